"""The explorer without a browser: its model against closed forms, its words, and the command that serves it."""

import gc
import socket
import sys
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain, straight
from kinds import of_kind
from places import DATA

import cddf_jax as cddf
from cddf_jax.explorer.controls import from_si, in_si, rounded
from cddf_jax.explorer.model import NUM_PULLS, Exploration
from cddf_jax.explorer.plots import TensionPlots
from cddf_jax.explorer.words import numbers_html
from cddf_jax.quantities import QUANTITIES
from cddf_jax.robot.profiles import Linear, Piecewise, Spline
from cddf_jax.robot.reshape import tapered

CELLS = DATA / "load_cells_simulated.csv"
OTHER = {"outer_radius.base": 18.0, "outer_radius.tip": 15.0}  # mm


@pytest.fixture(scope="module")
def explored():
    """The paper's body in the exact kinematics."""
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def settings(explored):
    """Another taper, 60 N."""
    start = explored.start
    return start._replace(numbers={**start.numbers, "base_tension_1": 60.0, **OTHER})


@pytest.fixture(scope="module")
def picture(explored, settings):
    return explored.picture(explored.case(settings))


@pytest.fixture(scope="module")
def other_body():
    """The same body in plain numbers, for the closed form of docs/theory.md (16)."""
    return paper_plain("exact", outer_radius=straight(0.018, 0.015, PAPER["length"]))


def test_the_picture_is_the_closed_form(picture, other_body):
    assert picture.good
    assert picture.message == ""
    tip = other_body.closed_form(60.0, PAPER["length"])
    assert picture.equilibrium.tip_tension[0] == pytest.approx(tip, rel=1e-10)
    # docs/identifiability.md: in the exact kinematics with a constant offset the tip angle is ln(T_base / T_tip) / mu
    assert picture.equilibrium.tip_angle == pytest.approx(np.log(60.0 / tip) / 0.42, rel=1e-10)
    # kappa = T d / (E J) where T is known; the thin end bends most
    curvature = tip * 0.010 / (1.4e6 * other_body.second_moment(PAPER["length"]))
    assert picture.peak_curvature == pytest.approx(curvature, rel=1e-9)
    assert picture.peak_strain == pytest.approx(0.015 * curvature, rel=1e-9)


def test_the_curve_is_the_closed_form(explored, picture, other_body):
    curve = explored.curve(picture.case)
    assert len(curve.base_tension) == NUM_PULLS
    expected = [other_body.closed_form(pull, PAPER["length"]) for pull in curve.base_tension]
    np.testing.assert_allclose(curve.tip_tension, expected, rtol=1e-10)
    angles = np.log(curve.base_tension[1:] / np.array(expected[1:])) / 0.42
    np.testing.assert_allclose(curve.tip_angle[1:], angles, rtol=1e-9)


def test_what_is_shown_and_set_is_the_same_number():
    """12.7 mm and 1.395 MPa are the float64 nearest to 0.0127 m and 1395000 Pa."""
    radius, modulus = QUANTITIES["outer_radius"], QUANTITIES["youngs_modulus"]
    assert in_si(12.7, radius) == 0.0127
    assert in_si(1.395, modulus) == 1395000.0
    assert from_si(0.0127, radius) == 12.7


@pytest.mark.parametrize(
    ("value", "low", "high", "told"),
    [
        (1.398237, 1.385, 1.412, 1.398),  # known to 0.0135
        (0.420345, 0.40, 0.44, 0.42),
        (0.4203449, 0.4201, 0.4205, 0.42034),
        (1234.5, 1000.0, 1400.0, 1230.0),
        (1.398237, -np.inf, np.inf, 1.398237),  # nothing is known: nothing is cut
        (1.398237, 1.398237, 1.398237, 1.398237),
    ],
)
def test_numbers_are_rounded_to_what_the_interval_tells(value, low, high, told):
    """Two digits of the half-width of the interval."""
    assert rounded(value, low, high) == told


def test_rows_that_no_curve_holds_are_solved_as_they_were_measured():
    """In: T / (1 + m T G), out: T / (1 - m T G), docs/theory.md (16), the body as it is set."""
    base, way = np.array([20.0, 40.0, 40.0, 20.0]), np.array([1.0, 1.0, -1.0, -1.0])
    read = {"tip_tension": base, "tip_angle": 0.01 * base}
    table = cddf.Measurements.from_columns("bench", base_tension=base, direction=way, **read)
    pulled_in = cddf.Measurements.from_columns("loading", base_tension=base, tip_tension=base)
    ((rows, model),) = Exploration(paper_body("exact"), (pulled_in, table)).in_rows(
        paper_body("exact", youngs_modulus=2e6)
    )
    assert rows is table
    loss = 0.42 / 2e6 * base * paper_plain("exact").compliance(PAPER["length"])
    np.testing.assert_allclose(model["tip_tension"], base / (1 + way * loss), rtol=1e-9)
    np.testing.assert_allclose(model["tip_angle"], np.log1p(way * loss) / (way * 0.42), rtol=1e-9)


