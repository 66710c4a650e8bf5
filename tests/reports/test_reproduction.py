"""The paper's figures and table, the house style, and files that are whole or absent."""

import json
import os
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread
from places import DATA

from cddf_jax.errors import InputError
from cddf_jax.figures.style import render
from cddf_jax.files import writing
from cddf_jax.files.manipulator_file import read_manipulator
from cddf_jax.measurements.table import read_measurements
from cddf_jax.reports.reproduction import reproduce
from cddf_jax.units import round_number

FIGURES = {  # name and width, inches
    "fig3_tip_error": 3.5,
    "fig4_iterations": 3.5,
    "fig5_distributed_forces": 3.5,
    "fig6_shapes": 7.16,
    "fig8_tip_tension": 3.5,
}


@pytest.fixture(scope="module")
def load_cells():
    return read_measurements(DATA / "load_cells_simulated.csv")


@pytest.fixture(scope="module")
def report(load_cells):
    return reproduce(read_manipulator(DATA / "smooth_sil_940.toml"), load_cells)


@pytest.fixture(scope="module")
def row(report):
    rows = {row["name"]: row for row in report.answer["table"]}
    return rows.__getitem__


def test_figures_are_those_named(report):
    made = {name: figure for name, figure in report.files().items() if name != "reproduction.md"}
    assert {name: figure.get_figwidth() for name, figure in made.items()} == FIGURES
    assert all(any(axes.has_data() for axes in figure.axes) for figure in made.values())
    picture = imread(BytesIO(render(made["fig3_tip_error"], "fig3")["fig3.png"]))
    assert picture.shape[1] == 1050  # 3.5 inches of 300 dots
    assert np.ptp(picture) > 0.5  # something is drawn


@pytest.mark.parametrize(
    ("name", "ours", "tolerance", "paper", "difference"),
    [  # ours: docs/theory.md (16), published kinematics, 75 N, to its last printed digit; Liu et al. (2020), section IV
        ("tension_loss", 1 - 45.122927013148 / 75, 1e-10, 0.40, -0.0016),
        ("iterations", 6, 0, 6, 0),  # 5 updates and the start
        ("levels", 17, 0, 18, -1),
    ],
)
def test_our_numbers_beside_the_papers(row, name, ours, tolerance, paper, difference):
    assert row(name)["ours"] == pytest.approx(ours, rel=0, abs=tolerance)
    assert row(name)["paper"] == paper
    assert row(name)["difference"] == pytest.approx(difference, abs=5e-5)


def test_what_cannot_be_compared_is_reported(row):
    error = row("mean_error")
    assert error["paper"] == 0.1466
    assert "measured" in error["note"]
    assert "simulated" in error["note"]
    assert error["note"].startswith("not comparable")
    assert error["difference"] is None


def test_mean_error_is_that_of_the_closed_form(row, load_cells):
    base, tip = load_cells["base_tension"], load_cells["tip_tension"]
    model = base / (1 + 0.42 / 1.4e6 * base * 2.942783188998e4)  # docs/theory.md (16)
    assert row("mean_error")["ours"] == pytest.approx(np.mean(np.abs(model - tip) / tip), rel=1e-8)


def test_markdown_holds_every_row(report):
    json.dumps(writing.plain(report.answer), allow_nan=False)
    text = report.files()["reproduction.md"]
    assert all(f"| {row['quantity']} |" in text for row in report.answer["table"])
    assert "| tension loss at 75 N | 40.00 % | 39.84 % | -0.16 % |" in text


# --- writing of files ------------------------------------------------------------------------------


def test_files_are_replaced_together_or_not_at_all(tmp_path):
    writing.write_all(tmp_path, {"a.txt": "old", "b.bin": b"old"})
    with pytest.raises(InputError, match=r"a\.txt.*; choose another place$"):
        writing.write_all(tmp_path, {"a.txt": "new", "a.txt/b.bin": b"new"})
    assert (tmp_path / "a.txt").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b.bin"]


def test_json_of_arrays_and_of_what_is_not_finite():
    value = {"a": np.array([1.0, np.nan]), "b": (np.float64(np.inf), 2, True, None, "µ"), "c": np.int64(3)}
    assert json.loads(writing.as_json(value)) == {"a": [1.0, None], "b": [None, 2, True, None, "µ"], "c": 3}


def test_a_file_name_that_is_not_utf8_in_reports(tmp_path):
    """0xff is no byte of UTF-8 (RFC 3629); the file is read by its true name."""
    path = tmp_path / os.fsdecode(b"run\xff.csv")
    path.write_text("base_tension [N],tip_tension [N]\n5,4\n")
    name = read_measurements(path).name
    assert name == "run\\xff.csv"
    writing.write_all(path.with_suffix(""), {"a.json": writing.as_json({"path": str(path)}), "a.md": str(path)})
    assert json.loads((path.with_suffix("") / "a.json").read_text()) == {"path": f"{tmp_path}/{name}"}
    assert (path.with_suffix("") / "a.md").read_text() == f"{tmp_path}/{name}"


def test_a_cell_of_a_table_that_holds_its_separator():
    """GitHub Flavored Markdown, section 4.10: a pipe in a cell is escaped by a backslash."""
    assert writing.markdown_table(["a|b"], [["c"]]) == ["| a\\|b |", "| --- |", "| c |"]


@pytest.mark.parametrize(("value", "expected"), [(531.6, 500), (27.3, 20), (1.0, 1), (0.09, 0.05)])
def test_round_numbers(value, expected):
    assert round_number(value) == pytest.approx(expected)
