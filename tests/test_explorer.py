"""The explorer: its model against closed forms, and its page in a headless browser against `solve` and `fit`."""

import gc
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain, straight

import cddf_jax as cddf
from cddf_jax.exploration import NUM_PULLS, Exploration, Rows, in_si, rounded, shown
from cddf_jax.explorer_plots import TensionPlots
from cddf_jax.explorer_taper import tapered
from cddf_jax.explorer_words import numbers_html
from cddf_jax.interchange import fields_csv
from cddf_jax.profiles import Constant, Linear, Piecewise, Spline

DATA = Path(__file__).parent.parent / "data"
ROBOT, ANGLES, CELLS = DATA / "smooth_sil_940.toml", DATA / "tip_angle_simulated.csv", DATA / "load_cells_simulated.csv"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE = 120_000  # ms, for compilers on a busy machine

# --- the model behind the page, without one -------------------------------------------------------

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
    """The same body in plain numbers, for the closed form of design.md section 3."""
    return paper_plain("exact", outer_radius=straight(0.018, 0.015, PAPER["length"]))


def test_the_picture_is_the_closed_form(picture, other_body):
    assert picture.good
    assert picture.message == ""
    tip = other_body.closed_form(60.0, PAPER["length"])
    assert picture.equilibrium.tip_tension[0] == pytest.approx(tip, rel=1e-10)
    # design.md section 4: in the exact kinematics with a constant offset the tip angle is ln(T_base / T_tip) / mu
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


def test_what_another_taper_does(explored, settings, other_body):
    """With G of design.md section 3 the angle theta needs T_base = (exp(mu theta) - 1) E / (mu G)."""
    own, new = explored.tapers(settings, 0.8)
    for taper, body in ((own, paper_plain("exact")), (new, other_body)):
        compliance = body.compliance(PAPER["length"])
        assert taper.base_tension == pytest.approx(np.expm1(0.42 * 0.8) * 1.4e6 / (0.42 * compliance), rel=1e-8)
        loss = 1 - body.closed_form(60.0, PAPER["length"]) / 60.0
        assert taper.tension_loss == pytest.approx(loss, rel=1e-9)
        assert taper.tip_angle == pytest.approx(-np.log1p(-loss) / 0.42, rel=1e-9)
    assert new.peak_strain < own.peak_strain  # the thinner tip of the paper's body bends more


def test_what_is_shown_and_set_is_the_same_number():
    """12.7 mm and 1.395 MPa are the float64 nearest to 0.0127 m and 1395000 Pa."""
    assert in_si(12.7, 3) == 0.0127
    assert in_si(1.395, -6) == 1395000.0
    assert shown(0.0127, 3) == 12.7


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
    """In: T / (1 + m T G), out: T / (1 - m T G), design.md section 3, the body as it is set."""
    base, way = np.array([20.0, 40.0, 40.0, 20.0]), np.array([1.0, 1.0, -1.0, -1.0])
    read = {"tip_tension": base, "tip_angle": 0.01 * base}
    table = cddf.Measurements.from_columns("bench", base_tension=base, direction=way, **read)
    pulled_in = cddf.Measurements.from_columns("loading", base_tension=base, tip_tension=base)
    (rows,) = Exploration(paper_body("exact"), (pulled_in, table)).in_rows(paper_body("exact", youngs_modulus=2e6))
    assert rows.table is table
    loss = 0.42 / 2e6 * base * paper_plain("exact").compliance(PAPER["length"])
    np.testing.assert_allclose(rows.model["tip_tension"], base / (1 + way * loss), rtol=1e-9)
    np.testing.assert_allclose(rows.model["tip_angle"], np.log1p(way * loss) / (way * 0.42), rtol=1e-9)


