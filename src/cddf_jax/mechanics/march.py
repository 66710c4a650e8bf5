"""One iteration of the solver, the march from base to tip, and the fixed point that makes it a method.

Shape and tension depend on each other: friction lowers the tension where the tendon turns, and the tension bends the
body. The unknowns at the nodes are r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext, in space also the rotation. Each iteration computes
the shape from the last unknowns, and new unknowns from that shape. With one unloaded tendon theta' r mostly does not
depend on r, see `Problem.is_quadrature`, and one iteration is exact.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import all_finite, computed_once, largest, largest_size, relative_size, sum_of, zero_as
from ..numerics.elements import Elements, totals
from ..numerics.fixed_point import fixed_point, minus, newton, round_off, without_derivative
from ..numerics.rotations import about, direction_of, parts_of, product, turned_across, turned_by
from ..robot.cross_section import AnySection, where_present
from . import space
from .friction import PerTendon, Pull, growth_beyond, is_proportional, ratio_beyond, ratio_factor, spent_rate, wrap_of
from .kinks import Tensions, tensions_along, with_smooth_ratios
from .problem import (
    BodyStates,
    Drops,
    Joints,
    Nodal,
    Number,
    Problem,
    Solution,
    State,
    nodal,
    ones_at_base,
    starts_of_newton,
    strain_along,
    strain_of,
)
from .truncation_error import missed_in_place, missed_in_turning

# the states at the starts, the nodes and the ends of the elements, the elastic strain at the nodes, and what they miss
Along = tuple[State, State, State, Array, Array | None]


class Part(NamedTuple):
    """What the march needs of each element; leading axis P."""

    width: Float[Array, " P"]
    section: AnySection  # at the nodes
    joint: Joints | None  # at its start
    force_at_start: Any  # N, newtons; None in space without loads
    force: Any  # likewise at the nodes
    drops: Drops | None  # of force and moment, at its start
    guess: Nodal  # the unknowns of the iteration before
    strain: Array | None  # the elastic strain there, approximately; None where it has a closed form


def march(problem: Problem, guess: Nodal, strain: Array | None = None) -> Along:
    """One iteration: shape, friction and moment from base to tip, by a scan over the elements.

    Args:
        problem: the body.
        guess: the unknowns at its nodes.
        strain: the elastic strain there, approximately, from which Newton's method starts; None to start from zero.
    """
    outboard = problem.outboard
    forces = (outboard.starts, outboard.nodes) if _has_headings(problem) else (None, None)
    parts = Part(problem.elements.width, problem.nodes, problem.joints, *forces, outboard.drops, guess, strain)

    def element(arriving: State, part: Part) -> tuple[State, Along]:
        start = _across_joint(problem, arriving, part)
        nodes, end, elastic, missed = _along_element(problem, start, part)
        return end, (start, nodes, end, elastic, missed)

    return jax.lax.scan(element, _at_base(problem), parts)[1]


def _has_headings(problem: Problem) -> bool:
    """Whether the march knows headings; in space without loads it does not need them; static."""
    return problem.loads is not None or not problem.geometry.has_frames


def _at_base(problem: Problem) -> State:
    ones = ones_at_base(problem)
    zero = zero_as(ones)
    return State(
        pull=Pull(ones, None if problem.nodes.drag is None else 0.0 * ones),
        heading=zero + jnp.asarray(problem.geometry.upright, zero.dtype) if _has_headings(problem) else None,
        moment=problem.base_moment + zero,
        force=None,
        strain=None,
        growth=0.0 * ones,
    )


def unbent(problem: Problem) -> BodyStates:
    """The states of a body without friction, on which its loads do not act yet."""
    base, shape = _at_base(problem), problem.elements.nodes.shape
    starts, nodes = (
        jax.tree.map(lambda x, at=at: jnp.broadcast_to(x, (*at, *x.shape)), base) for at in (shape[:1], shape)
    )
    elastic = jnp.zeros_like(problem.nodes.stiffness) + zero_as(base)
    return _solved(problem, starts, nodes, starts, elastic)


def _along_element(problem: Problem, start: State, part: Part) -> tuple[State, State, Array, Number | None]:
    """The states at the nodes and at the end of an element, the elastic strain at the nodes, and what they miss."""
    spent = _onwards(start.pull.spent, part.width, spent_rate(problem.direction, part.section, part.guess.ratio))
    tensions = _tensions(problem, start, part, Pull(part.guess.ratio, spent[0]))
    strains = _strains(problem, part, tensions)
    heading, axis, moment_rate = _headings(problem, start, part, tensions, strains)
    growth, missed = _turned(problem, start, part, tensions, strains, moment_rate)
    if missed is not None and axis is not None:
        missed = missed + missed_in_place(problem, part.width, axis, tensions.places)
    if missed is not None and tensions.spread is not None:
        missed = missed + jax.lax.stop_gradient(tensions.spread) * part.width / problem.elements.edges[-1]
    moments = 0.0 * _moments(problem, part.guess) if moment_rate is None else moment_rate
    rows = zip(growth, spent, heading, _onwards(start.moment, part.width, moments), strict=True)
    nodes, end = (_beyond(problem, start, *row) for row in rows)
    return nodes, end, jax.vmap(problem.geometry.elastic)(part.section, tensions.at_nodes(strains)), missed


def _beyond(
    problem: Problem, start: State, growth: Array, spent: Array | None, heading: Array | None, moment: Array | None
) -> State:
    """The state at the nodes or the end of an element, from the growth of the integral of theta' r since its start."""
    ratio = start.ratio + problem.direction * problem.manipulator.tendon_friction * growth
    return State(Pull(ratio, spent), heading, moment, None, None, growth=start.growth + growth)


