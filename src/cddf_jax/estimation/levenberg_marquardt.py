"""The minimum of a sum of squares, by optimistix's Levenberg-Marquardt over dimensionless unknowns."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float

from .parameter_space import Numbers, Prior
from .residuals import Deviations, LeastSquaresProblem

TOLERANCE = 1e-9  # relative, of unknowns and cost; tighter, and rounding errors of the cost would decide on steps
BATCH_TOLERANCE = 1e-6  # of a lane of many: far below any standard error
MAX_STEPS = 500


class Redrawn(NamedTuple):
    """Data instead of a problem's, with a leading axis of searches or one for all; None for those of the problem."""

    values: Sequence[Numbers] | None = None
    means: Sequence[Numbers] | None = None  # of the priors
    times: Sequence[Numbers] | None = None  # how often each datum counts, under a robust loss


class Outcome(NamedTuple):
    """Where the optimiser stopped; of many searches at once all with one leading axis."""

    z: np.ndarray
    parameters: np.ndarray
    size: np.ndarray  # of each parameter, its unit below
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    cost: np.ndarray  # the sum of squares, or of the loss
    num_steps: np.ndarray
    solved: np.ndarray


def hold_one(count: int, i: int, value: ArrayLike) -> np.ndarray:
    """What to hold of so many parameters so that parameter i has this value and all others are free."""
    return np.where(np.arange(count) == i, value, np.nan)


class Minimum(NamedTuple):
    """A problem, the noise that its data were weighted with, and where the search for its minimum ended."""

    problem: LeastSquaresProblem
    noise: tuple[np.ndarray, ...]  # standard deviations, one array for each group of data
    outcome: Outcome

    def refit(self, held: np.ndarray, max_steps: int = MAX_STEPS) -> tuple[Outcome, float]:
        """Hold some parameters, fit the others from here on.

        Args:
            held: values at which parameters are held, NaN for those that are free.
            max_steps: of the optimiser.

        Returns:
            Where the search ended, and the rise of the cost; NaN where the model gives no number.
        """
        moved = minimise(self.problem, self.noise, self.outcome.z, held, max_steps)
        return moved, float(moved.cost - self.outcome.cost)


class _Acceptance(optx.ClassicalTrustRegion):
    """Takes a step, too, that neither promises nor makes more than rounding errors of the cost, so that searches end.

    The remedy of Conn, Gould and Toint (2000), Trust Region Methods, section 17.4.2. The next step is shorter: along a
    flat valley rounding errors would lead it ever farther.
    """

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        _, accept, result, new = super().step(first_step, y, y_eval, f_info, f_eval_info, state)
        cost = f_info.as_min()
        least = 10 * jnp.finfo(cost.dtype).eps * cost
        changes = self.predict_reduction(y_eval - y, f_info), f_eval_info.as_min() - cost
        noise = jnp.maximum(*map(jnp.abs, changes)) < least
        size = jnp.where(noise, self.low_constant * state.step_size, new.step_size)
        return size, accept | noise, result, eqx.tree_at(lambda state: state.step_size, new, size)


def minimise(
    problem: LeastSquaresProblem,
    noise: Deviations,
    z: np.ndarray | None = None,
    held: np.ndarray | None = None,
    max_steps: int = MAX_STEPS,
) -> Outcome:
    """Search for the minimum from z, or from the start of the problem.

    Args:
        noise: standard deviations, one array for each group of data.
        z: dimensionless unknowns.
        held: values at which parameters are held, NaN for those that are free; None for all free.
        max_steps: of the optimiser.
    """
    first = problem.space.first() if z is None else z
    held = np.full(len(first), np.nan) if held is None else held
    return _outcome(problem, _descend(problem, tuple(noise), first, held, max_steps, TOLERANCE))


def minimise_all(
    problem: LeastSquaresProblem,
    noise: Deviations,
    z: np.ndarray,
    held: np.ndarray | None = None,
    drawn: Redrawn | None = None,
    max_steps: int = MAX_STEPS,
) -> Outcome:
    """Many searches at once.

    Args:
        noise: as for `minimise`, or one each: with a leading axis.
        z: (searches, n), where they start.
        held: (searches, n), NaN for parameters that are free; None for all free.
        drawn: data instead of the problem's, each search its own.
        max_steps: of each.
    """

    def one_each(x: float | Numbers, like: float | Numbers) -> Numbers:
        return np.asarray(x) if np.ndim(x) > np.ndim(like) else np.broadcast_to(x, (len(z), *np.shape(x)))

    values, means, times = drawn or Redrawn()
    own = [prior.mean for prior in problem.prior.values()]
    data = Redrawn(
        tuple(map(one_each, values or problem.values, problem.values)),
        tuple(map(one_each, means or own, own)),
        times and tuple(map(one_each, times, problem.values)),
    )
    noise = tuple(map(one_each, noise, problem.values))
    held = np.full(z.shape, np.nan) if held is None else held
    return _outcome(problem, _descend_all(problem, data, noise, z, held, max_steps))


