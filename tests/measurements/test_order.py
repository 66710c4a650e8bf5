"""The order in which rows were measured: what gives it, and what is refused because it does not."""

from typing import Any

import numpy as np
import pytest
from refusals import refused

from cddf_jax.measurements.path_file import read_path_file
from cddf_jax.measurements.table import Measurements, read_measurements

PULLS = (5, 75, 40, 60)


def path_of(tmp_path, head, cells, name="loop.csv"):
    """A file of a loop, simulated, with the given columns before the tensions."""
    rows = "".join(f"{cell},{pull},{0.9 * pull:.3g}\n" for cell, pull in zip(cells, PULLS, strict=True))
    path = tmp_path / name
    path.write_text(f"{head},base_tension [N],tip_tension [N]\n{rows}")
    return path


@pytest.mark.parametrize(
    ("head", "cells", "order"),
    [
        ("time [s]", "0 1 1 2", [0, 1, 2, 3]),  # a coarse clock
        ("Time (hh:mm:ss)", "9:59:59 10:00:00 10:00:01 10:00:02", [0, 1, 2, 3]),
        ("step", "1 1 2 3", [0, 1, 2, 3]),  # samples of one hold
        ("step", "4 1 3 2", [1, 3, 2, 0]),  # a shuffled file
        ("step,time", "4,3 1,0 3,2 2,1", [1, 3, 2, 0]),
        ("step,time", "1,58 2,59 3,0 4,1", [0, 1, 2, 3]),  # the clock shows the second of the minute
        ("trial,time", "a,7 b,0 a,8 b,1", [0, 2, 1, 3]),
        ("trial,step", "a,1 a,2 b,2 b,1", [0, 1, 3, 2]),
    ],
)
def test_the_order(tmp_path, head, cells, order):
    path = path_of(tmp_path, head, cells.split())
    assert read_measurements(path).order.tolist() == order
    if "trial" not in head:
        assert read_path_file(path).values == [PULLS[i] for i in order]


BACK = "column time: goes back from {} s in row {} to {} s; give each run a trial of its own, times that do not start"
AGAIN = "column step: {} again, as in row {}, after another step; number the rows 1, 2, 3, ... as they were measured"


@pytest.mark.parametrize(
    ("head", "cells", "said"),
    [
        ("time [s]", "56 0 4 8", "row 3, " + BACK.format(56, 2, 0)),  # the second of the minute
        ("time [s]", "0 1 0 1", "row 4, " + BACK.format(1, 3, 0)),  # two runs
        ("time [s]", "3 2 1 0", "row 3, " + BACK.format(3, 2, 2)),  # the last row first
        ("Time", "23:59:59 00:00:00 00:00:01 00:00:02", "row 3, " + BACK.format(86399, 2, 0)),  # over midnight
        ("time [s]", "0 1 x 3", "row 4, column time: 'x' is not a time; give a time such as"),
        ("step", "1 2 1 2", "row 4, " + AGAIN.format(1, 2)),  # two runs
        ("step", "1 2 x 3", "row 4, column step: 'x' is not a number"),
        ("step", "1 2 nan 3", "row 4, column step: must be finite"),
        ("step,time", "1,0 3,1 2,2 4,3", "row 3, column time: goes back from 2 s in row 4 to 1 s in the order of step"),
        ("step,time", "1,0 2,1 1,2 2,3", "row 4, " + AGAIN.format(1, 2)),
    ],
)
def test_an_order_that_is_not_known_is_refused_by_row(tmp_path, head, cells, said):
    path = path_of(tmp_path, head, cells.split())
    for read in (read_measurements, read_path_file):
        assert f"{path}: {said}" in refused(read, path)


@pytest.mark.parametrize("head", ["trial,time [s]", "trial,step"])
def test_a_trial_of_its_own_for_each_run(tmp_path, head):
    """The remedy of the message; a trial that comes again has to go on."""
    path = path_of(tmp_path, head, ["a,0", "a,1", "b,0", "b,1"])
    assert [rows.tolist() for rows in read_measurements(path).trials] == [[0, 1], [2, 3]]
    assert "row 5, column" in refused(read_measurements, path_of(tmp_path, head, ["a,0", "a,1", "b,0", "a,0"]))


def test_what_a_path_leaves_out_is_said(tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("tip_angle [deg], base_tension [N]\n60, 75\n50, 40\n")
    assert read_path_file(path).values == [75, 40]
    assert read_path_file(path).read_as == ("the path is base_tension; not used: tip_angle",)


def test_columns_of_python_have_an_order_too():
    columns: dict[str, Any] = {"base_tension": [5, 75, 40], "tip_tension": [4, 45, 45]}
    dates = np.array(["2026-05-04T10:00", "2026-05-04T10:01", "2026-05-04T10:02"], "M8[m]")
    assert Measurements.from_columns("loop", time=dates, **columns)["time"].tolist() == [0, 60, 120]
    for times, said in (
        (dates[::-1], "row 2, column time: goes back"),
        ([0, np.nan, 2], "row 2, column time: must be finite"),
        (["10:00", "x", "10:02"], "row 2, column time: 'x' is not a time"),
    ):
        assert f"loop: {said}" in refused(Measurements.from_columns, "loop", time=times, **columns)


def test_a_spreadsheet_with_times(tmp_path):
    """Dates, times of the day and durations of a cell, as `openpyxl` gives them."""
    from datetime import datetime, time, timedelta

    openpyxl = pytest.importorskip("openpyxl")
    for cells, seconds in (
        ([datetime(2026, 5, 4, 23, 59, 59), datetime(2026, 5, 5)], [0, 1]),
        ([time(10, 0, 0), time(10, 0, 1, 500_000)], [36000, 36001.5]),
        ([timedelta(hours=23), timedelta(hours=25)], [82800, 90000]),
    ):
        book = openpyxl.Workbook()
        for row in (["Time", "base_tension [N]"], [cells[0], 5], [cells[1], 75]):
            book.active.append(row)
        book.save(tmp_path / "loop.xlsx")
        assert read_measurements(tmp_path / "loop.xlsx")["time"].tolist() == seconds
