"""The explorer's page in a headless browser against `solve` and `fit`; `make browser` runs these tests."""

import signal

import numpy as np
import pytest
from bodies import paper_body
from pages import COMPUTING, PATIENCE, STALE, hosts_of, is_to_scale, opened_page, served, type_at, wait_for
from places import DATA

import cddf_jax as cddf
from cddf_jax.explorer.model import Exploration

pytestmark = pytest.mark.browser

ROBOT, ANGLES = DATA / "smooth_sil_940.toml", DATA / "tip_angle_simulated.csv"


@pytest.fixture(scope="module")
def server():
    """`cddf explore` twice in one process: the process, and the first address."""
    with served(ROBOT, ANGLES, "--kinematics", "exact", times=2) as (process, address):
        yield process, address


@pytest.fixture(scope="module")
def opened(browser, server):
    """The page with its first picture, what it asked for, and what went wrong in it."""
    page, asked, wrong = opened_page(browser, server[1])
    page.locator(COMPUTING).first.wait_for()  # while there is no answer yet
    wait_for(page, "tip_angle")
    page.locator(COMPUTING).first.wait_for(state="detached")
    yield page, asked, wrong
    page.close()


@pytest.fixture
def page(opened):
    """The page with the numbers of the file, 75 N."""
    opened[0].get_by_role("button", name="Back to the file").click()
    wait_for(opened[0], "base_tension_1", "75")
    return opened[0]


CONTROLS = [control.name for control in Exploration(paper_body("exact")).controls]


def type_number(page, name, text):
    type_at(page, CONTROLS.index(name), text)


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
        label = f"{control.label} ({control.quantity.shown[1]})".removesuffix(" ()")
        field = page.get_by_role("textbox", name=label, exact=True)
        assert float(field.input_value()) == pytest.approx(control.value)


def test_the_way_back_is_remembered_and_forgotten(page):
    """docs/hysteresis.md: 75, then 40 N; another body goes the same way, and the button makes it forget."""
    page.get_by_text("Drag the base tension back").wait_for()
    type_number(page, "base_tension_1", "40")
    wait_for(page, "past_tip_tension_1", "45.1229")
    wait_for(page, "past_tip_angle", "56.054")
    wait_for(page, "front", "115.09")
    assert follows(page, 40.0)  # all else is that of a pull from rest
    type_number(page, "youngs_modulus", "1.5")
    other = cddf.trace(paper_body("exact", youngs_modulus=1.5e6), [75.0, 40.0])
    wait_for(page, "past_tip_tension_1", f"{other.tip_tension[-1]:.4f}")
    page.get_by_role("button", name="Forget the past").click()
    page.get_by_text("Drag the base tension back").wait_for()


def test_the_body_is_to_scale(page):
    assert is_to_scale(page, "body")


def test_a_body_that_is_none_is_said(page):
    type_number(page, "outer_radius.tip", "9")
    page.get_by_role("alert").filter(has_text="tendon 1: offset must lie inside the wall").wait_for()
    assert follows(page, 75.0)  # the last good picture
    assert page.locator(STALE).count() > 0
    page.get_by_role("button", name="Back to the file").click()
    page.get_by_role("alert").wait_for(state="detached")
    assert page.locator(STALE).count() == 0


def test_crossing_fibres_are_said(page):
    """Without friction the tip has d kappa = T d^2 / (E J), 1.4 at 400 N."""
    type_number(page, "friction_coefficient", "0")
    type_number(page, "base_tension_1", "400")
    page.get_by_role("alert").filter(has_text="offset * curvature").wait_for()
    assert page.locator(STALE).count() > 0


def test_what_is_set_is_saved(page, tmp_path):
    type_number(page, "outer_radius.tip", "14.2")
    assert follows(page, 75.0, outer_radius=(0.020, 0.0142))
    for label, name, holds in (
        ("Figure (PDF)", "explorer.pdf", b"%PDF"),
        ("Figure (PNG)", "explorer.png", b"\x89PNG"),
        ("Body as set (TOML)", "body.toml", b'"14.2 mm"'),
        ("Fields along the body (CSV)", "fields.csv", b"arc_length [m],"),
    ):
        with page.expect_download() as download:
            page.get_by_text(label).click()
        assert download.value.suggested_filename == name
        download.value.save_as(tmp_path / name)
        assert holds in (tmp_path / name).read_bytes()


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
    assert hosts_of(asked) == {"localhost"}
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
