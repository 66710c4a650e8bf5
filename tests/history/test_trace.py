"""Pull and release of one tendon, against closed forms, a play operator in NumPy, and laws.

On the paper's body in the exact kinematics 1/T is a play of 1/T_base: clipped between 1/T_base -+ g(s) with
g(s) = (mu/E) int_0^s d/J, and mu phi is the integral of T over g.
"""

import functools
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    PAPER,
    UNIT_CUBE,
    body_of,
    both_modes,
    codes,
    draw_from,
    lane,
    one_kinematics_at_once,
    paper_body,
    paper_plain,
    plain_of,
)
from hypothesis import given, settings, strategies as st
from kinds import of_kind
from refusals import refused
from scipy.integrate import quad, solve_ivp

import cddf_jax as cddf

LENGTH, OFFSET, MU, MODULUS = PAPER["length"], PAPER["tendon_offset"], PAPER["friction_coefficient"], 1.4e6
BODY = paper_body("exact")
STEPS = 8  # of most paths here, so that they share one program
PLACES = np.linspace(0.0, LENGTH, 9)


PLAIN = paper_plain("exact")
END = MU / MODULUS * PLAIN.compliance(LENGTH)  # g(L)


def play(path, at):
    """T at a place where g has the value `at`, after a path of base tensions from rest."""
    y = np.inf
    for tension in path:
        turned = np.inf if tension == 0 else 1 / tension
        y = np.clip(y, turned - at, turned + at)
    return 1 / y


def angle(path):
    """phi(L): the integral of T over g, cut wherever two of the tensions meet, over mu."""
    inverse = [1 / tension for tension in path if tension > 0]
    cuts = sorted({abs(a - b) / 2 for a in inverse for b in inverse})
    cuts = [0.0, *[cut for cut in cuts if 0 < cut < END], END]
    pieces = [quad(lambda at: play(path, at), a, b, epsabs=0, epsrel=1e-12)[0] for a, b in pairwise(cuts)]
    return sum(pieces) / MU


def test_a_loop_of_the_paper():
    """Tip tension, angle and front of a loop as an independent derivation gives them: 8 digits."""
    path = [75.0, 60.0, 40.0, 20.0, 5.0, 0.0, 50.0, 75.0]
    tips = [45.122927, 45.122927, 45.122927, 24.288558, 5.230901, 0.0, 34.688077, 45.122927]
    angles = [69.313929, 67.619267, 56.053731, 26.502447, 6.158703, 0.0, 49.878294, 69.313929]
    fronts = [140.0, 51.564, 115.089, 140.0, 140.0, 140.0, 140.0, 140.0]
    history = cddf.trace(BODY, path)
    np.testing.assert_allclose(history.tip_tension, tips, atol=6e-7)
    np.testing.assert_allclose(np.degrees(history.tip_angle), angles, atol=6e-7)
    np.testing.assert_allclose(1e3 * history.front, fronts, atol=6e-4)
    middle = history.at(PLACES).tension[:3, 0, 4]
    np.testing.assert_allclose(middle, [62.977492, 62.977492, 44.534217], atol=6e-7)
    np.testing.assert_array_equal(history.num_turns, [1, 2, 2, 2, 2, 2, 3, 1])


def test_random_paths_against_the_play():
    """Also far above 113 N, where a tendon that is released would lock, were all of it to slide."""
    rng = np.random.default_rng(21)
    for largest in (80.0, 200.0, 200.0):
        path = rng.uniform(0, largest, STEPS)
        history = cddf.trace(BODY, path)
        for step in range(len(path)):
            np.testing.assert_allclose(history.tip_tension[step], play(path[: step + 1], END), rtol=1e-11)
            np.testing.assert_allclose(history.tip_angle[step], angle(path[: step + 1]), rtol=1e-10)
        np.testing.assert_allclose(history.tendon_displacement, OFFSET * history.tip_angle, rtol=1e-11)
        assert np.max(history.error_estimate) < 1e-9


