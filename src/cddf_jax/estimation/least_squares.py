"""`least_squares_fit`: any differentiable `predict(parameters)` against data; it knows no manipulator.

The optimiser sees dimensionless unknowns of order one. Noise that is not given is estimated, group by group.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.flatten_util
import numpy as np
from jaxtyping import PyTree

from ..errors import InputError
from ..numerics.given_numbers import check_numbers, check_whole
from .determination import Determination, determine
from .evidence import Evidence
from .levenberg_marquardt import MAX_STEPS, Minimum
from .observations import Noise, Observed, effects_of, group_observations
from .parameter_space import Bounds, Prior, Priors, bounds_of, names_of, parameter_space, priors_of
from .profile_likelihood import Profile, profile_likelihood
from .remarks import remarks_on_parameters, remarks_on_residuals
from .residuals import NO_ERRORS, Data, InputErrors, LeastSquaresProblem, Shared
from .restarts import search
from .whole_search import INTERRUPTED, Ending, FitTask


@dataclass(frozen=True, kw_only=True)
class LeastSquaresFit(Determination):
    """The estimate from all data together, and how it was found."""

    noise: dict[str, float]  # standard deviation by group of data, root mean square
    noise_model: dict[str, Noise]  # floor and fraction, of the groups that have them
    noise_estimated: bool  # whether that of any group was estimated
    input_noise: dict[str, float]  # standard deviation by group of inputs; 0 where the data show none
    residuals: PyTree  # observed - predicted, in the structure of the data; with the inputs as they were read
    reduced_chi_square: float  # sum of squared weighted residuals over the degrees of freedom
    degrees_of_freedom: int  # data less what they determine
    log_likelihood: float  # Gaussian, with this noise, without priors
    num_steps: int  # of the optimiser
    starts: np.ndarray  # the lowest cost of the search from each start, the best first
    restarted: str  # why there were several starts although none were asked for, in words; else ""
    success: bool
    result: str  # "successful", or what went wrong
    parameters: PyTree  # the estimate in the structure of `start`
    evidence: Evidence
    minimum: Minimum

    @property
    def bounded_above(self) -> tuple[str, ...]:
        """Parameters at the lower bound, with an upper 95 % limit: `confidence_interval`."""
        return tuple(self.names[i] for i in self.evidence.bounded_above)

    @property
    def standardised_residuals(self) -> dict[str, np.ndarray]:
        """Observed less predicted, over the noise, by group of data; without what errors of inputs have in common."""
        problem, outcome = self.minimum
        return dict(zip(problem.groups, problem.by_group(-outcome.residual), strict=True))

    @property
    def num_estimated(self) -> int:
        """Parameters, and the numbers of the noise that were estimated; random effects count as one, their spread."""
        of_noise = sum(slopes.shape[1] for slopes in self.evidence.noise_slopes.values())
        random = self.evidence.random
        return len(self.names) - len(random) + bool(random) + of_noise + len(self.evidence.estimated_inputs)

    @property
    def information_criteria(self) -> dict[str, float]:
        """AIC and BIC of the Gaussian likelihood, integrated over random effects by Laplace's method."""
        random, height = list(self.evidence.random), -2 * self.log_likelihood
        if random:
            size, effects = self.evidence.size[random], self.minimum.outcome.parameters[random]
            spread = size / np.array([self.evidence.prior_rows[i][0, i] for i in random])
            columns = np.concatenate([*self.evidence.rows.values()])[:, random] / size * spread
            height += float(np.linalg.slogdet(np.eye(len(random)) + columns.T @ columns)[1])
            height += float(np.sum((effects / spread) ** 2))
        count = self.minimum.problem.num_data
        return {
            "AIC": 2 * self.num_estimated + height,
            "BIC": float(np.log(count)) * self.num_estimated + height,
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on parameters at a kink or determined by one datum, and on residuals."""
        if self.result == INTERRUPTED:  # some remarks fit again
            return ()
        return (
            *([self.restarted] if self.restarted else []),
            *remarks_on_parameters(self.evidence, self.place),
            *remarks_on_residuals(self.evidence, self.minimum, self.place),
        )

    def place(self, group: str, k: int) -> str:
        """The place of the k-th datum of a group in words, k from 0."""
        return f"entry {k + 1} of {group}"

    def profile(self, name: str) -> Profile:
        """The likelihood with one parameter held at value after value and all others fitted again.

        Raises:
            InputError: for a name that was not fitted.
        """
        if name not in self.names:
            raise InputError(f"profile: {name!r} was not fitted; fitted are {', '.join(self.names)}")
        if self.noise_estimated and self.degrees_of_freedom < 1:
            raise InputError("profile: no data are left to estimate the noise; give it, or measure more")
        (quantile,) = self.evidence.uncertainty(np.eye(len(self.names))[[self.names.index(name)]]).quantile
        return profile_likelihood(self.minimum, name, self.standard_error[name], float(quantile))

    def doubted(self, reason: str) -> "LeastSquaresFit":
        """The fit as a failed one, for a reason that is not in its sum of squares."""
        evidence = replace(self.evidence, failed=True, bounded_above=())
        return replace(self, **vars(determine(evidence)), evidence=evidence, success=False, result=reason)

    def determined_by(self, *groups: str) -> Determination:
        """What some groups of the data alone, without priors, would determine if this estimate were the true values."""
        return determine(self.evidence.of(groups))

    def band(self, sensitivity: np.ndarray) -> np.ndarray:
        """Half-width of the 95 % band of predictions with this derivative by the parameters (rows: predictions).

        Infinite for a prediction that depends on what the data do not determine.
        """
        return self.evidence.uncertainty(sensitivity).half_width


def least_squares_fit(
    predict: Callable[[PyTree], PyTree],
    start: PyTree,
    observed: PyTree,
    sigma: PyTree = None,
    bounds: Bounds | None = None,
    *,
    priors: Priors | None = None,
    scales: Mapping[str, float] | None = None,
    starts: int | None = None,
    seed: int = 0,
    prefer_start: bool = False,
    max_steps: int = MAX_STEPS,
    accuracy: float = 0.0,
    inputs: InputErrors = NO_ERRORS,
) -> LeastSquaresFit:
    """Fit parameters by Levenberg-Marquardt and say what the data determine.

    Args:
        predict: differentiable; from parameters in the structure of `start` to the structure of `observed`.
            A function or a pytree that is callable; if it is given again, nothing is compiled.
        start: first guess, a mapping from names to numbers, or any pytree of numbers or arrays.
        observed: data, one array or a pytree of arrays; each array is a group with its own noise.
        sigma: standard deviation of the noise: a number, an array, a `Noise(floor, fraction)` or None, for all groups,
            or a mapping with one of these by the name of a group. None: it is estimated from the residuals.
        bounds: by parameter name, (lower, upper), None for none; the estimate stays inside.
        priors: by parameter name, mean and standard deviation of a Gaussian.
        scales: by parameter name, a size that matters, for parameters that may be 0. If the estimate is smaller, the
            standard error is compared with this size.
        starts: number of points to search from, the first being `start`. None: from `start` alone, and from up to 32
            more if that search failed, hardly explained the data or ended where the data do not determine the
            parameters; then the remarks say so. Further starts lie up to three powers of ten from the first, by the
            distance from a bound, or by the size of a parameter without bounds. Such a parameter has the other sign in
            one start of four.
        seed: of the further starts.
        prefer_start: if the data leave a valley open, end where its first parameter has its start value, and not at the
            shallow minimum that noise makes somewhere in the valley.
        max_steps: of the optimiser.
        accuracy: in standard errors, for a model whose derivative jumps or that is not good to all digits: a search
            ends where a whole step of Gauss-Newton promises to move the estimates by less.
        inputs: of the model, where they were read with errors, see `InputErrors`.

    Raises:
        InputError: for float32, `starts` below 1, a start outside its bounds, unknown names, data that are not
            finite.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            'fits need double precision: call jax.config.update("jax_enable_x64", True) before anything else'
        )
    if not jax.tree.leaves(start):
        raise InputError("start: there is no parameter to fit; give one or more")
    if starts is not None:
        check_whole("starts", starts, 1)
    check_numbers("start", jax.tree.leaves(start))
    flat, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(lambda leaf: np.asarray(leaf, float), start))
    names, first = names_of(start), np.asarray(flat)
    groups = group_observations(observed, sigma)
    prior = priors_of(names, priors or {})
    limits = bounds_of(names, first, bounds or {})
    space = parameter_space(names, first, *limits, _scales(names, first, scales or {}, prior))
    data = Data(
        values=tuple(group.values for group in groups),
        noise=tuple(group.first_guess() for group in groups),
        prior=prior,
    )
    labels = tuple(group.name for group in groups)
    effects = effects_of(inputs, groups, start)
    without = {name: 0 * own for name, own in effects.items()}  # in the shapes of later, so that programs are shared
    shared = Shared.of(without, dict.fromkeys(effects, 0.0), sum(group.values.size for group in groups))
    problem = LeastSquaresProblem(predict, unravel, labels, data, shared, space, max_steps, accuracy)
    task = FitTask(problem, groups, prefer_start, inputs)
    return _conclude(task.groups, jax.tree.structure(observed), search(task, starts, seed))


