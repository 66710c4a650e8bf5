"""The page of an antagonistic pair in a headless browser: it remembers its tensions and loads; see hysteresis.md."""

import re

import numpy as np
import pytest
from bodies import paper_body
from pages import opened_page, served, wait_for

import cddf_jax as cddf
from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import SHORT_STEPS
from cddf_jax.files.manipulator_file import manipulator_text

pytestmark = pytest.mark.browser

PAIR = paper_body("exact", num_tendons=2, density=1070.0)
CONTROLS = [control.name for control in Exploration(PAIR).controls]


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory):
    """The page with its first picture."""
    path = tmp_path_factory.mktemp("pair") / "pair.toml"
    path.write_text(manipulator_text(PAIR))
    with served(path) as (_, address):
        page, _, wrong = opened_page(browser, address)
        wait_for(page, "tip_angle")
        yield page
        page.close()
        assert wrong == []


@pytest.fixture
def page(opened):
    """The page with both tendons pulled together, to 75 and 20 N."""
    opened.get_by_role("button", name="Back to the file").click()
    wait_for(opened, "base_tension_1", "75")
    wait_for(opened, "base_tension_2", "0")
    type_number(opened, "base_tension_2", "20")
    wait_for(opened, "base_tension_2", "20")
    forget(opened)
    return opened


def type_number(page, name, text):
    field = page.locator(".slider-edit input").nth(CONTROLS.index(name))
    field.fill(text)
    field.press("Enter")


def forget(page):
    page.get_by_role("button", name="Forget the past").click()
    page.get_by_text("The past begins here: all tendons were pulled together").wait_for()


def number(page, name):
    return float(page.locator(f'[data-name="{name}"]').inner_text())


def test_a_released_pair_is_remembered(page):
    """The states of the table, hysteresis.md section 3, as far as steps of 3 N find them."""
    type_number(page, "base_tension_1", "60")
    wait_for(page, "base_tension_1", "60")
    wait_for(page, "past_tip_angle")
    type_number(page, "base_tension_1", "40")
    wait_for(page, "base_tension_1", "40")
    page.locator('[data-name="past_tip_angle"]', has_text=re.compile("^31[.]0")).wait_for()
    assert number(page, "past_tip_angle") == pytest.approx(31.046, abs=0.03)
    assert number(page, "past_tip_tension_1") == pytest.approx(45.013, abs=0.05)
    assert number(page, "past_tip_tension_2") == pytest.approx(17.772, abs=0.05)
    assert number(page, "front") == pytest.approx(125.43, abs=1.0)
    assert number(page, "tip_angle") < 30  # all else is that of a pull from rest


def test_gravity_is_a_step_and_may_rest_on_the_body_first(page):
    """Against `trace` with the loads of each step, and with loads that act before the first step."""
    bare, heavy = cddf.Loads(), cddf.Loads(gravity=(0.0, -9.81))
    type_number(page, "gravity.1", "-9.81")
    later = cddf.trace(PAIR, [[75.0, 20.0]] * 2, [bare, heavy], short_steps=32)
    wait_for(page, "past_tip_angle")
    assert number(page, "past_tip_angle") == pytest.approx(np.degrees(float(later.tip_angle[-1])), abs=0.03)
    forget(page)
    type_number(page, "base_tension_1", "60")
    first = cddf.trace(PAIR, [[75.0, 20.0], [60.0, 20.0]], heavy, short_steps=2 * SHORT_STEPS)
    wait_for(page, "past_tip_angle")
    assert number(page, "past_tip_angle") == pytest.approx(np.degrees(float(first.tip_angle[-1])), abs=0.1)


def test_another_body_forgets_and_says_so(page):
    type_number(page, "base_tension_2", "15")
    wait_for(page, "past_tip_angle")
    type_number(page, "youngs_modulus", "1.5")
    page.get_by_text("The body has changed: its past was forgotten.").wait_for()
    assert page.locator('[data-name="past_tip_angle"]').count() == 0


def test_the_axis_names_the_tendon_that_moved(page):
    label = "() => Bokeh.documents[0].get_model_by_name('tip_angle').below[0].axis_label"
    for name in ("base_tension_2", "base_tension_1"):
        type_number(page, name, "50")
        wait_for(page, name, "50")
        assert page.evaluate(label) == f"Base tension of tendon {name[-1]} (N)"