def test_data_of_two_tendons_lie_over_their_own_tensions():
    columns = {"base_tension": [20.0, 40.0], "base_tension_2": [5.0, 10.0]}
    read = {"tip_tension": [16.0, 30.0], "tip_tension_2": [6.0, 12.0], "tip_angle": [0.1, 0.2]}
    table = cddf.Measurements.from_columns("pair", **columns, **read)
    plots = TensionPlots(2)
    plots.show_data([table])
    plots.show_rows([Rows(table, {name: np.array(values) + 1.0 for name, values in read.items()})])
    tension, angle = plots.points["tension"], plots.points["angle"]
    for kind, more in (("data", 0.0), ("rows", 1.0)):
        np.testing.assert_array_equal(tension[kind].data["base"], [20.0, 40.0, 5.0, 10.0])
        np.testing.assert_array_equal(tension[kind].data["value"], np.array([16.0, 30.0, 6.0, 12.0]) + more)
        assert len(set(tension[kind].data["color"])) == 2
        np.testing.assert_allclose(angle[kind].data["value"], np.degrees([0.1 + more, 0.2 + more]))
    plots.show_data([])
    assert [fig.select_one({"name": "data"}).visible for fig in plots.figures.values()] == [False, False]


PROFILES = {
    "constant": Constant(0.016),
    "linear": Linear(0.020, 0.013, 0.14),
    "longer": Linear(0.020, 0.012, 0.16),
    "pieces": Piecewise([0.05], [0.018, Linear(0.020, 0.013, 0.14)]),
    "spline": Spline([0.0, 0.04, 0.09, 0.14], [0.020, 0.018, 0.013, 0.012]),
    "lines": Piecewise.linear([0.0, 0.04, 0.14], [0.020, 0.018, 0.012]),
}


@pytest.mark.parametrize("name", PROFILES)
def test_a_taper_adds_a_straight_line(name):
    profile, s = PROFILES[name], np.linspace(0.0, 0.14, 29)
    before, after = np.asarray(profile(s)), np.asarray(tapered(profile, 0.022, 0.011, 0.14)(s))
    line = np.interp(s, [0.0, 0.14], [0.022 - before[0], 0.011 - before[-1]])
    np.testing.assert_allclose(after, before + line, atol=1e-16)


def test_loads_and_directions_reach_the_solver(explored):
    numbers = {**explored.start.numbers, "tip_force.1": -2.0, "tip_moment": 0.05}
    case = explored.case(explored.start._replace(numbers=numbers, direction=(-1,), kinematics="published"))
    np.testing.assert_array_equal(case.loads.tip_force, [0.0, -2.0])
    assert case.loads.tip_moment == 0.05
    assert case.direction.tolist() == [-1.0]
    assert case.manipulator.kinematics == "published"
    assert explored.case(explored.start).loads is None


def test_directions_are_found_unless_they_are_stated():
    """design.md section 2: the antagonist at 20 N slides out, 45.9 degrees and 28.0 N; both in would give 54.0."""
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
def test_what_is_computed_at_once_keeps_its_mark(monkeypatch):
    """As where a file is loaded, and the page is there already."""
    pn = pytest.importorskip("panel")
    from bokeh.document import Document
    from panel.io.state import set_curdoc

    from cddf_jax.explorer import Page

    idle: Any = SimpleNamespace(pictures=SimpleNamespace(submit=lambda *_: None))
    with set_curdoc(Document()):
        monkeypatch.setattr(type(pn.state), "onload", lambda _, callback: callback())
        page = Page(paper_body("exact"), (), "", (), idle)
    marked = {part.css_classes[-1] for part in page.place if "computing" in part.css_classes}
    assert marked == {"body", "numbers", "tension", "along"}


def test_files_hold_what_is_shown(explored, picture, tmp_path):
    path = tmp_path / "body.toml"
    path.write_text(explored.toml(picture.case))
    body = cddf.read_manipulator(path)
    assert (body.outer_radius.base, body.outer_radius.tip) == (0.018, 0.015)
    text = fields_csv(picture.along, ["a note"]).splitlines()
    assert text[0] == "# a note"
    header, rows = text[1].split(","), np.array([line.split(",") for line in text[2:]], float)
    assert header[:2] == ["arc_length [m]", "x [m]"]
    tension = rows[:, header.index("tension_1 [N]")]
    assert tension[0] == pytest.approx(60.0, rel=1e-9)
    assert tension[-1] == pytest.approx(float(picture.equilibrium.tip_tension[0]), rel=1e-9)
    assert rows[-1, 0] == pytest.approx(0.140)


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.filterwarnings(
    "ignore:There is no current event loop:DeprecationWarning"
)  # Tornado asks for one, Python 3.12 on
@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # Tornado leaves one open that it cannot bind
def test_a_port_in_use_is_said(cddf_command):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, out, error = cddf_command("explore", "--no-browser", "--port", port)
        gc.collect()
    assert (code, out) == (2, "")
    assert error.startswith(f"error: --port {port}: Address already in use; give another")
    assert error.count("\n") == 1


