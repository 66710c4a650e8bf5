"""Shooting for the moment at the base of a loaded body.

Under dead loads the body is an initial-value problem once M_ext(0) is given, and M_ext(L) = m is the equation for
M_ext(0). The fixed point of the march and Newton's method for M_ext(0) go on together: each iteration marches once,
with the slopes of all values by M_ext(0), and then takes one Newton step.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint, unbent
from ..mechanics.problem import (
    BodyStates,
    Moment,
    Nodal,
    Number,
    Problem,
    Solution,
    line_up,
    loaded_to,
    state_at_nodes,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics import tolerances as tol
from ..numerics.arrays import largest_size, relative_size, varying_as, zero_as
from ..numerics.elements import Elements
from .system import Flag, Polished, Slopes, System, few_round_offs, moment_left_at_tip, newton_step

# The values of a loaded body in one array, as XLA compiles a kernel for every array that a loop carries. Rows: r of
# each tendon, M_ext over its scale, and the heading; in space twice the quaternion, whose change is an angle. Columns:
# base, nodes, tip. Slopes have a leading axis: by components of M_ext(0) over its scale, then by loads or tensions.
Values = Float[Array, "*slopes rows points"]


class Iterate(NamedTuple):
    """One iterate at a load fraction: each iteration brings it nearer to the equilibrium there."""

    values: Values
    slopes: Values  # of the march before
    residual_slopes: Float[Array, "slopes *components"]  # of M_ext(L) - m over the moment scale
    strain: Array | None  # the elastic strain, approximately; None where it has a closed form
    near: Flag  # near enough to the equilibrium to take the next step from here
    settled: Flag  # in equilibrium
    locked: Flag  # a tendon locks: its r has become negative and stays so
    lost: Flag  # locked, no longer finite, or too many iterations
    sane: Flag  # whether the first iteration was finite
    num_iterations: Number
    change: Number  # in the last iteration, relative; 0 before the first one


class _March(NamedTuple):
    """One march, with its slopes as in an iterate."""

    values: Values
    residual: Moment  # M_ext(L) - m over the moment scale
    slopes: Values
    residual_slopes: Array
    solution: Solution


class LoadedBody(NamedTuple):
    """A body, to be solved at any load fraction and with any moment at its base."""

    problem: Problem
    method: FixedPoint

    def at(self, moment: Moment, fraction: Number, pull: Number) -> Problem:
        """The problem at a moment over its scale, a load fraction, and a factor on all base tensions."""
        here = loaded_to(self.problem, fraction, moment * self.problem.moment_scale)
        return eqx.tree_at(lambda problem: problem.base_tension, here, pull * here.base_tension)

    def first(self, zero: Number) -> Iterate:
        """The body without friction and loads; `zero` varies over the same devices as all numbers."""
        problem, points = self.problem, self.problem.elements.nodes.size + 2
        components = max(problem.base_moment.size, 1)
        upright = np.ravel((2.0 if problem.geometry.has_frames else 1.0) * problem.geometry.upright)
        row = np.concatenate([np.ones(problem.base_tension.size), np.zeros(components), upright])
        start = jnp.asarray(np.tile(row[:, None], points), zero.dtype) + zero
        slopes = jnp.zeros((components + 1, *start.shape), start.dtype) + zero
        by = jnp.zeros((components + 1, *problem.base_moment.shape), start.dtype) + zero
        strain, none, true = varying_as(unbent(problem).nodes.strain, zero), zero > 0, zero == 0
        return Iterate(start, slopes, by, strain, none, none, none, none, true, zero, zero)

    def nodal(self, values: Values, finer: Elements | None = None) -> Nodal:
        """The unknowns of a march; those of `finer` elements, where they are given."""
        elements = self.problem.elements
        inner = jnp.moveaxis(values[..., 1:-1], -2, -1)
        inner = inner.reshape(*values.shape[:-2], *elements.nodes.shape, -1)
        if finer is not None:
            refined = partial(elements.refined, finer=finer)
            inner = refined(inner) if values.ndim == 2 else jax.vmap(refined)(inner)
        ratio, moment, heading = jnp.split(inner, self._rows, axis=-1)
        moment = moment.reshape(*moment.shape[:-1], *self.problem.base_moment.shape)
        return Nodal(ratio, moment, 0.5 * heading if self.problem.geometry.has_frames else None)

    def moment(self, values: Values) -> Moment:
        """M_ext(0) over its scale."""
        return values[slice(*self._rows), 0].reshape(self.problem.base_moment.shape)

    def headings(self, values: Values) -> Array:
        """The headings at base, nodes and tip."""
        upright = self.problem.geometry.upright.shape
        found = jnp.moveaxis(values[..., self._rows[1] :, :], -2, -1)
        return found.reshape(*found.shape[:-1], *upright)

    @property
    def _rows(self) -> tuple[int, int]:
        """Where the moment begins and ends among the rows of the values; static."""
        tendons = self.problem.base_tension.size
        return tendons, tendons + max(self.problem.base_moment.size, 1)

    def iterate(self, before: Iterate, fraction: Number, by_loads: Flag) -> Iterate:
        """One march with its slopes, then one Newton step of M_ext(0); all other values change by their slopes.

        Args:
            before: the last iterate.
            fraction: of the loads.
            by_loads: whether the last slope is that with respect to the load fraction; otherwise it is that with
                respect to a factor on all base tensions.
        """
        new = self._march_with_slopes(before, fraction, by_loads)
        moment, turned, solution = self.moment(before.values), self.headings(new.slopes), new.solution
        newton, off = newton_step(self.problem, moment, new.residual, turned[:-1], new.residual_slopes[:-1])
        # where the march is less accurate than the residual is large, the residual may be an error of the march
        inaccurate = (solution.residual > largest_size(new.residual)) & ~solution.converged
        step = jnp.where(inaccurate, 0.0, newton)
        sane = jnp.isfinite(largest_size(newton)) & jnp.isfinite(solution.residual) & ~solution.locked
        changed = relative_size(new.residual_slopes - before.residual_slopes, new.residual_slopes)
        settled = sane & solution.converged & (jnp.maximum(off, changed) <= 2 * few_round_offs(off) ** 0.5)
        near = sane & self._is_near(before, new, jnp.maximum(off, solution.residual), fraction)
        return Iterate(
            values=new.values + along_moment(new.slopes, step),
            slopes=new.slopes,
            residual_slopes=new.residual_slopes,
            strain=solution.nodes.strain,
            near=settled | near,
            settled=settled,
            locked=solution.locked,
            lost=~sane | (before.num_iterations + 1 >= self.method.max_iterations),
            sane=jnp.where(before.num_iterations == 0, sane, before.sane),
            num_iterations=before.num_iterations + 1.0,
            change=solution.residual,
        )

    def _march_with_slopes(self, before: Iterate, fraction: Number, by_loads: Flag) -> _March:
        one, moment = jnp.ones_like(before.change), self.moment(before.values)

        def flow(guess: Nodal, moment: Moment, fraction: Number, pull: Number):
            here = self.at(moment, fraction, pull)
            solution = self.method.improve(here, guess, before.strain, before.change)
            return (values_along(here, solution.states), moment_left_at_tip(here, solution)), solution

        def push(*tangents):
            at = self.nodal(before.values), moment, fraction, one
            return jax.jvp(flow, at, tangents, has_aux=True)

        seeds = self.nodal(before.slopes), *_directions(moment, zero_as(moment, fraction), by_loads)
        (values, residual), (slopes, steepness), solution = jax.vmap(push, out_axes=(None, 0, None))(*seeds)
        return _March(values, residual, slopes, steepness, solution)

    def _is_near(self, before: Iterate, new: _March, off: Number, fraction: Number) -> Flag:
        """Whether values, slopes and stability are known well enough to predict the next step."""
        slope = self.problem.geometry.steepness(new.residual_slopes[:-1])
        rough = jnp.where(fraction == 0, tol.ROUGH_AT_START, tol.ROUGH)
        enough = rough * jnp.minimum(1.0, slope)  # the sign of the slope must be known
        drift = new.residual_slopes - before.residual_slopes
        steady = largest_size(drift[:-1]) <= tol.STEADY * slope
        steady &= relative_size(drift, new.residual_slopes) <= tol.STEADY
        if self.problem.geometry.has_frames:  # where stability follows from the turns
            turns, last = self.headings(new.slopes[:-1]), self.headings(before.slopes[:-1])
            steady &= relative_size(turns - last, turns) <= tol.STEADY
        return (off <= enough) & steady

    def roughly(self, end: Iterate, system: System, targets: int) -> Polished:
        """An equilibrium of this body as the start of `polish`, for the same body without roughness.

        Args:
            end: an equilibrium.
            system: the body without roughness.
            targets: their number.
        """
        finer, zero, count = system.problem.elements, zero_as(end), len(end.residual_slopes) - 1
        rest = unbent(system.problem)
        strain = None if end.strain is None else self.problem.elements.refined(end.strain, finer)
        states = varying_as(rest._replace(nodes=rest.nodes._replace(strain=strain)), zero)
        by_moment = self.nodal(end.slopes[:count], finer), end.residual_slopes[:count].reshape(count, count)
        slopes = Slopes(*by_moment).beside(len(system.unknown), targets)
        start = system.with_moment(self.moment(end.values)) + zero, self.nodal(end.values, finer), states
        return Polished(*start, slopes, slopes.residual[0], zero, zero > 0, zero > 0, zero + tol.REFINED)

    def is_stable(self, iterate: Iterate) -> Flag:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body."""
        turned, heading = self.headings(iterate.slopes[:-1, :, 1:]), self.headings(iterate.values[:, 1:])
        return self.problem.geometry.is_stable(turned, heading, iterate.residual_slopes[:-1])

    def error_amplification(self, iterate: Iterate) -> Number:
        """The factor by which local errors along the body grow in the equilibrium.

        A local error causes a residual moment at the tip. A change of M_ext(0) removes it, and turns the whole body.
        Where errors grow exponentially along the body, an error in the middle grows by the square root of the factor
        for an error at the base.
        """
        turned, least = largest_size(self.headings(iterate.slopes[:-1])), jnp.finfo(iterate.change.dtype).eps
        corrected = turned / jnp.maximum(self.problem.geometry.steepness(iterate.residual_slopes[:-1]), least)
        return jnp.maximum(corrected, jnp.sqrt(jnp.maximum(turned, 1.0)))

    def slope_that_follows(self, iterate: Iterate) -> Values:
        """The derivative of the values by loads or tensions, while M_ext(0) follows so that M_ext(L) stays m."""
        by_moment, last = iterate.residual_slopes[:-1], iterate.residual_slopes[-1]
        follows = -self.problem.geometry.moment_for(by_moment, last)
        return iterate.slopes[-1] + along_moment(iterate.slopes, jnp.where(largest_size(last) == 0, 0.0, follows))

    def travel_rate(self, iterate: Iterate, fraction: Number) -> PerTendon:
        """The rate, m, at which tendons slide in while all base tensions rise in proportion."""

        def displacement(guess: Nodal, moment: Moment, pull: Number) -> PerTendon:
            here = self.at(moment, fraction, pull)
            return tendon_displacement(here, state_at_nodes(here, guess, iterate.strain))

        one = jnp.ones_like(iterate.change)
        at, moved = iterate.values, self.slope_that_follows(iterate)
        places, ways = ((self.nodal(x), self.moment(x), one) for x in (at, moved))
        return jax.jvp(displacement, places, ways)[1]


