"""Work, loss and stored energy of a path, against the closed form of a cycle, a table and the balance of energy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, paper_body, paper_plain

import cddf_jax as cddf

OFFSET, MU = PAPER["tendon_offset"], PAPER["friction_coefficient"]
END = MU / PAPER["youngs_modulus"] * paper_plain().compliance(PAPER["length"])  # times the integral of d / J
LOOP = [75.0, 60.0, 40.0, 20.0, 5.0, 0.0, 50.0, 75.0]


def residual(history):
    """Of the balance of energy, over the work done."""
    found = history.energies
    return np.max(np.abs(found.work - found.stored_energy - found.friction_loss)) / np.max(found.work)


def test_a_loop_of_the_paper():
    """The losses are those of an independent derivation; the pull by W = (d / mu) [T - ln(1 + g T) / g]."""
    history = cddf.trace(paper_body("exact"), LOOP)
    lost = [59.726, 60.423, 70.931, 96.029, 99.290, 99.331, 121.449, 159.057]
    found = history.energies
    np.testing.assert_allclose(1e3 * found.friction_loss, lost, atol=6e-4)
    work = OFFSET / MU * (75 - np.log(1 + END * 75) / END)
    stored = OFFSET / (2 * MU) * (75 - 75 / (1 + END * 75))
    np.testing.assert_allclose([found.work[0], found.stored_energy[0]], [work, stored], rtol=1e-10)
    np.testing.assert_allclose(found.friction_loss[5], 99.331129456e-3, rtol=1e-9)  # the cycle
    recovered = 180.084821e-3 + 135.989798e-3
    np.testing.assert_allclose(found.work[0] - found.work[5], recovered, atol=2e-9)
    assert residual(history) < 1e-10


@pytest.mark.slow
def test_a_history_goes_on():
    """The same loop once more, from its end on: all comes back, and it loses again what it has lost since the pull."""
    history = cddf.trace(paper_body("exact"), LOOP)
    on = cddf.trace(paper_body("exact"), LOOP, start=history)
    for name in ("tip_tension", "tip_angle", "tip_position", "tendon_displacement"):
        np.testing.assert_allclose(getattr(on, name), getattr(history, name), rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(on.num_turns, history.num_turns)
    again, before = on.energies, history.energies
    np.testing.assert_allclose(again.stored_energy, before.stored_energy, rtol=1e-9, atol=1e-15)
    for name in ("work", "friction_loss"):
        values = np.asarray(getattr(before, name))
        np.testing.assert_allclose(getattr(again, name), values[7] + values - values[0], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"kinematics": "published"}, {"tendon_offset": (0.012, 0.008), "drag": 8.0}])
def test_increments_lose_the_same(changes):
    """Friction and slip of each increment, which know no fronts. The published moment does not do the work of x."""
    body, path = paper_body(**{"kinematics": "exact", **changes}), [75.0, 40.0, 60.0, 0.0]
    history, found = cddf.trace(body, path), cddf.trace(body, path, cddf.Loads(), nodes=8, short_steps=32)
    np.testing.assert_allclose(found.energies.friction_loss, history.energies.friction_loss, rtol=2e-3)
    np.testing.assert_allclose(found.energies.work, history.energies.work, rtol=2e-3)
    if "kinematics" in changes:
        assert 1e-3 < residual(history) < 0.1


@pytest.mark.slow
def test_a_body_of_two_pieces_and_a_tendon_that_stretches():
    tendon = cddf.Tendon(0.010, 1, axial_stiffness=2e3, free_length=0.2)
    stiffness = cddf.Piecewise(ends=(0.06,), pieces=(0.12, 0.05))
    body = cddf.Manipulator(length=0.14, tendons=(tendon,), bending_stiffness=stiffness, friction_coefficient=0.42)
    history = cddf.trace(body, [60.0, 20.0, 45.0, 30.0, 70.0, 0.0])
    assert residual(history) < 1e-9
    assert history.energies.stored_energy[0] > 60.0**2 * 0.2 / 2e3 / 2  # that of the stretch outside


@pytest.mark.slow
def test_a_tendon_that_ends_before_the_tip():
    """With friction a loop loses what it does not store; without it gives all its work back."""
    tendons, stiffness = [cddf.Tendon(0.0045, end=0.06)], 2.5e-3
    for friction in (0.42, 0.0):
        body = cddf.Manipulator(0.18, tendons=tendons, bending_stiffness=stiffness, friction_coefficient=friction)
        history = cddf.trace(body, [2.0, 4.0, 2.0, 0.0])
        assert residual(history) < 1e-9
    work = np.asarray(history.energies.work)
    np.testing.assert_allclose(work[2:], [work[0], 0.0], atol=1e-9 * work[1])


@pytest.mark.slow
def test_derivatives_of_the_loss():
    """Of a pull by the closed form, in both modes; of a loop by differences."""
    at = jnp.array([MU, 75.0, 50.0, 60.0, 20.0])

    def lost(numbers):
        body = paper_body("exact", friction_coefficient=numbers[0])
        return cddf.trace(body, numbers[1:], throw=False).energies.friction_loss

    derivatives = both_modes(lost)
    _, forward, reverse = derivatives(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)

    def in_closed_form(mu):
        g = END / MU * mu
        return OFFSET / mu * (75 - jnp.log(1 + g * 75) / g) - OFFSET / (2 * mu) * (75 - 75 / (1 + g * 75))

    np.testing.assert_allclose(forward[0, 0], jax.grad(in_closed_form)(MU), rtol=1e-9)
    for k, step in ((0, 1e-5), (2, 1e-3), (4, 1e-3)):
        above, below = (derivatives(at.at[k].add(change))[0] for change in (step, -step))
        np.testing.assert_allclose(forward[:, k], (above - below) / (2 * step), rtol=1e-6, atol=1e-9 * (k > 0))
