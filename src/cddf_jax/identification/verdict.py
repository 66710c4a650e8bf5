"""The result of a fit in words: what the data determine and what not, why the fit is doubtful, and warnings."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Int

from ..estimation.determination import IDENTIFIED, NOT_IDENTIFIED, Determination
from ..estimation.least_squares import LeastSquaresFit
from ..estimation.remarks import EXACT, chance_of_more
from ..measurements.columns import is_reading
from ..measurements.holds import correlation_of_rows, holds_of
from ..measurements.jitter import Steady
from ..measurements.left_out import named_rows, rows_in_words
from ..measurements.readings import kind_of_set, of_shape, set_by, tendon_number
from ..measurements.table import Measurements
from ..measurements.table_warnings import warnings_of
from ..quantities import dimension_of
from ..robot.manipulator import Manipulator
from ..statics.status import NOTEWORTHY, Status, words_of
from ..units import preferred, shown
from .bench import Bench, BenchModel, Evaluation, Group, benches_of
from .course import Shown, is_driven_by_length
from .parameters import TRIALS, Parameters, parameter_named, unit_of
from .random_effects import many_levels
from .tension_before import is_past

LARGEST_FRICTION = 2.0  # a larger coefficient gives a warning
CHANCE = 1e-3  # p-value below which residuals drift, or differ from trial to trial
LARGEST_MOVE = 0.5  # standard errors; a larger error by increments gives a warning
MOST_ALIKE = 0.999  # a correlation of neighbours that is counted; at 1 nothing would be known
AGAINST = "tendons travel against the direction that was found for them"
MOST = 0.5  # of a table's rows; with more rows without a solution the fit fails
# statuses of rows without a solution
OUTSIDE = Status.unphysical, Status.locked, Status.not_converged, Status.load_limit, Status.crossing, Status.unstable


class SolveResults(NamedTuple):
    """How the solves of a table's rows ended, at the estimate."""

    name: str
    table: Measurements
    status: Int[Array, " rows"]
    contradicted: np.ndarray  # (rows,), whether a tendon travels against its direction, which the table did not state
    read: np.ndarray  # (rows,), whether there is a reading; the other rows do not count

    def ended(self, *statuses: Status) -> np.ndarray:
        """(rows,), whether there is a reading, and the solve ended with one of these statuses."""
        return np.isin(np.asarray(self.status), statuses) & self.read


def solve_results(
    parameters: Parameters, tables: Sequence[Measurements], model: BenchModel, inputs: Collection[str] = ()
) -> Iterator[SolveResults]:
    """One for each table of the manipulator; `inputs`: what was set and has errors, by table and column."""
    for name, table, experiment in benches_of(tables, model):
        errors = any(label.startswith(f"{name}: ") for label in inputs)  # then the search has compiled `evaluate`
        solved = experiment.evaluate if errors or experiment.course is None else experiment.solved
        shown = solved(model.manipulator, parameters, model.nodes)
        read = np.any([table.has(column) for column in table.columns if is_reading(column, table.columns)], axis=0)
        yield SolveResults(name, table, shown.status, against(experiment, shown) & read, read)


def against(experiment: Bench, shown: Shown | Evaluation) -> np.ndarray:
    """(rows,), whether a tendon travels against the direction that was found for it; a stated one is not doubted."""
    found = [way is None for way in experiment.direction]
    contradicted = np.asarray(shown.status) == Status.direction_contradicted
    return contradicted & np.any(np.asarray(shown.direction_contradicted)[:, found], axis=1)


def doubt(ends: Sequence[SolveResults]) -> str:
    """Why the rows of the tables cannot determine parameters; "" where they can."""
    for solves in ends:
        outside, count = solves.ended(*OUTSIDE), np.count_nonzero(solves.read)
        where = rows_in_words(named_rows([solves.table], [outside]))
        if np.count_nonzero(outside) > MOST * count:
            kinds = ", ".join(code.name.replace("_", " ") for code in OUTSIDE if np.any(solves.ended(code)))
            return (
                f"most rows of {solves.name} have no solution in the model ({np.count_nonzero(outside)} of {count}, "
                f"{where}: {kinds}); check the units of the table and the dimensions of the body"
            )
    tables = [solves.table for solves in ends]
    rows = named_rows(tables, [solves.contradicted for solves in ends])
    if not rows:
        return ""
    found, count = sum(map(len, rows.values())), sum(np.count_nonzero(solves.read) for solves in ends)
    return (
        f"{AGAINST} in {found} of {count} rows: "
        f"{rows_in_words(rows)}; parts of them stick there. Follow the rows with history, "
        "in the order in which they were pulled or each from rest (--each-from-rest). Or leave them out "
        "(leave_out, --leave-out). Or state the directions in columns direction and direction_2"
    )


