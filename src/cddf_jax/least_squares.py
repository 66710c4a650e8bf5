"""`least_squares_fit`: any differentiable `predict(parameters)` against data; it knows no manipulator.

The optimiser sees dimensionless unknowns of order one. Noise that is not given is estimated, group by group.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np

from .determination import IDENTIFIED, Determination, Evidence, determine, spectrum_of, without_nan
from .errors import InputError
from .levenberg_marquardt import LeastSquaresProblem, Outcome, chi_square, evaluate, minimise
from .parameter_space import Space, bounds_of, names_of, priors_of

SUCCESSFUL = "successful"
NOISE_ROUNDS = 50
CLOSING_RISE = 2.0  # of the sum of squares, times that at the end of a 95 % interval
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
    if not jax.tree.leaves(start):
        raise InputError("there is no parameter to fit")
    flat, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), start))
    names = names_of(start)
    data = _grouped(observed, sigma)
    space = Space(np.asarray(flat), *bounds_of(names, np.asarray(flat), bounds or {}))
    prior = priors_of(names, priors or {})
    problem = LeastSquaresProblem(predict, unravel, data.values, space, prior)

    noise, settled = data.first_guess(), False
    outcome = minimise(problem, noise, max_steps=max_steps)
    for _ in range(NOISE_ROUNDS):  # weights from residuals, residuals from weights
        improved = data.estimate_noise(noise, outcome)
        settled = all(np.allclose(a, b, rtol=1e-4) for a, b in zip(noise, improved, strict=True))
        noise, outcome = improved, minimise(problem, improved, outcome.z, max_steps=max_steps)
        if settled or not np.all(np.isfinite(outcome.residual)):
            break

    evidence = _evidence(names, space, prior, data, outcome)
    told = determine(evidence)
    profiles = _profiles(problem, noise, outcome, told, max_steps)
    result = _verdict(outcome, evidence, settled, profiles)
    if np.any(profiles.open):
        outcome = _nearest_to_start(problem, noise, outcome, profiles.open, told.quantile, max_steps)
        evidence = _evidence(names, space, prior, data, outcome)
    doubtful = profiles.open | (result != SUCCESSFUL)  # a failed fit has identified nothing
    return _conclude(replace(evidence, open_profile=doubtful), unravel, data, noise, outcome, result)


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

    def estimate_noise(self, noise: tuple[np.ndarray, ...], outcome: "Outcome") -> tuple[np.ndarray, ...]:
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
    sigmas = _per_group(sigma, names, observed)
    known = tuple(None if s is None else np.asarray(s, dtype=np.float64) for s in sigmas)
    for name, s, v in zip(names, known, values, strict=True):
        if s is not None and not np.all(s > 0):
            raise InputError(f"sigma of {name} must be > 0")
        if s is not None and s.shape not in ((), v.shape):
            raise InputError(f"sigma of {name} must be one number or of shape {v.shape} like the data, got {s.shape}")
    return _Data(names, values, known, structure)


def _per_group(sigma: Any, names: tuple[str, ...], observed: Any) -> list[Any]:
    """The given sigma of each group, None where it is not known."""
    if isinstance(observed, Mapping) and isinstance(sigma, Mapping):
        for name in sigma:
            if name not in names:
                raise InputError(
                    f"sigma is given for {name!r}, which is no group of data; there are {', '.join(names)}"
                )
        return [sigma.get(name) for name in names]
    if isinstance(sigma, Mapping | list | tuple):
        sigmas = jax.tree.leaves(sigma, is_leaf=lambda x: x is None)
        if len(sigmas) != len(names):
            raise InputError(f"sigma has {len(sigmas)} entries for {len(names)} groups of data ({', '.join(names)})")
        return sigmas
    return [sigma] * len(names)


# --- the conclusion -------------------------------------------------------------------------------


def _evidence(names, space: Space, prior, data: _Data, outcome: Outcome) -> Evidence:
    """The scaled Jacobian by groups; none of it where the model gave no number."""
    finite = np.all(np.isfinite(outcome.residual))
    jacobian = without_nan(outcome.jacobian) if finite else np.zeros_like(outcome.jacobian)
    *rows, prior_rows = np.split(jacobian, np.cumsum([v.size for v in data.values]))
    return Evidence(
        names=names,
        start=np.asarray(space.start),
        lower=np.asarray(space.lower),
        upper=np.asarray(space.upper),
        value=outcome.parameters,
        size=outcome.size,
        at_bound=space.at_bound(outcome.parameters),
        open_profile=np.zeros(len(names), bool),
        rows=dict(zip(data.names, rows, strict=True)),
        prior_rows={i: row[None] for i, row in zip(prior, prior_rows, strict=True)},
        noise_estimated={name: sigma is None for name, sigma in zip(data.names, data.sigma, strict=True)},
    )


class _Profiles(NamedTuple):
    open: np.ndarray  # by parameter: whether its 95 % interval is open on a side, for all that was tried
    least_rise: float  # of the sum of squares, over all that was tried


def _profiles(problem: LeastSquaresProblem, noise, outcome: Outcome, told: Determination, max_steps: int) -> _Profiles:
    """Hold each parameter that looks identified at values ever farther off and fit the others again.

    The curvature at a minimum can feign an interval where the valley is flat beyond. A side is closed where
    the sum of squares has risen by twice what ends a 95 % interval.
    """
    opened, least = np.zeros(len(told.names), bool), 0.0

    def closed(i: int, error: float, places: list[float]) -> bool:
        nonlocal least
        for place in places:
            held = np.where(np.arange(len(opened)) == i, place, np.nan)
            rise = chi_square(minimise(problem, noise, outcome.z, held, max_steps)) - chi_square(outcome)
            least = min(least, rise) if np.isfinite(rise) else least
            expected = ((place - outcome.parameters[i]) / error) ** 2
            if not rise <= min(CLOSING_RISE * told.quantile**2, 0.5 * expected):  # NaN: the model ends there
                return True
        return False

    for i, name in enumerate(told.names):
        if told.status[name] == IDENTIFIED:
            error = told.standard_error[name]
            sides = _sides(problem.space, i, told.value[name], told.quantile * error)
            opened[i] = not all(closed(i, error, places) for places in sides)
    return _Profiles(opened, least)


def _nearest_to_start(
    problem: LeastSquaresProblem, noise, outcome: Outcome, opened: np.ndarray, quantile: float, max_steps: int
) -> Outcome:
    """Along an open valley any place will do: the one at the start of the first open parameter, if it fits."""
    i, first = int(np.argmax(opened)), np.asarray(problem.space.first())
    held = np.where(np.arange(len(first)) == i, problem.space.start, np.nan)
    moved = minimise(problem, noise, outcome.z, held, max_steps)
    there = evaluate(problem, noise, np.where(np.isnan(held), moved.z, first))
    return there if chi_square(there) - chi_square(outcome) <= CLOSING_RISE * quantile**2 else outcome


def _sides(space: Space, i: int, value: float, half_width: float) -> tuple[list[float], list[float]]:
    """Places below and above an estimate: 2 and 10 half-widths of its interval off, and a fifth and five times it."""
    lower, upper = float(space.lower[i]), float(space.upper[i])
    below, above = ([value + sign * factor * half_width for factor in (2, 10)] for sign in (-1, 1))
    if np.isfinite(lower):
        below = [max(place, value - 0.9 * (value - lower)) for place in below]
    if np.isfinite(upper):
        above = [min(place, value + 0.9 * (upper - value)) for place in above]
    if np.isfinite(lower) and not np.isfinite(upper):
        below.append(lower + (value - lower) / 5)
        above.append(lower + (value - lower) * 5)
    return below, above


def _verdict(outcome: Outcome, evidence: Evidence, settled: bool, profiles: _Profiles) -> str:
    if not np.all(np.isfinite(outcome.residual)) or not np.all(np.isfinite(outcome.jacobian)):
        return "the model gave no number at the estimate; start closer, or leave out data beyond its reach"
    if not settled:
        return "the noise estimates did not settle; give the noise of some data"
    free = ~evidence.at_bound  # at a bound the sum of squares may well slope
    column, total = np.linalg.norm(outcome.jacobian, axis=0), np.linalg.norm(outcome.residual)
    slope = np.abs(outcome.jacobian.T @ outcome.residual) / np.maximum(column * total, 1e-300)
    exact = total <= 1e-3 * np.sqrt(outcome.residual.size)
    if not exact and np.any(slope[free] > (1e-4 if outcome.solved else 1e-6)):
        return "the optimiser stopped short of a minimum; start closer, or allow more steps"
    if profiles.least_rise < -0.01:
        return "a better minimum lies elsewhere; start closer"
    return SUCCESSFUL


def _conclude(evidence: Evidence, unravel, data: _Data, noise, outcome: Outcome, result: str) -> LeastSquaresFit:
    determined = determine(evidence)
    freedom = outcome.residual.size - determined.rank
    *residuals, _ = np.split(outcome.residual, np.cumsum([v.size for v in data.values]))
    observed_less_predicted = [-r.reshape(v.shape) * s for r, s, v in zip(residuals, noise, data.values, strict=True)]
    return LeastSquaresFit(
        **vars(determined),
        noise={name: float(np.sqrt(np.mean(s**2))) for name, s in zip(data.names, noise, strict=True)},
        noise_estimated=any(evidence.noise_estimated.values()),
        residuals=jax.tree_util.tree_unflatten(data.structure, observed_less_predicted),
        reduced_chi_square=chi_square(outcome) / max(freedom, 1),
        degrees_of_freedom=freedom,
        num_steps=outcome.num_steps,
        success=result == SUCCESSFUL,
        result=result,
        parameters=jax.tree.map(np.asarray, unravel(jnp.asarray(outcome.parameters))),
        evidence=evidence,
    )
