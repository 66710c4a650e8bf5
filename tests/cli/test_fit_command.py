"""`cddf fit` and `cddf reproduce`: answers against the library, files, and how a fit fails."""

import json
import re

import numpy as np
import pytest
from places import DATA
from repeat import repeated

import cddf_jax as cddf
from cddf_jax.estimation.observations import Noise

PAPER, LOAD_CELLS, PULLEY = (
    str(DATA / name) for name in ("smooth_sil_940.toml", "load_cells_simulated.csv", "pulley_simulated.csv")
)
BOTH = ("friction_coefficient", "youngs_modulus")


def assert_the_fit(answer, fit):
    """The JSON object is the library's fit."""
    assert answer["status"] == fit.status
    assert answer["verdict"] == list(fit.verdict)
    for name in fit.value:
        assert answer["value"][name] == pytest.approx(fit.value[name], rel=1e-9)
        error = answer["standard_error"][name]
        assert (np.inf if error is None else error) == pytest.approx(fit.standard_error[name], rel=1e-6)


def test_fit_in_words_says_what_is_not_known(cddf_command):
    code, out, err = cddf_command("fit", PAPER, PULLEY)
    assert (code, err) == (0, "")  # on standard output is the answer alone, and what is quick is not shown
    fit = cddf.fit(cddf.read_manipulator(PAPER), cddf.read_measurements(PULLEY))
    assert out.splitlines()[: len(fit.verdict)] == list(fit.verdict)
    assert "youngs_modulus: not identified" in out
    assert "simulated data: pulley_simulated.csv" in out


@pytest.mark.slow
def test_fit_of_two_tables_in_json_and_files(answer_of, tmp_path, said):
    answer = answer_of("fit", PAPER, PULLEY, LOAD_CELLS, "--out", tmp_path)
    tables = [cddf.read_measurements(path) for path in (PULLEY, LOAD_CELLS)]
    assert_the_fit(answer, cddf.fit(cddf.read_manipulator(PAPER), tables))
    assert answer["status"] == dict.fromkeys(BOTH, "identified")
    assert {(stage.what, stage.done, stage.total) for stage in said} >= {("profile", 1, 2), ("file", 4, 5)}
    stems = ("fit_pulley_simulated", "fit_load_cells_simulated", "residuals", "profiles")
    figures = {f"{stem}.{suffix}" for stem in stems for suffix in ("pdf", "png")}
    assert {path.name for path in tmp_path.iterdir()} == {"results.json", "report.md", *figures}
    assert json.loads((tmp_path / "results.json").read_text()) == answer
    assert (tmp_path / "report.md").read_text().startswith("# ")
    assert all((tmp_path / name).stat().st_size > 1000 for name in figures)


def test_options_of_a_fit(answer_of):
    """Against the library with the same options; of the pulley test alone, which needs no solve."""
    options = ("--free", "friction_coefficient")
    limits = ("--prior", "friction_coefficient = 0.4 +- 0.1", "--kinematics", "exact")
    answer = answer_of(
        "fit", PAPER, PULLEY, *options, *limits, "--noise", "pulling_tension=0.1 N + 1 %", "--no-history"
    )
    assert answer["kinematics"] == "exact"
    fit = cddf.fit(
        cddf.read_manipulator(PAPER),
        cddf.read_measurements(PULLEY),
        free=("friction_coefficient",),
        priors={"friction_coefficient": (0.4, 0.1)},
        noise={"pulling_tension": Noise(0.1, 0.01)},
    )
    assert_the_fit(answer, fit)
    told = {
        "free": ["friction_coefficient"],
        "priors": {"friction_coefficient": {"mean": 0.4, "standard_deviation": 0.1}},
        "noise": {"pulling_tension": {"floor": 0.1, "fraction": 0.01}},
        "history": False,
    }
    assert {name: answer["options"][name] for name in told} == told


def test_averaged_holds(answer_of, tmp_path):
    """Two weights, five samples each: two readings, whose ln(T / W) / pi scatters by nothing."""
    pull = np.array([5.0, 10.0]) * np.exp(0.42 * np.pi)
    rows = [f"{weight},180,{p + e:.9f}" for weight, p in zip((5, 10), pull, strict=True) for e in (-2, 1, 0, 2, -1)]
    (tmp_path / "drum.csv").write_text("weight [N],wrap_angle [deg],pulling_tension [N]\n" + "\n".join(rows))
    options = ("--free", "friction_coefficient", "--average-holds", "--noise", "pulling_tension=0.1 N")
    answer = answer_of("fit", PAPER, tmp_path / "drum.csv", *options)
    assert [(table["rows"], table["read_as"][-1]) for table in answer["data"]] == [
        (2, "drum.csv: each hold averaged to one reading: 10 rows became 2")
    ]
    assert answer["value"]["friction_coefficient"] == pytest.approx(0.42, rel=1e-6)


