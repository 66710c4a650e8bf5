"""`least_squares_fit`: any differentiable `predict(parameters)` against data; it knows no manipulator.

The optimiser sees dimensionless unknowns of order one. Noise that is not given is estimated, group by group.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .determination import Determination, Evidence, determine, spectrum_of, without_nan
from .errors import InputError
from .parameter_space import Prior, Space, bounds_of, names_of, priors_of

SUCCESSFUL = "successful"
NOISE_ROUNDS = 50
MODEL_PRECISION = 1e-8  # noise is never estimated below this times the data: the model is no better


@dataclass(frozen=True, kw_only=True)
class LeastSquaresFit(Determination):
    """The estimate from all data together, and how it was found."""

    noise: dict[str, float]  # standard deviation by group of data, root mean square
    noise_estimated: bool
    residuals: Any  # observed - predicted, in the structure of the data
    reduced_chi_square: float
    degrees_of_freedom: int
    num_steps: int
    success: bool
    result: str  # "successful", or what went wrong
    parameters: Any  # the estimate in the structure of `start`
    evidence: "Evidence"

    def told_by(self, *groups: str) -> Determination:
        """What some groups of the data alone, without priors, would determine, were this the truth."""
        return determine(self.evidence.of(groups))

    def band(self, sensitivity: np.ndarray) -> np.ndarray:
        """Half-width of the 95 % band of predictions with this derivative by the parameters (rows: predictions)."""
        variance = np.einsum("ki,ij,kj->k", sensitivity, self.covariance, sensitivity)
        return self.quantile * np.sqrt(np.maximum(variance, 0.0))


def least_squares_fit(
    predict: Callable[[Any], Any],
    start: Any,
    observed: Any,
    sigma: Any = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    *,
    priors: Mapping[str, tuple[float, float]] | None = None,
    max_steps: int = 500,
) -> LeastSquaresFit:
    """Fit parameters by Levenberg-Marquardt and say what the data determine.

    Args:
        predict: differentiable; from parameters in the structure of `start` to the structure of `observed`.
            A function or a pytree that is callable; given the same one again, nothing is compiled anew.
        start: first guess, a mapping from names to numbers, or any pytree of numbers or arrays.
        observed: data, one array or a pytree of arrays; each array is a group with its own noise.
        sigma: standard deviation of the noise: one number, or the structure of `observed` with a number, an
            array or None per group; None for a group, or altogether, has it estimated from the residuals.
        bounds: by parameter name, (lower, upper), None for none; the estimate stays inside.
        priors: by parameter name, mean and standard deviation of a Gaussian.
        max_steps: of the optimiser.

    Raises:
        InputError: for float32, a start outside its bounds, names that are none, data that are not finite.
    """
    _refuse_single_precision()
    flat, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), start))
    names = names_of(start)
    data = _grouped(observed, sigma)
    space = Space(np.asarray(flat), *bounds_of(names, np.asarray(flat), bounds or {}))
    prior = priors_of(names, priors or {})
    problem = _Problem(predict, unravel, data.values, space, prior)

    noise, settled = data.first_guess(), False
    outcome = _minimise(problem, noise, max_steps)
    for _ in range(NOISE_ROUNDS):  # weights from residuals, residuals from weights
        improved = data.estimate_noise(noise, outcome)
        settled = all(np.allclose(a, b, rtol=1e-4) for a, b in zip(noise, improved, strict=True))
        noise, outcome = improved, _minimise(problem, improved, max_steps)
        if settled:
            break
    return _conclude(names, unravel, space, prior, data, noise, outcome, settled)


def _refuse_single_precision() -> None:
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            'fits need double precision: call jax.config.update("jax_enable_x64", True) before anything else'
        )


# --- data -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Data:
    """Groups of observations, each with known or unknown noise."""

    names: tuple[str, ...]
    values: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray | None, ...]
    structure: Any

    @property
    def scale(self) -> list[float]:
        return [float(np.sqrt(np.mean(values**2))) or 1.0 for values in self.values]

    def first_guess(self) -> tuple[np.ndarray, ...]:
        guesses = zip(self.sigma, self.scale, self.values, strict=True)
        return tuple(np.broadcast_to(0.05 * c if s is None else s, v.shape) for s, c, v in guesses)

    def estimate_noise(self, noise: tuple[np.ndarray, ...], outcome: "_Outcome") -> tuple[np.ndarray, ...]:
        """From the residuals of each group, less the degrees of freedom that the fit took from it."""
        count = sum(v.size for v in self.values)
        jacobian = without_nan(outcome.jacobian)
        leverage = np.einsum("ki,ij,kj->k", jacobian, spectrum_of(jacobian).covariance, jacobian)[:count]
        improved, at = [], 0
        for values, sigma, old, scale in zip(self.values, self.sigma, noise, self.scale, strict=True):
            rows = slice(at, at := at + values.size)
            freedom = max(values.size - leverage[rows].sum(), 1e-3)
            spread = np.sqrt(np.sum((outcome.residual[rows] * old.ravel()) ** 2) / freedom)
            improved.append(old if sigma is not None else np.full(values.shape, max(spread, MODEL_PRECISION * scale)))
        return tuple(improved)


def _grouped(observed: Any, sigma: Any) -> _Data:
    leaves, structure = jax.tree_util.tree_flatten_with_path(observed)
    names = tuple(jax.tree_util.keystr(path, simple=True, separator=".") or "data" for path, _ in leaves)
    values = tuple(np.asarray(leaf, dtype=np.float64) for _, leaf in leaves)
    if not values or not any(v.size for v in values):
        raise InputError("there are no data to fit")
    for name, v in zip(names, values, strict=True):
        if not np.all(np.isfinite(v)):
            raise InputError(f"{name}: entry {int(np.argmin(np.isfinite(v.ravel())))} is not finite; leave it out")
    if isinstance(sigma, Mapping | list | tuple):
        sigmas = jax.tree.leaves(sigma, is_leaf=lambda x: x is None)
        if len(sigmas) != len(values):
            raise InputError(f"sigma has {len(sigmas)} entries for {len(values)} groups of data ({', '.join(names)})")
    else:
        sigmas = [sigma] * len(values)
    known = tuple(None if s is None else np.asarray(s, dtype=np.float64) for s in sigmas)
    for name, s in zip(names, known, strict=True):
        if s is not None and not np.all(s > 0):
            raise InputError(f"sigma of {name} must be > 0")
    return _Data(names, values, known, structure)


# --- the minimum ---------------------------------------------------------------------------------


class _Problem(eqx.Module):
    predict: Callable[[Any], Any]
    unravel: Callable[[Array], Any] = eqx.field(static=True)
    values: tuple[np.ndarray | Array, ...]
    space: Space
    prior: dict[int, Prior]

    def residual(self, z: Float[Array, " n"], noise: tuple[Any, ...]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors."""
        parameters = self.space.parameters(z)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        groups = zip(predicted, self.values, noise, strict=True)
        rows = [jnp.ravel((jnp.reshape(p, jnp.shape(v)) - v) / s) for p, v, s in groups]
        pulls = [(parameters[i] - prior.mean) / prior.standard_deviation for i, prior in self.prior.items()]
        return jnp.concatenate([*rows, jnp.stack(pulls)] if pulls else rows)


