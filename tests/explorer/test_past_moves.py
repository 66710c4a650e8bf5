"""What the explorer remembers of the sliders, against the play operator in NumPy and what is said of each case."""

import numpy as np
import pytest
from bodies import paper_body
from moves import FIRST, FORCE, FORGET, MODULUS, SECOND, turns_of

from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import NUM_LEGS, gone_on, remembered, why_no_loop
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
def one():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def pair():
    return Exploration(paper_body("exact", num_tendons=2))


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


def test_another_body_keeps_the_turns(one):
    assert turns_of(one, {FIRST: 40.0}, {MODULUS: 1.5}) == (75.0, 40.0)
    assert turns_of(one, {FIRST: 40.0}, FORGET, {FIRST: 30.0}) == (40.0, 30.0)


def test_a_load_forgets_the_past_and_it_begins_without_loads(one):
    assert turns_of(one, {FIRST: 40.0}, {FORCE: -0.1}) == ()
    assert turns_of(one, {FIRST: 40.0}, {FORCE: -0.1}, {FORCE: 0.0}, {FIRST: 30.0}) == (40.0, 30.0)


def test_where_there_is_no_loop_the_reason_is_said(one, pair):
    said = why_no_loop(one.manipulator, turns_of(one))
    assert said == "Drag the base tension back, and the loop appears here."
    assert why_no_loop(one.manipulator, turns_of(one, {FIRST: 40.0})) == ""
    said = why_no_loop(one.manipulator, turns_of(one, {FORCE: -0.1}))
    assert said.startswith("The past is remembered without loads only.")
    said = why_no_loop(pair.manipulator, turns_of(pair, {SECOND: 20.0}, {FIRST: 30.0}))
    assert said == "The past is remembered for one tendon. For several, follow a path with cddf trace."
    zigzag = [{FIRST: 50 + side * (20 - 0.5 * i)} for i in range(NUM_LEGS) for side in (1, -1)]
    said = why_no_loop(one.manipulator, turns_of(one, *zigzag))
    assert said == f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."


@pytest.mark.slow
def test_rows_of_a_measured_loop_know_their_past():
    """docs/hysteresis.md: tip tensions on the way back to the digits of the table."""
    base, tip = [75.0, 60.0, 40.0, 20.0], [45.122927, 45.122927, 45.122927, 24.288558]
    table = Measurements.from_columns("loop", base_tension=base, tip_tension=tip, step=[1, 2, 3, 4])
    body = paper_body("exact")
    ((rows, model),) = Exploration(body, (table,)).in_rows(body)
    assert rows is table
    np.testing.assert_allclose(model["tip_tension"], tip, atol=6e-7)
