"""Rows that a fit leaves out: how they are named, and what is left of a table."""

from dataclasses import replace

import numpy as np
import pytest

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.measurements.left_out import rows_in_words, without
from cddf_jax.measurements.trials import read_tables

TENSION = np.linspace(5.0, 40.0, 8)


def table(name="bench", **columns):
    readings = columns or {"tip_tension": 0.8 * TENSION, "tip_angle": 0.02 * TENSION}
    return cddf.Measurements.from_columns(name, base_tension=TENSION, **readings)


@pytest.mark.parametrize("rows", ["2, 4-6", "2 4 - 6", "2;4,5-6", [2, 4, 5, 6], {"bench": "2, 4-6"}], ids=str)
def test_ways_to_name_rows(rows):
    (found,), left_out = without([table()], rows)
    assert left_out == {"bench": [2, 4, 5, 6]}
    assert np.flatnonzero(np.isnan(found["tip_tension"])).tolist() == [1, 3, 4, 5]  # rows are counted from 1
    assert np.flatnonzero(np.isnan(found["tip_angle"])).tolist() == [1, 3, 4, 5]
    np.testing.assert_array_equal(found["base_tension"], TENSION)  # they stay as steps of a path
    assert rows_in_words(left_out) == "rows 2, 4-6 of bench"


def test_rows_of_files(tmp_path):
    """Two files with the same columns are the trials of one table, and a row is counted in its own file."""
    paths = [tmp_path / "run_1.csv", tmp_path / "run_2.csv"]
    for path in paths:
        path.write_text("base_tension [N], tip_tension [N]\n10, 8\n20, 15\n30, 21\n")
    tables = read_tables(paths, {})
    (*_, found), left_out = without(tables, {"run_2.csv": "3"})
    assert left_out == {"run_2.csv": [3]}  # the second row of data is line 3
    assert np.flatnonzero(np.isnan(found["tip_tension"])).tolist() == [len(found) - 2]
    with pytest.raises(InputError, match="say of which file, such as"):
        without(tables, "3")


def test_files_of_one_name_are_told_apart():
    tables = [replace(table(), files=("run_1.csv",), name=name) for name in ("cells", "angles")]
    _, left_out = without(tables, {"run_1.csv (2)": [3]})
    assert left_out == {"run_1.csv (2)": [3]}


def test_a_column_without_a_reading_is_gone():
    once = table(tip_tension=0.8 * TENSION, tip_angle=np.where(np.arange(8) == 2, 0.1, np.nan))
    (found,), _ = without([once], [3])
    assert "tip_angle" not in found


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("9", "leave_out: bench has no row 9; rows are counted as in the file"),
        ("5-3", "leave_out '5-3': 5-3 ends before it begins; write 3-5"),
        ("two", "leave_out 'two': 'two' is not a row; write rows such as"),
        ([1.5], "leave_out: needs the numbers of rows, got"),
        ({"other": [1]}, "leave_out: there is no file 'other'; there are bench"),
        ("1-8", "leave_out: no reading of bench is left; leave out fewer rows, or the whole table"),
    ],
    ids=str,
)
def test_refusals(rows, words):
    with pytest.raises(InputError) as error:
        without([table()], rows)
    assert words in str(error.value)
