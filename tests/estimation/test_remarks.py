"""What a fit remarks: outliers, groups that are not explained, parameters at their bounds."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from straight_line import B_HAT, COVARIANCE, DESIGN, NOISY, SIGMA, START, X, line

from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.remarks import chance_of_more


def test_a_product_of_many_rows():
    """30,000 rows: what needs a square matrix of them needs 7 GB."""
    x = np.linspace(0.0, 3.0, 30_000)
    fit = least_squares_fit(lambda p: p["c"] * p["d"] * x, {"c": 1.0, "d": 1.0}, 2.0 * x + 0.1 * np.cos(50 * x), 0.1)
    value, error, _ = fit.combinations["c * d"]
    assert value == pytest.approx(np.sum(x * (2.0 * x + 0.1 * np.cos(50 * x))) / np.sum(x**2), rel=1e-6)
    assert error == pytest.approx(0.1 / np.sqrt(np.sum(x**2)), rel=1e-6)


@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_an_outlier_is_pointed_out(sigma):
    data = NOISY.copy()
    data[7] += 10 * SIGMA
    fit = least_squares_fit(line, START, data, sigma)
    assert fit.remarks == ("entry 8 of data lies far off the model: check it, or leave it out",)


def test_honest_noise_has_hardly_ever_an_outlier():
    """One experiment in a hundred; of 100, more than 5 one time in a thousand."""
    rng = np.random.default_rng(5)
    alarms = [least_squares_fit(line, START, DESIGN @ [2.0, 0.5] + SIGMA * rng.normal(size=30)) for _ in range(100)]
    assert sum(bool(fit.remarks) for fit in alarms) <= stats.binom.ppf(0.999, 100, 0.01)


def test_data_without_residuals_show_no_noise():
    fit = least_squares_fit(line, START, DESIGN @ [2.0, 0.5])
    assert fit.remarks == (
        "data is met exactly, its noise cannot be estimated: standard errors mean nothing; give the noise",
    )
    assert least_squares_fit(line, START, DESIGN @ [2.0, 0.5], SIGMA).remarks == ()


def test_a_wrong_minimum_that_explains_nothing():
    """sin(25 x) from a start at sin(5 x)."""
    x = np.linspace(0.0, 1.0, 30)
    predict = lambda p: jnp.sin(p["w"] * x)  # noqa: E731
    fit = least_squares_fit(predict, {"w": 5.0}, np.sin(25 * x), 0.01, starts=1)
    assert abs(fit.value["w"] - 25) > 1
    assert (fit.success, fit.status) == (False, {"w": "not identified"})
    assert fit.standard_error == {"w": np.inf}
    assert fit.result.startswith("hardly anything of data is explained")
    assert any("hardly explained at all" in remark for remark in fit.remarks)
    again = least_squares_fit(predict, {"w": 5.0}, np.sin(25 * x), 0.01)
    assert again.value["w"] == pytest.approx(25)
    assert again.restarted.startswith("the search from the given start failed (hardly anything of data is explained")


def test_a_group_that_is_hardly_explained_beside_one_that_is():
    """A slope through 0 that a constant cannot follow, in fewer than half of the readings."""
    data = {"x": NOISY, "y": X[:9] - np.mean(X[:9])}
    fit = least_squares_fit(lambda p: {"x": line(p), "y": p["c"] * jnp.ones(9)}, START | {"c": 1.0}, data, SIGMA)
    assert fit.success
    assert any(remark.startswith("y is hardly explained at all") for remark in fit.remarks)


def test_repeats_of_one_level_are_explained():
    """Their scatter is noise and nothing else, and their mean is told by it."""
    data = 5.0 + 0.1 * np.random.default_rng(1).normal(size=30)
    fit = least_squares_fit(lambda p: p["a"] + 0 * X, {"a": 1.0}, data)
    assert (fit.success, fit.status) == (True, {"a": "identified"})
    assert fit.value["a"] == pytest.approx(data.mean(), rel=1e-9)


@pytest.mark.parametrize("sigma", [None, {"x": SIGMA}])
def test_more_columns_are_tested_against_the_noise_of_their_group(sigma):
    """Two lines that share nothing: the F or chi-square test of two more columns is that of one line alone."""
    few, bent = X[:9], 0.02 * X[:9] ** 2

    def lines(p):
        return {"x": p["a"] + p["b"] * few, "y": p["c"] + p["d"] * X}

    data = {"x": NOISY[:9] + bent, "y": 30 * NOISY}
    fit = least_squares_fit(lines, {"a": 1.0, "b": 1.0, "c": 30.0, "d": 20.0}, data, sigma)
    powers = few[:, None] ** np.arange(4)
    left = [np.linalg.lstsq(powers[:, :count], data["x"])[1][0] for count in (2, 4)]
    chance = chance_of_more(fit.evidence, fit.standardised_residuals, "x", powers[:, 2:] / fit.noise["x"])
    if sigma:
        assert chance == pytest.approx(stats.chi2.sf((left[0] - left[1]) / SIGMA**2, 2), rel=1e-4)
    else:
        assert chance == pytest.approx(stats.f.sf((left[0] - left[1]) / 2 / (left[1] / 5), 2, 5), rel=1e-3)


def test_a_parameter_near_its_bound_has_an_upper_limit():
    """A slope of 0.3 standard errors, at least 0: at most itself and 1.96 standard errors."""
    error = SIGMA * np.sqrt(COVARIANCE[1, 1])
    data = NOISY - (B_HAT - 0.3 * error) * X
    fit = least_squares_fit(line, {"a": 1.0, "b": 1.0}, data, SIGMA, {"b": (0.0, None)})
    assert (fit.status["b"], fit.bounded_above) == ("not identified", ("b",))
    expected = (0.3 + stats.norm.ppf(0.975)) * error
    assert fit.confidence_interval["b"] == (0.0, pytest.approx(expected, rel=1e-3))


def test_residuals_that_grow_are_reported():
    """Noise of 1 % and of one size, the same draws; a line from 1 to 31."""
    x, draws = np.linspace(0.0, 3.0, 40), np.random.default_rng(5).normal(size=40)
    truth = 1.0 + 10.0 * x
    grown = least_squares_fit(lambda p: p["a"] + p["b"] * x, START, truth * (1 + 0.01 * draws))
    even = least_squares_fit(lambda p: p["a"] + p["b"] * x, START, truth + 0.1 * draws)
    assert any("residuals grow with the reading" in remark for remark in grown.remarks)
    assert not any("residuals grow" in remark for remark in even.remarks)
