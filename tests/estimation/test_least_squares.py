"""The statistics of a fit, against closed forms and SciPy; no manipulator in sight."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats
from straight_line import (
    A_HAT,
    B_HAT,
    COVARIANCE,
    DESIGN,
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

# --- a straight line, where everything has a closed form -----------------------------------------

SETTLED = 1e-6  # the optimiser stops at a relative change of 1e-10; what is quadratic near the minimum loses half


@pytest.fixture(scope="module")
def known():
    return least_squares_fit(line, START, NOISY, SIGMA)


@pytest.fixture(scope="module")
def unknown():
    return least_squares_fit(line, START, NOISY)


@pytest.mark.parametrize(
    ("noise", "spread", "quantile", "rtol"),
    [
        ("known", SIGMA, stats.norm.ppf(0.975), SETTLED),
        ("unknown", np.sqrt(RSS / 28), stats.t.ppf(0.975, 28), 1e-4),  # to which estimated noise settles
    ],
)
def test_a_line(noise, spread, quantile, rtol, request):
    fit = request.getfixturevalue(noise)
    estimate, error = np.array([A_HAT, B_HAT]), spread * np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], estimate, rtol=SETTLED)
    np.testing.assert_allclose([fit.standard_error["a"], fit.standard_error["b"]], error, rtol=rtol)
    np.testing.assert_allclose(fit.covariance, spread**2 * COVARIANCE, rtol=rtol)
    interval = np.stack([estimate - quantile * error, estimate + quantile * error], axis=1)
    np.testing.assert_allclose([fit.confidence_interval["a"], fit.confidence_interval["b"]], interval, rtol=0.1 * rtol)
    assert fit.reduced_chi_square == pytest.approx(RSS / spread**2 / 28, rel=rtol)
    assert fit.noise == {"data": pytest.approx(spread, rel=rtol)}
    assert (fit.noise_estimated, fit.degrees_of_freedom) == (noise == "unknown", 28)
    np.testing.assert_allclose(fit.residuals, NOISY - DESIGN @ estimate, atol=1e-7)


def test_conditioning(known):
    scaled = DESIGN * [A_HAT, B_HAT] / SIGMA  # by noise and by the size of the parameters
    singular = np.linalg.svd(scaled, compute_uv=False)
    assert known.condition_number == pytest.approx(singular[0] / singular[1], rel=SETTLED)
    assert known.rank == 2
    expected = COVARIANCE[0, 1] / np.sqrt(COVARIANCE[0, 0] * COVARIANCE[1, 1])
    assert known.correlation[0, 1] == pytest.approx(expected, rel=SETTLED)
    assert known.status == {"a": "identified", "b": "identified"}
    assert known.combinations == {}


def test_band_of_a_line(unknown):
    at = np.array([[1.0, -1.0], [1.0, 1.5], [1.0, 10.0]])
    variance = RSS / 28 * np.einsum("ki,ij,kj->k", at, COVARIANCE, at)  # textbook band of a regression line
    np.testing.assert_allclose(unknown.band(at), stats.t.ppf(0.975, 28) * np.sqrt(variance), rtol=1e-4)


def test_noise_of_each_point():
    sigma = 0.02 + 0.05 * X
    fit = least_squares_fit(line, START, NOISY, sigma)
    covariance = np.linalg.inv(DESIGN.T @ (DESIGN / sigma[:, None] ** 2))  # weighted least squares
    expected = covariance @ DESIGN.T @ (NOISY / sigma**2)
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], expected, rtol=SETTLED)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=SETTLED)


@pytest.mark.parametrize("bounds", [{}, {"a": (0.0, 5.0)}, {"a": (0.0, None), "b": (None, 5.0)}])  # far away
def test_gaussian_prior(bounds):
    fit = least_squares_fit(line, START, NOISY, SIGMA, bounds, priors={"b": (0.6, 0.02)})
    expected, covariance = posterior_with(0.6, 0.02)
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], expected, rtol=SETTLED)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=SETTLED)
    assert fit.status == {"a": "identified", "b": "identified"}


def test_prior_on_what_the_data_do_not_hold():
    """In any order."""
    priors = {"c": (3.0, 0.1), "a": (2.0, 0.5)}
    fit = least_squares_fit(line_beside, START | {"c": 1.0}, NOISY, SIGMA, priors=priors)
    assert fit.status == {"a": "identified", "b": "identified", "c": "prior only"}
    assert fit.value["c"] == pytest.approx(3.0)
    assert fit.standard_error["c"] == pytest.approx(0.1)
    alone = fit.determined_by("data")
    assert alone.status["c"] == "not identified"
    assert alone.standard_error["c"] == np.inf


def test_too_few_data_to_estimate_the_noise():
    """Two points on a line of two parameters: it passes through both, and nothing says how well."""
    fit = least_squares_fit(lambda p: p["a"] + p["b"] * X[:2], START, NOISY[:2])
    assert fit.degrees_of_freedom == 0
    assert set(fit.standard_error.values()) == {np.inf}
    assert set(fit.status.values()) == {"not identified"}
    assert fit.combinations == {}


# --- SciPy as a cross-check ----------------------------------------------------------------------

DECAY = 3.0 * np.exp(-0.8 * X) + 0.5 + 0.03 * np.random.default_rng(2).normal(size=X.size)


def test_bounded_least_squares_agrees():
    """One active bound among three parameters of a curved model, against SciPy's trust region."""
    bounds = {"height": (0.0, None), "rate": (0.1, 5.0), "floor": (0.6, None)}  # the best floor is about 0.5
    fit = least_squares_fit(decay, {"height": 1.0, "rate": 1.0, "floor": 1.0}, DECAY, 0.03, bounds)
    expected = optimize.least_squares(
        lambda p: p[0] * np.exp(-p[1] * X) + p[2] - DECAY,
        x0=[1.0, 1.0, 1.0],
        bounds=([0.0, 0.1, 0.6], [np.inf, 5.0, np.inf]),
        ftol=1e-14,
        xtol=1e-14,
        gtol=1e-14,
    ).x
    np.testing.assert_allclose([fit.value[n] for n in ("height", "rate", "floor")], expected, rtol=1e-4)
    assert fit.status == {"height": "identified", "rate": "identified", "floor": "at bound"}
    assert fit.success


