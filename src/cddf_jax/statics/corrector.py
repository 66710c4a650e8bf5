"""One pass towards the equilibrium of a body, with its slopes, and a Newton step of the moment at the base.

Without loads a pass improves the values at the nodes. Under dead loads the body is an initial-value problem once
M_ext(0) is given, and M_ext(L) = m is one equation for M_ext(0). A `Trial` is brought to its root: each pass improves
the values at the nodes, and Newton's method M_ext(0).
"""

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..mechanics.friction import PerTendon
from ..mechanics.problem import (
    AnyState,
    Method,
    Nodal,
    Number,
    PassState,
    Problem,
    Solution,
    loaded_to,
    moments_of,
    nodal,
    pull_at_nodes,
    tendon_displacement,
)
from ..numerics.arrays import largest, largest_size, relative_size, varying_as, zero_as

ROUGH = 1e-3  # relative tolerance of the states on the way
STEADY = 1e-2  # relative tolerance of the slopes on the way

Tree = TypeVar("Tree")
Flag = Bool[Array, ""]


class Headings(NamedTuple):
    """The heading phi at the nodes and at the tip, rad, or slopes of it along a leading axis K."""

    nodes: Float[Array, "*K P p"]
    tip: Float[Array, "*K"]


class Slopes(NamedTuple):
    """Slopes along a leading axis of two: with respect to M_ext(0), and to the loads or the tensions."""

    nodal: Nodal
    heading: Headings
    residual: Float[Array, "2"]  # of the residual moment at the tip


