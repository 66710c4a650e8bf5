"""Files as laboratories have them, made up for these tests.

Each holds the numbers of a plain file. These are the expected ones; they went into every other file by hand.
"""

import io
import re

import numpy as np
import pytest
from bodies import paper_body
from refusals import refused

import cddf_jax as cddf
from cddf_jax.cli.options import read_data
from cddf_jax.errors import InputError
from cddf_jax.measurements.table import Measurements, read_measurements
from cddf_jax.measurements.trials import read_tables, trials_together

PLAIN = "base_tension [N],tip_tension [N]\n5,4.79\n10,9.19\n20,17.02\n"
LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nTime_Pref\tRelative\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t3\t3\t\nX_Dimension\tTime\tTime\t\n***End_of_Header***\t\t\t\n"
)


def write(tmp_path, content, name="bench.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def read(tmp_path, content, columns=None, name="bench.csv"):
    return read_measurements(write(tmp_path, content, name), columns)


def spreadsheet(**sheets):
    """The content of an .xlsx file: rows of cells by the name of the sheet."""
    openpyxl = pytest.importorskip("openpyxl")
    book, content = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for cells in rows:
            sheet.append(cells)
    book.save(content)
    return content.getvalue()


@pytest.mark.parametrize(
    ("content", "first_row"),
    [
        ("\ufeff" + PLAIN, 2),  # byte-order mark
        (PLAIN.replace("\n", "\r\n"), 2),
        (PLAIN.replace(",", ";"), 2),
        (PLAIN.replace(",", "\t").encode("utf-16"), 2),  # "Unicode text" of spreadsheets
        (b"\xfe\xff" + PLAIN.replace(",", "\t").encode("utf-16-be"), 2),
        (PLAIN.replace("\n", ",\n"), 2),  # separators at the end of every line
        (PLAIN.replace("10,", '# the cell was zeroed here, with a 5" key\n\n10,'), 2),  # a note between rows
        ('"base_tension [N]","tip_tension [N]"\n"5","4.79"\n"10", "9.19"\n"20","17.02"\n', 2),  # as R writes it
        ("sep=;\n" + PLAIN.replace(",", ";").replace(".", ","), 3),
        (("# Prüfstand 3\n" + PLAIN).encode("latin-1"), 3),
        ("Zeit [s],Tbase_N,T_tip (N),Bemerkung\n0,5,4.79,\n1,10,9.19,gut\n2,20,17.02\n", 2),
        ("Base Tension [N],TIP  TENSION (Newton)\n5,4.79\n10,9.19\n20,17.02\n", 2),
        ("base_tension_N,tip_tension_mN\n5,4790\n10,9190\n20,17020\n", 2),
        ("base_tension,tip_tension\nAI 0,AI 1\nN,mN\n5,4790\n10,9190\n20,17020\n", 4),
        ("HBM_CATMAN\n\nTime 1\tbase_tension\ttip_tension\nMX840\tCH 1\t2\ns\tN\tN\n0\t5\t4.79\n1\t10\t9.19\n"
         "2\t20\t17.02\n", 6),
        ("Channel,Name,Unit,Range\n1,base_tension,N,50\n2,tip_tension,N,50\n\nbase_tension,tip_tension\nN,N\n5,4.79\n"
         "10,9.19\n20,17.02\n", 7),
        ("t;base_tension;tip_tension [N]\ns;[N];\n0;5;4,79\n1;10;9,19\n2;20;17,02\n", 3),
        (LABVIEW + "X_Value\tT_base [N]\tT_tip [N]\tComment\n0,0\t5\t4,79\n0,1\t10\t9,19\n0,2\t20\t17,02\n", 13),
        ("# Rig 3\n# " + PLAIN, 3),  # as NumPy's savetxt writes it
        ("Rig: 3, tendon: steel\nMeasured by, A. N. Other\n\n" + PLAIN, 5),
        (",base_tension [N],tip_tension [N]\n0,5,4.79\n1,10,9.19\n2,20,17.02\n", 2),  # as pandas writes an index
        ('base_tension [N],"tip_tension\n[N]",note\n5,4.79,"wet,\nand 5 °C"\n10,9.19,\n20,17.02,\n', 3),
        (PLAIN + "30,\n,\n", 2),
        ("base_tension [N],tip_tension [N],tip_angle [deg]\n5,4.79,\n10,9.19,n/a\n20,17.02,-\n", 2),
    ],
)  # fmt: skip
def test_each_file_gives_the_numbers_of_the_plain_one(tmp_path, content, first_row):
    plain, table = read(tmp_path, PLAIN, name="plain.csv"), read(tmp_path, content)
    assert table.checksum == plain.checksum
    assert table.rows[0] == first_row


def test_how_a_file_was_read_is_said(tmp_path):
    head = "Prüfstand 3\nZeit [s],Tbase,T_tip (N)\n,N,\n".encode("latin-1")
    table = read(tmp_path, head + b"0,5,4.79\n1,10,9.19\n2,20,\n")
    assert table.read_as == (
        "bench.csv: the file is not UTF-8; it was read as Windows-1252 (Latin-1)",
        "bench.csv: the header is row 2; the text above it from row 1 on is taken for notes",
        "bench.csv: row 3 holds the units",
        "bench.csv: read as: 'Tbase' base_tension [N], 'T_tip (N)' tip_tension [N]",
        "bench.csv: columns that are not used: 'Zeit [s]'",
        "bench.csv: rows without a reading are left out: 1 of 3 rows (row 6 first)",
    )
    assert str(table).splitlines()[1:] == list(table.read_as)


def test_rows_are_counted_as_in_the_file(tmp_path):
    text = 'sep=;\nRig 3\n\nBase Tension;tip_tension;note\nN;N;\n5;4,79;\n\n# zeroed\n10;9,19;"two\nlines"\n20;x;\n'
    with pytest.raises(InputError, match="row 11, column tip_tension: 'x' is not a number"):
        read(tmp_path, text)
    table = read(tmp_path, text.replace("x", "17,02").replace("Rig 3", "Simulated, seed 1"))
    assert table.rows.tolist() == [6, 9, 11]
    assert table.simulated  # said above the header


# --- which column --------------------------------------------------------------------------------


def test_columns_by_their_names_in_the_file(tmp_path):
    text = "F1 [N],F2,tip_tensoin,t\n,N,,s\n5,4.79,1,0\n10,9.19,1,1\n20,17.02,1,2\n"
    meant = {"F1": "base_tension", "F2": "tip_tension [N]", "tip_tensoin": ""}
    table = read(tmp_path, text, meant)
    assert table.checksum == read(tmp_path, PLAIN, name="plain.csv").checksum
    assert "read as: 'F1 [N]' base_tension [N], 'F2' tip_tension [N]" in table.read_as[1]
    with pytest.raises(InputError, match=r"bench.csv: has no column 'F3'; use"):
        read(tmp_path, text, meant | {"F3": "tip_angle [deg]"})
    with pytest.raises(InputError, match=r"unknown column 'tension \[N\]'; did you mean tip_tension"):
        read(tmp_path, text, meant | {"t": "tension [N]"})
    twice = "row 1: 'F1 \\[N\\]' and 'F2' both are the column base_tension; remove one"
    with pytest.raises(InputError, match=twice):
        read(tmp_path, text, meant | {"F2": "base_tension [N]"})


def test_two_headers_are_refused(tmp_path):
    """The first is the header, and the second no row of numbers; also one that knows more."""
    for below in (PLAIN, PLAIN.replace("\n", ",1\n").replace(",1", ",tip_angle [deg]", 1)):
        assert ": row 5" in refused(read, tmp_path, PLAIN + below)
    few = "trial,direction,base_tension [N]\na,in,5\n"  # few numbers in a row
    assert "row 3, column direction: 'direction' is not a number" in refused(read, tmp_path, few + few)


def test_units_in_header_and_row_below_must_agree(tmp_path):
    said = read(tmp_path, "base_tension,cell\nN,kN\n5,4.79\n", {"cell": "tip_tension [N]"})
    assert said["tip_tension"] == 4.79  # what the user says wins
    with pytest.raises(InputError, match="row 2, column tip_tension: the unit is kN, but N in the header; keep one"):
        read(tmp_path, "base_tension,tip_tension [N]\nN,kN\n5,4\n")


def test_directions_in_words(tmp_path):
    words = ["loading", "Unloading", "in", "OUT", "up", "down", "pull", "release", "+1", "-1", "1.0", "+", "-"]
    rows = "".join(f"{i + 5},{i + 4},{word}\n" for i, word in enumerate(words))
    table = read(tmp_path, "base_tension [N],tip_tension [N],direction (in/out)\n" + rows)
    assert table["direction"].tolist() == [1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, 1, -1]
    with pytest.raises(InputError, match="row 2, column direction: 'sideways' is not a number; write loading, load,"):
        read(tmp_path, "base_tension [N],tip_tension [N],direction\n5,4,sideways\n")


# --- unknown columns -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "base", "tip"),
    [
        ("Kraft_unten (N);Kraft_oben (N)\n5,0;4,79\n10,0;9,19\n20,0;17,02\n".encode("latin-1"),
         "Kraft_unten", "Kraft_oben"),
        ("Prüfstand 3;;\nNr.;Kraft unten;Kraft oben;Bemerkung\n1;5,0;4,79;\n2;10,0;9,19;gut\n3;20,0;17,02;\n",
         "Kraft unten", "Kraft oben"),
        ("Zeit;Kraft unten;Kraft oben\ns;mN;N\n0,1;5000,0;4,79\n0,2;10000,0;9,19\n0,3;20000,0;17,02\n",
         "Kraft unten", "Kraft oben"),
        (LABVIEW + "X_Value\tBase\tTip\tComment\n0,0\t5\t4,79\n0,1\t10\t9,19\n0,2\t20\t17,02\n", "Base", "Tip"),
    ],
)  # fmt: skip
def test_a_header_without_a_known_name_is_found(tmp_path, text, base, tip):
    """The message names the heads, and the option that says which one is missing."""
    path = write(tmp_path, text)
    said, unit = refused(read_tables, [path]), "mN" if b";mN;" in path.read_bytes() else "N"
    missing, _, heads = said.partition(", where NAME is one of ")
    assert missing.endswith(
        'the column base_tension is missing; add it, or say which one it is by --column "NAME=base_tension [N]"'
    )
    assert f"'{base}" in heads
    (table,) = read_tables([path], {base: f"base_tension [{unit}]", tip: "tip_tension [N]"})
    assert table.checksum == read(tmp_path, PLAIN, name="plain.csv").checksum


