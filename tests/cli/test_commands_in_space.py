"""Commands with the example bodies in space: their numbers, their files, and what is refused in one line."""

import dataclasses
import json

import numpy as np
import pandas
import pytest
from bodies import fields_at
from places import DATA, ROOT
from scipy.spatial.transform import Rotation

import cddf_jax as cddf

HELIX, THREE = (str(DATA / f"{name}_made_up.toml") for name in ("helix", "three_tendons"))
PAPER = str(DATA / "smooth_sil_940.toml")
PULL = ("-t", "75 N")
# half a turn on the paper's body, of two independent derivations and codes: mm and N, to all digits printed
TIP, TIP_TENSION = (122.12680351, 17.21060405, 47.09759111), 54.52936051


def test_the_helix_in_words(cddf_command):
    code, out, err = cddf_command("solve", HELIX, *PULL)
    assert (code, err) == (0, "")
    assert "tip at (122.127, 17.211, 47.098) mm, " in out
    assert "tendon 1: tip tension 54.5294 N, loss 27.29 %" in out  # 1 - 54.5294 / 75


@pytest.mark.slow
def test_the_helix_in_files(cddf_command, tmp_path):
    code, _, err = cddf_command("solve", HELIX, *PULL, "--out", tmp_path)
    assert (code, err) == (0, "")
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
def test_three_tendons_have_a_closed_form(answer_of):
    """Parallel tendons of one friction that all slide in keep the ratio of their tensions: as one tendon, eq. (13)."""
    answer = answer_of("solve", THREE, "-t", "10 N", "-t", "7 N", "-t", "0 N")
    pull = 0.009 * np.abs(10.0 + 7.0 * np.exp(2j * np.pi / 3))  # N m at the base
    s, step = np.linspace(0.0, 0.2, 20001, retstep=True)
    compliance = 1 / (1.4e6 * np.pi / 4 * ((0.015 - 0.015 * s) ** 4 - 0.005**4))
    whole = step * (compliance.sum() - 0.5 * (compliance[0] + compliance[-1]))
    left = 1 / (1 + 0.25 * pull * whole)
    assert answer["tip_tension"] == pytest.approx([10 * left, 7 * left, 0.0], rel=1e-7)
    assert answer["tip_angle"] == pytest.approx(-np.log(left) / 0.25, rel=1e-7)
    _, y, z = answer["tip_position"]
    assert np.arctan2(z, y) == pytest.approx(np.angle(10.0 + 7.0 * np.exp(2j * np.pi / 3)), rel=1e-9)


@pytest.mark.slow
def test_a_loop_in_files(cddf_command, tmp_path):
    code, out, _ = cddf_command("trace", HELIX, "--path", "0 N, 75 N, 40 N, 75 N", "--out", tmp_path)
    assert code == 0
    assert "2: pulled to 75 N, slides in along the whole body; tip tension 54.529 N" in out
    answer = json.loads((tmp_path / "trace.json").read_text())
    np.testing.assert_allclose(1e3 * np.array(answer["tip_position"])[[1, 3]], [TIP] * 2, atol=1e-5)
    loop = pandas.read_csv(tmp_path / "loop.csv")
    np.testing.assert_allclose(1e3 * loop.iloc[-1][["x [m]", "y [m]", "z [m]"]].to_numpy(float), TIP, atol=1e-5)
    assert {"trace.pdf", "fields.csv"} < {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_loads_in_space_in_words(cddf_command):
    pulls = ("-t", "10 N", "-t", "0 N", "-t", "0 N")
    loads = ("--tip-force", "0, 0.1, 0 N", "--tip-moment", "0.01, 0, 0 N m")
    code, out, err = cddf_command("solve", THREE, *pulls, *loads)
    assert (code, err) == (0, "")
    assert "loads: tip force (0, 0.1, 0) N, tip moment (0.01, 0, 0) N m, gravity (0, 0, 0) m/s^2; put on in " in out
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


@pytest.mark.slow
def test_a_fit_to_markers_that_a_camera_sees(cddf_command, tmp_path):
    """Positions of `solve` at a known modulus, turned by SciPy, in a table of markers."""
    body = dataclasses.replace(cddf.read_manipulator(HELIX), youngs_modulus=1.3e6)
    markers = ["row,marker,arc_length [mm],offset_x [mm],offset_y [mm],offset_z [mm],x [mm],y [mm]"]
    for row, pull in enumerate((20.0, 40.0, 60.0), 1):
        found = fields_at(cddf.solve(body, pull), 0.080)
        place = found.position + found.frame @ np.array([0.002, 0.011, 0.004])
        x, y, _ = 1e3 * Rotation.from_rotvec([0.0, 0.0, 0.1]).apply(np.array(place)) + (10.0, 0.0, 0.0)
        markers.append(f"{row},head,80,2,11,4,{x:.9f},{y:.9f}")
    (tmp_path / "bench.csv").write_text("base_tension [N]\n20\n40\n60\n")
    (tmp_path / "markers.csv").write_text("\n".join(markers))
    told = ("--given", "camera_turn_z=0.1 rad", "--free", "youngs_modulus", "--free", "camera_x")
    noise = ("--noise", "x@head=0.1 mm", "--noise", "y@head=0.1 mm")
    code, out, err = cddf_command(
        "fit", HELIX, tmp_path / "bench.csv", tmp_path / "markers.csv", *told, *noise, "--json"
    )
    assert (code, err) == (0, "note: bench.csv: markers of markers.csv: head, in 3 of 3 rows\n")
    answer = json.loads(out)
    assert answer["value"]["youngs_modulus"] == pytest.approx(1.3e6, rel=1e-6)
    assert answer["value"]["camera_x"] == pytest.approx(0.010, rel=1e-6)
    assert answer["options"]["setting"]["given"] == {"camera_turn_z": 0.1}
    assert answer["data"][0]["markers"]["head"]["offset"] == pytest.approx([0.002, 0.011, 0.004])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve", HELIX, *PULL, "--kinematics", "published"), "--kinematics published: Manipulator: the published"),
        (("solve", PAPER, *PULL, "--tip-force", "0, 0, 1 N"), "smooth_sil_940.toml: Manipulator: the published"),
        (("solve", HELIX, *PULL, "--gravity", "0, 0, -9.81 m/s^2"), "loads.gravity: the body has no weight"),
        (("solve", HELIX, *PULL, "--tip-moment", "0, 0.1 N m"), "is one number in the plane and three in space"),
        (
            ("reproduce", HELIX, str(DATA / "load_cells_simulated.csv")),
            "in a plane, this one is in space; remove the angle",
        ),
    ],
)
def test_refused_in_one_line(fails, arguments, message):
    assert message in fails(*arguments)