class _Reached(NamedTuple):
    """What a search found, on the device."""

    z: Float[Array, "*lanes n"]
    parameters: Float[Array, "*lanes n"]
    residual: Float[Array, "*lanes m"]
    slope: Float[Array, "*lanes m n"]  # of the residual by the parameters
    cost: Float[Array, "*lanes"]
    num_steps: ArrayLike
    solved: Bool[Array, "*lanes"] | bool


def _outcome(problem: LeastSquaresProblem, reached: _Reached) -> Outcome:
    """The same in this process, with the derivatives by the parameters over their size."""
    z, parameters, residual, slope, cost, num_steps, solved = map(np.asarray, jax.device_get(reached))
    size = problem.space.size(parameters)
    return Outcome(z, parameters, size, residual, slope * size[..., None, :], cost, num_steps, solved)


def evaluate(problem: LeastSquaresProblem, noise: Deviations, z: np.ndarray) -> Outcome:
    """Cost, residuals and derivatives at z, as of a search that ended there."""
    free = np.full(len(z), np.nan)
    residual, by_z = _residual_and_slope(problem, tuple(noise), free, z)
    parameters, stretch = jax.jvp(problem.space.parameters, (jnp.asarray(z),), (jnp.ones(len(z)),))
    cost = jnp.sum(problem.softened(residual) ** 2)
    return _outcome(problem, _Reached(jnp.asarray(z), parameters, residual, by_z / stretch, cost, 0, True))


def residuals_at(problem: LeastSquaresProblem, noise: Deviations, z: np.ndarray) -> np.ndarray:
    """The residuals at many places, (places, rows)."""
    return np.asarray(_residuals_at(problem, tuple(noise), z))


@eqx.filter_jit
def _residuals_at(problem: LeastSquaresProblem, noise: Deviations, z: Float[Numbers, "places n"]) -> Array:
    free = jnp.full(z.shape[1], jnp.nan)
    return jax.vmap(lambda z: problem.residual(z, noise, free))(z)


@eqx.filter_jit
def _residual_and_slope(
    problem: LeastSquaresProblem, noise: Deviations, held: Float[Numbers, " n"], z: Float[Numbers, " n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, noise, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@eqx.filter_jit
def _descend(
    problem: LeastSquaresProblem,
    noise: Deviations,
    z: Float[Numbers, " n"],
    held: Float[Numbers, " n"],
    max_steps: int,
    tolerance: float,
) -> _Reached:
    # Handed an explicit Jacobian, the optimiser need not differentiate the model for every product with it;
    # asked for in one place, it is traced once.
    @jax.custom_jvp
    def residual(z):
        return problem.softened(_residual_and_slope(problem, noise, held, z)[0])

    @residual.defjvp
    def _(primals, tangents):
        value, slope = _residual_and_slope(problem, noise, held, *primals)
        return jax.jvp(problem.softened, (value,), (slope @ tangents[0],))

    optimiser = eqx.tree_at(lambda o: o.search, optx.LevenbergMarquardt(tolerance, tolerance), _Acceptance())
    # The optimiser asks within and without `vmap`, which JAX takes for different contexts and would trace anew.
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ())):
        solution = optx.least_squares(
            lambda z, _: residual(z),
            optimiser,
            jnp.asarray(z),
            options={"jac": "fwd"},
            max_steps=max_steps,
            throw=False,
        )
        z = solution.value
        value, slope = _residual_and_slope(problem, noise, held, z)
    parameters, stretch = jax.jvp(lambda z: problem.parameters(z, held), (z,), (jnp.ones_like(z),))
    slope = slope / jnp.where(stretch == 0, 1.0, stretch)
    solved = solution.result == optx.RESULTS.successful
    cost = jnp.sum(problem.softened(value) ** 2)
    return _Reached(z, parameters, value, slope, cost, solution.stats["num_steps"], solved)


@eqx.filter_jit
def _descend_all(
    problem: LeastSquaresProblem,
    data: Redrawn,
    noise: Deviations,
    z: Float[Numbers, "searches n"],
    held: Float[Numbers, "searches n"],
    max_steps: int,
) -> _Reached:
    def one(data, noise, z, held):
        values, means, times = data
        pairs = zip(problem.prior.items(), means, strict=True)
        prior = {i: Prior(mean, known.standard_deviation) for (i, known), mean in pairs}
        there = replace(problem, values=values, prior=prior, times=times)
        return _descend(there, noise, z, held, max_steps, BATCH_TOLERANCE)

    return jax.vmap(one)(data, noise, z, held)
