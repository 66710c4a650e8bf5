"""The functions of `cddf_jax.figures`: axes in, axes out, with units, and what they show is what they were given."""

import re
from functools import partial

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from bodies import paper_body
from kinds import of_kind
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.quiver import Quiver
from places import DATA
from read_back import x_of, xy_of, y_of
from refusals import refused
from scipy import stats

import cddf_jax as cddf
from cddf_jax import figures

TENSIONS, FRICTIONS = np.linspace(10.0, 50.0, 5), np.array([0.2, 0.4, 0.6])
NUMBERS = ("base_tension", "friction_coefficient")
LOCKED = cddf.Status.locked
PAIR = paper_body(num_tendons=2)
PLAIN = {"Friction coefficient", "Root of the rise in squares", ""}  # numbers without a unit, and hidden labels


@pytest.fixture(scope="module")
def bent():
    return cddf.solve(PAIR, [60.0, 20.0], direction=[+1, -1])


@pytest.fixture(scope="module")
def fit():
    """The friction of the simulated pulley test: no solve, and a model that stands in one line of NumPy."""
    table = cddf.read_measurements(DATA / "pulley_simulated.csv")
    return cddf.fit(cddf.read_manipulator(DATA / "smooth_sil_940.toml"), table, free="friction_coefficient")


@pytest.fixture(scope="module")
def profile(fit):
    return fit.profile("friction_coefficient")


@pytest.fixture(scope="module")
def grid():
    """Made up: 100 times the sum of places for tendon 1, 1000 more for tendon 2; one solve failed."""
    places = np.add.outer(np.arange(5.0), np.arange(3.0))
    result = np.zeros((5, 3), np.int8)
    result[4, 2] = LOCKED
    places[4, 2] = np.nan
    tension = np.stack([100 * places, 100 * places + 1000], axis=-1)
    return xarray.Dataset(
        {
            "tip_tension": ((*NUMBERS, "tendon"), tension, {"units": "N"}),
            "tip_position": ((*NUMBERS, "component"), np.stack([places, 2 * places], -1), {"units": "m"}),
            "stable": (NUMBERS, np.ones((5, 3), bool)),
            "result": (NUMBERS, result),
        },
        {
            "base_tension": ("base_tension", TENSIONS, {"units": "N"}),
            "friction_coefficient": ("friction_coefficient", FRICTIONS, {"units": "1"}),
            "tendon": np.arange(2),
            "component": ["X", "Y"],
        },
    )


DRAWN = {
    "shape": lambda it, axes: figures.draw_shape(PAIR, it("bent"), axes=axes),
    "force_arrows": lambda it, axes: figures.draw_force_arrows(PAIR, it("bent"), axes),
    "along": lambda it, axes: figures.draw_along(PAIR, it("bent"), "tension", axes),
    "fit": lambda it, axes: figures.draw_fit(it("fit"), axes=axes),
    "residuals": lambda it, axes: figures.draw_residuals(it("fit"), axes=axes),
    "profile": lambda it, axes: figures.draw_profile(it("fit"), it("profile"), axes),
    "lines": lambda it, axes: figures.draw_lines(it("grid").sel(tendon=0), "tip_tension", "base_tension", axes),
    "map": lambda it, axes: figures.draw_map(it("grid").sel(tendon=0), "tip_tension", *NUMBERS, axes),
}


@pytest.mark.parametrize("name", DRAWN)
def test_axes_in_and_axes_out(name, request):
    """With units, in the style of the axes that are given or else in the house style; nothing else changes."""
    before, given = (dict(mpl.rcParams), plt.get_fignums()), Figure().subplots()
    assert DRAWN[name](request.getfixturevalue, given) is given
    made = DRAWN[name](request.getfixturevalue, None)
    assert before == (dict(mpl.rcParams), plt.get_fignums())
    assert given.xaxis.label.get_fontfamily() == mpl.rcParams["font.family"]
    assert made.xaxis.label.get_fontfamily() == ["STIXGeneral"]
    assert of_kind(Figure, made.figure).get_figwidth() == figures.SINGLE_COLUMN
    of_kind(Figure, given.figure).draw_without_rendering()
    for label in (given.get_xlabel(), given.get_ylabel()):
        assert label in PLAIN or re.search(r" \([^)]*[a-zA-Z°%][^)]*\)$", label), label


# --- what is drawn is what was given -------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["tension", "curvature", "normal_force", "friction_force", "strain", "heading"])
def test_lines_along_the_body(bent, quantity):
    lines = figures.draw_along(PAIR, bent, quantity, Figure().subplots()).lines
    s = np.linspace(0.0, 0.140, 201)
    along = bent.at(s)
    expected = {
        "tension": along.tension,
        "curvature": [along.curvature],
        "normal_force": np.hypot(*np.moveaxis(along.normal_force, -1, 0)),
        "friction_force": np.hypot(*np.moveaxis(along.friction_force, -1, 0)),
        "strain": [100 * (0.020 - 0.007 * s / 0.140) * np.abs(along.curvature)],  # the paper's cone: 20 to 13 mm
        "heading": [np.degrees(along.heading)],
    }[quantity]
    assert len(lines) == len(expected)
    for line, values in zip(lines, expected, strict=True):
        np.testing.assert_allclose(np.interp(1e3 * s, *xy_of(line)), values, rtol=1e-9, atol=1e-12)