# --- bounds --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bound", "start", "slope", "active"),
    [
        ((None, 0.2), 0.1, 0.5, 0.2),
        ((0.7, 2.0), 1.0, 0.5, 0.7),
        ((0.0, None), 1.0, -0.5, 0.0),
    ],
)
def test_truth_outside_the_bounds(bound, start, slope, active):
    data = NOISY + (slope - 0.5) * X
    fit = least_squares_fit(line, {"a": 1.0, "b": start}, data, SIGMA, {"b": bound})
    low, high = (-np.inf if bound[0] is None else bound[0]), (np.inf if bound[1] is None else bound[1])
    assert fit.status == {"a": "identified", "b": "at bound"}
    assert low <= fit.value["b"] <= high
    assert fit.value["b"] == pytest.approx(active, abs=1e-4)
    assert fit.value["a"] == pytest.approx(np.mean(data - active * X), abs=2e-4)  # the best with the slope held
    assert fit.standard_error["b"] == np.inf
    # from a lower bound on, at most two standard errors; what an upper bound holds is not limited below
    error = SIGMA * np.sqrt(COVARIANCE[1, 1])
    limit = active + stats.norm.ppf(0.975) * error if active == bound[0] else high
    assert fit.confidence_interval["b"] == (low, pytest.approx(limit, rel=1e-3))
    assert fit.bounded_above == (("b",) if active == bound[0] else ())
    assert fit.success, fit.result


