"""`cddf trace`: the table of a loop that was derived by hand and met by a simulation, and what is refused."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import paper_body
from places import DATA
from refusals import refused

import cddf_jax as cddf
from cddf_jax.cli.trace import read_paths
from cddf_jax.files.manipulator_file import write_manipulator
from cddf_jax.reports.trace_report import TracedPath, trace_as_dict, traced

# base tension and tip tension, N, tip angle, deg, front, mm, energy lost so far, mJ: of a play in 1/T in closed form,
# met by a time-stepping simulation without fronts
TABLE = np.array(
    [
        (0, 0, 0, 140, 0),
        (75, 45.122927, 69.313929, 140, 59.726),
        (60, 45.122927, 67.619267, 51.564, 60.423),
        (40, 45.122927, 56.053731, 115.089, 70.931),
        (20, 24.288558, 26.502447, 140, 96.029),
        (0, 0, 0, 140, 99.331),
        (75, 45.122927, 69.313929, 140, 159.057),
    ]
)
PATH = ", ".join(f"{tension:g}" for tension in TABLE[:, 0]) + " N"


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "exact.toml"
    write_manipulator(paper_body("exact"), path)
    return path


@pytest.mark.slow
def test_a_loop_in_json_and_in_files(answer_of, robot, tmp_path):
    answer = answer_of("trace", robot, "--path", PATH, "--out", tmp_path / "out")
    base, tip, angle, front, lost = TABLE.T
    assert answer["base_tension"] == base.tolist()
    np.testing.assert_allclose(answer["tip_tension"], tip, atol=6e-7)
    np.testing.assert_allclose(np.degrees(answer["tip_angle"]), angle, atol=6e-7)
    np.testing.assert_allclose(1e3 * np.array(answer["front"]), front, atol=6e-4)
    np.testing.assert_allclose(1e3 * np.array(answer["friction_loss"]), lost, atol=6e-4)
    balance = np.subtract(answer["work"], np.add(answer["stored_energy"], answer["friction_loss"]))
    np.testing.assert_allclose(balance, 0.0, atol=1e-9 * max(answer["work"]))
    # 415.405749 mJ are put in and 180.084821 + 135.989798 mJ come back
    assert answer["friction_loss"][5] == pytest.approx(99.331129e-3, abs=1e-9)
    files = {path.name: path for path in (tmp_path / "out").iterdir()}
    assert set(files) == {"trace.json", "loop.csv", "fields.csv", "trace.pdf", "trace.png"}
    assert json.loads(files["trace.json"].read_text()) == answer
    loop = np.genfromtxt(files["loop.csv"], delimiter=",", names=True, deletechars="")
    assert len(loop) == 256
    whole = loop[loop["step"] % 1 == 0]
    np.testing.assert_allclose(whole["tip_tension_[N]"], answer["tip_tension"], rtol=1e-8)  # nine digits are written
    between = loop[(loop["step"] > 1) & (loop["step"] < 2)]  # T / (1 + g T), by the closed form at 75 N
    g = 1 / TABLE[1, 1] - 1 / 75
    np.testing.assert_allclose(between["tip_tension_[N]"], 1 / (1 / between["base_tension_[N]"] + g), rtol=1e-7)
    fields = np.genfromtxt(files["fields.csv"], delimiter=",", names=True, deletechars="")
    middle = fields[np.isclose(fields["arc_length_[m]"], 0.07)]
    assert middle["step"].tolist() == [1, 2, 3, 4, 5, 6, 7]
    np.testing.assert_allclose(middle["tension_1_[N]"][1:5], [62.977492, 62.977492, 44.534217, 21.072753], atol=6e-7)


def test_a_loop_in_words(cddf_command, robot):
    code, out, err = cddf_command("trace", robot, "--path", "0 N, 75 N, 40 N, 75 N, 75 N")
    assert (code, err) == (0, "")
    start, pull, release, back, stay, work, last = out.splitlines()
    assert start == "1: 0 N, at rest"
    tip, travel = "tip tension 45.123 N, tip angle", f"pulled in {1e3 * 0.010 * np.radians(69.313929):.5g} mm"
    assert pull == f"2: pulled to 75 N, slides in along the whole body; {tip} 69.314 deg, {travel}"
    assert release.startswith(f"3: released to 40 N, slides out up to 115.09 mm and rests beyond; {tip} 56.054 deg, ")
    assert back == f"4: pulled to 75 N, slides in along the whole body; {tip} 69.314 deg, {travel}"
    assert stay == f"5: stays at 75 N; {tip} 69.314 deg, {travel}"
    # the area within the loop of base tension over tendon displacement, by trapezoids
    found = traced(paper_body("exact"), [[0.0, 75.0, 40.0, 75.0, 75.0]], ["force"], None, 16, 4)
    loop = slice(found.steps[1], found.steps[3] + 1)
    pulls, travels = (found.numbers[name][loop] for name in ("base_tension", "tendon_displacement"))
    area = 1e3 * np.trapezoid(pulls, travels, axis=0).item()
    put_in, stored, lost = re.findall(r"([\d.]+) mJ", work)
    assert stored == "355.68"
    assert float(put_in) - 415.405749 == pytest.approx(area, rel=1e-3)
    assert float(lost) - 59.726 == pytest.approx(area, rel=1e-3)  # of the first pull
    assert last.startswith("error estimate ")
    assert last.endswith("; successful")


def test_jitter_of_a_file_makes_no_turns(cddf_command, robot, tmp_path, monkeypatch):
    """Up to 75 N and back to 40 N in readings that jitter by 0.1 N: of their 9 turns one is a turn of the tendon."""
    monkeypatch.chdir(tmp_path)
    read = [20.0, 19.9, 40.0, 39.85, 60.0, 74.9, 75.0, 60.0, 60.1, 50.0, 50.15, 40.0]
    (tmp_path / "bench.csv").write_text("Tbase (N)\n" + "".join(f"{x}\n" for x in read))
    assert np.sum(np.diff(np.sign(np.diff([0.0, *read]))) != 0) == 9  # from rest
    code, out, err = cddf_command("trace", robot, "--path", "bench.csv", "--noise", "0.1 N")
    assert code == 0
    assert err.splitlines() == [
        "note: bench.csv: read as: 'Tbase (N)' base_tension [N]",
        "note: 8 turns of the base tension are taken for jitter and left out",
    ]
    steps = [line for line in out.splitlines() if line[0].isdigit()]
    last = max(i for i, line in enumerate(steps) if "slides in" in line)
    assert not any("slides out" in line for line in steps[:last])
    assert not any("slides in" in line for line in steps[last + 1 :])
    assert steps[-1].startswith("12: released to 40 N, slides out up to 115.")


@pytest.mark.parametrize(
    ("path", "noise", "message"),
    [
        ("0 N, 75 N", "0.1 N", "--noise 0.1 N: is for a file only; leave it out, or give a file with --path"),
        ("bench.csv", "0 N", "--noise 0 N: give a standard deviation above 0 N, or leave it out"),
        ("angle.csv", "0.1 N", "is for base tensions, and angle.csv has none; leave it out"),
    ],
)
def test_a_noise_that_has_no_meaning(fails, robot, path, noise, message):
    files = {"bench.csv": "base_tension [N]\n1\n2\n", "angle.csv": "tip_angle [deg]\n1\n2\n"}
    assert message in fails("trace", robot, "--path", path, "--noise", noise, files=files).splitlines()[-1]


@pytest.mark.slow
def test_a_tendon_that_would_have_to_push_is_slack(cddf_command, robot):
    """10 mm times the angle is the displacement: 0 where the body is straight, and less only by a push."""
    code, out, _ = cddf_command("trace", robot, "--path", "5 mm, -1 mm, 2 mm")
    assert code == 0
    hangs = "2: released to 0 N, slides out along the whole body; tip tension 0 N, tip angle 0 deg, pulled in 0 mm"
    assert out.splitlines()[1] == f"{hangs}; the tendon is slack, as it would have to push"
    assert f"tip angle {np.degrees(0.2):.5g} deg, pulled in 2 mm" in out.splitlines()[2]


def test_the_answer_states_the_loads():
    at_rest: Any = SimpleNamespace(status=np.zeros(1, int))
    answer = trace_as_dict(TracedPath(paper_body(), at_rest, [0], {}, cddf.Loads(gravity=(0.0, -9.81))))
    loads: Any = answer["loads"]
    assert list(loads.gravity) == [0.0, -9.81]


def test_tip_angles_under_loads_are_no_tensions(cddf_command, robot, monkeypatch):
    def stop(body, given, *_, **options):
        (goal,) = given
        assert isinstance(goal, cddf.TipAngle)
        assert np.degrees(np.asarray(goal.value))[-1] == pytest.approx(30.0)
        raise cddf.InputError("far enough")

    monkeypatch.setattr("cddf_jax.reports.trace_report.trace", stop)
    code, _, error = cddf_command("trace", robot, "--path", "60 deg, 30 deg", "--tip-force", "0 N, 0.1 N")
    assert (code, error) == (2, f"error: {robot}: far enough\n")


@pytest.mark.parametrize(
    ("second", "start", "before"), [("20 N", [75.0, 5.0], "rest"), ("2 mm", [40.0, 2e-3], [75.0, 5.0])]
)
def test_tensions_before_displacements(cddf_command, two_tendons, monkeypatch, second, start, before):
    told = []

    def stop(body, given, *_, **options):
        first = given[0] if isinstance(given, np.ndarray) else [np.asarray(getattr(x, "value", x))[0] for x in given]
        told.append((list(map(float, first)), np.asarray(options["before"]).tolist()))
        raise cddf.InputError("far enough")

    monkeypatch.setattr("cddf_jax.reports.trace_report.trace", stop)
    path = "--path", "40, 20 N", "--path", second
    assert cddf_command("trace", two_tendons, *path, "--before", "75, 5 N")[0] == 2
    assert told == [(start, before)]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("75", "--path needs a unit of force, got '75'; write for example '12.5 N'"),
        ("75, -5 N", "--path 75, -5 N: a tendon cannot push; give 0 N or more"),
        ("75 N, much", "--path is not a number, got 'much'; write for example '12.5 N'"),
        ("none.csv", "none.csv: cannot be read (No such file or directory); check the path"),
        ("bad.csv", "bad.csv: row 3, column base_tension: must be 0 or more, got -2 N; correct or remove the row"),
        ("nan.csv", "nan.csv: row 2, column base_tension: must be finite, got nan; correct or remove the row"),
        ("other.csv", "other.csv: row 1: has no column with a path (base_tension or displacement or tip_angle, with"),
        ("trials.csv", "trials.csv: holds 2 trials, but a path is one trial; keep the rows of one, such as a"),
    ],
)
def test_wrong_paths(fails, path, message):
    files = {
        "bad.csv": "base_tension [N]\n1\n-2\n",
        "nan.csv": "base_tension [N]\nnan\n",
        "other.csv": "weight [N], height [m]\n1,2\n",
        "trials.csv": "trial,base_tension [N]\na,1\nb,2\n",
    }
    assert fails("trace", DATA / "smooth_sil_940.toml", "--path", path, files=files).startswith(message)


def test_names_that_a_laboratory_gave(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("t [s];F_soll [N]\n0;0\n1;75,5\n2;40\n")
    Path("b.csv").write_text("Weg [mm]\n0\n12\n5\n")
    Path("c.csv").write_text("Tendon displacement [mm]\n0\n12\n5\n")
    said = refused(read_paths, ["a.csv"], None, 1)
    assert said.endswith("--column \"NAME=base_tension [N]\", where NAME is one of 't [s]', 'F_soll [N]'")
    columns = ["t [s]=time [s]", "F_soll [N]=base_tension [N]", "Weg [mm]=tendon_displacement [mm]"]
    assert read_paths(["a.csv", "b.csv"], None, 2, columns)[0] == [[0, 75.5, 40], [0, 0.012, 0.005]]
    assert read_paths(["c.csv"], None, 1)[0] == [[0, 0.012, 0.005]]
    for path, asked in (("a.csv", "G=time [s]"), ("0 N, 5 N", "G=time [s]")):
        said = refused(read_paths, [path], None, 1, [*columns[: 2 if path == "a.csv" else 0], asked])
        assert said == f"--path {path}: no path takes a column 'G'; check the name"


def test_what_cannot_be_traced(fails, two_tendons):
    lengths = fails("trace", two_tendons, "--path", "75, 60 N", "--path", "20, 10, 5 N")
    assert lengths == "--path: the tendons have 2, 3 steps; give each the same number, or one value that stays"
    assert fails("trace", two_tendons, "--path", "60, 30 deg", "--path", "5 N").startswith("--path: a tip angle drives")
    assert fails("trace", two_tendons, "--path", "60 N", "--before", "75 N").startswith("--before 75 N: give a tension")


@pytest.mark.slow
def test_a_rough_path_is_refused_and_the_remedy_helps(answer_of, fails, two_tendons):
    path = ("--path", "85, 10 N", "--path", "5, 60 N")
    rough = (*path, "--short-steps", 2, "--nodes", 4)
    assert fails("trace", two_tendons, *rough, code=1).endswith("exceeds 0.01: raise --short-steps and --nodes.")
    assert 0 < max(answer_of("trace", two_tendons, *path, "--short-steps", 32, "--nodes", 16)["error_estimate"]) < 0.01


def test_a_step_that_fails(fails, robot):
    zigzag = [level for i in range(9) for level in (90 - i, i)]  # ever smaller: each turn is still remembered
    said = fails("trace", robot, "--path", f"{zigzag}".strip("[]") + " N", "--out", "folder", code=1)
    assert said.startswith("step 17, on the way to 82 N, at 12.")
    assert said.endswith("More turns of the base tension have to be remembered than max_turns. Raise max_turns=.")
