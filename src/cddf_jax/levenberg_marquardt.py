"""The minimum of a sum of squares, by optimistix's Levenberg-Marquardt over dimensionless unknowns."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .errors import InputError
from .parameter_space import Prior, Space
from .robust_loss import LOSSES, Loss

TOLERANCE = 1e-9  # relative, of unknowns and cost; tighter, and rounding errors of the cost would decide on steps
BATCH_TOLERANCE = 1e-6  # of a lane of many: far below any standard error


class LeastSquaresProblem(eqx.Module):
    """A model, its data, and what is known of its parameters."""

    predict: Callable[[Any], Any]
    unravel: Callable[[Array], Any] = eqx.field(static=True)
    values: tuple[np.ndarray | Array, ...]
    space: Space
    prior: dict[int, Prior]
    loss: str = eqx.field(static=True, default="linear")

    def residual(self, z: Float[Array, " n"], noise: tuple[Any, ...], held: Float[Array, " n"]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors."""
        parameters = self.parameters(z, held)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        sizes = [jnp.size(p) for p in predicted], [np.size(v) for v in self.values]
        if sizes[0] != sizes[1]:
            raise InputError(f"predict gives arrays of {sizes[0]} numbers where the data have {sizes[1]}")
        groups = zip(predicted, self.values, noise, strict=True)
        rows = [jnp.ravel((jnp.reshape(p, jnp.shape(v)) - v) / s) for p, v, s in groups]
        pulls = [(parameters[i] - prior.mean) / prior.standard_deviation for i, prior in self.prior.items()]
        return jnp.concatenate([*rows, jnp.stack(pulls)] if pulls else rows)

    def parameters(self, z: Float[Array, " n"], held: Float[Array, " n"]) -> Float[Array, " n"]:
        return jnp.where(jnp.isnan(held), self.space.parameters(z), held)

    @property
    def num_data(self) -> int:
        """Without the rows of the priors, which no loss softens."""
        return sum(int(np.prod(np.shape(v))) for v in self.values)

    def softened(self, residual: Float[Array, " m"]) -> Float[Array, " m"]:
        """What to square and sum."""
        if self.loss == "linear":
            return residual
        data, prior = jnp.split(residual, [self.num_data])
        return jnp.concatenate([LOSSES[self.loss].transformed(data), prior])

    def influence(self, residual: np.ndarray) -> np.ndarray:
        """Half the derivative of the cost by each residual."""
        kind: Loss = LOSSES[self.loss]
        return np.append(kind.influence(residual[: self.num_data]), residual[self.num_data :])


class Outcome(NamedTuple):
    """Where the optimiser stopped; of many searches at once all with one leading axis."""

    z: np.ndarray
    parameters: np.ndarray
    size: np.ndarray  # of each parameter, its unit below
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    cost: Any  # the sum of squares, or of the loss
    num_steps: Any
    solved: Any


class Search(NamedTuple):
    """What a fit ended with, for all that looks around it."""

    problem: LeastSquaresProblem
    noise: tuple[np.ndarray, ...]  # standard deviations, one array for each group of data
    outcome: Outcome


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


class _LevenbergMarquardt(optx.LevenbergMarquardt):
    """That of optimistix with this acceptance."""

    def __init__(self, tolerance: float):
        super().__init__(rtol=tolerance, atol=tolerance)
        self.search = _Acceptance()


def minimise(
    problem: LeastSquaresProblem,
    noise: tuple[np.ndarray, ...],
    z: np.ndarray | None = None,
    held: np.ndarray | None = None,
    max_steps: int = 500,
) -> Outcome:
    """Go downhill from z, or from the start of the problem.

    Args:
        noise: standard deviations, one array for each group of data.
        z: dimensionless unknowns.
        held: values at which parameters are held, NaN for those that are free; None for all free.
        max_steps: of the optimiser.
    """
    first = problem.space.first() if z is None else z
    held = np.full(len(first), np.nan) if held is None else held
    return _outcome(problem, _descend(problem, noise, first, held, max_steps, TOLERANCE))