def test_without_panel_the_remedy_is_said(cddf_command, monkeypatch):
    for name in ("explorer", "explorer_view"):
        monkeypatch.delitem(sys.modules, f"cddf_jax.{name}", raising=False)
        monkeypatch.delattr(cddf, name, raising=False)
    monkeypatch.setitem(sys.modules, "panel", None)
    code, _, error = cddf_command("explore", "--no-browser")
    assert code == 2
    assert error == "error: explore needs the package panel; install it with pip install 'cddf-jax[explore]'\n"


# --- the page in a browser ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def server():
    """`cddf explore` twice in one process, each ended as a person ends it: its output, and the first address."""
    program = "from cddf_jax.cli import app; [app(standalone_mode=False) for _ in range(2)]"
    arguments = [ROBOT, ANGLES, "--kinematics", "exact", "--no-browser"]
    command = [sys.executable, "-u", "-c", program, "explore", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        if line:
            yield process, line.split()[0]
            process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert line.startswith("http://localhost:"), error
    assert process.returncode == 0, error
    assert "Traceback" not in error


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine; install Debian's package of this name")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def opened(browser, server):
    """The page with its first picture, what it asked for, and what went wrong in it."""
    page, asked, wrong = browser.new_page(viewport={"width": 1440, "height": 900}), [], []
    page.set_default_timeout(PATIENCE)
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(server[1])
    page.locator(".computing").first.wait_for()  # while there is no answer yet
    wait_for(page, "new_base_tension")
    page.locator(".computing").first.wait_for(state="detached")
    yield page, asked, wrong
    page.close()


@pytest.fixture
def page(opened):
    """The page with the numbers of the file, 75 N."""
    opened[0].get_by_role("button", name="Back to the file").click()
    wait_for(opened[0], "base_tension_1", "75")
    return opened[0]


CONTROLS = [control.name for control in Exploration(paper_body("exact")).controls]


def slider(page, name):
    return page.get_by_role("slider").nth(CONTROLS.index(name))


def type_number(page, name, text):
    """Into the field beside a slider."""
    field = page.locator(".slider-edit input").nth(CONTROLS.index(name))
    field.fill(text)
    field.press("Enter")


def wait_for(page, name, text=None):
    """Until a number, or this one, stands on the page."""
    words = {} if text is None else {"has_text": re.compile(f"^{re.escape(text)}$")}
    page.locator(f'[data-name="{name}"]', **words).wait_for()


def follows(page, base_tension, **changes):
    """Whether the page comes to show what `solve` finds."""
    found = cddf.solve(paper_body("exact", **changes), base_tension)
    wait_for(page, "tip_tension_1", f"{found.tip_tension[0]:.4f}")
    wait_for(page, "tension_loss_1", f"{100 * found.tension_loss[0]:.3f}")
    wait_for(page, "tip_angle", f"{np.degrees(found.tip_angle):.3f}")
    wait_for(page, "tip_x", f"{1e3 * found.tip_position[0]:.3f}")
    wait_for(page, "tip_y", f"{1e3 * found.tip_position[1]:.3f}")
    return True


def test_the_page_shows_what_solve_finds(page):
    assert follows(page, 75.0)
    assert page.get_by_role("alert").count() == 0


def test_every_field_has_a_name_for_screen_readers(page):
    for control in Exploration(paper_body("exact")).controls:
        label = f"{control.label} ({control.unit})" if control.unit else control.label
        field = page.get_by_role("textbox", name=label, exact=True)
        assert float(field.input_value()) == pytest.approx(control.value)


def test_what_is_computed_loses_its_mark(page):
    type_number(page, "base_tension_1", "64")
    assert follows(page, 64.0)
    page.locator(".computing").first.wait_for(state="detached")


def test_keys_move_a_slider(page):
    """By Tab alone to the first handle; its steps are of 0.5 N."""
    page.locator("input[type=file]").first.focus()
    for _ in range(20):
        page.keyboard.press("Tab")
        if slider(page, "base_tension_1").evaluate("handle => handle.matches(':focus')"):
            break
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    wait_for(page, "base_tension_1", "76")
    assert follows(page, 76.0)


def test_a_slider_is_dragged(page):
    from playwright.sync_api import expect

    handle = slider(page, "friction_coefficient")
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y, steps=20)
    page.mouse.up()
    index = CONTROLS.index("friction_coefficient")
    # the field lags behind the handle; where that was let go stands in the page's model of it
    left = page.evaluate(
        """index => [...Bokeh.documents[0]._all_models.values()]
        .filter(model => model.type.endsWith('Slider'))[index].value""",
        index,
    )
    assert left < 0.35
    assert follows(page, 75.0, friction_coefficient=left)
    expect(page.locator(".slider-edit input").nth(index)).to_have_value(f"{left:.10g}", timeout=PATIENCE)


