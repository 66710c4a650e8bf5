"""Profiles of a likelihood, against the t interval of linear models and refits by SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from kinds import root_of
from scipy import optimize, stats
from straight_line import (
    A_HAT,
    B_HAT,
    COVARIANCE,
    NOISY,
    RSS,
    SIGMA,
    START,
    X,
    decay,
    line,
    line_beside,
    posterior_with,
    without_a_number,
)

from cddf_jax.errors import InputError
from cddf_jax.estimation.least_squares import least_squares_fit

NORMAL = stats.norm.ppf(0.975)
B_ERROR = SIGMA * np.sqrt(COVARIANCE[1, 1])


# --- a linear model ------------------------------------------------------------------------------


@pytest.mark.parametrize(("sigma", "name", "i"), [(SIGMA, "a", 0), (None, "b", 1)])
def test_a_linear_model_has_its_t_interval(sigma, name, i):
    spread, quantile = (SIGMA, NORMAL) if sigma else (np.sqrt(RSS / 28), stats.t.ppf(0.975, 28))
    profile = least_squares_fit(line, START, NOISY, sigma).profile(name)
    half_width = float(quantile * spread * np.sqrt(COVARIANCE[i, i]))
    expected = [A_HAT, B_HAT][i] + half_width * np.array([-1, 1])
    # estimated noise settles to 1e-4
    np.testing.assert_allclose(
        profile.confidence_interval, expected, atol=(2e-4 if sigma is None else 1e-5) * half_width
    )
    assert profile.closed == (True, True)
    assert profile.threshold == pytest.approx(quantile**2)


def test_rows_of_a_linear_model():
    """The rise is ((b - best) / error)^2."""
    profile = least_squares_fit(line, START, NOISY, SIGMA).profile("b")
    np.testing.assert_allclose(profile.rise, ((profile.value - B_HAT) / B_ERROR) ** 2, rtol=1e-4, atol=1e-6)
    assert np.all(np.diff(profile.value) > 0)


def test_a_prior_counts():
    fit = least_squares_fit(line, START, NOISY, SIGMA, priors={"b": (0.6, 0.02)})
    (_, mean), covariance = posterior_with(0.6, 0.02)
    half_width = NORMAL * np.sqrt(covariance[1, 1])
    np.testing.assert_allclose(fit.profile("b").confidence_interval, [mean - half_width, mean + half_width], rtol=1e-5)


# --- curved models -------------------------------------------------------------------------------

DECAY = 3.0 * np.exp(-0.8 * X) + 0.5 + 0.15 * np.random.default_rng(2).normal(size=X.size)
TRUTH = {"height": 3.0, "rate": 0.8, "floor": 0.5}


def held_rate(rate):
    """Sum of squares with the rate held: what is left is linear."""
    columns = np.stack([np.exp(-rate * X), np.ones_like(X)], axis=1)
    return np.sum((DECAY - columns @ np.linalg.lstsq(columns, DECAY, rcond=None)[0]) ** 2)


def held_height(height):
    """Sum of squares with the height held, by SciPy's own least squares."""
    best, _ = optimize.curve_fit(
        lambda x, rate, floor: height * np.exp(-rate * x) + floor, X, DECAY, p0=[0.8, 0.5], ftol=1e-13, xtol=1e-13
    )
    return np.sum((DECAY - height * np.exp(-best[0] * X) - best[1]) ** 2)


@pytest.mark.parametrize(("name", "held", "reach"), [("rate", held_rate, 0.7), ("height", held_height, 1.5)])
def test_a_curved_model(name, held, reach):
    fit = least_squares_fit(decay, TRUTH, DECAY)
    profile = fit.profile(name)
    best = fit.value[name]
    least = held(best)
    limit = least * (1 + stats.t.ppf(0.975, 27) ** 2 / 27)  # the noise is the residual standard deviation
    expected = [root_of(lambda v: held(v) - limit, best, best + side * reach) for side in (-1, 1)]
    np.testing.assert_allclose(profile.confidence_interval, expected, rtol=2e-4)
    below, above = best - expected[0], expected[1] - best
    assert abs(above / below - 1) > 0.05  # the interval of the linearisation is another
    assert profile.closed == (True, True)


