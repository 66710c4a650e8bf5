"""Directions that are not stated: each tendon slides as it travels.

Expected values: `solve` with every choice of stated directions, of which the one that no travel contradicts is meant;
that `solve` with stated directions is right is held by `test_reference`.
"""

import itertools
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_with, replaced

import cddf_jax as cddf
from cddf_jax.mechanics.directions import find_directions, stated_directions

SUCCESSFUL, CONTRADICTED = cddf.Status.successful, cddf.Status.direction_contradicted
PAIR = paper_body("exact", num_tendons=2)


def test_antagonists():
    """75 N against 20 N: 45.858 degrees in the limit of refined time steps, both in would give 54.0."""
    found = cddf.solve(PAIR, (75.0, 20.0))
    assert float(np.degrees(found.tip_angle)) == pytest.approx(45.858, abs=5e-4)
    np.testing.assert_array_equal(found.direction, (1, -1))
    mirrored = cddf.solve(PAIR, (20.0, 75.0))
    np.testing.assert_array_equal(mirrored.direction, (-1, 1))
    assert float(mirrored.tip_angle) == pytest.approx(-float(found.tip_angle), rel=1e-12)
    equal = cddf.solve(PAIR, (50.0, 50.0))  # the body stays straight, no tendon travels, and nothing is lost
    assert equal.status == cddf.Status.successful
    np.testing.assert_allclose(equal.tip_tension, 50.0, rtol=1e-12)


def three_tendons(kinematics):
    """Of which the last ends halfway, so that the body may bend both ways."""
    ends = (0.010, +1, None), (0.008, -1, None), (0.010, -1, 0.07)
    return paper_with(*(cddf.Tendon(offset, side, end=end) for offset, side, end in ends), kinematics=kinematics)


@pytest.mark.parametrize("kinematics", [pytest.param("published", marks=pytest.mark.slow), "exact"])
def test_the_choice_that_no_travel_contradicts(kinematics):
    """Random tensions, seed 0, one lane that fails; where no choice agrees, the fewest contradictions and a mark."""
    body = three_tendons(kinematics)
    tension = np.random.default_rng(0).uniform(0.0, 60.0, (256, 3))
    tension[17, 1] = np.nan

    @jax.jit
    @jax.vmap
    def outcome(tension, direction=None):
        found = cddf.solve(body, tension, direction=direction)
        return (
            found.status,
            found.direction_contradicted,
            found.direction,
            found.tip_angle,
            found.error_estimate,
        )

    result, against, direction, angle, error = map(np.asarray, outcome(tension))
    choices = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    stated = [outcome(tension, jnp.broadcast_to(choice, tension.shape)) for choice in choices]
    codes, contradicted, _, angles, errors = (np.stack(list(map(np.asarray, x))) for x in zip(*stated, strict=True))
    agrees = codes == SUCCESSFUL
    assert np.isnan(angle[17])
    good = np.arange(len(tension)) != 17
    assert np.all(np.sum(agrees, axis=0) <= 1)  # never two: the answer is unique
    unique = good & np.any(agrees, axis=0)
    np.testing.assert_array_equal(result[unique], SUCCESSFUL)
    chosen = np.argmax(agrees, axis=0)
    np.testing.assert_array_equal(direction[unique], choices[chosen[unique]])
    there = chosen, np.arange(len(tension))
    apart = np.abs(angle - angles[there])
    assert np.all(apart[unique] <= (error + errors[there])[unique])  # each is as near to the truth as it says
    assert np.max(apart[unique]) < 1e-12
    torn = good & ~np.any(agrees, axis=0)
    assert 0 < np.sum(torn) < 0.2 * len(tension)
    np.testing.assert_array_equal(result[torn], CONTRADICTED)
    np.testing.assert_array_equal(np.sum(against, axis=1)[torn], np.min(np.sum(contradicted, axis=2), axis=0)[torn])


# which tendon travels against its direction, by choice; none does in the last choice
CYCLES = [{(1, 1): 1, (1, -1): 0, (-1, -1): 1}, {(1, 1): 0, (-1, 1): 1, (-1, -1): 0}]