Both = tuple[Array | None, Array | None]  # a value at the nodes of an element, and at its end


def _onwards(start: Array | None, width: Number, rate: Array | None) -> Both:
    """A value at the nodes and at the end of an element, from that at its start and its rate at the nodes."""
    if start is None or rate is None:
        return None, None
    nodes, end = totals(width, rate)
    return start + nodes, start + end


def _strains(problem: Problem, part: Part, tensions: Tensions) -> Float[Array, "branches p *strains"]:
    """The strain at the nodes of an element, on each branch."""
    acting = part.guess.frame, _moments(problem, part.guess), part.force, part.strain
    strain = jax.vmap(jax.vmap(problem.geometry.strain), (None, 0, None, None, None, None))
    return strain(part.section, tensions.branches, *acting)


def _headings(
    problem: Problem, start: State, part: Part, tensions: Tensions, strains: Array
) -> tuple[Both, Array | None, Array | None]:
    """The headings of an element; the axis t and M_ext' at its nodes, which follow from the new headings."""
    if start.heading is None:
        return (None, None), None, None
    geometry = problem.geometry
    nodes, end = tensions.totals(part.width, jax.vmap(partial(geometry.heading_rate, part.guess.frame))(strains))
    heading = start.heading + nodes, start.heading + end
    axis = geometry.axis(heading[0], tensions.at_nodes(strains))
    return heading, axis, None if problem.loads is None else geometry.moment_rate(axis, part.force)


def _turning(problem: Problem, part: Part, tensions: Tensions, strains: Array, moment_rate: Array | None) -> Array:
    """The turning of the tendons at the nodes of an element, on each branch."""

    def on_branch(strain: Array, tension: Array, sign: Array | None) -> Array:
        given = strain, tension, problem.direction, moment_rate, sign
        return problem.geometry.turning(part.width, part.section, *given)

    return jax.vmap(on_branch)(strains, tensions.branches, tensions.signs)


def _tensions(problem: Problem, start: State, part: Part, pull: Pull) -> Tensions:
    """The tensions along an element, in which tendons may turn over or become slack."""
    tensions = tensions_along(part.section, problem.base_tension, pull, problem.rough)
    if not problem.has_kinks or problem.geometry.has_frames:  # in space there are sharp minima in place of kinks
        return tensions
    strains, moment_rate = _strains(problem, part, tensions), None
    own = not problem.geometry.has_closed_strain(problem.manipulator, loaded=False)
    if own:  # a slanted tendon turns with kappa'
        moment_rate = _headings(problem, start, part, tensions, strains)[2]
    turning = _turning(problem, part, tensions, strains, moment_rate)
    growth = part.width * ratio_factor(part.section, pull.ratio) * turning
    return with_smooth_ratios(tensions, part.section, problem.base_tension, pull, problem.direction, growth, own)


