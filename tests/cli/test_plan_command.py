"""`cddf plan`: candidates from a file, the same ranking as in Python, one-line errors."""

import json

import numpy as np
import pytest
from places import DATA

import cddf_jax as cddf

PAPER, LOAD_CELLS = (DATA / name for name in ("smooth_sil_940.toml", "load_cells_simulated.csv"))
ANGLES = cddf.Candidate("angles", {"base_tension": [20.0, 40.0, 60.0]}, {"tip_angle": np.radians(1.0)})
DRUM = cddf.Candidate("pulley", {"wrap_angle": np.radians([90, 180]), "weight": 10.0}, {"pulling_tension": 0.5})


@pytest.fixture
def run(cddf_command):
    """`cddf plan` with some arguments."""
    return lambda *arguments: cddf_command("plan", *arguments)


@pytest.fixture
def two_candidates(monkeypatch):
    """In place of the usual ones, whose programs take long to compile."""
    monkeypatch.setattr("cddf_jax.identification.experiment_design.standard_candidates", lambda *_: [ANGLES, DRUM])


def test_the_command_ranks_as_the_call_does(run, tmp_path, two_candidates):
    out = tmp_path / "plan"
    code, text, error = run(PAPER, "--json", "--out", out, "--num", 1)
    assert (code, error) == (0, "")
    answer = json.loads(text)
    called = cddf.plan(cddf.read_manipulator(PAPER), [ANGLES, DRUM], num=1)
    assert [row["name"] for row in answer["ranking"]] == [row.candidate.name for row in called.ranking]
    for row, ranked in zip(answer["ranking"], called.ranking, strict=True):
        assert row["gain"] == pytest.approx(ranked.gain)
    pulley = next(row for row in answer["ranking"] if row["name"] == "pulley")
    assert pulley["standard_error"]["youngs_modulus"] is None  # infinite
    assert pulley["status"]["friction_coefficient"] == "identified"
    assert json.loads((out / "plan.json").read_text()) == answer
    assert (out / "plan.md").read_text().startswith("# What to measure next")


def test_a_known_gain(run, monkeypatch):
    """A cell that reads ten times as much tells ten times as much of the pull, at the same noise."""
    cell = cddf.Candidate("cell", {"base_tension": [20.0]}, {"tip_tension": 0.5})
    monkeypatch.setattr("cddf_jax.identification.experiment_design.standard_candidates", lambda *_: [cell])
    errors = []
    for gain in ("1", "10"):
        code, text, _ = run(PAPER, "--json", "--given", f"tip_gain={gain}", "--free", "friction_coefficient")
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


def test_candidates_of_a_bench_driven_by_displacement(run, tmp_path, monkeypatch):
    """Their largest displacement is that of the tables."""
    told = []

    def stop(*given):
        told.append(given[-1])
        raise cddf.InputError("far enough")

    monkeypatch.setattr("cddf_jax.identification.experiment_design.standard_candidates", stop)
    monkeypatch.setattr("cddf_jax.identification.fit.fit", lambda *_, **__: None)
    (tmp_path / "bench.csv").write_text("step,displacement [mm],tip_angle [deg]\n1,0,0\n2,9,40\n3,4,22\n")
    for arguments in ((), (tmp_path / "bench.csv",)):
        run(PAPER, *arguments)
    assert told == [None, 9e-3]


def test_options_that_are_refused(fails):
    for options, message in (
        (("--tension", "0 N"), "give a tension above 0 N"),
        (("--criterion", "E"), "criterion 'E' is neither"),
        (("--free", "friction"), "'friction' is not a parameter"),
    ):
        assert message in fails("plan", PAPER, *options)