def test_exact_numbers_are_typed(page):
    type_number(page, "youngs_modulus", "1.2345")
    type_number(page, "outer_radius.tip", "14.2")
    assert follows(page, 75.0, youngs_modulus=1.2345e6, outer_radius=(0.020, 0.0142))


def test_the_body_is_to_scale(page):
    """Millimetres per pixel along both axes."""
    x, y = page.evaluate("""() => {
        const body = Bokeh.documents[0].get_model_by_name('body')
        return [(body.x_range.end - body.x_range.start) / body.inner_width,
                (body.y_range.end - body.y_range.start) / body.inner_height]
    }""")
    assert x == pytest.approx(y, rel=0.01)


def test_a_body_that_is_none_is_said(page):
    type_number(page, "outer_radius.tip", "9")
    page.get_by_role("alert").filter(has_text="tendon 1: offset must lie inside the wall").wait_for()
    assert follows(page, 75.0)  # the last good picture
    assert page.locator(".stale").count() > 0
    page.get_by_role("button", name="Back to the file").click()
    page.get_by_role("alert").wait_for(state="detached")
    assert page.locator(".stale").count() == 0


def test_crossing_fibres_are_said(page):
    """Without friction the tip has d kappa = T d^2 / (E J), 1.4 at 400 N."""
    type_number(page, "friction_coefficient", "0")
    type_number(page, "base_tension_1", "400")
    page.get_by_role("alert").filter(has_text="offset * curvature").wait_for()
    assert page.locator(".stale").count() > 0


@pytest.mark.parametrize(
    ("label", "name", "start"),
    [("Figure (PDF)", "explorer.pdf", b"%PDF"), ("Figure (PNG)", "explorer.png", b"\x89PNG")],
)
def test_the_figure_is_saved(page, tmp_path, label, name, start):
    assert saved(page, tmp_path, label, name).read_bytes().startswith(start)


def saved(page, folder, label, name):
    with page.expect_download() as download:
        page.get_by_text(label).click()
    assert download.value.suggested_filename == name
    download.value.save_as(folder / name)
    return folder / name


def test_body_and_fields_are_saved(page, tmp_path):
    type_number(page, "outer_radius.tip", "14.2")
    type_number(page, "base_tension_1", "40")
    assert follows(page, 40.0, outer_radius=(0.020, 0.0142))
    body = cddf.read_manipulator(saved(page, tmp_path, "Body as set (TOML)", "body.toml"))
    assert float(body.outer_radius.tip) == 0.0142
    text = saved(page, tmp_path, "Fields along the body (CSV)", "fields.csv").read_text()
    assert "# Base tension = 40 N" in text
    expected = cddf.solve(paper_body("exact", outer_radius=(0.020, 0.0142)), 40.0).tip_tension[0]
    assert float(text.splitlines()[-1].split(",")[5]) == pytest.approx(float(expected), rel=1e-9)


