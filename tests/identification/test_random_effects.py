"""Friction that differs from trial to trial, on data with closed-form answers."""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.identification.parameters import TRIALS
from cddf_jax.identification.random_effects import fit_trials

COUNT, EACH = 5, 4
TRIAL = np.repeat(np.arange(COUNT), EACH)


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_balanced_trials(spread):
    """A level in five trials of four readings: the variance of its mean is that between trials, with four degrees.

    The textbook interval of a balanced random one-way layout is exact. The spread is
    the mean square between trials less that within, over the readings of a trial.
    """
    rng = np.random.default_rng(4)
    data = 3.0 + spread * rng.normal(size=COUNT)[TRIAL] + 0.4 * rng.normal(size=TRIAL.size)

    def predict(p):
        return {"read": p["level"] + jnp.asarray(p[TRIALS])[TRIAL]}

    search = partial(least_squares_fit, predict, observed={"read": data})
    fit, found = fit_trials(search, COUNT, {"level": 2.0}, {}, {}, None)
    means = data.reshape(COUNT, EACH).mean(axis=1)
    between = EACH * np.var(means, ddof=1)
    within = np.sum((data - means[TRIAL]) ** 2) / (COUNT * (EACH - 1))
    error = np.sqrt(between / data.size)
    low, high = fit.confidence_interval["level"]
    assert fit.value["level"] == pytest.approx(data.mean(), rel=1e-6)
    assert found == pytest.approx(np.sqrt((between - within) / EACH), rel=5e-3)
    assert fit.standard_error["level"] == pytest.approx(error, rel=5e-3)
    assert (high - low) / 2 == pytest.approx(stats.t.ppf(0.975, COUNT - 1) * error, rel=5e-3)