def _turned(
    problem: Problem, start: State, part: Part, tensions: Tensions, strains: Array, moment_rate: Array | None
) -> tuple[tuple[Array, Array], Number | None]:
    """The integral of theta' r to the nodes and to the end of an element, and what the nodes miss of it."""
    geometry = problem.geometry
    turning = _turning(problem, part, tensions, strains, moment_rate)
    rates = geometry.scaled(turning, jnp.abs(tensions.ratios))
    both = tensions.totals(part.width, rates, geometry.size, geometry.gains if problem.has_kinks else None)
    return both, None if problem.rough else missed_in_turning(problem, part.width, rates)


def _moments(problem: Problem, guess: Nodal) -> Float[Array, "p *components"]:
    """M_ext at the nodes of an element, N m."""
    if guess.moment is not None:
        return problem.moment_scale * guess.moment
    return jnp.multiply.outer(0.0 * guess.ratio[:, 0], jnp.asarray(problem.geometry.no_moment, guess.ratio.dtype))


def _across_joint(problem: Problem, arriving: State, part: Part) -> State:
    """The state beyond the start of an element: r grows by the finite angle by which a tendon turns there."""
    beyond = arriving if part.drops is None else arriving._replace(moment=arriving.moment - part.drops.moment)
    if part.joint is None:
        return beyond
    inner = part.force_at_start if part.drops is None else part.force_at_start + part.drops.force
    sides = arriving._replace(force=inner), beyond._replace(force=part.force_at_start)
    turn, ratio = turn_at_joint(problem, part.joint, *sides)
    growth = arriving.growth + growth_beyond(problem.direction, part.joint.before, turn, arriving.ratio)
    return beyond._replace(pull=arriving.pull._replace(ratio=ratio), growth=growth)


def turn_at_joint(problem: Problem, joint: Joints, arriving: State, beyond: State) -> tuple[PerTendon, PerTendon]:
    """The finite angle by which a tendon turns where two pieces meet (exact kinematics), and r beyond it.

    Force and moment of the loads are given on either side.
    """
    geometry, ratio = problem.geometry, arriving.ratio

    def pointing(section: AnySection, side: State, ratio: PerTendon) -> Array:
        state = side._replace(pull=side.pull._replace(ratio=ratio))
        return geometry.pointing(section, strain_of(section, problem.base_tension, state))

    before = pointing(joint.before, arriving, ratio)

    def step(guess: tuple[PerTendon, PerTendon]) -> tuple[PerTendon, PerTendon]:
        turn = where_present(joint.after, geometry.turn_between(before, pointing(joint.after, beyond, guess[1])))
        turn = jnp.where(joint.turns, turn, 0.0)
        return turn, ratio_beyond(problem.direction, joint.before, turn, ratio)

    return newton(step, (jnp.zeros_like(ratio), ratio + zero_as(before)), tol.JOINT_STEPS)


# --- the method ------------------------------------------------------------------------------------


