"""Losses that outliers pull less, against SciPy, quadrature and simulation."""

from itertools import combinations_with_replacement

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, optimize, stats

from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.observations import Noise
from cddf_jax.estimation.robust_loss import HUBER, LOSSES

LOSS = LOSSES["huber"]
X = np.linspace(0.0, 3.0, 60)
START = {"a": 1.0, "b": 1.0}


def line(p):
    return p["a"] + p["b"] * X


def decay(p):
    return p["height"] * jnp.exp(-p["rate"] * X) + p["floor"]


def with_outliers(rng, clean, sigma=0.05, share=0.15, shift=1.0):
    """Gaussian noise, and some readings far too high."""
    return clean + sigma * rng.normal(size=clean.shape) + shift * (rng.random(clean.shape) < share)


# --- the functions -------------------------------------------------------------------------------

RESIDUALS = np.array([-1e6, -30.0, -2.0, -1.0, -1e-3, -1e-9, 0.0, 1e-9, 1e-4, 0.5, 1.3, 1.4, 3.0, 1e3, 1e8])


def test_squares_are_those_of_scipy():
    """SciPy's rho(z) of z = (r / C)^2, from the text of scipy.optimize.least_squares; C^2 rho is what it sums."""
    rho, z = np.asarray(LOSS.transformed(jnp.asarray(RESIDUALS))) ** 2, (RESIDUALS / HUBER) ** 2
    np.testing.assert_allclose(rho, HUBER**2 * np.where(z <= 1, z, 2 * np.sqrt(z) - 1), rtol=1e-8, atol=1e-15)


def test_influence_and_slope_are_derivatives():
    half_rho = jax.vmap(jax.grad(lambda r: LOSS.transformed(r) ** 2 / 2))
    np.testing.assert_allclose(LOSS.influence(RESIDUALS), half_rho(jnp.asarray(RESIDUALS)), rtol=1e-7)
    step = 1e-6 * np.maximum(1.0, np.abs(RESIDUALS))
    slope = (LOSS.influence(RESIDUALS + step) - LOSS.influence(RESIDUALS - step)) / (2 * step)
    np.testing.assert_allclose(LOSS.slope(RESIDUALS), slope, atol=1e-8)
    assert float(jax.grad(LOSS.transformed)(0.0)) == 1.0


def test_efficiency_is_95_per_cent():
    """Of a location estimate under Gaussian noise (E psi')^2 / E psi^2, Huber (1981); by quadrature."""

    def mean(f):
        return 2 * sum(
            integrate.quad(lambda r: f(np.float64(r)) * stats.norm.pdf(r), *ends)[0]
            for ends in ((0.0, HUBER), (HUBER, 40.0))
        )

    slope, spread = mean(LOSS.slope), mean(lambda r: LOSS.influence(r) ** 2)
    assert slope**2 / spread == pytest.approx(0.95, abs=2e-4)  # the constants have five digits


# --- fits ----------------------------------------------------------------------------------------


def test_scipy_least_squares_agrees():
    sigma = 0.05
    data = with_outliers(np.random.default_rng(1), 3.0 * np.exp(-0.8 * X) + 0.5)
    start = {"height": 2.0, "rate": 1.0, "floor": 1.0}
    fit = least_squares_fit(decay, start, data, sigma, loss="huber")
    expected = optimize.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * X) + p[2] - data) / sigma,
        x0=[2.0, 1.0, 1.0],
        loss="huber",
        f_scale=HUBER,
        **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-14),
    )
    assert fit.success, fit.result
    assert fit.loss == "huber"
    # where the least of the loss is flat, SciPy's own steps stop at 1e-5
    np.testing.assert_allclose([fit.value[n] for n in ("height", "rate", "floor")], expected.x, rtol=1e-5)


