"""The figure of a sweep, read back from what is drawn; the numbers are made up."""

import numpy as np
import pytest
import xarray
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation
from read_back import legend_of, x_of, xy_of, y_of

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.figures.style import render
from cddf_jax.figures.sweeps import draw_lines, draw_map, sweep_figure

CROSSING, LOCKED = cddf.Status.crossing, cddf.Status.locked
TENSIONS = np.linspace(10.0, 50.0, 5)
FRICTIONS = np.linspace(0.1, 0.6, 6)
MODULI = np.linspace(1.2e6, 1.6e6, 7)
UNITS = dict.fromkeys(("base_tension", "base_tension_1", "base_tension_2"), "N")
UNITS |= {"friction_coefficient": "1", "youngs_modulus": "Pa"}


def answer_over(axes, *, tendons=1, together=None):
    """A tip tension that is 100 times the sum of places, a tip angle that is their sum; all successful."""
    sizes = {name: len(values) for name, values in axes.items()}
    places = np.array(sum(np.meshgrid(*(np.arange(n) for n in sizes.values()), indexing="ij"), start=0.0), float)
    coords = {name: (name, values, {"units": UNITS[name]} if name in UNITS else {}) for name, values in axes.items()}
    if together:
        coords = {name: c for name, c in coords.items() if name != "sample"}
        coords |= {name: ("sample", values, {"units": UNITS[name]}) for name, values in together.items()}
    coords |= {"tendon": np.arange(tendons)}
    dims = tuple(axes)
    return xarray.Dataset(
        {
            "tip_tension": ((*dims, "tendon"), np.stack([100 * places] * tendons, -1), {"units": "N"}),
            "tip_angle": (dims, np.array(places), {"units": "rad"}),
            "curvature": ((*dims, "point"), np.zeros((*places.shape, 3)), {"units": "1/m"}),
            "result": (dims, np.zeros(places.shape, np.int8)),
        },
        coords,
    )


def drawn(answer, outputs=("tip_tension", "tip_angle")):
    return sweep_figure(answer, outputs)


def hatched(axes):
    return [patch for patch in axes.patches if isinstance(patch, Rectangle) and patch.get_hatch()]


def contours(axes):
    return [artist for artist in axes.collections if isinstance(artist, QuadContourSet)]


# --- lines ---------------------------------------------------------------------------------------


def test_a_line_and_what_is_not_sure():
    answer = answer_over({"base_tension": TENSIONS})
    answer["result"][:] = [0, 0, 0, CROSSING, LOCKED]
    answer["tip_angle"][4] = np.nan
    answer["tip_tension"][4] = np.nan
    figure = drawn(answer)
    tension, angle = figure.axes
    assert (tension.get_xlabel(), tension.get_ylabel()) == ("Base tension (N)", "Tip tension (N)")
    assert angle.get_ylabel() == "Tip angle (deg)"
    line, doubtful, failed = angle.lines
    np.testing.assert_allclose(y_of(line), [*np.degrees([0.0, 1.0, 2.0]), np.nan, np.nan])
    np.testing.assert_allclose(xy_of(doubtful).T, [[40.0, np.degrees(3.0)]])
    assert (doubtful.get_linestyle(), doubtful.get_markerfacecolor()) == ("None", "white")
    assert x_of(failed).tolist() == [50.0]
    assert legend_of(figure) == ["hollow: doubtful, crossing", "at the foot: no number, locked"]


def test_lines_of_labels_and_tendons():
    answer = answer_over({"kinematics": np.array(["published", "exact"]), "base_tension": TENSIONS}, tendons=2)
    figure = drawn(answer, ["tip_tension"])
    assert [axes.get_ylabel() for axes in figure.axes] == [f"Tip tension of tendon {i} (N)" for i in (1, 2)]
    assert legend_of(figure) == ["published kinematics", "exact kinematics"]
    for axes in figure.axes:
        first, second = axes.lines
        np.testing.assert_allclose(y_of(second) - y_of(first), 100.0)
        assert first.get_linestyle() != second.get_linestyle()  # told apart in a grey print


def test_values_in_any_order_make_one_line():
    answer = answer_over({"base_tension": TENSIONS[[2, 0, 1]]})
    (line,) = drawn(answer, ["tip_angle"]).axes[0].lines
    assert x_of(line).tolist() == [10.0, 20.0, 30.0]
    np.testing.assert_allclose(y_of(line), np.degrees([1.0, 2.0, 0.0]))


def test_an_answer_of_yes_or_no_has_none_where_the_solve_failed():
    answer = answer_over({"base_tension": TENSIONS})
    answer["stable"] = ("base_tension", np.array([True] * 4 + [False]))
    assert y_of(drawn(answer, ["stable"]).axes[0].lines[0]).tolist() == [1, 1, 1, 1, 0]
    answer["result"][4], answer["tip_angle"][4] = LOCKED, np.nan  # failed: neither yes nor no
    line, failed = drawn(answer, ["stable"]).axes[0].lines
    np.testing.assert_array_equal(y_of(line), [1, 1, 1, 1, np.nan])
    assert x_of(failed).tolist() == [50.0]


# --- contours ------------------------------------------------------------------------------------


