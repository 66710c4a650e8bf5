"""What the explorer remembers of the sliders, against the play operator in NumPy and what is said of each case."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import paper_body
from moves import FIRST, FORCE, FORGET, MODULUS, SECOND, past_of
from places import DATA

import cddf_jax as cddf
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


def tensions_of(past):
    return [point.tension for point in past.points]


@pytest.fixture(scope="module")
def one():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def pair():
    return Exploration(paper_body("exact", num_tendons=2))


@pytest.fixture(scope="module")
def three():
    return Exploration(cddf.read_manipulator(DATA / "three_tendons_made_up.toml"))


@pytest.fixture(scope="module")
def turned():
    """The paper's body, whose tendon has an angle."""
    return Exploration(replace(paper_body("exact"), tendons=(cddf.Tendon(0.010, angle=0.5),)))


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


def test_every_move_is_a_step_of_the_path(pair):
    past = past_of(pair, {SECOND: 20.0}, {FIRST: 60.0}, {FORCE: -0.1}, {FORCE: -0.1})
    assert tensions_of(past) == [(75.0, 0.0), (75.0, 20.0), (60.0, 20.0), (60.0, 20.0)]
    assert [any(point.load) for point in past.points] == [False, False, False, True]
    assert past.tendon == 0  # the tension that moved last, a load apart
    assert past_of(pair, {FIRST: 60.0}, {SECOND: 20.0}).tendon == 1
    assert tensions_of(past_of(pair, {SECOND: 20.0}, {FIRST: 60.0}, FORGET)) == [(60.0, 20.0)]


def test_another_body_forgets_the_past_of_several_tendons(pair):
    past = past_of(pair, {SECOND: 20.0}, {FIRST: 60.0}, {MODULUS: 1.5})
    assert tensions_of(past) == [(60.0, 20.0)]
    said = why_no_loop(pair.manipulator, past)
    assert said.startswith("The body has changed: its past was forgotten. ")
    again = past_of(pair, {SECOND: 20.0}, {MODULUS: 1.5}, {FIRST: 60.0})
    assert not again.body_changed
    assert "has changed" not in why_no_loop(pair.manipulator, past_of(pair, {MODULUS: 1.5}))  # nothing was forgotten


def test_another_body_with_one_tendon_keeps_the_turns(one):
    past = past_of(one, {FIRST: 40.0}, {MODULUS: 1.5})
    assert past.turns == (75.0, 40.0)
    under_load = past_of(one, {FORCE: -0.1}, {FIRST: 40.0}, {MODULUS: 1.5})
    assert under_load.body_changed
    assert tensions_of(under_load) == [(40.0,)]


def test_where_there_is_no_loop_the_reason_is_said(one, pair):
    assert why_no_loop(one.manipulator, past_of(one)) == "Drag the base tension back, and the loop appears here."
    assert why_no_loop(one.manipulator, past_of(one, {FIRST: 40.0})) == ""
    assert why_no_loop(one.manipulator, past_of(one, {FORCE: -0.1})) == ""
    said = why_no_loop(pair.manipulator, past_of(pair))
    assert said.startswith("The past begins here: all tendons were pulled together from rest to what is set.")
    assert why_no_loop(pair.manipulator, past_of(pair, {SECOND: 20.0})) == ""
    zigzag = [{FIRST: 50 + side * (20 - 0.5 * i)} for i in range(NUM_LEGS) for side in (1, -1)]
    said = why_no_loop(one.manipulator, past_of(one, *zigzag))
    assert said == f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."


def test_what_trace_refuses_in_space_is_said(three, turned):
    """`trace` follows one tendon without loads in space."""
    said = why_no_loop(three.manipulator, past_of(three, {FIRST: 30.0}))
    assert said.startswith("The past is not remembered here: the friction of several tendons in space")
    with pytest.raises(ValueError, match="in space only one tendon without loads can be followed"):
        cddf.trace(three.manipulator, [[30.0, 0.0, 0.0]])
    loaded = past_of(turned, {FIRST: 40.0}, {"tip_force.2": 0.5})
    assert why_no_loop(turned.manipulator, loaded).startswith(
        "The past is not remembered here: in space it is known with"
    )
    with pytest.raises(ValueError, match="in space only one tendon without loads can be followed"):
        cddf.trace(turned.manipulator, [40.0], cddf.Loads((0.0, 0.0, 0.5)))
    # it begins when the load is taken away
    unloaded = past_of(turned, {FIRST: 40.0}, {"tip_force.2": 0.5}, {"tip_force.2": 0.0})
    assert tensions_of(unloaded) == [(40.0,)]
    assert why_no_loop(turned.manipulator, past_of(turned, {FIRST: 40.0})) == ""


def test_rows_of_a_measured_loop_know_their_past():
    """hysteresis.md section 2: tip tensions on the way back to the digits of the table."""
    base, tip = [75.0, 60.0, 40.0, 20.0], [45.122927, 45.122927, 45.122927, 24.288558]
    table = Measurements.from_columns("loop", base_tension=base, tip_tension=tip, step=[1, 2, 3, 4])
    body = paper_body("exact")
    ((rows, model),) = Exploration(body, (table,)).in_rows(body)
    assert rows is table
    np.testing.assert_allclose(model["tip_tension"], tip, atol=6e-7)