def _directions(moment: Moment, zero: Number, by_loads: Flag) -> tuple[Array, Array, Array]:
    """Of the slopes, for `flow`: along each component of the moment, and last by the loads or by all base tensions."""
    second, count = jnp.where(by_loads, 1.0 + zero, 0.0), max(moment.size, 1)
    units, last = (jnp.asarray(x, second.dtype) for x in (np.eye(count + 1, count), np.eye(count + 1)[-1]))
    return zero + units.reshape(count + 1, *moment.shape), second * last, (1.0 - second) * last


def values_along(problem: Problem, states: BodyStates) -> Values:
    """The values of a body at base, nodes and tip."""
    base, tip = (jax.tree.map(lambda x, at=at: x[at], state) for state, at in ((states.starts, 0), (states.ends, -1)))
    along = jax.tree.map(line_up, base, states.nodes, tip)
    heading = 2.0 * along.heading if problem.geometry.has_frames else along.heading
    every = along.ratio, along.moment / problem.moment_scale, heading
    return jnp.concatenate([jnp.moveaxis(x.reshape(len(x), -1), 1, 0) for x in every])


def along_moment(slopes: Array, change: Moment) -> Array:
    """The change of numbers with these slopes by a change of M_ext(0), over its scale."""
    return change * slopes[0] if change.ndim == 0 else jnp.tensordot(change, slopes[:-1], 1)
