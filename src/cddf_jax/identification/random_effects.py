"""Random effects: friction that differs from trial to trial, and errors of the base cells.

The error of a base tension moves all readings of its row, and with a history later rows.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from ..estimation.determination import determine
from ..estimation.least_squares import LeastSquaresFit
from ..estimation.parameter_space import Priors
from ..estimation.residuals import InputErrors
from ..estimation.whole_search import INTERRUPTED
from ..measurements.jitter import LARGEST_JITTER
from ..measurements.readings import kind_of_set
from ..measurements.table import Measurements
from .bench import Bench, BenchModel, benches_of
from .parameters import TRIALS, Parameters

SPREAD_ROUNDS = 20
FIRST_SPREAD = 0.1
SPREADS = (1e-4, 3.0)  # of ln(mu) over trials, smallest and largest; the smallest counts as 0
RIDGE = 1e-12  # of the largest information, for directions that the data do not determine
MOST_LEVELS = 400  # of a table; for more the noise of base tensions is not estimated

Slopes = Mapping[str, Mapping[str, np.ndarray]]


def fit_trials(
    search: Callable[..., LeastSquaresFit],
    count: int,
    start: Parameters,
    priors: Priors,
    scales: Mapping[str, float],
    starts: int | None,
) -> tuple[LeastSquaresFit, float]:
    """Random effects, by iteration: the fit for a spread over trials, then the likeliest spread at that fit, and so on.

    Args:
        search: `least_squares_fit` of the bench and its data.
        count: the number of trials.
        start, priors, scales, starts: as `least_squares_fit` takes them.

    Returns:
        The fit and the spread of ln(mu) over trials, 0 where there is none.
    """
    start, spread = {**start, TRIALS: np.zeros(count)}, FIRST_SPREAD
    names = [f"{TRIALS}[{k}]" for k in range(count)]

    def fitted(start: Parameters, spread: float, starts: int | None) -> LeastSquaresFit:
        of_trials = dict.fromkeys(names, (0.0, spread)), dict.fromkeys(names, spread)
        return search(start, priors={**priors, **of_trials[0]}, scales={**scales, **of_trials[1]}, starts=starts)

    statistics = first = fitted(start, spread, starts)
    if statistics.result == INTERRUPTED:
        return statistics, spread
    random = tuple(i for i, name in enumerate(statistics.names) if name in names)
    for _ in range(SPREAD_ROUNDS):
        last, spread = spread, _likeliest_spread(statistics, random)
        statistics = fitted({name: np.asarray(value) for name, value in statistics.parameters.items()}, spread, 1)
        if statistics.result == INTERRUPTED:
            return statistics, spread
        if abs(spread - last) < 1e-3 * last:
            break
    evidence = replace(statistics.evidence, random=random)
    searched = {"starts": first.starts, "restarted": first.restarted}
    statistics = replace(statistics, **vars(determine(evidence)), evidence=evidence, **searched)
    return statistics, spread if spread > 1.01 * SPREADS[0] else 0.0


def _likeliest_spread(statistics: LeastSquaresFit, random: tuple[int, ...]) -> float:
    """The spread with the largest restricted likelihood of the model, linearised at the estimate.

    Patterson and Thompson (1971), Biometrika 58, 545; by the mixed-model equations of Harville (1977), JASA 72, 320.
    """
    from scipy.optimize import minimize_scalar

    evidence, (problem, outcome) = statistics.evidence, statistics.minimum
    priors = [i for i in evidence.prior_rows if i not in random]
    jacobian = np.concatenate([*evidence.rows.values(), *(evidence.prior_rows[i] for i in priors)])
    others = np.delete(jacobian, random, axis=1)
    effects = jacobian[:, random] / evidence.size[list(random)]
    pulls = dict(zip(problem.data.prior, outcome.residual[problem.num_data :], strict=True))
    residual = np.append(outcome.residual[: problem.num_data], [pulls[i] for i in priors])
    residual = residual - effects @ outcome.parameters[list(random)]  # as it would be without the effects
    columns = np.concatenate([others, effects], axis=1)
    information, pull = columns.T @ columns, columns.T @ residual
    diagonal = np.arange(others.shape[1], columns.shape[1])

    def minus_twice(logarithm: float) -> float:
        whole = information + RIDGE * np.max(np.diag(information)) * np.eye(len(information))
        whole[diagonal, diagonal] += np.exp(-2 * logarithm)
        return np.linalg.slogdet(whole)[1] + 2 * len(random) * logarithm - pull @ np.linalg.solve(whole, pull)

    found: Any = minimize_scalar(minus_twice, bounds=np.log(SPREADS), method="bounded", options={"xatol": 1e-5})
    return float(np.exp(found.x))


# --- errors of base cells -------------------------------------------------------------------------


class SetLevels(NamedTuple):
    """What was set in the rows of a table; rows of one level share the errors of their cells."""

    name: str
    table: Measurements
    bench: Bench
    level: np.ndarray  # (rows,), 0, 1, ... through all trials

    @property
    def are_many(self) -> bool:
        """Whether there are more levels than errors are estimated for."""
        return int(np.max(self.level)) >= MOST_LEVELS

    @property
    def are_shared(self) -> bool:
        """Whether what is set in one level moves several readings."""
        count = sum(int(np.sum(self.table.has(column))) for column in self.bench.columns)
        turns = self.bench.course is not None and self.bench.course.turns
        return turns or count > self.bench.actuation.shape[1] * (int(np.max(self.level)) + 1)

    def slopes(self, uncertain: Mapping[str, int], model: BenchModel, at: Parameters) -> Slopes:
        """By label of each uncertain column and group of data, (readings, levels), the derivatives by what was set.

        They are over the root of the number of different readings of a level. Equal ones are one: the noise of a cell
        makes no equal readings.
        """
        by_base = self.bench.evaluate(model.manipulator, jax.tree.map(np.asarray, at), model.nodes).by_base
        return {label: self._by_column(by_base, number) for label, number in uncertain.items()}

    def _by_column(self, by_base: Mapping[str, np.ndarray], number: int) -> dict[str, np.ndarray]:
        every, rows = self.table.set_columns, np.arange(len(self.table))
        pull = self.bench.actuation[:, every[number].tendon]
        different = np.unique(np.stack([self.level, pull]), axis=1)[0].astype(int)
        others = np.setdiff1d(self.level, self.level[every[number].rows])  # the levels that another column sets
        size = np.sqrt(np.bincount(different))
        found = {}
        for column in self.bench.columns:
            slope = np.asarray(by_base[column]).reshape(len(self.table), -1, len(every))[:, :, number]
            whole = np.zeros((len(self.table), size.size))
            whole[rows, self.level] = slope[:, 0]
            if (course := self.bench.course) is not None:
                for trial, steps in enumerate(course.turn_steps):
                    own = np.flatnonzero(np.asarray(course.trial) == trial)
                    for turn, step in enumerate(steps.tolist()):
                        there = own[np.asarray(course.step)[own] == step]
                        if there.size:
                            whole[own, self.level[there[0]]] = slope[own, 1 + turn]
            whole[:, others] = 0.0
            found[f"{self.name}: {column}"] = (whole / size)[self.table.has(column)]
        return found


def levels_of(model: BenchModel, tables: Sequence[Measurements]) -> list[SetLevels]:
    """One for each table of the manipulator."""
    return [SetLevels(*own, _levels(*own[1:])) for own in benches_of(tables, model)]


def _levels(table: Measurements, bench: Bench) -> np.ndarray:
    """The level of each row, counted through all trials."""
    if bench.course is not None:
        trial, step = np.asarray(bench.course.trial), np.asarray(bench.course.step)
        return np.unique(np.stack([trial, step]), axis=1, return_inverse=True)[1].ravel()
    level, count = np.zeros(len(table), int), 0
    for own in table.trials:
        moved = np.any(np.diff(bench.actuation[own], axis=0) != 0, axis=1)
        level[own] = count + np.cumsum(np.append(False, moved))
        count = int(np.max(level[own])) + 1
    return level


def errors_of_base(model: BenchModel, tables: Sequence[Measurements], noise: Mapping[str, float]) -> InputErrors:
    """The base tensions as inputs with errors; none where they have none.

    A noise that is not stated is estimated where one base tension moves several readings: those of its row, or later
    ones after a turn. Elsewhere it cannot be told from the noise of the readings, which then includes it. With
    more than `MOST_LEVELS` different levels it is not estimated either, as that takes long; see `many_levels`.

    Args:
        model: the bench.
        tables: its data.
        noise: by column, the stated standard deviation, N.
    """
    sigma, largest, found = {}, {}, []
    for levels in levels_of(model, tables):
        estimable, uncertain = levels.are_shared and not levels.are_many, {}
        for number, (column, _, rows) in enumerate(levels.table.set_columns):
            stated = noise.get(column, noise.get(kind_of_set(column)))
            most = LARGEST_JITTER * float(np.ptp(np.append(levels.table[column][rows], 0.0)))
            if stated != 0 and most > 0 and (stated is not None or estimable):
                label = f"{levels.name}: {column}"
                sigma[label], largest[label], uncertain[label] = stated, most, number
        found += [partial(levels.slopes, uncertain, model)] * bool(uncertain)

    def slopes(at: Parameters) -> Slopes:
        return {label: own for of_table in found for label, own in of_table(at).items()}

    return InputErrors(slopes, sigma, largest)


def many_levels(model: BenchModel, tables: Sequence[Measurements], noise: Mapping[str, object]) -> list[str]:
    """The names of the tables whose noise of base tension is neither stated nor estimated, as there are many levels."""
    return [
        levels.name
        for levels in levels_of(model, tables)
        if levels.are_many
        and levels.are_shared
        and not {kind_of_set(own.column) for own in levels.table.set_columns} <= set(noise)
    ]