class Trial(NamedTuple):
    """One corrector iterate at a load fraction: each pass brings it nearer to the equilibrium there."""

    nodal: Nodal
    moment: Number | None  # M_ext(0) over its scale; None without loads
    heading: Headings | None  # likewise
    slopes: Slopes | None  # likewise
    near: Flag  # near enough to the equilibrium to take the next step from here
    settled: Flag  # in equilibrium
    locked: Flag  # a tendon locks: its r passes below zero, and stays there
    lost: Flag  # locked, no longer finite, or too many passes
    sane: Flag  # whether the first pass was finite
    num_passes: Number
    change: Number  # in the last pass, relative

    @property
    def stable(self) -> Flag:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body."""
        if self.slopes is None:
            return self.settled | True  # true on all devices of shard_map over which the others vary
        slope = by_moment(self.slopes.heading)
        return (self.slopes.residual[0] > 0) & (slope.tip > 0) & (largest(-slope.nodes) < 0)

    @property
    def leverage(self) -> Number:
        """The factor by which local errors along the body grow in the equilibrium; 1 without loads.

        A local error leaves a residual moment at the tip. A change of M_ext(0) removes it, and turns the whole body.
        Where an error grows exponentially along the body, one made in the middle grows by the square root of the
        factor of one made at the base.
        """
        if self.slopes is None:
            return jnp.ones_like(self.change)
        turned, least = largest_size(by_moment(self.slopes.heading)), jnp.finfo(self.change.dtype).eps
        corrected = turned / jnp.maximum(jnp.abs(self.slopes.residual[0]), least)
        return jnp.maximum(corrected, jnp.sqrt(jnp.maximum(turned, 1.0)))


class LoadedBody(NamedTuple):
    """A body, to be solved at any load fraction and with any moment at its base."""

    problem: Problem
    method: Method

    def at(self, moment: Number, fraction: Number, pull: Number) -> Problem:
        """The problem at a moment over its scale, a load fraction, and a factor on all base tensions."""
        here = loaded_to(self.problem, fraction, moment * self.problem.moment_scale)
        return eqx.tree_at(lambda problem: problem.base_tension, here, pull * here.base_tension)

    def correct(self, trial: Trial, fraction: Number, by_loads: Flag) -> Trial:
        """One pass with its slopes, then one Newton step of M_ext(0), along whose slopes everything else follows.

        Args:
            trial: to be corrected.
            fraction: of the loads.
            by_loads: whether the second slope is that with respect to the load fraction; otherwise it is that with
                respect to a factor on all base tensions.
        """
        if trial.moment is None or trial.slopes is None:
            return self._improve(trial)
        one = jnp.ones_like(trial.moment)

        def flow(guess: Nodal, moment: Number, fraction: Number, pull: Number):
            here = self.at(moment, fraction, pull)
            solution = self.method.improve(here, guess)
            heading = Headings(solution.nodes.heading, solution.tip.heading)
            return (nodal(here, solution), heading, moment_left_at_tip(here, solution)), solution

        def push(*tangents):
            return jax.jvp(flow, (trial.nodal, trial.moment, fraction, one), tangents, has_aux=True)

        zero, second = zero_as(trial.moment, fraction), jnp.where(by_loads, one, 0.0)
        seeds = jnp.stack([jnp.stack([one, zero]), jnp.stack([zero, second]), jnp.stack([zero, one - second])])
        (values, heading, residual), slopes, solution = jax.vmap(push, out_axes=(None, 0, None))(
            trial.slopes.nodal, *seeds
        )
        slopes = Slopes(*slopes)
        newton, off = _newton(trial.moment, residual, slopes)
        rough = (solution.residual > jnp.abs(residual)) & ~solution.converged  # the residual may be that of the pass
        correction = jnp.where(rough, 0.0, newton)
        sane = jnp.isfinite(newton) & jnp.isfinite(solution.residual) & ~solution.locked
        changed = relative_size(slopes.residual - trial.slopes.residual, slopes.residual)
        enough = ROUGH * jnp.minimum(1.0, jnp.abs(slopes.residual[0]))  # the sign of that slope must be known
        settled = sane & solution.converged & (jnp.maximum(off, changed) <= 2 * _round_off(off) ** 0.5)
        near = sane & (jnp.maximum(off, solution.residual) <= enough)
        steady = jnp.abs(slopes.residual[0] - trial.slopes.residual[0]) <= STEADY * jnp.abs(slopes.residual[0])
        return trial._replace(
            moment=trial.moment + correction,
            nodal=_moved(values, slopes.nodal, correction),
            heading=_moved(heading, slopes.heading, correction),
            slopes=slopes,
            near=settled | (near & steady & (changed <= STEADY)),
            settled=settled,
            locked=solution.locked,
            lost=~sane | (trial.num_passes + 1 >= self.method.max_passes),
            sane=jnp.where(trial.num_passes == 0, sane, trial.sane),
            num_passes=trial.num_passes + 1.0,
            change=solution.residual,
        )

    def _improve(self, trial: Trial) -> Trial:
        """One pass without loads."""
        solution = self.method.improve(self.problem, trial.nodal)
        sane = jnp.isfinite(solution.residual) & ~solution.locked
        return trial._replace(
            nodal=nodal(self.problem, solution),
            near=solution.converged,
            settled=solution.converged,
            locked=solution.locked,
            lost=~sane | (trial.num_passes + 1 >= self.method.max_passes),
            num_passes=trial.num_passes + 1.0,
            change=solution.residual,
        )

    def state(self, trial: Trial, fraction: Number) -> PassState:
        """At the nodes."""
        problem = self.problem if trial.moment is None else self.at(trial.moment, fraction, jnp.ones_like(trial.moment))
        moment = moments_of(problem, trial.nodal)
        heading = jnp.zeros_like(moment) if trial.heading is None else trial.heading.nodes
        return PassState(pull_at_nodes(problem, trial.nodal), heading, moment, problem.outboard.nodes)

    def travel(self, trial: Trial, fraction: Number) -> PerTendon:
        """How far tendons slide in, m; under loads the rate at which they do while all base tensions rise together."""

        def displacement(guess: Nodal, moment: Number, pull: Number) -> PerTendon:
            here = self.at(moment, fraction, pull)
            return tendon_displacement(here, pull_at_nodes(here, guess), moments_of(here, guess))

        if trial.moment is None or trial.slopes is None:
            return tendon_displacement(
                self.problem, pull_at_nodes(self.problem, trial.nodal), moments_of(self.problem, trial.nodal)
            )
        one = jnp.ones_like(trial.moment)
        by_moment, by_pull = trial.slopes.residual
        follows = jnp.where(by_pull == 0, 0.0, -by_pull / by_moment)  # of M_ext(0), for M_ext(L) to stay m
        moved = jax.tree.map(lambda slopes: slopes[1] + follows * slopes[0], trial.slopes.nodal)
        return jax.jvp(displacement, (trial.nodal, trial.moment, one), (moved, follows, one))[1]


def by_moment(slopes: Tree) -> Tree:
    """The slopes with respect to M_ext(0), which stand first."""
    return jax.tree.map(lambda x: x[0], slopes)


def _moved(values: Tree, slopes: Tree, moment: Number) -> Tree:
    """The values after a change of M_ext(0), over its scale."""
    return jax.tree.map(lambda x, slope: x + moment * slope[0], values, slopes)


def _round_off(x: Array) -> float:
    return 4 * float(jnp.finfo(x.dtype).eps)


def _newton(moment: Number, residual: Number, slopes: Slopes) -> tuple[Number, Number]:
    """The Newton step of M_ext(0), and the largest angle by which it turns the body, rad."""
    exact = jnp.abs(residual) <= _round_off(residual)  # also where its slope vanishes
    step = jnp.where(exact, 0.0, -residual / slopes.residual[0])
    size = 1 + jnp.abs(moment)
    turned = jnp.abs(step) * jnp.maximum(1 / size, largest_size(by_moment(slopes.heading)))
    return step, jnp.where(jnp.abs(step) <= _round_off(step) * size, 0.0, turned)  # less than rounding


def moment_left_at_tip(problem: Problem, solution: Solution[AnyState]) -> Number:
    """M_ext(L) - m over the moment scale."""
    assert problem.loads is not None
    return (solution.tip.moment - problem.loads.tip_moment) / problem.moment_scale


def start_from(guess: Nodal, zero: Number) -> Trial:
    """A trial that knows nothing but a guess of the values at the nodes; 0 under shard_map varies as all numbers do."""
    guess, false, true = varying_as(guess, zero), zero > 0, zero == 0
    heading = slopes = None
    if guess.moment is not None:
        heading = Headings(zero + jnp.zeros(guess.moment.shape, zero.dtype), zero)
        none = jax.tree.map(jnp.zeros_like, guess), heading, zero
        slopes = Slopes(*jax.tree.map(lambda x: jnp.stack([x, x]), none))
    return Trial(
        nodal=guess,
        moment=None if slopes is None else zero,
        heading=heading,
        slopes=slopes,
        near=false,
        settled=false,
        locked=false,
        lost=false,
        sane=true,
        num_passes=zero,
        change=zero,
    )
