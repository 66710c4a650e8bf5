"""A path in a file: the tensions, displacements or angles that a bench went through, in their order in time."""

import os
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from ..errors import InputError, within
from ..files.csv_table import read_table
from ..quantities import dimension_of
from ..units import Dimension
from .columns import how_to_say
from .order import check_order, order_of
from .table import KIND, check_rows

DRIVEN = ("base_tension", "displacement", "tip_angle")  # the first that the file has is the path


class PathFile(NamedTuple):
    """A path that was read from a file."""

    values: list[float]  # SI
    dimension: Dimension
    read_as: tuple[str, ...]  # how the file was read
    described: set[str]  # names of columns that the caller described and the file has


def read_path_file(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> PathFile:
    """The column `base_tension` of a file with the unit in its header, or else `displacement` or `tip_angle`.

    The order is that of the column `step`, or without it that of the rows, in which a column `time` may not go back.

    Args:
        path: CSV or .xlsx; other columns are not used.
        columns: by the head of a column in the file, what it is; the file need not have all of them.

    Raises:
        InputError: names the file, row (line), column, value and remedy; also for several trials.
    """
    table = read_table(path, KIND, columns)
    with within(path):
        named = [name for name in DRIVEN if name in table.columns]
        if not named:
            what = f"has no column with a path ({' or '.join(DRIVEN)}, with its unit)"
            raise InputError(what, where=f"row {table.header}", remedy=how_to_say("base_tension [N]", table.unused))
        driven, *others = named
        trials = list(dict.fromkeys(table.columns.get("trial", np.zeros(0)).tolist()))
        if len(trials) > 1:
            raise InputError(
                f"holds {len(trials)} trials, but a path is one trial; keep the rows of one, such as {trials[0]}"
            )
        values = table.columns[driven]
        demand = partial(check_rows, driven, values, table.rows)
        demand(np.isfinite(values), "must be finite", "correct or remove the row")
        demand((values >= 0) | (driven != "base_tension"), "must be 0 or more", "correct or remove the row")
        check_order(table.columns, table.rows)
    said = [f"the path is {driven}; not used: {', '.join(others)}"] if others else []
    values = values[order_of(table.columns)]
    return PathFile(values.tolist(), dimension_of(driven), (*table.read_as, *said), table.described)