def minimise_all(
    problem: LeastSquaresProblem,
    noise: tuple[np.ndarray, ...],
    z: np.ndarray,
    held: np.ndarray | None = None,
    values: tuple[np.ndarray, ...] | None = None,
    max_steps: int = 500,
) -> Outcome:
    """Many searches at once.

    Args:
        noise: as for `minimise`, or one each: with a leading axis.
        z: (searches, n), where they start.
        held: (searches, n), NaN for parameters that are free; None for all free.
        values: data instead of the problem's, each search its own.
        max_steps: of each.
    """

    def one_each(x, like):
        return x if np.ndim(x) > np.ndim(like) else np.broadcast_to(x, (len(z), *np.shape(x)))

    own = tuple(map(one_each, problem.values if values is None else values, problem.values))
    noise = tuple(map(one_each, noise, problem.values))
    held = np.full(z.shape, np.nan) if held is None else held
    return _outcome(problem, _descend_all(problem, own, noise, z, held, max_steps))


def _in_one(z: Any, parameters: Any, cost: Any, num_steps: Any, solved: Any, residual: Any, slope: Any) -> Array:
    """One array, which leaves the device in less time than seven."""
    numbers = jnp.stack([cost, num_steps, solved]).astype(residual.dtype)
    return jnp.concatenate([z, parameters, numbers, residual, slope.ravel()])


def _outcome(problem: LeastSquaresProblem, in_one: Array) -> Outcome:
    """What `_in_one` put together, of one search or with a leading axis of many."""
    n, answer = problem.space.num_parameters, np.asarray(in_one)
    end = (answer.shape[-1] + n * (2 * n + 3)) // (n + 1)  # of the residuals
    z, parameters, residual = answer[..., :n], answer[..., n : 2 * n], answer[..., 2 * n + 3 : end]
    cost, steps, solved = (answer[..., 2 * n + k] for k in range(3))
    size = problem.space.size(parameters)
    jacobian = answer[..., end:].reshape(*residual.shape, n) * size[..., None, :]
    return Outcome(z, parameters, size, residual, jacobian, cost, steps.astype(int), solved > 0)


def evaluate(problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], z: np.ndarray) -> Outcome:
    """The outcome of standing still at z."""
    free = np.full(len(z), np.nan)
    residual, by_z = _residual_and_slope(problem, noise, free, z)
    parameters, stretch = jax.jvp(problem.space.parameters, (jnp.asarray(z),), (jnp.ones(len(z)),))
    cost = jnp.sum(problem.softened(residual) ** 2)
    return _outcome(problem, _in_one(jnp.asarray(z), parameters, cost, 0, True, residual, by_z / stretch))


def residuals_at(problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], z: np.ndarray) -> np.ndarray:
    """The residuals at many places, (places, rows)."""
    return np.asarray(_residuals_at(problem, noise, z))


@eqx.filter_jit
def _residuals_at(problem: LeastSquaresProblem, noise: tuple[Any, ...], z: Any):
    free = jnp.full(z.shape[1], jnp.nan)
    return jax.vmap(lambda z: problem.residual(z, noise, free))(z)


@eqx.filter_jit
def _residual_and_slope(problem: LeastSquaresProblem, noise: tuple[Any, ...], held: Any, z: Any):
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, noise, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@eqx.filter_jit
def _descend(problem: LeastSquaresProblem, noise: tuple[Any, ...], z: Any, held: Any, max_steps: int, tolerance: float):
    # Handed an explicit Jacobian, the optimiser need not differentiate the model for every product with it;
    # asked for in one place, it is traced once.
    @jax.custom_jvp
    def residual(z):
        return problem.softened(_residual_and_slope(problem, noise, held, z)[0])

    @residual.defjvp
    def _(primals, tangents):
        value, slope = _residual_and_slope(problem, noise, held, *primals)
        return jax.jvp(problem.softened, (value,), (slope @ tangents[0],))

    # The optimiser asks within and without `vmap`, which JAX takes for different contexts and would trace anew.
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ())):
        solution = optx.least_squares(
            lambda z, _: residual(z),
            _LevenbergMarquardt(tolerance),
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
    return _in_one(z, parameters, cost, solution.stats["num_steps"], solved, value, slope)


@eqx.filter_jit
def _descend_all(problem: LeastSquaresProblem, values: Any, noise: Any, z: Any, held: Any, max_steps: int):
    def one(values, noise, z, held):
        there = eqx.tree_at(lambda problem: problem.values, problem, values)
        return _descend(there, noise, z, held, max_steps, BATCH_TOLERANCE)

    return jax.vmap(one)(values, noise, z, held)
