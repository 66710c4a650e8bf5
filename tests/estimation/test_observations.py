"""Noise that grows with the reading, against likelihoods that SciPy maximises."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

from cddf_jax.errors import InputError
from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.observations import Noise

X = np.linspace(0.2, 20.0, 80)
DESIGN = np.stack([np.ones_like(X), X], axis=1)
FLOOR, FRACTION = 0.1, 0.03
CLEAN = 1.0 + 2.0 * X
START = {"a": 1.5, "b": 1.5}


def line(p):
    return p["a"] + p["b"] * X


def readings(seed, clean=CLEAN):
    return clean + np.hypot(FLOOR, FRACTION * clean) * np.random.default_rng(seed).normal(size=clean.size)


def weighted(y, variance):
    """Estimate, covariance and residuals of weighted linear least squares."""
    covariance = np.linalg.inv(DESIGN.T @ (DESIGN / variance[:, None]))
    estimate = covariance @ DESIGN.T @ (y / variance)
    return estimate, covariance, y - DESIGN @ estimate


def restricted(y, floor, fraction):
    """Floor, fraction (None: the most likely) and estimate of a line, by restricted likelihood.

    Patterson and Thompson (1971). The variance goes by the line itself, which is held while the likelihood is
    maximised over floor and fraction, and then drawn anew, until both agree.
    """

    def parts(logs):
        free = iter(np.exp(logs))
        return (next(free) if floor is None else floor), (next(free) if fraction is None else fraction)

    def cost(logs, predicted):
        f, g = parts(logs)
        variance = f**2 + (g * predicted) ** 2
        _, covariance, residual = weighted(y, variance)
        return np.sum(np.log(variance)) - np.linalg.slogdet(covariance)[1] + np.sum(residual**2 / variance)

    def another_round(predicted, logs):
        if logs.size:
            options = {"xatol": 1e-8, "fatol": 1e-11, "maxiter": 2000}
            logs = optimize.minimize(cost, logs, args=(predicted,), method="Nelder-Mead", options=options).x
        f, g = parts(logs)
        return logs, f, g, *weighted(y, f**2 + (g * predicted) ** 2)[:2]

    found = another_round(y, np.log([0.2, 0.05][: (floor is None) + (fraction is None)]))
    for _ in range(11):
        found = another_round(DESIGN @ found[3], found[0])
    return found[1:]


def kenward_roger(design, covariance, parts, row):
    """Half-width of the 95 % interval of row @ estimate by Kenward and Roger (1997), Biometrics 53, 983: full matrices.

    The covariance of the data is linear in the estimated variances, and `parts` are its derivatives. The information of
    restricted likelihood on these variances is that of Patterson and Thompson (1971). One row has the degrees of
    freedom of Satterthwaite (1946).
    """
    inverse = np.linalg.inv(covariance)
    phi = np.linalg.inv(design.T @ inverse @ design)
    projector = inverse - inverse @ design @ phi @ design.T @ inverse
    if not parts:
        return stats.norm.ppf(0.975) * np.sqrt(row @ phi @ row)
    weight = np.linalg.inv([[0.5 * np.trace(projector @ a @ projector @ b) for b in parts] for a in parts])
    slopes = [-design.T @ inverse @ a @ inverse @ design for a in parts]
    more = np.zeros_like(phi)
    for i, a in enumerate(parts):
        for k, b in enumerate(parts):
            both = design.T @ inverse @ a @ inverse @ b @ inverse @ design
            more += weight[i, k] * (both - slopes[i] @ phi @ slopes[k])
    by_part = np.array([-row @ phi @ slope @ phi @ row for slope in slopes])
    freedom = 2 * (row @ phi @ row) ** 2 / (by_part @ weight @ by_part)
    return stats.t.ppf(0.975, freedom) * np.sqrt(row @ (phi + 2 * phi @ more @ phi) @ row)


@pytest.mark.parametrize("given", [Noise(), Noise(FLOOR, None), Noise(None, FRACTION), Noise(FLOOR, FRACTION)])
def test_restricted_likelihood(given):
    y = readings(1)
    fit = least_squares_fit(line, START, y, given)
    floor, fraction, estimate, covariance = restricted(y, *given)
    assert fit.success, fit.result
    # the fit stops where another round changes no noise by 1e-4
    assert fit.noise_model["data"] == pytest.approx((floor, fraction), rel=2e-3, abs=1e-6)
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], estimate, rtol=1e-4)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=4e-3)
    assert fit.noise_estimated == (None in given)
    f, g = np.array(fit.noise_model["data"], float)
    variance = f**2 + (g * (DESIGN @ estimate)) ** 2
    parts = [
        np.diag(part) for part, one in zip((np.ones(80), (DESIGN @ estimate) ** 2), given, strict=True) if one is None
    ]
    for row, name in zip(np.eye(2), "ab", strict=True):
        low, high = fit.confidence_interval[name]
        expected = kenward_roger(DESIGN, np.diag(variance), parts, row)
        assert (high - low) / 2 == pytest.approx(expected, rel=4e-3)
    root_mean_square = np.sqrt(np.mean(floor**2 + (fraction * (DESIGN @ estimate)) ** 2))
    assert fit.noise["data"] == pytest.approx(root_mean_square, rel=2e-3)


def test_noise_always_settles():
    """With few readings a floor is often next to zero; 10 draws of 20 readings, both parts estimated."""
    x = np.array([2.0, 5.0, 10.0, 15.0, 20.0] * 4)
    results = set()
    for seed in range(10):
        noise = np.hypot(0.1, 0.01 * 2 * x) * np.random.default_rng((5, seed)).normal(size=x.size)
        results.add(least_squares_fit(line_through_zero, {"b": 1.0}, 2.0 * x + noise, Noise()).result)
    assert results == {"successful"}


def line_through_zero(p):
    return p["b"] * jnp.asarray([2.0, 5.0, 10.0, 15.0, 20.0] * 4)


def test_units_do_not_matter():
    unit = 1e6
    fit = least_squares_fit(line, START, readings(6), Noise())
    other = least_squares_fit(line, {"a": 1.5 * unit, "b": 1.5 * unit}, unit * readings(6), Noise())
    floor, fraction = np.array(other.noise_model["data"], float)
    assert (floor / unit, fraction) == pytest.approx(fit.noise_model["data"], rel=1e-3)
    np.testing.assert_allclose(np.array(list(other.value.values())) / unit, list(fit.value.values()), rtol=1e-5)
    np.testing.assert_allclose(other.covariance / unit**2, fit.covariance, rtol=2e-3)


@pytest.mark.parametrize("sigma", [Noise(-0.1, None), Noise(0.0, 0.0), Noise(np.nan, 0.1), {"data": Noise(0.1, -1.0)}])
def test_refusals(sigma):
    with pytest.raises(InputError, match=r"^sigma of data: floor and fraction must be 0 or more, one of them > 0"):
        least_squares_fit(lambda p: {"data": line(p)}, START, {"data": readings(1)}, sigma)


SIZES, SPREADS = (6, 9), (0.1, 0.3)
LEVEL = {"a": 1.0}


def two_samples(p):
    return {name: p["a"] * jnp.ones(size) for name, size in zip("xy", SIZES, strict=True)}


def draw(rng):
    return {name: 1 + s * rng.normal(size=n) for name, n, s in zip("xy", SIZES, SPREADS, strict=True)}


def test_interval_of_a_mean_weighted_by_estimated_noise():
    """Two samples of different noise: the interval of Kenward and Roger (1997)."""
    fit = least_squares_fit(two_samples, LEVEL, draw(np.random.default_rng(3)))
    precision = np.array([size / fit.noise[name] ** 2 for name, size in zip("xy", SIZES, strict=True)])
    np.testing.assert_allclose(fit.standard_error["a"], np.sum(precision) ** -0.5, rtol=1e-6)
    low, high = fit.confidence_interval["a"]
    half_width = (high - low) / 2
    variances = [np.repeat(fit.noise[name] ** 2, size) for name, size in zip("xy", SIZES, strict=True)]
    parts = [np.diag(np.arange(15) < 6).astype(float), np.diag(np.arange(15) >= 6).astype(float)]
    expected = kenward_roger(np.ones((15, 1)), np.diag(np.concatenate(variances)), parts, np.ones(1))
    assert half_width == pytest.approx(expected, rel=1e-6)
