"""The page of a body in space in a headless browser, against `solve`; `make browser` runs these tests."""

import numpy as np
import pytest
from pages import COMPUTING, is_to_scale, opened_page, served, type_at, wait_for
from places import DATA

import cddf_jax as cddf
from cddf_jax.explorer.space import BODY

pytestmark = pytest.mark.browser

ROBOT = DATA / "three_tendons_made_up.toml"
TENSIONS = (30.0, 10.0, 0.0)


@pytest.fixture(scope="module")
def body():
    return cddf.read_manipulator(ROBOT)


@pytest.fixture(scope="module")
def opened(browser, body):
    """The page with two tendons pulled, what it asked for, and what went wrong in it."""
    with served(ROBOT) as (_, address):
        page, asked, wrong = opened_page(browser, address)
        wait_for(page, "tip_angle")
        for i, tension in enumerate(TENSIONS):
            type_at(page, i, f"{tension:g}")
        wait_for(page, "base_tension_2", "10")
        page.locator(COMPUTING).first.wait_for(state="detached")
        yield page, asked, wrong
        page.close()


@pytest.fixture
def page(opened):
    """Seen from where the figures see a body."""
    see_from(opened[0], -58, 24)
    return opened[0]


@pytest.fixture(scope="module")
def found(body):
    return cddf.solve(body, np.array(TENSIONS))


def angles(page):
    """Azimuth and elevation, deg."""
    return page.evaluate("""() => ['azimuth', 'elevation'].map(name => [...Bokeh.documents[0]._all_models.values()]
        .find(model => model.type == 'Slider' && (model.title ?? '').includes(name)).value)""")


def see_from(page, azimuth, elevation):
    page.evaluate(
        """angles => ['azimuth', 'elevation'].forEach((name, i) => [...Bokeh.documents[0]._all_models.values()]
        .find(model => model.type == 'Slider' && (model.title ?? '').includes(name)).value = angles[i])""",
        [azimuth, elevation],
    )


def seen(page, figure):
    """What a figure shows: the data of the sources of its glyphs, in the order in which it draws."""
    return page.evaluate(
        """name => Bokeh.documents[0].get_model_by_name(name).renderers.map(renderer =>
        Object.fromEntries(renderer.data_source.columns().map(column =>
            [column, Array.from(renderer.data_source.get(column), each => each.length === undefined
                || typeof each == 'string' ? each : Array.from(each))])))""",
        figure,
    )


def ends_of(page, figure):
    """The anchors of the tendons as they are seen, mm."""
    (source,) = [data for data in seen(page, figure) if set(data) == set(BODY["ends"]) and len(data["x"]) == 3]
    return np.array([source["x"], source["y"]], float).T


def anchors(found):
    return 1e3 * np.asarray(found.at(found.arc_length[-1]).path)


def test_the_page_shows_what_solve_finds(page, found):
    for i, (base, tip) in enumerate(zip(found.base_tension, found.tip_tension, strict=True), 1):
        wait_for(page, f"base_tension_{i}", f"{base:.4g}")
        wait_for(page, f"tip_tension_{i}", f"{tip:.4f}")
    wait_for(page, "tip_angle", f"{np.degrees(found.tip_angle):.3f}")
    for axis, place in zip("xyz", 1e3 * np.asarray(found.tip_position), strict=True):
        wait_for(page, f"tip_{axis}", f"{place:.3f}")


@pytest.mark.parametrize(("plane", "right", "up"), [("XY", 0, 1), ("XZ", 0, 2), ("YZ", 1, 2)])
def test_plane_views_show_coordinates_in_mm(page, found, plane, right, up):
    np.testing.assert_allclose(ends_of(page, f"view_{plane}"), anchors(found)[:, [right, up]], atol=1e-6)


def test_the_view_is_turned_by_dragging(page, found):
    """Half a degree for each pixel; seen places are those on the unit vectors right and up of the direction."""
    box = page.locator(".body").first.bounding_box()
    x, y = box["x"] + 0.6 * box["width"], box["y"] + 250
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 100, y + 40, steps=10)
    page.mouse.up()
    page.wait_for_timeout(500)
    azimuth, elevation = angles(page)
    assert (azimuth, elevation) == (-58 + 50, 24 + 20)
    a, e = np.radians([azimuth, elevation])
    right = [-np.sin(a), np.cos(a), 0.0]
    up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    # distances between the anchors, wherever the middle of the picture is
    expected = np.diff(anchors(found) @ np.array([right, up]).T, axis=0)
    np.testing.assert_allclose(np.diff(ends_of(page, "body"), axis=0), expected, atol=1e-6)


def test_what_the_body_hides_is_pale(page):
    """Straight, seen from +Z: tendon 2 at 120 degrees lies in front of the axis, tendon 3 at 240 degrees behind."""
    for i in range(3):
        type_at(page, i, "0")
    wait_for(page, "base_tension_1", "0")
    wait_for(page, "tip_x", "200.000")
    drawn = [data for data in seen(page, "view_XY") if {"xs", "color"} <= set(data)]
    below, pale, above = ([color for color in data["color"] if color != "#7F7F7F"] for data in drawn)
    assert "#009E73" in pale
    assert "#009E73" not in above + below
    assert "#D55E00" in above
    assert "#D55E00" not in pale + below
    for i, tension in enumerate(TENSIONS):
        type_at(page, i, f"{tension:g}")
    wait_for(page, "base_tension_2", "10")
    page.locator(COMPUTING).first.wait_for(state="detached")


def test_the_axis_names_the_tendon_that_moved(page):
    label = "() => Bokeh.documents[0].get_model_by_name('tip_angle').below[0].axis_label"
    for place, other in ((0, 31.0), (1, 11.0)):
        for tension in (other, TENSIONS[place]):
            type_at(page, place, f"{tension:g}")
            wait_for(page, f"base_tension_{place + 1}", f"{tension:g}")
        assert page.evaluate(label) == f"Base tension of tendon {place + 1} (N)"


def test_the_turned_body_is_to_scale(page):
    assert all(is_to_scale(page, name) for name in ("body", "view_XY", "view_XZ", "view_YZ"))
