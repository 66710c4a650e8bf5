"""A second method of `solve`, the oracle of the fixed point: one pass with Runge-Kutta steps, without iteration."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from cddf_jax.mechanics import bending
from cddf_jax.mechanics.friction import Pull, ratio_factor, spent_rate
from cddf_jax.mechanics.geometry import axis_of
from cddf_jax.mechanics.march import turn_at_joint
from cddf_jax.mechanics.problem import (
    Nodal,
    Number,
    Problem,
    Solution,
    State,
    edge_nudge,
    guarded_section,
    load_rate,
    ones_at_base,
    spent_scale,
    starts_of_newton,
    strain_along,
    strain_of,
    tension_of,
)
from cddf_jax.numerics import tolerances
from cddf_jax.numerics.arrays import zero_as
from cddf_jax.robot.loads import planar_cross


class Marching(eqx.Module):
    """The whole state integrated together from base to tip, by the classical Runge-Kutta method from node to node.

    The pass is made a second time with half the step. `residual` is the error by Richardson's rule.

    Args:
        steps: Runge-Kutta steps between neighbouring nodes in the coarser pass.
    """

    steps: int = eqx.field(default=4, static=True)
    max_iterations: ClassVar[int] = 64

    def __call__(self, problem: Problem) -> Solution:
        coarse, _ = _march(problem, self.steps)
        tip, (starts, along) = _march(problem, 2 * self.steps)
        length = problem.elements.edges[-1]
        one = jnp.ones_like(length)
        force = jnp.max(jnp.abs(problem.outboard.starts)) + problem.moment_scale / length
        pull = Pull(tip.ratio, spent_scale(problem, tip.pull))
        scale = State(pull, one, problem.moment_scale, force, None, jnp.ones_like(tip.ratio), length)
        both = zip(*map(jax.tree.leaves, (tip, coarse, scale)), strict=True)
        differences = [jnp.max(jnp.abs((a - b) / c)) for a, b, c in both]
        residual = jnp.max(jnp.stack(differences)) / 15
        positive = jnp.all(along.ratio > 0)
        nodes, ends = (jax.tree.map(lambda x, at=at: x[:, at], along) for at in (slice(-1), -1))
        strain = strain_along(problem.nodes, problem.base_tension, nodes)
        at_starts, at_nodes, at_ends = starts_of_newton(problem, strain)
        return Solution(
            starts=starts._replace(strain=at_starts),
            nodes=nodes._replace(strain=at_nodes),
            ends=ends._replace(strain=at_ends),
            num_iterations=jnp.ones_like(length),
            residual=residual,
            converged=positive & (residual <= tolerances.ACCURACY),
            locked=~positive,
        )

    def improve(self, problem: Problem, guess: Nodal, strain: Array | None = None, before: object = 0.0) -> Solution:
        return self(problem)

    finish = improve


def _march(problem: Problem, steps: int) -> tuple[State, tuple[State, State]]:
    """The state at the tip; at the start of every element; at every node and the end of every element."""
    cut = problem.elements
    stops = jnp.concatenate([cut.nodes, cut.edges[1:, None]], axis=1)
    nudge = edge_nudge(cut)

    def rate(state: State, arc_length: Number) -> State:
        section = guarded_section(problem.manipulator, arc_length)
        kappa = strain_of(section, problem.base_tension, state)
        moment_rate = -planar_cross(axis_of(state.heading), state.force)
        tension = tension_of(section, problem.base_tension, state.pull)
        turning = bending.turning(section, kappa, tension, problem.direction, moment_rate)
        ratio = state.ratio
        direction = problem.direction
        faster = direction * jnp.abs(turning) * ratio_factor(section, ratio)
        growth = Pull(faster, spent_rate(direction, section, ratio))
        force_rate = jnp.zeros_like(state.force)
        if problem.loads is not None:
            force_rate = -load_rate(problem.manipulator, arc_length, problem.loads)
        return State(growth, kappa, moment_rate, force_rate, None, jnp.abs(turning), axis_of(state.heading))

    def element(state, inputs):
        joint, drops, start, end, stops = inputs
        arriving = state
        if drops is not None:
            state = state._replace(force=state.force - drops.force, moment=state.moment - drops.moment)
        if joint is not None:
            turn, ratio = turn_at_joint(problem, joint, arriving, state)
            state = state._replace(pull=state.pull._replace(ratio=ratio), wrap_angle=state.wrap_angle + turn)

        def inside(state, arc_length):  # stay on this element's side of its edges
            return rate(state, jnp.clip(arc_length, start + nudge, end - nudge))

        def leg(carry, stop):
            state, here = carry
            step = (stop - here) / steps
            state = jax.lax.fori_loop(0, steps, lambda i, y: _runge_kutta(inside, y, here + i * step, step), state)
            return (state, stop), state

        (end_state, _), along = jax.lax.scan(leg, (state, start), stops)
        return end_state, (state, along)

    ones = ones_at_base(problem)
    zero = zero_as(ones)
    force = problem.outboard.starts[0]
    pull = Pull(ones, None if problem.base.drag is None else jnp.zeros_like(ones))
    base = State(pull, zero, problem.base_moment, force, None, jnp.zeros_like(ones), jnp.zeros_like(force))
    base = jax.tree.map(lambda x: x + zero, base)
    inputs = problem.joints, problem.outboard.drops, cut.edges[:-1], cut.edges[1:], stops
    return jax.lax.scan(element, base, inputs)


def _runge_kutta(rate, state: State, arc_length: Number, step: Number) -> State:
    def advanced(slope, fraction):
        return jax.tree.map(lambda y, f: y + fraction * step * f, state, slope)

    k1 = rate(state, arc_length)
    k2 = rate(advanced(k1, 0.5), arc_length + step / 2)
    k3 = rate(advanced(k2, 0.5), arc_length + step / 2)
    k4 = rate(advanced(k3, 1.0), arc_length + step)
    return jax.tree.map(lambda y, a, b, c, d: y + step / 6 * (a + 2 * b + 2 * c + d), state, k1, k2, k3, k4)