@pytest.mark.parametrize("against", CYCLES)
def test_no_choice_is_left_out(against):
    """A made-up body that contradicts three of four choices in turn: the search comes to the fourth."""
    (agreeing,) = set(itertools.product((1, -1), repeat=2)) - set(against)

    def attempt(direction):
        wrong = sum(
            jnp.where(jnp.all(direction == jnp.array(choice)), jnp.eye(2)[tendon], 0.0)
            for choice, tendon in against.items()
        )
        return direction, direction * (1.0 - 2.0 * wrong), jnp.array(True)

    ones = jnp.ones(2)
    found = find_directions(PAIR, 20.0 * ones, ones, (0, 1), attempt, ones)
    np.testing.assert_array_equal(found, agreeing)
    ones = jnp.array([1.0, -agreeing[1]])  # the second direction is stated: the search leaves it as it is
    found = find_directions(PAIR, 20.0 * jnp.ones(2), ones, (0,), attempt, ones)
    assert found[1] == -agreeing[1]


@pytest.mark.slow
def test_the_slope_holds_the_directions():
    """By a factor on both tensions, in both modes: against the central difference of solves, whose error is h^2."""
    body, h = paper_body("published", num_tendons=2), 1e-5

    def angle(factor):
        return cddf.solve(body, factor * jnp.array([75.0, 20.0]), nodes=8).tip_angle

    @jax.jit
    def with_slopes(factor):
        value, along = jax.linearize(angle, factor)  # reverse mode is this linear map transposed
        return value, along(1.0), jax.linear_transpose(along, factor)(1.0)[0]

    ahead, here, behind = (with_slopes(1.0 + step) for step in (h, 0.0, -h))
    np.testing.assert_allclose(here[1:], [(ahead[0] - behind[0]) / (2 * h)] * 2, rtol=1e-7)


@pytest.mark.slow
def test_derivatives_hold_the_directions():
    """In both modes those of the stated directions, which `test_gradients` holds against differences."""

    def tips(tension, modulus, direction):
        return cddf.solve(replaced(PAIR, youngs_modulus=modulus), tension, direction=direction).tip_tension

    at = jnp.array([75.0, 20.0]), 1.4e6
    expected = jax.jacfwd(tips, (0, 1))(*at, (1, -1))
    for mode in (jax.jacfwd, jax.jacrev):
        for slope, known in zip(mode(tips, (0, 1))(*at, None), expected, strict=True):
            np.testing.assert_allclose(slope, known, rtol=1e-9)


@pytest.mark.slow
def test_stated_directions_win():
    found = cddf.solve(PAIR, (75.0, 20.0), direction=(None, +1))
    both_in = cddf.solve(PAIR, (75.0, 20.0), direction=+1)
    np.testing.assert_array_equal(found.direction, (1, 1))
    np.testing.assert_array_equal(found.direction_contradicted, (False, True))
    np.testing.assert_array_equal(found.tip_tension, both_in.tip_tension)


def test_a_single_tendon_slides_in():
    """Under any loads: its direction does not depend on them."""
    assert stated_directions(None, 1) == stated_directions([None], 1) == 1.0
    np.testing.assert_array_equal(cddf.solve(paper_body("exact"), 5.0, direction=[None]).direction, [1])


def test_under_loads():
    """The travel is then the rate while all tensions rise; the stated directions agree with it, the others do not."""
    loads = cddf.Loads(tip_force=(0.0, -2.0))
    found = cddf.solve(PAIR, (60.0, 20.0), loads)
    stated = cddf.solve(PAIR, (60.0, 20.0), loads, direction=(1, -1))
    assert found.status == stated.status == cddf.Status.successful
    np.testing.assert_array_equal(found.direction, (1, -1))
    np.testing.assert_allclose(found.tip_tension, stated.tip_tension, rtol=1e-10)