@pytest.mark.slow
def test_a_path_of_several_blocks():
    path = np.random.default_rng(2).uniform(5, 90, 150)
    history = cddf.trace(BODY, path)
    expected = [play(path[: step + 1], END) for step in range(path.size)]
    np.testing.assert_allclose(history.tip_tension, expected, rtol=1e-11)


@pytest.mark.slow
def test_the_shape_is_the_integral_of_its_heading():
    history, s = cddf.trace(BODY, [75.0, 40.0, 60.0, 50.0]), np.linspace(0, LENGTH, 20001)
    along = of_kind(cddf.Fields, history.at(s))
    heading = np.asarray(along.heading)
    for component, function in enumerate((np.cos, np.sin)):
        found = np.trapezoid(function(heading), s, axis=1)
        np.testing.assert_allclose(history.tip_position[:, component], found, atol=1e-10)
    np.testing.assert_allclose(along.position[:, -1], history.tip_position, atol=1e-12)
    np.testing.assert_allclose(along.heading[:, -1], history.tip_angle, rtol=1e-11)
    assert np.all(np.isnan(history.at([-1e-3, 1.01 * LENGTH]).tension))
    np.testing.assert_allclose(np.trapezoid(along.curvature, s, axis=1), history.tip_angle, rtol=1e-8)
    slip = np.gradient(np.asarray(along.tension[-1, 0]), s)  # friction along the tendon is what its tension loses
    force = np.linalg.norm(along.friction_force[-1, 0], axis=-1)
    far = np.min(np.abs(s[:, None] - np.asarray(history.front)), axis=1) > 1e-4
    np.testing.assert_allclose(force[far][1:-1], np.abs(slip[far][1:-1]), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("path", "drag"), [((70.0, 45.0), 8.0), ((150.0, 120.0), 60.0), ((200.0, 150.0), 60.0)])
def test_a_front_with_drag_against_an_integration(path, drag):
    """T by SciPy's solve_ivp along both directions, up to where they meet; from 150 N on all of it would lock."""

    def branch(tension, direction, events=None):
        def rate(s, T):
            return -direction * (MU * OFFSET / (MODULUS * PLAIN.second_moment(s)) * T**2 + drag)

        options: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12, "dense_output": True}
        return solve_ivp(rate, (0, LENGTH), [tension], events=events, **options)

    pulled = branch(path[0], 1).sol

    def meets(s, T):
        return T[0] - pulled(s)[0]

    vars(meets).update(terminal=True, direction=1)
    released = branch(path[1], -1, meets)
    front = released.t_events[0][0]
    history = cddf.trace(paper_body("exact", drag=drag), path)
    np.testing.assert_allclose(history.front[1], front, rtol=1e-9)
    assert history.error_estimate[1] < 1e-10
    s = np.linspace(0, LENGTH, 41)
    expected = [(released.sol if x < front else pulled)(x)[0] for x in s]
    np.testing.assert_allclose(history.at(s).tension[1, 0], expected, rtol=1e-9)


@pytest.mark.slow
def test_what_drag_leaves_after_full_release():
    """0.702123 N and 0.544432 degrees, by an independent simulation."""
    left = cddf.trace(paper_body("exact", drag=5.0), [75.0, 0.0])
    np.testing.assert_allclose([left.tip_tension[1], np.degrees(left.tip_angle[1])], [0.702123, 0.544432], atol=6e-7)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"kinematics": "published"}, {"tendon_offset": (0.012, 0.008), "drag": 8.0}])
def test_other_bodies_by_their_branches(changes):
    """T is clipped by the two branches of `solve`; the shape is the integral of the curvature."""
    body = paper_body(**{"kinematics": "exact", **changes})
    path, s = [70.0, 30.0, 55.0, 40.0, 50.0, 10.0, 35.0, 20.0], np.linspace(0, LENGTH, 4001)
    tension, now = np.zeros_like(s), 0.0
    for value in path:
        pulled = value > now
        branch = cddf.solve(body, value, direction=1 if pulled else -1, throw=False).at(s).tension[0]
        tension, now = np.maximum(tension, branch) if pulled else np.minimum(tension, branch), value
    history = cddf.trace(body, path)
    last = jax.tree.map(lambda x: x[-1], history.at(s))
    np.testing.assert_allclose(last.tension[0], tension, rtol=1e-10)
    np.testing.assert_allclose(np.trapezoid(last.curvature, s), history.tip_angle[-1], atol=3e-8)


