"""`cddf plan`: candidates from a file, the same ranking as in Python, one-line errors."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from places import DATA

import cddf_jax as cddf
from cddf_jax.cli.fit_options import read_candidates
from cddf_jax.figures.estimates import draw_plan

PAPER, LOAD_CELLS = (DATA / name for name in ("smooth_sil_940.toml", "load_cells_simulated.csv"))
CANDIDATES = """
[[candidate]]
name = "angles"
base_tension = ["20 N", "40 N", "60 N"]
noise = { tip_angle = "1 deg" }
repeats = 2
cost = 1.5

[[candidate]]
name = "pulley"
wrap_angle = ["90 deg", "180 deg"]
weight = "10 N"
noise = { pulling_tension = "0.5 N" }
"""


@pytest.fixture
def run(cddf_command):
    """`cddf plan` with some arguments."""
    return lambda *arguments: cddf_command("plan", *arguments)


@pytest.fixture
def candidates(tmp_path):
    path = tmp_path / "candidates.toml"
    path.write_text(CANDIDATES)
    return path


def test_the_command_ranks_as_the_call_does(run, candidates, tmp_path):
    out = tmp_path / "plan"
    code, text, error = run(PAPER, "--candidates", candidates, "--json", "--out", out, "--num", 1)
    assert (code, error) == (0, "")
    answer = json.loads(text)
    called = cddf.plan(cddf.read_manipulator(PAPER), read_candidates(candidates), num=1)
    assert [row["name"] for row in answer["ranking"]] == [row.candidate.name for row in called.ranking]
    for row, ranked in zip(answer["ranking"], called.ranking, strict=True):
        assert row["gain"] == pytest.approx(ranked.gain)
    pulley = next(row for row in answer["ranking"] if row["name"] == "pulley")
    assert pulley["standard_error"]["youngs_modulus"] is None  # infinite
    assert pulley["status"]["friction_coefficient"] == "identified"
    assert json.loads((out / "plan.json").read_text()) == answer
    assert {row["name"]: row["cost"] for row in answer["ranking"]} == {"angles": 1.5, "pulley": 1.0}
    assert (out / "plan.md").read_text().startswith("# What to measure next")
    assert (out / "plan.png").stat().st_size > 10_000


def test_noise_that_grows_with_the_reading(tmp_path):
    """0.3 N and 4 % of the pulling tension: the Fisher information of eq. (5) by hand."""
    path = tmp_path / "candidates.toml"
    path.write_text(CANDIDATES.replace('"0.5 N"', '"0.3 N + 4 %"'))
    paper = cddf.read_manipulator(PAPER)
    answer = cddf.plan(paper, read_candidates(path)[1:], ["friction_coefficient"])
    wrap = np.radians([90.0, 180.0])
    reading = 10.0 * np.exp(float(paper.friction_coefficient) * wrap)
    information = np.sum((wrap * reading) ** 2 / (0.3**2 + (0.04 * reading) ** 2))
    assert answer.ranking[0].expected.standard_error["friction_coefficient"] == pytest.approx(information**-0.5)


def test_the_figure_holds_the_table(candidates):
    """A marker per candidate and parameter: filled at the standard error, hollow at the edge where there is none."""
    answer = cddf.plan(cddf.read_manipulator(PAPER), read_candidates(candidates))
    given = Figure().subplots()
    assert draw_plan(answer, given) is given
    assert given.get_xlabel() == "Expected standard error (%)"
    axes = draw_plan(answer)
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "now",
        *(r.candidate.name for r in answer.ranking),
    ]
    lines = {line.get_label(): line.get_xdata() for line in axes.lines}
    for name in ("friction_coefficient", "youngs_modulus"):
        errors = [100 * r.expected.standard_error[name] / r.expected.value[name] for r in answer.ranking]
        np.testing.assert_allclose(lines[name], [error for error in errors if np.isfinite(error)], rtol=1e-12)
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "none"]
    assert sum(len(line.get_xdata()) for line in hollow) == 2 + 1  # both now, the modulus after a pulley test


def test_a_known_gain(run, tmp_path):
    """A cell that reads ten times as much tells ten times as much of the pull, at the same noise."""
    path = tmp_path / "candidates.toml"
    path.write_text('[[candidate]]\nbase_tension = "20 N"\nnoise = { tip_tension = "0.5 N" }\n')
    errors = []
    for gain in ("1", "10"):
        given = ("--given", f"tip_gain={gain}", "--free", "friction_coefficient")
        code, text, _ = run(PAPER, "--candidates", path, "--num", 1, "--json", *given)
        assert code == 0
        errors.append(json.loads(text)["ranking"][0]["standard_error"]["friction_coefficient"])
    assert errors[0] / errors[1] == pytest.approx(10.0)


@pytest.mark.slow
def test_added_to_what_was_measured(run):
    """Load cells alone hold mu / E; the first thing to do is what separates the two, and the text says so."""
    code, text, error = run(PAPER, LOAD_CELLS, "--num", 1)
    assert (code, error) == (0, "")
    lines = text.splitlines()
    assert lines[2].startswith("- now: friction_coefficient / youngs_modulus +- ")
    assert "youngs_modulus not identified" in lines[2]
    assert lines[3].startswith("- 1. pulley test: then friction_coefficient +- ")
    assert "not identified" not in lines[3]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "holds no candidates"),
        ("x = [", "is not TOML"),
        ("[[candidate]]\nbase_tension = '20 N'", "candidate 1: needs what is read"),
        (CANDIDATES.replace("1 deg", "1 deg + 2 mm"), "tip_angle: the part that grows with the reading is in %"),
        (CANDIDATES.replace("1 deg", "0 deg + 0 %"), "with standard deviations > 0"),
        (CANDIDATES.replace("1 deg", "1 mm"), "tip_angle needs a unit of angle"),
        (CANDIDATES.replace("repeats = 2", "repeats = 0"), "repeats must be 1 or more"),
        (CANDIDATES.replace("repeats = 2", "repeats = 1.5"), "repeats must be a whole number"),
        (CANDIDATES.replace("cost = 1.5", "cost = 0"), "cost must be a number > 0"),
        (CANDIDATES.replace("cost = 1.5", "cost = '1 h'"), "cost is a plain number, got"),
        (CANDIDATES.replace("base_tension", "base"), "unknown column 'base'"),
        (CANDIDATES.replace('["20 N", "40 N", "60 N"]', "[]"), "base_tension is empty"),
    ],
)
def test_files_that_are_refused(fails, content, message):
    assert message in fails("plan", PAPER, "--candidates", "some.toml", files={"some.toml": content})


def test_options_that_are_refused(fails):
    for options, message in (
        (("--tension", "0 N"), "give a tension above 0 N"),
        (("--criterion", "E"), "criterion 'E' is neither"),
        (("--free", "friction"), "'friction' is not a parameter"),
        (("--candidates", "nowhere.toml"), "cannot be read"),
    ):
        assert message in fails("plan", PAPER, *options)
