"""The data of a fit: groups of observations, each with noise that is known, modelled or estimated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from ..errors import InputError
from ..numerics.given_numbers import check_numbers
from .evidence import spectrum_of, without_nan
from .levenberg_marquardt import Minimum, Outcome
from .parameter_space import TINY
from .residuals import InputErrors, LeastSquaresProblem, Shared

MODEL_PRECISION = 1e-8  # noise is never estimated below this times the data: the model is no better
LARGEST_LEVERAGE = 0.9
NEGLIGIBLE = 1e-3  # of the noise: a smaller part of it is set to 0
EXACTLY = {"ftol": 1e-15, "gtol": 1e-12, "maxiter": 500, "maxls": 60}  # of the likelihood of floor and fraction
LEAST_FALL = 1.0  # of minus twice the logarithm of the likelihood, by the noise of inputs that was not given
LINEAR_ROUNDS, LIKELY_ENOUGH = 200, 1e-7
NOT_MOVING = 1e-12  # singular values of the effects of inputs below this times the largest are rounding
DECADES = 12.0  # logarithm of the largest noise of an input over the smallest


class Noise(NamedTuple):
    """Noise that grows with the reading: standard deviation sqrt(floor^2 + (fraction * value)^2).

    The value is the predicted one. A part that is None is estimated from the residuals.
    """

    floor: float | None = None  # in the unit of the data
    fraction: float | None = None


@dataclass(frozen=True)
class Observed:
    """A group of observations."""

    name: str
    values: np.ndarray
    sigma: np.ndarray | Noise | None  # standard deviations, or None if they are estimated

    @property
    def scale(self) -> float:
        return float(np.sqrt(np.mean(self.values**2))) or 1.0

    def first_guess(self) -> np.ndarray:
        """Standard deviations to start from."""
        if self.sigma is None:
            return np.full(self.values.shape, 0.05 * self.scale)
        if isinstance(self.sigma, Noise):
            floor = 0.03 * self.scale if self.sigma.floor is None else self.sigma.floor
            fraction = 0.03 if self.sigma.fraction is None else self.sigma.fraction
            return np.hypot(np.maximum(floor, MODEL_PRECISION * self.scale), fraction * self.values)
        return np.broadcast_to(self.sigma, self.values.shape)

    def estimate(self, old: np.ndarray, residual: np.ndarray, leverage: np.ndarray) -> np.ndarray:
        """Standard deviations from residuals in units of the old ones, less the degrees of freedom of the fit."""
        noise, least = old.ravel(), MODEL_PRECISION * self.scale
        error = residual * noise
        if self.sigma is None:
            freedom = max(self.values.size - leverage.sum(), 1e-3)
            spread = np.sqrt(np.sum(error**2) / freedom)
            return np.full(self.values.shape, max(spread, least))
        if not isinstance(self.sigma, Noise):
            return old
        predicted = self.values.ravel() + error
        floor, fraction = _parts(self.sigma, predicted, error**2, leverage, noise)
        return np.hypot(max(floor, least), fraction * predicted).reshape(self.values.shape)

    def noise_slopes(self, noise: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """(data, parts), the derivative of each variance by each estimated part of it, over the variance.

        The variance is linear in the parts, which are the variance itself, or the squares of floor and fraction. Each
        part is in the unit in which its largest entry is 1. The residuals are over the noise.
        """
        if not isinstance(self.sigma, Noise):
            return np.ones((self.values.size, int(self.sigma is None)))
        predicted, free = self.values.ravel() + residual * noise.ravel(), [part is None for part in self.sigma]
        slopes = np.stack([np.ones_like(predicted), predicted**2], axis=1)[:, free] / noise.ravel()[:, None] ** 2
        return without_nan(slopes / np.maximum(np.max(slopes, axis=0, initial=0.0), TINY))

    def model(self, noise: np.ndarray, residual: np.ndarray) -> Noise | None:
        """Floor and fraction of the noise; None if it has none."""
        if not isinstance(self.sigma, Noise):
            return None
        noise = noise.ravel()
        predicted = self.values.ravel() + residual * noise
        parts = np.array(_parts(self.sigma, predicted, noise**2, np.zeros(noise.size), noise))
        size = parts * [1.0, np.max(np.abs(predicted))]
        return Noise(*np.where(size < NEGLIGIBLE * np.min(noise), 0.0, parts).tolist())


def estimate_noise(
    groups: Sequence[Observed], minimum: Minimum, inputs: InputErrors
) -> tuple[tuple[np.ndarray, ...], Shared]:
    """Standard deviations of each group, and errors of inputs, from the residuals at a minimum.

    An input group whose standard deviation is to be found gets none unless the data show it: minus twice the logarithm
    of the restricted likelihood falls by more than `LEAST_FALL`.
    """
    problem, outcome = minimum
    given = tuple(map(np.asarray, problem.data.noise))
    if not np.all(np.isfinite(outcome.residual)):
        return given, problem.shared
    effects = effects_of(inputs, groups, jax.tree.map(np.asarray, problem.unravel(outcome.parameters)))
    linear = _Linear(groups, problem, outcome, effects, inputs)
    free = [name for name, sigma in inputs.sigma.items() if sigma is None]
    none = {name: sigma or 0.0 for name, sigma in inputs.sigma.items()}
    without = linear.settled(given, none, ())
    if not free:
        return without[1:]
    found = linear.settled(given, none, free)
    return (found if found[0] < without[0] - LEAST_FALL else without)[1:]


def effects_of(inputs: InputErrors, groups: Sequence[Observed], parameters: PyTree) -> dict[str, np.ndarray]:
    """By input group, (data, inputs), the derivatives of all data by the inputs; 0 where the model gives no number."""

    def whole(own: Mapping[str, np.ndarray]) -> np.ndarray:
        count = next(iter(own.values())).shape[1]
        every = np.concatenate([own.get(group.name, np.zeros((group.values.size, count))) for group in groups])
        return without_nan(every)

    return {name: whole(own) for name, own in inputs.slopes(parameters).items()}


class _Linear(NamedTuple):
    """The model, linear about a minimum, with errors of inputs."""

    groups: Sequence[Observed]
    problem: LeastSquaresProblem
    outcome: Outcome
    effects: dict[str, np.ndarray]  # as of `effects_of`
    inputs: InputErrors

    def settled(
        self, noise: tuple[np.ndarray, ...], deviation: dict[str, float], free: Sequence[str]
    ) -> tuple[float, tuple[np.ndarray, ...], Shared]:
        """Minus twice the logarithm of the restricted likelihood at its maximum, and the noise there."""
        problem, count, old = self.problem, self.problem.num_data, np.concatenate(list(map(np.ravel, noise)))
        jacobian = problem.unwhitened(without_nan(self.outcome.jacobian))
        residual = problem.unwhitened(self.outcome.residual)
        height, shared = np.inf, problem.shared
        for _ in range(LINEAR_ROUNDS):
            now = np.concatenate(list(map(np.ravel, noise)))
            factor = np.append(old / now, np.ones(len(residual) - count))
            rows, errors = jacobian * factor[:, None], residual * factor
            for name in free:
                deviation = deviation | {name: self._likeliest(name, deviation, now, rows, errors)}
            shared = self._shared(deviation, now)
            basis, pulls = self._basis(shared, rows), _whitened(shared, errors, count)
            last, height = height, 2 * np.sum(np.log(now)) + shared.log_determinant + np.sum(pulls**2)
            spectrum = spectrum_of(_whitened(shared, rows, count))  # what is not determined is rounding
            height += 2 * np.sum(np.log(spectrum.values[spectrum.determined])) - np.sum((basis.T @ pulls) ** 2)
            if abs(last - height) < LIKELY_ENOUGH:
                break
            error = np.asarray(shared.whitened(pulls[:count]))
            leverage = 1 - shared.kept + np.sum(shared.whitened(basis[:count]) ** 2, axis=1)
            each = zip(self.groups, noise, problem.by_group(error), problem.by_group(leverage), strict=True)
            noise = tuple(group.estimate(sigma, r, h) for group, sigma, r, h in each)
        return float(height), noise, shared

    def _shared(self, deviation: dict[str, float], noise: np.ndarray) -> Shared:
        columns = {name: deviation[name] * own / noise[:, None] for name, own in self.effects.items()}
        return Shared.of(columns, deviation, noise.size)

    def _basis(self, shared: Shared, rows: np.ndarray) -> np.ndarray:
        """(rows, determined), orthonormal, of the whitened Jacobian."""
        rows = _whitened(shared, rows, self.problem.num_data)
        return rows @ spectrum_of(rows).root.T

    def _likeliest(
        self, name: str, deviation: dict[str, float], noise: np.ndarray, rows: np.ndarray, errors: np.ndarray
    ) -> float:
        """The standard deviation of an input group with the largest restricted likelihood, all others as they are."""
        from scipy.optimize import minimize_scalar

        others = self._shared(deviation | {name: 0.0}, noise)
        basis, count = self._basis(others, rows), self.problem.num_data
        effect = np.zeros((len(rows), self.effects[name].shape[1]))
        effect[:count] = others.whitened(self.effects[name] / noise[:, None])
        effect -= basis @ (basis.T @ effect)
        directions, size, _ = np.linalg.svd(effect, full_matrices=False)
        moving = size > NOT_MOVING * max(np.max(size), TINY)
        pull, square = (directions.T[moving] @ _whitened(others, errors, count)) ** 2, size[moving] ** 2

        def height(logarithm: float) -> float:
            grown = 1 + np.exp(2 * logarithm) * square
            return float(np.sum(np.log(grown) + pull / grown))  # no differences of large numbers

        largest = np.log(self.inputs.largest[name])
        found: Any = minimize_scalar(
            height, bounds=(largest - DECADES, largest), method="bounded", options={"xatol": 1e-6}
        )
        return float(np.exp(found.x)) if found.fun < np.sum(pull) else 0.0


def _whitened(shared: Shared, rows: np.ndarray, count: int) -> np.ndarray:
    """Rows of the data whitened, and then those of the priors."""
    return np.concatenate([shared.whitened(rows[:count]), rows[count:]])


def _parts(
    sigma: Noise, predicted: np.ndarray, squares: np.ndarray, leverage: np.ndarray, old: np.ndarray
) -> tuple[float, float]:
    """The most likely floor and fraction, given the squares of the residuals; the variance is linear in their squares.

    Restricted likelihood (Patterson and Thompson 1971): the sum of (square - (1 - leverage) variance) / variance^2,
    times 1 or times predicted^2, is zero, or the part itself is zero.
    """
    from scipy.optimize import nnls

    design = np.stack([np.ones_like(predicted), predicted**2], axis=1)
    known = np.array([part is not None for part in sigma])
    given = np.array([0.0 if part is None else part**2 for part in sigma])
    if not np.all(known):
        kept = 1 - np.minimum(leverage, LARGEST_LEVERAGE)
        least = (MODEL_PRECISION**2 * np.mean(predicted**2)) or TINY
        size = np.max(design[:, ~known], axis=0, initial=TINY)
        free, rest = design[:, ~known] / size, design @ given + least
        first, _ = nnls(free / old[:, None] ** 2, np.maximum(squares / kept - rest, 0.0) / old**2)
        given[~known] = _most_likely(free, rest, squares / kept, kept, first) / size
    floor, fraction = np.sqrt(given)
    return float(floor), float(fraction)


def _most_likely(
    design: np.ndarray, rest: np.ndarray, squares: np.ndarray, weight: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """The u >= 0 at which the sum of weight * (log v + square / v) is least, with v = design @ u + rest."""
    from scipy.optimize import minimize

    unit = float(np.mean(squares + rest))

    def height(u: np.ndarray) -> tuple[float, np.ndarray]:
        variance = unit * (design @ u) + rest
        slope = weight * (1 - squares / variance) / variance
        return float(np.sum(weight * (np.log(variance) + squares / variance))), unit * (slope @ design)

    bounds = [(0, None)] * design.shape[1]
    return unit * minimize(height, first / unit, jac=True, method="L-BFGS-B", bounds=bounds, options=EXACTLY).x


def group_observations(observed: PyTree, sigma: PyTree) -> tuple[Observed, ...]:
    """Check the data, and give each group its noise."""
    leaves = jax.tree_util.tree_flatten_with_path(observed)[0]
    check_numbers("the data", [leaf for _, leaf in leaves])
    names = tuple(jax.tree_util.keystr(path, simple=True, separator=".") or "data" for path, _ in leaves)
    values = tuple(np.asarray(leaf, dtype=np.float64) for _, leaf in leaves)
    if not values or not any(v.size for v in values):
        raise InputError("there are no data to fit")
    for name, v in zip(names, values, strict=True):
        if not np.all(np.isfinite(v)):
            raise InputError(f"{name}: entry {int(np.argmin(np.isfinite(v.ravel()))) + 1} is not finite; leave it out")
    given = sigma if isinstance(sigma, Mapping) else dict.fromkeys(names, sigma)
    if unknown := [name for name in given if name not in names]:
        there = ", ".join(names)
        raise InputError(f"sigma is given for {unknown[0]!r}, which is not a group of data; there are {there}")
    return tuple(_checked(name, v, given.get(name)) for name, v in zip(names, values, strict=True))


def _checked(name: str, values: np.ndarray, sigma: PyTree) -> Observed:
    check_numbers(f"sigma of {name}", [sigma])
    if isinstance(sigma, Noise):
        known = [part for part in sigma if part is not None]
        if any(not part >= 0 for part in known) or not (len(known) < 2 or any(part > 0 for part in known)):
            raise InputError(f"sigma of {name}: floor and fraction must be 0 or more, one of them > 0, got {sigma}")
    elif sigma is not None:
        sigma = np.asarray(sigma, dtype=np.float64)
        if not np.all(sigma > 0):
            raise InputError(f"sigma of {name} must be > 0")
        if sigma.shape not in ((), values.shape):
            raise InputError(
                f"sigma of {name} must be one number or of shape {values.shape} like the data, got {sigma.shape}"
            )
    return Observed(name, values, sigma)