def test_a_pull_alone_is_a_solve():
    tensions = np.linspace(5.0, 75.0, STEPS)
    history = cddf.trace(BODY, tensions)
    along = history.equilibria
    for step, tension in enumerate(tensions):
        found = cddf.solve(BODY, tension)
        compare = functools.partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-11)
        jax.tree.map(compare, lane(along, step), found.along)
        np.testing.assert_allclose(history.tendon_displacement[step], found.tendon_displacement[0], rtol=1e-12)


@functools.cache
def traced_draws(kinematics):
    """Compiled: two paths over a body of `bodies.draw_from`."""

    def traced(draw, path):
        history = cddf.trace(body_of(draw, kinematics), path, throw=False)
        found = history.tip_tension, history.tip_angle, history.tip_position, history.front
        return (*found, history.tendon_displacement), history.num_turns, history.status

    return jax.jit(jax.vmap(traced, (None, 0)))


@one_kinematics_at_once
@given(unit=UNIT_CUBE, levels=st.tuples(st.floats(0.05, 1.0), *[st.just(0.0) | st.floats(1e-9, 1.0)] * 5))
@settings(max_examples=30)
def test_return_point_memory(kinematics, unit, levels):
    """Of random bodies on random paths: loops within loops close, and what is passed is forgotten.

    All is pulled to the top first and then stays between top and bottom. Tip tensions are those of the play.
    """
    draw = draw_from(unit, kinematics)
    top = levels[0] * draw.base_tension
    bottom, *inner, last = (level * top for level in levels[1:])
    inner, last = np.maximum(inner, bottom), max(last, bottom)
    detour, direct = [top, *inner, bottom, last, bottom, top], [top, bottom, last, bottom, last, bottom, last, top]
    numbers, num_turns, result = traced_draws(kinematics)(draw, np.array([detour, direct]))
    assert set(codes(result)) == {0}
    for values in numbers:
        values = np.asarray(values)
        scale = np.max(np.abs(values))
        for again, once in (((0, 4), (1, 1)), ((0, 6), (0, 4)), ((0, 7), (0, 0)), ((1, 3), (1, 1))):
            np.testing.assert_allclose(values[again], values[once], rtol=1e-12, atol=1e-12 * scale)
    assert num_turns[0, 7] == num_turns[1, 7] == 1
    end = draw.friction_coefficient / draw.youngs_modulus * plain_of(draw, kinematics).compliance(draw.length)
    expected = [play(detour[: step + 1], end) for step in range(len(detour))]
    np.testing.assert_allclose(numbers[0][0], expected, rtol=1e-9, atol=1e-12 * top)


def test_a_history_in_words():
    """What failed, and what is traced; test_trace_command.py has the lines of a loop."""
    failed = str(cddf.trace(BODY, PATH.at[STEPS - 1].set(-5.0), throw=False)).splitlines()
    assert failed[-2].startswith(f"{STEPS}: The body or its load is not physical")
    assert failed[-1].endswith(f"; {STEPS - 1} successful, 1 unphysical")
    batch = jax.eval_shape(jax.vmap(lambda path: cddf.trace(BODY, path)), jnp.ones((2, STEPS)))
    assert str(batch).startswith("History(")


def test_where_it_slides():
    history = cddf.trace(BODY, PATH)
    np.testing.assert_array_equal(history.sliding([0.02, 0.1])[:2], [[1, 1], [-1, 0]])


def traced_angles(tensions, mu, throw=False):
    return cddf.trace(paper_body("exact", friction_coefficient=mu), tensions, throw=throw).tip_angle


PATH = jnp.array([75.0, 60.0, 40.0, 50.0, 45.0, 30.0, 55.0, 70.0])
derivatives = both_modes(lambda numbers: traced_angles(numbers[1:], numbers[0]))  # by mu, and by each tension