def test_a_column_that_was_asked_for_and_is_not_there_is_an_error(tmp_path):
    cells = write(tmp_path, "base_tension [N],tip_tension [N],A [deg],A [rad]\n5,4,1,2\n")
    for asked in ("B=tip_angle [deg]", "C="):
        name = asked.partition("=")[0]
        with pytest.raises(InputError, match=re.escape(f"bench.csv: no column {name!r}; check")):
            read_data([cells], [asked])
    with pytest.raises(InputError, match="no column 'A'; check the name"):
        read_data([cells], ["A [deg]=", "A [rad]=", "A=tip_angle [deg]"])
    with pytest.raises(InputError, match="no file of data: no column 'A'; check the name"):
        read_data([], ["A=tip_angle [deg]"])


# --- spreadsheets --------------------------------------------------------------------------------


def test_a_spreadsheet(tmp_path):
    rows = [["Rig 3"], [], ["Tbase (N)", "Tip tension (N)", "note"], [5, 4.79], [10, 9.19, "wet"], [], [20, 17.02]]
    table = read(tmp_path, spreadsheet(Remarks=[["made up"]], Run=rows), name="bench.xlsx")
    assert table.checksum == read(tmp_path, PLAIN).checksum
    assert table.rows.tolist() == [4, 5, 7]
    assert table.read_as[0] == "bench.xlsx: the sheet 'Run' is read; not used: 'Remarks'"
    assert table.notes == ("Rig 3",)


