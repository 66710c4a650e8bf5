"""Tables of measurements: what is understood, what is refused with its place, what deserves a look."""

import hashlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from refusals import refused

from cddf_jax.errors import InputError
from cddf_jax.measurements.table import Measurements, read_measurements
from cddf_jax.measurements.table_warnings import warnings_of
from cddf_jax.measurements.trials import repeated_tables

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


def test_a_pulley_test_and_what_a_name_says(tmp_path):
    table = read(tmp_path, "wrap_angle [deg], weight [N], pulling_tension [N]\n90, 10, 19.3\n", "pulley.csv")
    assert table["wrap_angle"].tolist() == [np.pi / 2]
    assert not table.simulated
    assert read(tmp_path, PAIRS, "load_cells_Simulated.csv").simulated


@settings(max_examples=25)
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
    (PAIRS + "15\n", "row 4 has 1 cells, the header 2; fill the row"),
    (PAIRS + "15,2,13,1\n", "row 4 has 4 cells, the header 2; with decimal commas separate the columns by semicolons"),
    (PAIRS + "\n15, abc\n", "row 5, column tip_tension: 'abc' is not a number; give a number or remove the row"),
    (PAIRS + "nan, 13\n", "row 4, column base_tension: must be finite, got nan; give a number or remove the row"),
    (_with("tip_x [mm]").replace("4.79", "").replace("9.19", "-"), "no row holds a reading (tip_x); add the"),
    (PAIRS + "-15, 5\n", "row 4, column base_tension: must be 0 or more, got -15 N; check its sign and the zero of"),
    (_with("tip_tension"), "row 1: the column tip_tension needs a unit of force, got none;"),
    (_with("tip_x [N]"), "tip_x needs a unit of length, got [N]; write for example [mm]"),
    (_with("tip_tension [Nn]"), "got [Nn] with the unknown unit 'Nn'; write for example [N]"),
    (_with("tip_tensoin [N]"), "row 1: unknown column 'tip_tensoin'; did you mean tip_tension? Rename it, or"),
    (_with("T_base_0 [N]"), "unknown column 'T_base_0'; did you mean base_tension?"),  # tendons count from 1
    (_with("tip_tension [g]"), "needs a unit of force, got [g]; write for example [N]; a mass is not a force: did you"),
    (_with("direction"), "row 2, column direction: must be 1 or -1, got 4.79; write 1 where"),
    (PAIRS.replace("tip_tension", "base_tension"), " and 'base_tension [N]' both are the column base_tension; remove"),
    ("base_tension [N]  tip_tension [N]\n5 4", "is no header (lines with # are notes); write names and units such"),
    ("a" * 10**6, "row 1: is not CSV (field larger than field limit"),
    (PAIRS.replace("base_tension", "tip_tension_2"), "the column base_tension is missing; add it"),
    (PAIRS.replace("base_tension", "weight"), "the column tip_tension does not belong to a pulley test; put it into a"),
    ("weight [N], wrap_angle [rad]\n1, 1", "the column pulling_tension is missing; add it (a pulley test has wrap"),
    ("trial, base_tension [N]\n , 3", "row 2, column trial: the cell is empty; fill it"),
    ("5, 4.79\n10, 9.19", "row 1: '5' is no header (lines with # are notes); write names and units such"),
    (PAIRS.replace(", ", ";") + "5;4,79", "row 4, column tip_tension: '4,79' has a comma, but row 2, column"),
    (PAIRS + '"1,234.5", 5', "row 4, column base_tension: '1,234.5' is not a number; write it with a decimal"),
    (PAIRS + '"15", "5', "row 4: is not CSV (unexpected end of data); remove a misplaced quotation mark there"),
    (PAIRS.encode("utf-16-le"), "is not text in UTF-8, UTF-16 or Latin-1; save it as CSV UTF-8"),  # without its mark
    (b"PK\x03\x04\x14\x00\x06\x00" + bytes(range(256)), "is not a spreadsheet in the format .xlsx (File is not a zip"),
    (b"\xd0\xcf\x11\xe0" + bytes(range(256)), "is a spreadsheet in the old format .xls; save it as .xlsx or as CSV"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), CASES)
def test_bad_files_are_refused(tmp_path, text, message):
    said = refused(read, tmp_path, text)
    assert message in said
    assert said.startswith(f"{tmp_path / 'table.csv'}: ")
    assert len(said) < 600


# --- tables from arrays --------------------------------------------------------------------------


def test_from_columns():
    base = np.array([5.0, 10.0])
    table = Measurements.from_columns("bench", base_tension=base, tip_tension=[4, 9], trial=[3, 3])
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
        ({"base_tension": [1, 2], "tip_tension": [1]}, "bench: the columns differ in length ({'base_tension': 2, 't"),
        ({"base_tension": []}, "bench: has no rows; add measurements"),
        ({"base_tension": 5.0}, "bench: column base_tension: needs one list of numbers, got shape ()"),
        ({"base_tension": ["a"]}, "bench: column base_tension: text cannot be used, got 'a'; give the number alone,"),
        ({"base_tensoin": [1]}, "bench: unknown column 'base_tensoin'; did you mean base_tension?"),
    ],
)
def test_from_columns_refuses(columns, message):
    with pytest.raises(InputError) as error:
        Measurements.from_columns("bench", **columns)
    assert str(error.value).startswith(message)


