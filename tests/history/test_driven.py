"""Paths of displacements and of tip angles, against a closed form and against traces of their tensions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, codes, paper_body, paper_with

import cddf_jax as cddf

BODY = paper_body("exact")
PATH = [75.0, 40.0, 60.0, 50.0, 30.0, 80.0, 10.0, 45.0]  # eight steps, as elsewhere: one program for all of them


@pytest.mark.slow
def test_a_little_back_from_a_pull():
    """The closed form with the front inside: y_b/y_0 = (2 - K + 2 sqrt(1 - K)) / K, K = exp(mu phi) y_0 / (y_0 + g).

    Then further back than the tendon can push, and pulled in again: it is slack meanwhile, and loses nothing.
    """
    top = float(cddf.solve(BODY, 75.0).tendon_displacement[0])
    path = [top, top - 1e-4, top - 5e-4, top - 2e-3, -1e-3, -2e-3, 3e-3, 4e-3]
    history = cddf.trace(BODY, cddf.Displacement(path))
    np.testing.assert_allclose(history.base_tension[:4], [75, 65.879540, 56.100971, 41.836412], atol=6e-7)
    np.testing.assert_array_equal(history.base_tension[4:6], 0.0)
    slack = cddf.Status.slack
    assert codes(history.status) == [0, 0, 0, 0, slack, slack, 0, 0]
    np.testing.assert_allclose(history.tendon_displacement, [*path[:4], 0, 0, *path[6:]], atol=1e-15)
    pulled = [cddf.solve(BODY, cddf.Displacement(x)).base_tension[0] for x in path[6:]]
    np.testing.assert_allclose(history.base_tension[6:], pulled)


@pytest.mark.slow
def test_a_tendon_that_begins_on_the_axis():
    """A single pull is the same with and without a history."""
    body = paper_body("exact", tendon_offset=(0.0, 0.010))
    lengths = cddf.Displacement([1e-4, 2e-4])
    alone = [float(cddf.solve(body, cddf.Displacement(x)).base_tension[0]) for x in lengths.value]
    np.testing.assert_allclose(cddf.trace(body, lengths).base_tension, alone, rtol=1e-9)


@pytest.mark.slow
def test_tip_angles_of_a_tendon_on_the_other_side():
    """The mirror image; an angle to the other side would take a push."""
    path = np.array([0.5, 0.3, 0.6, -0.1])
    bodies = [paper_with(cddf.Tendon(0.010, side=side)) for side in (1, -1)]
    one, other = (
        cddf.trace(body, cddf.TipAngle(sign * path), throw=False) for sign, body in zip((1, -1), bodies, strict=True)
    )
    np.testing.assert_allclose(other.base_tension, one.base_tension, rtol=1e-12)
    assert codes(other.status) == codes(one.status) == [0, 0, 0, cddf.Status.unreachable]


@pytest.mark.slow
def test_the_way_back_of_tip_angles():
    """Loops that close, and on from their end: 80 N, the most of all, lets the rest be forgotten."""
    body = paper_body("published")
    history = cddf.trace(body, PATH)
    found = cddf.trace(body, cddf.TipAngle(history.tip_angle))
    np.testing.assert_allclose(found.base_tension, PATH, rtol=1e-10)
    on = cddf.trace(body, cddf.TipAngle(history.tip_angle), start=history)
    np.testing.assert_allclose(on.base_tension, PATH, rtol=1e-10)
    np.testing.assert_array_equal(np.asarray(on.num_turns)[5:], np.asarray(history.num_turns)[5:])
    with pytest.raises(cddf.SolveError, match="No base tension between slack"):
        cddf.trace(body, cddf.TipAngle([1e3] * 8))
    with pytest.raises(cddf.SolveError, match="not physical"):
        cddf.trace(body, cddf.TipAngle([np.nan] * 8))


@pytest.mark.slow
def test_derivatives_are_those_of_the_inverse():
    """dT/dx against the inverse of dx/dT; by mu against differences."""
    path, mu, step = jnp.array([75.0, 60.0, 30.0, 45.0]), PAPER["friction_coefficient"], 1e-6

    def displacement(path):
        found = cddf.trace(BODY, path, throw=False).tendon_displacement
        return found, found

    inverse, values = jax.jit(jax.jacfwd(displacement, has_aux=True))(path)

    def tension(numbers):
        body = paper_body("exact", friction_coefficient=numbers[0])
        return cddf.trace(body, cddf.Displacement(numbers[1:]), throw=False).base_tension

    derivatives = both_modes(tension)
    _, forward, reverse = derivatives(jnp.append(mu, values))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(forward[:, 1:] @ inverse, np.eye(4), atol=1e-9)
    above, below = (derivatives(jnp.append(mu + change, values))[0] for change in (step, -step))
    np.testing.assert_allclose(forward[:, 0], (above - below) / (2 * step), rtol=1e-6)


def test_what_came_before():
    """From 75 to 60 N: tip tension, angle and front as test_trace.py has them of a loop of the paper."""
    found = cddf.trace(BODY, [60.0], before=75.0)
    tip = found.tip_tension[0], np.degrees(found.tip_angle[0])
    np.testing.assert_allclose(tip, [45.122927, 67.619267], atol=6e-7)
    np.testing.assert_allclose(1e3 * found.front, [51.564], atol=6e-4)
    np.testing.assert_array_equal(found.num_turns, [2])
    with pytest.raises(ValueError, match=r'before must be "rest" or base tensions, N, .*, got .full.'):
        cddf.trace(BODY, [40.0], before="full")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="before and start both give the history"):
        cddf.trace(BODY, [40.0], before=75.0, start=found)
    with pytest.raises(ValueError, match=r"one number for each step, got the shapes \(\)"):
        cddf.trace(BODY, cddf.Displacement(0.01))


@pytest.mark.slow
def test_a_tension_before_displacements():
    """The same motions of a tendon with drag, whose later steps are given as displacements: loops that close."""
    body = paper_body("exact", drag=5.0)
    whole = cddf.trace(body, PATH)
    found = cddf.trace(body, cddf.Displacement(whole.tendon_displacement[1:]), before=PATH[0])
    np.testing.assert_allclose(found.base_tension, PATH[1:], rtol=1e-10)
    for name in ("tip_angle", "front", "num_turns"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name)[1:], rtol=1e-9)


@pytest.mark.slow
def test_derivative_by_what_came_before():
    """Mu phi = ln[y (y_0 + g) / ((y + y_0) / 2)^2] with y_0 = 1/T of what came before; without g in its derivative."""
    mu, y, y0 = PAPER["friction_coefficient"], 1 / 60.0, 1 / 75.0
    g = 1 / float(cddf.solve(BODY, 75.0).tip_tension[0]) - y0
    slope = jax.grad(lambda before: cddf.trace(BODY, [60.0], before=before).tip_angle[0])(75.0)
    np.testing.assert_allclose(slope, (1 / (y0 + g) - 2 / (y + y0)) / mu * -(y0**2), rtol=1e-9)
