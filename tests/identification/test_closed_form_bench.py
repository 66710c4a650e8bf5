"""Fits to readings of one tendon at a constant offset, by its closed form T = T_0 / (1 + mu T_0 d s / (E J))."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

import cddf_jax as cddf
from cddf_jax.estimation.determination import determine

LENGTH, OUTER, INNER, OFFSET, MU, E = 0.14, 0.012, 0.007, 0.009, 0.3, 1.4e6
BODY = cddf.Manipulator(
    length=LENGTH,
    outer_radius=OUTER,
    inner_radius=INNER,
    tendons=[cddf.Tendon(OFFSET)],
    youngs_modulus=1e6,
    friction_coefficient=0.2,
)


def readings(rng, tension, mu: ArrayLike = MU, error=0.0):
    """Tip tension, tip angle and tip_x with noise, where base tensions are larger than read by their errors."""
    steps = np.linspace(0.0, LENGTH, 2001)
    true = (tension + error * rng.normal(size=tension.size) if error else tension)[:, None]
    mu = np.broadcast_to(mu, tension.shape)[:, None]
    turned = np.log1p(mu * true * OFFSET * steps / (E * np.pi / 4 * (OUTER**4 - INNER**4))) / mu
    tip = (true * np.exp(-mu * turned[:, -1:]))[:, 0] + 0.05 * rng.normal(size=tension.size)
    angle = turned[:, -1] + 0.005 * rng.normal(size=tension.size)
    along = np.trapezoid(np.cos(turned), steps, axis=1) + 2e-4 * rng.normal(size=tension.size)
    return {"base_tension": tension, "tip_tension": tip, "tip_angle": angle, "tip_x": along}


@pytest.mark.slow
def test_noise_that_goes_to_zero_slowly_beside_that_of_the_base():
    """The noise of the tip cell hides below 0.15 N of the base cell; its estimate creeps on for hundreds of rounds."""
    table = readings(np.random.default_rng(72), np.tile([3.0, 6, 9, 12, 15], 3), error=0.15)
    fit = cddf.fit(BODY, cddf.Measurements.from_columns("x", **table), noise={"base_tension": 0.15})
    assert (fit.success, fit.restarted) == (True, "")
    for name, truth in (("friction_coefficient", MU), ("youngs_modulus", E)):
        low, high = fit.confidence_interval[name]
        assert low < truth < high


@pytest.mark.slow
def test_differences_of_trials_are_no_parameters_of_the_report():
    """The friction of six trials is not told to half of their spread, but many differences of two trials are."""
    rng, trial = np.random.default_rng(0), np.repeat(np.arange(6), 5)
    table = readings(rng, np.tile([3.0, 6, 9, 12, 15], 6), np.repeat(MU * np.exp(0.1 * rng.normal(size=6)), 5))
    fit = cddf.fit(BODY, cddf.Measurements.from_columns("x", trial=trial, **table), per_trial=True)
    assert determine(fit.widened).sums
    assert fit.sums == fit.combinations == {}
    assert not any("trial_deviation" in line for line in fit.verdict)