def test_a_prior_is_not_softened():
    """A mean of 20 equal readings that a narrow prior pulls 50 deviations off: Huber's psi of all is its constant."""
    deviation, readings = 0.01, np.zeros(20)
    fit = least_squares_fit(
        lambda p: p["a"] + 0 * readings, {"a": 5.0}, readings, 0.1, loss="huber", priors={"a": (10.0, deviation)}
    )
    expected = 10.0 - 20 * HUBER / 0.1 * deviation**2  # 20 C / sigma = (mean - a) / deviation^2
    assert fit.value["a"] == pytest.approx(expected, rel=1e-8)


def test_noise_is_the_median():
    """1.4826 times the median of |residual| is the deviation of a Gaussian; two parameters are fitted."""
    data = with_outliers(np.random.default_rng(3), 2.0 + 0.5 * X)
    fit = least_squares_fit(line, START, data, loss="huber")
    factor = 1 / stats.norm.ppf(0.75)
    residuals = data - fit.value["a"] - fit.value["b"] * X
    expected = factor * np.median(np.abs(residuals)) * np.sqrt(60 / 58)
    assert fit.noise["data"] == pytest.approx(expected, rel=2e-4)


@pytest.mark.slow
def test_standard_errors_against_simulation():
    """200 data sets, outliers of both signs: the scatter of the slope is its standard error."""
    fits = []
    for seed in range(200):
        rng = np.random.default_rng((5, seed))
        noise = 0.05 * rng.normal(size=X.size) * np.where(rng.random(X.size) < 0.1, 10.0, 1.0)
        fits.append(least_squares_fit(line, {"a": 2.0, "b": 0.5}, 2.0 + 0.5 * X + noise, loss="huber"))
    slopes, errors = (np.array([f.value["b"] for f in fits]), np.array([f.standard_error["b"] for f in fits]))
    assert all(f.success for f in fits)
    # four standard errors of a spread from 200 draws
    assert np.std(slopes) / np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=4 / np.sqrt(2 * 200))
    assert abs(np.mean(slopes) - 0.5) < 4 * np.std(slopes) / np.sqrt(200)


# --- what else a fit has, under a robust loss ----------------------------------------------------


def test_floor_and_fraction_with_outliers():
    """Without a robust loss ten readings of 300 that are far off would multiply floor and fraction."""
    x = np.linspace(1.0, 100.0, 300)
    rng = np.random.default_rng(6)
    data = 2.0 * x + rng.normal(size=300) * np.hypot(0.5, 0.02 * 2.0 * x)
    data[rng.choice(300, 10, replace=False)] += 80.0
    fit, misled = (
        least_squares_fit(lambda p: p["a"] * x, {"a": 1.0}, data, Noise(), loss=loss) for loss in ("huber", "linear")
    )
    floor, fraction = fit.noise_model["data"]
    assert fit.success, fit.result
    assert fraction == pytest.approx(0.02, rel=0.25)  # four standard errors, and 3 % of outliers
    assert floor < 2.0
    assert max(misled.noise_model["data"].floor / 0.5, misled.noise_model["data"].fraction / 0.02) > 3


def test_bootstrap_of_cases_counts_a_datum_twice():
    """A datum drawn twice is there twice: of three clusters there are ten draws, refitted here by SciPy."""
    data = with_outliers(np.random.default_rng(8), 2.0 + 0.5 * X)
    fit = least_squares_fit(line, START, data, 0.05, loss="huber")
    found = fit.bootstrap("cases", 40, clusters={"data": ("trial", np.arange(60) % 3)})
    possible = []
    for drawn in combinations_with_replacement(range(3), 3):
        rows = np.concatenate([np.arange(k, 60, 3) for k in drawn])
        answer = optimize.least_squares(
            lambda p, x=X[rows], y=data[rows]: (p[0] + p[1] * x - y) / 0.05,
            [2.0, 0.5],
            loss="huber",
            f_scale=HUBER,
            **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-14),
        )
        possible.append(answer.x)
    distance = np.abs(found.estimates[:, None] - np.array(possible)).max(axis=2)
    assert np.all(distance.min(axis=1) < 1e-4)
    assert len(set(distance.argmin(axis=1))) > 5
    assert found.num_failed == 0
