"""What the explorer remembers of the base tension, against hysteresis.md section 2 and the play operator in NumPy."""

import numpy as np
import pytest
from bodies import paper_body

from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import NUM_LEGS, densely, gone_on, loop, remembered, why_no_loop
from cddf_jax.explorer.plots import BodyPlot, TensionPlots
from cddf_jax.explorer.words import loop_html
from cddf_jax.measurements.table import Measurements

G = np.linspace(0.0, 9e-3, 50)  # the widths of the plays along the paper's body, 1/N


def after(path):
    """Where 1/T is between its limits, at every place, after a path from rest."""
    y = np.full(G.size, np.inf)
    for tension in path:
        y = np.clip(y, 1 / tension - G, 1 / tension + G)
    return y


def moved(*path):
    turns = ()
    for tension in path:
        turns = gone_on(turns, tension)
    return turns


@pytest.fixture(scope="module")
def explored():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def case(explored):
    return explored.case(explored.start)


@pytest.fixture(scope="module")
def found(case, explored):
    return loop(case, moved(75.0, 60.0, 40.0), explored.arc_length)


def test_only_the_turns_are_kept():
    assert moved(0.0, 30.0, 30.0, 75.0) == (75.0,)
    assert moved(75.0, 60.0, 40.0, 50.0, 60.0) == (75.0, 40.0, 60.0)
    assert moved(75.0, 0.0, 40.0) == (75.0, 0.0, 40.0)


def test_closed_loops_may_be_left_out():
    """The plays are where the whole path has left them, also on long paths."""
    assert remembered((75.0, 40.0, 60.0, 50.0, 80.0)) == (80.0,)
    assert remembered((75.0, 40.0, 60.0, 30.0)) == (75.0, 30.0)
    rng = np.random.default_rng(8)
    for _ in range(50):
        path = rng.uniform(1.0, 90.0, 40)
        turns = moved(*path)
        np.testing.assert_allclose(after(turns), after(path), rtol=1e-14)
        np.testing.assert_allclose(after(remembered(turns)), after(path), rtol=1e-14)


def test_the_path_has_one_length_and_meets_all_turns():
    for turns in ((75.0,), (75.0, 40.0, 60.0)):
        path = densely(turns)
        assert path.shape == densely(tuple(range(1, NUM_LEGS + 1))).shape
        assert path[-1] == turns[-1]
        assert set(turns) <= set(path.tolist())


def test_the_loop_is_that_of_the_table(found):
    """40 N on the way back from 75 N: tip tension, angle and front to the digits of the table."""
    assert found.message == ""
    assert found.base_tension[0] == 75.0
    assert found.tip_tension[-1] == pytest.approx(45.122927, abs=6e-7)
    assert np.degrees(found.tip_angle[-1]) == pytest.approx(56.053731, abs=6e-7)
    assert 1e3 * found.front == pytest.approx(115.089, abs=6e-4)
    text = loop_html(found)
    assert [f">{number}<" in text for number in ("45.1229", "56.054", "115.09")] == [True] * 3


def test_the_loop_is_drawn_and_taken_away(found, explored):
    tension, body = TensionPlots(1), BodyPlot(explored.manipulator, explored.arc_length)
    figures = (*tension.figures.values(), body.figure)
    for plot in (tension, body):
        plot.show_loop(found)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [True] * 3
    np.testing.assert_allclose(tension.loops["tension"].data["value"], found.tip_tension)
    np.testing.assert_allclose(tension.points["angle"]["past"].data["value"], [56.053731], atol=6e-7)
    # the heading of the last piece of the axis is the tip angle, up to half a step of the grid
    (x, y) = (np.diff(body.sources["past"].data[name])[-1] for name in "xy")
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(56.05, abs=0.5)
    for plot in (tension, body):
        plot.show_loop(None)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [False] * 3


def test_rows_of_a_measured_loop_know_their_past():
    """Tip tensions on the way back to the digits of the table."""
    base, tip = [75.0, 60.0, 40.0, 20.0], [45.122927, 45.122927, 45.122927, 24.288558]
    table = Measurements.from_columns("loop", base_tension=base, tip_tension=tip, step=[1, 2, 3, 4])
    body = paper_body("exact")
    ((rows, model),) = Exploration(body, (table,)).in_rows(body)
    assert rows is table
    np.testing.assert_allclose(model["tip_tension"], tip, atol=6e-7)


def test_where_there_is_no_loop_the_reason_is_said(case, explored):
    pair = Exploration(paper_body("exact", num_tendons=2))
    loaded = explored.case(explored.start._replace(numbers={**explored.start.numbers, "tip_moment": 0.1}))
    zigzag = moved(*(50 + side * (20 - 0.5 * i) for i in range(NUM_LEGS) for side in (1, -1)))
    assert why_no_loop(case, (75.0,)) == "Drag the base tension back, and the loop appears here."
    assert why_no_loop(case, (75.0, 40.0)) == ""
    for other in (pair.case(pair.start), loaded):
        assert "for one tendon without loads" in why_no_loop(other, (75.0, 40.0))
    assert why_no_loop(case, zigzag) == f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."