class _Outcome(NamedTuple):
    parameters: np.ndarray
    size: np.ndarray  # of each parameter, its unit below
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    num_steps: int
    solved: bool


def _minimise(problem: _Problem, noise: tuple[np.ndarray, ...], max_steps: int) -> _Outcome:
    parameters, residual, slope, steps, solved = jax.device_get(_levenberg_marquardt(problem, noise, max_steps))
    size = problem.space.size(parameters)
    return _Outcome(parameters, size, residual, slope * size, int(steps), bool(solved))


@eqx.filter_jit
def _residual_and_slope(problem: _Problem, noise: tuple[np.ndarray, ...], z: Float[Array, " n"]):
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, noise), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@eqx.filter_jit
def _levenberg_marquardt(problem: _Problem, noise: tuple[np.ndarray, ...], max_steps: int):
    # Handed an explicit Jacobian, the optimiser need not differentiate the model for every product with it;
    # asked for in one place, it is traced once.
    @jax.custom_jvp
    def residual(z):
        return _residual_and_slope(problem, noise, z)[0]

    @residual.defjvp
    def _(primals, tangents):
        value, slope = _residual_and_slope(problem, noise, *primals)
        return value, slope @ tangents[0]

    solution = optx.least_squares(
        lambda z, _: residual(z),
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        problem.space.first(),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    parameters, stretch = jax.jvp(problem.space.parameters, (solution.value,), (jnp.ones_like(solution.value),))
    value, slope = _residual_and_slope(problem, noise, solution.value)
    slope = slope / jnp.where(stretch == 0, 1.0, stretch)
    return parameters, value, slope, solution.stats["num_steps"], solution.result == optx.RESULTS.successful


# --- the conclusion -------------------------------------------------------------------------------


def _verdict(outcome: _Outcome) -> str:
    if not np.all(np.isfinite(outcome.residual)) or not np.all(np.isfinite(outcome.jacobian)):
        return "the model gave no number at the estimate; start closer, or leave out data beyond its reach"
    column, total = np.linalg.norm(outcome.jacobian, axis=0), np.linalg.norm(outcome.residual)
    slope = np.abs(outcome.jacobian.T @ outcome.residual) / np.maximum(column * total, 1e-300)
    exact = total <= 1e-6 * np.sqrt(outcome.residual.size)
    if not exact and np.any(slope > (1e-4 if outcome.solved else 1e-6)):
        return "the optimiser stopped short of a minimum; start closer, or allow more steps"
    return SUCCESSFUL


def _conclude(
    names, unravel, space: Space, prior, data: _Data, noise, outcome: _Outcome, settled: bool
) -> LeastSquaresFit:
    cuts = np.cumsum([v.size for v in data.values])
    *rows, prior_rows = np.split(outcome.jacobian, cuts)
    *residuals, _ = np.split(outcome.residual, cuts)
    estimated = {name: sigma is None for name, sigma in zip(data.names, data.sigma, strict=True)}
    evidence = Evidence(
        names=names,
        start=np.asarray(space.start),
        lower=np.asarray(space.lower),
        upper=np.asarray(space.upper),
        value=outcome.parameters,
        size=outcome.size,
        at_bound=space.at_bound(outcome.parameters),
        rows=dict(zip(data.names, rows, strict=True)),
        prior_rows={i: row[None] for i, row in zip(prior, prior_rows, strict=True)},
        noise_estimated=estimated,
    )
    determined = determine(evidence)
    freedom = outcome.residual.size - determined.rank
    result = _verdict(outcome) if settled else "the noise estimates did not settle; give the noise of some data"
    observed_less_predicted = [-r.reshape(v.shape) * s for r, s, v in zip(residuals, noise, data.values, strict=True)]
    return LeastSquaresFit(
        **vars(determined),
        noise={name: float(np.sqrt(np.mean(s**2))) for name, s in zip(data.names, noise, strict=True)},
        noise_estimated=any(estimated.values()),
        residuals=jax.tree_util.tree_unflatten(data.structure, observed_less_predicted),
        reduced_chi_square=float(np.sum(outcome.residual**2) / max(freedom, 1)),
        degrees_of_freedom=freedom,
        num_steps=outcome.num_steps,
        success=result == SUCCESSFUL,
        result=result,
        parameters=jax.tree.map(np.asarray, unravel(jnp.asarray(outcome.parameters))),
        evidence=evidence,
    )
