"""The frame of measured positions: its pose as one word, the start of the search, and readings out of reach."""

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import paper_body
from kinds import bench_of
from refusals import refused
from scipy.spatial.transform import Rotation

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.identification.parameters import free_parameters
from cddf_jax.measurements.markers import registered

MU, E = 0.35, 1.2e6
PULLS = np.linspace(10.0, 60.0, 6)
PLANAR = (0.5, -0.3, 2.5)  # camera_x, camera_y, m, and camera_turn_z: far from the base of a body of 140 mm
FREE = ["friction_coefficient", "youngs_modulus", "camera"]


@pytest.mark.parametrize("axes", [2, 3])
def test_a_pose_is_found(axes):
    """Points turned by SciPy and shifted; of points in a plane the turn is no reflection."""
    points = np.random.default_rng(1).normal(size=(7, 3)) * [1.0, 1.0, 0.0 if axes == 2 else 1e-9]
    turn = np.array([0.0, 0.0, -2.0]) if axes == 2 else np.array([0.4, -1.0, -0.9])
    read = Rotation.from_rotvec(turn).apply(points) + np.array([0.3, -0.2, 0.0])
    rest, pose = registered(points[:, :axes], read[:, :axes])
    assert rest == pytest.approx(0.0, abs=1e-20)
    np.testing.assert_allclose(pose, [*(0.3, -0.2, 0.0)[:axes], *(turn[2:] if axes == 2 else turn)], atol=1e-8)


def far_away(**more):
    """Tips of `solve` and their tensions, as a camera sees them."""
    body = paper_body("exact", friction_coefficient=MU, youngs_modulus=E)
    found = [cddf.solve(body, pull) for pull in PULLS]
    x, y = np.array([one.tip_position for one in found]).T
    cos, sin = np.cos(PLANAR[2]), np.sin(PLANAR[2])
    seen = {"tip_x": cos * x - sin * y + PLANAR[0], "tip_y": sin * x + cos * y + PLANAR[1]}
    tension = np.array([one.tip_tension[0] for one in found])
    return cddf.Measurements.from_columns("simulated", base_tension=PULLS, tip_tension=tension, **(seen | more))


@pytest.mark.slow
def test_one_word_frees_the_whole_pose_and_its_start_is_found():
    """The truth is that of `far_away`; the body starts at another modulus and friction."""
    body = paper_body("exact", friction_coefficient=0.2, youngs_modulus=4e5)
    fit = cddf.fit(body, far_away(), FREE)
    expected = dict(zip(("camera_x", "camera_y", "camera_turn_z"), PLANAR, strict=True))
    assert fit.status == dict.fromkeys([*FREE[:2], *expected], "identified")
    for name, value in {**expected, "friction_coefficient": MU, "youngs_modulus": E}.items():
        assert fit.value[name] == pytest.approx(value, rel=1e-6)


def test_six_numbers_in_space_and_three_in_the_plane():
    assert free_parameters(paper_body("exact"), ["camera"]) == ("camera_x", "camera_y", "camera_turn_z")
    body = dataclasses.replace(paper_body("exact"), tendons=(cddf.Tendon(0.01, angle=0.0),))
    assert len(free_parameters(body, ["camera", "camera_x"])) == 6


def test_readings_out_of_reach_are_refused_at_once():
    """|(0.5, -0.3)| = 0.583 m less or more a body of 0.14 m; told before anything is compiled."""
    with pytest.raises(InputError) as error:
        cddf.fit(paper_body("exact"), far_away())
    assert str(error.value).startswith("fit: simulated: row 1, tip_x, tip_y: the tip is ")
    assert "(6 of 6 rows); check the unit, leave the row out" in str(error.value)
    assert "or fit the pose of its frame too: add camera to the parameters that are fitted" in str(error.value)


class NotRefusedError(Exception):
    """The search would begin."""


def reaching(monkeypatch, x, **options) -> str:
    """The refusal of a table whose third row reads tip_x = `x`, or "" where it is taken; no fit is made."""

    def search(*_, **__):
        raise NotRefusedError

    monkeypatch.setattr("cddf_jax.identification.fit.least_squares_fit", search)
    table = cddf.Measurements.from_columns("bench", base_tension=[1.0, 2.0, 3.0], tip_x=[0.1, 0.1, x])
    with pytest.raises((NotRefusedError, InputError)) as raised:
        cddf.fit(paper_body("exact"), table, **options)
    return str(raised.value)


