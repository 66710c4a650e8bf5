"""The order in which rows were measured: that of the file, or that of a column `step`. A clock has to agree with it."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..errors import InputError

ORDER = ("step", "time")  # columns that say that the order of the rows is known
_REMEDY = "give each run a trial of its own, a clock that runs on (with the date), or the order by a column step"


def order_of(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """The rows, 0, 1, ..., in the order in which they were measured, trial by trial."""
    keys = [columns[name] for name in ("step", "trial") if name in columns]
    return np.lexsort(keys) if keys else np.arange(len(next(iter(columns.values()))))


def check_order(columns: Mapping[str, np.ndarray], rows: Sequence[int] | np.ndarray) -> list[str]:
    """What the columns `step` and `time` say of the order, in words, where it is not plain.

    Args:
        columns: by name; of the order `step`, `time` and `trial` are looked at.
        rows: the number of each row, for messages.

    Raises:
        InputError: names row, column and remedy, where the order is not known: a step that comes again after another
            one; a time that goes back without a `step`; a `step` that gives another order than file and time.
    """
    trial = columns.get("trial", np.zeros(len(rows)))
    in_file, order = np.argsort(trial, kind="stable"), order_of(columns)
    by_step, said = bool(np.any(order != in_file)), []
    for i, first in _steps_again(columns, trial, in_file):
        again = f"{columns['step'][i]:g} again, as in row {rows[first]}, after another step"
        remedy = "number the rows 1, 2, 3, ... as they were measured, or give each run a trial of its own"
        raise InputError(f"row {rows[i]}, column step: {again}; {remedy}")
    if by_step:
        said.append("the rows are taken in the order of step, not in that of the file")
    time = columns.get("time", np.zeros(len(rows)))
    back = np.flatnonzero((np.diff(time[order]) < 0) & (trial[order][1:] == trial[order][:-1]))
    if not back.size:
        return said
    i, before = order[back[0] + 1], order[back[0]]
    went = f"goes back from {time[before]:.9g} s in row {rows[before]} to {time[i]:.9g} s"
    if "step" not in columns:
        raise InputError(f"row {rows[i]}, column time: {went}; {_REMEDY}")
    if by_step:
        contradicted = "in the order of step, which is not that of the file; correct step or time, or leave one out"
        raise InputError(f"row {rows[i]}, column time: {went} {contradicted}")
    return [f"time {went} (row {rows[i]}); the rows are taken in the order of step"]


def _steps_again(
    columns: Mapping[str, np.ndarray], trial: np.ndarray, in_file: np.ndarray
) -> Iterator[tuple[int, int]]:
    """Rows whose step was there before in their trial, with another one in between, and the first row of that step."""
    if "step" not in columns:
        return
    step, own = columns["step"][in_file], trial[in_file]
    new = np.append(True, (step[1:] != step[:-1]) | (own[1:] != own[:-1]))
    first: dict[tuple[float, float], int] = {}
    for i, key in zip(in_file[new].tolist(), zip(own[new].tolist(), step[new].tolist(), strict=True), strict=True):
        if first.setdefault(key, i) != i:
            yield i, first[key]