def warnings_of_rows(
    tables: Sequence[Measurements], model: BenchModel, without_jitter: Mapping[str, Steady]
) -> Iterator[str]:
    """Warnings about the tables, and about what was taken for granted or ignored in them."""
    for table, one in zip(tables, model.experiments, strict=True):
        from_rest = one.course is None or one.course.past is None
        yield from (f"{table.name}: {own}" for own in warnings_of(table, in_order=one.in_order, from_rest=from_rest))
    for name, table, one in benches_of(tables, model):
        if one.in_order is None and len(table) > 1:
            yield f"{name}: each row was followed from rest, with all that was set in proportion"
        slack = {*range(1, model.manipulator.num_tendons + 1)} - {*map(tendon_number, set_by(table.columns))}
        if slack:
            yield f"{name}: no column for tendon {', '.join(map(str, sorted(slack)))}: taken as slack"
        for column, _, _ in table.set_columns:
            if (steady := without_jitter.get(f"{name}: {column}")) and steady.num_ignored:
                noise, least = (shown(x, dimension_of(kind_of_set(column))) for x in (steady.noise, steady.least_turn))
                yield (
                    f"{name}: {column} jitters by {noise} (standard deviation), and {steady.num_ignored} of its turns "
                    f"of {least} or less are taken for noise; if they are real, give the noise of {column}"
                )


def warnings_of_inputs(
    fit: LeastSquaresFit, tables: Sequence[Measurements], model: BenchModel, given: Mapping[str, Any]
) -> Iterator[str]:
    """Noise of what was set that was not `given`: what was found for it, and where nothing could be."""
    for label in fit.evidence.estimated_inputs:
        noise = shown(fit.input_noise[label], dimension_of(kind_of_set(label.rpartition(": ")[2])))
        yield (
            f"{label} was not given a noise; the readings of a row deviate together, as {noise} of noise in it would "
            "cause (standard deviation), and the intervals contain it; give it if you know it, 0 for none"
        )
    for name in many_levels(model, tables, given):
        yield (
            f"{name}: what was set has too many levels for an estimate of its noise, and the intervals do not contain "
            "it; give the noise of base_tension or displacement, 0 if it is exact, or fit one reading for each hold"
        )


def warnings_of_numbers(fit: LeastSquaresFit, moved: Mapping[str, float]) -> Iterator[str]:
    """A friction that no real body has, and estimates that the increments of a history have `moved` too far."""
    for name, part in moved.items():
        if not part <= LARGEST_MOVE:
            what = f"the increments of the history move {name} by {part:.2g} of its standard error"
            yield f"{what}; give more short_steps"
    mu = fit.value.get("friction_coefficient", 0.0)
    if mu > LARGEST_FRICTION and fit.status["friction_coefficient"] == IDENTIFIED:
        yield (
            f"friction_coefficient = {mu:.3g} is far above that of any tendon; check the units of the tables, "
            "for instance radians in a column of degrees"
        )


def warnings_of_kinematics(tables: Sequence[Measurements], manipulator: Manipulator) -> Iterator[str]:
    """The published kinematics, where the shape of a real body was read."""
    if manipulator.kinematics == "published" and _hold_shape(tables):
        yield (
            "tip angles or positions are fitted in the published kinematics, which bends 5 to 10 % less at 40 % loss; "
            "use the exact one for a real body"
        )


def warnings_of_trials(fit: LeastSquaresFit, groups: Sequence[Group]) -> Iterator[str]:
    """Readings that differ from trial to trial, although no parameter does."""
    for group in groups:
        trials = group.table.trial[group.there]
        exact = np.max(np.abs(fit.residuals[group.label]), initial=0.0) <= EXACT * np.max(np.abs(group.observed))
        if TRIALS in fit.parameters or exact:  # rounding errors may differ from trial to trial
            continue
        columns = (trials[:, None] == np.unique(trials)).astype(float)
        columns -= columns.mean(axis=0)  # by how much each trial is off the mean of all
        if chance_of_more(fit.evidence, fit.standardised_residuals, group.label, columns) < CHANCE:
            yield f"{group.label} differs from trial to trial by more than its scatter; try per_trial"


