"""Tables of measurements: what is understood, what is refused with its place, what deserves a look."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cddf_jax.errors import InputError
from cddf_jax.measurements import Measurements, read_measurements

PAIRS = """base_tension [N], tip_tension [N]
5, 4.79
10, 9.19
"""


def read(tmp_path, text, name="table.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_measurements(path)


# --- what is understood --------------------------------------------------------------------------


def test_columns_in_si_with_labels_rows_and_notes(tmp_path):
    table = read(
        tmp_path,
        "# Bench 3, SIMULATED\n#seed 1\n\n"
        "trial, base_tension [N], tip_tension [kN], tip_angle [deg], tip_x [mm], base_tension_2 [N], direction\n"
        "B, 5, 4.79e-3, 180, 120.4, 0, 1\n\n"
        "A, 10, 9.19e-3, -90, 119, 1, -1\n"
        "B, 15, +.013, 0, 118, 2, 1",
    )
    assert (table.name, len(table), table.simulated) == ("table.csv", 3, True)
    assert table.notes == ("Bench 3, SIMULATED", "seed 1")
    assert table.rows.tolist() == [5, 7, 8]  # lines of the file as counted in an editor
    assert table.trial_labels == ("B", "A")
    assert table["trial"].tolist() == [0, 1, 0]
    assert table["direction"].tolist() == [1, -1, 1]
    np.testing.assert_allclose(table["tip_x"], [0.1204, 0.119, 0.118], rtol=1e-15)
    np.testing.assert_allclose(table["tip_tension"], [4.79, 9.19, 13.0], rtol=1e-15)
    np.testing.assert_allclose(table["tip_angle"], [np.pi, -np.pi / 2, 0], rtol=1e-15)
    assert "base_tension_2" in table
    assert "tip_y" not in table
    assert all(column.dtype == np.float64 for column in table.columns.values())


def test_a_pulley_test(tmp_path):
    table = read(tmp_path, "wrap_angle [deg], weight [N], pulling_tension [N]\n90, 10, 19.3\n", "pulley.csv")
    assert table["wrap_angle"].tolist() == [np.pi / 2]
    assert not table.simulated


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + PAIRS,  # byte-order mark
        PAIRS.replace("\n", "\r\n"),
        PAIRS.replace(", ", ";"),
        PAIRS.replace(", ", ";").replace(".", ","),  # decimal commas
        PAIRS.replace(", ", " ;\t").replace(".", ","),
        PAIRS.replace("base_tension [N]", '"base_tension [N]"'),  # as R writes it
        PAIRS + "\n,\n , \n",  # blank rows, as Excel leaves them
        PAIRS.rstrip(),
    ],
)
def test_dialects_of_csv(tmp_path, text):
    table = read(tmp_path, text)
    assert table["base_tension"].tolist() == [5, 10]
    assert table["tip_tension"].tolist() == [4.79, 9.19]


def test_trials_of_different_length_and_unsorted_rows_stay_as_they_are(tmp_path):
    table = read(tmp_path, "trial, base_tension [N], tip_tension [N]\n2, 20, 17\n1, 5, 4\n2, 10, 9\n")
    assert table.trial_labels == ("2", "1")
    assert table["base_tension"].tolist() == [20, 5, 10]
    assert table.warnings == ()


def test_simulated_is_read_off_the_name(tmp_path):
    assert read(tmp_path, PAIRS, "load_cells_Simulated.csv").simulated


def test_a_million_rows(tmp_path):
    base = np.random.default_rng(0).uniform(0, 85, 1_000_000).round(4)
    body = "\n".join(f"{t},{0.6 * t:.5f}" for t in base.tolist())
    table = read(tmp_path, "base_tension [N],tip_tension [N]\n" + body)
    np.testing.assert_array_equal(table["base_tension"], base)


@given(hnp.arrays(np.float64, (7, 2), elements=st.floats(0, 1e300)))
def test_numbers_are_read_to_the_last_bit(tmp_path_factory, values):
    path = tmp_path_factory.getbasetemp() / "exact.csv"
    path.write_text("base_tension [N], tip_tension [N]\n" + "\n".join(f"{a!r}, {b!r}" for a, b in values.tolist()))
    table = read_measurements(path)
    np.testing.assert_array_equal(np.stack([table["base_tension"], table["tip_tension"]], axis=1), values)


# --- what is refused -----------------------------------------------------------------------------


def _with(header):
    return PAIRS.replace("tip_tension [N]", header)


CASES = [
    ("", "is empty; write a header such as 'base_tension [N], tip_tension [N]' and rows below it"),
    ("# only notes\n\n", "is empty; write a header"),
    (PAIRS.splitlines()[0], "has a header but no rows; add the measurements below it"),
    (PAIRS + "15\n", "row 4 has 1 cells, the header 2; fill the row"),
    (PAIRS + "15,2,13,1\n", "row 4 has 4 cells, the header 2; with decimal commas separate the columns by semicolons"),
    (PAIRS + "\n15, abc\n", "row 5, column tip_tension: 'abc' is not a number; give a number or remove the row"),
    (PAIRS + "1_5, 3\n", "row 4, column base_tension: '1_5' is not a number"),
    (PAIRS + "15, 13 N\n", "row 4, column tip_tension: '13 N' is not a number"),
    (PAIRS + "15,\n", "row 4, column tip_tension: the cell is empty; give a number or remove the row"),
    (PAIRS + "15, nan\n", "row 4, column tip_tension: must be finite, got nan; give a number or remove the row"),
    (PAIRS + "inf, 5\n", "row 4, column base_tension: must be finite, got inf"),
    (PAIRS + "-15, 5\n", "row 4, column base_tension: must be 0 or more, got -15 N; check its sign and the zero of"),
    (PAIRS.replace("[N]", "[kN]") + "3, -5e-3\n", "row 4, column tip_tension: must be 0 or more, got -5 N"),
    (_with("tip_tension"), "row 1: the column tip_tension needs a unit of force, got none;"),
    (_with("tip_tension []"), "row 1: the column tip_tension needs a unit of force, got none;"),
    ("# a\n" + _with("tip_tension [mm]"), "row 2: the column tip_tension needs a unit of force"),
    (_with("tip_x [N]"), "tip_x needs a unit of length, got [N]; write for example [mm]"),
    (_with("tip_tension [Nn]"), "got [Nn] with the unknown unit 'Nn'; write for example [N]"),
    (_with("tip_tensoin [N]"), "unknown column 'tip_tensoin'; did you mean tip_tension? Known"),
    (_with("Tip tension [N]"), "unknown column 'Tip tension'; did you mean tip_tension?"),
    (_with("base_tension_1 [N]"), "unknown column 'base_tension_1'; did you mean base_tension?"),
    (_with("tip_x_2 [mm]"), "unknown column 'tip_x_2'; did you mean tip_x?"),
    (_with("colour"), "unknown column 'colour'; Known are trial, direction, base_tension,"),
    (_with("direction [N]"), "row 1: the column direction has no unit, got [N]; leave it out"),
    (_with("direction"), "row 2, column direction: must be 1 or -1, got 4.79; write 1 where"),
    (PAIRS.replace("tip_tension", "base_tension"), "row 1: the column base_tension appears twice; remove one"),
    (_with(""), "row 1, column 2: '' is no column; write 'name [unit]'"),
    (_with("tip [N] [N]"), "row 1, column 2: 'tip [N] [N]' is no column"),
    (PAIRS.replace("base_tension", "tip_tension_2"), "the column base_tension is missing; add it"),
    (PAIRS.replace("tip_tension", "tip_tension_3"), "the column base_tension_3 is missing; add it"),
    (PAIRS.replace("base_tension", "weight"), "the column tip_tension does not belong to a pulley test; put it into a"),
    ("weight [N], wrap_angle [rad]\n1, 1", "the column pulling_tension is missing; add it (a pulley test has wrap"),
    ("trial, base_tension [N]\n , 3", "row 2, column trial: the cell is empty; fill it"),
    ("5, 4.79\n10, 9.19", "unknown column '5'; Known are"),
    (PAIRS.encode("utf-16"), "is not UTF-8 text; save it as CSV UTF-8"),
    (PAIRS.encode() + b"\xe9", "is not UTF-8 text"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), CASES)
def test_bad_files_are_refused(tmp_path, text, message):
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert message in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 'table.csv'}: ")
    assert "\n" not in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"none.csv: cannot be read \(No such file or directory\); check the path"):
        read_measurements(tmp_path / "none.csv")
    with pytest.raises(InputError, match=r": cannot be read \(Is a directory\); check the path"):
        read_measurements(tmp_path)


# --- tables from arrays --------------------------------------------------------------------------


def test_from_columns():
    base = np.array([5.0, 10.0])
    table = Measurements.from_columns(name="bench", base_tension=base, tip_tension=[4, 9], trial=[3, 3])
    assert (table.name, len(table), table.rows.tolist(), table.trial_labels) == ("bench", 2, [1, 2], ("3",))
    assert table["tip_tension"].dtype == np.float64
    base[0] = 7.0
    assert table["base_tension"][0] == 5.0
    with pytest.raises(ValueError, match="read-only"):
        table["base_tension"][0] = 7.0


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({}, "bench: the column base_tension is missing; add it"),
        (
            {"base_tension": [1, 2], "tip_tension": [1]},
            "bench: the columns differ in length ({'base_tension': 2, 'tip_",
        ),
        ({"base_tension": []}, "bench: has no rows; add measurements"),
        ({"base_tension": 5.0}, "bench: column base_tension: needs one list of numbers, got shape ()"),
        ({"base_tension": ["a"]}, "bench: column base_tension: not every value is a number; give numbers in SI units"),
        ({"base_tension": [1, -2]}, "bench: row 2, column base_tension: must be 0 or more, got -2 N"),
        ({"base_tension": [1], "tip_x": [np.inf]}, "bench: row 1, column tip_x: must be finite, got inf"),
        ({"base_tensoin": [1]}, "bench: unknown column 'base_tensoin'; did you mean base_tension?"),
    ],
)
def test_from_columns_refuses(columns, message):
    with pytest.raises(InputError) as error:
        Measurements.from_columns(name="bench", **columns)
    assert str(error.value).startswith(message)


# --- what deserves a look ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("columns", "warnings"),
    [
        ({"base_tension": [5, 10], "tip_tension": [4, 9]}, ()),
        ({"base_tension": [5]}, ("there is one row only, from which no scatter can be estimated",)),
        (
            {"base_tension": [5, 5], "trial": ["a", "b"]},
            ("all 2 rows are equal, so that nothing can be told from their differences",),
        ),
        (
            {"base_tension": [9, 5, 9, 5], "tip_tension": [8, 4, 8, 4]},
            ("rows that repeat an earlier one to the last digit: 2 of 4 (row 3 is row 1 again); were they copied?",),
        ),
        ({"base_tension": [9, 5, 9], "trial": ["a", "a", "b"]}, ()),  # another trial may read the same
        ({"base_tension": [10, 20], "tip_tension": [10.4, 19]}, ()),  # noise
        (
            {"base_tension": [10, 20], "tip_tension": [9, 21.5]},
            (
                "rows with tip_tension more than 5 % above base_tension: 1 of 2 (row 2: 21.5 N over 20 N); "
                "are the cells swapped or off zero?",
            ),
        ),
        ({"base_tension": [10, 20], "tip_tension": [13, 26], "direction": [-1, -1]}, ()),  # sliding out
    ],
)
def test_warnings(columns, warnings):
    assert Measurements.from_columns(**columns).warnings == warnings
