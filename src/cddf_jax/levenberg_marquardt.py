"""The minimum of a sum of squares, by optimistix's Levenberg-Marquardt over dimensionless unknowns."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .parameter_space import Prior, Space


class LeastSquaresProblem(eqx.Module):
    """A model, its data, and what is known of its parameters."""

    predict: Callable[[Any], Any]
    unravel: Callable[[Array], Any] = eqx.field(static=True)
    values: tuple[np.ndarray | Array, ...]
    space: Space
    prior: dict[int, Prior]

    def residual(self, z: Float[Array, " n"], noise: tuple[Any, ...], held: Float[Array, " n"]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors."""
        parameters = self.parameters(z, held)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        groups = zip(predicted, self.values, noise, strict=True)
        rows = [jnp.ravel((jnp.reshape(p, jnp.shape(v)) - v) / s) for p, v, s in groups]
        pulls = [(parameters[i] - prior.mean) / prior.standard_deviation for i, prior in self.prior.items()]
        return jnp.concatenate([*rows, jnp.stack(pulls)] if pulls else rows)

    def parameters(self, z: Float[Array, " n"], held: Float[Array, " n"]) -> Float[Array, " n"]:
        return jnp.where(jnp.isnan(held), self.space.parameters(z), held)


class Outcome(NamedTuple):
    """Where the optimiser stopped."""

    z: np.ndarray
    parameters: np.ndarray
    size: np.ndarray  # of each parameter, its unit below
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    num_steps: int
    solved: bool


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
    first = np.asarray(problem.space.first()) if z is None else z
    held = np.full(len(first), np.nan) if held is None else held
    end, parameters, residual, slope, steps, solved = jax.device_get(_descend(problem, noise, first, held, max_steps))
    size = problem.space.size(parameters)
    return Outcome(end, parameters, size, residual, slope * size, int(steps), bool(solved))


def evaluate(problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], z: np.ndarray) -> Outcome:
    """The outcome of standing still at z."""
    free = np.full(len(z), np.nan)
    residual, by_z = jax.device_get(_residual_and_slope(problem, noise, free, z))
    parameters, stretch = jax.jvp(problem.space.parameters, (jnp.asarray(z),), (jnp.ones(len(z)),))
    parameters = np.asarray(parameters)
    size = problem.space.size(parameters)
    return Outcome(z, parameters, size, residual, by_z / np.asarray(stretch) * size, 0, True)


@eqx.filter_jit
def _residual_and_slope(problem: LeastSquaresProblem, noise: tuple[Any, ...], held: Any, z: Any):
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, noise, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@eqx.filter_jit
def _descend(problem: LeastSquaresProblem, noise: tuple[Any, ...], z: Any, held: Any, max_steps: int):
    # Handed an explicit Jacobian, the optimiser need not differentiate the model for every product with it;
    # asked for in one place, it is traced once.
    @jax.custom_jvp
    def residual(z):
        return _residual_and_slope(problem, noise, held, z)[0]

    @residual.defjvp
    def _(primals, tangents):
        value, slope = _residual_and_slope(problem, noise, held, *primals)
        return value, slope @ tangents[0]

    solution = optx.least_squares(
        lambda z, _: residual(z),
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        jnp.asarray(z),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    z = solution.value
    parameters, stretch = jax.jvp(lambda z: problem.parameters(z, held), (z,), (jnp.ones_like(z),))
    value, slope = _residual_and_slope(problem, noise, held, z)
    slope = slope / jnp.where(stretch == 0, 1.0, stretch)
    solved = solution.result == optx.RESULTS.successful
    return z, parameters, value, slope, solution.stats["num_steps"], solved


def chi_square(outcome: Outcome) -> float:
    """The sum of squares at an outcome."""
    return float(np.sum(outcome.residual**2))
