"""Tables of markers: the wide table that each stands for, written by hand, and what is refused."""

import numpy as np
import pytest
from refusals import refused

import cddf_jax as cddf
from cddf_jax.measurements.trials import read_tables

BENCH = "base_tension [N], tip_tension [N]\n10, 9\n20, 17\n30,\n"
LONG = """row, marker, arc_length [mm], offset_y [mm], x [mm], y [mm]
1, head 1, 80, 11, 79.1, 12.3
3, head 1, 80, 11, 75.2, 20.1
2, 120mm, 120, 0, 118, 4.1
3, 120mm, 120, 0, , 6.2
"""


@pytest.fixture
def read(tmp_path):
    """The tables of files that hold these texts, in this order."""

    def of(*texts, columns=None):
        paths = [tmp_path / f"{name}.csv" for name in "abcd"[: len(texts)]]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return read_tables(paths, columns)

    return of


def test_a_row_for_each_marker(read):
    (table,) = read(BENCH, LONG)
    none = np.nan
    wide = {
        "x@head1": [0.0791, none, 0.0752],
        "y@head1": [0.0123, none, 0.0201],
        "x@120mm": [none, 0.118, none],
        "y@120mm": [none, 0.0041, 0.0062],
    }
    for column, values in wide.items():  # the third row has no tip tension, and its markers all the same
        np.testing.assert_allclose(table[column], values, rtol=1e-15)
    assert list(table.markers) == ["head1", "120mm"]
    for marker, place in zip(table.markers.values(), ([0.08, 0.0, 0.011, 0.0], [0.12, 0.0, 0.0, 0.0]), strict=True):
        np.testing.assert_allclose([marker.arc_length, *marker.offset], place, rtol=1e-15)
    assert "a.csv: markers of b.csv: head1, 120mm, in 3 of 3 rows" in table.read_as
    assert cddf.average_holds(table).markers == table.markers


def test_names_that_a_laboratory_gave(read):
    text = "Row;Marker ID;X (mm);Y (mm)\n1;left;79,1;12,3\n"
    (table,) = read("Tbase_N\n10\n", text, columns={"Marker ID": "marker", "Tbase_N": "base_tension [N]"})
    np.testing.assert_allclose([table["x@left"][0], table["y@left"][0]], [0.0791, 0.0123], rtol=1e-15)
    assert table.markers == {}


def test_unknown_columns(read):
    """The message names them with the option that says what they are; a column that is not there is an error."""
    names = "row,marker,EM_X (mm),EM_Y (mm),s [mm]\n1,head,79.1,,80\n"
    said = refused(read, BENCH, names.replace(",,", ",12.3,"))
    assert said.endswith(
        'b.csv: row 1: the column x or y is missing; add it, or say which one it is by --column "NAME=x [mm]", '
        "where NAME is one of 'EM_X (mm)', 'EM_Y (mm)', 's [mm]'"
    )
    (table,) = read(BENCH, names, columns={"EM_X (mm)": "x [mm]", "s [mm]": "arc_length [mm]"})
    np.testing.assert_allclose([table["x@head"][0], table.markers["head"].arc_length], [0.0791, 0.08], rtol=1e-15)
    with pytest.raises(cddf.InputError, match=r"a.csv: no column 'EM_Z \(mm\)'; check the name"):
        read(BENCH, names, columns={"EM_X (mm)": "x [mm]", "EM_Z (mm)": "z [mm]"})
    assert "base_tension" in refused(read, "marker,F [N]\na,5\n")  # no table of markers


def test_trials_and_other_tables(read):
    """Two files with the same markers are trials of one experiment; a marker elsewhere is another experiment."""
    (both,) = read(BENCH, LONG, BENCH.replace("17", "18"), LONG)
    assert both.markers["head1"].arc_length == 0.08
    assert both["x@head1"].size == 6
    assert len(read(BENCH, LONG, BENCH.replace("17", "18"), LONG.replace(", 80, 11", ", 81, 11"))) == 2


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ((LONG, BENCH), "a.csv: is a table of markers; name the file of the measurements just before it"),
        ((BENCH, LONG, LONG), "c.csv: is a table of markers; name the file of the measurements just before it"),
        ((BENCH, LONG.replace("row", "n")), "b.csv: row 1: the column row is missing; add it: 1 for the first row"),
        ((BENCH, LONG.replace("3, 120", "4, 120")), "b.csv: row 5, column row: must be 1 to 3, got 4; the first row"),
        ((BENCH, LONG.replace("3, head", "0, head")), "b.csv: row 3, column row: must be 1 to 3, got 0"),
        ((BENCH, LONG.replace("3, head", "1, head")), "b.csv: the marker 'head1' of row 1 is there 2 times; keep one"),
        ((BENCH, LONG.replace("80, 11, 75", "80, 12, 75")), "b.csv: row 3, column offset_y: 12 mm, but 11 mm in row 2"),
        ((BENCH, LONG.replace("arc_length", "s")), "b.csv: the column offset_y needs a column arc_length"),
        ((BENCH, LONG.replace("y [mm]\n", "y\n")), "b.csv: row 1: the column y needs a unit of length"),
        ((BENCH, LONG.replace("79.1", "far")), "b.csv: row 2, column x: 'far' is not a number"),
        (
            ("base_tension [N], y@120mm [mm]\n10, 9\n", "row,marker,y [mm]\n1,120mm,2\n"),
            "a.csv: the column y@120mm is in ",
        ),
    ],
)
def test_what_is_refused(read, texts, message):
    assert message in refused(read, *texts)