def _scales(
    names: tuple[str, ...], start: np.ndarray, scales: Mapping[str, float], prior: Mapping[int, Prior]
) -> np.ndarray:
    """Sizes that matter, NaN if unknown: as given, or for a parameter that starts at 0 the width of its prior."""
    for name, scale in scales.items():
        if name not in names or not scale > 0:
            raise InputError(
                f"scale of {name!r}: needs a number > 0 and a parameter that is fitted ({', '.join(names)})"
            )
    known = {names[i]: float(p.standard_deviation) for i, p in prior.items() if start[i] == 0} | dict(scales)
    return np.array([known.get(name, np.nan) for name in names])


def _conclude(groups: Sequence[Observed], structure: PyTree, ending: Ending) -> LeastSquaresFit:
    problem, outcome = ending.minimum
    freedom = outcome.residual.size - ending.determination.rank
    noise = [np.asarray(s) for s in problem.data.noise]
    raw = problem.by_group(problem.unwhitened(outcome.residual))
    residuals = [r.reshape(s.shape) for r, s in zip(raw, noise, strict=True)]
    found = list(zip(groups, noise, residuals, strict=True))
    models = {g.name: g.model(s, r.ravel()) for g, s, r in found}
    log_likelihood = -0.5 * (
        np.sum(outcome.residual[: problem.num_data] ** 2)
        + sum(np.sum(np.log(2 * np.pi * s**2)) for s in noise)
        + problem.shared.log_determinant
    )
    return LeastSquaresFit(
        **vars(ending.determination),
        noise={g.name: float(np.sqrt(np.mean(s**2))) for g, s, _ in found},
        noise_model={name: model for name, model in models.items() if model is not None},
        noise_estimated=any(ending.evidence.noise_estimated.values()),
        input_noise={name: float(value) for name, value in problem.shared.deviation.items()},
        residuals=jax.tree.unflatten(structure, [-r * s for _, s, r in found]),
        reduced_chi_square=float(np.sum(outcome.residual**2)) / max(freedom, 1),
        degrees_of_freedom=freedom,
        log_likelihood=float(log_likelihood),
        num_steps=int(outcome.num_steps),
        starts=ending.starts,
        restarted=ending.restarted,
        success=ending.success,
        result=ending.result,
        parameters=jax.tree.map(np.array, problem.unravel(outcome.parameters)),
        evidence=ending.evidence,
        minimum=ending.minimum,
    )
