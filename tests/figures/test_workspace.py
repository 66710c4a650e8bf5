"""The cloud of tips, read back from what is drawn; the numbers are made up."""

import numpy as np
import pytest
import xarray
from read_back import legend_of

import cddf_jax as cddf
from cddf_jax import figures
from cddf_jax.errors import InputError
from cddf_jax.figures import workspace

CROSSING, LOCKED = cddf.Status.crossing, cddf.Status.locked
PULLS = np.array([0.0, 10.0, 30.0])


def answer(components=3, **changes):
    """Tips at (100 - T1 - T2, T1, T2) mm of two tendons whose tip tensions are half of those at the base."""
    first, second = np.meshgrid(PULLS, PULLS, indexing="ij")
    tips = 1e-3 * np.stack([100.0 - first - second, first, second], -1)[..., :components]
    dims = ("base_tension_1", "base_tension_2")
    data = {
        "tip_position": ((*dims, "component"), tips, {"units": "m"}),
        "tip_angle": (dims, np.radians(first), {"units": "rad"}),
        "tip_tension": ((*dims, "tendon"), 0.5 * np.stack([first, second], -1), {"units": "N"}),
        "result": (dims, np.zeros((3, 3), np.int8)),
    }
    coords = {name: (name, PULLS, {"units": "N"}) for name in dims} | {"tendon": [0, 1]}
    return xarray.Dataset(data | changes, coords)


def drawn(axes):
    """Dots that have a colour by value: their places, mm, and values."""
    (dots,) = [x for x in axes.collections if x.get_array() is not None]
    points = (
        np.stack([np.asarray(x) for x in dots._offsets3d], -1) if hasattr(dots, "_offsets3d") else dots.get_offsets()
    )
    return np.asarray(points), np.asarray(dots.get_array())


def test_tips_in_millimetres_and_the_sum_of_tensions():
    scene = figures.draw_workspace(answer())
    tips, values = drawn(scene)
    assert len(tips) == 9
    np.testing.assert_allclose(values, tips[:, 1] + tips[:, 2])
    np.testing.assert_allclose(tips.sum(axis=1), 100.0)
    assert [axes.get_ylabel() for axes in scene.figure.axes[1:]] == ["Total tension (N)"]
    assert not scene.figure.legends


def test_the_nearest_lies_on_top():
    tips, _ = drawn(figures.draw_workspace(answer()))
    towards = tips @ [np.cos(np.radians(-58)) * np.cos(np.radians(24)), -0.77473, np.sin(np.radians(24))]
    assert np.all(np.diff(towards) > -1e-3)


def test_without_all_base_tensions_the_first_number_colours_the_dots():
    scene = figures.draw_workspace(answer().isel(base_tension_2=0, drop=True))
    assert scene.figure.axes[1].get_ylabel() == "Base tension 1 (N)"


def test_another_number_colours_the_dots():
    tips, values = drawn(figures.draw_workspace(answer(), "tip_angle"))
    np.testing.assert_allclose(values, tips[:, 1])  # deg


def test_what_is_doubtful_and_what_failed():
    data = answer()
    data["result"][2, 2] = CROSSING
    data["result"][0, 0] = LOCKED
    data["tip_position"][0, 0] = np.nan
    scene = figures.draw_workspace(data)
    assert len(drawn(scene)[0]) == 7
    told = legend_of(scene)
    assert told == ["hollow: doubtful, crossing", "no number: 1 of 9, locked"]


def test_a_plane_and_an_array_of_ones_own():
    data = answer(2)
    share = (data.tip_tension.sum("tendon") / 40.0).assign_attrs(units="1")
    axes = figures.draw_workspace(data.assign(share=share), "share")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("$X$ (mm)", "$Y$ (mm)")
    assert axes.figure.axes[1].get_ylabel() == "Share"
    assert drawn(axes)[1].max() == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("data", "by", "message"),
    [
        (answer().drop_vars("tip_position"), "tip_angle", "there is no tip_position; ask the sweep for it"),
        (answer(), "tip_tension", "tip_tension has more than one number for each solve; choose one tendon"),
        (answer(), "twist", "'twist' is neither an output nor a number that varies; there are tip_position"),
        (answer().assign(tip_position=answer().tip_position * np.nan), "tip_angle", "no solve gave a tip"),
    ],
)
def test_what_is_refused(data, by, message):
    with pytest.raises(InputError, match=f"^workspace: {message}"):
        figures.draw_workspace(data, by)


def test_of_many_solves_some_are_drawn(monkeypatch):
    monkeypatch.setattr(workspace, "MOST", 4)
    assert len(drawn(figures.draw_workspace(answer()))[0]) == 4
