"""The explorer's model and rows of bodies in space, against docs/space.md and what is plain geometry."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import paper_body
from places import DATA

import cddf_jax as cddf
from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.space import SpacePlot, body_rows, floor_rows
from cddf_jax.explorer.words import numbers_html
from cddf_jax.figures.geometry import Body, Drawn, stations
from cddf_jax.files.manipulator_file import read_robot_file
from cddf_jax.measurements.table import Measurements

THREE = DATA / "three_tendons_made_up.toml"


def turned(*angles):
    """The paper's body with tendons at angles around its axis, rad."""
    tendons = tuple(cddf.Tendon(0.010, angle=angle) for angle in angles)
    return replace(paper_body("exact"), tendons=tendons)


@pytest.fixture(scope="module")
def three():
    return Exploration(cddf.read_manipulator(THREE))


def straight(manipulator, loads=None):
    """What is drawn of a body without tensions: all lines straight, at 9 mm and 0, 120 and 240 degrees."""
    s = stations(manipulator)
    radius, angles = 1e3 * np.asarray(manipulator.radii(s)[0]), np.radians([0.0, 120.0, 240.0])
    body = Body(np.outer(1e3 * s, [1.0, 0.0, 0.0]), np.tile(np.eye(3), (len(s), 1, 1)), radius, 0.0 * radius)
    across = 9.0 * np.stack([0 * angles, np.cos(angles), np.sin(angles)], axis=-1)
    paths = body.midline + across[:, None]
    loads = cddf.Loads((0.0, 0.0, 0.0)) if loads is None else loads
    return Drawn(body, body, paths, np.ones(paths.shape[:2]), loads, in_space=True)


def of(rows, kind):
    return [row for row in rows if row.kind == kind]


def test_every_number_of_a_body_in_space_has_a_slider(three):
    names = [control.name for control in three.controls]
    assert names[:3] == ["base_tension_1", "base_tension_2", "base_tension_3"]
    for load in ("tip_force", "tip_moment", "gravity"):
        assert [name for name in names if name.startswith(load)] == [f"{load}.{i}" for i in range(3)]
    labels = [control.label for control in three.controls]
    assert labels[7:10] == ["Tip force X", "Tip force Y", "Tip force Z"]
    assert {"friction_coefficient", "youngs_modulus", "outer_radius.base", "outer_radius.tip"} < set(names)


def test_loads_of_three_components_reach_the_solver(three):
    numbers = {**three.start.numbers, "tip_force.2": -0.2, "tip_moment.0": 0.03, "gravity.1": -9.81}
    loads = three.case(three.start._replace(numbers=numbers)).loads
    np.testing.assert_array_equal(loads.tip_force, [0.0, 0.0, -0.2])
    np.testing.assert_array_equal(loads.tip_moment, [0.03, 0.0, 0.0])
    np.testing.assert_array_equal(loads.gravity, [0.0, -9.81, 0.0])
    assert three.case(three.start).loads is None


def test_gravity_of_the_file_is_where_its_sliders_start(three):
    hanging = replace(three, gravity=(0.0, 12.5))
    np.testing.assert_array_equal(hanging.case(hanging.start).loads.gravity, [0.0, 12.5, 0.0])
    (slider,) = (control for control in hanging.controls if control.name == "gravity.1")
    assert (slider.value, slider.low, slider.high) == (12.5, -12.5, 12.5)
    assert hanging.setting.loads.gravity.tolist() == [0.0, 12.5]
    assert replace(three, gravity=(0.0, 0.0)).case(three.start).loads is None


def test_a_saved_body_keeps_the_gravity_that_is_set(three, tmp_path):
    path = tmp_path / "body.toml"
    hanging = replace(three, gravity=(9.81, 0.0, 0.0))
    turned = hanging.start._replace(numbers={**hanging.start.numbers, "gravity.0": 0.0, "gravity.2": -9.81})
    still = hanging.start._replace(numbers={**hanging.start.numbers, "gravity.0": 0.0, "tip_force.1": 0.1})
    for settings, gravity in ((hanging.start, (9.81, 0.0, 0.0)), (turned, (0.0, 0.0, -9.81)), (still, None)):
        path.write_text(hanging.toml(hanging.case(settings)))
        assert read_robot_file(path).gravity == gravity


def test_a_gravity_that_does_not_fit_the_body_is_refused():
    where = "^gravity of the robot file: "
    with pytest.raises(cddf.InputError, match=where + "loads.gravity: the body has no weight, since its density is 0"):
        Exploration(paper_body("exact"), gravity=(0.0, -9.81))
    with pytest.raises(
        cddf.InputError, match=where + "it has three components, but the body is in the plane; give two"
    ):
        Exploration(paper_body("exact", density=1070.0), gravity=(0.0, -9.81, 0.0))


def test_tables_were_measured_under_the_gravity_of_the_file(monkeypatch):
    """The fit is told so."""
    table = Measurements.from_columns("up", base_tension=[10.0, 20.0], tip_angle=[0.1, 0.2], step=[1, 2])
    explored = Exploration(replace(turned(0.0), density=1070.0), (table,))
    hanging = replace(explored, gravity=(9.81, 0.0, 0.0))
    told = []
    monkeypatch.setattr("cddf_jax.identification.fit.fit", lambda *_, setting: told.append(setting))
    hanging.fit()
    assert [setting.loads.gravity.tolist() for setting in told] == [[9.81, 0.0, 0.0]]


