"""What the explorer remembers of the sliders, and the loops that it draws, against docs/hysteresis.md and `trace`."""

import re

import jax
import numpy as np
import pytest
from bodies import paper_body

import cddf_jax as cddf
from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import NUM_MOVES, after_move, loop_of, why_no_loop
from cddf_jax.explorer.plots import BodyPlot, TensionPlots
from cddf_jax.explorer.words import loop_html
from cddf_jax.measurements.table import Measurements

FIRST, SECOND, FORCE, MODULUS = "base_tension_1", "base_tension_2", "tip_force.1", "youngs_modulus"
FORGET = "the button"
COMPILED = []  # what was traced or compiled in this process
jax.monitoring.register_event_duration_secs_listener(
    lambda event, duration_secs, **_: (
        COMPILED.append(event) if re.search("backend_compile|jaxpr_trace", event) else None
    )
)


@pytest.fixture(scope="module")
def one():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def pair():
    return Exploration(paper_body("exact", num_tendons=2))


def moves_of(explored, *moves):
    """After the first picture, and moves that are numbers by name or the button that forgets."""
    found, settings = (), explored.start
    for move in ({}, *moves):
        numbers = {} if move == FORGET else move
        settings = settings._replace(numbers={**settings.numbers, **numbers})
        found = after_move(() if move == FORGET else found, explored, settings)
    return found


def loop_after(explored, *moves, tendon=0):
    """The path of a tendon, with the manipulator as it is set then."""
    numbers = {name: number for move in moves for name, number in move.items()}
    body = explored.case(explored.start._replace(numbers={**explored.start.numbers, **numbers})).manipulator
    return body, loop_of(body, moves_of(explored, *moves), tendon, explored.arc_length)


def pulls(moves):
    """The tension of the first tendon after each move, N."""
    return [move[0] for move in moves]


def test_a_move_that_goes_on_is_one_with_the_last(one, pair):
    assert pulls(moves_of(one, {FIRST: 78.0}, {FIRST: 78.0}, {FIRST: 80.0})) == [80.0]
    assert pulls(moves_of(one, {FIRST: 60.0}, {FIRST: 40.0}, {FIRST: 50.0}, {FIRST: 60.0})) == [75.0, 40.0, 60.0]
    found = moves_of(pair, {SECOND: 10.0}, {SECOND: 20.0}, {FIRST: 30.0}, {SECOND: 30.0})
    assert [move[:2] for move in found] == [(75.0, 0.0), (75.0, 20.0), (30.0, 20.0), (30.0, 30.0)]


def test_loads_move_as_tensions_do(one):
    found = moves_of(one, {FIRST: 40.0}, {FORCE: -0.1}, {FORCE: 0.0})
    assert [(move[0], move[2]) for move in found] == [(75.0, 0.0), (40.0, 0.0), (40.0, -0.1), (40.0, 0.0)]


def test_another_body_keeps_the_moves(one):
    assert pulls(moves_of(one, {FIRST: 40.0}, {MODULUS: 1.5})) == [75.0, 40.0]
    assert pulls(moves_of(one, {FIRST: 40.0}, FORGET, {FIRST: 30.0})) == [40.0, 30.0]


def test_where_there_is_no_loop_the_reason_is_said(one):
    assert why_no_loop(moves_of(one)).startswith("Drag the base tension back")
    assert why_no_loop(moves_of(one, {FIRST: 40.0})) == ""
    zigzag = [{FIRST: 50 + side * (20 - 0.5 * i)} for i in range(NUM_MOVES) for side in (1, -1)]
    said = why_no_loop(moves_of(one, *zigzag))
    assert said == f"More than {NUM_MOVES} moves are remembered at once; forget the past to go on."


@pytest.mark.slow
def test_rows_of_a_measured_loop_know_their_past():
    """docs/hysteresis.md: tip tensions on the way back to the digits of the table."""
    base, tip = [75.0, 60.0, 40.0, 20.0], [45.122927, 45.122927, 45.122927, 24.288558]
    table = Measurements.from_columns("loop", base_tension=base, tip_tension=tip, step=[1, 2, 3, 4])
    body = paper_body("exact")
    ((rows, model),) = Exploration(body, (table,)).in_rows(body)
    assert rows is table
    np.testing.assert_allclose(model["tip_tension"], tip, atol=6e-7)