@pytest.mark.parametrize("sign", [1, -1])
def test_an_interval_is_longer_where_the_sum_of_squares_rises_slowly(sign):
    """Likelihood of a square: an interval ends where b^2 is 1 +- 1.96 noise; by its curvature at 1 +- 0.98 noise."""
    reach = stats.norm.ppf(0.975) * 0.25
    bounds = {"b": (0.0, None) if sign > 0 else (None, 0.0)}
    fit = least_squares_fit(lambda p: p["b"] ** 2 * jnp.ones(1), {"b": 0.9 * sign}, np.ones(1), 0.25, bounds)
    assert fit.status["b"] == "identified"
    assert fit.standard_error["b"] == pytest.approx(0.125, rel=1e-6)
    # towards 0 the square changes less and less; away from 0 it changes more, and the end by the curvature is kept
    inner, outer = sorted(fit.confidence_interval["b"], key=abs)
    assert (inner, outer) == pytest.approx((sign * np.sqrt(1 - reach), sign * (1 + reach / 2)), rel=1e-4)


def test_an_interval_reaches_beyond_a_bend():
    """A line, five times less steep from half a half-width below the estimate on: it ends at three half-widths."""
    half_width = stats.norm.ppf(0.975) * 0.01
    bend = 5.0 - half_width / 2
    fit = least_squares_fit(
        lambda p: jnp.maximum(p["b"], bend + (p["b"] - bend) / 5)[None], {"b": 4.0}, 5 * np.ones(1), 0.01
    )
    assert fit.confidence_interval["b"] == pytest.approx((5 - 3 * half_width, 5 + half_width), rel=1e-6)


def test_the_model_is_never_asked_beyond_a_bound():
    """The square root has no derivative at 0 and no value below."""
    data = np.sqrt(0.01) * X + SIGMA * np.random.default_rng(3).normal(size=X.size)
    fit = least_squares_fit(lambda p: jnp.sqrt(p["a"]) * X, {"a": 100.0}, data, SIGMA, {"a": (0.0, None)})
    slope = np.sum(data * X) / np.sum(X**2)
    assert fit.value["a"] == pytest.approx(slope**2, rel=1e-5)
    assert fit.success


# --- what the data do not hold -------------------------------------------------------------------


# the fit of y = q x: its estimate is sum xy / sum xx, its standard error sigma / sqrt(sum xx)
PROPORTIONAL = 1.5 * X + SIGMA * np.random.default_rng(4).normal(size=X.size)
Q_HAT, Q_ERROR = np.sum(X * PROPORTIONAL) / np.sum(X**2), SIGMA / np.sqrt(np.sum(X**2))


JOINED = {  # what the data hold of two parameters, by its name
    "p0 * p1": lambda p: p["p0"] * p["p1"] * X,
    "p0^2 / p1": lambda p: p["p0"] ** 2 / p["p1"] * X,
}


@pytest.mark.parametrize(("name", "bounds"), [("p0 * p1", {"p0": (0.0, None), "p1": (0.0, None)}), ("p0^2 / p1", None)])
def test_combinations(name, bounds):
    joined_name = "p0 / p1^0.5" if name == "p0^2 / p1" else name  # the largest power is one
    fit = least_squares_fit(JOINED[name], {"p0": 7.0, "p1": 0.2}, PROPORTIONAL, SIGMA, bounds)
    assert fit.rank == 1
    assert fit.condition_number == np.inf
    assert fit.status == {"p0": "not identified", "p1": "not identified"}
    assert fit.standard_error == {"p0": np.inf, "p1": np.inf}
    assert list(fit.combinations) == [joined_name]
    assert (fit.restarted, fit.starts.size) == ("", 0)  # a product that the data tell is no trouble
    value, error, _ = fit.combinations[joined_name]
    power = 0.5 if name == "p0^2 / p1" else 1.0  # of the one parameter that the data hold
    assert value == pytest.approx(Q_HAT**power, rel=1e-6)
    assert error == pytest.approx(power * Q_HAT ** (power - 1) * Q_ERROR, rel=1e-6)


