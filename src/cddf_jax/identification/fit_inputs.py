"""What `fit` takes: the course of each table, and the noise of what was set and of what was read."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError
from ..estimation.observations import Noise
from ..measurements.columns import column_dimension, is_reading
from ..measurements.jitter import Steady
from ..measurements.readings import SET, kind_of_set, of_tendons
from ..measurements.table import Measurements
from ..numerics.given_numbers import check_numbers
from ..robot.manipulator import Manipulator
from ..units import si_unit
from .bench import Bench, Group, Pulley, experiment_of
from .course import EACH, SHORT_STEPS, Course, course_of, how_followed, paths_of
from .parameters import MOTORS, BenchSetting, along_a_path
from .tension_before import Before, first_guesses, pasts_of

Numbers = ArrayLike | Sequence[ArrayLike] | Sequence[Sequence[float]]
Conditions = Mapping[str, Numbers]


def courses_of(
    manipulator: Manipulator,
    tables: Sequence[Measurements],
    history: bool | str | None,
    before: Before,
    free: Sequence[str],
    noise: Mapping[str, float],
    short_steps: int,
    setting: BenchSetting,
) -> tuple[list[tuple[Course, dict[str, Steady]] | None], dict[str, tuple[float, float]]]:
    """The course of each table, None without a history; guesses of pasts."""
    paths = [paths_of(table, history) for table in tables]
    counts = [len(own or ()) for own in paths]
    pasts = pasts_of(counts, before, free)
    names = *free, *setting.given
    along = along_a_path(manipulator, names)
    for table, rows in zip(tables, paths, strict=True):
        if along and not rows and "pulling_tension" not in table:
            what = f"{table.name}: {', '.join(along)} act along a history, and the rows have none"
            raise InputError(what, remedy="add a column step or time, or give history=True (--history)")
    how = how_followed(manipulator, names, setting.loads)
    needed = next((name for name in along if name in MOTORS), "")
    for table in tables:
        for own in table.set_columns:
            if needed and own.by_length and not np.all(own.rows):
                place = f"{table.name}: {table.place(int(np.argmin(own.rows)))}, column {own.column}"
                what = f"{place}: a base tension sets the tendon there, and {needed} takes displacements in all rows"
                raise InputError(what, remedy=f"clear the base tensions of this tendon, or leave {needed} out")
    courses = [
        course_of(table, noise, own, short_steps, paths=rows, **how) if rows else None
        for table, rows, own in zip(tables, paths, pasts, strict=True)
    ]
    known = [(own, course[0]) for own, course in zip(pasts, courses, strict=True) if course]
    first = [(own, np.asarray(course.readings)[:, 0, 0]) for own, course in known]
    return courses, first_guesses(first)


def unread_table(name: str, conditions: Conditions, num_tendons: int, read: Sequence[str]) -> Measurements:
    """A table whose readings are not known yet.

    Args:
        name: of the table.
        conditions: what is set, by column, SI: numbers, or lists of one length. Further tendons have no tension where
            none is given.
        num_tendons: of the body.
        read: the columns that are read.

    Raises:
        InputError: for lists of several lengths, and as `Measurements.from_columns`.
    """
    given = {column: np.atleast_1d(np.asarray(value, float)) for column, value in conditions.items()}
    count = max((values.size for values in given.values()), default=0)
    for column, length in zip(*(of_tendons(kind, num_tendons) for kind in SET), strict=True):
        if column != "base_tension" and length not in given and "weight" not in given:
            given.setdefault(column, np.zeros(1))
    lengths = {column: values.size for column, values in given.items() if values.size not in (1, count)}
    if lengths:
        raise InputError(f"{name}: {', '.join(lengths)} must hold 1 or {count} numbers; give lists of one length")
    columns = {column: np.broadcast_to(values, (count,)) for column, values in given.items()}
    return Measurements.from_columns(name, **columns, **{column: np.zeros(count) for column in read})


def unread_rows(
    table: Measurements,
    body: Manipulator,
    setting: BenchSetting,
    parameters: Sequence[str],
    history: bool | str | None = None,
    short_steps: int = SHORT_STEPS,
) -> Pulley | Bench:
    """The rows of a table whose readings are not known yet; what was set is exact. Arguments as in `fit`.

    `parameters`: those that are fitted. Where friction acts along a history only, rows without an order are each
    pulled from rest.
    """
    acting = along_a_path(body, (*parameters, *setting.given))
    course, paths = None, paths_of(table, EACH if acting and not (history or table.ordered) else history)
    if paths:
        how = how_followed(body, (*parameters, *setting.given), setting.loads)
        course, _ = course_of(table, dict.fromkeys(SET, 0.0), short_steps=short_steps, paths=paths, **how)
    return experiment_of(table, body, course=course, setting=setting, free=("angle_zero",))  # readings are no zeros


def split_noise(
    noise: Mapping[str, float | Noise], tables: Sequence[Measurements]
) -> tuple[dict[str, float | Noise], dict[str, float]]:
    """The noise of the predicted columns, and that of what was set."""
    columns = {own.column for table in tables for own in table.set_columns}
    columns |= {*map(kind_of_set, columns)} - {column for table in tables for column in table.columns}
    base: dict[str, float] = {}
    for column, given in noise.items():
        if isinstance(given, Noise) and column not in columns:
            continue
        check_numbers(f"noise of {column}", [given])
        number = np.asarray(given, float)
        if number.ndim or not number >= 0:
            unit = si_unit(column_dimension(column) or "dimensionless")
            raise InputError(f"noise of {column} must be one standard deviation in {unit}, 0 or more")
        base |= {column: float(number)} if column in columns else {}
    read = {own.column for table in tables for own in table.set_columns if np.any(table.has(own.column) & ~own.rows)}
    read |= {column for table in tables for column in table.columns if is_reading(column, table.columns)}
    predicted = {column: given for column, given in noise.items() if column not in base or column in read}
    return predicted, base


def trials_of(table: Measurements) -> tuple[str, ...]:
    """The labels of trials in which friction may differ; a pulley test has the mean friction of all trials."""
    return () if "pulling_tension" in table else table.trial_labels


def noise_of(groups: Sequence[Group], noise: Mapping[str, float | Noise]) -> dict[str, float | Noise | None]:
    """By group, the given noise of its column, or None.

    Raises:
        InputError: for a column that no table holds.
    """
    columns = {group.column for group in groups}
    for column in set(noise) - columns:
        held = ", ".join(sorted(columns))
        raise InputError(f"fit: noise is given for {column!r}, which no table holds; they hold {held}")
    return {group.label: noise.get(group.column) for group in groups}