def test_arrows_are_the_forces(bent):
    axes = figures.draw_force_arrows(PAIR, bent, Figure().subplots())
    normal, friction = (artist for artist in axes.collections if isinstance(artist, Quiver))
    s = 0.140 * (np.arange(10) + 0.45) / 10  # the middle of each tenth, a bit before
    along = bent.at(s)
    for arrows, force in ((normal, along.normal_force), (friction, along.friction_force)):
        np.testing.assert_allclose(np.stack([arrows.U, arrows.V], -1), np.reshape(force, (-1, 2)), rtol=1e-9)
    left = np.stack([-np.sin(along.heading), np.cos(along.heading)], axis=-1)
    roots = [1e3 * (along.position + side * 0.010 * left) for side in (+1, -1)]  # the paper's tendon: 10 mm off
    np.testing.assert_allclose(np.asarray(normal.get_offsets()), np.concatenate(roots), rtol=1e-9)


def test_a_body_to_scale_in_axes_that_share_their_limits(bent):
    figure = Figure()
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    figures.draw_shape(PAIR, bent, axes=axes[0])
    figures.draw_force_arrows(PAIR, bent, axes[1])
    figure.draw_without_rendering()
    assert axes[0].get_aspect() == axes[1].get_aspect() == 1.0


def test_the_model_and_the_data(fit):
    """Liu et al. (2020), eq. (5): T / W = exp(mu wrap), with the slope wrap exp(mu wrap) by mu."""
    (table,) = fit.tables
    axes = figures.draw_fit(fit, axes=Figure().subplots())
    mu, error = fit.value["friction_coefficient"], fit.standard_error["friction_coefficient"]
    line = next(line for line in axes.lines if line.get_label() == "model")
    wrap = np.radians(x_of(line))
    np.testing.assert_allclose(y_of(line), np.exp(mu * wrap), rtol=1e-9)
    (band,) = (item for item in axes.collections if item.get_label() == "95 % band of the model")
    high = np.max(np.exp(mu * wrap) + stats.t.ppf(0.975, fit.degrees_of_freedom) * error * wrap * np.exp(mu * wrap))
    assert band.get_datalim(axes.transData).ymax == pytest.approx(high, rel=1e-4)
    data = next(line for line in axes.lines if line.get_label() == "simulated data")
    expected = np.degrees(table["wrap_angle"]), table["pulling_tension"] / table["weight"]
    np.testing.assert_allclose(xy_of(data), expected)


def test_the_residuals_stand_below_the_data(fit):
    (figure,) = figures.table_figures(fit).values()
    above, below = figure.axes
    assert above.get_xlim() == below.get_xlim()
    dots = next(line for line in below.lines if line.get_marker() == "o")
    (table,) = fit.tables
    predicted = np.exp(fit.value["friction_coefficient"] * table["wrap_angle"])
    np.testing.assert_allclose(y_of(dots), table["pulling_tension"] / table["weight"] - predicted, atol=1e-9)


# --- what cannot be drawn ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda it: figures.draw_along(PAIR, it("bent"), "stress"), "figures: quantity must be one of tension, "),
        (lambda it: figures.draw_fit(it("fit"), "x.csv"), "draw_fit: table must be one of pulley_simulated.csv"),
        (lambda it: figures.draw_residuals(it("fit"), column="tip_x"), "draw_residuals: column must be one of"),
        (lambda it: figures.draw_lines(it("grid"), "x", "base_tension"), "draw_lines: 'x' is not an output of this"),
        (lambda it: figures.draw_lines(it("grid"), "tip_tension", "length"), "draw_lines: 'length' is not a number"),
        (lambda it: figures.draw_map(it("grid"), "tip_position", *NUMBERS), "draw_map: component varies too, with 2"),
        (lambda it: figures.draw_map(it("grid"), "stable", NUMBERS[0], NUMBERS[0]), "draw_map: x and y"),
    ],
)
def test_a_wrong_name_gives_one_clear_line(draw, message, request):
    assert refused(draw, request.getfixturevalue).startswith(message)


def test_a_failed_solve_is_not_drawn(bent):
    nothing = jax.tree.map(lambda x: x * np.nan if np.issubdtype(x.dtype, np.inexact) else x, bent)
    along = partial(figures.draw_along, quantity="tension")
    for draw in (figures.draw_shape, figures.draw_force_arrows, along):
        with pytest.raises(cddf.InputError, match="the solve failed"):
            draw(PAIR, nothing)


# --- style and files -----------------------------------------------------------------------------


def a_figure():
    with figures.house_style():
        figure = figures.new_figure(figures.SINGLE_COLUMN, 2.0)
        figure.subplots().plot([0.0, 3.0], [1.0, 20.0])
    return figure


def test_a_file_is_sharp_and_has_the_same_bytes_again(tmp_path):
    figure, path = a_figure(), tmp_path / "picture.png"
    figure.savefig(path)
    assert imread(path).shape[:2] == (600, 1050)  # 2 by 3.5 inches of 300 dots
    pdf = figures.render(figure, "picture")["picture.pdf"]
    assert pdf.startswith(b"%PDF-")
    assert b"/FontType0" in pdf.replace(b" ", b"") or b"/Type0" in pdf  # no Type 3, which journals refuse
    assert figures.render(a_figure(), "picture")["picture.pdf"] == pdf