def warnings_of_solves(ends: Sequence[SolveResults]) -> Iterator[str]:
    """Rows whose solves ended in a way that is worth a note."""
    for solves in ends:
        for status in NOTEWORTHY:
            contradicted = status is Status.direction_contradicted
            which = solves.contradicted if contradicted else solves.ended(status)
            if np.any(which):
                where = f"{np.count_nonzero(which)} of {np.count_nonzero(solves.read)} rows"
                yield f"{where}, {rows_in_words(named_rows([solves.table], [which]))}: {words_of(status)}"


def drift_of(fit: LeastSquaresFit, group: Group) -> str:
    """In words, that the residuals of a group with a history drift from the first step to the last; "" if not.

    Two more parameters of the linearised model are tested: an error that grows with the step, and one that grows with
    step times reading.
    """
    course = group.experiment.course
    if course is None or course.each_from_rest:
        return ""
    last = np.zeros(len(course.first_row))
    np.maximum.at(last, course.trial, course.step)
    time = (course.step / np.maximum(last[course.trial], 1.0) - 0.5)[group.there]
    size = np.max(np.abs(group.observed), initial=1e-300)
    problem = fit.minimum.problem
    noise = np.ravel(problem.data.noise[problem.groups.index(group.label)])
    columns = np.stack([time, time * group.observed / size], axis=1) / noise[:, None]
    chance = chance_of_more(fit.evidence, fit.standardised_residuals, group.label, columns)
    if chance >= CHANCE:
        return ""
    return (
        f"{group.label}: residuals drift from the first row to the last (p = {chance:.1g}); does the body creep, or "
        "the zero of an instrument? Measure faster, or wait at each level"
    )


def neighbours(residuals: Mapping[str, np.ndarray], groups: Sequence[Group]) -> tuple[float, list[str]]:
    """How far standardised residuals of neighbouring rows of histories are correlated, and the groups of these rows.

    0 as in `correlation_of_rows`.
    """
    found, labels, trials = [np.zeros(0)], [np.zeros(0, int)], 0
    every = [group for group in groups if group.experiment.in_order]
    for group in every:
        course = group.experiment.course
        assert course is not None
        trial, step = (np.asarray(own)[group.there] for own in (course.trial, course.step))
        order = np.lexsort((step, trial))
        found.append(residuals[group.label][order])
        labels.append(trials + trial[order])
        trials += 1 + int(np.max(trial, initial=0))
    correlation = correlation_of_rows(np.concatenate(found), np.concatenate(labels))
    return min(correlation, MOST_ALIKE), [group.label for group in every]


def held_in_words(residuals: Mapping[str, np.ndarray], group: Group) -> str:
    """That standardised residuals within the holds of a group are correlated, and what helps; "" where they are not."""
    table = group.table
    order = table.order[group.there[table.order]]
    holds = holds_of(table)[order]
    correlation = correlation_of_rows(residuals[group.label][(np.cumsum(group.there) - 1)[order]], holds)
    if not correlation:
        return ""
    return (
        f"{group.label}: readings of one hold are alike (correlation {correlation:.2f} of residuals from row to row), "
        f"and {holds.size} in {np.unique(holds).size} holds are not as many independent ones: standard errors are too "
        "small; fit one reading for each hold (average_holds, --average-holds)"
    )


def variance_of_neighbours(correlation: float) -> float:
    """The variance of means of correlated readings over that of independent ones, of a first-order autoregression."""
    return (1 + correlation) / (1 - correlation)


def neighbours_in_words(correlation: float) -> str:
    """That residuals of neighbouring rows are alike, and what was done."""
    return (
        f"residuals of neighbouring rows are alike (correlation {correlation:.2f}), as a wrong model makes them: "
        f"standard errors and intervals are {np.sqrt(variance_of_neighbours(correlation)):.1f} times those of "
        "independent readings"
    )


