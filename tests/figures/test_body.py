"""The figure of one equilibrium, read back from what is drawn: to scale, every tendon, every load."""

from dataclasses import replace
from typing import Any

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from read_back import legend_of, x_of, xy_of

import cddf_jax as cddf
from cddf_jax.figures import style as plotting
from cddf_jax.figures.along import draw_along
from cddf_jax.figures.body import equilibrium_figure
from cddf_jax.figures.looks import CURVES, PALE, PURPLE, VERMILION

LENGTH, END = 0.36, 0.305
LOADS = cddf.Loads(tip_force=(-0.02, 0.05), tip_moment=-0.004, gravity=(9.81, 0.0))
RADIUS = np.array([0.01541, 0.00642, 0.0048])
# as the body of fitting/soft_tentacle.toml, solid and with a passive tip link; its tendons run in parallel here
LINK = cddf.Manipulator(
    length=LENGTH,
    outer_radius=cddf.Piecewise.linear([0.0, END, LENGTH], RADIUS),
    inner_radius=0.0,
    tendons=[cddf.Tendon(0.005, side, end=END) for side in (+1, -1)],
    youngs_modulus=315e3,
    friction_coefficient=0.1,
    density=1318.0,
)


@pytest.fixture(scope="module")
def equilibrium():
    """Without the loads, which are only drawn: a solve under loads compiles for long."""
    return cddf.solve(LINK, [4.0, 1.0], direction=[+1, -1])


@pytest.fixture(scope="module")
def figure(equilibrium):
    return equilibrium_figure(LINK, equilibrium, LOADS)


def shape_of(figure):
    return figure.axes[0]


def tension_of(figure):
    return figure.axes[1]


def wall_of(figure):
    """The one polygon of a solid body."""
    grey = pytest.approx(matplotlib.colors.to_rgb(PALE))
    (wall,) = [patch for patch in shape_of(figure).patches if patch.get_facecolor()[:3] == grey]
    return wall


def arrows(figure):
    """The line of each arrow without its head, mm, by the letter of its load: they are drawn in this order."""
    every = [line for line in shape_of(figure).lines if line.get_color() in (VERMILION, PURPLE)]
    lines = [line for line in every if x_of(line).size]  # those of the legend are empty
    return dict(zip("Fm", (xy_of(line).T for line in lines), strict=True))


def test_axes_are_to_scale_and_in_millimetres(figure):
    shape = shape_of(figure)
    assert shape.get_aspect() == 1
    assert (shape.get_xlabel(), shape.get_ylabel()) == ("$X$ (mm)", "$Y$ (mm)")
    assert figure.axes[2].get_ylabel() == "$T$ (N)"  # the colour bar


def test_the_outer_wall_is_where_it_is(figure, equilibrium):
    there = equilibrium.at(np.array([0.0, END, LENGTH]))
    normal = np.stack([-np.sin(there.heading), np.cos(there.heading)], axis=-1)
    wall = wall_of(figure)
    for side in (+1, -1):
        for corner in 1e3 * (np.asarray(there.position) + side * RADIUS[:, None] * normal):
            assert np.min(np.linalg.norm(wall.get_xy() - corner, axis=-1)) < 1e-9


def test_tendons_are_coloured_by_tension_and_end_at_their_anchors(figure, equilibrium):
    lines = [item for item in shape_of(figure).collections if isinstance(item, LineCollection)]
    assert len(lines) == 2
    anchor = equilibrium.at(np.array([END]))
    normal = np.array([-np.sin(anchor.heading[0]), np.cos(anchor.heading[0])])
    for line, side, base, tip in zip(lines, (+1, -1), (4.0, 1.0), np.asarray(equilibrium.tip_tension), strict=True):
        pieces, values = line.get_segments(), np.asarray(line.get_array())
        np.testing.assert_allclose(pieces[0][0], [0.0, side * 5.0], atol=1e-9)
        np.testing.assert_allclose(pieces[-1][-1], 1e3 * (anchor.position[0] + side * 0.005 * normal), atol=1e-9)
        steps = np.linalg.norm([piece[1] - piece[0] for piece in pieces], axis=-1)
        # a line at a constant offset d to the left of the axis is shorter by d times the angle that this turns
        assert steps.sum() == pytest.approx(1e3 * END - side * 5.0 * float(anchor.heading[0]), rel=1e-4)
        # the first and last piece are 2 mm long, along which the tension changes by less than 1 %
        np.testing.assert_allclose([values[0], values[-1]], [base, tip], rtol=0.01)
    limits = [line.norm for line in lines]
    assert limits[0] is limits[1]  # one colour bar for all
    assert (limits[0].vmin, limits[0].vmax) == (pytest.approx(1.0, rel=1e-6), pytest.approx(4.0))