# --- loops ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def found(one):
    return loop_after(one, {FIRST: 60.0}, {FIRST: 40.0})[1]


def test_the_loop_is_that_of_the_table(found):
    """docs/hysteresis.md, 40 N on the way back from 75 N: tip tension, angle and front to its digits."""
    assert found.status == cddf.Status.successful
    assert found.base_tension[0] == 75.0
    assert found.tip_tension[-1] == pytest.approx(45.122927, abs=6e-7)
    assert np.degrees(found.tip_angle[-1]) == pytest.approx(56.053731, abs=6e-7)
    assert 1e3 * found.front == pytest.approx(115.089, abs=6e-4)
    text = loop_html(found)
    assert [f">{number}<" in text for number in ("45.1229", "56.054", "115.09")] == [True] * 3


def test_the_path_is_that_of_a_trace(one):
    """Of which `trace` is given every point; then with another body, without compiling again."""
    moves = ({FIRST: 40.0}, {FIRST: 60.0}, {FIRST: 50.0})
    loop_after(one, *moves)
    jax.jit(lambda x: x + len(COMPILED))(1.0)
    assert COMPILED  # the listener listens
    for more in ((), ({MODULUS: 1.6},), ({FIRST: 55.0},)):
        COMPILED.clear()
        body, found = loop_after(one, *moves, *more)
        assert COMPILED == []
        if FIRST in (more[0] if more else ()):
            continue  # a path of another length, for which `trace` would be compiled again
        whole = cddf.trace(body, found.base_tension)
        np.testing.assert_allclose(found.tip_tension, whole.tip_tension, rtol=1e-9)
        np.testing.assert_allclose(found.tip_angle, whole.tip_angle, rtol=1e-9)
        np.testing.assert_allclose(found.position[-1], whole.tip_position[-1], rtol=1e-9)


@pytest.mark.slow
def test_several_tendons_and_loads_have_a_past(pair):
    """Within the error of elements and increments. After the second step the tendons hold each other."""
    rel, moves = 5e-3, ({SECOND: 20.0}, {FIRST: 30.0}, {FORCE: -0.5})
    body, found = loop_after(pair, *moves, tendon=1)
    force = [(0.0, 0.0)] * 3 + [(0.0, -0.5)]
    pulls = [[75.0, 0.0], [75.0, 20.0], [30.0, 20.0], [30.0, 20.0]]
    whole = cddf.trace(body, pulls, cddf.Loads(tip_force=force), short_steps=64, estimate_error=False)
    np.testing.assert_allclose(found.base_tension[[0, 8, 16, 24]], [0.0, 20.0, 20.0, 20.0])
    np.testing.assert_allclose(found.tip_tension[[16, 24]], whole.tip_tension[2:, 1], rtol=rel)
    np.testing.assert_allclose(found.tip_angle[[0, 8, 16, 24]], whole.tip_angle, rtol=rel)
    np.testing.assert_allclose(found.position[-1], whole.tip_position[-1], atol=rel * 0.140)
    assert "past_tip_tension_2" in loop_html(found, 1)


def test_the_loop_is_drawn_and_taken_away(found, one):
    tension, body = TensionPlots(1), BodyPlot(one.manipulator, one.arc_length)
    figures = (*tension.figures.values(), body.figure)
    for plot in (tension, body):
        plot.show_loop(found)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [True] * 3
    np.testing.assert_allclose(tension.points["tension"]["loop"].data["value"], found.tip_tension)
    np.testing.assert_allclose(tension.points["angle"]["past"].data["value"], [56.053731], atol=6e-7)
    # the heading of the last piece of the axis is the tip angle, up to half a step of the grid
    (x, y) = (np.diff(body.sources["past"].data[name])[-1] for name in "xy")
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(56.05, abs=0.5)
    for plot in (tension, body):
        plot.show_loop(None)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [False] * 3


def test_a_loop_that_cannot_be_relied_on_says_so(found):
    doubtful = loop_html(found._replace(status=np.asarray(cddf.Status.inaccurate)))
    assert doubtful.startswith("<p>The path is rough")
    assert "past_tip_angle" in doubtful
    lost = found._replace(status=np.asarray(cddf.Status.crossing))
    assert not lost.shown
    assert loop_html(lost).startswith("<p>There is no answer with this past: ")
