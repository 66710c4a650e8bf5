"""The tensions along a body, resolved together with its shape by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r. With one unloaded tendon in the published kinematics theta' r does not
depend on r, and one sweep of the fixed point is exact.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import mechanics
from .fixed_point import fixed_point, round_off
from .manipulator import CrossSection, Manipulator
from .quadrature import Panels, panels

PerTendon = Float[Array, " tendons"]
Number = Float[Array, ""]
ACCURACY = 1e-5  # a larger error of truncation is not called successful, nor a larger residual of Marching
SAFETY = 5.0  # by which the difference of two quadratures is taken larger than it is


class Joints(NamedTuple):
    """Where two smooth pieces of the body may meet: both sides of the start of every panel, leading axis P."""

    before: CrossSection
    after: CrossSection


class Problem(eqx.Module):
    """A body under load, cut into panels, its cross-sections evaluated once."""

    manipulator: Manipulator
    base_tension: PerTendon
    direction: PerTendon
    panels: Panels
    base: CrossSection
    nodes: CrossSection  # leading axes: P panels, p nodes
    tip: CrossSection
    joints: Joints | None  # None where no tendon can turn by a finite angle


class State(NamedTuple):
    """What is integrated along the body; leading axes may be panels and nodes."""

    ratio: Float[Array, "*points tendons"]  # r = T_base / T
    wrap_angle: Float[Array, "*points tendons"]  # theta, rad
    heading: Float[Array, "*points"]  # phi, rad
    position: Float[Array, "*points 2"]  # u, m


class Path(NamedTuple):
    """A method's answer."""

    starts: State  # at the start of every panel
    nodes: State  # at every Gauss node
    tip: State
    num_iterations: Number
    residual: Number  # what the method itself left open, relative
    converged: Bool[Array, ""]
    locked: Bool[Array, ""]  # the tension of a tendon sliding out grows without bound


@runtime_checkable
class Method(Protocol):
    """A way to resolve shape and tension. Its settings are static."""

    def __call__(self, problem: Problem) -> Path: ...


def lay_out(manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, nodes: int) -> Problem:
    """Cut the body into panels and evaluate its cross-sections."""
    cut = panels(jnp.asarray(manipulator.length), manipulator.breakpoints, nodes)
    nudge = edge_nudge(cut)
    section = jax.vmap(lambda s: guarded_section(manipulator, s))
    along = section(jnp.concatenate([nudge[None], cut.nodes.ravel(), cut.edges[-1:] - nudge]))
    turns = manipulator.kinematics == "exact" and manipulator.slanted and manipulator.breakpoints.shape[0] > 0
    starts = cut.edges[:-1]
    return Problem(
        manipulator,
        base_tension,
        direction,
        cut,
        base=jax.tree.map(lambda x: x[0], along),
        nodes=jax.tree.map(lambda x: x[1:-1].reshape(*cut.nodes.shape, *x.shape[1:]), along),
        tip=jax.tree.map(lambda x: x[-1], along),
        joints=Joints(section(jnp.maximum(starts - nudge, 0.0)), section(starts + nudge)) if turns else None,
    )


def guarded_section(manipulator: Manipulator, arc_length: Number) -> CrossSection:
    """The cross-section, with a stand-in where a body that is none has no stiffness; `solve` reports that."""
    section = manipulator.cross_section(arc_length)
    stiffness = jnp.where(section.stiffness > 0, section.stiffness, 1.0)
    return eqx.tree_at(lambda section: section.stiffness, section, stiffness)


def edge_nudge(cut: Panels) -> Number:
    """The least step off an edge, m, that surely tells its two sides apart."""
    return 8 * float(jnp.finfo(cut.edges.dtype).eps) * cut.edges[-1]


# --- one cross-section ---------------------------------------------------------------------------


def tension_of(section: CrossSection, base_tension: PerTendon, ratio: PerTendon) -> PerTendon:
    """T = T_base / r, zero beyond the anchor. Where a tendon locks, r goes on below zero, and its size stands in."""
    size = jnp.maximum(jnp.abs(ratio), jnp.finfo(ratio.dtype).eps)
    return jnp.where(section.present, base_tension / size, 0.0)


def turning_of(problem: Problem, section: CrossSection, ratio: PerTendon) -> tuple[Number, PerTendon]:
    """The curvature kappa, and theta' of each tendon, from the tensions at one cross-section."""
    tension = tension_of(section, problem.base_tension, ratio)
    kappa = mechanics.curvature(section, tension)
    turning = mechanics.rates(section, kappa, tension, problem.direction).turning
    return kappa, jnp.where(section.present, jnp.abs(turning), 0.0)


def ratio_rate(problem: Problem, section: CrossSection, ratio: PerTendon) -> PerTendon:
    """The growth r' = direction mu theta' r."""
    _, wrap_rate = turning_of(problem, section, ratio)
    return problem.direction * section.friction_coefficient * wrap_rate * jnp.abs(ratio)


def turn_at_joint(problem: Problem, joint: Joints | None, ratio: PerTendon) -> tuple[PerTendon, PerTendon]:
    """The finite angle by which a tendon turns where two pieces meet (exact kinematics), and r beyond it."""
    if joint is None:
        return jnp.zeros_like(ratio), ratio
    before, after = joint

    def angle(section, ratio):
        kappa = mechanics.curvature(section, tension_of(section, problem.base_tension, ratio))
        return mechanics.tangent_angle(section, kappa)

    arriving, gain = angle(before, ratio), problem.direction * before.friction_coefficient
    turn, beyond = jnp.zeros_like(ratio), ratio
    for _ in range(6):  # the angle beyond depends on r there only by mu d d' kappa, so this contracts fast
        turn = jnp.where(after.present, jnp.abs(angle(after, beyond) - arriving), 0.0)
        beyond = ratio * jnp.exp(gain * turn)
    return turn, beyond