@pytest.mark.parametrize(
    ("x", "options", "refused"),
    [
        (0.15, {}, False),  # 7 % more than 0.14 m: a length that was measured badly
        (0.16, {}, True),
        (0.16, {"setting": cddf.BenchSetting(given={"camera_x": 0.05})}, False),
        (-0.12, {"setting": cddf.BenchSetting(given={"camera_x": 0.05})}, True),
        (5.0, {"free": ["camera_x"]}, False),  # may be anywhere
        (5.0, {"free": ["length"]}, False),
    ],
    ids=str,
)
def test_what_length_and_camera_can_explain(monkeypatch, x, options, refused):
    told = reaching(monkeypatch, x, **options)
    assert bool(told) == refused
    if refused:
        assert "bench: row 3, tip_x" in told
        assert "leave the row out (leave_out, --leave-out)" in told


@pytest.mark.slow
def test_poses_of_three_tendons_in_the_frame_of_a_tracker():
    """Simulated by an independent rod code with the history of friction; its truth, with the pose of the tracker."""
    truth = {"friction_coefficient": 0.186, "youngs_modulus": 1.06e6}
    pose = (-0.2807693513475604, -0.22909189252061398, -0.2374283143243745)
    turn = (0.39462696471760217, -0.9885746201441636, -0.9218689334883712)
    truth |= {f"camera_{axis}": value for axis, value in zip("xyz", pose, strict=True)}
    truth |= {f"camera_turn_{axis}": value for axis, value in zip("xyz", turn, strict=True)}
    tendons = tuple(cddf.Tendon(8.6e-3, angle=cddf.Constant(np.radians(6.302536 + 120 * i))) for i in range(3))
    numbers: dict[str, Any] = {"youngs_modulus": 1e6, "friction_coefficient": 0.2, "poissons_ratio": 0.45}
    body = cddf.Manipulator(0.201, 11.4e-3, 3e-3, tendons, **numbers)
    table = cddf.read_measurements(Path(__file__).with_name("three_tendon_poses_simulated.csv"))
    fit = cddf.fit(body, table, FREE, history=False, leave_out="27, 33")  # parts of tendons stick there
    assert fit.success
    for name, value in truth.items():
        assert fit.status[name] == "identified"
        assert abs(fit.value[name] - value) < 3 * fit.standard_error[name]
    mirrored = replace(table, columns={**table.columns, "tip_z": -table["tip_z"]})  # no rotation does that
    fit = cddf.fit(body, mirrored, FREE, history=False, leave_out="27, 33", starts=1)
    assert not fit.success
    assert "left-handed, change the sign of one axis" in fit.result
    assert "identified" not in fit.status.values()


@pytest.mark.slow
def test_the_direction_of_the_tip_turns_with_the_camera_and_does_not_move():
    """Turned by SciPy; against the frame of the tip that `solve` gives."""
    body = dataclasses.replace(paper_body("exact"), tendons=(cddf.Tendon(0.01, angle=1.0),))
    axes = {f"tip_axis_{axis}": [0.0] for axis in "xyz"}
    table = cddf.Measurements.from_columns("zeros", base_tension=[30.0], **axes)
    turn = {"camera_turn_x": 0.4, "camera_turn_y": -1.0, "camera_turn_z": -0.9, "camera_x": 0.3}
    shown = bench_of(table, body).evaluate(body, turn, 16).readings
    found = cddf.solve(body, 30.0)
    expected = Rotation.from_rotvec([0.4, -1.0, -0.9]).apply(np.array(found.tip_frame)[:, 0])
    np.testing.assert_allclose([shown[axis][0] for axis in axes], expected, atol=1e-10)


def test_a_direction_longer_than_1_is_refused():
    said = refused(cddf.Measurements.from_columns, "bench", base_tension=[1.0, 2.0], tip_axis_x=[0.9, 90.0])
    assert said == (
        "bench: row 2, column tip_axis_x: must be from -1 to 1, got 90; give the parts of a direction of length 1"
    )
