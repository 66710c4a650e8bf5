"""What the explorer remembers of the sliders, and what is said of each case."""

import numpy as np
import pytest
from bodies import paper_body
from moves import FIRST, FORCE, FORGET, MODULUS, SECOND, moves_of

from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import NUM_MOVES, why_no_loop
from cddf_jax.measurements.table import Measurements


@pytest.fixture(scope="module")
def one():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def pair():
    return Exploration(paper_body("exact", num_tendons=2))


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
