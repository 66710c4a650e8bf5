"""One equilibrium under dead loads: the moment at the base that leaves the right moment at the tip.

With M_ext(0) given, the body is an initial-value problem, and M_ext(L) = m is one equation for M_ext(0). A `Trial` is
brought to its root: each pass improves the values at the nodes, and Newton's method M_ext(0).
"""

from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..mechanics.friction import PerTendon
from ..mechanics.problem import Method, Nodal, Number, Problem, Solution, loaded_to, nodal, tendon_displacement
from ..numerics.arrays import largest, largest_size, relative_size, varying_as, zero_as

MAX_PASSES = 64  # in one try
MAX_POLISHING = 16  # passes without slopes
ROUGH = 1e-3  # relative tolerance of the states on the way
STEADY = 1e-2  # relative tolerance of the slope with respect to M_ext(0) on the way
TRAVEL = 1e-7  # relative tolerance of the travel of tendons, of which only the sign is used

Tree = TypeVar("Tree")
Flag = Bool[Array, ""]


class Headings(NamedTuple):
    """The heading phi at the nodes and at the tip, rad, or slopes of it along a leading axis K."""

    nodes: Float[Array, "*K P p"]
    tip: Float[Array, "*K"]


class Trial(NamedTuple):
    """One corrector iterate at a load fraction: each pass brings it nearer to the equilibrium there.

    Slopes have a leading axis K: with respect to M_ext(0), and on the path also with respect to the load fraction.
    """

    moment: Number  # M_ext(0) over its scale
    nodal: Nodal
    nodal_slopes: Nodal
    residual_slopes: Float[Array, " K"]  # of the residual moment at the tip
    heading: Headings
    heading_slopes: Headings
    near: Flag  # near enough to the equilibrium to take the next step from here
    settled: Flag  # in equilibrium
    lost: Flag  # no longer finite, or too many passes
    sane: Flag  # whether the first pass was finite
    num_passes: Number
    change: Number  # in the last pass, relative

    @property
    def stable(self) -> Flag:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body."""
        slope = by_moment(self.heading_slopes)
        return (self.residual_slopes[0] > 0) & (slope.tip > 0) & (largest(-slope.nodes) < 0)

    @property
    def leverage(self) -> Number:
        """The factor by which local errors along the body grow in the equilibrium.

        A local error leaves a residual moment at the tip. A change of M_ext(0) removes it, and turns the whole body.
        Where an error grows exponentially along the body, one made in the middle grows by the square root of the
        factor of one made at the base.
        """
        turned, least = largest_size(by_moment(self.heading_slopes)), jnp.finfo(self.residual_slopes.dtype).eps
        corrected = turned / jnp.maximum(jnp.abs(self.residual_slopes[0]), least)
        return jnp.maximum(corrected, jnp.sqrt(jnp.maximum(turned, 1.0)))


class LoadedBody(NamedTuple):
    """A body under its loads, to be solved at any load fraction and with any moment at its base."""

    problem: Problem
    method: Method

    def at(self, moment: Number, fraction: Number) -> Problem:
        """The problem at a moment and a load fraction."""
        return loaded_to(self.problem, fraction, moment * self.problem.moment_scale)

    def solution(self, trial: Trial, fraction: Number) -> Solution:
        """One pass of the method from the values at the nodes."""
        return self.method.improve(self.at(trial.moment, fraction), trial.nodal)

    def correct(self, trial: Trial, fraction: Number) -> tuple[Trial, Solution]:
        """One pass with its slopes, then one Newton step of M_ext(0), along whose slopes everything else follows."""
        close = 2 * _round_off(trial.moment) ** 0.5

        def flow(guess: Nodal, *at: Number):
            here = self.at(*at)
            solution = self.method.improve(here, guess)
            heading = Headings(solution.nodes.heading, solution.tip.heading)
            return (nodal(here, solution), moment_left_at_tip(here, solution), heading), solution

        def push(*tangents):
            return jax.jvp(flow, (trial.nodal, trial.moment, fraction), tangents, has_aux=True)

        basis = jnp.eye(trial.residual_slopes.shape[0], 2, dtype=trial.moment.dtype).T
        basis = basis + zero_as(trial.moment)  # shard_map wants tangents like their values
        values_and_slopes = jax.vmap(push, out_axes=(None, 0, None))(trial.nodal_slopes, *basis)
        (values, residual, heading), (nodal_slopes, slopes, heading_slopes), solution = values_and_slopes
        newton, off = _newton(trial.moment, residual, slopes[0], heading_slopes)
        rough = (solution.residual > jnp.abs(residual)) & ~solution.converged  # the residual may be that of the pass
        correction = jnp.where(rough, 0.0, newton)
        sane = jnp.isfinite(newton) & jnp.isfinite(solution.residual) & ~solution.locked
        changes = slopes - trial.residual_slopes
        steady = jnp.abs(changes[0]) <= STEADY * jnp.abs(slopes[0])
        enough = ROUGH * jnp.minimum(1.0, jnp.abs(slopes[0]))  # the sign of that slope must be known
        settled = sane & solution.converged & (jnp.maximum(off, relative_size(changes, slopes)) <= close)
        return Trial(
            moment=trial.moment + correction,
            nodal=_moved(values, nodal_slopes, correction),
            nodal_slopes=nodal_slopes,
            residual_slopes=slopes,
            heading=_moved(heading, heading_slopes, correction),
            heading_slopes=heading_slopes,
            near=settled | (sane & (jnp.maximum(off, solution.residual) <= enough) & steady),
            settled=settled,
            lost=~sane | (trial.num_passes + 1 >= MAX_PASSES),
            sane=jnp.where(trial.num_passes == 0, sane, trial.sane),
            num_passes=trial.num_passes + 1.0,
            change=solution.residual,
        ), solution

    def polish(self, trial: Trial, fraction: Number, wanted: Flag) -> Trial:
        """Where it is wanted: passes without slopes, and Newton steps along the last known slopes, until it settles."""

        def once(trial: Trial) -> Trial:
            solution = self.solution(trial, fraction)
            here = self.at(trial.moment, fraction)
            residual = moment_left_at_tip(here, solution)
            correction, off = _newton(trial.moment, residual, trial.residual_slopes[0], trial.heading_slopes)
            return trial._replace(
                moment=trial.moment + correction,
                nodal=_moved(nodal(here, solution), trial.nodal_slopes, correction),
                settled=solution.converged & ~solution.locked & (off <= _round_off(off) / STEADY),
                num_passes=trial.num_passes + 1.0,
                change=solution.residual,
            )

        polished = jax.lax.while_loop(
            lambda trial: wanted & ~trial.settled & (trial.num_passes < MAX_POLISHING),
            once,
            trial._replace(num_passes=jnp.zeros_like(trial.num_passes)),
        )
        return jax.tree.map(lambda a, b: jnp.where(polished.settled, a, b), polished, trial)

    def travel(self, trial: Trial, fraction: Number) -> PerTendon:
        """The rate at which tendons slide in while all base tensions rise in proportion, m."""

        def flow(guess: Nodal, moment: Number, pull: Number):
            here = self.at(moment, fraction)
            here = eqx.tree_at(lambda problem: problem.base_tension, here, pull * self.problem.base_tension)
            solution = self.method.improve(here, guess)
            return nodal(here, solution), moment_left_at_tip(here, solution), tendon_displacement(here, solution)

        def one_pass(state):  # M_ext(0) has to follow for M_ext(L) to stay m
            old, slope, _, count = state
            new, missing, _ = push(old, slope, one)
            more = jnp.where(missing == 0, 0.0, -missing / trial.residual_slopes[0])
            new = _moved(new, trial.nodal_slopes, more)
            return new, slope + more, relative_size(jax.tree.map(jnp.subtract, new, old), new), count + 1.0

        zero, one = jnp.zeros_like(trial.moment), jnp.ones_like(trial.moment)
        push = jax.linearize(flow, trial.nodal, trial.moment, one)[1]
        start = jax.tree.map(jnp.zeros_like, trial.nodal), zero, zero + 1.0, zero
        pulled, slope, *_ = jax.lax.while_loop(
            lambda state: (state[2] > TRAVEL) & (state[3] < MAX_PASSES), one_pass, start
        )
        return push(pulled, slope, one)[2]


def by_moment(slopes: Tree) -> Tree:
    """The slopes with respect to M_ext(0), which stand first."""
    return jax.tree.map(lambda x: x[0], slopes)


def _moved(values: Tree, slopes: Tree, moment: Number) -> Tree:
    """The values after a change of M_ext(0), over its scale."""
    return jax.tree.map(lambda x, slope: x + moment * slope[0], values, slopes)


def _round_off(x: Array) -> float:
    return 4 * float(jnp.finfo(x.dtype).eps)


def _newton(moment: Number, residual: Number, slope: Number, heading_slopes: Headings) -> tuple[Number, Number]:
    """The Newton step of M_ext(0), and the largest angle by which it turns the body, rad."""
    exact = jnp.abs(residual) <= _round_off(residual)  # also where its slope vanishes
    step = jnp.where(exact, 0.0, -residual / slope)
    size = 1 + jnp.abs(moment)
    turned = jnp.abs(step) * jnp.maximum(1 / size, largest_size(by_moment(heading_slopes)))
    return step, jnp.where(jnp.abs(step) <= _round_off(step) * size, 0.0, turned)  # less than rounding


def moment_left_at_tip(problem: Problem, solution: Solution) -> Number:
    """M_ext(L) - m over the moment scale."""
    assert problem.loads is not None
    return (solution.tip.moment - problem.loads.tip_moment) / problem.moment_scale


def start_from(guess: Nodal, zero: Number, *, num_slopes: int) -> Trial:
    """A trial that knows nothing but a guess of the values at the nodes; 0 under shard_map varies as all numbers do."""
    guess = varying_as(guess, zero)
    flat = Headings(zero + jnp.zeros(guess.ratio.shape[:2], zero.dtype), zero)

    def one_each(tree: Tree) -> Tree:
        return jax.tree.map(lambda x: jnp.stack([x] * num_slopes), tree)

    false, true = zero > 0, zero == 0
    return Trial(
        moment=zero,
        nodal=guess,
        nodal_slopes=one_each(jax.tree.map(jnp.zeros_like, guess)),
        residual_slopes=one_each(zero),
        heading=flat,
        heading_slopes=one_each(flat),
        near=false,
        settled=false,
        lost=false,
        sane=true,
        num_passes=zero,
        change=zero,
    )