def shown_unit(name: str) -> tuple[float, str]:
    """The factor from SI to the unit that engineers use for a parameter, and that unit after a space."""
    scale, unit = preferred(parameter_named(name).dimension)
    return scale, f" {unit}" if unit else ""


def parameter_shown(found: Determination, name: str) -> tuple[float, float, float, float, str]:
    """Value, standard error and interval of a parameter in the unit that engineers use, and that unit."""
    scale, unit = shown_unit(name)
    numbers = found.value[name], found.standard_error[name], *found.confidence_interval[name]
    value, error, low, high = (scale * number for number in numbers)
    return value, error, low, high, unit


def error_in_words(known: Determination, name: str) -> str:
    """The standard error of a parameter: relative where it is positive, else in its unit; "open" where it has none."""
    error, value, kind = known.standard_error[name], known.value[name], parameter_named(name)
    if not np.isfinite(error):
        return "open"
    return f"{100 * error / abs(value):.2g} %" if kind.positive else shown(error, kind.dimension)


def so_far_in_words(fit: LeastSquaresFit) -> list[str]:
    """A line for each fitted parameter of a search that was interrupted."""
    own = [name for name in fit.names if not name.startswith(TRIALS)]
    shown = [(name, *shown_unit(name)) for name in own]
    misfit, group = fit.minimum.misfit
    lines = [f"{name} = {scale * fit.value[name]:.4g}{unit} so far: not identified" for name, scale, unit in shown]
    return [*lines, f"misfit {100 * misfit:.3g} % of the scatter of {group}"]


def estimates_in_words(found: Determination, bounded_above: Sequence[str] = ()) -> list[str]:
    """A line for each parameter and combination, in the unit that engineers use."""
    lines = []
    for name, status in found.status.items():
        value, error, low, high, unit = parameter_shown(found, name)
        if status == IDENTIFIED:
            lines.append(f"{name} = {value:.4g} +- {error:.2g}{unit} (95 %: {low:.4g} to {high:.4g}{unit}): identified")
        elif status != NOT_IDENTIFIED:
            limit = f", at most {high:.4g}{unit} (95 %)" if name in bounded_above else ""
            lines.append(f"{name} = {value:.4g}{unit}: {status}{limit}")
        elif name in bounded_above:
            lines.append(f"{name}: at the lower bound {low:.4g}{unit}, at most {high:.4g}{unit} (95 %): not identified")
        else:
            lines.append(f"{name}: not identified")
    for found_together, parts in ((found.combinations, "factors"), (found.sums, "terms")):
        for name, (value, error, _) in found_together.items():
            number = f"{value:.4g} +- {error:.2g} {unit_of(name)}"
            lines.append(f"{name} = {number}: identified, although its {parts} are not")
    return lines


def _hold_shape(tables: Sequence[Measurements]) -> bool:
    """Whether the tables hold tip angles or positions."""
    return any(of_shape(column) for table in tables for column in table.columns)


def advice_on(fit: LeastSquaresFit, tables: Sequence[Measurements], lost: set[str]) -> str:
    """What measurement would separate the parameters that these data do not separate."""
    unknown = f"The data do not determine {', '.join(sorted(lost))}"
    if pasts := sorted(filter(is_past, lost)):
        return (
            f"The data do not determine {', '.join(pasts)}: a tension before the first row has an effect only if the "
            "release to that row has not reached the tip. Leave it fixed, or start from rest."
        )
    if fit.sums:
        return (
            f"{unknown}. Some have the same effect: only the sums and differences above are determined. Fix one "
            "parameter of each, or give it a prior."
        )
    if any(map(is_driven_by_length, tables)):
        return (
            f"{unknown}. cddf plan says by how much other measurements would help: a load cell at the tip, a known "
            "weight there, a marker in the middle, loops of other amplitudes and speeds. Or give a value that is "
            "measured in another way, or a prior."
        )
    if _hold_shape(tables):
        pulley = " (friction: a pulley test)" if "friction_coefficient" in lost else ""
        return (
            f"{unknown}, although they hold tip angles or positions. Each needs a value that is measured in another "
            f"way{pulley}, or a prior."
        )
    if all("pulling_tension" in table for table in tables):
        return (
            "A pulley test determines the friction alone. Add tip tensions, tip angles or tip positions of the "
            "manipulator."
        )
    return f"{unknown}. Add tip angles or tip positions, a pulley test (friction alone), or a prior."