def test_data_of_two_tendons_lie_over_their_own_tensions():
    columns = {"base_tension": [20.0, 40.0], "base_tension_2": [5.0, 10.0]}
    read = {"tip_tension": [16.0, 30.0], "tip_tension_2": [6.0, 12.0], "tip_angle": [0.1, 0.2]}
    table = cddf.Measurements.from_columns("pair", **columns, **read)
    plots = TensionPlots(2)
    plots.show_points("data", [(table, table.columns)])
    plots.show_points("rows", [(table, {name: np.array(values) + 1.0 for name, values in read.items()})])
    tension, angle = plots.points["tension"], plots.points["angle"]
    for kind, more in (("data", 0.0), ("rows", 1.0)):
        np.testing.assert_array_equal(tension[kind].data["base"], [20.0, 40.0, 5.0, 10.0])
        np.testing.assert_array_equal(tension[kind].data["value"], np.array([16.0, 30.0, 6.0, 12.0]) + more)
        assert len(set(tension[kind].data["color"])) == 2
        np.testing.assert_allclose(angle[kind].data["value"], np.degrees([0.1 + more, 0.2 + more]))
    plots.follow(1)  # the angle is drawn over the tension of the tendon that moved last
    np.testing.assert_array_equal(angle["data"].data["base"], [5.0, 10.0])
    assert plots.figures["angle"].xaxis.axis_label == "Base tension of tendon 2 (N)"
    plots.show_points("data", [])
    assert [fig.select_one({"name": "data"}).visible for fig in plots.figures.values()] == [False, False]


@pytest.mark.slow
def test_rows_of_displacements_are_drawn_over_them():
    """A tendon at a constant offset that does not stretch turns the tip by its displacement over the offset."""
    pulled = 1e-3 * np.array([4.0, 8.0, 5.0, -1.0])
    table = cddf.Measurements.from_columns("driven", displacement=pulled, tip_angle=100 * pulled, step=range(4))
    body = paper_body("exact")
    explored = Exploration(body, (table,))
    assert explored.notes == []
    ((rows, model),) = explored.in_rows(body)
    assert rows is table
    np.testing.assert_allclose(model["tip_angle"], np.maximum(pulled, 0.0) / 0.010, rtol=1e-9)
    plots = TensionPlots(1, explored.over)
    plots.show_points("rows", [(table, model)])
    plots.show_now(explored.picture(explored.case(explored.start)))
    angle = plots.points["angle"]
    np.testing.assert_allclose(angle["rows"].data["base"], 1e3 * pulled)
    (now,) = angle["now"].data["base"]
    assert np.radians(angle["now"].data["value"]) == pytest.approx(now / 10.0, rel=1e-9)
    assert plots.figures["angle"].xaxis.axis_label == "Displacement (mm)"
    by_tension = cddf.Measurements.from_columns("cell", base_tension=[5.0], tip_angle=[0.1])
    both = Exploration(body, (table, by_tension))
    assert both.over == "base_tension"
    assert both.notes == [
        "driven: driven by displacement, and the tip is drawn over base tensions; explore it alone to see it"
    ]


PROFILES = {
    "longer": Linear(0.020, 0.012, 0.16),
    "pieces": Piecewise([0.05], [0.018, Linear(0.020, 0.013, 0.14)]),
    "spline": Spline([0.0, 0.04, 0.09, 0.14], [0.020, 0.018, 0.013, 0.012]),
}


values_at = eqx.filter_jit(lambda profile, s: profile(s))


@pytest.mark.parametrize("name", PROFILES)
def test_a_taper_adds_a_straight_line(name):
    profile, s = PROFILES[name], np.linspace(0.0, 0.14, 29)
    before, after = (np.asarray(values_at(one, s)) for one in (profile, tapered(profile, 0.022, 0.011, 0.14)))
    line = np.interp(s, [0.0, 0.14], [0.022 - before[0], 0.011 - before[-1]])
    np.testing.assert_allclose(after, before + line, atol=1e-16)


def test_loads_and_directions_reach_the_solver(explored):
    numbers = {**explored.start.numbers, "tip_force.1": -2.0, "tip_moment": 0.05}
    case = explored.case(explored.start._replace(numbers=numbers, direction=(-1,)))
    np.testing.assert_array_equal(case.loads.tip_force, [0.0, -2.0])
    assert case.loads.tip_moment == 0.05
    assert case.direction.tolist() == [-1.0]
    assert explored.case(explored.start).loads is None