def fit_on(page):
    page.get_by_role("button", name="Fit friction and modulus").click()
    page.locator('[data-name="verdict"]').wait_for(state="detached")
    verdict = page.locator('[data-name="verdict"]')
    verdict.wait_for()
    return " ".join(verdict.inner_text().split())


def test_the_data_are_fitted_and_the_sliders_set(page):
    fit = cddf.fit(paper_body("exact"), cddf.read_measurements(ANGLES))
    told = fit_on(page)
    for line in fit.verdict:
        assert line in told
    page.get_by_role("button", name="Set the sliders to the fit").click()
    # half-widths of 0.001 to 0.01, and of 1 to 10 kPa: in the units shown, four digits behind the point
    ends = fit.confidence_interval
    assert 0.002 < np.ptp(ends["friction_coefficient"]) < 0.02
    assert 2e3 < np.ptp(ends["youngs_modulus"]) < 2e4
    set_to = {"friction_coefficient": round(fit.value["friction_coefficient"], 4)}
    set_to["youngs_modulus"] = 1e6 * round(1e-6 * fit.value["youngs_modulus"], 4)
    assert follows(page, 75.0, **set_to)


def test_a_bad_file_changes_nothing(page, tmp_path):
    robot, table = page.locator("input[type=file]").first, page.locator("input[type=file]").nth(1)
    (tmp_path / "bad.toml").write_text('length = "140"\n')
    robot.set_input_files(tmp_path / "bad.toml")
    page.get_by_role("alert").filter(has_text=re.compile("^bad.toml: outer_radius is missing; add it$")).wait_for()
    (tmp_path / "bad.csv").write_text("base_tension [N], tip_tension [N]\n5, five\n")
    table.set_input_files(tmp_path / "bad.csv")
    said = "bad.csv: row 2, column tip_tension: 'five' is not a number; give a number or remove the row"
    page.get_by_role("alert").filter(has_text=re.compile(f"^{said}$")).wait_for()
    assert follows(page, 75.0)


def test_what_the_data_do_not_tell_is_no_number(page):
    """Tensions of one tendon hold mu / E alone, design.md section 4: 0.42 / 1.4 MPa within its interval."""
    page.locator("input[type=file]").nth(1).set_input_files(CELLS)
    page.get_by_text("load_cells_simulated.csv").first.wait_for()
    told = fit_on(page)
    assert "friction_coefficient: not identified" in told
    assert "youngs_modulus: not identified" in told
    value, error = map(float, re.search(r"friction_coefficient / youngs_modulus = (\S+) \+- (\S+)", told).groups())
    assert abs(value - 0.42 / 1.4e6) < 3 * error
    assert "pulley test" in told
    assert not page.get_by_role("button", name="Set the sliders to the fit").is_visible()


def test_a_narrow_page_is_one_column(page):
    page.set_viewport_size({"width": 420, "height": 900})
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= 420
    edges = [page.locator(f".{name}").first.bounding_box() for name in ("body", "numbers", "side", "tension")]
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= 420 for box in edges)
    assert [box["y"] for box in edges] == sorted(box["y"] for box in edges)


def test_nothing_is_asked_of_the_network(opened):
    _, asked, wrong = opened
    assert any(url.startswith("ws://localhost:") for url in asked)
    hosts = {re.match(r"\w+://([^:/]*)", url)[1] for url in asked if not url.startswith(("data:", "blob:"))}
    assert hosts == {"localhost"}
    assert wrong == []


def test_a_second_page_in_one_process(browser, server, opened):
    """After the first was ended; it comes last, as that ends the page of all the others."""
    process, first = server
    process.send_signal(signal.SIGINT)
    second = process.stdout.readline().split()[0]
    assert second != first
    page = browser.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(second)
    assert follows(page, 75.0)
    page.close()
