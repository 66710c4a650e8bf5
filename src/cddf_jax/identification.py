"""`fit`: friction, modulus and the errors of the bench from measurements, and what the measurements do not hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .bench import (
    TRIALS,
    Bench,
    BenchModel,
    experiment_of,
    free_parameters,
    parameter_named,
    starting_value,
    stiffness_parameter,
    with_parameters,
)
from .bootstrap import Bootstrap
from .determination import FIXED, Determination, Estimate, spectrum_of
from .errors import InputError
from .friction_by_trial import fit_trials
from .holds import SerialCorrelation, holds_of, serial_correlation
from .least_squares import LeastSquaresFit, least_squares_fit
from .manipulator import Manipulator
from .measurements import Measurements
from .observations import Noise
from .verdict import doubt, estimates_in_words, fit_warnings, looks_at, verdict_of

POSITIVE = (0.0, None)


class Prediction(NamedTuple):
    """The fitted model at some base tensions."""

    value: np.ndarray
    half_width: np.ndarray  # of the 95 % band that the uncertainty of the parameters makes
    extrapolated: np.ndarray  # True beyond the base tensions or tip forces of the data


class Alone(Determination):
    """What one table by itself would have told."""

    def __str__(self) -> str:
        return "\n".join(estimates_in_words(self))


@dataclass(frozen=True, kw_only=True)
class Fit(LeastSquaresFit):
    """Friction, modulus and more as the measurements tell them, SI units; parameters that were not free are "fixed"."""

    manipulator: Manipulator  # with the estimates; where a parameter is not identified, one of many that fit
    tables: tuple[Measurements, ...]  # the data
    model: BenchModel  # of the bench: parameters to readings
    alone: dict[str, Determination]  # what each table by itself, without priors, would have told
    trial_effects: dict[str, Estimate]  # by table and trial, ln(mu of the trial / mu); empty unless asked for
    trial_spread: float  # standard deviation of ln(mu) over trials; 0 where there is none, NaN where not asked for
    warnings: tuple[str, ...]  # of tables, statistics and solver, in words

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: what was determined, what was not, and what measurement would help."""
        return tuple(verdict_of(self, self.tables, self.trial_spread))

    @property
    def mean_relative_error(self) -> float:
        """Of the tip tensions, the measure of Liu et al. (2020): mean of |predicted - read| / read; NaN without any."""
        pairs = [
            (self.residuals[f"{name}: {column}"], table.read(column))
            for name, table in zip(self.alone, self.tables, strict=True)
            for column in table.columns
            if column.startswith("tip_tension")
        ]
        errors = [np.abs(residual[read > 0] / read[read > 0]) for residual, read in pairs]
        return float(np.mean(np.concatenate(errors))) if errors else float("nan")

    @property
    def num_estimated(self) -> int:
        """Parameters and numbers of the noise; of friction that differs between trials the spread alone."""
        return super().num_estimated - len(self.evidence.random) + bool(self.evidence.random)

    @property
    def information_criteria(self) -> dict[str, float]:
        """AIC and BIC of the Gaussian likelihood, over all that the trials could have been (Laplace's method)."""
        random = list(self.evidence.random)
        if not random:
            return super().information_criteria
        size, effects = self.evidence.size[random], self.search.outcome.parameters[random]
        spread = size / np.array([self.evidence.prior_rows[i][0, i] for i in random])
        columns = np.concatenate([*self.evidence.rows.values()])[:, random] / size * spread
        more = np.linalg.slogdet(np.eye(len(random)) + columns.T @ columns)[1] + np.sum((effects / spread) ** 2)
        return {name: value + float(more) for name, value in super().information_criteria.items()}

    def __str__(self) -> str:
        return "\n".join(self.verdict)

    def predict(self, column: str, base_tension: Any, tip_force: Any = (0.0, 0.0), direction: Any = None) -> Prediction:
        """A reading with its 95 % band.

        Args:
            column: "tip_tension", "tip_tension_2", "tip_angle", "tip_x" or "tip_y".
            base_tension: N, (rows,) where every tendon is pulled alike, or (rows, tendons).
            tip_force: N, (2,) or (rows, 2).
            direction: 1 where tendons slide in and -1 where they slide out, broadcast to (rows, tendons); None where
                it is to be found, as in `solve`.

        Raises:
            InputError: for another column, or conditions of other shapes.
        """
        bench = _conditions(base_tension, tip_force, direction, self.manipulator.num_tendons)
        value, slope, *_ = bench.evaluate(self.model.manipulator, self.parameters, self.model.nodes)
        if column not in value:
            raise InputError(f"predict: {column!r} is no reading; there are {', '.join(value)}")
        return Prediction(value[column], self.band(slope[column]), _beyond(bench, self.model))

    def bootstrap(self, kind: str = "parametric", replicates: int = 1000, **options: Any) -> Bootstrap:
        """Refits to data drawn anew; "cases" draws whole trials where there are trials, and whole rows elsewhere."""
        if kind == "cases" and "clusters" not in options:
            options["clusters"] = self.clusters
        return super().bootstrap(kind, replicates, **options)

    def place(self, group: str, k: int) -> str:
        """In words, by the row of the file (1, 2, ... where there is none)."""
        name, _, column = group.rpartition(": ")
        table = self.tables[list(self.alone).index(name)]
        row = table.place(int(np.flatnonzero(table.has(column))[k]))
        return f"{row}, {column}" if table.files else f"{row} of {group}"

    @property
    def rows(self) -> dict[str, np.ndarray]:
        """By group of data, the row of each datum in its file."""
        return {
            f"{name}: {column}": table.rows[table.has(column)]
            for name, table, experiment in zip(self.alone, self.tables, self.model.experiments, strict=True)
            for column in experiment.columns
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """Those of any fit, and where samples of one hold are no independent readings."""
        alike = ((label, one.remark) for label, one in self.serial_correlation.items())
        return (*super().remarks, *(f"{label}: {remark}" for label, remark in alike if remark))

    @property
    def serial_correlation(self) -> dict[str, SerialCorrelation]:
        """By group of data, how alike the residuals within holds are: consecutive rows at one level."""
        covariance, found = spectrum_of(self.evidence.jacobian).covariance, {}
        noise = dict(zip(self.evidence.rows, self.search.noise, strict=True))
        for name, table, experiment in zip(self.alone, self.tables, self.model.experiments, strict=True):
            holds = holds_of(table)
            for label in (f"{name}: {column}" for column in experiment.columns):
                rows = self.evidence.rows[label]
                taken = float(np.einsum("ki,ij,kj->", rows, covariance, rows))
                found[label] = serial_correlation(
                    self.residuals[label] / noise[label], holds[table.has(label.rpartition(": ")[2])], taken
                )
        return found

    @property
    def clusters(self) -> dict[str, tuple[str, np.ndarray]]:
        """By group of data, the table whose trials (or rows) are drawn together, and their labels."""
        return {
            f"{name}: {column}": (
                name,
                (table["trial"] if "trial" in table else np.arange(len(table)))[table.has(column)],
            )
            for name, table, experiment in zip(self.alone, self.tables, self.model.experiments, strict=True)
            for column in experiment.columns
        }


def _conditions(base_tension: Any, tip_force: Any, direction: Any, tendons: int) -> Bench:
    tension = np.atleast_1d(np.asarray(base_tension, dtype=np.float64))
    stated = {} if direction is None else {"direction": direction}
    for name, numbers in {"base_tension": tension, "tip_force": tip_force, **stated}.items():
        if not np.all(np.isfinite(np.asarray(numbers, np.float64))):
            raise InputError(f"predict: {name} must hold finite numbers")
    if np.any(tension < 0):
        raise InputError(f"predict: base_tension must be 0 N or more, got {np.min(tension):g}; a tendon only pulls")
    tension = tension[:, None] if tension.ndim == 1 else tension
    rows = len(tension)
    try:
        pulled = np.broadcast_to(tension, (rows, tendons))
        way = np.broadcast_to(np.asarray(direction, np.float64), (rows, tendons)).T if stated else (None,) * tendons
        force = np.broadcast_to(np.asarray(tip_force, np.float64), (rows, 2))
    except ValueError:
        raise InputError(
            f"predict: needs base_tension (rows,) or (rows, {tendons}), tip_force (2,) or (rows, 2), and direction "
            f"that fits; got {', '.join(str(np.shape(given)) for given in (base_tension, tip_force, *stated.values()))}"
        ) from None
    return Bench(pulled, tuple(way), force if np.any(force) else None)


def _beyond(wanted: Bench, model: BenchModel) -> np.ndarray:
    """Which rows lie outside what the data span, of any tendon's base tension or any component of the tip force."""

    def conditions(bench: Bench) -> np.ndarray:
        force = np.zeros((len(bench.base_tension), 2)) if bench.tip_force is None else bench.tip_force
        return np.concatenate([bench.base_tension, force], axis=1)

    measured = [conditions(e) for e in model.experiments if isinstance(e, Bench)]
    there = conditions(wanted)
    if not measured:
        return np.ones(len(there), bool)
    rows = np.concatenate(measured)
    low, high = rows.min(axis=0), rows.max(axis=0)
    slack = 1e-9 * np.maximum(np.abs(low), np.abs(high))
    return np.any((there < low - slack) | (there > high + slack), axis=1)


def fit(
    manipulator: Manipulator,
    data: Measurements | Sequence[Measurements],
    free: Sequence[str] | None = None,
    priors: Mapping[str, Any] | None = None,
    *,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    noise: Mapping[str, Any] | None = None,
    per_trial: bool = False,
    loss: str = "linear",
    starts: int | None = None,
    seed: int = 0,
    nodes: int = 16,
) -> Fit:
    """Fit parameters of a manipulator and its bench to one or several tables at once.

    A table with `weight`, `pulling_tension` and `wrap_angle` is a pulley test and speaks of friction alone.
    Any other has `base_tension` (and `base_tension_2`, ... for further tendons) and one or more of
    `tip_tension`, `tip_tension_2`, ..., `tip_angle`, `tip_x`, `tip_y`; `direction`, `tip_force_x`,
    `tip_force_y` and `trial` are optional.

    Args:
        manipulator: the body; its numbers are the start.
        data: a table or several.
        free: what is fitted, of `bench.PARAMETERS`; None for friction and modulus, of a body without a single modulus
            friction and `stiffness_factor`. It may also be the constant drag per length,
            gain and zero of the cells (`tip_gain`, `base_zero`, `tip_gain_2` for the cell of tendon 2),
            `pretension`, `angle_zero`, and errors of dimensions (`outer_radius_error`), best with priors.
        priors: by parameter, mean and standard deviation of a Gaussian, SI units, or `Uniform(low, high)`.
        bounds: by parameter, (lower, upper), SI units; default (0, None) for what is positive.
        noise: by column, known standard deviation, SI units, a number or one per row, or `Noise(floor, fraction)`;
            what is not given is estimated, for each column of each table, from the residuals.
        per_trial: let friction differ from trial to trial, ln(mu) by a Gaussian whose spread is estimated.
        loss, starts, seed: as in `least_squares_fit`.
        nodes: as in `solve`.

    Raises:
        InputError: for float32, unknown parameters or columns, tables that do not fit the manipulator.
        TypeError: for a manipulator that is none.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"fit: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    tables = (data,) if isinstance(data, Measurements) else tuple(data)
    try:
        free = free_parameters(manipulator, free)
    except InputError as error:
        raise InputError(f"fit: {error}") from None
    if not all(isinstance(table, Measurements) for table in tables):
        raise InputError("fit: data must be tables as read_measurements gives them, one or several")
    own = [tendon.friction_coefficient is not None for tendon in manipulator.tendons]
    if "friction_coefficient" in free and all(own):
        raise InputError("fit: every tendon has its own friction coefficient; leave theirs out to fit a common one")
    if not tables or not free:
        raise InputError("fit: needs a table of measurements and a free parameter")
    kinds = {name: parameter_named(name) for name in free}
    before = np.cumsum([0, *(len(_trials(table)) for table in tables)])
    experiments = (experiment_of(table, manipulator, int(first)) for table, first in zip(tables, before, strict=False))
    model = BenchModel(manipulator, tuple(experiments), nodes)
    groups = _groups(tables, model)
    start: dict[str, Any] = {name: starting_value(manipulator, name) for name in free}
    bounds = {name: POSITIVE for name, kind in kinds.items() if kind.positive} | dict(bounds or {})
    scales = {name: kind.scale for name, kind in kinds.items() if kind.start is not None}
    given = {"priors": dict(priors or {}), "scales": scales, "loss": loss, "starts": starts, "seed": seed}
    observed, sigma = {group.label: group.observed for group in groups}, _noise_of(groups, noise or {})
    if not per_trial:
        statistics = least_squares_fit(model, start, observed, sigma, bounds, prefer_start=True, **given)
        return _conclude(statistics, tables, model, float("nan"))
    if "friction_coefficient" not in free or before[-1] < 2:
        raise InputError(
            "fit: per_trial needs a free friction_coefficient and tables whose column trial names 2 or more"
        )
    statistics, spread = fit_trials(model, int(before[-1]), start, observed, sigma, bounds, given)
    return _conclude(statistics, tables, model, spread)


def _trials(table: Measurements) -> tuple[str, ...]:
    """The labels of trials in which the friction may differ; a pulley test speaks of the mean."""
    return () if "pulling_tension" in table else table.trial_labels


def _noise_of(groups: "list[_Group]", noise: Mapping[str, Any]) -> dict[str, Any]:
    columns = {group.column for group in groups}
    for column in set(noise) - columns:
        raise InputError(
            f"fit: noise is given for {column!r}, which no table holds; they hold {', '.join(sorted(columns))}"
        )
    return {group.label: _of_readings(noise.get(group.column), group) for group in groups}


def _of_readings(noise: Any, group: "_Group") -> Any:
    """Noise as it was given; of one number per row, those of the rows that were read."""
    per_row = not isinstance(noise, Noise) and np.shape(noise) == group.there.shape
    return np.asarray(noise)[group.there] if per_row else noise


class _Group(NamedTuple):
    label: str
    column: str
    observed: np.ndarray
    there: np.ndarray  # (rows,), in which rows of the table it was read


def _groups(tables: tuple[Measurements, ...], model: BenchModel) -> list[_Group]:
    """One for each observed column of each table."""
    return [
        _Group(f"{name}: {column}", column, table.read(column), table.has(column))
        for table, name, experiment in zip(tables, model.names, model.experiments, strict=True)
        for column in experiment.columns
    ]


# --- the verdict ---------------------------------------------------------------------------------


def _conclude(statistics: LeastSquaresFit, tables, model: BenchModel, trial_spread: float) -> Fit:
    body = model.manipulator
    looks = list(looks_at(statistics.parameters, tables, model))
    if statistics.success and (reason := next(filter(None, map(doubt, looks)), "")):
        statistics = statistics.doubted(reason)
    both = "friction_coefficient", stiffness_parameter(body)
    fixed = {n: starting_value(body, n) for n in both if n not in statistics.names}
    own = [name for name in statistics.names if not name.startswith(TRIALS)]
    told = vars(statistics) | {
        "value": {n: statistics.value[n] for n in own} | fixed,
        "standard_error": {n: statistics.standard_error[n] for n in own} | dict.fromkeys(fixed, 0.0),
        "confidence_interval": {n: statistics.confidence_interval[n] for n in own}
        | {n: (v, v) for n, v in fixed.items()},
        "status": {n: statistics.status[n] for n in own} | dict.fromkeys(fixed, FIXED),
    }
    labels = {name: [f"{name}: {c}" for c in e.columns] for name, e in zip(model.names, model.experiments, strict=True)}
    trials = [f"{name}: {label}" for name, table in zip(model.names, tables, strict=True) for label in _trials(table)]
    spread = np.sqrt(np.diag(statistics.covariance))
    effects = [Estimate(statistics.value[n], float(spread[i])) for i, n in enumerate(statistics.names) if n not in own]
    kept = [name for name in statistics.names if name not in own]
    fit = Fit(
        **told,
        manipulator=with_parameters(body, statistics.parameters),
        tables=tables,
        model=model,
        alone={n: Alone(**vars(statistics.told_by(*labels[n], with_priors_of=kept))) for n in model.names},
        trial_effects=dict(zip(trials, effects, strict=True)) if effects else {},
        trial_spread=trial_spread,
        warnings=(),
    )
    return replace(fit, warnings=tuple(fit_warnings(fit, tables, model, looks)))
