"""Figures of a body in space, read back from what is drawn: an arc of a circle whose places have closed forms."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from kinds import of_kind
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection
from read_back import legend_of, y_of

import cddf_jax as cddf
from cddf_jax import figures
from cddf_jax.errors import InputError
from cddf_jax.figures import space, style
from cddf_jax.figures.geometry import drawn, stations
from cddf_jax.figures.looks import BLACK

LENGTH, RADIUS, OFFSET, BEND = 0.2, 0.01, 0.006, 2.0
LOADS = cddf.Loads(tip_force=(0.0, 0.3, 0.4), tip_moment=(0.02, 0.0, 0.0), gravity=(0.0, 0.0, -9.81))
TENDONS = cddf.Tendon(OFFSET, angle=np.pi / 2), cddf.Tendon(OFFSET, angle=-np.pi / 2, end=0.15)
ROBOT = cddf.Manipulator(LENGTH, RADIUS, 0.0, TENDONS, youngs_modulus=1e6, friction_coefficient=0.1)


def arc(s):
    """An arc in the plane of X and Z: tendon 1 on its inner side, tendon 2 on its outer side, their tensions linear."""
    sine, cosine, none = jnp.sin(BEND * s), jnp.cos(BEND * s), 0.0 * s
    axis, normal = jnp.stack([cosine, none, sine], -1), jnp.stack([-sine, none, cosine], -1)
    position = jnp.stack([sine, none, 1.0 - cosine], -1) / BEND
    tension = jnp.stack([20.0 - 50.0 * s, 8.0 + 10.0 * s])
    return cddf.SpatialFields(
        arc_length=s,
        curvature=jnp.stack([none, none - BEND, none], -1),  # about y: from z to x
        frame=jnp.stack([axis, jnp.broadcast_to(jnp.eye(3)[1], axis.shape), normal], -1),
        position=position,
        tension=tension,
        wrap_angle=jnp.stack([BEND * s] * 2),
        normal_force=BEND * tension[..., None] * normal,
        friction_force=-0.1 * BEND * tension[..., None] * axis,
        path=jnp.stack([position + side * OFFSET * normal for side in (1, -1)]),
    )


@pytest.fixture
def equilibrium(monkeypatch):
    """What the figures ask of one, without solving."""
    for module in ("geometry", "along"):
        monkeypatch.setattr(f"cddf_jax.figures.{module}.fields_along", lambda _, s: arc(s))
    return SimpleNamespace(tip_frame=np.eye(3))


@pytest.fixture(scope="module")
def what():
    return drawn(ROBOT, arc(stations(ROBOT)), LOADS)


def test_axes_in_space_are_to_scale_and_in_millimetres(equilibrium):
    scene = of_kind(Axes3D, figures.draw_shape(ROBOT, equilibrium, LOADS))
    assert [scene.get_xlabel(), scene.get_ylabel(), scene.get_zlabel()] == ["$X$ (mm)", "$Y$ (mm)", "$Z$ (mm)"]
    sizes = np.ptp([scene.get_xlim(), scene.get_ylim(), scene.get_zlim()], axis=1)
    np.testing.assert_allclose(scene._box_aspect / sizes, scene._box_aspect[0] / sizes[0])
    labels = [axes.get_ylabel() for axes in scene.figure.axes[1:]]
    assert labels == ["$T$ (N)"]
    told = legend_of(scene)
    assert told == ["$g$ = (0, 0, \N{MINUS SIGN}9.81) m/s$^2$", "$F$ = 0.5 N", "$m$ = 0.02 N m"]


def test_shadows_lie_on_the_walls(equilibrium, what):
    scene = of_kind(Axes3D, figures.draw_shape(ROBOT, equilibrium))
    walls = scene.get_xlim()[0], scene.get_ylim()[1], scene.get_zlim()[0]
    polygons = space.shadows(scene, what.body)
    on = [[np.all(polygon[:, i] == walls[i]) for i in range(3)] for polygon in polygons]
    np.testing.assert_array_equal(np.sum(on, axis=0), len(what.body.rings) - 1)
    # no part of the body touches a wall
    for across, sign in zip(range(3), (1, -1, 1), strict=True):
        assert np.min(sign * (what.body.rings[..., across] - walls[across])) > 0


def area(polygon):
    x, y = polygon.T
    return 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))


def test_silhouettes(what):
    """From the side a band as wide as the body, from above the band and half a disc at the tip, from the front too."""
    side = sum(map(area, space.silhouette(what.body, (0, 2))))
    assert side == pytest.approx(1e6 * 2 * RADIUS * LENGTH, rel=2e-3)  # exact for an arc (Pappus)
    corners = np.concatenate(space.silhouette(what.body, (0, 1)))
    tip = BEND * LENGTH
    np.testing.assert_allclose(corners[:, 0].max(), 1e3 * (np.sin(tip) / BEND + RADIUS * np.sin(tip)), rtol=1e-6)
    np.testing.assert_allclose(np.abs(corners[:, 1]).max(), 1e3 * RADIUS, rtol=1e-3)


def is_dashed(line):
    return line.get_linestyle() == "--" and line.get_color() == BLACK


def test_tendons_are_where_they_are_and_end_at_their_anchors(equilibrium, what):
    scene = figures.draw_shape(ROBOT, equilibrium)
    (near,) = [x for x in scene.collections if isinstance(x, Line3DCollection) and x.get_array() is not None]
    pieces = np.asarray(near._segments3d)
    # seen from above and in front: the inner tendon, which runs above the midline, hides nothing and is not hidden
    np.testing.assert_allclose(pieces[0, 0], [0.0, 0.0, 1e3 * OFFSET], atol=1e-9)
    assert np.asarray(near.get_array())[0] == pytest.approx(20.0, rel=0.01)
    radius = np.linalg.norm(pieces[:, 0] - [0.0, 0.0, 1e3 / BEND], axis=-1)
    np.testing.assert_allclose(radius, 1e3 * (1 / BEND - OFFSET), rtol=1e-9)
    dashed = [np.stack(of_kind(Line3D, line).get_data_3d(), axis=-1) for line in scene.lines if is_dashed(line)]
    (hidden,) = [line[np.isfinite(line[:, 0])] for line in dashed if np.isfinite(line).any()]
    length = np.linalg.norm(np.diff(hidden, axis=0), axis=-1).sum()
    assert length == pytest.approx(1e3 * 0.15 * (1 + BEND * OFFSET), rel=1e-4)
    assert np.all(np.isnan(what.tendons[1, what.straight.midline[:, 0] > 150.1]))


def test_fields_along_a_body_in_space(equilibrium):
    figure = figures.equilibrium_figure(ROBOT, equilibrium, LOADS)
    curvature = next(axes for axes in figure.axes if "Curvature" in axes.get_ylabel())
    told = {line.get_label(): y_of(line) for line in curvature.lines}
    assert list(told) == ["twist, $x$", "bending, $y$", "bending, $z$"]
    np.testing.assert_allclose(told["bending, $y$"], -BEND)
    force = figures.draw_along(ROBOT, equilibrium, "normal_force")
    np.testing.assert_allclose(y_of(force.lines[0])[[0, -1]], [BEND * 20.0, BEND * 10.0])
    heading = y_of(figures.draw_along(ROBOT, equilibrium, "heading").lines[0])
    assert heading[-1] == pytest.approx(np.degrees(BEND * LENGTH))
    strain = y_of(figures.draw_along(ROBOT, equilibrium, "strain").lines[0])
    np.testing.assert_allclose(strain, 100 * RADIUS * BEND)


def test_what_is_refused(equilibrium):
    flat = figures.new_figure(3.0, 3.0).subplots()
    with pytest.raises(InputError, match='the body is in space; give axes with projection="3d", or none'):
        figures.draw_shape(ROBOT, equilibrium, axes=flat)
    soft = cddf.Manipulator(LENGTH, RADIUS, 0.0, TENDONS, youngs_modulus=1e6, friction_coefficient=0.1, extensible=True)
    with pytest.raises(InputError, match="the strain along an axis that stretches is not known"):
        figures.draw_along(soft, equilibrium, "strain")


def test_tensions_that_hardly_differ_have_a_scale_from_zero():
    scale = style.tension_scale(np.array([5.0, 5.0]))
    assert isinstance(scale, Normalize)
    assert (scale.vmin, scale.vmax) == (0.0, 5.0)
