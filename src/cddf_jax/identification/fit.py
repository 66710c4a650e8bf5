"""`fit`: friction, modulus and the errors of the bench from measurements; and what the data do not determine."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from ..errors import InputError, within
from ..estimation.determination import FIXED, NOT_IDENTIFIED, Determination, Estimate, determine, estimate
from ..estimation.evidence import Evidence
from ..estimation.least_squares import LeastSquaresFit, least_squares_fit
from ..estimation.observations import Noise
from ..estimation.parameter_space import Bounds, Priors
from ..estimation.whole_search import INTERRUPTED
from ..measurements.jitter import Steady
from ..measurements.left_out import LeaveOut, rows_in_words, without
from ..measurements.loop_sense import runs_backwards
from ..measurements.markers import marker_column
from ..measurements.table import Measurements
from ..measurements.trials import repeated_tables
from ..numerics.given_numbers import check_whole
from ..robot.manipulator import Manipulator
from ..statics.arguments import refuse_batch
from . import bench, verdict
from .camera import camera_start, check_reach, unexplained_pose
from .course import CLOSE, EACH, SHORT_STEPS
from .fit_inputs import Conditions, courses_of, noise_of, split_noise, trials_of, unread_rows
from .parameters import (
    PLAIN,
    TRIALS,
    BenchSetting,
    camera_parameters,
    check_tendons,
    free_parameters,
    parameter_named,
    starting_value,
    stiffness_parameter,
    with_parameters,
)
from .predictions import (
    Numbers,
    Prediction,
    beyond_the_data,
    moved_by_finer_steps,
    rows_to_predict,
)
from .random_effects import errors_of_base, fit_trials
from .rivals import Rival, rivals_of
from .tension_before import Before

POSITIVE = (0.0, None)


@dataclass(frozen=True, kw_only=True)
class Fit(LeastSquaresFit):
    """The result of `fit`, in SI units; friction and stiffness have the status "fixed" where they were not free."""

    manipulator: Manipulator  # with the estimates; where a parameter is not identified, one of many that fit
    tables: tuple[Measurements, ...]  # the data
    model: bench.BenchModel  # the bench: from parameters to readings
    trial_effects: dict[str, Estimate]  # by table and trial, ln(mu of the trial / mu); empty without `per_trial`
    trial_spread: float  # standard deviation of ln(mu) over trials; 0 if none was found, NaN without `per_trial`
    neighbours: float  # correlation of residuals of neighbouring rows of histories; 0 if it may be chance
    widened: Evidence  # with more noise where neighbours are alike; of it are statuses, standard errors and intervals
    solve_results: tuple[verdict.SolveResults, ...]  # how the solves of each table of the manipulator ended
    without_jitter: dict[str, Steady]  # by table and column that was set, of tables with a history
    options: dict[str, Any]  # the arguments of `fit` besides body and data, and the names of the free parameters

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: what the data determine, what they do not determine, and what measurement would help."""
        lines = [] if self.success else [f"The fit failed: {self.result}. No parameter is identified."]
        left_out = self.options["leave_out"]
        lines += [f"Left out: {rows_in_words(left_out)}."] if left_out else []
        interrupted = self.result == INTERRUPTED
        lines += verdict.so_far_in_words(self) if interrupted else verdict.estimates_in_words(self, self.bounded_above)
        if TRIALS in self.parameters:
            lines.append(
                f"friction differs from trial to trial by {100 * self.trial_spread:.2g} % (standard deviation)"
            )
        lost = {name for name, status in self.status.items() if status == NOT_IDENTIFIED} - {*self.bounded_above}
        return *lines, *([verdict.advice_on(self, self.tables, lost)] if lost and self.success else [])

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about tables, statistics and solver, in words."""
        tables = self.tables
        return (
            *verdict.warnings_of_rows(tables, self.model, self.without_jitter),
            *verdict.warnings_of_inputs(self, tables, self.model, self.options["noise"]),
            *verdict.warnings_of_numbers(self, self.moved_by_steps),
            *(rival.in_words for rival in self.rivals if rival.in_words),
            *repeated_tables(tables),
            *verdict.warnings_of_kinematics(tables, self.manipulator),
            *(remark for remark in self.remarks if not remark.startswith(TRIALS)),
            *verdict.warnings_of_trials(self, self.groups),
            *verdict.warnings_of_solves(self.solve_results),
        )

    @cached_property
    def alone(self) -> dict[str, Determination]:
        """What each table alone, without priors, would determine."""
        labels = {name: [g.label for g in self.groups if g.name == name] for name in self.model.names}
        trials = [name for name in self.evidence.space.names if name.startswith(TRIALS)]
        return {name: determine(self.widened.of(of, trials)) for name, of in labels.items()}

    @property
    def own_names(self) -> list[str]:
        """The parameters that were fitted, without the deviations of trials."""
        return [name for name in self.names if not name.startswith(TRIALS)]

    @property
    def groups(self) -> list[bench.Group]:
        """The groups of data, in the order of the tables and their columns."""
        return bench.groups_of(self.tables, self.model)

    def __str__(self) -> str:
        return "\n".join(self.verdict)

    def predict(self, column: str, conditions: Numbers | Conditions, *, history: bool = False) -> Prediction:
        """Predict a reading, with its 95 % band.

        Args:
            column: "tip_tension", "tip_tension_2", "tip_angle", "tip_x", "tip_y", "tip_axis_x", ..., of a body in space
                "tip_z" as well, or the column of a marker, "x@120mm".
            conditions: base tensions, N, (rows,) where every tendon has the same tension, or (rows, tendons). Or by
                column what is set, as in a table, SI: {"base_tension": 50.0, "force_y@60mm": -1.0}, or
                {"displacement": [0.004, 0.011]} as the encoders read, with "time" where the fit knows a lag; numbers,
                or lists of one length. A further tendon that is not named has no tension.
            history: whether the rows are a path from rest, pulled and released in this order; every turn counts. Else
                each row is an equilibrium of its own, with the directions that `solve` finds. By displacement, where
                friction acts along a history only, where no direction of a row agrees with its travel, and of a fit
                that followed its rows so, each row is pulled from rest, and its forces grow with it.

        Returns:
            `value`, `half_width` (95 %), `extrapolated` and `status` (a code of `Status`), one for each row. Value and
            band are NaN where the model has no solution.

        Raises:
            InputError: for another column, conditions of other shapes, or a path that `fit` could not follow.
        """
        table = rows_to_predict(conditions, self.manipulator.num_tendons, column)
        given = table, self.manipulator, self.whole_setting, self.names
        for way in (history or (self.options["history"] == EACH and EACH), EACH):
            wanted = unread_rows(*given, way, self.options["short_steps"])
            assert isinstance(wanted, bench.Bench)
            shown = wanted.evaluate(self.model.manipulator, self.parameters, self.model.nodes)
            if not np.any(verdict.against(wanted, shown)):
                break
        if column not in shown.readings:
            raise InputError(f"predict: {column!r} is not a reading; there are {', '.join(shown.readings)}")
        band, status = self.band(shown.derivatives[column]), np.asarray(shown.status)
        solved = ~np.isin(status, verdict.OUTSIDE)
        value, half_width = (np.where(solved, own, np.nan) for own in (shown.readings[column], band))
        return Prediction(value, half_width, beyond_the_data(table, self.tables), status)

    @property
    def whole_setting(self) -> BenchSetting:
        """What all rows share, with the markers of the tables."""
        known = {name: place for own in self.tables for name, place in own.markers.items()}
        setting = self.options["setting"]
        return replace(setting, markers={**known, **setting.markers})

    def place(self, group: str, k: int) -> str:
        """The place of reading `k` of a group, in words: its row in the file, or its number where there is no file."""
        one = next(one for one in self.groups if one.label == group)
        row = one.table.place(int(np.flatnonzero(one.there)[k]))
        return f"{row}, {one.column}" if one.table.files else f"{row} of {group}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remarks of any fit; samples of a hold that are not independent; readings with a history that drift."""
        alike = (verdict.held_in_words(self.standardised_residuals, group) for group in self.groups)
        drifts = (verdict.drift_of(self, group) for group in self.groups if self.success)
        wider = verdict.neighbours_in_words(self.neighbours) if self.success and self.neighbours else ""
        return (*super().remarks, *filter(None, (*alike, *drifts, wider)))

    def band(self, sensitivity: np.ndarray) -> np.ndarray:
        """As of any fit, wider where neighbouring rows are alike."""
        return self.widened.uncertainty(sensitivity).half_width

    @cached_property
    def moved_by_steps(self) -> dict[str, float]:
        """By parameter, its error by the increments of a history, over its standard error; {} without increments."""
        return moved_by_finer_steps(self, self.model, self.groups) if self.success else {}

    @cached_property
    def rivals(self) -> list[Rival]:
        """What else may have made the loops of a bench driven by displacement, beside friction on the body."""
        return rivals_of(self, self.tables, self.model, self.options)


