"""The loops that the explorer draws, against hysteresis.md and `trace` along the whole path at once."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from bodies import paper_body
from moves import FIRST, FORCE, FORGET, GRAVITY, MODULUS, SECOND, body_of, past_of

import cddf_jax as cddf
from cddf_jax.explorer import past as pasts
from cddf_jax.explorer.model import Exploration
from cddf_jax.explorer.past import HALVINGS, SHORT_STEPS, EndState, Follower, Loop
from cddf_jax.explorer.plots import BodyPlot, TensionPlots
from cddf_jax.explorer.space import SpacePlot
from cddf_jax.explorer.words import loop_html

TOGETHER = ({SECOND: 20.0}, FORGET)  # both tendons are pulled at once, to 75 and 20 N
COMPILED = []  # what was traced or compiled in this process
jax.monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **_: COMPILED.append(name) if "backend_compile" in name or "jaxpr_trace" in name else None
)


@pytest.fixture(scope="module")
def one():
    return Exploration(paper_body("exact"))


@pytest.fixture(scope="module")
def pair():
    return Exploration(paper_body("exact", num_tendons=2, density=1070.0))


@pytest.fixture(scope="module")
def found(one):
    return Follower(one).loop(one.manipulator, past_of(one, {FIRST: 60.0}, {FIRST: 40.0}))


@pytest.fixture
def steps(monkeypatch):
    """The base tensions of all steps that are followed."""
    followed, step = [], pasts._followed

    def counted(body, tension, *rest):
        followed.append(tension)
        return step(body, tension, *rest)

    monkeypatch.setattr(pasts, "_followed", counted)
    return followed


# --- one tendon without loads ---------------------------------------------------------------------


def test_the_loop_is_that_of_the_table(found):
    """hysteresis.md section 2, 40 N on the way back from 75 N: tip tension, angle and front to its digits."""
    assert found.state.status == cddf.Status.successful
    assert found.base_tension[0] == 75.0
    assert found.tip_tension[-1] == pytest.approx(45.122927, abs=6e-7)
    assert np.degrees(found.tip_angle[-1]) == pytest.approx(56.053731, abs=6e-7)
    assert 1e3 * found.state.front == pytest.approx(115.089, abs=6e-4)
    text = loop_html(found)
    assert [f">{number}<" in text for number in ("45.1229", "56.054", "115.09")] == [True] * 3


def test_parts_of_the_path_are_joined(one):
    """As one path, of which `trace` is given every point at once; then with another body."""
    moves, follower = ({FIRST: 40.0}, {FIRST: 60.0}, {FIRST: 50.0}), Follower(one)
    for more in ((), ({MODULUS: 1.6},)):
        body = body_of(one, *moves, *more)
        found = follower.loop(body, past_of(one, *moves, *more))
        whole = cddf.trace(body, found.base_tension[:, 0])
        np.testing.assert_allclose(found.tip_tension[:, 0], whole.tip_tension, rtol=1e-9)
        np.testing.assert_allclose(found.tip_angle, whole.tip_angle, rtol=1e-9)
        np.testing.assert_allclose(found.state.position[-1], whole.tip_position[-1], rtol=1e-9)


def test_the_loop_is_drawn_and_taken_away(found, one):
    tension, body = TensionPlots(1), BodyPlot(one.manipulator, one.arc_length)
    figures = (*tension.figures.values(), body.figure)
    for plot in (tension, body):
        plot.show_loop(found)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [True] * 3
    np.testing.assert_allclose(tension.loops["tension"].data["value"], found.tip_tension[:, 0])
    np.testing.assert_allclose(tension.points["angle"]["past"].data["value"], [56.053731], atol=6e-7)
    # the heading of the last piece of the axis is the tip angle, up to half a step of the grid
    (x, y) = (np.diff(body.sources["past"].data[name])[-1] for name in "xy")
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(56.05, abs=0.5)
    for plot in (tension, body):
        plot.show_loop(None)
    assert [fig.select_one({"name": "past"}).visible for fig in figures] == [False] * 3


@pytest.mark.slow
def test_one_tendon_in_space_is_remembered(one):
    """A tendon at 0 degrees bends the body as it does in the plane: hysteresis.md section 2, 60 N."""
    explored = Exploration(replace(one.manipulator, tendons=(cddf.Tendon(0.010, angle=0.0),)))
    found = Follower(explored).loop(explored.manipulator, past_of(explored, {FIRST: 60.0}))
    assert found.tip_tension[-1] == pytest.approx(45.122927, abs=6e-7)
    assert np.degrees(found.tip_angle[-1]) == pytest.approx(67.619267, abs=6e-7)
    plot = SpacePlot(explored.manipulator)
    plot.show(explored.picture(explored.case(explored.start)))
    for loop in (found, None):
        plot.show_loop(loop)
        assert ("past" in plot.space.data["kind"]) == (loop is not None)


# --- in short steps -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def released(pair):
    """Tendon 1 of the pair released from 75 to 60 and to 40 N, tendon 2 at 20 N."""
    follower, moves = Follower(pair), (*TOGETHER, {FIRST: 60.0}, {FIRST: 40.0})
    return [follower.loop(pair.manipulator, past_of(pair, *moves[:count])) for count in (3, 4)]


def test_a_released_pair_is_that_of_the_table(released):
    """hysteresis.md section 3; steps of 1 N are off by 0.01 degrees, it says, and these are somewhat longer."""
    at_60, at_40 = released
    assert np.degrees(at_60.tip_angle[-1]) == pytest.approx(44.148, abs=0.03)
    np.testing.assert_allclose(at_60.tip_tension[-1], [50.304, 23.855], atol=0.03)
    assert 1e3 * at_60.state.front[0] == pytest.approx(52.74, abs=1.0)
    assert np.degrees(at_40.tip_angle[-1]) == pytest.approx(31.046, abs=0.03)
    np.testing.assert_allclose(at_40.tip_tension[-1], [45.013, 17.772], atol=0.05)
    assert 1e3 * at_40.state.front[0] == pytest.approx(125.43, abs=1.0)
    text = loop_html(at_40)
    assert f'"past_tip_tension_2">{at_40.tip_tension[-1, 1]:.4f}<' in text
    assert "Tendon 1 slid last up to" in text


def at_once(explored, loop, loads=None):
    """`trace` along the pull from rest and all rows."""
    return cddf.trace(explored.manipulator, loop.base_tension, loads, short_steps=SHORT_STEPS)


@pytest.mark.slow
def test_carried_states_are_those_of_the_whole_path(pair, released):
    """Without drag and loads a straight pull from rest leaves the same state in any number of steps."""
    whole = at_once(pair, released[1])
    np.testing.assert_allclose(released[1].tip_tension, whole.tip_tension, rtol=1e-5)
    np.testing.assert_allclose(released[1].tip_angle, whole.tip_angle, rtol=1e-5)
    np.testing.assert_allclose(released[1].state.position[-1], whole.tip_position[-1], atol=1e-7)
    np.testing.assert_allclose(released[1].state.front, whole.front[-1], rtol=1e-3)


@pytest.mark.slow
def test_gravity_rests_on_the_body_before_the_pull(pair):
    """The whole path by `trace` with constant loads, which act before the first step."""
    moves = (*TOGETHER[:1], {GRAVITY: -9.81}, FORGET, {FIRST: 60.0})
    found = Follower(pair).loop(pair.manipulator, past_of(pair, *moves))
    whole = at_once(pair, found, cddf.Loads(gravity=(0.0, -9.81)))
    np.testing.assert_allclose(found.tip_angle, whole.tip_angle, atol=2e-5)
    np.testing.assert_allclose(found.tip_tension[-1], whole.tip_tension[-1], rtol=1e-4)
    # the weight of 0.117 kg turns the tip back by more than a degree: it is not left out
    without = at_once(pair, found)
    assert np.degrees(without.tip_angle[-1] - whole.tip_angle[-1]) > 0.3


@pytest.mark.slow
def test_a_load_is_a_step_of_the_path(one):
    """75, 40 N, then a force: the last step of `trace` with a load for each step. The path until then is exact."""
    moves = ({FIRST: 40.0}, {FORCE: -0.2})
    found = Follower(one).loop(one.manipulator, past_of(one, *moves))
    bare, pushed = cddf.Loads(), cddf.Loads(tip_force=(0.0, -0.2))
    whole = cddf.trace(one.manipulator, [75.0, 40.0, 40.0], [bare, bare, pushed], short_steps=32)
    assert found.tip_angle[-1] == pytest.approx(float(whole.tip_angle[-1]), abs=1e-4)
    before = np.flatnonzero(found.base_tension[:, 0] == 40.0)[0]
    assert np.degrees(found.tip_angle[before]) == pytest.approx(56.053731, abs=0.01)  # hysteresis.md section 2
    assert not found.by_turns


def test_another_move_compiles_nothing_and_costs_its_own_steps(pair, steps):
    follower, moves = Follower(pair), (*TOGETHER, {FIRST: 70.0})
    follower.loop(pair.manipulator, past_of(pair, *moves))
    jax.jit(lambda x: x + len(COMPILED))(1.0)
    assert COMPILED  # the listener listens
    for move in ({FIRST: 69.0}, {SECOND: 22.0}, {FORCE: -0.005}, {FIRST: 72.0}):
        COMPILED.clear()
        steps.clear()
        moves = (*moves, move)
        follower.loop(pair.manipulator, past_of(pair, *moves))
        assert (COMPILED, len(steps)) == ([], 1)


def test_another_turn_compiles_nothing(one):
    follower, moves = Follower(one), ({FIRST: 60.0},)
    follower.loop(one.manipulator, past_of(one, *moves))
    COMPILED.clear()
    for move in ({FIRST: 50.0}, {FIRST: 55.0}, {MODULUS: 1.5}):
        moves = (*moves, move)
        follower.loop(body_of(one, *moves), past_of(one, *moves))
    assert COMPILED == []


def test_what_was_forgotten_is_followed_no_further(pair, steps):
    assert Follower(pair).loop(pair.manipulator, past_of(pair, {SECOND: 20.0}), lambda: len(steps) < 3) is None
    assert len(steps) == 3


def test_a_step_that_does_not_settle_is_halved(pair, monkeypatch):
    """Steps of more than 1 N fail here; then all do, and the past is lost."""
    step, longest = pasts._followed, 1.0

    def failing(body, tension, loads, start, arc_length):
        history, tip, angle, state = step(body, tension, loads, start, arc_length)
        far = np.max(np.abs(tension - np.asarray(start.base_tension[-1]))) > longest
        return history, tip, np.where(far, np.nan, angle), state

    follower, moves = Follower(pair), (*TOGETHER, {FIRST: 74.5})
    follower.loop(pair.manipulator, past_of(pair, *moves))
    monkeypatch.setattr(pasts, "_followed", failing)
    moves = (*moves, {FIRST: 71.5})
    found = follower.loop(pair.manipulator, past_of(pair, *moves))
    assert np.max(np.abs(np.diff(found.base_tension[-4:, 0]))) <= longest
    assert np.all(np.isfinite(found.tip_angle))
    longest = 0.0
    tried = follower.loop(pair.manipulator, past_of(pair, *moves, {FIRST: 70.5}))
    assert np.isnan(tried.tip_angle[-1])
    assert len(tried.tip_angle) == len(found.tip_angle) + 1
    assert HALVINGS == 3


def made_up(status, second=20.0):
    """A loop of two tendons with a status, tendon 2 pulled at its base."""
    state = EndState(np.full(2, 0.14), np.asarray(0.2), np.asarray(status), np.zeros((3, 2)))
    return Loop(np.array([[75.0, second]]), np.array([[10.0, 5.0]]), np.ones(1), state, 1, False)


def test_numbers_that_cannot_be_relied_on_say_so():
    text = loop_html(made_up(cddf.Status.inaccurate))
    assert text.startswith("<p>Do not rely on the numbers with their past: their error estimate is large. ")
    assert "its friction is not determined" not in text
    assert "its friction is not determined" in loop_html(made_up(cddf.Status.inaccurate, second=0.0))
    assert '"past_error_estimate">2.0e-01<' in text
    lost = made_up(cddf.Status.not_converged)
    assert not lost.shown
    assert loop_html(lost) == (
        "<p>The past is lost: a step of this move did not settle. Forget the past to start again.</p>"
    )
    assert "There is no answer with this past: " in loop_html(made_up(cddf.Status.crossing))


def test_figures_follow_the_tension_that_moves():
    """Tendon 2 at 5, 5, 6 and 7 N: the loop is drawn from where it began to move."""
    base = np.array([[9.0, 5.0], [8.0, 5.0], [8.0, 6.0], [8.0, 7.0]])
    state = EndState(np.full(2, 0.14), np.asarray(0.0), cddf.Status.successful, np.zeros((3, 2)))
    loop = Loop(base, base + 1.0, np.radians([1.0, 2.0, 3.0, 4.0]), state, 1, False)
    columns = {"base_tension": [20.0, 40.0], "base_tension_2": [5.0, 10.0], "tip_angle": [0.1, 0.2]}
    table = cddf.Measurements.from_columns("pair", **columns)
    plots = TensionPlots(2)
    plots.show_points("data", [(table, table.columns)])
    plots.follow(1)
    plots.show_loop(loop)
    np.testing.assert_array_equal(plots.loops["tension"].data["base"], [5.0, 6.0, 7.0])
    np.testing.assert_array_equal(plots.loops["tension"].data["value"], [6.0, 7.0, 8.0])
    np.testing.assert_allclose(plots.loops["angle"].data["value"], [2.0, 3.0, 4.0])
    np.testing.assert_array_equal(plots.points["tension"]["past"].data["base"], [8.0, 7.0])
    np.testing.assert_array_equal(plots.points["angle"]["data"].data["base"], [5.0, 10.0])
    assert plots.figures["angle"].xaxis.axis_label == "Base tension of tendon 2 (N)"
    plots.follow(0)
    np.testing.assert_array_equal(plots.points["angle"]["data"].data["base"], [20.0, 40.0])
    assert not plots.figures["angle"].select_one({"name": "loop"}).visible
