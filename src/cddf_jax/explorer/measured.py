"""The tables of the explorer: their readings by a body in their rows. Loaded with the first table, as `fit` is."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ..identification.bench import Bench, Pulley, experiment_of
from ..identification.course import course_of, has_history
from ..identification.parameters import BenchSetting
from ..measurements.table import Measurements
from ..robot.manipulator import Manipulator
from .answers import where_good

NODES = 16  # of the solves in the rows of tables, as `fit` has them


def readings_in_rows(
    tables: Sequence[Measurements], body: Manipulator, setting: BenchSetting
) -> list[tuple[Measurements, dict[str, np.ndarray]]]:
    """As `Exploration.in_rows`, for tables that can be followed."""
    experiments = ((table, _experiment(table, body, setting)) for table in tables)
    apart = [(table, rows) for table, rows in experiments if isinstance(rows, Bench) and not rows.on_one_curve]
    return [(table, jax.tree.map(np.asarray, _in_rows(rows, body))) for table, rows in apart]


def can_be_followed(table: Measurements, body: Manipulator, setting: BenchSetting) -> bool:
    """Whether a body in space can follow the order of the rows, if it matters."""
    return not has_history(table, None) or _is_exact(table, body, setting)


def _experiment(table: Measurements, body: Manipulator, setting: BenchSetting) -> Pulley | Bench:
    """A table as an experiment, with a history if the order of its rows is known and can be followed."""
    ordered = has_history(table, None) and _is_exact(table, body, setting)
    return experiment_of(table, body, course=course_of(table)[0] if ordered else None, setting=setting)


def _is_exact(table: Measurements, body: Manipulator, setting: BenchSetting) -> bool:
    """Whether a history of these rows has an exact answer: one tendon without loads."""
    loaded = any(column.startswith("tip_force") and np.any(table[column]) for column in table.columns)
    return body.num_tendons == 1 and not loaded and setting.loads is None


@eqx.filter_jit
def _in_rows(rows: Bench, body: Manipulator) -> dict[str, Array]:
    shown = rows.shown(body, {}, NODES)
    readings = rows.readings(shown, rows.columns, {})
    return dict(zip(readings, where_good(shown.status, tuple(readings.values())), strict=True))
