"""The order in which rows were measured: that of the file, or that of a column `step`. A clock has to agree with it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError

ORDER = ("step", "time")  # columns that say that the order of the rows is known
_BY_TRIAL = "give each run a trial of its own"


def order_of(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """The rows, 0, 1, ..., in the order in which they were measured, trial by trial."""
    keys = [columns[name] for name in ("step", "trial") if name in columns]
    return np.lexsort(keys) if keys else np.arange(len(next(iter(columns.values()))))


def check_order(columns: Mapping[str, np.ndarray], rows: ArrayLike) -> None:
    """Refuse columns `step` and `time` that do not tell the order.

    Args:
        columns: by name; `step`, `time` and `trial` are looked at.
        rows: the number of each row, for messages.

    Raises:
        InputError: names row, column and remedy: a step that comes again after another
            one; a time that goes back without a `step`; a `step` that contradicts both file and time.
    """
    row = np.asarray(rows)
    trial = columns.get("trial", np.zeros(row.size))
    in_file, order = np.argsort(trial, kind="stable"), order_of(columns)
    if "step" in columns:
        _check_steps(columns["step"][in_file], trial[in_file], row[in_file])
    time, own = columns.get("time", np.zeros(row.size))[order], trial[order]
    back = np.flatnonzero((np.diff(time) < 0) & (own[1:] == own[:-1]))
    if not back.size:
        return
    before, i = back[0], back[0] + 1
    went = f"goes back from {time[before]:.9g} s in row {row[order][before]} to {time[i]:.9g} s"
    where = f"row {row[order][i]}, column time"
    if "step" not in columns:
        remedy = f"{_BY_TRIAL}, times that do not start again (with the date), or the order by a column step"
        raise InputError(f"{where}: {went}; {remedy}")
    if np.any(order != in_file):
        raise InputError(f"{where}: {went} in the order of step, not of the file; correct one, or leave time out")


def _check_steps(step: np.ndarray, trial: np.ndarray, row: np.ndarray) -> None:
    """Refuse a step that comes again in its trial with another one in between; the rows are those of the file."""
    new = np.append(True, (step[1:] != step[:-1]) | (trial[1:] != trial[:-1]))
    first: dict[tuple[float, float], int] = {}
    for one, its_trial, at in zip(step[new].tolist(), trial[new].tolist(), row[new].tolist(), strict=True):
        if (before := first.setdefault((its_trial, one), at)) != at:
            again = f"{one:g} again, as in row {before}, after another step"
            remedy = f"number the rows 1, 2, 3, ... as they were measured, or {_BY_TRIAL}"
            raise InputError(f"row {at}, column step: {again}; {remedy}")