def test_the_higher_the_tension_the_darker():
    """CIE lightness of the colours falls evenly, so that a grey print can be read."""
    rgb = plotting.TENSION_COLOURS(np.linspace(0, 1, 64))[:, :3]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)  # sRGB, IEC 61966-2-1
    lightness = 116 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16
    steps = -np.diff(lightness)
    assert np.all(steps > 0.5 * np.mean(steps))
    assert lightness[0] - lightness[-1] > 60


def test_arrows_point_as_the_loads_do(figure, equilibrium):
    drawn, tip = arrows(figure), 1e3 * np.asarray(equilibrium.tip_position)
    line = drawn["F"][-1] - drawn["F"][0]
    np.testing.assert_allclose(
        line / np.linalg.norm(line), LOADS.tip_force / np.linalg.norm(LOADS.tip_force), atol=1e-6
    )
    assert min(np.linalg.norm(drawn["F"][end] - tip) for end in (0, -1)) < 1e-9  # at the tip
    (x0, y0), (x1, y1) = drawn["m"][0] - tip, drawn["m"][1] - tip
    assert np.sign(x0 * y1 - y0 * x1) == np.sign(LOADS.tip_moment)  # around the tip, from X to Y where positive
    np.testing.assert_allclose(np.linalg.norm(drawn["m"] - tip, axis=-1), np.hypot(x0, y0), rtol=1e-9)


def test_the_legend_states_the_loads_and_covers_nothing(figure):
    told = ["$g$ = (9.81, 0) m/s$^2$", "$F$ = 0.0539 N", "$m$ = 0.004 N m"]  # |F| = sqrt(0.02^2 + 0.05^2)
    assert legend_of(shape_of(figure)) == told
    figure.draw_without_rendering()
    axes = shape_of(figure)
    legend, frame = axes.get_legend().get_window_extent(), axes.get_window_extent()
    assert np.all(frame.min <= legend.min)
    assert np.all(legend.max <= frame.max)
    drawn = axes.transData.transform(np.concatenate([wall_of(figure).get_xy(), *arrows(figure).values()]))
    assert not any(legend.contains(*point) for point in drawn)


def test_the_tension_stops_at_the_anchor(figure, equilibrium):
    lines = tension_of(figure).get_lines()
    for line, tip in zip(lines, np.asarray(equilibrium.tip_tension), strict=True):
        s, values = xy_of(line)
        last = np.flatnonzero(np.isfinite(values))[-1]
        assert (s[last], values[last]) == (pytest.approx(1e3 * END), pytest.approx(tip, rel=1e-9))
    assert tension_of(figure).get_xlim()[1] >= 1e3 * LENGTH


def test_without_loads_there_are_no_arrows(equilibrium):
    figure = equilibrium_figure(LINK, equilibrium)
    assert not {VERMILION, PURPLE} & {line.get_color() for line in shape_of(figure).lines}
    assert shape_of(figure).get_legend() is None


def test_more_tendons_than_dash_patterns(equilibrium, monkeypatch):
    """Their lines are told apart without any colour; the tensions are made up."""
    count = 2 * len(CURVES) + 2
    body = replace(LINK, tendons=(cddf.Tendon(0.005, end=END),) * count)

    def made_up(_, s):
        fields = equilibrium.at(s)
        return replace(fields, tension=fields.tension[:1] * np.arange(1, count + 1)[:, None])

    monkeypatch.setattr("cddf_jax.figures.along.fields_along", made_up)
    lines: Any = draw_along(body, equilibrium, "tension").lines
    looks = {(line.get_linestyle(), line._dash_pattern[1] and tuple(line._dash_pattern[1]), line.get_marker())
             for line in lines}  # fmt: skip
    assert len(looks) == len(lines) == count