@pytest.mark.parametrize(("factor", "name"), [(-1.0, "p0 - p1"), (0.5, "p0 + 0.5 p1"), (1.0, "")])
def test_a_sum_of_parameters(factor, name):
    """It is reported of two parameters that may be 0, as a size tells; the closed form is that of one slope."""
    scales = {"p0": 1.0, "p1": 1.0} if name else {}
    start = dict.fromkeys(("p0", "p1"), 0.0 if name else 2.0)
    fit = least_squares_fit(lambda p: (p["p0"] + factor * p["p1"]) * X, start, PROPORTIONAL, SIGMA, scales=scales)
    assert fit.value["p0"] + factor * fit.value["p1"] == pytest.approx(Q_HAT, rel=SETTLED)
    assert fit.status == {"p0": "not identified", "p1": "not identified"}
    assert fit.standard_error == {"p0": np.inf, "p1": np.inf}
    assert fit.confidence_interval["p0"] == (-np.inf, np.inf)
    assert (fit.rank, fit.combinations, list(fit.sums)) == (1, {}, [name] if name else [])
    for value, error, _ in fit.sums.values():
        assert value == pytest.approx(Q_HAT, rel=SETTLED)
        assert error == pytest.approx(Q_ERROR, rel=1e-6)
        assert f"{name} = {Q_HAT:.4g} +- {Q_ERROR:.2g}: identified" in str(fit)


def test_a_parameter_without_effect():
    fit = least_squares_fit(line_beside, START | {"c": 1.0}, NOISY, SIGMA)
    assert fit.status == {"a": "identified", "b": "identified", "c": "not identified"}
    assert fit.standard_error["c"] == np.inf
    assert fit.standard_error["a"] == pytest.approx(SIGMA * np.sqrt(COVARIANCE[0, 0]), rel=SETTLED)
    assert (fit.rank, fit.condition_number) == (2, np.inf)
    assert (fit.restarted, fit.starts.size) == ("", 0)  # other starts tell no more


# --- several groups of data ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def groups():
    """Two tables that share a slope; the second is ten times as noisy."""
    rng = np.random.default_rng(6)
    fine = 1.0 + 0.5 * X + 0.03 * rng.normal(size=X.size)
    coarse = -2.0 + 0.5 * X + 0.3 * rng.normal(size=X.size)
    return {"fine": fine, "coarse": coarse}


def two_lines(p):
    return {"fine": p["fine_level"] + p["slope"] * X, "coarse": p["coarse_level"] + p["slope"] * X}


LEVELS = {"fine_level": 0.0, "coarse_level": 0.0, "slope": 1.0}
TWO_DESIGNS = np.block(
    [[np.ones((30, 1)), np.zeros((30, 1)), X[:, None]], [np.zeros((30, 1)), np.ones((30, 1)), X[:, None]]]
)


def weighted(groups, fine, coarse):
    """Estimate, covariance and residuals of weighted linear least squares."""
    y, variance = np.concatenate([groups["fine"], groups["coarse"]]), np.repeat([fine**2, coarse**2], 30)
    covariance = np.linalg.inv(TWO_DESIGNS.T @ (TWO_DESIGNS / variance[:, None]))
    estimate = covariance @ TWO_DESIGNS.T @ (y / variance)
    return estimate, covariance, y - TWO_DESIGNS @ estimate, variance


def restricted_likelihood(log_noise, groups):
    """Minus twice its logarithm; Patterson and Thompson (1971): variances without the bias of maximum likelihood."""
    _, covariance, residual, variance = weighted(groups, *np.exp(log_noise))
    return np.sum(np.log(variance)) - np.linalg.slogdet(covariance)[1] + np.sum(residual**2 / variance)


