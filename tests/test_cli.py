"""The command line: answers against the library, and every error in one line that names what to do."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bodies import PAPER as DIMENSIONS
from bodies import paper_body
from repeat import repeated

import cddf_jax as cddf
from cddf_jax import application, cli, solve_command
from cddf_jax.manipulator_file import write_manipulator
from cddf_jax.observations import Noise

DATA = Path(__file__).resolve().parents[1] / "data"
PAPER, LOAD_CELLS, PULLEY = (
    str(DATA / name) for name in ("smooth_sil_940.toml", "load_cells_simulated.csv", "pulley_simulated.csv")
)
PULL = ("-t", "75 N")
BOTH = ("friction_coefficient", "youngs_modulus")
RATIO = "friction_coefficient / youngs_modulus"


@pytest.fixture(autouse=True)
def _tests_set_jax_up_themselves(monkeypatch):
    """The tests' own settings hold; what `configure_jax` does is seen in a process of its own."""
    monkeypatch.setattr(application, "configure_jax", lambda **_: None)


@pytest.fixture
def answer_of(cddf_command):
    """The one JSON object on standard output of a command that succeeds."""

    def run(*arguments):
        code, out, err = cddf_command(*arguments, "--json")
        assert (code, err) == (0, "")
        assert out.startswith("{")
        return json.loads(out, parse_constant=lambda constant: pytest.fail(constant))

    return run