# --- what deserves a look ------------------------------------------------------------------------

TWO = {"base_tension": [9, 8], "base_tension_2": [10, 20]}


@pytest.mark.parametrize(
    ("columns", "warning"),
    [
        ({"base_tension": [5, 10], "tip_tension": [4, 9]}, None),
        (
            {"base_tension": [10, 20, 75, 30, 20, 10], "tip_angle": [0.1, 0.2, 0.7, 0.6, 0.4, 0.2]},
            "below that of the row before: 2 of 6 (row 4: 30 N after 75 N)",
        ),
        ({"base_tension": [10, 75, 30, 10], "direction": [1, 1, -1, -1]}, "1 of 4 (row 3: 30 N after 75 N)"),
        ({"base_tension": [10, 40, 75, 30, 10], "step": range(5)}, None),  # a path
        ({"base_tension": [10, 10, 10], "base_tension_2": [10, 75, 30]}, "base_tension_2 below that of the row before"),
        ({"base_tension": [10, 75.1, 75, 75.2, 10.1, 75.3]}, None),  # noise at a level, a fresh start at the lowest
        ({"base_tension": [10, 75, 30, 40], "trial": ["a", "a", "b", "b"]}, None),  # another trial
        ({"base_tension": [0, 0.1, 20], "tip_tension": [0.05, 0.15, 19]}, None),  # noise about 0
        ({"base_tension": [10, 20], "tip_tension": [9, 21.5]}, "(row 2: 21.5 N over 20 N); are the cells swapped"),
        (TWO | {"tip_tension_2": [12, 19], "direction_2": [1, 1]}, "base_tension_2: 1 of 2 (row 1: 12 N over 10 N)"),
        # sliding out the tip tension is the larger one, by the capstan law
        (TWO | {"tip_tension_2": [12, 24], "direction_2": [-1, -1]}, None),
        # of several tendons an unstated direction is found with the equilibrium, and may be either
        (TWO | {"tip_tension_2": [12, 19]}, None),
        ({"base_tension": [10, 20], "tip_tension": [13, 26], "direction": [-1, -1]}, None),  # sliding out
        (
            {"wrap_angle": [90, 180], "weight": [5, 5], "pulling_tension": [9, 18]},
            "wrap_angle beyond 5 turn(s): 2 of 2 (row 1: 90 rad)",
        ),
        ({"wrap_angle": [np.pi / 2, 6 * np.pi], "weight": [5, 5], "pulling_tension": [9, 18]}, None),
        (
            {"base_tension": [0, 10, 20], "tip_tension": [-0.1, 9, -0.2], "tip_angle": [0, np.nan, 0.3]},
            "rows with tip_tension below 0: 2 of 3 (row 1: -0.1 N); has the zero of the cell drifted?",
        ),
    ],
)  # fmt: skip
def test_warnings(columns, warning):
    table = Measurements.from_columns(**columns)
    found = warnings_of(table, in_order=table.ordered)
    assert len(found) == (warning is not None)
    assert warning is None or warning in found[0]


# --- tables told apart ---------------------------------------------------------------------------


def test_the_checksum_is_that_of_names_and_numbers(tmp_path):
    table = read(tmp_path, PAIRS)
    # SHA-256 of the columns as the docstring defines it, written out
    numbers = struct.pack("<2d", 5, 10), struct.pack("<2d", 4.79, 9.19)
    text = b"base_tension\0" + b"2\0" + numbers[0] + b"tip_tension\0" + b"2\0" + numbers[1]
    assert table.checksum == hashlib.sha256(text).hexdigest()
    same = [
        read(tmp_path, "# a note\n" + PAIRS.replace("\n", "\r\n"), "other.csv"),
        read(tmp_path, "base_tension [kN]\ttip_tension [mN]\n0.005\t4790\n0.01\t9190\n"),
        Measurements.from_columns(base_tension=[5, 10], tip_tension=[4.79, 9.19]),
    ]
    assert {other.checksum for other in same} == {table.checksum}
    other = Measurements.from_columns(base_tension=[5, 10], tip_tension=[4.79, np.nextafter(9.19, 10)])
    assert other.checksum != table.checksum


def test_tables_given_twice(tmp_path):
    one, copy = read(tmp_path, PAIRS, "a.csv"), read(tmp_path, PAIRS.replace("\n", "\r\n"), "b.csv")
    other = read(tmp_path, PAIRS + "15, 13\n", "a.csv")
    assert repeated_tables([one, other]) == []
    assert repeated_tables([]) == []
    twice = "holds the same numbers as table 1 (a.csv), which thus count twice and make standard errors too small"
    expected = [f"{name}: {twice}; leave one out" for name in ("b.csv: table 3", "a.csv: table 4")]
    assert repeated_tables([one, other, copy, one]) == [line.replace(": holds", " holds") for line in expected]