def test_noise_of_groups_is_that_of_restricted_likelihood(groups):
    fit = least_squares_fit(two_lines, LEVELS, groups)
    best = optimize.minimize(
        restricted_likelihood, np.log([0.1, 0.1]), args=(groups,), method="Nelder-Mead", options={"xatol": 1e-8}
    )
    fine, coarse = np.exp(best.x)
    assert fit.noise == {"fine": pytest.approx(fine, rel=1e-3), "coarse": pytest.approx(coarse, rel=1e-3)}
    estimate, covariance, _, _ = weighted(groups, fine, coarse)
    names = list(LEVELS)
    np.testing.assert_allclose([fit.value[n] for n in names], estimate, rtol=1e-4)
    np.testing.assert_allclose([fit.standard_error[n] for n in names], np.sqrt(np.diag(covariance)), rtol=1e-3)
    np.testing.assert_allclose(fit.residuals["fine"] + fit.value["fine_level"] + fit.value["slope"] * X, groups["fine"])


@pytest.fixture(scope="module")
def joint(groups):
    return least_squares_fit(
        two_lines, LEVELS, groups, {"fine": 0.03, "coarse": 0.3}, priors={"coarse_level": (-2.0, 0.1)}
    )


def test_what_one_group_determines(joint):
    alone = joint.determined_by("fine")
    assert alone.status == {"fine_level": "identified", "slope": "identified", "coarse_level": "not identified"}
    # the line through that group, its noise as given: sigma^2 (X'X)^-1, without the prior
    expected = 0.03 * np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose([alone.standard_error["fine_level"], alone.standard_error["slope"]], expected, rtol=1e-6)
    assert alone.value == joint.value
    assert alone.rank == 2


# --- information criteria -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("noise", "spread", "count", "rel"), [("known", SIGMA, 2, 1e-9), ("unknown", np.sqrt(RSS / 28), 3, 1e-5)]
)
def test_information_criteria(noise, spread, count, rel, request):
    """Akaike (1974) and Schwarz (1978): 2 k - 2 ln L and k ln n - 2 ln L; estimated noise is a third parameter."""
    fit = request.getfixturevalue(noise)
    log_likelihood = np.sum(stats.norm.logpdf(NOISY, DESIGN @ [A_HAT, B_HAT], spread))
    assert fit.log_likelihood == pytest.approx(log_likelihood, rel=rel)
    criteria = {"AIC": 2 * count - 2 * log_likelihood, "BIC": np.log(30) * count - 2 * log_likelihood}
    assert fit.information_criteria == pytest.approx(criteria, rel=rel)


# --- failures and refusals -----------------------------------------------------------------------


def test_a_model_without_a_number_is_reported_as_a_failure():
    fit = least_squares_fit(without_a_number, {"a": -1.0}, NOISY)
    assert not fit.success
    assert "no number" in fit.result
    assert fit.restarted == (
        "the search from the given start failed (the model gave no number at the estimate); nothing better was found "
        "from 32 other start(s)"
    )
    assert fit.status["a"] == "not identified"
    assert fit.standard_error["a"] == np.inf


def test_too_few_steps_are_a_failure():
    fit = least_squares_fit(decay, {"height": 100.0, "rate": 10.0, "floor": -5.0}, DECAY, 0.03, max_steps=1)
    assert not fit.success
    assert "stopped short" in fit.result


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds": {"a": (2.0, 3.0)}}, "a starts at 1, which is not inside its bounds 2 to 3; move the start or the"),
        ({"bounds": {"c": (0.0, 1.0)}}, "bounds for 'c', which is not fitted; fitted are a, b"),
        ({"priors": {"c": (0.0, 1.0)}}, "prior for 'c', which is not fitted; fitted are a, b"),
        ({"priors": {"a": (0.0, 0.0)}}, "prior for a: needs a mean and a standard deviation > 0, got 0.0, 0.0"),
        ({"sigma": 0.0}, "sigma of data must be > 0"),
        ({"sigma": [1.0, 2.0]}, r"sigma of data must be one number or of shape \(30,\) like the data, got \(2,\)"),
        ({"observed": np.where(X > 2.9, np.nan, NOISY)}, "data: entry 30 is not finite; leave it out"),
        ({"observed": np.zeros(0)}, "there are no data to fit"),
        ({"observed": {"fine": NOISY}, "sigma": {"rough": 0.3}}, "sigma is given for 'rough', which is not a group"),
        ({"observed": NOISY[:4]}, r"predict gives arrays of \[30\] numbers where the data have \[4\]"),
        ({"scales": {"a": 0.0}}, r"scale of 'a': needs a number > 0"),
        ({"start": {}}, "start: there is no parameter to fit"),
        ({"starts": 0}, "starts must be a whole number of 1 or more, got 0"),
    ],
)
def test_refusals(change, message):
    arguments = {"predict": line, "start": START, "observed": NOISY} | change
    with pytest.raises(InputError, match=f"^{message}"):
        least_squares_fit(**arguments)


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(InputError, match=r"double precision: call jax\.config\.update"):
        least_squares_fit(line, START, NOISY)