@pytest.mark.slow
def test_targets():
    """The tensions with which `solve` with stated directions comes to the same tip angle."""
    found = cddf.solve(PAIR, (cddf.TipAngle(0.6), cddf.TotalTension(120.0)))
    np.testing.assert_array_equal(found.direction, (1, -1))
    again = cddf.solve(PAIR, found.base_tension, direction=(1, -1))
    assert float(again.tip_angle) == pytest.approx(0.6, abs=1e-9)
    assert float(jnp.sum(found.base_tension)) == pytest.approx(120.0, rel=1e-9)


@pytest.mark.slow
def test_the_paper_s_iteration():
    """It gets the directions of the equilibrium; its last tip tension is that of `solve`."""
    body = paper_body("published", num_tendons=2)
    history = cddf.iteration_history(body, (30.0, 10.0), tip_tolerance=1e-12)
    np.testing.assert_allclose(history.tip_tension[-1], cddf.solve(body, (30.0, 10.0)).tip_tension, rtol=1e-8)


@pytest.mark.slow
def test_a_sweep_and_a_case_of_a_design():
    """Unstated, or stated for one tendon along an axis."""
    swept = cddf.sweep(PAIR, {"base_tension_2": [10.0, 20.0]}, base_tension=75.0, outputs=("tip_tension",))
    expected = [cddf.solve(PAIR, (75.0, pull), direction=(1, -1)).tip_tension for pull in (10.0, 20.0)]
    np.testing.assert_allclose(swept.tip_tension, expected, rtol=1e-10)
    stated = cddf.sweep(PAIR, {"direction_2": [-1.0, 1.0]}, base_tension=(75.0, 20.0), outputs=("tip_tension",))
    expected = [cddf.solve(PAIR, (75.0, 20.0), direction=(1, way)).tip_tension for way in (-1, 1)]
    np.testing.assert_allclose(stated.tip_tension, expected, rtol=1e-10)
    case = cddf.LoadCase((75.0, 20.0)).solve(PAIR)
    np.testing.assert_array_equal(case.direction, (1, -1))


PULLS = np.linspace(10.0, 80.0, 6)


@cache
def readings():
    """Tip angles and tensions of tendon 1 at 10 to 80 N, tendon 2 pulled with 0.3 of that, directions stated."""
    solved = jax.vmap(lambda a: cddf.solve(PAIR, (a, 0.3 * a), direction=(1, -1)))(jnp.asarray(PULLS))
    pulls = {"base_tension": PULLS, "base_tension_2": 0.3 * PULLS}
    return pulls | {"tip_angle": solved.tip_angle, "tip_tension": solved.tip_tension[:, 0]}


@pytest.mark.slow
@pytest.mark.parametrize("stated", [{}, {"direction": np.ones(6)}], ids=["nothing stated", "one stated"])
def test_a_table_without_directions(stated):
    """Its predictions are those of the directions that were found."""
    from cddf_jax.identification.bench import experiment_of

    read = readings()
    bench = experiment_of(cddf.Measurements.from_columns("simulated", **read, **stated), PAIR)
    for column, values in bench.predict(PAIR, {}, 16).items():
        np.testing.assert_allclose(values, read[column], rtol=1e-9)


@pytest.mark.slow
def test_a_fit_without_directions():
    """Readings of the right directions give back what they were made with."""
    fit = cddf.fit(PAIR, cddf.Measurements.from_columns("simulated", **readings()))
    assert fit.value["friction_coefficient"] == pytest.approx(0.42, rel=1e-7)
    assert fit.value["youngs_modulus"] == pytest.approx(1.4e6, rel=1e-7)
    band = fit.predict("tip_tension", [[75.0, 20.0]])
    expected = cddf.solve(PAIR, (75.0, 20.0), direction=(1, -1)).tip_tension[0]
    assert float(band.value[0]) == pytest.approx(float(expected), rel=1e-7)


@pytest.mark.parametrize(
    ("direction", "message"),
    [
        ((None, None, 1), "solve: direction must be a number or one per tendon (2), got 3 entries"),
        ((None, (1, 1)), "solve: direction must be a number or one per tendon (2), got shape (2,)"),
    ],
)
def test_directions_of_a_wrong_shape(direction, message):
    with pytest.raises(ValueError, match="direction must be") as error:
        cddf.solve(PAIR, 20.0, direction=direction)
    assert str(error.value) == message