@pytest.mark.slow
def test_trials_of_the_shipped_data(cddf_command, tmp_path):
    """The truth: mu 0.42, E 1.4 MPa, friction that scatters by 1 % from trial to trial (data/README.md)."""
    table = str(DATA / "tip_angle_simulated.csv")
    options = ("--kinematics", "exact", "--per-trial")
    code, out, err = cddf_command("fit", PAPER, table, *options, "--out", tmp_path)
    assert (code, err) == (0, "")
    markdown = (tmp_path / "report.md").read_text()
    for line in markdown.splitlines()[2:5]:  # the same first lines on the terminal and in the report
        assert line.removeprefix("- ") in out
    assert re.match(r"# .*\n\n- friction_coefficient = 0\.4\d* \+- .*: identified\n- youngs_modulus = 1\.", markdown)
    results = json.loads((tmp_path / "results.json").read_text())
    effects = results["trial_effects"]
    assert list(effects) == [f"tip_angle_simulated.csv: {k}" for k in (1, 2, 3)]
    assert all(abs(effect["value"]) < 0.05 and 0 < effect["standard_error"] < 0.05 for effect in effects.values())
    assert "| tip_angle_simulated.csv: 1 | " in markdown
    again = repeated(results, tmp_path)
    assert again.value == pytest.approx(results["value"], rel=1e-9)
    assert again.trial_spread == pytest.approx(results["trial_spread"], rel=1e-6)


def test_a_fit_says_how_its_files_were_read(cddf_command, tmp_path, monkeypatch):
    """The numbers are 10 exp(0.42 angle), Liu et al. (2020), eq. (5); a trial in each file, one without a reading."""
    angles, files = (45.0, 90.0, 135.0), [tmp_path / "run_1.csv", tmp_path / "run_2.csv"]
    for file, scatter in zip(files, (1.01, 0.99), strict=True):
        rows = [f"{a},10,{scatter * 10 * np.exp(0.42 * np.radians(a)):.4f},{a}" for a in angles]
        file.write_text("\n".join(["Wrap angle (deg),Weight_N,F1,t", *rows, "180,10,,0", ""]))
    monkeypatch.setattr("cddf_jax.figures.render", lambda *_: {})
    asked = ("--free", "friction_coefficient", "--column", "F1=pulling_tension [N]", "--json")
    code, out, err = cddf_command("fit", PAPER, *files, *asked, "--out", tmp_path / "out")
    answer = json.loads(out)
    assert code == 0
    assert answer["value"]["friction_coefficient"] == pytest.approx(0.42, rel=1e-3)  # the scatter is 1 %, both ways
    read_as = [
        "run_1.csv: read as: 'Wrap angle (deg)' wrap_angle [deg], 'Weight_N' weight [N], 'F1' pulling_tension [N]",
        "run_1.csv: columns that are not used: 't'",
        "run_1.csv: rows without a reading are left out: 1 of 4 rows (row 5 first)",
    ]
    assert err.splitlines()[:3] == [f"note: {line}" for line in read_as]
    assert err.splitlines()[-1].startswith("note: run_1.csv, run_2.csv: the same columns and no column trial, so each")
    assert answer["data"][0]["read_as"] == [line.removeprefix("note: ") for line in err.splitlines()]
    report = (tmp_path / "out" / "report.md").read_text()
    assert all(f"- {line}" in report for line in answer["data"][0]["read_as"])


LOCKED = "base_tension [N],tip_tension [N],direction\n200,300,-1\n210,305,-1\n220,310,-1\n"


@pytest.mark.slow
def test_a_fit_that_fails(cddf_command, tmp_path):
    """At 200 N the model has no solution: one line on standard error, no traceback from its figures."""
    (tmp_path / "locked.csv").write_text(LOCKED)
    code, out, err = cddf_command("fit", PAPER, tmp_path / "locked.csv", "--json", "--out", tmp_path / "folder")
    assert code == 1
    assert err.startswith("error: the fit failed: ")
    assert err.count("\n") == 1
    assert json.loads(out)["success"] is False
    assert json.loads((tmp_path / "folder" / "results.json").read_text())["success"] is False
    report = (tmp_path / "folder" / "report.md").read_text()
    assert report.splitlines()[2].startswith("- The fit failed: ")
    assert "- No figure of profiles: the fit failed: " in report


def test_ctrl_c_after_the_search_keeps_the_fit(cddf_command, tmp_path, monkeypatch):
    def interrupted(fit, name):
        raise KeyboardInterrupt

    monkeypatch.setattr(cddf.Fit, "profile", interrupted)
    monkeypatch.setattr("cddf_jax.figures.render", lambda *_: {})
    code, out, err = cddf_command("fit", PAPER, PULLEY, "--free", "friction_coefficient", "--out", tmp_path / "folder")
    assert (code, err) == (130, "error: interrupted; the fit is complete, but without profiles\n")
    assert out.startswith("friction_coefficient = 0.41")  # data/README.md: 0.42, with noise
    assert (tmp_path / "folder" / "report.md").exists()


@pytest.mark.slow
def test_reproduce_in_its_own_folder(cddf_command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = cddf_command("reproduce", PAPER, LOAD_CELLS)
    assert (code, err) == (0, "")
    assert "| tension loss at 75 N | 40.00 % | 39.84 % |" in out
    assert (tmp_path / "out" / "reproduce" / "reproduction.json").is_file()
    assert len(list((tmp_path / "out" / "reproduce").glob("fig*.pdf"))) == 5