REST = [1.0, -1.0] * 4  # further readings, which the parameters do not change
KINKS = {  # a model, its readings, the start; by hand the minimum, and the parameter at the kink
    # (a - 2.5)^2 + (5 max(a - 2, 0) + 1)^2 falls up to a = 2 and rises from there; b = 3 - a
    "one": (lambda a, b: [a, 5 * jnp.maximum(a - 2, 0), a + b, b], [2.5, -1, 3, 1], (1.0, 0.5), (2.0, 1.0), ["a"]),
    # with 1.5 in place of 2.5 the minimum lies where the model is smooth: 2 a + b = 4.5 and a + 2 b = 4
    "none": (lambda a, b: [a, 5 * jnp.maximum(a - 2, 0), a + b, b], [1.5, -1, 3, 1], (1.0, 0.5), (5 / 3, 7 / 6), []),
    # (5 |a - 2| + 0.5)^2 + (0.1 b - 3)^2; it starts at the kink, and b is steeper
    "start": (lambda a, b: [5 * jnp.abs(a - 2) + 0.5, b / 10], [0, 3, *REST], (2.0, 1.0), (2.0, 30.0), ["a"]),
    # 100 (a + b - 2)^2 + (5 |a - b| + 0.05)^2: with one of them held, the other one ends at the kink too
    "across": (lambda a, b: [10 * (a + b), 5 * jnp.abs(a - b) + 0.05], [20, 0, *REST], (1.5, 0.2), (1.0, 1.0), None),
}


@pytest.mark.parametrize("name", KINKS)
def test_a_minimum_at_a_kink(name):
    model, data, start, least, at_kink = KINKS[name]

    def predict(p):
        values = model(p["a"], p["b"])
        return jnp.stack([*values, *jnp.zeros(len(data) - len(values))])

    found = least_squares_fit(predict, dict(zip("ab", start, strict=True)), np.array(data, float), sigma=1.0)
    assert (found.success, found.restarted) == (True, "")  # one search was enough
    near = 0.011 if name == "across" else 1e-6  # the standard errors across it are 0.11
    assert [found.value[one] for one in "ab"] == pytest.approx(least, rel=1e-6, abs=near)
    kinks = [remark.split(" ")[0] for remark in found.remarks if "lies at a kink of the model" in remark]
    assert at_kink in (kinks, None)


def test_a_parameter_alone_is_no_product():
    """1 - exp(-a) = 0.95 +- 0.03: its slope would close the interval of a. But an infinite a is off by 1.7 errors only.

    No reading depends on b.
    """
    data, noise, start = {"read": np.full(4, 0.95)}, {"read": 0.06}, {"a": 1.0, "b": 1.0}

    def model(p):
        return {"read": (1 - jnp.exp(-p["a"])) * jnp.ones(4)}

    found = least_squares_fit(model, start, data, noise, bounds=dict.fromkeys(start, (0.0, None)))
    assert found.status == {"a": "not identified", "b": "not identified"}
    assert not found.combinations
