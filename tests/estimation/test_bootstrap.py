"""Refits to newly drawn data, against closed forms and loops over NumPy's least squares."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
from scipy import stats
from straight_line import (
    COVARIANCE,
    DESIGN,
    NOISY,
    SIGMA,
    START,
    X,
    line,
    line_beside,
    without_a_number,
)

from cddf_jax.errors import InputError
from cddf_jax.estimation.bootstrap import Bootstrap
from cddf_jax.estimation.least_squares import least_squares_fit

TRIALS = np.arange(30) // 10  # three, one after the other


def two_lines(p):
    return {"fine": p["a"] + p["b"] * X, "coarse": 2 * p["a"] + p["b"] * X}


PAIR = {"fine": NOISY, "coarse": 2 * NOISY - 0.5 * X}


@pytest.fixture(scope="module")
def known():
    return least_squares_fit(line, START, NOISY, SIGMA)


def refit(design, y):
    return np.linalg.lstsq(design, y, rcond=None)[0]


def agree_within_simulation(found, expected, draws):
    """Two covariances: an element of one from n normal draws has variance (C_ii C_jj + C_ij^2) / n."""
    deviation = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / draws)
    assert np.all(np.abs(found - expected) < 4 * deviation)


# --- parametric ----------------------------------------------------------------------------------


def test_parametric_covariance_of_a_linear_model(known):
    found = known.bootstrap("parametric", 4000, seed=2)
    expected = SIGMA**2 * COVARIANCE  # sigma^2 (X'X)^-1
    agree_within_simulation(found.covariance, expected, 4000)
    bias = np.array([found.bias[n] for n in found.names])
    assert np.all(np.abs(bias) < 4 * np.sqrt(np.diag(expected) / 4000))
    # percentiles of a normal: 1.96 standard errors off, each with a deviation of sqrt(p (1 - p) / n) / density
    deviation = np.sqrt(0.025 * 0.975 / 4000) / stats.norm.pdf(1.96)
    half_widths = (np.array(found.confidence_interval["b"]) - found.estimate[1]) / np.sqrt(expected[1, 1])
    np.testing.assert_allclose(half_widths, [-1.96, 1.96], atol=4 * deviation)
    assert found.num_failed == 0


def test_parametric_takes_the_estimated_noise():
    """Data of two groups, one ten times as noisy: each is drawn with its own."""
    rng = np.random.default_rng(3)
    data = {"fine": 2 + 0.5 * X + 0.03 * rng.normal(size=30), "coarse": 4 + 0.5 * X + 0.3 * rng.normal(size=30)}
    fit = least_squares_fit(two_lines, START, data)
    design = np.concatenate([DESIGN, DESIGN * [2, 1]])
    variance = np.repeat([fit.noise["fine"] ** 2, fit.noise["coarse"] ** 2], 30)
    expected = np.linalg.inv(design.T @ (design / variance[:, None]))
    order = [fit.names.index(n) for n in ("a", "b")]
    agree_within_simulation(fit.bootstrap(replicates=2000).covariance[np.ix_(order, order)], expected, 2000)


@pytest.mark.parametrize("kind", ["parametric", "cases"])
def test_what_only_a_prior_holds_scatters_by_it(kind):
    fit = least_squares_fit(line_beside, START | {"c": 1.0}, NOISY, SIGMA, priors={"c": (3.0, 0.1)})
    error = fit.bootstrap(kind, 1000, seed=13).standard_error["c"]
    assert error == pytest.approx(0.1, rel=4 / np.sqrt(2 * 1000))  # four standard errors of a spread


def test_a_seed_gives_the_same_draws(known):
    """Also in more than one chunk."""
    one, same, other = (known.bootstrap(replicates=260, seed=seed).estimates for seed in (4, 4, 6))
    np.testing.assert_array_equal(one, same)
    assert not np.any(one == other)


def test_estimates_stay_inside_bounds():
    best = refit(DESIGN, NOISY)[1]
    low, high = best - 0.005, best + 0.005  # half a standard error
    fit = least_squares_fit(line, {"a": 1.0, "b": best}, NOISY, SIGMA, {"b": (low, high)})
    slopes = fit.bootstrap(replicates=200).estimates[:, fit.names.index("b")]
    assert np.all((slopes >= low) & (slopes <= high))
    assert np.mean((slopes < low + 1e-4) | (slopes > high - 1e-4)) > 0.3  # 62 % of a normal lie beyond


# --- cases ---------------------------------------------------------------------------------------


def test_cases_of_a_linear_model(known):
    """Against a loop over NumPy's least squares with draws of its own: rows with replacement."""
    found = known.bootstrap("cases", 2000, seed=7)
    rng = np.random.default_rng(8)
    rows = rng.integers(0, 30, size=(4000, 30))
    loop = np.array([refit(DESIGN[k], NOISY[k]) for k in rows])
    agree_within_simulation(found.covariance, np.cov(loop.T), 4 / 3 * 1000)  # 1/2000 + 1/4000 and the tails of cases
    assert np.all(np.abs(found.estimates.mean(axis=0) - loop.mean(axis=0)) < 4 * loop.std(axis=0) * np.sqrt(1 / 1333))


