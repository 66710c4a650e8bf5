"""Directions that are not stated: each tendon slides as it travels.

Expected values: `solve` with every choice of stated directions, of which the one that no travel contradicts is meant;
that `solve` with stated directions is right is held by `test_reference`.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, paper_body, paper_with

import cddf_jax as cddf

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


def test_the_choice_that_no_travel_contradicts():
    """Random tensions, seed 0, one lane that fails; where no choice agrees, the fewest contradictions and a mark.

    The last of three tendons ends halfway, so that the body may bend both ways.
    """
    ends = (0.010, +1, None), (0.008, -1, None), (0.010, -1, 0.07)
    body = paper_with(*(cddf.Tendon(offset, side, end=end) for offset, side, end in ends))
    tension = np.random.default_rng(0).uniform(0.0, 60.0, (128, 3))
    tension[17, 1] = np.nan

    @jax.jit
    @jax.vmap
    def outcome(tension, direction=None):
        found = cddf.solve(body, tension, direction=direction)
        return found.status, found.direction_contradicted, found.direction, found.tip_angle

    result, against, direction, angle = map(np.asarray, outcome(tension))
    choices = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    stated = [outcome(tension, jnp.broadcast_to(choice, tension.shape)) for choice in choices]
    codes, contradicted, _, angles = (np.stack(list(map(np.asarray, x))) for x in zip(*stated, strict=True))
    agrees = codes == SUCCESSFUL
    assert np.isnan(angle[17])
    good = np.arange(len(tension)) != 17
    assert np.all(np.sum(agrees, axis=0) <= 1)  # never two: the answer is unique
    unique, chosen = good & np.any(agrees, axis=0), np.argmax(agrees, axis=0)
    np.testing.assert_array_equal(result[unique], SUCCESSFUL)
    np.testing.assert_array_equal(direction[unique], choices[chosen[unique]])
    np.testing.assert_allclose(angle[unique], angles[chosen, np.arange(len(tension))][unique], atol=1e-12)
    torn = good & ~np.any(agrees, axis=0)
    assert 0 < np.sum(torn) < 0.2 * len(tension)
    np.testing.assert_array_equal(result[torn], CONTRADICTED)
    np.testing.assert_array_equal(np.sum(against, axis=1)[torn], np.min(np.sum(contradicted, axis=2), axis=0)[torn])


@pytest.mark.slow
def test_the_slope_holds_the_directions():
    """By a factor on both tensions, in both modes: against the central difference of solves, whose error is h^2."""
    body, h = paper_body("published", num_tendons=2), 1e-5

    def angle(factor):
        return cddf.solve(body, factor[0] * jnp.array([75.0, 20.0]), nodes=8).tip_angle[None]

    derivatives = both_modes(angle)
    ahead, here, behind = (derivatives(jnp.array([1.0 + step])) for step in (h, 0.0, -h))
    np.testing.assert_allclose(np.ravel(here[1:]), np.repeat(ahead[0] - behind[0], 2) / (2 * h), rtol=1e-7)


@pytest.mark.slow
def test_a_tendon_without_tension_slides_as_it_travels():
    """It winds, and the pulled one shortens its path. Its slope is that towards a small tension, by differences."""
    winding, pulled = (cddf.Tendon(0.010, angle=angle) for angle in (cddf.Linear(0.0, 1.5, 0.14), 2.1))
    body, step = paper_with(winding, pulled), jnp.array([1e-4, 0.0])

    @jax.jit
    def outcome(tension):
        def tip(tension):
            found = cddf.solve(body, tension, throw=False)
            return found.tip_tension[0], found

        (value, found), slope = jax.value_and_grad(tip, has_aux=True)(tension)
        return value, slope[0], found.direction, found.tendon_displacement

    value, slope, direction, travel = outcome(jnp.array([0.0, 12.0]))
    assert value == 0
    assert travel[0] > 0
    np.testing.assert_array_equal(direction, (1, 1))
    np.testing.assert_allclose(slope, outcome(jnp.array([0.0, 12.0]) + step)[0] / step[0], rtol=1e-5)


def test_stated_directions_win():
    """Where a tendon travels against its direction, that is said and not raised."""
    both_in = cddf.solve(PAIR, (75.0, 20.0), direction=+1)
    assert both_in.status == CONTRADICTED
    assert "flip it or leave it out" in cddf.in_words(both_in.status)
    assert both_in.tendon_displacement[1] < 0
    found = cddf.solve(PAIR, (75.0, 20.0), direction=(None, +1))
    np.testing.assert_array_equal(found.direction, (1, 1))
    np.testing.assert_array_equal(found.direction_contradicted, (False, True))
    np.testing.assert_array_equal(found.tip_tension, both_in.tip_tension)
    # without tension there is no friction whose sign could be wrong
    assert cddf.solve(PAIR, (75.0, 0.0), direction=+1).status == SUCCESSFUL


@pytest.mark.parametrize(
    ("pulls", "loads"),
    [
        ((60.0, 20.0), cddf.Loads(tip_force=(0.0, -2.0))),
        pytest.param((cddf.TipAngle(0.6), cddf.TotalTension(120.0)), None, marks=pytest.mark.slow),
    ],
    ids=["loads", "targets"],
)
def test_under_loads_and_for_targets(pulls, loads):
    """Under loads the travel is the rate while all tensions rise."""
    found, stated = (cddf.solve(PAIR, pulls, loads, direction=direction) for direction in (None, (1, -1)))
    assert found.status == stated.status == cddf.Status.successful
    np.testing.assert_array_equal(found.direction, (1, -1))
    np.testing.assert_allclose(found.tip_tension, stated.tip_tension, rtol=1e-10)


@pytest.mark.slow
def test_a_sweep_and_a_fit_without_directions():
    """Of a sweep one direction is stated along an axis; readings of the right ones give back their origin."""
    swept = cddf.sweep(PAIR, {"direction_2": [-1.0, 1.0]}, base_tension=(75.0, 20.0), outputs=("tip_tension",))
    expected = [cddf.solve(PAIR, (75.0, 20.0), direction=(1, way)).tip_tension for way in (-1, 1)]
    np.testing.assert_allclose(swept.tip_tension, expected, rtol=1e-10)
    pulls = np.linspace(10.0, 80.0, 6)
    solved = jax.vmap(lambda a: cddf.solve(PAIR, (a, 0.3 * a), direction=(1, -1)))(jnp.asarray(pulls))
    read = {"base_tension": pulls, "base_tension_2": 0.3 * pulls, "tip_angle": solved.tip_angle}
    table = cddf.Measurements.from_columns("simulated", **read, tip_tension=solved.tip_tension[:, 0])
    fit = cddf.fit(PAIR, table)
    assert fit.value["friction_coefficient"] == pytest.approx(0.42, rel=1e-7)
    assert fit.value["youngs_modulus"] == pytest.approx(1.4e6, rel=1e-7)