def fit(
    manipulator: Manipulator,
    data: Measurements | Sequence[Measurements],
    free: Sequence[str] | None = None,
    priors: Priors | None = None,
    *,
    bounds: Bounds | None = None,
    noise: Mapping[str, float | Noise] | None = None,
    setting: BenchSetting = PLAIN,
    history: bool | Literal["each"] | None = None,
    before: Before = "rest",
    short_steps: int = SHORT_STEPS,
    leave_out: LeaveOut = (),
    per_trial: bool = False,
    starts: int | None = None,
    seed: int = 0,
    nodes: int = 16,
) -> Fit:
    """Fit parameters of a manipulator and its bench to one or several tables at once.

    A table with `weight`, `pulling_tension` and `wrap_angle` is a pulley test and determines friction alone.
    Any other has `base_tension` (and `base_tension_2`, ... for further tendons) or `displacement`, in each row at least
    one of them (with both, the displacement is a reading), and one or more of `tip_tension`, `tip_tension_2`, ...,
    `tip_angle`, `tip_x`, `tip_y`, `tip_axis_x`, ..., of a body in space `tip_z` and `tip_axis_z`, and markers
    (`x@120mm`); `direction`, `tip_force_x` and the others, `force_x@60mm`, `trial`, `step` and `time` are optional.

    With a history, the rows of a trial are steps of a path: pulled, released and pulled again. The path starts from
    rest, or from `before`. Directions follow from the path; a column `direction` is only compared with it. Without a
    history, the whole tendon slides in one direction in each row.

    Args:
        manipulator: the body; its numbers are the start.
        data: a table or several.
        free: what is fitted, of `parameters.PARAMETERS`; None for friction and modulus, of a body without a single
            modulus friction and `stiffness_factor`. It may also be the constant drag per length, gain and zero of the
            cells (`tip_gain`, `base_zero`, `tip_gain_2` for the cell of tendon 2), `pretension`, `angle_zero`, the pose
            of the camera that sees tip and markers (`camera_x`, ..., `camera_turn_z`; "camera" for all of it: its start
            is found from the readings), the direction of gravity (`gravity_turn_x`, ...), and errors of dimensions
            (`outer_radius_error`, `tendon_angle_error`), best with priors. With a history it may be friction besides
            that of tendons on the body (`friction_moment`, `outside_friction`, `outside_drag`), of tendons driven by
            displacement what stands between motor and body (`slack_offset`, `outside_compliance`, `backlash`, `lag`,
            and `tendon_stretch`, 1 / (E A) of the tendon),
            or of one tendon `before` (`before_2` for trial 2), the largest base tension before the first row, N.
        priors: by parameter, mean and standard deviation of a Gaussian, SI units.
        bounds: by parameter, (lower, upper), SI units; default (0, None) for what is positive.
        noise: by column, known standard deviation, SI units, or `Noise(floor, fraction)`; what is not given is
            estimated, for each column of each table, from the residuals. That of `base_tension` is a number, 0 for
            exact base tensions. It also decides which turns a history ignores.
        setting: what all rows share: constant loads such as gravity, positions of markers, known numbers of the bench.
        history: whether each row depends on the rows before it, in the order of the columns `step` or `time`, or else
            in that of the file. "each": every row was pulled from rest, its tensions and forces in proportion; loads
            of `setting`, such as gravity, act before.
            None: yes if the table has one of these columns; else no, and "each" if that contradicts rows.
        before: with a history of one tendon, the tension before the first row: "rest", or the largest base tension, N,
            from which it was released to the first row, as the base cell reads it. One for all trials, or a list with
            one for each, in the order of the tables and of their trials. For a free parameter `before` it is the start
            of the search. For several tendons, write the tensions before a trial as its first row.
        short_steps: into how many increments each step of a history is divided with several tendons or loads, 2 or
            more; the report states the error that they leave.
        leave_out: rows whose readings do not count, by their numbers in the file: [8, 14] or "8, 14, 20-23", and of
            several files by name, {"run_2.csv": [8, 14]}. With a history such a row stays as a step of the path.
        per_trial: let friction differ from trial to trial: ln(mu) has a normal distribution whose spread is estimated.
        starts, seed: as in `least_squares_fit`.
        nodes: as in `solve`.

    Raises:
        InputError: for float32, unknown parameters or columns, tables that do not fit the manipulator, a body whose
            history cannot be followed, directions that contradict the order of the rows, `before` below the first row.
        TypeError: if the first argument is not a manipulator.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"fit: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    refuse_batch("fit", manipulator)
    tables = (data,) if isinstance(data, Measurements) else tuple(data)
    with within("fit"):
        free = free_parameters(manipulator, free)
    if not all(isinstance(table, Measurements) for table in tables):
        raise InputError("fit: data must be tables as read_measurements gives them, one or several")
    given: dict[str, Any] = {
        **{"priors": priors or {}, "bounds": bounds or {}, "noise": noise or {}, "setting": setting, "nodes": nodes},
        **{"history": history, "before": before, "short_steps": short_steps, "per_trial": per_trial},
        **{"starts": starts, "seed": seed},
    }
    with within("fit"):
        tables, left_out = without(tables, leave_out)
    if history not in (None, True, False, EACH):
        raise InputError(f"fit: history must be True, False, None or {EACH!r}, got {history!r}")
    own = [tendon.friction_coefficient is not None for tendon in manipulator.tendons]
    if "friction_coefficient" in free and all(own):
        raise InputError("fit: every tendon has its own friction coefficient; leave theirs out to fit a common one")
    check_whole("fit: short_steps", short_steps, 2)
    if not tables or not free:
        raise InputError("fit: needs a table of measurements and a free parameter")
    check_tendons([*free, *setting.given], manipulator.num_tendons)
    options = given | {"free": list(free), "leave_out": left_out}
    kinds = {name: parameter_named(name) for name in free}
    earlier = np.cumsum([0, *(len(trials_of(table)) for table in tables)])
    with within("fit"):
        noise, of_base = split_noise(noise or {}, tables)
        courses, guesses = courses_of(manipulator, tables, history, before, free, of_base, short_steps, setting)
    experiments = (
        bench.experiment_of(table, manipulator, int(first), course and course[0], setting, free=free)
        for table, first, course in zip(tables, earlier, courses, strict=False)
    )
    model = bench.BenchModel(manipulator, tuple(experiments), nodes)
    named = zip(model.names, courses, strict=True)
    without_jitter = {f"{name}: {own}": one for name, each in named if each for own, one in each[1].items()}
    groups = bench.groups_of(tables, model)
    for name in setting.markers:
        if not any(marker_column(group.column) == (axis, name) for group in groups for axis in "xyz"):
            raise InputError(f"fit: the marker {name!r} is in no table; name its columns x@{name}, y@{name}")
    start = {name: starting_value(manipulator, name, setting.given) for name in free}
    start |= {name: guess for name, (guess, _) in guesses.items()}
    own_bounds = {name: POSITIVE for name, kind in kinds.items() if kind.positive}
    bounds = _with_bounds(own_bounds | {name: (low, None) for name, (_, low) in guesses.items()}, bounds or {})
    sigma = noise_of(groups, noise)
    with within("fit"):
        check_reach(model, groups, free, setting.given)
    pose = camera_parameters(manipulator)
    if set(pose) <= set(free) and not any(name in setting.given or name in bounds for name in pose):
        start |= camera_start(model, groups, start)
    scales = {name: kind.scale for name, kind in kinds.items() if kind.start is not None}
    observed, inputs = {group.label: group.observed for group in groups}, errors_of_base(model, tables, of_base)
    search = partial(least_squares_fit, model, observed=observed, sigma=sigma, inputs=inputs, bounds=bounds)
    in_increments = any(course is not None and course[0].short_steps is not None for course in courses)
    search = partial(search, seed=seed, prefer_start=True, accuracy=CLOSE if in_increments else 0.0)
    if not per_trial:
        statistics = search(start, priors=priors, scales=scales, starts=starts)
        found = _conclude(statistics, tables, model, without_jitter, float("nan"), options)
        if history is None and found.result.startswith(verdict.AGAINST):
            given["history"] = EACH
            return fit(manipulator, data, free, leave_out=leave_out, **given)
        return found
    if "friction_coefficient" not in free or earlier[-1] < 2:
        remedy = "needs a free friction_coefficient and tables whose column trial names 2 or more"
        raise InputError(f"fit: per_trial {remedy}")
    statistics, spread = fit_trials(search, int(earlier[-1]), start, priors or {}, scales, starts)
    return _conclude(statistics, tables, model, without_jitter, spread, options)


def _with_bounds(own: Bounds, given: Bounds) -> Bounds:
    """The bounds of parameters by nature, and given ones; where no lower one is given, that by nature stays."""
    stated = {name: (own.get(name, (None,))[0] if low is None else low, high) for name, (low, high) in given.items()}
    return {**own, **stated}


def _conclude(
    statistics: LeastSquaresFit,
    tables: tuple[Measurements, ...],
    model: bench.BenchModel,
    without_jitter: dict[str, Steady],
    trial_spread: float,
    options: dict[str, Any],
) -> Fit:
    """The result of `fit` from the statistics: the body with the estimates, and how the solves of each table ended."""
    body = model.manipulator
    ends = tuple(verdict.solve_results(statistics.parameters, tables, model, statistics.input_noise))
    groups = bench.groups_of(tables, model)
    followed = [table for table, one in zip(tables, model.experiments, strict=True) if one.in_order]
    reasons = unexplained_pose(statistics, groups, body), verdict.doubt(ends), *map(runs_backwards, followed)
    if statistics.success and (reason := next(filter(None, reasons), "")):
        statistics = statistics.doubted(reason)
    correlation, labels = verdict.neighbours(statistics.standardised_residuals, groups)
    widened = statistics.evidence.enlarged(dict.fromkeys(labels, verdict.variance_of_neighbours(correlation)))
    statistics = replace(statistics, **vars(determine(widened)))
    both = "friction_coefficient", stiffness_parameter(body)
    fixed = {n: starting_value(body, n) for n in both if n not in statistics.names}
    own = [name for name in statistics.names if not name.startswith(TRIALS)]
    of_fixed = {
        "value": fixed,
        "standard_error": dict.fromkeys(fixed, 0.0),
        "confidence_interval": {n: (v, v) for n, v in fixed.items()},
        "status": dict.fromkeys(fixed, FIXED),
    }
    found = vars(statistics)
    kinds = "combinations", "sums"
    together: dict[str, Any] = {kind: {n: e for n, e in found[kind].items() if TRIALS not in n} for kind in kinds}
    trials = [f"{name}: {label}" for name, table in zip(model.names, tables, strict=True) for label in trials_of(table)]
    rows = {n: row for n, row in zip(statistics.names, np.eye(len(statistics.names)), strict=True) if n not in own}
    effects = [estimate(statistics.value[n], widened.uncertainty(row[None])) for n, row in rows.items()]
    return Fit(
        **found | together | {field: {n: found[field][n] for n in own} | more for field, more in of_fixed.items()},
        manipulator=with_parameters(body, {**options["setting"].given, **statistics.parameters}),
        tables=tables,
        model=model,
        trial_effects=dict(zip(trials, effects, strict=True)) if effects else {},
        trial_spread=trial_spread,
        neighbours=correlation,
        widened=widened,
        solve_results=ends,
        without_jitter=without_jitter,
        options=options,
    )