def test_derivatives_in_both_modes_are_those_of_the_closed_form():
    """A release with its front inside has mu phi = ln[y (y_0 + g) / ((y + y_0) / 2)^2], y = 1/T; differences by mu."""
    _, forward, reverse = derivatives(jnp.append(MU, PATH))
    np.testing.assert_allclose(forward, reverse, rtol=1e-11, atol=1e-14)
    y, y0 = 1 / 60.0, 1 / 75.0
    by_tension = (1 / y - 2 / (y + y0)) * -(y**2) / MU
    np.testing.assert_allclose(forward[1, 2], by_tension, rtol=1e-10)
    step = 1e-5
    difference = (traced_angles(PATH, MU + step) - traced_angles(PATH, MU - step)) / (2 * step)
    np.testing.assert_allclose(forward[:, 0], difference, rtol=1e-7)


@pytest.mark.slow
def test_lanes_and_single_precision():
    def total(scale):
        def traced(mu):
            return cddf.trace(paper_body("exact", friction_coefficient=mu), scale * PATH, throw=False)

        found = jax.vmap(traced)(jnp.array([MU, -1.0, 0.2]))
        return jnp.nansum(found.tip_angle), (found.tip_angle, found.status)

    slope, (angles, result) = jax.jit(jax.grad(total, has_aux=True))(1.0)
    np.testing.assert_allclose(angles[0], traced_angles(PATH, MU), rtol=1e-12)
    expected = [cddf.Status.successful] * STEPS + [cddf.Status.unphysical] * STEPS + [cddf.Status.successful] * STEPS
    assert codes(result) == expected
    assert np.all(np.isnan(angles[1]))
    good = sum(jnp.sum(derivatives(jnp.append(mu, PATH))[1][:, 1:] @ PATH) for mu in (MU, 0.2))
    np.testing.assert_allclose(slope, good, rtol=1e-11)  # the lane that fails leaves it alone
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), BODY)
    found = cddf.trace(single, np.asarray(PATH, np.float32))
    assert found.tip_angle.dtype == jnp.float32
    np.testing.assert_allclose(found.tip_angle, angles[0], rtol=1e-5)


@pytest.mark.slow
def test_more_turns_than_there_is_room_for():
    path = [75.0, 20.0, 70.0, 25.0]
    history = cddf.trace(BODY, path, max_turns=3, throw=False)
    assert codes(history.status) == [cddf.Status.successful] * 3 + [cddf.Status.too_many_turns]
    assert np.isnan(history.tip_angle[3])
    np.testing.assert_array_equal(np.isnan(history.front), [False, False, False, True])
    np.testing.assert_array_equal(np.isnan(history.at(0.05).tension[:, 0]), [False, False, False, True])
    on = cddf.trace(BODY, [60.0], start=history, throw=False)  # what it remembers is not known
    assert codes(on.status) == [cddf.Status.unphysical]
    assert np.isnan(on.tip_angle[0])
    with pytest.raises(cddf.SolveError, match=r"step 3 of the trace, 25 N: More turns .* Raise max_turns="):
        cddf.trace(BODY, path, max_turns=3)


@pytest.mark.parametrize(
    ("body", "path", "options", "words"),
    [
        (BODY, 75.0, {}, r"tensions, N, of the shape \(steps,\) or \(steps, 1\) for this body, got the shape \(\)"),
        (BODY, [[75.0, 1.0]], {}, r"got the shape \(1, 2\)"),
        (BODY, [], {}, r"got the shape \(0,\)"),
        (BODY, [75.0], {"max_turns": 0}, "max_turns must be a whole number of 1 or more, got 0"),
        (BODY, [75.0], {"nodes": 3}, "nodes must be a whole number of 4 or more"),
    ],
)
def test_what_is_refused(body, path, options, words):
    with pytest.raises(ValueError, match=words):
        cddf.trace(body, path, **options)