def test_spreadsheets_that_are_refused(tmp_path):
    rows = [["base_tension [N]", "tip_tension [N]"], [5, "broken"]]
    with pytest.raises(InputError, match="row 2, column tip_tension: 'broken' is not a number"):
        read(tmp_path, spreadsheet(Run=rows), name="bench.xlsx")
    with pytest.raises(InputError, match="holds tables in the sheets 'A', 'B'; save each in a file of its own"):
        read(tmp_path, spreadsheet(A=rows, B=rows), name="bench.xlsx")
    with pytest.raises(InputError, match="is empty; write a header such as"):
        read(tmp_path, spreadsheet(A=[]), name="bench.xlsx")


NEVER = "row {}: the formula '{}' was never computed; open the file in a spreadsheet program and save it, or put"


def test_formulas_that_were_never_computed(tmp_path):
    """Openpyxl writes formulas without values."""
    heads = ["trial", "base_tension [N]", "tip_tension [N]", "mean"]

    def book(row):
        return spreadsheet(Run=[heads, ["a", 5, 4.79, "=B2"], row])

    assert len(read(tmp_path, book(["a", 10, 9.19, "=B3"]), name="bench.xlsx")) == 2  # in a column that is not used
    for content, said in (
        (book(["a", 10, "=B3*0.9"]), NEVER.format("3, column tip_tension", "=B3*0.9")),
        (book(["=A2", 10, 9.19]), NEVER.format("3, column trial", "=A2")),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            read(tmp_path, content, name="bench.xlsx")


# --- trials in files of their own ----------------------------------------------------------------


def test_files_of_the_same_columns_are_trials(tmp_path):
    again = PLAIN.replace("4.79", "4.81")
    paths = [write(tmp_path, PLAIN, "run_1.csv"), write(tmp_path, "Rig 3\n" + again, "run_2.csv")]
    pulley = write(tmp_path, "wrap_angle [deg],weight [N],pulling_tension [N]\n90,10,19.3\n", "pulley.csv")
    table, other = read_tables([*paths, pulley])
    assert (table.name, table.trial_labels, other.name) == ("run_1.csv, run_2.csv", ("run_1", "run_2"), "pulley.csv")
    assert table["trial"].tolist() == [0, 0, 0, 1, 1, 1]
    assert table["tip_tension"].tolist() == [4.79, 9.19, 17.02, 4.81, 9.19, 17.02]
    assert [table.place(i) for i in (0, 5)] == ["row 2 of run_1.csv", "row 5 of run_2.csv"]
    assert table.read_as[-1].startswith("run_1.csv, run_2.csv: the same columns and no column trial, so each file is")
    assert table.read_as[0].startswith("run_2.csv: the header is row 2")
    with pytest.raises(InputError, match=r"run_2.csv: row 3, column tip_tension"):
        read_tables([paths[0], write(tmp_path, again.replace("4.81", "x").replace("5,", "\n5,", 1), "run_2.csv")])


def test_a_trial_without_any_reading_of_a_column_is_a_trial(tmp_path):
    head = "base_tension [N], tip_tension [N], tip_angle [deg], tip_x [mm]\n"
    texts = [f"{head}5, {4.7 + 0.01 * k}, {angle}, \n10, 9.2, {angle}, \n" for k, angle in enumerate((3, "", 4))]
    paths = [write(tmp_path, text, f"run_{k}.csv") for k, text in enumerate(texts, 1)]
    (table,) = read_tables(paths)
    assert table.trial_labels == ("run_1", "run_2", "run_3")
    np.testing.assert_allclose(np.degrees(table["tip_angle"]), [3, 3, np.nan, np.nan, 4, 4], rtol=1e-12)
    assert (table.unread, "tip_x" in table) == (("tip_x",), False)
    assert "run_2.csv: tip_angle holds no number and is not used" in table.read_as
    assert table.left_out == 0
    (joined,) = read_tables([write(tmp_path, f"{text}15, , , \n", f"gap_{k}.csv") for k, text in enumerate(texts)])
    assert joined.left_out == 3  # rows without a reading, which a history without a column step must know of
    (same,) = read_tables(paths[1::-1])  # the file without readings first
    np.testing.assert_allclose(np.degrees(same["tip_angle"]), [np.nan, np.nan, 3, 3], rtol=1e-12)


def test_files_that_stay_apart(tmp_path):
    named = "trial," + PLAIN.replace("\n", "\na,").removesuffix("a,")
    table = read(tmp_path, PLAIN)
    assert trials_together([table, table]) == (table, table)  # given twice, of which `fit` warns
    labelled = [read(tmp_path, named, name=f"{i}.csv") for i in (1, 2)]
    assert trials_together(labelled) == tuple(labelled)
    assert trials_together([]) == ()


def test_a_column_that_some_files_have(tmp_path):
    paths = [write(tmp_path, PLAIN, "a.csv"), write(tmp_path, PLAIN.replace("tip_tension [N]", "cell"), "b.csv")]
    tables = read_tables(paths, {"cell": "tip_tension [N]"})
    assert [table.checksum for table in tables] == [tables[0].checksum] * 2
    with pytest.raises(InputError, match="no column 'cells'"):
        read_tables(paths[:1], {"cells": "tip_tension [N]"})


# --- readings that are missing -------------------------------------------------------------------

PULLS = np.array([10.0, 30.0, 50.0, 60.0])
TENSIONS, ANGLES = np.array([9.1, 23.8, 34.9, 39.6]), np.array([0.16, 0.45, 0.72, 0.85])  # made up, about right
NOISE = {"tip_tension": 0.5, "tip_angle": 0.02}


@pytest.mark.slow
def test_the_other_readings_of_a_row_count():
    """With known noise a fit is the same where the rows with and without the reading are tables of their own."""
    body = paper_body("exact", outer_radius=0.015)
    gap = np.where(np.arange(4) == 2, np.nan, TENSIONS)
    table = Measurements.from_columns("gap", base_tension=PULLS, tip_tension=gap, tip_angle=ANGLES)
    assert table.has("tip_tension").tolist() == [True, True, False, True]
    kept = table.has("tip_tension")
    read_twice = {"base_tension": PULLS[kept], "tip_tension": TENSIONS[kept], "tip_angle": ANGLES[kept]}
    both = Measurements.from_columns("both", **read_twice)
    angle = Measurements.from_columns("angle", base_tension=PULLS[~kept], tip_angle=ANGLES[~kept])
    one, other = cddf.fit(body, table, noise=NOISE), cddf.fit(body, [both, angle], noise=NOISE)
    for name in ("friction_coefficient", "youngs_modulus"):
        np.testing.assert_allclose(one.value[name], other.value[name], rtol=1e-7)  # the optimiser's own tolerance
        np.testing.assert_allclose(one.standard_error[name], other.standard_error[name], rtol=1e-5)
    assert one.residuals["gap: tip_tension"].shape == (3,)
