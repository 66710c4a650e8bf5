"""One pass towards the equilibrium of a body, with its slopes, and a Newton step of the moment at the base.

Without loads a pass improves the values at the nodes. Under dead loads the body is an initial-value problem once
M_ext(0) is given, and M_ext(L) = m is the equation for M_ext(0). In each pass of a `Trial` the values at the nodes are
improved, and Newton's method improves M_ext(0).
"""

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..mechanics.friction import PerTendon
from ..mechanics.problem import (
    AnyState,
    Method,
    Moment,
    Nodal,
    Number,
    PassState,
    Problem,
    Solution,
    loaded_to,
    nodal,
    state_at_nodes,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.arrays import largest_size, relative_size, varying_as, zero_as
from ..numerics.rotations import cofactors, cross, small_turn, solve_three

ROUGH = 2e-2  # relative tolerance of the states along the path of the loads
STEADY = 2e-1  # relative tolerance of the slopes along the path of the loads
ROUGH_AT_START = 5e-2  # looser at load fraction 0: its state serves the first prediction only

Tree = TypeVar("Tree")
Flag = Bool[Array, ""]


class Headings(NamedTuple):
    """The heading phi at the nodes and at the tip, rad, or slopes of it along a leading axis K.

    In space it is twice the quaternion, whose change is an angle.
    """

    nodes: Float[Array, "*K_P_p_and_components"]
    tip: Float[Array, "*K_and_components"]


class Slopes(NamedTuple):
    """Slopes along a leading axis: with respect to each component of M_ext(0), last to the loads or the tensions."""

    nodal: Nodal
    heading: Headings
    residual: Float[Array, "slopes *components"]  # of the residual moment at the tip


class Trial(NamedTuple):
    """One corrector iterate at a load fraction: each pass brings it nearer to the equilibrium there."""

    nodal: Nodal
    moment: Moment | None  # M_ext(0) over its scale; None without loads
    heading: Headings | None  # likewise
    slopes: Slopes | None  # likewise
    strain: Array | None  # the elastic strain, approximately; None where it has a closed form
    near: Flag  # near enough to the equilibrium to take the next step from here
    settled: Flag  # in equilibrium
    locked: Flag  # a tendon locks: its r has become negative and stays so
    lost: Flag  # locked, no longer finite, or too many passes
    sane: Flag  # whether the first pass was finite
    num_passes: Number
    change: Number  # in the last pass, relative; 0 before the first one of a try

    @property
    def stable(self) -> Flag:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body.

        The nodes of a panel without width may lie at the base, where nothing turns.
        """
        if self.slopes is None:
            return self.settled | True  # true on all devices of shard_map over which the others vary
        if self.moment is not None and self.moment.ndim:
            return self._stable_in_space
        slope = by_moment(self.slopes.heading)
        return (self.slopes.residual[0] > 0) & (slope.tip > 0) & jnp.all(slope.nodes >= 0)

    @property
    def _stable_in_space(self) -> Flag:
        """Whether no eigenvalue has become negative, of two matrices of derivatives.

        These are the turns of the cross-sections by M_ext(0), and M_ext(L) by the turn of the tip. The three invariants
        decide. They also show two eigenvalues that became negative together.
        """
        assert self.heading is not None
        assert self.slopes is not None
        slope, heading = _in_one_row(by_moment(self.slopes.heading)), _in_one_row(self.heading)
        turns = jnp.moveaxis(small_turn(slope, heading), 0, -1) * 2.0  # headings are twice a quaternion
        nodes, tip = turns, turns[-1]
        stiffness = (
            by_moment(self.slopes.residual).T @ cofactors(tip).T
        )  # det(tip) times M_ext(L) by the turn of the tip
        matrices = jnp.concatenate([nodes, (stiffness + stiffness.T)[None]])
        signs = _invariants(matrices)
        return jnp.all(signs >= 0) & jnp.all(signs[:, -2:] > 0)

    @property
    def leverage(self) -> Number:
        """The factor by which local errors along the body grow in the equilibrium; 1 without loads.

        A local error causes a residual moment at the tip. A change of M_ext(0) removes it, and turns the whole body.
        Where errors grow exponentially along the body, an error in the middle grows by the square root of the factor
        for an error at the base.
        """
        if self.slopes is None:
            return jnp.ones_like(self.change)
        turned, least = largest_size(by_moment(self.slopes.heading)), jnp.finfo(self.change.dtype).eps
        corrected = turned / jnp.maximum(steepness(self.slopes.residual), least)
        return jnp.maximum(corrected, jnp.sqrt(jnp.maximum(turned, 1.0)))


class LoadedBody(NamedTuple):
    """A body, to be solved at any load fraction and with any moment at its base."""

    problem: Problem
    method: Method

    def at(self, moment: Moment, fraction: Number, pull: Number) -> Problem:
        """The problem at a moment over its scale, a load fraction, and a factor on all base tensions."""
        here = loaded_to(self.problem, fraction, moment * self.problem.moment_scale)
        return eqx.tree_at(lambda problem: problem.base_tension, here, pull * here.base_tension)

    def correct(self, trial: Trial, fraction: Number, by_loads: Flag) -> Trial:
        """One pass with its slopes, then one Newton step of M_ext(0); all other values change by their slopes.

        Args:
            trial: to be corrected.
            fraction: of the loads.
            by_loads: whether the second slope is that with respect to the load fraction; otherwise it is that with
                respect to a factor on all base tensions.
        """
        if trial.moment is None or trial.slopes is None:
            return self._improve(trial)
        one = jnp.ones_like(trial.change)

        def flow(guess: Nodal, moment: Moment, fraction: Number, pull: Number):
            here = self.at(moment, fraction, pull)
            solution = self.method.improve(here, guess, trial.strain, trial.change)
            heading = Headings(solution.nodes.heading, solution.tip.heading)
            heading = jax.tree.map(lambda x: 2.0 * x, heading) if here.in_space else heading
            return (nodal(here, solution.nodes), heading, moment_left_at_tip(here, solution)), solution

        def push(*tangents):
            return jax.jvp(flow, (trial.nodal, trial.moment, fraction, one), tangents, has_aux=True)

        size = max(trial.moment.size, 1)
        units, last = np.eye(size + 1, size).reshape(size + 1, *trial.moment.shape), np.eye(size + 1)[-1]
        zero, second = zero_as(trial.moment, fraction), jnp.where(by_loads, one, 0.0)
        seeds = (
            zero + jnp.asarray(units, one.dtype),
            second * last.astype(one.dtype),
            (one - second) * last.astype(one.dtype),
        )
        (values, heading, residual), slopes, solution = jax.vmap(push, out_axes=(None, 0, None))(
            trial.slopes.nodal, *seeds
        )
        slopes = Slopes(*slopes)
        newton, off = _newton(trial.moment, residual, slopes)
        # where the pass is less accurate than the residual is large, the residual may be an error of the pass
        inaccurate = (solution.residual > magnitude(residual)) & ~solution.converged
        correction = jnp.where(inaccurate, 0.0, newton)
        sane = jnp.isfinite(magnitude(newton)) & jnp.isfinite(solution.residual) & ~solution.locked
        changed = relative_size(slopes.residual - trial.slopes.residual, slopes.residual)
        slope, rough = steepness(slopes.residual), jnp.where(fraction == 0, ROUGH_AT_START, ROUGH)
        enough = rough * jnp.minimum(1.0, slope)  # the sign of the slope must be known
        settled = sane & solution.converged & (jnp.maximum(off, changed) <= 2 * _round_off(off) ** 0.5)
        near = sane & (jnp.maximum(off, solution.residual) <= enough)
        drifted = magnitude(by_moment(slopes.residual) - by_moment(trial.slopes.residual))
        steady = (drifted <= STEADY * slope) & (changed <= STEADY)
        if trial.moment.ndim:  # stability follows from the turns, of which the residual without loads says nothing
            turns, before = (by_moment(each.heading) for each in (slopes, trial.slopes))
            steady &= relative_size(jax.tree.map(jnp.subtract, turns, before), turns) <= STEADY
        return trial._replace(
            moment=trial.moment + correction,
            nodal=_moved(values, slopes.nodal, correction),
            heading=_moved(heading, slopes.heading, correction),
            slopes=slopes,
            strain=solution.nodes.strain,
            near=settled | (near & steady),
            settled=settled,
            locked=solution.locked,
            lost=~sane | (trial.num_passes + 1 >= self.method.max_passes),
            sane=jnp.where(trial.num_passes == 0, sane, trial.sane),
            num_passes=trial.num_passes + 1.0,
            change=solution.residual,
        )

    def _improve(self, trial: Trial) -> Trial:
        """One pass without loads."""
        solution = self.method.improve(self.problem, trial.nodal, trial.strain, trial.change)
        sane = jnp.isfinite(solution.residual) & ~solution.locked
        return trial._replace(
            nodal=nodal(self.problem, solution.nodes),
            strain=solution.nodes.strain,
            near=solution.converged,
            settled=solution.converged,
            locked=solution.locked,
            lost=~sane | (trial.num_passes + 1 >= self.method.max_passes),
            num_passes=trial.num_passes + 1.0,
            change=solution.residual,
        )

    def state(self, trial: Trial, fraction: Number) -> PassState:
        """The state at the nodes."""
        problem = self.problem if trial.moment is None else self.at(trial.moment, fraction, jnp.ones_like(trial.change))
        state = state_at_nodes(problem, trial.nodal, trial.strain)
        return state if trial.heading is None or problem.in_space else state._replace(heading=trial.heading.nodes)

    def travel(self, trial: Trial, fraction: Number) -> PerTendon:
        """How far tendons slide in, m; under loads the rate of that while all base tensions rise in proportion, m."""

        def displacement(guess: Nodal, moment: Moment, pull: Number) -> PerTendon:
            here = self.at(moment, fraction, pull)
            return tendon_displacement(here, state_at_nodes(here, guess, trial.strain))

        if trial.moment is None or trial.slopes is None:
            return tendon_displacement(self.problem, state_at_nodes(self.problem, trial.nodal, trial.strain))
        one = jnp.ones_like(trial.change)
        follows = moment_that_follows(trial.slopes.residual)
        moved = jax.tree.map(lambda slopes: slopes[-1] + along_moment(slopes, follows), trial.slopes.nodal)
        return jax.jvp(displacement, (trial.nodal, trial.moment, one), (moved, follows, one))[1]


# --- M_ext(0) is one number in the plane, and three in space ---------------------------------------


def by_moment(slopes: Tree) -> Tree:
    """The slopes with respect to M_ext(0), which stand first; in space along an axis of three."""
    return jax.tree.map(lambda x: x[0] if x.shape[0] == 2 else x[:-1], slopes)


def along_moment(slopes: Array, change: Moment) -> Array:
    """The change of numbers with these slopes by a change of M_ext(0), over its scale."""
    return change * slopes[0] if change.ndim == 0 else jnp.tensordot(change, slopes[:-1], 1)


def moment_for(residual_slopes: Float[Array, "slopes *components"], change: Moment) -> Moment:
    """The change of M_ext(0) that causes a given change of the residual moment at the tip."""
    if change.ndim == 0:
        return change / residual_slopes[0]
    return solve_three(residual_slopes[:-1].T, change)


def moment_that_follows(residual_slopes: Float[Array, "slopes *components"]) -> Moment:
    """The derivative of M_ext(0) with respect to the loads or the tensions at which M_ext(L) stays m."""
    still = magnitude(residual_slopes[-1]) == 0
    return jnp.where(still, 0.0, -moment_for(residual_slopes, residual_slopes[-1]))


def steepness(residual_slopes: Float[Array, "slopes *components"]) -> Number:
    """The least rate at which the residual moment at the tip changes with M_ext(0); approximate in space."""
    slope = by_moment(residual_slopes)
    if slope.ndim == 0:
        return jnp.abs(slope)
    return jnp.abs(_invariants(slope)[2]) / jnp.maximum(largest_size(slope), jnp.finfo(slope.dtype).tiny) ** 2


def magnitude(moment: Array) -> Number:
    """The largest component."""
    return jnp.abs(moment) if moment.ndim == 0 else largest_size(moment)


def _invariants(matrix: Float[Array, "*points 3 3"]) -> Float[Array, "3 *points"]:
    """The trace, the sum of the principal minors, and the determinant."""
    a, b, c = (matrix[..., i, :] for i in range(3))
    trace = a[..., 0] + b[..., 1] + c[..., 2]
    of_square = jnp.sum(matrix * jnp.swapaxes(matrix, -1, -2), axis=(-2, -1))
    return jnp.stack([trace, (trace**2 - of_square) / 2, jnp.sum(a * cross(b, c), axis=-1)])


def _in_one_row(headings: Headings) -> Float[Array, "*K points components"]:
    """The headings in space, or slopes of them, at the nodes and at last at the tip."""
    nodes = headings.nodes.reshape(*headings.tip.shape[:-1], -1, headings.tip.shape[-1])
    return jnp.concatenate([nodes, headings.tip[..., None, :]], axis=-2)


def _moved(values: Tree, slopes: Tree, moment: Moment) -> Tree:
    """The values after a change of M_ext(0), over its scale."""
    return jax.tree.map(lambda x, slope: x + along_moment(slope, moment), values, slopes)


def _round_off(x: Array) -> float:
    return 4 * float(jnp.finfo(x.dtype).eps)


def _newton(moment: Moment, residual: Moment, slopes: Slopes) -> tuple[Moment, Number]:
    """The Newton step of M_ext(0), and the largest angle by which it turns the body, rad."""
    exact = magnitude(residual) <= _round_off(residual)  # also where its slope vanishes
    step = jnp.where(exact, 0.0, -moment_for(slopes.residual, residual))
    size, length = 1 + magnitude(moment), magnitude(step)
    turned = length * jnp.maximum(1 / size, largest_size(by_moment(slopes.heading)))
    return step, jnp.where(length <= _round_off(step) * size, 0.0, turned)  # less than rounding


def moment_left_at_tip(problem: Problem, solution: Solution[AnyState]) -> Moment:
    """M_ext(L) - m over the moment scale."""
    return (solution.tip.moment - problem.outboard.tip_moment) / problem.moment_scale


def start_from(guess: Nodal, strain: Array | None, zero: Number) -> Trial:
    """A trial from a guess of the values at the nodes; `zero` varies over the same devices as all numbers."""
    (guess, strain), false, true = varying_as((guess, strain), zero), zero > 0, zero == 0
    heading = slopes = moment = None
    if guess.moment is not None:
        in_space = guess.frame is not None
        moment = zero + jnp.zeros(3) if in_space else zero
        shape = guess.frame.shape if guess.frame is not None else guess.moment.shape
        heading = Headings(zero + jnp.zeros(shape, zero.dtype), zero + jnp.zeros(shape[2:], zero.dtype))
        none = jax.tree.map(jnp.zeros_like, guess), jax.tree.map(jnp.zeros_like, heading), moment
        slopes = Slopes(*jax.tree.map(lambda x: jnp.stack([x] * (4 if in_space else 2)), none))
    return Trial(
        nodal=guess,
        moment=moment,
        heading=heading,
        slopes=slopes,
        strain=strain,
        near=false,
        settled=false,
        locked=false,
        lost=false,
        sane=true,
        num_passes=zero,
        change=zero,
    )
