"""The figures of a history, read back from what is drawn; the numbers are those of a play in 1/T, in closed form."""

import jax
import numpy as np
import pytest
from bodies import paper_body
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from read_back import legend_of, x_of, xy_of, y_of

import cddf_jax as cddf
from cddf_jax import figures

BODY = paper_body("exact")
PATH = np.array([0.0, 75.0, 60.0, 40.0, 60.0, 75.0])
# a release from 75 N: tip angle, deg, and front, mm, at 60 and 40 N, and what is lost so far, mJ, at 75, 60 and 40 N
ANGLES, FRONTS, LOSSES = (69.313929, 67.619267, 56.053731), (51.564, 115.089), (59.726, 60.423, 70.931)


@pytest.fixture(scope="module")
def history():
    return cddf.trace(BODY, PATH)


def numbers_of(axes):
    return [text.get_text() for text in axes.texts if text.get_text()]


def test_a_loop(history):
    axes = figures.draw_loop(history, "tip_angle", Figure().subplots())
    pull, release, back = (line for line in axes.lines if len(x_of(line)) > 1)
    np.testing.assert_array_equal(x_of(pull), [0.0, 75.0])
    np.testing.assert_array_equal(x_of(release), [75.0, 60.0, 40.0])
    np.testing.assert_allclose(y_of(release), ANGLES, atol=6e-7)
    np.testing.assert_array_equal(x_of(back), [40.0, 60.0, 75.0])
    assert pull.get_linestyle() == back.get_linestyle() != release.get_linestyle()
    assert legend_of(axes) == ["pulled", "released"]
    assert numbers_of(axes) == ["1", "2, 4", "3"]  # the turns; it closes where it began to be released
    assert sum(isinstance(text, Annotation) and text.arrowprops is not None for text in axes.texts) == 3
    assert axes.get_ylabel() == "Tip angle (deg)"


def test_numbers_of_ones_own_and_many_steps(history):
    axes = figures.draw_loop(history, axes=Figure().subplots(), steps=[1, 3])
    assert numbers_of(axes) == ["1", "2"]
    many = [0, 1, 1, 1, 1, 1, 1, 2, 2, 3, 5, 5]  # the first two turns are 0 and 1 of the history
    axes = figures.draw_loop(history, axes=Figure().subplots(), steps=many)
    assert numbers_of(axes) == ["1", "2, 3, 4, 5, 6, 7, 11, 12", "10"]


def test_lines_along_the_body_and_their_fronts(history):
    """Tensions at the tip by the table of the loop; at the base they are those that were given."""
    axes = figures.draw_along(BODY, history, "tension", Figure().subplots(), steps=[0, 1, 2, 3, 5])
    assert legend_of(axes) == ["3: 60 N", "4: 40 N", "2, 5: 75 N", "front"]
    lines = [line for line in axes.lines if len(x_of(line)) > 1]
    ends = [(y_of(line)[0], y_of(line)[-1]) for line in lines]
    np.testing.assert_allclose(ends, [(60.0, 45.122927), (40.0, 45.122927), (75.0, 45.122927)], atol=6e-7)
    dots = [x_of(line)[0] for line in axes.lines if len(x_of(line)) == 1]
    np.testing.assert_allclose(dots, FRONTS, atol=6e-4)
    top = lines[2]
    on_it = [np.interp(x, *xy_of(top)) for x in dots]  # beyond its front it has the tension of the pull
    heights = [y_of(line)[0] for line in axes.lines if len(x_of(line)) == 1]
    np.testing.assert_allclose(heights, on_it, rtol=2e-3)  # the kink lies between two points of the lines


def test_where_the_work_goes(history):
    axes = figures.draw_energy(history, Figure().subplots(), steps=range(6))
    stored, work = (line for line in axes.lines if len(x_of(line)) == 6)
    np.testing.assert_array_equal(x_of(work), [1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose((y_of(work) - y_of(stored))[1:4], LOSSES, atol=6e-4)
    assert y_of(work)[1] == pytest.approx(415.405749, abs=6e-7)
    assert legend_of(axes) == ["stored in the body", "lost to friction", "work put in"]
    assert [label.get_text() for label in axes.get_xticklabels()][:3] == ["1\n0", "2\n75", "3\n60"]
    assert sum(isinstance(area, PolyCollection) for area in axes.collections) == 2


def test_what_cannot_be_drawn(history):
    with pytest.raises(cddf.InputError, match=r"^draw_loop: quantity must be one of tip_tension, tip_angle, tend"):
        figures.draw_loop(history, "strain")


def test_a_step_that_failed_is_not_drawn(history):
    failed = jax.tree.map(lambda x: x * np.nan if np.issubdtype(x.dtype, np.inexact) else x, history)
    for draw in (figures.draw_loop, figures.draw_energy, lambda it: figures.draw_along(BODY, it, "tension")):
        with pytest.raises(cddf.InputError, match="a step of the trace failed"):
            draw(failed)