def possible_estimates(draws, design, data):
    """One estimate for each draw of rows."""
    return np.array([refit(design[rows], data[rows]) for rows in draws])


def assert_among(estimates, possible):
    distance = np.abs(estimates[:, None] - possible).max(axis=2)
    assert np.all(distance.min(axis=1) < 1e-5)  # searches in a batch stop at 1e-7
    return distance.argmin(axis=1)


def test_whole_clusters_are_kept_together(known):
    """Of three trials there are ten draws, each as often as the multinomial distribution has it."""
    found = known.bootstrap("cases", 1000, clusters={"data": ("trial", TRIALS)}, seed=9)
    draws = list(combinations_with_replacement(range(3), 3))
    rows = [np.concatenate([np.flatnonzero(k == TRIALS) for k in draw]) for draw in draws]
    which = assert_among(found.estimates, possible_estimates(rows, DESIGN, NOISY))
    chance = [stats.multinomial.pmf([draw.count(k) for k in range(3)], 3, [1 / 3] * 3) for draw in draws]
    counts = np.bincount(which, minlength=10)
    assert stats.chisquare(counts, 1000 * np.array(chance)).pvalue > 1e-3


def test_how_often_few_cases_hold_the_truth():
    """20,000 means of a few normal cases: over all draws a bootstrap scatters by their deviation / sqrt n."""
    count = 3
    draws = np.random.default_rng(12).normal(size=(20_000, count))
    held = np.mean(np.abs(draws.mean(axis=1)) < 1.959964 * draws.std(axis=1) / np.sqrt(count))
    told = Bootstrap("cases", ("a",), np.zeros((9, 1)), np.zeros(1), 0, 0, num_cases=count)
    assert told.coverage == pytest.approx(held, abs=4 * np.sqrt(0.15 / 20_000))
    assert (
        f"drawn from {count} case(s) only: even for a plain mean such 95 % intervals contain the true value in "
        in told.remark
    )


def test_how_often_drawn_noise_holds_the_truth():
    """Noise told by 2 degrees of freedom: z for t, whose distribution then is t / sqrt(2 + t^2)."""
    told = Bootstrap("parametric", ("a",), np.zeros((9, 1)), np.zeros(1), 0, 0, noise_freedom=2.0)
    assert told.coverage == pytest.approx(1.959964 / np.sqrt(2 + 1.959964**2), rel=1e-6)
    assert told._replace(noise_freedom=np.inf).remark == ""


@pytest.mark.parametrize("common", [True, False])
def test_clusters_across_groups(common):
    """Groups that draw from the same trials have the same trials drawn; from others, any two draws together."""
    fit = least_squares_fit(two_lines, START, PAIR, {"fine": SIGMA, "coarse": 3 * SIGMA})
    other = ("trial", TRIALS) if common else ("other trial", [f"no. {k}" for k in TRIALS])
    clusters = {"fine": ("trial", TRIALS), "coarse": other}
    found = fit.bootstrap("cases", 60, clusters=clusters, seed=10)
    weight = np.repeat([1 / SIGMA, 1 / (3 * SIGMA)], 30)
    design = np.concatenate([DESIGN, DESIGN * [2, 1]]) * weight[:, None]
    data = np.concatenate([PAIR["fine"], PAIR["coarse"]]) * weight
    draws = [[np.flatnonzero(k == TRIALS) for k in draw] for draw in combinations_with_replacement(range(3), 3)]
    pairs = [(d, d) for d in draws] if common else list(product(draws, draws))
    rows = [np.concatenate([*fine, *(30 + k for k in coarse)]) for fine, coarse in pairs]
    order = [fit.names.index(n) for n in ("a", "b")]
    which = assert_among(found.estimates[:, order], possible_estimates(rows, design, data))
    assert len(set(which)) > (5 if common else 20)


# --- failures and refusals -----------------------------------------------------------------------


def test_refits_that_fail_are_counted():
    """A model without a number has no refit that ends: nothing is told, and nothing is raised."""
    fit = least_squares_fit(without_a_number, {"a": -1.0}, NOISY, SIGMA)
    found = fit.bootstrap(replicates=5)
    assert found.num_failed == 5
    assert found.estimates.shape == (0, 1)
    assert np.isnan(found.standard_error["a"])
    assert np.all(np.isnan(found.confidence_interval["a"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "residuals"}, "bootstrap: kind 'residuals' is not known; there are parametric, cases"),
        ({"replicates": 1}, "bootstrap: needs 2 replicates or more, got 1"),
        ({"clusters": {"data": ("trial", TRIALS[1:])}}, "bootstrap: clusters of 'data' need one label for each datum"),
    ],
)
def test_refusals(known, options, message):
    with pytest.raises(InputError, match=f"^{message}"):
        known.bootstrap(**({"kind": "cases"} | options))
