"""`cddf solve`: answers against the library and closed forms."""

import json
import re

import numpy as np
import pytest
from bodies import PAPER as DIMENSIONS, paper_body
from places import DATA

import cddf_jax as cddf
from cddf_jax.files.manipulator_file import write_manipulator
from cddf_jax.reports.solve_report import solve_as_dict

PAPER = str(DATA / "smooth_sil_940.toml")
PULL = ("-t", "75 N")


def test_solve_in_words(cddf_command):
    code, out, err = cddf_command("solve", PAPER, "-t", "75 N")
    assert (code, err) == (0, "")
    # docs/theory.md (16), published kinematics: (120.39593, 57.00182) mm, 63.16687 degrees, 45.1229 N, 39.84 %
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
    assert answer["tip_tension"] == pytest.approx([45.122927013148], rel=1e-8)  # docs/theory.md (16)
    assert {"arc_length", "curvature", "heading", "position", "tension", "normal_force"} <= set(answer)
    targets = solve_as_dict(equilibrium, [cddf.CurvatureAt(8.0, 0.07)], None)["targets"]
    assert targets == [{"curvature": 8.0, "arc_length": 0.07}]


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
    # a tendon parallel to the axis travels d phi = 10 mm * 69.31393 degrees (docs/theory.md (16)), the other way here
    assert "tendon 2: no tension, pulled in -12.098 mm" in out


# --- loads ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """The paper's body in the exact kinematics, with the density of silicone."""
    path = tmp_path_factory.mktemp("robot") / "heavy.toml"
    write_manipulator(paper_body("exact", density=1070.0), path)
    return path


def test_the_moment_at_the_base_is_that_of_statics(answer_of, cddf_command, heavy):
    arguments = ("solve", heavy, *PULL, "--tip-force", "3 N, -5 N", "--tip-moment", "0.1 N m")
    answer = answer_of(*arguments)
    x, y = answer["tip_position"]
    assert answer["base_moment"] == pytest.approx(x * -5.0 - y * 3.0 + 0.1, rel=1e-9)  # r x F + m about the base
    assert answer["loads"] == {"tip_force": [3.0, -5.0], "tip_moment": 0.1, "gravity": [0.0, 0.0], "points": []}
    assert (answer["base_tension"], answer["load_fraction"], answer["stable"]) == ([75.0], 1.0, True)
    code, out, err = cddf_command(*arguments)
    assert (code, err) == (0, "")
    assert out.splitlines()[3:5] == [
        "loads: tip force (3, -5) N, tip moment 0.1 N m, gravity (0, 0) m/s^2",
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

G = 2.942783188998e4  # m^-2, G(L) of docs/theory.md (16)


def section(s):
    """J of the paper's body, m^4."""
    (base, tip), inner, length = DIMENSIONS["outer_radius"], DIMENSIONS["inner_radius"], DIMENSIONS["length"]
    return np.pi / 4 * ((base + (tip - base) * s / length) ** 4 - inner**4)


def test_a_target_meets_the_closed_form(answer_of, cddf_command, heavy):
    """The closed form: T_base - T_tip = mu / E G T_base T_tip, and T_tip = T_base exp(-mu phi) of the capstan law."""
    answer = answer_of("solve", heavy, "-t", "tip_angle=45 deg")
    tip_tension = (1 - np.exp(-0.42 * np.pi / 4)) / (0.42 / 1.4e6 * G)
    assert answer["tip_angle"] == pytest.approx(np.pi / 4, rel=1e-7)
    assert answer["tip_tension"] == pytest.approx([tip_tension], rel=1e-7)
    assert answer["base_tension"] == pytest.approx([tip_tension * np.exp(0.42 * np.pi / 4)], rel=1e-7)
    assert answer["tendon_displacement"] == pytest.approx([0.01 * np.pi / 4], rel=1e-7)
    assert answer["targets"] == [{"tip_angle": pytest.approx(np.pi / 4, rel=1e-15)}]
    assert abs(answer["target_miss"][0]) < 1e-6
    code, out, err = cddf_command("solve", heavy, "-t", "tip_angle=45 deg")
    assert (code, err) == (0, "")
    # T_tip = 31.8271 N, loss 1 - exp(-0.42 pi / 4) = 28.10 %, travel 10 mm * pi / 4
    line = "tendon 1: base tension 44.2646 N gives tip_angle=45 deg, tip tension 31.8271 N, loss 28.10 %, "
    assert line + "pulled in 7.854 mm" in out


def test_a_target_out_of_reach(fails, heavy):
    said = fails("solve", heavy, "-t", "tip_angle=400 deg", "--out", "folder", code=1)
    pattern = (
        "--base-tension 'tip_angle=400 deg': no tension between slack and crossing fibres gives it, "
        r"the nearest is (\S+) deg at (\S+) N; change the target"
    )
    angle, tension = map(float, re.findall(f"^{pattern}$", said)[0])
    # fibres cross at the base, where d kappa = T d^2 / (E J) = 1; the angle there follows from the closed form
    most = 1.4e6 * section(0.0) / 0.010**2
    assert tension == pytest.approx(most, rel=1e-3)
    assert angle == pytest.approx(np.degrees(np.log(1 + 0.42 / 1.4e6 * G * most) / 0.42), rel=1e-3)


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