class FixedPoint(eqx.Module):
    """The default method: Picard iteration of r = 1 + integral of direction mu theta' r.

    Under dead loads M_ext = M_ext(0) - integral of t x N is iterated with it. Each iteration solves the equilibrium
    of every cross-section with the last tensions and the last moment (the semi-implicit map). Both enter
    through Volterra integrals, so that the error after n iterations falls like c^n / n! for any load.
    Derivatives are implicit, see `numerics.fixed_point`.

    Args:
        tolerance: relative change of r at which the iteration stops; None for 1e-12 (float32: 4e-6).
        max_iterations: the largest number of iterations in one try.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_iterations: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem) -> Solution:
        if problem.is_quadrature:
            return self._by_quadrature(problem)
        least, guess, off = self.tolerance_of(problem), nodal(problem, unbent(problem).nodes), jnp.inf
        if _follows_the_axis(problem):
            guess, off = _once(problem, guess)
        settings = {"tolerance": least, "max_iterations": self.max_iterations, "acceptable": _acceptable, "off": off}
        values, count, change, good = fixed_point(Partial(_improved, problem), guess, **settings)
        found = self.improve(problem, values)
        good = good & jnp.all(found.tip.ratio > 0)
        locked = (change <= least) & ~good
        return Solution(found.states, count, change, good, locked, found.missed)

    def _by_quadrature(self, problem: Problem) -> Solution:
        """The solution where r is exact after one iteration, from any guess; the next gives the shape.

        r is kept also where a tendon that slides out locks further outboard: a trace takes what lies before.
        """
        straight = unbent(problem)
        first = self.improve(problem, without_derivative(nodal(problem, straight.nodes)))
        finite = all_finite(first.nodes.ratio)
        good = _acceptable(nodal(problem, first.nodes)) & jnp.all(first.tip.ratio > 0)
        guess = jax.tree.map(lambda new, old: jnp.where(good, new, old), first.nodes, straight.nodes)
        found = self.improve(problem, nodal(problem, guess))
        pairs = zip(found.states, first.states, strict=True)
        states = (state._replace(pull=exact.pull, growth=exact.growth) for state, exact in pairs)
        change, count = jnp.where(finite, 0.0, jnp.inf), ones_at_base(problem)[0]
        return Solution(BodyStates(*states), count, change, good, finite & ~good, found.missed)

    def improve(
        self, problem: Problem, guess: Nodal, strain: Array | None = None, before: Number | float = 0.0
    ) -> Solution:
        """One iteration from a guess; `converged` if its result is the solution.

        Args:
            problem: the body.
            guess: the unknowns at its nodes.
            strain: the elastic strain there, that of the iteration before.
            before: the relative change in that iteration, 0 if there was none. It shows how fast they converge.
        """
        starts, nodes, ends, elastic, missed = march(problem, guess, strain)
        states = _solved(problem, starts, nodes, ends, elastic)
        better, guess = without_derivative((nodal(problem, states.nodes), guess))  # their change needs no derivative
        change = relative_size(minus(better, guess), better)
        positive = jnp.all(states.ends.ratio > 0) & jnp.all(better.ratio > 0)
        # the iteration converges by the factor change / before, so the next change would be this one times that factor
        least = self.tolerance_of(problem)
        still = (change * change <= least * jnp.maximum(before, change)) & (change <= tol.LAST_GAIN * least)
        # from a poor guess r may pass below zero and come back
        ended = jnp.ones_like(change), change, still & positive, still & ~positive
        return Solution(states, *ended, 0.0 if missed is None else jnp.sum(missed))

    def tolerance_of(self, problem: Problem) -> float:
        """The relative change at which the iteration stops."""
        return max(1e-12, round_off(problem.elements.edges.dtype)) if self.tolerance is None else self.tolerance


def _improved(problem: Problem, guess: Nodal) -> Nodal:
    return nodal(problem, march(problem, guess)[1])


def _acceptable(values: Nodal) -> Bool[Array, ""]:
    return all_finite(values._replace(ratio=jnp.where(values.ratio > 0, values.ratio, jnp.inf)))


def _follows_the_axis(problem: Problem) -> bool:
    """Whether all tendons of a body in space follow its axis, and lose tension in proportion to it; static."""
    closed = problem.geometry.has_closed_strain(problem.manipulator, problem.loads is not None)
    return problem.geometry.has_frames and closed and is_proportional(problem.nodes)


def _once(problem: Problem, guess: Nodal) -> tuple[Nodal, Number]:
    """The ratio r of tendons that follow the axis after one iteration; how far it is off: zero if friction is alike.

    If all tendons have the same friction, all tensions fall alike, and |M| r is the moment of the base tensions:
    r' = direction mu |M(0)| / (E J).
    """
    growth = problem.direction * problem.manipulator.tendon_friction
    return _improved(problem, guess), jnp.where(jnp.all(growth == growth[0]), 0.0, jnp.inf)


def _solved(problem: Problem, starts: State, nodes: State, ends: State, elastic: Array) -> BodyStates:
    """The states with the forces of the loads, and the elastic strain where it has no closed form."""
    outboard, strains = problem.outboard, starts_of_newton(problem, elastic)
    forces = (outboard.starts, outboard.nodes, outboard.ends) if _has_headings(problem) else (None, None, None)
    given = zip((starts, nodes, ends), forces, strains, strict=True)
    states = [state._replace(force=force, strain=strain) for state, force, strain in given]
    if not _has_headings(problem):
        upright = jnp.asarray(problem.geometry.upright, elastic.dtype)
        states = [state._replace(heading=jnp.multiply.outer(1 + 0 * state.ratio[..., 0], upright)) for state in states]
    return BodyStates(*states)


# --- what does not act back on the tensions: found at the end -----------------------------------------


def finished(problem: Problem, solution: Solution) -> Solution:
    """The solution with wrap angle and position, in space without loads also with rotations."""
    if solution.nodes.growth is None:
        return solution
    cut, geometry, states = problem.elements, problem.geometry, solution.states
    strain = strain_along(problem.nodes, problem.base_tension, states.nodes)
    headings, missed = [state.heading for state in states], solution.missed
    if not _has_headings(problem):
        (edges, nodes), found = _frames(cut, strain)
        headings, solution = [edges[:-1], nodes, edges[1:]], replace(solution, converged=solution.converged & found)
    axis = geometry.axis(headings[1], strain)
    if not _has_headings(problem):
        missed = missed + jnp.sum(jax.vmap(partial(missed_in_place, problem))(cut.width, axis))
    edges, nodes = cut.integrate(axis)

    def whole(state: State, heading: Array, position: Array) -> State:
        wrap_angle = wrap_of(problem.direction * problem.manipulator.tendon_friction, state.growth)
        return state._replace(heading=heading, position=position, wrap_angle=wrap_angle, growth=None)

    rows = zip(states, headings, (edges[:-1], nodes, edges[1:]), strict=True)
    return replace(solution, states=BodyStates(*(whole(*row) for row in rows)), missed=missed)


def _frames(cut: Elements, strain: Array) -> tuple[tuple[Array, Array], Bool[Array, ""]]:
    """The rotations at the edges and the nodes that follow from the curvature, both (..., 4); whether they are found.

    Each is a turn about one axis for the whole body, and a rotation after it, which an iteration finds: the identity
    and a change. Where the body bends about one axis, the turn is all.
    """
    curvature = computed_once(space.curvature_of_strain(strain))
    axis = without_derivative(direction_of(jnp.sum(cut.gain(curvature), axis=0)))  # any axis leads to the same frames
    rate = sum_of([x * n for x, n in zip(parts_of(curvature), axis, strict=True)])[..., 0]
    turns = jax.tree.map(lambda angle: about(axis, angle), cut.integrate(rate))
    rest = turned_across(turns[1], curvature - rate[..., None] * axis)
    off = largest(sum_of([jnp.abs(part) for part in parts_of(rest)])) * cut.edges[-1]
    settings = {"tolerance": round_off(rate.dtype), "size": _absolute_size, "off": off}
    found = fixed_point(Partial(_turned_on, cut, rest), jax.tree.map(jnp.zeros_like, turns), **settings)
    return jax.tree.map(lambda turn, change: turn + product(change, turn), turns, found.value), found.converged


def _turned_on(cut: Elements, rate: Array, change: tuple[Array, Array]) -> tuple[Array, Array]:
    """A better change, by which the rotation differs from the identity."""
    real, vector = jnp.split(change[1], [1], axis=-1)
    return cut.integrate(turned_by(jnp.concatenate([1.0 + real, vector], axis=-1), rate))


def _absolute_size(change: tuple[Array, Array], _: tuple[Array, Array]) -> Number:
    return largest_size(change)
