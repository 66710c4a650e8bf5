"""What else makes loops by displacement, beside friction on the body; and loops that no friction makes."""

from typing import Any

import numpy as np
import pytest

import cddf_jax as cddf
from cddf_jax.measurements.loop_sense import loop_widths, runs_backwards

D, COMPLIANCE, STIFFNESS, NOISE = 0.009, 2e-5, 0.02, 2e-4  # m, m/N, N m^2, rad
PULLED = 1e-3 * np.array([0.0, 1.5, 3, 4.5, 6, 7.5, 9, 10, 8.5, 7, 5.5, 4, 2.5, 1.0, 3, 5, 7, 9, 11, 9, 7, 5, 3])  # m
TIME = np.cumsum(np.where(np.arange(PULLED.size) < 14, 1.0, 0.5))  # s; the second half is faster


def robot(friction, moment=None):
    tendon = cddf.Tendon(D, outside_compliance=COMPLIANCE)
    return cddf.Manipulator(
        length=0.14,
        tendons=[tendon],
        bending_stiffness=STIFFNESS,
        friction_coefficient=friction,
        friction_moment=moment,
    )


def table(angle, pulled=PULLED):
    noise = NOISE * np.random.default_rng(3).normal(size=len(pulled))
    columns = {"displacement": pulled, "time": TIME[: len(pulled)], "tip_angle": np.asarray(angle) + noise}
    return cddf.Measurements.from_columns("simulated", **columns)


def fitted(data):
    free, noise = ["friction_coefficient", "outside_compliance"], {"displacement": 0.0, "tip_angle": NOISE}
    return cddf.fit(robot(0.2), data, free, noise=noise)


@pytest.mark.slow
def test_a_friction_moment_taken_for_friction_on_the_body_is_noticed():
    """The data are those of a body without friction of tendons, and with a moment of 2 N mm."""
    found = fitted(table(cddf.trace(robot(0.0, 2e-3), cddf.Displacement(PULLED)).tip_angle))
    named = {rival.name: rival for rival in found.rivals}
    assert named["friction_moment"].gain > 50
    assert any("friction_moment" in warning and "compare" in warning for warning in found.warnings)


@pytest.mark.slow
def test_friction_on_the_body_is_left_alone():
    """No rival explains more than noise; friction stays within three standard errors of the truth."""
    found = fitted(table(cddf.trace(robot(0.3), cddf.Displacement(PULLED)).tip_angle))
    assert found.status["friction_coefficient"] == "identified"
    assert abs(found.value["friction_coefficient"] - 0.3) < 3 * found.standard_error["friction_coefficient"]
    constant = {"lag", "backlash", "friction_moment", "outside_drag"}
    assert {rival.name for rival in found.rivals} == {*constant, "slack_offset", "outside_friction"}
    assert all(rival.gain < 6 for rival in found.rivals)
    assert all(abs(rival.friction - 0.3) < 4 * rival.standard_error for rival in found.rivals)


@pytest.mark.slow
def test_in_one_loop_backlash_and_constant_friction_look_alike():
    """The data have a backlash of 0.04 mm beside friction, and one way back.

    A force F outside the body and a moment F d of the body make the same loop: either is missing in E J kappa = d T.
    """
    there, follows = PULLED[:11], [0.0]
    for motor in there[1:]:
        follows.append(min(max(follows[-1], motor), motor + 4e-5))
    found = fitted(table(cddf.trace(robot(0.2), cddf.Displacement(follows)).tip_angle, there))
    named = {rival.name: rival for rival in found.rivals}
    moment, force = named["friction_moment"], named["outside_drag"]
    assert moment.value == pytest.approx(force.value * D, rel=1e-3)
    assert moment.gain == pytest.approx(force.gain, abs=0.1)
    assert any("do not tell friction on the body from backlash" in said for said in found.warnings)


def test_widths_of_a_loop_are_those_of_its_ways():
    """Along both ways the angle is a straight line; the way back lies 0.01 rad above the way there."""
    pulled = np.array([0.0, 1, 2, 3, 4, 3.5, 2.5, 1.5, 0.5, -1.0])
    angle = 0.1 * pulled + np.where(np.arange(10) > 4, 0.01, 0.0)
    data = cddf.Measurements.from_columns("made up", displacement=pulled, step=np.arange(10), tip_angle=angle)
    np.testing.assert_allclose(loop_widths(data), [0.01 - 1e-3 * 0.49] * 4)  # less a thousandth of the motion
    assert not runs_backwards(data)


@pytest.mark.parametrize("power", [0.5, 2.0, 3.0])
def test_a_curve_without_a_loop_has_no_width(power):
    """The way back is the way there, read between its readings: straight lines between them miss a part."""
    pulled = np.concatenate([np.arange(10.0), np.arange(8.5, 0.0, -1.0)])
    angle = (pulled / 9) ** power
    data = cddf.Measurements.from_columns("made up", displacement=pulled, step=np.arange(pulled.size), tip_angle=angle)
    assert not runs_backwards(data)
    assert np.mean(loop_widths(data) == 0) > 0.8


@pytest.mark.slow
def test_tables_that_pull_one_tendon_of_three():
    """Each table by its own tendon; the others hang slack. All numbers are those that the data were made with."""
    tendons = [cddf.Tendon(D, angle=2 * np.pi * i / 3, outside_compliance=COMPLIANCE) for i in range(3)]
    stiffness: dict[str, Any] = {"bending_stiffness": STIFFNESS, "torsional_stiffness": STIFFNESS}
    body = cddf.Manipulator(length=0.14, tendons=tendons, friction_coefficient=0.3, **stiffness)
    pulled, data = PULLED[:14], []
    for number in (2, 3):
        path = [cddf.Displacement(pulled) if tendon == number else np.zeros(14) for tendon in (1, 2, 3)]
        position = np.asarray(cddf.trace(body, path, estimate_error=False).tip_position)
        columns = dict(zip(("tip_x", "tip_y", "tip_z"), position.T, strict=True)) | {"step": np.arange(14)}
        name = f"simulated {number}"
        data.append(cddf.Measurements.from_columns(name, **{f"displacement_{number}": pulled + 5e-4}, **columns))
    free = ["friction_coefficient", "slack_offset_2", "slack_offset_3"]
    noise = {"displacement": 0.0} | dict.fromkeys(("tip_x", "tip_y", "tip_z"), 1e-4)
    found = cddf.fit(body, data, free, noise=noise)
    assert found.success
    for name, truth in zip(free, (0.3, 5e-4, 5e-4), strict=True):
        assert abs(found.value[name] - truth) < 0.3 * found.standard_error[name] + 0.02 * abs(truth)