def test_wrong_types_and_numbers():
    with pytest.raises(TypeError, match="the first argument must be a Manipulator"):
        cddf.trace("robot.toml", [75.0])  # pyright: ignore[reportArgumentType]
    for target in (cddf.CurvatureAt([5.0], 0.1), cddf.TipPosition((0.1, 0.05))):
        with pytest.raises(TypeError, match=f", TotalTension, got {type(target).__name__}; give the tension or the"):
            cddf.trace(BODY, target)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match="start must be a History"):
        cddf.trace(BODY, [75.0], start=75.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(cddf.SolveError, match="step 1 of the trace, -5 N: The body or its load is not physical"):
        cddf.trace(BODY, PATH.at[1].set(-5.0))


@pytest.mark.slow
def test_the_front_has_its_derivatives():
    """Against central differences, in both modes; at the tip the front does not move."""

    def front(numbers):
        mu, modulus, high, low = numbers
        body = paper_body("exact", friction_coefficient=mu, drag=2.0, youngs_modulus=1.4e6 * modulus)
        return cddf.trace(body, jnp.stack([75.0 * high, 40.0 * low, 55.0])).front

    derivatives, at = both_modes(front), np.array([0.42, 1.0, 1.0, 1.0])
    ends = [(derivatives(at + 1e-5 * unit)[0], derivatives(at - 1e-5 * unit)[0]) for unit in np.eye(4)]
    differences = np.stack([(above - below) / 2e-5 for above, below in ends], axis=1)
    for found in derivatives(at)[1:]:
        np.testing.assert_allclose(found, differences, atol=1e-7)


@pytest.mark.slow
def test_derivatives_by_the_length():
    """Against central differences; of a pull, of a release whose front is inside, and of one that reaches the tip."""

    def found(length):
        tendons = [cddf.Tendon(0.01)]
        body = cddf.Manipulator(length=length, tendons=tendons, bending_stiffness=0.05, friction_coefficient=0.4)
        history = cddf.trace(body, [30.0, 20.0, 5.0], throw=False)
        return jnp.concatenate([history.tip_angle, history.tip_tension, history.front, history.energies.work])

    slopes = jax.jacfwd(found)(LENGTH)
    differences = (found(LENGTH + 1e-6) - found(LENGTH - 1e-6)) / 2e-6
    np.testing.assert_allclose(slopes, differences, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_a_history_carried_by_scan():
    """A history keeps its structure, from rest on; the states are those of the whole path."""

    def step(history, pull):
        history = cddf.trace(BODY, pull[None], start=history)
        return history, history.tip_angle[0]

    pulls = jnp.array([40.0, 75.0, 30.0, 60.0, 50.0, 20.0, 80.0])
    _, carried = jax.lax.scan(step, cddf.trace(BODY, [0.0]), pulls)
    np.testing.assert_allclose(carried, cddf.trace(BODY, jnp.append(0.0, pulls)).tip_angle[1:], rtol=1e-12)


def test_a_batch_of_histories_is_refused():
    batch = jax.eval_shape(jax.vmap(lambda path: cddf.trace(BODY, path)), jnp.ones((2, STEPS)))
    for asked, ask in (("at(s)", batch.at), ("sliding(s)", batch.sliding)):
        said = refused(ask, 0.07)
        assert said.startswith(f"{asked}: needs one history, not a batch of shape (2,); use jax.vmap(lambda history:")
    with pytest.raises(ValueError, match="energies: needs one history"):
        _ = batch.energies


@pytest.mark.slow
def test_a_front_that_rests_at_a_joint():
    """Where the radius jumps, the tension of a slanted tendon does, and a range of tensions leaves the front there."""
    radius = cddf.Piecewise([0.07], [0.01, 0.006])
    tendon = cddf.Tendon(cddf.Linear(0.008, 0.003, 0.14))
    body = cddf.Manipulator(
        length=0.14,
        outer_radius=radius,
        inner_radius=0.0,
        tendons=[tendon],
        youngs_modulus=1e6,
        friction_coefficient=0.5,
    )

    @jax.jit
    def found(tension):
        history = cddf.trace(body, jnp.stack([jnp.asarray(3.0), tension]), throw=False)
        return history.tip_angle[1], history.front[1]

    (low, front), (high, _) = found(2.537), found(2.538)
    assert front == 0.07
    slope, moved = jax.jacfwd(found)(2.5375)
    np.testing.assert_allclose([slope, moved], [(high - low) / 0.001, 0.0], rtol=1e-6)