def test_directions_are_found_unless_they_are_stated():
    """docs/theory.md: the antagonist at 20 N slides out, 45.9 degrees and 28.0 N; both in would give 54.0."""
    explored = Exploration(paper_body("exact", num_tendons=2))
    numbers = {**explored.start.numbers, "base_tension_1": 75.0, "base_tension_2": 20.0}
    found = explored.picture(explored.case(explored.start._replace(numbers=numbers)))
    assert found.equilibrium.direction.tolist() == [1.0, -1.0]
    assert np.degrees(found.equilibrium.tip_angle) == pytest.approx(45.9, abs=0.05)
    assert found.equilibrium.tip_tension[1] == pytest.approx(28.0, abs=0.05)
    assert '<b data-name="direction_2">out</b>' in numbers_html(found)
    stated = explored.case(explored.start._replace(direction=(1, None)))
    assert (float(stated.direction[0]), stated.direction[1]) == (1.0, None)


def test_ranges_hold_the_numbers_of_the_file():
    for control in Exploration(paper_body(num_tendons=2, density=1070.0)).controls:
        assert control.low <= control.value <= control.high
        assert 0 < control.step < control.high - control.low


def test_a_wall_without_its_tendon_is_refused(explored):
    numbers = {**explored.start.numbers, "outer_radius.tip": 9.0}
    with pytest.raises(cddf.InputError, match="tendon 1: offset must lie inside the wall"):
        explored.case(explored.start._replace(numbers=numbers))


def test_a_table_of_another_body_is_refused():
    with pytest.raises(cddf.InputError, match="no column 'base_tension_2'"):
        Exploration(paper_body(num_tendons=2), (cddf.read_measurements(CELLS),))


@pytest.mark.filterwarnings("ignore:.* will be removed in version 2.0:PendingDeprecationWarning")
def test_only_what_the_data_identify_is_taken_over(monkeypatch):
    """Tensions of one tendon hold mu / E alone; the numbers are made up."""
    pn = pytest.importorskip("panel")
    from bokeh.document import Document
    from panel.io.state import set_curdoc

    from cddf_jax.explorer.view import ExplorerView, Threads

    names, value = ("friction_coefficient", "youngs_modulus"), {"friction_coefficient": 0.5012, "youngs_modulus": 2e6}
    intervals = {"friction_coefficient": (0.4812, 0.5212), "youngs_modulus": (0.0, np.inf)}
    monkeypatch.setattr(type(pn.state), "onload", lambda *_: None)
    with set_curdoc(Document()), Threads() as idle:
        view = ExplorerView(Exploration(paper_body("exact")), idle)
    monkeypatch.setattr(view, "change", lambda: None)
    for known, offered in (("identified", True), ("not identified", False)):
        status = {"friction_coefficient": known, "youngs_modulus": "not identified"}
        told = {"names": names, "value": value, "confidence_interval": intervals, "status": status}
        fit: Any = SimpleNamespace(success=True, **told)
        view._show_fit(fit, "")
        assert view.take_over.visible == offered
        if offered:
            view._take_over()
    assert view.sliders["friction_coefficient"].value == 0.501  # two digits of the half-width of 0.02
    assert view.sliders["youngs_modulus"].value == 1.4


def test_the_file_holds_the_body_that_is_shown(explored, picture, tmp_path):
    path = tmp_path / "body.toml"
    path.write_text(explored.toml(picture.case))
    radius = of_kind(cddf.Linear, cddf.read_manipulator(path).outer_radius)
    assert (radius.base, radius.tip) == (0.018, 0.015)


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.filterwarnings(
    "ignore:There is no current event loop:DeprecationWarning"
)  # Tornado asks for one, Python 3.12 on
@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # Tornado leaves one open that it cannot bind
def test_a_port_in_use_is_said(cddf_command):
    gc.freeze()  # what is older is no concern of this test
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, out, error = cddf_command("explore", "--no-browser", "--port", port)
        gc.collect()
    gc.unfreeze()
    assert (code, out) == (2, "")
    assert error.startswith(f"error: --port {port}: Address already in use; give another")
    assert error.count("\n") == 1


def test_without_panel_the_remedy_is_said(cddf_command, monkeypatch):
    monkeypatch.setitem(sys.modules, "panel", None)
    code, _, error = cddf_command("explore", "--no-browser")
    assert code == 2
    assert error == "error: this needs panel; install it with: pip install 'cddf-jax[explore]'\n"