@pytest.mark.parametrize("bounds", [None, {"a": (0.0, None), "b": (0.0, None)}])
def test_a_product_is_open_ended(bounds):
    """Of a product no factor has an end above; below it ends at 0, where the product is none."""
    fit = least_squares_fit(lambda p: p["a"] * p["b"] * X, {"a": 2.0, "b": 0.25}, NOISY - 2.0, SIGMA, bounds)
    profile = fit.profile("a")
    assert profile.confidence_interval[0] == pytest.approx(0.0, abs=1e-2 * fit.value["a"])
    assert profile.confidence_interval[1] == np.inf
    assert profile.closed == (bounds is None, False)
    inside = profile.value > 1e-2 * fit.value["a"]
    np.testing.assert_allclose(profile.rise[inside], 0.0, atol=1e-4)
    assert np.max(profile.value) > 100 * fit.value["a"]


def test_a_side_that_flattens_is_open():
    """1 - exp(-a x) where a x is large: the data say at least how large, and no more."""
    x = np.array([1.0, 2.0, 3.0])
    data = 1.0 - np.exp(-3.0 * x)
    fit = least_squares_fit(lambda p: 1 - jnp.exp(-p["a"] * x), {"a": 3.0}, data, 0.05, {"a": (0.0, None)})
    profile = fit.profile("a")
    low = root_of(lambda a: np.sum(((np.exp(-a * x) - np.exp(-3 * x)) / 0.05) ** 2) - NORMAL**2, 0.1, 3.0)
    assert profile.closed == (True, False)
    assert profile.confidence_interval == (pytest.approx(low, rel=1e-4), np.inf)


def test_bounds_are_respected():
    """A slope with bounds at half of its interval: it ends at the bounds, open."""
    low, high = B_HAT - B_ERROR, B_HAT + B_ERROR
    fit = least_squares_fit(line, {"a": 1.0, "b": B_HAT}, NOISY, SIGMA, {"b": (low, high)})
    profile = fit.profile("b")
    assert profile.confidence_interval == (low, high)
    assert profile.closed == (False, False)
    assert np.all((profile.value >= low) & (profile.value <= high))


def test_an_estimate_at_its_bound():
    """From a bound at 0.55 upwards: (b - best)^2 - (0.55 - best)^2 = (1.96 error)^2."""
    fit = least_squares_fit(line, {"a": 1.0, "b": 1.0}, NOISY, SIGMA, {"b": (0.55, None)})
    assert fit.status["b"] == "at bound"
    profile = fit.profile("b")
    high = B_HAT + np.sqrt((NORMAL * B_ERROR) ** 2 + (0.55 - B_HAT) ** 2)
    assert profile.confidence_interval == (0.55, pytest.approx(high, rel=1e-4))
    assert profile.closed == (False, True)


def test_a_model_that_ends():
    """The root of a is no number below 0. In r = sqrt(a) the model is linear: the upper end is (r + 1.96 error)^2."""
    sigma = 1.0
    error = sigma / np.sqrt(np.sum(X**2))
    rng = np.random.default_rng(3)
    data = 1.2 * error * X
    data += 0.1 * (noise := rng.normal(size=X.size)) - 0.1 * X * np.sum(noise * X) / np.sum(X**2)  # the root stays
    fit = least_squares_fit(lambda p: jnp.sqrt(p["a"]) * X, {"a": 0.1}, data, sigma)
    profile = fit.profile("a")
    root = 1.2 * error
    assert fit.value["a"] == pytest.approx(root**2, rel=1e-5)
    low, high = profile.confidence_interval
    assert high == pytest.approx((root + NORMAL * error) ** 2, rel=1e-4)
    assert 0 <= low < 0.02 * root**2
    assert profile.closed == (False, True)  # the data have not spoken where the model ends
    assert profile.model_ends == (True, False)
    assert np.all(np.isinf(profile.rise[profile.value < 0]))
    assert np.any(profile.value < 0)


@pytest.mark.parametrize(
    ("predict", "start", "name"), [(without_a_number, {"a": -1.0}, "a"), (line_beside, START | {"c": 1.0}, "c")]
)
def test_without_a_number_or_an_effect_there_is_no_interval(predict, start, name):
    profile = least_squares_fit(predict, start, NOISY, SIGMA).profile(name)
    assert profile.confidence_interval == (-np.inf, np.inf)
    assert profile.closed == (False, False)
    if name == "c":
        np.testing.assert_allclose(profile.rise, 0.0, atol=1e-6)


def test_refusals():
    fit = least_squares_fit(line, START, NOISY, SIGMA)
    with pytest.raises(InputError, match=r"^profile: 'c' was not fitted; fitted are a, b$"):
        fit.profile("c")
