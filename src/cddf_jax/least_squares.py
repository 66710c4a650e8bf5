"""The statistics of a fit: any differentiable `predict(parameters)` against data; it knows no manipulator.

The optimiser sees dimensionless unknowns of order one; bounds are a change of variable. Everything that
is said about the estimate comes from the thin SVD of the Jacobian scaled by noise and parameter size.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float
from scipy.special import ndtri, stdtrit

from .errors import InputError

IDENTIFIED, NOT_IDENTIFIED, PRIOR_ONLY, AT_BOUND, FIXED = (
    "identified",
    "not identified",
    "prior only",
    "at bound",
    "fixed",
)
SUCCESSFUL = "successful"
NOISE_ROUNDS = 50
RELATIVE_RANK = 1e-9  # singular values below this times the largest are zero
LARGEST_RELATIVE_ERROR = 0.5  # of a parameter that is called identified
MODEL_PRECISION = 1e-8  # noise is never estimated below this times the data: the model is no better


class Prior(NamedTuple):
    """A Gaussian prior."""

    mean: Any
    standard_deviation: Any


class Estimate(NamedTuple):
    value: float
    standard_error: float


@dataclass(frozen=True, kw_only=True)
class Determination:
    """What some data determine about the parameters. Dictionaries go by name, arrays by the order of `names`."""

    names: tuple[str, ...]
    value: dict[str, float]
    standard_error: dict[str, float]  # inf where the data do not determine the parameter
    confidence_interval: dict[str, tuple[float, float]]  # 95 %, t-statistics where noise was estimated
    status: dict[str, str]
    combinations: dict[str, Estimate]  # what is identified of the parameters that are not
    covariance: np.ndarray  # of the directions that the data determine
    correlation: np.ndarray
    singular_values: np.ndarray  # of the Jacobian scaled by noise and size of the parameters
    rank: int
    condition_number: float
    sloppy_direction: dict[str, float]  # powers of the parameters in the least determined combination
    quantile: float  # half-width of a 95 % interval over its standard error


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
    evidence: "_Evidence"

    def told_by(self, *groups: str) -> Determination:
        """What some groups of the data alone, without priors, would determine, were this the truth."""
        return _determine(self.evidence.of(groups))

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
    names = _names_of(start)
    data = _grouped(observed, sigma)
    space = _Space(np.asarray(flat), *_bounds_of(names, np.asarray(flat), bounds or {}))
    prior = _priors_of(names, priors or {})
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


# --- parameters and data -------------------------------------------------------------------------


def _refuse_single_precision() -> None:
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            'fits need double precision: call jax.config.update("jax_enable_x64", True) before anything else'
        )


def _names_of(start: Any) -> tuple[str, ...]:
    """One name per number: the key of a mapping, with an index where the value is an array."""
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(start)[0]:
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        indices = np.ndindex(np.shape(leaf))
        names += [name + "".join(f"[{i}]" for i in index) for index in indices]
    return tuple(names)


def _known(kind: str, names: tuple[str, ...], given: Mapping[str, Any]) -> None:
    for name in given:
        if name not in names:
            raise InputError(f"{kind} for {name!r}, which is not fitted; fitted are {', '.join(names)}")


def _bounds_of(names: tuple[str, ...], start: np.ndarray, bounds: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    _known("bounds", names, bounds)
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for i, name in enumerate(names):
        low, high = bounds.get(name, (None, None))
        lower[i], upper[i] = -np.inf if low is None else low, np.inf if high is None else high
        if not lower[i] < start[i] < upper[i]:
            raise InputError(
                f"{name} starts at {start[i]:g}, which is not inside its bounds {lower[i]:g} to {upper[i]:g}; "
                "move the start or the bounds"
            )
    return lower, upper


def _priors_of(names: tuple[str, ...], priors: Mapping[str, tuple[float, float]]) -> dict[int, Prior]:
    _known("prior", names, priors)
    for name, (mean, deviation) in priors.items():
        if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
            raise InputError(f"prior for {name}: needs a mean and a standard deviation > 0, got {mean}, {deviation}")
    return {names.index(name): Prior(*map(np.float64, prior)) for name, prior in priors.items()}


class _Space(eqx.Module):
    """The change of variable from dimensionless, unbounded z to the parameters."""

    start: Float[np.ndarray | Array, " n"]
    lower: Float[np.ndarray | Array, " n"]
    upper: Float[np.ndarray | Array, " n"]
    kinds: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, start: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self.start, self.lower, self.upper = start, lower, upper
        finite = zip(np.isfinite(lower), np.isfinite(upper), strict=True)
        self.kinds = tuple(("free", "below", "above", "between")[2 * int(a) + int(b)] for a, b in finite)

    def size(self, value: np.ndarray) -> np.ndarray:
        """What to measure each parameter by: its value, its start or 1, the first that is not 0."""
        start = np.abs(np.asarray(self.start))
        return np.where(value == 0, np.where(start == 0, 1.0, start), np.abs(value))

    def first(self) -> Float[Array, " n"]:
        def inverse(kind, start, lower, upper):
            return np.log((start - lower) / (upper - start)) if kind == "between" else 0.0

        return jnp.asarray(
            [inverse(*args) for args in zip(self.kinds, self.start, self.lower, self.upper, strict=True)]
        )

    def parameters(self, z: Float[Array, " n"]) -> Float[Array, " n"]:
        def one(i, kind):
            if kind == "free":
                return self.start[i] + jnp.where(self.start[i] == 0, 1.0, jnp.abs(self.start[i])) * z[i]
            if kind == "above":  # bounded below
                return self.lower[i] + (self.start[i] - self.lower[i]) * jnp.exp(z[i])
            if kind == "below":  # bounded above
                return self.upper[i] - (self.upper[i] - self.start[i]) * jnp.exp(z[i])
            return self.lower[i] + (self.upper[i] - self.lower[i]) * jax.nn.sigmoid(z[i])

        return jnp.stack([one(i, kind) for i, kind in enumerate(self.kinds)])

    def at_bound(self, value: np.ndarray) -> np.ndarray:
        """Whether the optimiser pushed a parameter against a bound."""
        width = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, self.size(value))
        return np.minimum(value - self.lower, self.upper - value) < 1e-5 * width


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
        jacobian = _without_nan(outcome.jacobian)
        leverage = np.einsum("ki,ij,kj->k", jacobian, _spectrum(jacobian).covariance, jacobian)[:count]
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
    space: _Space
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


# --- what it tells -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Evidence:
    """The rows of the scaled Jacobian at an estimate, by group of data."""

    names: tuple[str, ...]
    space: _Space
    value: np.ndarray
    size: np.ndarray
    rows: dict[str, np.ndarray]  # by group, (rows, parameters)
    prior_rows: dict[int, np.ndarray]  # by parameter
    noise_estimated: dict[str, bool]

    def of(self, groups: tuple[str, ...]) -> "_Evidence":
        rows = {name: self.rows[name] for name in groups}
        estimated = {name: self.noise_estimated[name] for name in groups}
        return replace(self, rows=rows, prior_rows={}, noise_estimated=estimated)

    @property
    def jacobian(self) -> np.ndarray:
        return _without_nan(np.concatenate([*self.rows.values(), *self.prior_rows.values()]))


def _without_nan(matrix: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(matrix), matrix, 0.0)


class _Spectrum(NamedTuple):
    """The thin SVD of a scaled Jacobian."""

    values: np.ndarray
    directions: np.ndarray  # rows
    determined: np.ndarray  # which are not zero
    covariance: np.ndarray  # relative, of the determined directions
    relative_error: np.ndarray  # of each parameter, inf where a direction that is not determined holds it


def _spectrum(jacobian: np.ndarray) -> _Spectrum:
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    determined = values > RELATIVE_RANK * max(values.max(initial=0.0), 1e-300)
    scaled = directions[determined] / values[determined, None]
    covariance = scaled.T @ scaled
    reached = np.sum(directions[determined] ** 2, axis=0)  # 1 for a parameter within the determined directions
    error = np.where(reached < 1 - 1e-12, np.inf, np.sqrt(np.diag(covariance)))
    return _Spectrum(values, directions, determined, covariance, error)


def _determine(evidence: _Evidence) -> Determination:
    names, space, value, size = evidence.names, evidence.space, evidence.value, evidence.size
    jacobian = evidence.jacobian
    spectrum = _spectrum(jacobian)
    rank = int(spectrum.determined.sum())
    freedom = jacobian.shape[0] - rank
    error = spectrum.relative_error * size
    quantile = float(ndtri(0.975))
    if any(evidence.noise_estimated.values()):
        quantile = float(stdtrit(max(freedom, 1), 0.975))
        error = error if freedom > 0 else np.full_like(error, np.inf)  # no data left to tell the noise

    status = _statuses(evidence, error, quantile)
    lost = np.array([word == NOT_IDENTIFIED for word in status])
    open_ended = lost | np.array([word == AT_BOUND for word in status])
    low, high = value - quantile * error, value + quantile * error
    low, high = np.where(open_ended, space.lower, low), np.where(open_ended, space.upper, high)
    spread = np.sqrt(np.diag(spectrum.covariance))
    sloppy = spectrum.directions[-1] / max(np.abs(spectrum.directions[-1]).max(), 1e-300)

    def by_name(values: Any) -> dict[str, Any]:
        return dict(zip(names, values, strict=True))

    return Determination(
        names=names,
        value=by_name(value.tolist()),
        standard_error=by_name(np.where(open_ended, np.inf, error).tolist()),
        confidence_interval=by_name(zip(low.tolist(), high.tolist(), strict=True)),
        status=by_name(status),
        combinations=_combinations(names, value, lost, spectrum),
        covariance=spectrum.covariance * np.outer(size, size),
        correlation=spectrum.covariance / np.maximum(np.outer(spread, spread), 1e-300),
        singular_values=spectrum.values,
        rank=rank,
        condition_number=float(spectrum.values[0] / spectrum.values[-1]) if rank == len(names) else np.inf,
        sloppy_direction=by_name(sloppy.tolist()),
        quantile=quantile,
    )


def _statuses(evidence: _Evidence, error: np.ndarray, quantile: float) -> list[str]:
    """By the rule: an interval that closes inside the bounds, and a relative standard error below 0.5."""
    space, value = evidence.space, evidence.value
    at_bound = space.at_bound(value)
    start = np.where(np.isfinite(space.lower), 0.0, np.abs(space.start))  # what may be 0 is measured by its start too
    known = error < LARGEST_RELATIVE_ERROR * np.maximum(evidence.size, start)
    closed = (value - quantile * error > space.lower) & (value + quantile * error < space.upper)
    data_error = _spectrum(_without_nan(np.concatenate([*evidence.rows.values()]))).relative_error * evidence.size
    result = []
    for i in range(len(value)):
        prior_row = evidence.prior_rows.get(i)
        # alone the data say nothing, and together they leave the prior as wide as it was
        prior_only = (
            prior_row is not None
            and not data_error[i] < np.inf
            and error[i] * np.abs(prior_row[0, i]) > 0.98 * evidence.size[i]
        )
        if at_bound[i]:
            result.append(AT_BOUND)
        elif prior_only:
            result.append(PRIOR_ONLY)
        else:
            result.append(IDENTIFIED if known[i] and closed[i] else NOT_IDENTIFIED)
    return result


def _combinations(
    names: tuple[str, ...], value: np.ndarray, lost: np.ndarray, spectrum: _Spectrum
) -> dict[str, Estimate]:
    """Products of powers of the unidentified parameters that the data do determine."""
    found = {}
    if np.count_nonzero(lost) < 2 or np.any(value[lost] <= 0):
        return found
    for singular, direction in zip(spectrum.values, spectrum.directions, strict=True):
        within = np.where(lost, direction, 0.0)
        if singular * LARGEST_RELATIVE_ERROR <= 1 or np.linalg.norm(within) < 0.99:
            continue  # not known well enough, or not of these parameters
        first = min((i for i in range(len(names)) if abs(within[i]) > 0.02), key=lambda i: names[i])
        powers = within * np.sign(within[first]) / np.abs(within).max()  # the first in the alphabet stands above
        whole = np.round(powers)
        powers = np.where(np.abs(powers - whole) < 0.02, whole, np.round(powers, 2))
        product = float(np.exp(np.sum(powers[lost] * np.log(value[lost]))))
        along = spectrum.directions[spectrum.determined] @ powers / spectrum.values[spectrum.determined]
        found[_product_name(names, powers)] = Estimate(product, product * float(np.linalg.norm(along)))
    return found


def _product_name(names: tuple[str, ...], powers: np.ndarray) -> str:
    """For example `friction_coefficient / youngs_modulus`."""

    def factor(name: str, power: float) -> str:
        return name if power == 1 else f"{name}^{power:g}"

    above = [factor(n, p) for n, p in zip(names, powers, strict=True) if p > 0]
    below = [factor(n, -p) for n, p in zip(names, powers, strict=True) if p < 0]
    return " * ".join(above or ["1"]) + "".join(f" / {name}" for name in below)


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
    names, unravel, space: _Space, prior, data: _Data, noise, outcome: _Outcome, settled: bool
) -> LeastSquaresFit:
    cuts = np.cumsum([v.size for v in data.values])
    *rows, prior_rows = np.split(outcome.jacobian, cuts)
    *residuals, _ = np.split(outcome.residual, cuts)
    estimated = {name: sigma is None for name, sigma in zip(data.names, data.sigma, strict=True)}
    evidence = _Evidence(
        names,
        space,
        outcome.parameters,
        outcome.size,
        dict(zip(data.names, rows, strict=True)),
        {i: row[None] for i, row in zip(prior, prior_rows, strict=True)},
        estimated,
    )
    determined = _determine(evidence)
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