@pytest.fixture(scope="module")
def two_tendons(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.toml"
    write_manipulator(paper_body("exact", num_tendons=2), path)
    return path


def separate_process(*arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", "from cddf_jax.cli import main; main()", *map(str, arguments)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )


# --- solve ---------------------------------------------------------------------------------------


def test_solve_in_words(cddf_command):
    code, out, err = cddf_command("solve", PAPER, "-t", "75 N")
    assert (code, err) == (0, "")
    # design.md section 3, published kinematics: (120.39593, 57.00182) mm, 63.16687 degrees, 45.1229 N, 39.84 %
    assert "tip at (120.396, 57.002) mm, 63.167 deg" in out
    assert "tendon 1: tip tension 45.1229 N, loss 39.84 %" in out
    assert "successful" in out


def test_solve_in_json_is_what_the_library_says(answer_of):
    answer = answer_of("solve", PAPER, "-t", "75 N")
    equilibrium = cddf.solve(cddf.read_manipulator(PAPER), 75.0)
    assert answer["result"] == "successful"
    assert (answer.pop("remarks"), answer.pop("self_contact")) == ([], None)
    for name in set(answer) - {"result"}:
        np.testing.assert_allclose(answer[name], getattr(equilibrium, name), rtol=1e-12, err_msg=name)
    assert answer["tip_tension"] == pytest.approx([45.122927013148], rel=1e-8)  # design.md section 3
    assert {"arc_length", "curvature", "heading", "position", "tension", "normal_force"} <= set(answer)


def test_units_of_the_tension(answer_of):
    assert answer_of("solve", PAPER, "-t", "0.075 kN") == answer_of("solve", PAPER, "--base-tension", "75 N")


def test_kinematics_instead_of_the_files(answer_of):
    answer = answer_of("solve", PAPER, "-t", "75 N", "--kinematics", "exact")
    assert np.degrees(answer["tip_angle"]) == pytest.approx(69.31393, abs=1e-5)  # design.md section 3
    np.testing.assert_allclose(answer["tip_position"], [0.11734384, 0.06028179], atol=1e-8)


def test_two_tendons_and_their_directions(answer_of, two_tendons):
    tensions = ("--base-tension", "75 N", "--base-tension", "20 N")
    answer = answer_of("solve", two_tendons, *tensions, "--direction", "1", "--direction", "-1")
    # design.md section 2: 45.9 degrees and 28.0 N with the right signs, 54.0 degrees and 13.5 N with both "in"
    assert np.degrees(answer["tip_angle"]) == pytest.approx(45.9, abs=0.05)
    assert answer["tip_tension"][1] == pytest.approx(28.0, abs=0.05)
    assert answer["direction_contradicted"] == [False, False]
    found = answer_of("solve", two_tendons, *tensions)
    assert found["direction"] == [1, -1]
    assert found["tip_tension"] == pytest.approx(answer["tip_tension"], rel=1e-10)
    both_in = answer_of("solve", two_tendons, *tensions, "--direction", "1")
    assert np.degrees(both_in["tip_angle"]) == pytest.approx(54.0, abs=0.05)
    assert both_in["tip_tension"][1] == pytest.approx(13.5, abs=0.05)
    assert both_in["direction_contradicted"] == [False, True]
    assert both_in["result"].startswith("A tendon travels against its direction")


def test_one_tension_for_all_tendons(answer_of, two_tendons):
    answer = answer_of("solve", two_tendons, "-t", "20 N")
    assert answer["tip_angle"] == pytest.approx(0.0, abs=1e-12)  # pulled alike, it stays straight
    assert answer["tip_tension"] == pytest.approx([20.0, 20.0])


def test_solve_writes_files(answer_of, tmp_path):
    answer = answer_of("solve", PAPER, "-t", "75 N", "--out", tmp_path / "new" / "folder")
    files = {path.name: path for path in (tmp_path / "new" / "folder").iterdir()}
    assert set(files) == {"solve.json", "solve.pdf", "solve.png", "fields.csv"}
    head, *rows = files["fields.csv"].read_text().splitlines()
    tip = dict(zip(head.split(","), map(float, rows[-1].split(",")), strict=True))
    assert tip["tension_1 [N]"] == pytest.approx(answer["tip_tension"][0], rel=1e-8)  # nine digits are written
    assert [tip["x [m]"], tip["y [m]"]] == pytest.approx(answer["tip_position"], rel=1e-8)
    assert json.loads(files["solve.json"].read_text()) == answer
    assert files["solve.pdf"].read_bytes().startswith(b"%PDF-")
    assert files["solve.png"].read_bytes().startswith(b"\x89PNG")


def test_a_warning_in_words(cddf_command, two_tendons):
    code, out, _ = cddf_command("solve", two_tendons, "-t", "75 N", "-t", "20 N", "--direction", "1")
    assert code == 0
    *_, last, warning = out.splitlines()
    assert last.startswith("error estimate ")
    assert "successful" not in last
    assert warning.startswith("warning: tendon 2: A tendon travels against its direction")


def test_a_tendon_without_tension(cddf_command, two_tendons):
    code, out, _ = cddf_command("solve", two_tendons, "-t", "75 N", "-t", "0 N", "--direction", "1", "--direction=-1")
    assert code == 0
    # a tendon parallel to the axis travels d phi = 10 mm * 69.31393 degrees (design.md section 3), the other way here
    assert "tendon 2: no tension, pulled in -12.098 mm" in out


# --- loads ---------------------------------------------------------------------------------------

LOADS = ("--tip-force", "0 N, -5 N", "--tip-moment", "0.1 N m", "--gravity", "0, -9.81 m/s^2")


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """The paper's body in the exact kinematics, with the density of silicone."""
    path = tmp_path_factory.mktemp("robot") / "heavy.toml"
    write_manipulator(paper_body("exact", density=1070.0), path)
    return path


def test_loads_in_json_are_what_the_library_says(answer_of, heavy):
    answer = answer_of("solve", heavy, *PULL, *LOADS)
    loads = cddf.Loads(tip_force=(0.0, -5.0), tip_moment=0.1, gravity=(0.0, -9.81))
    equilibrium = cddf.solve(paper_body("exact", density=1070.0), [75.0], loads, direction=[1])
    assert (answer.pop("result"), equilibrium.result == cddf.RESULTS.successful) == ("successful", True)
    assert (answer.pop("remarks"), answer.pop("self_contact")) == ([], None)
    assert answer.pop("loads") == {"tip_force": [0.0, -5.0], "tip_moment": 0.1, "gravity": [0.0, -9.81]}
    for name in answer:
        np.testing.assert_allclose(answer[name], getattr(equilibrium, name), rtol=1e-12, err_msg=name)
    new = {"base_tension", "target_miss", "base_moment", "load_fraction", "num_load_steps", "stable"}
    assert new <= set(answer)
    assert (answer["base_tension"], answer["load_fraction"], answer["stable"]) == ([75.0], 1.0, True)


def test_the_moment_at_the_base_is_that_of_statics(answer_of, heavy):
    answer = answer_of("solve", heavy, *PULL, "--tip-force", "3 N, -5 N", "--tip-moment", "0.1 N m")
    x, y = answer["tip_position"]
    assert answer["base_moment"] == pytest.approx(x * -5.0 - y * 3.0 + 0.1, rel=1e-9)  # r x F + m about the base


@pytest.mark.parametrize(
    "others",
    [
        ("--tip-force", "0, -0.005 kN", "--tip-moment", "100 N mm", "--gravity", "0 m/s^2, -981 cm/s^2"),
        ("--tip-force", "0 kN, -5 N", "--tip-moment", "0.1 Nm", "--gravity", "0 m/s^2, -9.81"),
    ],
)
def test_units_of_the_loads(answer_of, heavy, others):
    assert answer_of("solve", heavy, *PULL, *others) == answer_of("solve", heavy, *PULL, *LOADS)


def test_loads_in_words(cddf_command, answer_of, heavy):
    code, out, err = cddf_command("solve", heavy, *PULL, *LOADS)
    assert (code, err) == (0, "")
    answer = answer_of("solve", heavy, *PULL, *LOADS)
    assert out.splitlines()[3:5] == [
        "loads: tip force (0, -5) N, tip moment 0.1 N m, gravity (0, -9.81) m/s^2; put on in 1 step",
        f"moment of the loads at the base: {answer['base_moment']:.5g} N m",
    ]
    assert out.splitlines()[5].endswith("; successful")


def test_what_is_not_stable_is_shown_and_fails(cddf_command, heavy):
    # a straight column: pi^2 E J / (4 L^2) is 21.8 N even with the section of the base from base to tip
    arguments = ("solve", heavy, "-t", "0 N", "--tip-force", "-30 N, 0 N")
    code, out, err = cddf_command(*arguments)
    assert code == 1
    assert "tip at (140.000, 0.000) mm" in out
    assert out.splitlines()[-1].startswith("warning: The equilibrium is unstable")
    assert err.startswith("error: The equilibrium is unstable")
    assert err.count("\n") == 1
    code, out, _ = cddf_command(*arguments, "--json")
    assert (code, json.loads(out)["stable"]) == (1, False)


# --- targets -------------------------------------------------------------------------------------

G = 2.942783188998e4  # m^-2, G(L) of design.md section 3


def section(s):
    """J of the paper's body, m^4."""
    (base, tip), inner, length = DIMENSIONS["outer_radius"], DIMENSIONS["inner_radius"], DIMENSIONS["length"]
    return np.pi / 4 * ((base + (tip - base) * s / length) ** 4 - inner**4)


@pytest.mark.parametrize(
    ("target", "tip_angle", "tip_tension"),
    [
        # a parallel tendon wraps by the tip angle and travels by d phi; capstan law T_tip = T_base exp(-mu phi), and
        # T_base - T_tip = mu / E G T_base T_tip by the closed form
        ("tip_angle=45 deg", np.pi / 4, (1 - np.exp(-0.42 * np.pi / 4)) / (0.42 / 1.4e6 * G)),
        ("displacement = 5 mm", 0.5, (1 - np.exp(-0.42 * 0.5)) / (0.42 / 1.4e6 * G)),
        ("tip_tension=0.04 kN", -np.log(1 - 0.42 / 1.4e6 * G * 40.0) / 0.42, 40.0),
    ],
)
def test_targets_meet_the_closed_form(answer_of, heavy, target, tip_angle, tip_tension):
    answer = answer_of("solve", heavy, "-t", target)
    assert answer["tip_angle"] == pytest.approx(tip_angle, rel=1e-7)
    assert answer["tip_tension"] == pytest.approx([tip_tension], rel=1e-7)
    assert answer["base_tension"] == pytest.approx([tip_tension * np.exp(0.42 * tip_angle)], rel=1e-7)
    assert answer["tendon_displacement"] == pytest.approx([0.01 * tip_angle], rel=1e-7)
    name = target.partition("=")[0].strip()
    wanted = {"tip_angle": tip_angle, "displacement": 0.005, "tip_tension": 40.0}[name]
    assert answer["targets"] == [{name: pytest.approx(wanted, rel=1e-15)}]
    assert abs(answer["target_miss"][0]) < 1e-6


def test_a_curvature_at_a_place(answer_of, heavy):
    answer = answer_of("solve", heavy, "-t", "curvature=0.008 1/mm at 7 cm")
    assert answer["targets"] == [{"curvature": 8.0, "arc_length": 0.07}]
    tension = cddf.closed_form_tension(paper_body("exact"), answer["base_tension"][0], 0.07)
    assert float(tension) * 0.010 / (1.4e6 * section(0.07)) == pytest.approx(8.0, rel=1e-7)  # E J kappa = d T


def test_a_target_in_words(cddf_command, heavy):
    code, out, err = cddf_command("solve", heavy, "-t", "tip_angle=45 deg")
    assert (code, err) == (0, "")
    # as above: T_tip = 31.8271 N, loss 1 - exp(-0.42 pi / 4) = 28.10 %, travel 10 mm * pi / 4
    line = "tendon 1: base tension 44.2646 N gives tip_angle=45 deg, tip tension 31.8271 N, loss 28.10 %, "
    assert line + "pulled in 7.854 mm" in out


@pytest.mark.slow
def test_a_target_under_loads(answer_of, heavy):
    answer = answer_of("solve", heavy, "-t", "tip_angle=45 deg", "--tip-force", "0 N, -5 N")
    assert answer["tip_angle"] == pytest.approx(np.pi / 4, rel=1e-9)
    assert answer["tension_loss"] == pytest.approx([1 - np.exp(-0.42 * np.pi / 4)], rel=1e-7)  # it bends one way only
    assert answer["base_tension"][0] > 44.2646  # the force pulls the other way
    assert answer["loads"]["tip_force"] == [0.0, -5.0]


def test_two_targets(answer_of, two_tendons):
    targets = ("-t", "tip_angle=30 deg", "-t", "total_tension=80 N", "--direction", "1", "--direction", "-1")
    answer = answer_of("solve", two_tendons, *targets)
    assert answer["tip_angle"] == pytest.approx(np.pi / 6, rel=1e-8)
    assert sum(answer["base_tension"]) == pytest.approx(80.0, rel=1e-8)
    growth = np.exp(0.42 * np.pi / 6)  # capstan law, sliding in and out
    ratio = np.divide(answer["tip_tension"], answer["base_tension"])
    np.testing.assert_allclose(ratio, [1 / growth, growth], rtol=1e-7)
    assert answer["targets"] == [{"tip_angle": pytest.approx(np.pi / 6)}, {"total_tension": 80.0}]


def test_a_target_beside_a_tension():
    """Read in the order of the tendons; a stiffness is only read here, its solve compiles for long."""
    body = paper_body("exact", num_tendons=2)
    stiffness, tension = solve_command.read_actuation(["tip_stiffness=0.35 N/mm", "20 N"], body)
    assert (type(stiffness), float(stiffness.value), tension) == (cddf.TipStiffness, 350.0, 20.0)


# --- fit -----------------------------------------------------------------------------------------


def assert_the_fit(answer, fit):
    """The JSON object is the library's fit."""
    assert answer["status"] == fit.status
    assert answer["verdict"] == list(fit.verdict)
    for name in fit.value:
        assert answer["value"][name] == pytest.approx(fit.value[name], rel=1e-9)
        error = answer["standard_error"][name]
        assert (np.inf if error is None else error) == pytest.approx(fit.standard_error[name], rel=1e-6)


def test_fit_in_words_says_what_is_not_known(cddf_command):
    code, out, err = cddf_command("fit", PAPER, LOAD_CELLS)
    assert (code, err) == (0, "")
    fit = cddf.fit(cddf.read_manipulator(PAPER), cddf.read_measurements(LOAD_CELLS))
    assert out.splitlines()[: len(fit.verdict)] == list(fit.verdict)
    assert "simulated data: load_cells_simulated.csv" in out


def test_fit_of_two_tables_in_json_and_files(answer_of, tmp_path):
    answer = answer_of("fit", PAPER, PULLEY, LOAD_CELLS, "--out", tmp_path)
    tables = [cddf.read_measurements(path) for path in (PULLEY, LOAD_CELLS)]
    assert_the_fit(answer, cddf.fit(cddf.read_manipulator(PAPER), tables))
    assert answer["status"] == dict.fromkeys(BOTH, "identified")
    stems = ("fit_pulley_simulated", "fit_load_cells_simulated", "residuals", "profiles", "correlation")
    figures = {f"{stem}.{suffix}" for stem in stems for suffix in ("pdf", "png")}
    assert {path.name for path in tmp_path.iterdir()} == {"results.json", "report.md", *figures}
    assert json.loads((tmp_path / "results.json").read_text()) == answer
    assert (tmp_path / "report.md").read_text().startswith("# ")
    assert all((tmp_path / name).stat().st_size > 1000 for name in figures)


def test_prior_noise_and_kinematics(answer_of):
    # the offset is constant and only tensions are fitted: the kinematics change nothing but their name
    options = ("--prior", "youngs_modulus=1.4 MPa +- 100 kPa", "--noise", "tip_tension=0.0005 kN")
    answer = answer_of("fit", PAPER, LOAD_CELLS, *options, "--kinematics", "exact")
    fit = cddf.fit(
        paper_body("exact"),
        cddf.read_measurements(LOAD_CELLS),
        priors={"youngs_modulus": (1.4e6, 1e5)},
        noise={"tip_tension": 0.5},
    )
    assert_the_fit(answer, fit)
    assert answer["kinematics"] == "exact"
    assert answer["noise"] == {"load_cells_simulated.csv: tip_tension": pytest.approx(0.5)}
    assert answer["status"]["youngs_modulus"] == "prior only"


@pytest.mark.parametrize("sign", ["+-", "±"])
def test_prior_of_a_plain_number(answer_of, sign):
    answer = answer_of("fit", PAPER, PULLEY, "--prior", f"friction_coefficient = 0.4 {sign} 0.0001")
    # far narrower than the pulley's 0.0006, it decides: weights 36 to 1 about 0.4 and 0.41876
    assert answer["value"]["friction_coefficient"] == pytest.approx(0.4, abs=1.5e-3)


def test_one_free_parameter(answer_of):
    answer = answer_of("fit", PAPER, PULLEY, "--free", "friction_coefficient")
    assert answer["status"] == {"friction_coefficient": "identified", "youngs_modulus": "fixed"}


def test_options_of_a_fit(answer_of):
    """Against the library with the same options; of the pulley test alone, which needs no solve."""
    options = ("--free", "friction_coefficient", "--loss", "huber", "--starts", "3", "--seed", "5")
    limits = ("--prior", "friction_coefficient = uniform 0.1 .. 0.6", "--bound", "friction_coefficient=0.2:")
    answer = answer_of("fit", PAPER, PULLEY, *options, *limits, "--noise", "pulling_tension=0.1 N + 1 %")
    fit = cddf.fit(
        cddf.read_manipulator(PAPER),
        cddf.read_measurements(PULLEY),
        free=("friction_coefficient",),
        bounds={"friction_coefficient": (0.2, 0.6)},
        noise={"pulling_tension": Noise(0.1, 0.01)},
        loss="huber",
    )
    assert_the_fit(answer, fit)
    assert answer["options"] == {
        "free": ["friction_coefficient"],
        "priors": {},
        "bounds": {"friction_coefficient": [0.2, 0.6]},
        "noise": {"pulling_tension": {"floor": 0.1, "fraction": 0.01}},
        "per_trial": False,
        "loss": "huber",
        "starts": 3,
        "seed": 5,
        "nodes": 16,
    }


def test_averaged_holds(answer_of, tmp_path):
    """Two weights, five samples each: two readings, whose ln(T / W) / pi scatters by nothing."""
    pull = np.array([5.0, 10.0]) * np.exp(0.42 * np.pi)
    rows = [f"{weight},180,{p + e:.9f}" for weight, p in zip((5, 10), pull, strict=True) for e in (-2, 1, 0, 2, -1)]
    (tmp_path / "drum.csv").write_text("weight [N],wrap_angle [deg],pulling_tension [N]\n" + "\n".join(rows))
    options = ("--free", "friction_coefficient", "--average-holds", "--noise", "pulling_tension=0.1 N")
    answer = answer_of("fit", PAPER, tmp_path / "drum.csv", *options)
    assert [(table["rows"], table["holds_averaged"]) for table in answer["data"]] == [(2, True)]
    assert answer["value"]["friction_coefficient"] == pytest.approx(0.42, rel=1e-6)


@pytest.mark.slow
def test_trials_and_bootstrap_of_the_shipped_data(cddf_command, tmp_path):
    """The truth: mu 0.42, E 1.4 MPa, friction that scatters by 1 % from trial to trial (data/README.md)."""
    table = str(DATA / "tip_angle_simulated.csv")
    options = ("--kinematics", "exact", "--per-trial", "--bootstrap", "20", "--seed", "3")
    code, out, err = cddf_command("fit", PAPER, table, *options, "--out", tmp_path)
    assert (code, err) == (0, "")
    markdown = (tmp_path / "report.md").read_text()
    for line in markdown.splitlines()[2:5]:  # the same first lines on the terminal and in the report
        assert line.removeprefix("- ") in out
    assert re.match(r"# .*\n\n- friction_coefficient = 0\.4\d* \+- .*: identified\n- youngs_modulus = 1\.", markdown)
    results = json.loads((tmp_path / "results.json").read_text())
    assert [(b["kind"], b["replicates"], b["seed"]) for b in results["bootstraps"]] == [
        ("parametric", 20, 3),
        ("cases", 20, 3),
    ]
    assert "bootstrap, cases, 20 refits:\n  friction_coefficient +- " in out
    effects = results["trial_effects"]
    assert list(effects) == [f"tip_angle_simulated.csv: {k}" for k in (1, 2, 3)]
    assert all(abs(effect["value"]) < 0.05 and 0 < effect["standard_error"] < 0.05 for effect in effects.values())
    assert "| tip_angle_simulated.csv: 1 | " in markdown
    assert "## Model-free friction" in markdown
    again = repeated(results, tmp_path)
    assert again.value == pytest.approx(results["value"], rel=1e-9)
    assert again.trial_spread == pytest.approx(results["trial_spread"], rel=1e-6)


# --- reproduce -----------------------------------------------------------------------------------


def test_reproduce(answer_of, tmp_path):
    answer = answer_of("reproduce", PAPER, LOAD_CELLS, "--out", tmp_path)
    rows = {row["name"]: row for row in answer["table"]}
    assert rows["tension_loss"]["ours"] == pytest.approx(1 - 45.122927013148 / 75, rel=1e-8)  # design.md section 3
    assert rows["levels"]["ours"] == 17
    assert {path.name for path in tmp_path.iterdir()} == set(answer["files"])
    assert json.loads((tmp_path / "reproduction.json").read_text()) == answer


def test_reproduce_in_words_and_in_its_own_folder(cddf_command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = cddf_command("reproduce", PAPER, LOAD_CELLS)
    assert (code, err) == (0, "")
    assert "| tension loss at 75 N | 40.00 % | 39.84 % |" in out
    assert (tmp_path / "out" / "reproduce" / "fig8_tip_tension.pdf").exists()


# --- help and processes --------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [(), ("solve",), ("fit",), ("reproduce",)])
def test_help(cddf_command, arguments):
    code, out, err = cddf_command(*arguments, "--help")
    assert (code, err) == (0, "")
    assert "Usage: " in out
    assert "--help" in out
    assert all(name in out for name in arguments or ("solve", "fit", "reproduce"))


@pytest.mark.parametrize("command", ["solve", "fit", "reproduce"])
def test_help_imports_nothing_heavy(command):
    script = (
        "import sys; sys.argv = ['cddf', sys.argv[1], '--help']\n"
        "from cddf_jax.cli import main\n"
        "try: main()\n"
        "except SystemExit as ended: assert ended.code == 0\n"
        "heavy = {'jax', 'jaxlib', 'equinox', 'optimistix', 'scipy', 'numpy', 'matplotlib', 'pint', 'xarray'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_process_of_its_own(tmp_path):
    """As a shell runs it: settings, cache and all."""
    done = separate_process("solve", PAPER, "-t", "75 N", "--json", XDG_CACHE_HOME=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["tip_tension"] == pytest.approx([45.122927013148], rel=1e-8)  # in double precision


@pytest.mark.slow
def test_an_error_in_a_process_of_its_own(tmp_path):
    done = separate_process("fit", PAPER, tmp_path / "none.csv", XDG_CACHE_HOME=str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr == f"error: {tmp_path / 'none.csv'}: cannot be read (No such file or directory); check the path\n"
    )


# --- errors --------------------------------------------------------------------------------------


def test_a_fit_says_how_its_files_were_read(cddf_command, tmp_path):
    """The numbers are 10 exp(0.42 angle), Liu et al. (2020), eq. (5); a trial in each file, one without a reading."""
    angles, files = (45.0, 90.0, 135.0), [tmp_path / "run_1.csv", tmp_path / "run_2.csv"]
    for file, scatter in zip(files, (1.01, 0.99), strict=True):
        rows = [f"{a},10,{scatter * 10 * np.exp(0.42 * np.radians(a)):.4f},{a}" for a in angles]
        file.write_text("\n".join(["Wrap angle (deg),Weight_N,F1,t", *rows, "180,10,,0", ""]))
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


@pytest.fixture
def fails(cddf_command, tmp_path, monkeypatch):
    """Run in an empty folder; the command must end in one line on standard error, and write nothing."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, code=2, files=None):
        for name, text in (files or {}).items():
            (tmp_path / name).write_text(text)
        before = {path: path.read_bytes() for path in tmp_path.iterdir()}
        ended, out, err = cddf_command(*arguments)
        assert (ended, out) == (code, "")
        assert err.startswith("error: ")
        assert err.endswith("\n")
        assert err.count("\n") == 1
        assert "Traceback" not in err
        assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
        return err.removeprefix("error: ").rstrip("\n")

    return run


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "Missing command. Try --help."),
        (("bend",), "No such command 'bend'"),
        (("--bogus",), "No such option: --bogus"),
        (("solve",), "Missing argument 'robot'"),
        (("fit", PAPER), "Missing argument 'data'"),
        (("reproduce", PAPER), "Missing argument 'load_cells'"),
        (("solve", PAPER), "Missing option '--base-tension' / '-t'"),
        (("solve", PAPER, *PULL, "--bogus"), "No such option: --bogus"),
        (("solve", PAPER, *PULL, "more"), "Got unexpected extra argument(s) (more)"),
        (("solve", PAPER, "-t"), "Option '-t' requires an argument"),
        (("solve", PAPER, *PULL, "--nodes", "3"), "Invalid value for '--nodes'"),
        (("fit", PAPER, PULLEY, "--nodes", "two"), "Invalid value for '--nodes'"),
        (("solve", PAPER, *PULL, "--direction", "in"), "Invalid value for '--direction'"),
        (("solve", PAPER, *PULL, "--kinematics", "other"), "Invalid value for '--kinematics'"),
    ],
)
def test_wrong_usage(fails, arguments, message):
    assert fails(*arguments).startswith(message)


@pytest.mark.parametrize(
    ("tension", "message"),
    [
        ("75", "--base-tension needs a unit of force, got '75'; write for example '12.5 N'"),
        ("75 mm", "--base-tension needs a unit of force, got '75 mm'"),
        ("75 stone", "--base-tension needs a unit of force, got '75 stone'"),
        ("much", "--base-tension is not a number, got 'much'"),
        ("", "--base-tension is not a number, got ''"),
        ("nan N", "--base-tension must be finite, got 'nan N'"),
        ("-5 N", "--base-tension"),
    ],
)
def test_wrong_tensions(fails, tension, message):
    assert fails("solve", PAPER, "-t", tension, "--out", "folder").startswith(message)


def test_wrong_directions(fails):
    message = fails("solve", PAPER, *PULL, "--direction", "2", "--out", "folder")
    assert "--direction" in message
    assert "2" in message


def test_wrong_numbers_of_tensions_and_directions(fails, two_tendons):
    assert fails("solve", PAPER, *PULL, *PULL) == "--base-tension: 2 given; give one for all, or one for each of 1"
    message = "--base-tension: 3 given; give one for all, or one for each of 2"
    assert fails("solve", two_tendons, *PULL, *PULL, *PULL) == message
    directions = ["--direction", "1"] * 3
    message = "--direction: 3 given; give one for all, or one for each of 2"
    assert fails("solve", two_tendons, *PULL, *directions) == message


WRONG_TARGETS = [
    ("tip_angle=45", "--base-tension tip_angle needs a unit of angle, got '45'; write for example '12.5 deg'"),
    ("tip_angle=", "--base-tension tip_angle is not a number, got ''; write for example '12.5 deg'"),
    ("tip_angle=45 N", "--base-tension tip_angle needs a unit of angle, got '45 N'; write for example '12.5 deg'"),
    ("tip_angle 45 deg", "--base-tension 'tip_angle 45 deg': write a target with = as in 'tip_angle=45 deg'"),
    ("tip-angle=45 deg", "--base-tension 'tip-angle=45 deg': unknown target 'tip-angle'; did you mean tip_angle?"),
    (
        "mu=0.4",
        "--base-tension 'mu=0.4': unknown target 'mu'; known are displacement, tip_angle, tip_tension, curvature, "
        "total_tension, tip_stiffness",
    ),
    ("displacement=inf mm", "--base-tension displacement must be finite, got 'inf mm'; write for example '12.5 mm'"),
    ("tip_tension=-4 N", "--base-tension 'tip_tension=-4 N': a tendon cannot push; give 0 N or more"),
    ("total_tension=-4 N", "--base-tension 'total_tension=-4 N': a tendon cannot push; give 0 N or more"),
    ("tip_stiffness=0 N/m", "--base-tension 'tip_stiffness=0 N/m': a stiffness is positive; give more than 0 N/m"),
    (
        "curvature=8 1/m",
        "--base-tension 'curvature=8 1/m': say where the curvature is wanted as in 'curvature=8 1/m at 70 mm'",
    ),
    (
        "curvature=8 at 70 mm",
        "--base-tension curvature needs a unit of curvature, got '8'; write for example '12.5 1/m'",
    ),
    (
        "curvature=8 1/m at 70",
        "--base-tension curvature at needs a unit of length, got '70'; write for example '12.5 mm'",
    ),
    (
        "curvature=8 1/m at 150 mm",
        "--base-tension 'curvature=8 1/m at 150 mm': 150 mm is not on the body; give an arc length from 0 mm to 140 mm",
    ),
]


@pytest.mark.parametrize(("target", "message"), WRONG_TARGETS)
def test_wrong_targets(fails, target, message):
    assert fails("solve", PAPER, "-t", target, "--out", "folder") == message


def test_wrong_numbers_of_targets(fails, two_tendons):
    said = fails("solve", two_tendons, "-t", "tip_angle=45 deg")
    assert said == "--base-tension: 1 given with a target among them; give one tension or target for each of 2"


@pytest.mark.parametrize(
    ("option", "text", "message"),
    [
        ("--tip-force", "5 N", "needs two components X, Y, got '5 N'; write for example '0 N, -12.5 N'"),
        ("--tip-force", "1 N, 2 N, 3 N", "needs two components X, Y, got '1 N, 2 N, 3 N'; write for example"),
        ("--tip-force", "0, -5", " X needs a unit of force, got '0'; write for example '12.5 N'"),
        ("--tip-force", "0 N, -5 mm", " Y needs a unit of force, got '-5 mm'; write for example '12.5 N'"),
        ("--tip-force", "down, 5 N", " X is not a number, got 'down'; write for example '12.5 N'"),
        ("--tip-force", "0 N,", " Y is not a number, got ''; write for example '12.5 N'"),
        ("--tip-force", "nan N, 0 N", " X must be finite, got 'nan N'; write for example '12.5 N'"),
        ("--tip-moment", "0.1", "needs a unit of moment, got '0.1'; write for example '12.5 N m'"),
        ("--tip-moment", "0.1 mm", "needs a unit of moment, got '0.1 mm'; write for example '12.5 N m'"),
        (
            "--tip-moment",
            "0.1 N m, 0",
            "needs a unit of moment, got '0.1 N m, 0' with the unknown unit 'N m, 0'; write",
        ),
        ("--tip-moment", "strong", "is not a number, got 'strong'; write for example '12.5 N m'"),
        ("--gravity", "9.81 m/s^2", "needs two components X, Y, got '9.81 m/s^2'; write for example '0 m/s^2, -12.5"),
        ("--gravity", "0, -9.81 m", " X needs a unit of acceleration, got '0 m'; write for example '12.5 m/s^2'"),
        (
            "--gravity",
            "0, -1 g_0",
            "'0, -1 g_0': the body has no weight, since its density is 0; "
            'give in its file density = "1070 kg/m^3", mass_per_length = "0.12 kg/m" or a [[point_mass]]',
        ),
    ],
)
def test_wrong_loads(fails, option, text, message):
    said = fails("solve", PAPER, *PULL, option, text, "--out", "folder")
    assert said.startswith(f"{option} {message.lstrip()}")


def test_a_target_out_of_reach(fails, heavy):
    said = fails("solve", heavy, "-t", "tip_angle=400 deg", "--out", "folder", code=1)
    pattern = (
        "--base-tension 'tip_angle=400 deg': no tension between slack and crossing fibres gives it, "
        r"the nearest is (\S+) deg at (\S+) N; change the target"
    )
    angle, tension = map(float, re.fullmatch(pattern, said).groups())
    # fibres cross at the base, where d kappa = T d^2 / (E J) = 1; the angle there follows from the closed form
    most = 1.4e6 * section(0.0) / 0.010**2
    assert tension == pytest.approx(most, rel=1e-3)
    assert angle == pytest.approx(np.degrees(np.log(1 + 0.42 / 1.4e6 * G * most) / 0.42), rel=1e-3)


def test_a_displacement_that_would_take_a_push(fails, heavy):
    said = fails("solve", heavy, "-t", "displacement=-3 mm", "--out", "folder", code=1)
    assert said == (
        "--base-tension 'displacement=-3 mm': the tendon would have to push, the nearest is 0 mm at 0 N; "
        "change the target"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("140 mm", "140 N"), "length needs a unit of length, got '140 N'; write for example '12.5 mm'"),
        (("140 mm", "140"), "length needs a unit of length, got '140'"),
        (('"140 mm"', "140 mm"), "is not TOML"),
        (("1.4 MPa", "-1.4 MPa"), "youngs_modulus must be above 0, got -1.4e+06 Pa"),
        (("= 0.42", "= -0.42"), "friction_coefficient must be 0 or more, got -0.42"),
        (("= 0.42", '= "slippery"'), "friction_coefficient is not a number, got 'slippery'"),
        (('"published"', '"printed"'), "kinematics must be one of ('published', 'exact'), got 'printed'"),
        (("7 mm", "13 mm"), "outer_radius must exceed inner_radius: at s = 140 mm"),
        (("side = 1", "side = 2"), "tendon 1: side must be 1 or -1, got 2"),
        (("youngs_modulus", "young_modulus"), "unknown key 'young_modulus'; did you mean youngs_modulus?"),
    ],
)
@pytest.mark.parametrize("command", [("solve", *PULL), ("fit", PULLEY)])
def test_wrong_manipulators(fails, command, change, message):
    text = Path(PAPER).read_text()
    assert change[0] in text
    said = fails(command[0], "robot.toml", *command[1:], files={"robot.toml": text.replace(*change)})
    assert said.startswith(f"robot.toml: {message}")


def test_columns_that_are_said_badly(fails):
    said = fails("fit", PAPER, PULLEY, "--column", "wrap_angle")
    assert said.startswith("--column 'wrap_angle': write the head of a column and what it is, as in")
    twice = ("--column", "a=trial", "--column", "a=weight [N]")
    assert fails("plan", PAPER, PULLEY, *twice) == "--column a is given twice; leave one out"
    said = fails("reproduce", PAPER, LOAD_CELLS, "--column", "a=trial")
    assert said.startswith("load_cells_simulated.csv: no column 'a'")


def test_files_that_are_not_there(fails):
    remedy = "cannot be read (No such file or directory); check the path"
    assert fails("solve", "none.toml", *PULL) == f"none.toml: {remedy}"
    assert fails("fit", PAPER, PULLEY, "none.csv") == f"none.csv: {remedy}"
    assert fails("reproduce", PAPER, "none.csv") == f"none.csv: {remedy}"
    assert fails("fit", PAPER, ".").startswith(".: cannot be read (Is a directory)")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("base_tension [N],tip_tension [N]\n5,4.8\n10,9.O1\n", "row 3, column tip_tension: '9.O1' is not a number"),
        ("base_tension [N],tip_tension [N]\n5,\n", "no row holds a reading (tip_tension); add the measurements"),
        ("base_tension [N],tip_tension [N]\n5,-4.8\n", "row 2, column tip_tension: must be 0 or more, got -4.8 N"),
        ("# note\nbase_tension [N],tip_tension [N]\n5\n", "row 3 has 1 cells, the header 2"),
        (
            "base_tension [mm],tip_tension [N]\n5,4.8\n",
            "row 1: the column base_tension needs a unit of force, got [mm]",
        ),
        ("base_tension [N],tip_tention [N]\n5,4.8\n", "unknown column 'tip_tention'; did you mean tip_tension?"),
        ("base_tension [N],tip_tension [N]\n", "has a header but no rows"),
        ("", "is empty"),
        ("base_tension [N],direction,tip_tension [N]\n5,0,4.8\n", "row 2, column direction: must be 1 or -1, got 0"),
        ("tip_tension [N]\n5\n", "the column base_tension is missing"),
    ],
)
def test_wrong_tables(fails, table, message):
    said = fails("fit", PAPER, PULLEY, "bench.csv", "--out", "folder", files={"bench.csv": table})
    assert said.startswith("bench.csv: ")
    assert message in said


def test_tables_that_do_not_fit_the_manipulator(fails, two_tendons):
    said = fails("fit", two_tendons, LOAD_CELLS)
    assert said.endswith("no column 'base_tension_2'; a manipulator of 2 tendons needs it")
    said = fails("fit", PAPER, "bench.csv", files={"bench.csv": "base_tension [N]\n5\n"})
    assert said.startswith("bench.csv: nothing observed; add a column tip_tension [N]")
    table = "base_tension [N],base_tension_2 [N],tip_tension [N]\n5,5,4.8\n"
    said = fails("fit", PAPER, "bench.csv", files={"bench.csv": table})
    assert said.startswith("bench.csv: column 'base_tension_2', but the manipulator has 1 tendon(s)")
    said = fails("reproduce", PAPER, PULLEY)
    assert said.startswith("pulley_simulated.csv: the column tip_tension is missing")
    assert fails("reproduce", two_tendons, LOAD_CELLS).startswith("the paper's manipulator has one tendon")


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ("youngs_modulus", "--prior 'youngs_modulus': write a parameter, mean and deviation as in"),
        ("youngs_modulus=1.4 MPa", "--prior 'youngs_modulus=1.4 MPa': write a parameter, mean and deviation as in"),
        ("mu=0.4 +- 0.1", "'mu' is no parameter that can be fitted; there are friction_coefficient, youngs_modulus"),
        ("friction_coefficient=0.1..", "--prior friction_coefficient is not a number, got ''"),
        ("friction_coefficient=0.6..0.7", "friction_coefficient starts at 0.42, which is not inside its bounds 0.6 to"),
        ("youngs_modulus=1.4 N +- 1 N", "--prior youngs_modulus needs a unit of pressure, got '1.4 N'"),
        ("youngs_modulus=1.4 MPa +- 0.1", "--prior youngs_modulus needs a unit of pressure, got '0.1'"),
        ("youngs_modulus=1.4 MPa +- 0 MPa", "prior for youngs_modulus: needs a mean and a standard deviation > 0"),
        ("friction_coefficient=0.4 N +- 0.1", "--prior friction_coefficient is a plain number, got '0.4 N'"),
        ("length=140 mm +- 1 mm", "prior for 'length', which is not fitted; fitted are friction_coefficient"),
    ],
)
def test_wrong_priors(fails, prior, message):
    assert fails("fit", PAPER, PULLEY, "--prior", prior, "--out", "folder").startswith(message)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ("pulling_tension", "--noise 'pulling_tension': write a column and a standard deviation as in"),
        ("pulling_tension=loud", "--noise pulling_tension is not a number, got 'loud'"),
        ("pulling_tension=0.5 mm", "--noise pulling_tension needs a unit of force, got '0.5 mm'"),
        ("pulling_tension=0.5", "--noise pulling_tension needs a unit of force, got '0.5'"),
        ("tip_angle=1 N", "--noise tip_angle needs a unit of angle, got '1 N'"),
        ("tip_angle=1 deg", "fit: noise is given for 'tip_angle', which no table holds; they hold pulling_tension"),
        ("pulling_tension=0.1 N + 0.2 N", "--noise pulling_tension: the part that grows with the reading is in %, got"),
        ("pulling_tension=0.1 N + x %", "--noise pulling_tension is not a number, got 'x'"),
        ("pulling_tension=0.1 N + -1 %", "sigma of pulley_simulated.csv: pulling_tension: floor and fraction must be"),
        ("pulling_tension=0 N", "sigma of pulley_simulated.csv: pulling_tension must be > 0"),
        ("pulling_tension=-1 N", "sigma of pulley_simulated.csv: pulling_tension must be > 0"),
    ],
)
def test_wrong_noise(fails, noise, message):
    assert fails("fit", PAPER, PULLEY, "--noise", noise, "--out", "folder").startswith(message)


@pytest.mark.parametrize(
    ("bound", "message"),
    [
        ("friction_coefficient", "--bound 'friction_coefficient': write a parameter and its limits as in"),
        ("friction_coefficient=:", "--bound 'friction_coefficient=:': write a parameter and its limits as in"),
        ("mu=0:1", "'mu' is no parameter that can be fitted"),
        ("youngs_modulus=1:2 MPa", "--bound youngs_modulus needs a unit of pressure, got '1'"),
        ("length=130 mm:150 mm", "bounds for 'length', which is not fitted; fitted are friction_coefficient"),
        ("friction_coefficient=0.5:1", "friction_coefficient starts at 0.42, which is not inside its bounds 0.5 to 1"),
    ],
)
def test_wrong_bounds(fails, bound, message):
    assert fails("fit", PAPER, PULLEY, "--bound", bound, "--out", "folder").startswith(message)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--loss", "square"), "Invalid value for '--loss'"),
        (("--starts", "0"), "Invalid value for '--starts'"),
        (("--bootstrap", "-1"), "Invalid value for '--bootstrap'"),
        (("--bootstrap", "1"), "bootstrap: needs 2 replicates or more, got 1"),
        (("--prior", "friction_coefficient=0.4 +- 0.1") * 2, "--prior friction_coefficient is given twice"),
        (("--per-trial", "--free", "youngs_modulus"), "fit: per_trial needs a free friction_coefficient"),
    ],
)
def test_wrong_options_of_a_fit(fails, options, message):
    assert fails("fit", PAPER, PULLEY, *options, "--out", "folder").startswith(message)


@pytest.mark.parametrize(
    ("free", "message"),
    [
        ("mu", "fit: 'mu' is no parameter that can be fitted; there are friction_coefficient, youngs_modulus"),
        ("density", "fit: 'density' is no parameter that can be fitted"),
    ],
)
def test_wrong_parameters(fails, free, message):
    assert fails("fit", PAPER, PULLEY, "--free", free, "--out", "folder").startswith(message)


@pytest.mark.parametrize("command", [("solve", PAPER, *PULL), ("fit", PAPER, PULLEY), ("reproduce", PAPER, LOAD_CELLS)])
@pytest.mark.parametrize("place", ["taken", "taken/below"])
def test_out_where_a_file_is(fails, command, place):
    said = fails(*command, "--out", place, files={"taken": "kept"})
    assert said.startswith(f"{place}: ")
    assert said.endswith("; choose another place")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        # d kappa = T d^2 / (E J) reaches 1 at the base at 1733 N, exact kinematics
        (("-t", "2500 N", "--kinematics", "exact"), "offset * curvature"),
        # sliding out, T(s) = T / (1 - mu T G / E) has no end at T = E / (mu G(L)) = 113 N
        (("-t", "120 N", "--direction", "-1"), "locks"),
    ],
)
def test_a_solve_that_fails(fails, arguments, message):
    assert message in fails("solve", PAPER, *arguments, "--out", "folder", code=1)


LOCKED = "base_tension [N],tip_tension [N],direction\n200,300,-1\n210,305,-1\n220,310,-1\n"


def test_a_fit_that_fails(cddf_command, tmp_path):
    """At 200 N the model has no solution: one line on standard error, and what was found is called a failure."""
    (tmp_path / "locked.csv").write_text(LOCKED)
    code, out, err = cddf_command("fit", PAPER, tmp_path / "locked.csv", "--json")
    assert code == 1
    assert err.startswith("error: the fit failed: ")
    assert err.count("\n") == 1
    assert json.loads(out)["success"] is False


def test_a_fit_that_fails_with_a_folder(cddf_command, tmp_path):
    """No traceback from figures of numbers that are none; what is written is whole."""
    (tmp_path / "locked.csv").write_text(LOCKED)
    code, _, err = cddf_command("fit", PAPER, tmp_path / "locked.csv", "--out", tmp_path / "folder")
    assert code == 1
    assert err.startswith("error: the fit failed: ")
    if (tmp_path / "folder").exists():
        assert json.loads((tmp_path / "folder" / "results.json").read_text())["success"] is False


def test_a_failure_while_writing_leaves_nothing(fails, monkeypatch):
    """A disk that is full shows as one line, and the folder holds no half of a result."""

    def full(self, content):
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    code = fails("solve", PAPER, *PULL, "--out", ".")
    assert "No space left on device" in code


def test_a_bug_of_ours_is_not_hidden(monkeypatch):
    def broken(path):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("cddf_jax.manipulator_file.read_manipulator", broken)
    monkeypatch.setattr(sys, "argv", ["cddf", "solve", PAPER, *PULL])
    with pytest.raises(ZeroDivisionError, match="a bug"):
        cli.main()


def test_fit_and_plan_average_holds_alike(tmp_path):
    """Both read their files by `_tables`; by hand, the means of two holds."""
    from cddf_jax.cli import _tables

    path = tmp_path / "bench.csv"
    path.write_text("base_tension [N], tip_tension [N]\n5, 4.7\n5, 4.9\n10, 9.2\n")
    (plain,), (means,) = _tables([path], None), _tables([path], None, True)
    assert plain["tip_tension"].tolist() == [4.7, 4.9, 9.2]
    assert means["tip_tension"].tolist() == pytest.approx([4.8, 9.2])
