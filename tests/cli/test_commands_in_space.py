"""Commands with the example bodies in space: their numbers, their files, and what is refused in one line."""

import json

import numpy as np
import pandas
import pytest
from places import DATA, ROOT

import cddf_jax as cddf

HELIX, THREE = (str(DATA / f"{name}_made_up.toml") for name in ("helix", "three_tendons"))
PAPER = str(DATA / "smooth_sil_940.toml")
PULL = ("-t", "75 N")
# half a turn on the paper's body, of two independent derivations and codes: mm and N, to all digits printed
TIP, TIP_TENSION = (122.12680351, 17.21060405, 47.09759111), 54.52936051


@pytest.mark.slow
def test_the_helix_in_files(cddf_command, tmp_path):
    code, out, err = cddf_command("solve", HELIX, *PULL, "--out", tmp_path)
    assert (code, err) == (0, "")
    assert "tip at (122.127, 17.211, 47.098) mm, " in out
    assert "tendon 1: tip tension 54.5294 N, loss 27.29 %" in out  # 1 - 54.5294 / 75
    answer = json.loads((tmp_path / "solve.json").read_text())
    np.testing.assert_allclose(1e3 * np.array(answer["tip_position"]), TIP, atol=1e-5)  # 1e-7 of the length
    assert answer["tip_tension"] == pytest.approx([TIP_TENSION], rel=5e-9)
    shapes = {"curvature": (50, 3), "frame": (50, 3, 3), "path": (1, 50, 3), "twist": (50,), "base_moment": (3,)}
    assert {name: np.shape(answer[name]) for name in shapes} == shapes
    table = pandas.read_csv(tmp_path / "fields.csv")
    last = table.iloc[-1]
    np.testing.assert_allclose(1e3 * last[["x [m]", "y [m]", "z [m]"]], TIP, atol=1e-5)
    frame = np.array([[last[f"frame_{i}_{j}"] for j in "xyz"] for i in "xyz"])
    np.testing.assert_allclose(frame, answer["tip_frame"], atol=1e-8)
    # the tendon ends at the angle pi, 10 mm from the axis
    path = last[["path_1_x [m]", "path_1_y [m]", "path_1_z [m]"]].to_numpy(float)
    np.testing.assert_allclose(path, np.array(TIP) / 1e3 + frame @ (0.0, -0.010, 0.0), atol=1e-8)
    np.testing.assert_array_equal(table["twist [1/m]"], table["curvature_x [1/m]"])
    assert {path.name for path in tmp_path.iterdir()} == {"solve.json", "solve.pdf", "solve.png", "fields.csv"}


@pytest.mark.slow
def test_loads_in_space_in_words(cddf_command):
    pulls = ("-t", "10 N", "-t", "0 N", "-t", "0 N")
    loads = ("--tip-force", "0, 0.1, 0 N", "--tip-moment", "0.01, 0, 0 N m")
    code, out, err = cddf_command("solve", THREE, *pulls, *loads)
    assert (code, err) == (0, "")
    assert "loads: tip force (0, 0.1, 0) N, tip moment (0.01, 0, 0) N m, gravity (0, 0, 0) m/s^2" in out
    # r x F + m about the base
    tip = [1e-3 * float(x) for x in out.partition("(")[2].partition(")")[0].split(",")]
    told = out.partition("base: (")[2].partition(")")[0].split(",")
    np.testing.assert_allclose([float(x) for x in told], [0.01 - 0.1 * tip[2], 0.0, 0.1 * tip[0]], atol=1e-6)


@pytest.mark.slow
def test_the_example_of_a_routing(cddf_command, tmp_path):
    """It stays parallel: T_base = (exp(mu phi) - 1) / (mu d int ds / E J) with d as far out as it may, eq. (13).

    The tip of the bent body lies across the axis at the angle of the tendon.
    """
    code, _, err = cddf_command("design", ROOT / "fitting" / "design_routing.toml", "--out", tmp_path)
    assert (code, err) == (0, "")
    s, step = np.linspace(0.0, 0.2, 20001, retstep=True)
    compliance = 1 / (1.4e6 * np.pi / 4 * ((0.015 - 0.015 * s) ** 4 - 0.005**4))
    whole = step * (compliance.sum() - 0.5 * (compliance[0] + compliance[-1]))
    answer = json.loads((tmp_path / "design.json").read_text())
    assert answer["objective"] == pytest.approx(np.expm1(0.25 * np.pi / 3) / (0.25 * 0.010 * whole), rel=1e-7)
    tendon, body = {name: free["value"] for name, free in answer["free"].items()}, tmp_path / "design.toml"
    assert tendon["tendons.0.angle.tip"] == pytest.approx(tendon["tendons.0.angle.base"], abs=1e-6)
    _, y, z = cddf.solve(cddf.read_manipulator(body), (answer["objective"], 0.0, 0.0), direction=1).tip_position
    assert z == pytest.approx(0.060, rel=1e-7)
    assert np.arctan2(z, y) == pytest.approx(tendon["tendons.0.angle.base"], abs=1e-6)
    names = {"design.json", "design.md", "design.pdf", "design.png", "design.toml", "profile.csv"}
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve", HELIX, *PULL, "--kinematics", "published"), "--kinematics published: Manipulator: the published"),
        (("solve", PAPER, *PULL, "--tip-force", "0, 0, 1 N"), "smooth_sil_940.toml: Manipulator: the published"),
        (("solve", HELIX, *PULL, "--gravity", "0, 0, -9.81 m/s^2"), "loads.gravity: the body has no weight"),
        (("solve", HELIX, *PULL, "--tip-moment", "0, 0.1 N m"), "is one number in the plane and three in space"),
        (("reproduce", HELIX, str(DATA / "load_cells_simulated.csv")), "in a plane, this one is in space; remove"),
    ],
)
def test_refused_in_one_line(fails, arguments, message):
    assert message in fails(*arguments)