@pytest.mark.slow
def test_the_picture_of_two_tendons_is_that_of_the_table():
    """Tendons at 0 and 90 degrees, 40 and 20 N; 10 digits of two derivations and codes apart from this one."""
    table = Measurements.from_columns(
        "tips",
        **{"base_tension": [40.0], "base_tension_2": [20.0], "tip_x": [0.13], "tip_y": [0.036], "tip_z": [0.018]},
        **{"x@140mm": [0.13], "y@140mm": [0.036], "z@140mm": [0.018], "x@70mm": [0.069]},
    )
    explored = Exploration(turned(0.0, np.pi / 2), (table,))
    numbers = {**explored.start.numbers, "base_tension_1": 40.0, "base_tension_2": 20.0}
    picture = explored.picture(explored.case(explored.start._replace(numbers=numbers)))
    tip = np.array([130.40912322, 36.19224489, 18.09612245])
    assert picture.good
    np.testing.assert_allclose(picture.equilibrium.tip_tension, [28.6776219, 14.33881095], atol=6e-8)
    np.testing.assert_allclose(1e3 * picture.equilibrium.tip_position, tip, atol=6e-9)
    assert '<b data-name="tip_z">18.096</b> mm' in numbers_html(picture)
    # both bend in one plane, without twist: kappa = T d / (E J) of 32.1 N at the tip, the length of both tensions
    bent = np.hypot(28.6776219, 14.33881095) * 0.010 / (1.4e6 * np.pi / 4 * (0.013**4 - 0.007**4))
    assert picture.peak_curvature == pytest.approx(bent, rel=1e-8)
    plot = SpacePlot(explored.manipulator)
    plot.show(picture)
    sent = dict(zip(plot.space.data["kind"], plot.space.data["points"], strict=True))  # the last of each kind
    np.testing.assert_allclose(sent["axis"][-3:], tip, atol=1e-6)
    # the anchor of tendon 2 lies 10 mm from the axis, across the body
    arm = sent["end"] - tip
    assert np.linalg.norm(arm) == pytest.approx(10.0, rel=1e-9)
    assert arm @ sent["ahead"] == pytest.approx(0.0, abs=1e-9)
    ((_, model),) = explored.in_rows(explored.manipulator)
    np.testing.assert_allclose([1e3 * model[f"tip_{axis}"][0] for axis in "xyz"], tip, atol=1e-5)
    plot.show_points("data", [(table, table.columns)])
    plot.show_points("rows", [(table, model)])
    # the tip and the marker there, but not the marker of which only x is told
    assert [list(plot.space.data["kind"]).count(kind) for kind in ("data", "rows")] == [2, 2]
    sent = dict(zip(plot.space.data["kind"], plot.space.data["points"], strict=True))
    np.testing.assert_allclose(sent["rows"], tip, atol=1e-5)
    np.testing.assert_allclose(sent["data"], [130.0, 36.0, 18.0])


@pytest.mark.slow
def test_a_force_out_of_the_plane_is_that_of_the_table():
    """One tendon at 40 N and 0.5 N along z at the tip; from two derivations and codes apart from this one."""
    explored = Exploration(turned(0.0))
    numbers = {**explored.start.numbers, "base_tension_1": 40.0, "tip_force.2": 0.5}
    case = explored.case(explored.start._replace(numbers=numbers))
    picture = explored.picture(case)
    assert picture.equilibrium.tip_tension[0] == pytest.approx(29.537997, abs=6e-7)
    expected = [132.04836657, 36.77433798, 4.08358246]
    np.testing.assert_allclose(1e3 * picture.equilibrium.tip_position, expected, atol=1e-6)


def test_the_axis_with_its_past_is_sent_and_taken_away(three):
    plot, axis = SpacePlot(three.manipulator), np.linspace([0.0, 0.0, 0.0], [0.2, 0.0, 0.0], 5)
    plot.now = body_rows(straight(three.manipulator))
    loop: Any = SimpleNamespace(position=axis)
    plot.show_loop(loop)
    sent = dict(zip(plot.space.data["kind"], plot.space.data["points"], strict=True))
    np.testing.assert_allclose(sent["past"][-3:], [200.0, 0.0, 0.0])
    plot.show_loop(None)
    assert "past" not in plot.space.data["kind"]


def test_a_step_of_the_body_has_a_ring_on_both_sides(three):
    """From 15 to 12 mm at 70 mm, which is no place of the grid of rings."""
    radius = cddf.Piecewise([0.070], [0.015, 0.012])
    rings = of(body_rows(straight(replace(three.manipulator, outer_radius=radius))), "ring")
    near = [ring.points[0, 1] for ring in rings if abs(ring.points[0, 0] - 70.0) < 1e-3]
    assert {15.0, 12.0} == {round(y, 9) for y in near}


def test_the_floor_has_squares_of_one_size():
    rows = floor_rows(200.0, 50.0)
    (floor,) = of(rows, "floor")
    assert floor.points[2] == -100.0  # two squares down, at least 0.35 of the length
    lines = np.array([row.points[:, :2] for row in of(rows, "grid")])
    across = [line[0, 0] for line in lines if np.ptp(line[:, 0]) == 0]
    along = [line[0, 1] for line in lines if np.ptp(line[:, 1]) == 0]
    assert (across, along) == ([0, 50, 100, 150, 200], [-100, -50, 0, 50, 100])
    assert [row.text for row in of(rows, "name")] == ["X", "Y"]
