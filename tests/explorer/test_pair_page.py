"""The page of an antagonistic pair in a headless browser."""

import pytest
from bodies import paper_body
from pages import opened_page, served, wait_for

from cddf_jax.explorer.model import Exploration
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


def type_number(page, name, text):
    field = page.locator(".slider-edit input").nth(CONTROLS.index(name))
    field.fill(text)
    field.press("Enter")


def test_the_axis_names_the_tendon_that_moved(opened):
    label = "() => Bokeh.documents[0].get_model_by_name('tip_angle').below[0].axis_label"
    for name in ("base_tension_2", "base_tension_1"):
        type_number(opened, name, "50")
        wait_for(opened, name, "50")
        assert opened.evaluate(label) == f"Base tension of tendon {name[-1]} (N)"


def test_the_past_of_several_tendons_is_not_remembered(opened):
    opened.get_by_text("The past is remembered for one tendon.").wait_for()
    assert opened.get_by_role("button", name="Forget the past").count() == 0