def test_contours_and_where_there_are_none():
    answer = answer_over({"base_tension": TENSIONS, "youngs_modulus": MODULI})
    answer["result"][4, :] = CROSSING
    figure = drawn(answer)
    tension, angle, tension_bar, angle_bar = figure.axes
    assert (tension.get_xlabel(), tension.get_ylabel()) == ("Base tension (N)", "Young's modulus (MPa)")
    assert (tension_bar.get_ylabel(), angle_bar.get_ylabel()) == ("Tip tension (N)", "Tip angle (deg)")
    assert tension.get_xlim() == (10.0, 50.0)
    assert tension.get_ylim() == pytest.approx((1.2, 1.6))
    filled, lines = contours(tension)
    assert min(filled.levels) <= 0.0
    assert max(filled.levels) >= 100.0 * (3 + 6)  # of what is successful
    # 100 (i + k) = 300 is a straight line in the places
    x, y = np.asarray(lines.get_paths()[list(lines.levels).index(300.0)].vertices).T
    np.testing.assert_allclose((x - 10.0) / 10.0 + (y - 1.2) / (0.4 / 6), 3.0, atol=1e-12)
    assert (x.min(), x.max()) == pytest.approx((10.0, 40.0))
    reached = np.concatenate([path.vertices for path in filled.get_paths()])
    assert reached[:, 0].max() == pytest.approx(40.0)  # nothing drawn where solves are doubtful
    assert all(hatched(axes) for axes in (tension, angle))
    assert legend_of(figure) == ["hatched: crossing"]


@pytest.mark.parametrize("value", [0.0, 45.0, np.nan])
def test_an_output_that_does_not_change(value):
    answer = answer_over({"base_tension": TENSIONS, "youngs_modulus": MODULI})
    answer["tip_angle"][...] = value
    answer["result"][...] = 0 if np.isfinite(value) else LOCKED
    figure = drawn(answer, ["tip_angle"])
    assert len(contours(figure.axes[0])) == np.isfinite(value)
    assert bool(hatched(figure.axes[0])) == bool(figure.legends) == np.isnan(value)
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == ["Tip angle (deg)"] * int(np.isfinite(value))


# --- none ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "reason"),
    [
        ({"kinematics": np.array(["published", "exact"])}, "no number varies along an axis of its own"),
        (dict.fromkeys("abcd", TENSIONS), "4 axes are too many for one figure; choose with xarray"),
        (
            {"a": TENSIONS, "b": TENSIONS, "batch": np.array(["x", "y"])},
            "3 axes are too many for one figure; choose with",
        ),
        ({"a": TENSIONS, "batch": np.array([*"abcdefgh"])}, "draw_lines: batch varies too, with 8 values; choose one"),
    ],
)
def test_no_figure_and_why(axes, reason):
    with pytest.raises(InputError, match=f"^{reason}"):
        drawn(answer_over(axes), ["tip_angle"])


def test_one_value_is_no_axis():
    figure = drawn(answer_over({"friction_coefficient": [0.4], "base_tension": TENSIONS}), ["tip_angle"])
    assert isinstance(figure, Figure)
    assert figure.axes[0].get_xlabel() == "Base tension (N)"
    assert set(render(figure, "sweep")) == {"sweep.pdf", "sweep.png"}


# --- a path of base tensions ---------------------------------------------------------------------

PATH = np.array([0.0, 75.0, 40.0, 60.0, 75.0])


def loops_over(axes):
    return answer_over({"base_tension": PATH} | axes).assign_attrs(path="base_tension")


def test_a_path_is_drawn_in_its_order():
    answer = loops_over({"friction_coefficient": FRICTIONS[:3]})
    figure = drawn(answer)
    assert isinstance(figure, Figure)
    tension, angle = figure.axes
    for mu, line in enumerate(tension.lines):
        np.testing.assert_array_equal(x_of(line), PATH)
        np.testing.assert_array_equal(y_of(line), 100 * (np.arange(5.0) + mu))
    arrows = [text for text in angle.texts if isinstance(text, Annotation)]
    assert len(arrows) == 9  # for each of three loops: up to 75 N, back to 40 N, up again
    assert legend_of(figure) == [f"Friction coefficient = {mu:.4g}" for mu in FRICTIONS[:3]]


def test_a_path_of_two_tensions_is_drawn_over_the_one_that_varies():
    """The path has a name of its own, and the second tension stays."""
    together = {"base_tension_1": PATH, "base_tension_2": np.full(5, 20.0)}
    answer = answer_over({"sample": np.arange(5), "friction_coefficient": FRICTIONS[:2]}, together=together)
    answer = answer.assign_attrs(path="sample")
    axes = draw_lines(answer, "tip_angle", "base_tension_1")
    assert len(axes.lines) == 2
    np.testing.assert_array_equal(x_of(axes.lines[0]), PATH)
    with pytest.raises(InputError, match="draw_lines: 'sample' is not a number that varies; there are "):
        drawn(answer, ("tip_angle",))
    with pytest.raises(InputError, match="draw_map: base_tension_1 is a path"):
        draw_map(answer, "tip_angle", "base_tension_1", "friction_coefficient")