# --- the whole body ------------------------------------------------------------------------------

_at_nodes = (None, 0, 0)
ratio_rates = jax.vmap(ratio_rate, _at_nodes)  # over the nodes of a panel
turning_along = jax.vmap(jax.vmap(turning_of, _at_nodes), _at_nodes)  # over panels and nodes


def integrate_shape(cut: Panels, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    return heading, cut.integrate(jnp.stack([jnp.cos(heading[1]), jnp.sin(heading[1])], axis=-1))


def truncation_error(problem: Problem, path: Path) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    The rates along the polynomials of the solution are integrated once more with a few more nodes in
    each panel; what differs is summed over the panels.
    """
    coarse, fine = problem.panels, problem.panels.finer()
    sections = jax.vmap(jax.vmap(lambda s: guarded_section(problem.manipulator, s)))(fine.nodes)
    ratio = coarse.resample(path.starts.ratio, path.nodes.ratio, fine.rule.nodes)
    heading = coarse.resample(path.starts.heading, path.nodes.heading, fine.rule.nodes)

    def gains(cut, sections, ratio, heading):
        kappa, wrap_rate = turning_along(problem, sections, ratio)
        growth = sections.friction_coefficient * wrap_rate * ratio / path.tip.ratio
        axis = jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1) / cut.edges[-1]
        return cut.gain(jnp.concatenate([growth, axis, kappa[..., None]], axis=-1))

    finely = gains(fine, sections, ratio, heading)
    coarsely = gains(coarse, problem.nodes, path.nodes.ratio, path.nodes.heading)
    truncation = SAFETY * jnp.max(jnp.sum(jnp.abs(finely - coarsely), axis=0))
    return jnp.maximum(truncation, _unseen_turning(problem))


def _unseen_turning(problem: Problem) -> Number:
    """What the nodes miss of the frictionless bend, the integral of T_base d / (E J), rad: a notch between them."""
    body, coarse = problem.manipulator, problem.panels
    dense = coarse.densely(times=32, order=4)

    def bend(arc_length):
        stiffness = body.bending_stiffness(arc_length)
        return problem.base_tension * body.offset(arc_length) / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = coarse.gain(jax.vmap(jax.vmap(bend))(coarse.nodes))
    there = dense.gain(jax.vmap(jax.vmap(bend))(dense.nodes)).reshape(seen.shape[0], -1, seen.shape[1]).sum(axis=1)
    return jnp.max(jnp.sum(jnp.abs(there - seen), axis=0))


class FixedPoint(eqx.Module):
    """The default: in each panel sweep r = r_start + integral of direction mu theta' r; `lax.scan` over the panels.

    A sweep solves the equilibrium of every cross-section with the tensions at hand (the semi-implicit
    map). Tensions enter through a Volterra integral, so the errors of the sweeps fall like c^n / n!
    for any tension. Derivatives are implicit, see `fixed_point`.

    Args:
        tolerance: relative change of r at which the sweeps stop; None for 1e-12 (float32: 4e-6).
        max_sweeps: in one panel.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_sweeps: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem) -> Path:
        cut = problem.panels
        tolerance = max(1e-12, round_off(cut.edges.dtype)) if self.tolerance is None else self.tolerance
        integration, weights = cut.constant("integration"), cut.constant("weights")

        def panel(ratio, inputs):
            section, joint, width = inputs
            turn, start = turn_at_joint(problem, joint, ratio)
            answer = fixed_point(
                lambda r: start + width * integration @ ratio_rates(problem, section, r),
                jnp.broadcast_to(start, (cut.order, *start.shape)),
                tolerance=tolerance,
                max_sweeps=self.max_sweeps,
                acceptable=lambda r: jnp.all(r > 0),
            )
            end = start + width * weights @ ratio_rates(problem, section, answer.value)
            return jnp.where(end > 0, end, 1.0), (start, answer, turn, jnp.all(end > 0))

        inputs = problem.nodes, problem.joints, cut.width
        tip, (starts, answer, turns, positive) = jax.lax.scan(panel, ones_at_base(problem), inputs)
        settled = answer.change <= tolerance
        return _follow(
            problem, starts, answer.value, tip, turns,
            num_iterations=jnp.max(answer.num_sweeps),
            residual=jnp.max(answer.change),
            converged=jnp.all(answer.converged & positive),
            locked=jnp.any(settled & ~(answer.converged & positive)),
        )  # fmt: skip


def ones_at_base(problem: Problem) -> PerTendon:
    """Ones, r at the base, made so that under shard_map it varies over the same devices as r further on."""
    rate = ratio_rate(problem, problem.base, problem.base_tension)
    return jnp.where(rate == rate, jnp.ones_like(rate), 1.0)


def _follow(problem: Problem, starts: Array, nodes: Array, tip: Array, turns: Array, **outcome) -> Path:
    """Integrate the turning that goes with r at starts, nodes and tip into wrap angle, heading and position."""
    kappa, wrap_rate = turning_along(problem, problem.nodes, nodes)
    wrap_edges, wrap = problem.panels.integrate(wrap_rate)
    turned = jnp.cumsum(turns, axis=0)
    (heading_edges, heading), (position_edges, position) = integrate_shape(problem.panels, kappa)
    return Path(
        State(starts, wrap_edges[:-1] + turned, heading_edges[:-1], position_edges[:-1]),
        State(nodes, wrap + turned[:, None], heading, position),
        State(tip, wrap_edges[-1] + turned[-1], heading_edges[-1], position_edges[-1]),
        **outcome,
    )
