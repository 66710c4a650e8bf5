"""The statistics of a fit, against certified answers, closed forms and SciPy; no manipulator in sight."""

from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

from cddf_jax.errors import InputError
from cddf_jax.least_squares import least_squares_fit
from cddf_jax.parameter_space import Space, Uniform

NIST = Path(__file__).resolve().parents[2] / "shared" / "data" / "nist"


# --- problems with certified answers -------------------------------------------------------------


def exponentials(b, x):
    return b[0] * jnp.exp(-b[1] * x) + b[2] * jnp.exp(-b[3] * x) + b[4] * jnp.exp(-b[5] * x)


# the formula that the head of each file states
MODELS = {
    "Misra1a": lambda b, x: b[0] * (1 - jnp.exp(-b[1] * x)),
    "Chwirut2": lambda b, x: jnp.exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos3": exponentials,
    "MGH17": lambda b, x: b[0] + b[1] * jnp.exp(-x * b[3]) + b[2] * jnp.exp(-x * b[4]),
    "Thurber": lambda b, x: jnp.polyval(b[3::-1], x) / jnp.polyval(jnp.append(b[:3:-1], 1.0), x),
}


class Problem:
    """One NIST file: starts, certified values and deviations, data."""

    def __init__(self, name):
        path = NIST / f"{name}.dat"
        if not path.exists():
            pytest.skip(f"the NIST problems are not there: no {path.name} in ../shared/data/nist")
        lines = path.read_text().splitlines()
        table = [line.split("=")[1].split() for line in lines[40:60] if line.strip().startswith("b")]
        self.start1, self.start2, self.value, self.deviation = np.array(table, dtype=float).T
        self.y, self.x = np.array([line.split() for line in lines[60:] if line.strip()], dtype=float).T
        stated = dict(line.split(":", 1) for line in lines[40:60] if ":" in line)
        self.sum_of_squares = float(stated["Residual Sum of Squares"])
        self.freedom = int(stated["Degrees of Freedom"])
        model, x = MODELS[name], jnp.asarray(self.x)
        self.predict = lambda b: model(b, x)

    def fit(self, start):
        return least_squares_fit(self.predict, getattr(self, start), self.y)


@pytest.mark.parametrize("start", ["start1", "start2"])
@pytest.mark.parametrize("name", MODELS)
def test_certified_values(name, start):
    problem = Problem(name)
    fit = problem.fit(start)
    assert fit.success
    assert fit.result == "successful"
    value, error = np.array(list(fit.value.values())), np.array(list(fit.standard_error.values()))
    if name == "MGH17" and value[3] > value[4]:
        # b1 + b2 exp(-x b4) + b3 exp(-x b5) is the same model with b2, b4 and b3, b5 exchanged: the certified
        # minimum has two names, and either is right
        value, error = value[[0, 2, 1, 4, 3]], error[[0, 2, 1, 4, 3]]
    np.testing.assert_allclose(value, problem.value, rtol=1e-6)
    np.testing.assert_allclose(error, problem.deviation, rtol=1e-4)
    assert fit.degrees_of_freedom == problem.freedom
    assert np.sum(fit.residuals**2) == pytest.approx(problem.sum_of_squares, rel=1e-6)
    # the noise is the residual standard deviation, and with it the reduced chi-square is 1
    assert fit.noise["data"] == pytest.approx(np.sqrt(problem.sum_of_squares / problem.freedom), rel=1e-4)
    assert fit.reduced_chi_square == pytest.approx(1.0, rel=1e-3)


# --- problems that are hard from afar -------------------------------------------------------------

# NIST StRD, nonlinear regression, "higher level of difficulty": model, data, the two starts, certified values
# (https://www.itl.nist.gov/div898/strd/nls/data/boxbod.shtml, mgh09.shtml, mgh10.shtml, ratkowsky3.shtml)
HARD = {
    "BoxBOD": (
        lambda b, x: b[0] * (1 - jnp.exp(-b[1] * x)),
        [1, 2, 3, 5, 7, 10],
        [109, 149, 149, 191, 213, 224],
        {"far": [1, 1], "near": [100, 0.75]},
        [2.1380940889e02, 5.4723748542e-01],
    ),
    "MGH09": (
        lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
        [4, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625],
        [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246],
        {"far": [25, 39, 41.5, 39], "near": [0.25, 0.39, 0.415, 0.39]},
        [1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01],
    ),
    "MGH10": (
        lambda b, x: b[0] * jnp.exp(b[1] / (x + b[2])),
        np.arange(50.0, 126.0, 5.0),
        [34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744, 8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872],
        {"far": [2, 400000, 25000], "near": [0.02, 4000, 250]},
        [5.6096364710e-03, 6.1813463463e03, 3.4522363462e02],
    ),
    "Rat43": (
        lambda b, x: b[0] / (1 + jnp.exp(b[1] - b[2] * x)) ** (1 / b[3]),
        np.arange(1.0, 16.0),
        [
            16.08,
            33.83,
            65.8,
            97.2,
            191.55,
            326.2,
            386.87,
            520.53,
            590.03,
            651.92,
            724.93,
            699.56,
            689.96,
            637.56,
            717.41,
        ],
        {"far": [100, 10, 1, 1], "near": [700, 5, 0.75, 1.3]},
        [6.9964151270e02, 5.2771253025e00, 7.5962938329e-01, 1.2792483859e00],
    ),
}


@cache  # the same function again is not compiled again
def predict_hard(name):
    model, x = HARD[name][0], jnp.asarray(HARD[name][1], float)
    return lambda b: model(b, x)


def fit_hard(name, start, **options):
    _, _, y, starts, certified = HARD[name]
    start = np.array(starts[start], float)
    return least_squares_fit(predict_hard(name), start, np.array(y, float), **options), np.array(certified)


@pytest.mark.parametrize("start", ["far", "near"])
@pytest.mark.parametrize("name", HARD)
def test_hard_problems(name, start):
    """Without an option; from two of the far starts a search of its own ends nowhere, and the fit says so."""
    fit, certified = fit_hard(name, start)
    assert fit.success, fit.result
    np.testing.assert_allclose(list(fit.value.values()), certified, rtol=2e-5)
    again = (name, start) in (("MGH09", "far"), ("Rat43", "far"))
    assert ("the search from the given start" in fit.restarted, len(fit.starts) > 1) == (again, again)
    assert (fit.restarted in fit.remarks) == again


def test_other_starts_compile_nothing():
    x, traces = jnp.linspace(0.0, 1.0, 30), []

    def predict(p):
        traces.append(1)
        return jnp.sin(p["w"] * x)

    data = np.sin(25 * np.asarray(x)) + 0.01 * np.random.default_rng(8).normal(size=30)
    near = least_squares_fit(predict, {"w": 24.0}, data, 0.01)
    count = len(traces)
    far = least_squares_fit(predict, {"w": 5.0}, data, 0.01)
    assert (near.restarted, near.starts.size, len(traces)) == ("", 0, count)
    assert far.value["w"] == pytest.approx(near.value["w"], rel=SETTLED)
    assert far.starts.size > 1


def test_what_data_leave_open_is_not_searched_for_long():
    """A product that the data tell is no trouble; of a parameter without effect other starts tell no more."""
    product = least_squares_fit(lambda p: p["c"] * p["d"] * X, {"c": 1.0, "d": 1.0}, PROPORTIONAL, SIGMA)
    assert (product.restarted, product.starts.size) == ("", 0)
    nothing = least_squares_fit(lambda p: line(p) + 0 * p["c"], START | {"c": 1.0}, NOISY, SIGMA)
    assert (nothing.restarted, nothing.starts.size) == ("", 0)
    np.testing.assert_allclose([nothing.value["a"], nothing.value["b"]], [A_HAT, B_HAT], rtol=SETTLED)


def test_other_starts_lie_within_the_bounds():
    space = Space(np.array([-3.0, 0.0, 2.0, 2.0, 2.0]), *np.array([[-np.inf, -np.inf, 1.0, -np.inf, 1.0],
                                                                   [np.inf, np.inf, np.inf, 4.0, 5.0]]))  # fmt: skip
    draws = np.random.default_rng(9).random((200, 5))
    moved = [space.elsewhere(draw, 2.0) for draw in draws]
    starts = np.array([there.parameters(z) for there, z in moved])
    assert np.all((starts > space.lower) & (starts < space.upper))
    for sign, column in ((-1, 0), (1, 1)):  # one of four has the other sign: four standard errors of a share
        assert np.mean(np.sign(starts[:, column]) == sign) == pytest.approx(0.75, abs=4 * np.sqrt(0.75 * 0.25 / 200))
    sizes = np.log10(np.abs(starts[:, :3] - [0.0, 0.0, 1.0]) / [3.0, 1.0, 1.0])
    assert np.all(np.abs(sizes) <= 2.0 + 1e-9)
    assert np.all(np.ptp(sizes, axis=0) > 3.0)
    back = [space.parameters(space.seen_from(there, z)) for there, z in moved]
    np.testing.assert_allclose(back, starts, rtol=1e-9)


def test_as_many_starts_as_are_asked_for():
    fit, certified = fit_hard("MGH09", "far", starts=64)
    np.testing.assert_allclose(list(fit.value.values()), certified, rtol=2e-5)
    assert fit.starts.shape == (64,)
    np.testing.assert_array_equal(fit.starts, np.sort(fit.starts))
    assert fit.restarted == ""


@pytest.mark.parametrize("name", ["MGH09", "Rat43"])
def test_one_far_start_is_no_wrong_success(name):
    fit, certified = fit_hard(name, "far", starts=1)
    assert fit.starts.shape == (1,)
    right = np.allclose(list(fit.value.values()), certified, rtol=2e-5)
    assert right or not fit.success


def test_further_starts_repeat_by_seed():
    one, same, other = (fit_hard("Rat43", "far", starts=8, seed=seed)[0].starts for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


# --- far starts, from which SciPy's least_squares ends elsewhere ---------------------------------

FAR = {  # model, places, truth, far starts
    "rational of second order": (
        lambda b, x: b[0] * (x**2 + b[1] * x) / (x**2 + b[2] * x + b[3]),
        np.geomspace(0.0625, 4.0, 11),
        [0.3, 0.4, 0.15, 0.2],
        [[25.0, 39.0, 41.5, 39.0], [-0.06, -20.0, 0.11, 1.2]],
    ),
    "saturation of second order": (
        lambda b, x: b[0] * x**2 / (b[1] + b[2] * x + x**2),
        np.linspace(0.1, 10.0, 25),
        [3.0, 6.0, -1.5],
        [[3.5, 0.17, -4.7], [0.2, 0.67, -15.0]],
    ),
    "logistic step": (
        lambda b, x: b[3] + b[0] / (1 + jnp.exp(-(x - b[1]) / b[2])),
        np.linspace(0.0, 15.0, 20),
        [12.0, 8.0, 1.5, 3.0],
        [[2.1, 270.0, -0.027, 88.0], [-130.0, 11.5, 0.04, 88.0]],
    ),
    "hyperbolic tangent": (
        lambda b, x: b[0] * jnp.tanh((x - b[1]) / b[2]) + b[3],
        np.linspace(0.0, 15.0, 20),
        [2.0, 6.0, 2.0, 1.0],
        [[0.37, 40.0, 0.31, 9.2], [-1.6, 89.0, -0.12, 0.018]],
    ),
    "power law with an offset": (
        lambda b, x: b[2] + b[0] * x ** b[1],
        np.geomspace(0.05, 50.0, 24),
        [3.0, 0.4, -2.0],
        [[45.0, -1.8, -26.0], [14.0, -0.0115, -77.0]],
    ),
    "power law of a shifted place": (
        lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
        np.linspace(1.0, 40.0, 30),
        [-2500.0, 45.0, 0.95],
        [[-2.8e4, 330.0, -0.7], [-25.0, 450.0, 9.5]],
    ),
}


@pytest.mark.parametrize("name", FAR)
def test_far_starts(name):
    """Exact data have the truth for their minimum; of noisy ones SciPy, from the truth, finds it."""
    model, x, truth, starts = FAR[name]
    places = jnp.asarray(x)
    predict = lambda b: model(b, places)  # noqa: E731
    exact = np.asarray(predict(np.array(truth)))
    noisy = exact + 0.01 * np.std(exact) * np.random.default_rng(7).normal(size=x.size)
    least = optimize.least_squares(lambda b: np.asarray(predict(b)) - noisy, truth, x_scale="jac").cost
    for start in starts:
        fit = least_squares_fit(predict, np.array(start), exact)
        np.testing.assert_allclose(predict(fit.parameters), exact, atol=1e-5 * float(np.std(exact)))
        assert fit.success
        fit = least_squares_fit(predict, np.array(start), noisy)
        assert np.sum(fit.residuals**2) / 2 == pytest.approx(least, rel=1e-5)
        assert fit.success


# --- a straight line, where everything has a closed form -----------------------------------------

X = np.linspace(0.0, 3.0, 30)
SIGMA = 0.05
NOISY = 2.0 + 0.5 * X + SIGMA * np.random.default_rng(1).normal(size=X.size)
DESIGN = np.stack([np.ones_like(X), X], axis=1)
COVARIANCE = np.linalg.inv(DESIGN.T @ DESIGN)  # over sigma^2
A_HAT, B_HAT = np.linalg.lstsq(DESIGN, NOISY, rcond=None)[0]
RSS = np.sum((NOISY - DESIGN @ [A_HAT, B_HAT]) ** 2)
START = {"a": 1.0, "b": 1.0}
SETTLED = 1e-6  # the optimiser stops at a relative change of 1e-10; what is quadratic near the minimum loses half


def line(p):
    return p["a"] + p["b"] * X


@pytest.fixture(scope="module")
def known():
    return least_squares_fit(line, START, NOISY, SIGMA)


@pytest.fixture(scope="module")
def unknown():
    return least_squares_fit(line, START, NOISY)


def test_known_noise(known):
    error = SIGMA * np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose([known.value["a"], known.value["b"]], [A_HAT, B_HAT], rtol=SETTLED)
    np.testing.assert_allclose([known.standard_error["a"], known.standard_error["b"]], error, rtol=SETTLED)
    np.testing.assert_allclose(known.covariance, SIGMA**2 * COVARIANCE, rtol=SETTLED)
    quantile = stats.norm.ppf(0.975)
    assert known.quantile == pytest.approx(quantile)
    interval = (B_HAT - quantile * error[1], B_HAT + quantile * error[1])
    np.testing.assert_allclose(known.confidence_interval["b"], interval, rtol=SETTLED)
    assert known.reduced_chi_square == pytest.approx(RSS / SIGMA**2 / 28)
    assert known.noise == {"data": pytest.approx(SIGMA)}
    assert (known.noise_estimated, known.degrees_of_freedom) == (False, 28)


def test_unknown_noise(unknown):
    spread = np.sqrt(RSS / 28)
    error = spread * np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose([unknown.value["a"], unknown.value["b"]], [A_HAT, B_HAT], rtol=SETTLED)
    np.testing.assert_allclose([unknown.standard_error["a"], unknown.standard_error["b"]], error, rtol=1e-4)
    quantile = stats.t.ppf(0.975, 28)
    assert unknown.quantile == pytest.approx(quantile)
    interval = (A_HAT - quantile * error[0], A_HAT + quantile * error[0])
    np.testing.assert_allclose(unknown.confidence_interval["a"], interval, rtol=1e-5)
    assert unknown.noise_estimated
    assert unknown.noise["data"] == pytest.approx(spread, rel=1e-4)


def test_conditioning(known):
    scaled = DESIGN * [A_HAT, B_HAT] / SIGMA  # by noise and by the size of the parameters
    singular = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(known.singular_values, singular, rtol=SETTLED)
    assert known.condition_number == pytest.approx(singular[0] / singular[1], rel=SETTLED)
    assert known.rank == 2
    expected = COVARIANCE[0, 1] / np.sqrt(COVARIANCE[0, 0] * COVARIANCE[1, 1])
    assert known.correlation[0, 1] == pytest.approx(expected, rel=SETTLED)
    assert known.status == {"a": "identified", "b": "identified"}
    assert known.combinations == {}


def test_residuals_are_observed_less_predicted(known):
    np.testing.assert_allclose(known.residuals, NOISY - DESIGN @ [A_HAT, B_HAT], atol=1e-7)


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


def test_gaussian_prior():
    mean, deviation = 0.6, 0.02
    fit = least_squares_fit(line, START, NOISY, SIGMA, priors={"b": (mean, deviation)})
    precision = DESIGN.T @ DESIGN / SIGMA**2 + np.diag([0.0, 1 / deviation**2])  # the conjugate posterior
    expected = np.linalg.solve(precision, DESIGN.T @ NOISY / SIGMA**2 + [0.0, mean / deviation**2])
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], expected, rtol=SETTLED)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(precision), rtol=SETTLED)
    assert fit.status == {"a": "identified", "b": "identified"}


def test_prior_on_what_the_data_do_not_hold():
    fit = least_squares_fit(line, START | {"c": 1.0}, NOISY, SIGMA, priors={"c": (3.0, 0.1)})
    assert fit.status == {"a": "identified", "b": "identified", "c": "prior only"}
    assert fit.value["c"] == pytest.approx(3.0)
    assert fit.standard_error["c"] == pytest.approx(0.1)
    alone = fit.told_by("data")
    assert alone.status["c"] == "not identified"
    assert alone.standard_error["c"] == np.inf


@pytest.mark.parametrize("unit", [1e-6, 1e6, 1e12])
def test_units_do_not_matter(unit):
    fit = least_squares_fit(lambda p: p["a"] + p["b"] / unit * X, {"a": 1.0, "b": unit}, NOISY, SIGMA)
    error = SIGMA * np.sqrt(COVARIANCE[1, 1])
    assert fit.value["b"] == pytest.approx(unit * B_HAT, rel=SETTLED)
    assert fit.standard_error["b"] == pytest.approx(unit * error, rel=SETTLED)
    assert fit.status["b"] == "identified"


def test_no_data_left_to_tell_the_noise():
    """Two points on a line of two parameters: it passes through both, and nothing says how well."""
    fit = least_squares_fit(lambda p: p["a"] + p["b"] * X[:2], START, NOISY[:2])
    assert fit.degrees_of_freedom == 0
    assert set(fit.standard_error.values()) == {np.inf}
    assert set(fit.status.values()) == {"not identified"}
    assert fit.combinations == {}


# --- SciPy as a cross-check ----------------------------------------------------------------------

DECAY = 3.0 * np.exp(-0.8 * X) + 0.5 + 0.03 * np.random.default_rng(2).normal(size=X.size)


def decay(p):
    return p["height"] * jnp.exp(-p["rate"] * X) + p["floor"]


@pytest.mark.parametrize("sigma", [None, 0.03])
def test_curve_fit_agrees(sigma):
    start = {"height": 1.0, "rate": 1.0, "floor": 1.0}
    fit = least_squares_fit(decay, start, DECAY, sigma)
    names = ("height", "rate", "floor")
    expected, covariance = optimize.curve_fit(
        lambda x, height, rate, floor: height * np.exp(-rate * x) + floor,
        X,
        DECAY,
        p0=np.ones(3),
        sigma=sigma and np.full(X.size, sigma),
        absolute_sigma=sigma is not None,
        ftol=1e-12,
        xtol=1e-12,
    )
    np.testing.assert_allclose([fit.value[n] for n in names], expected, rtol=1e-6)
    # curve_fit differentiates numerically
    np.testing.assert_allclose([fit.standard_error[n] for n in names], np.sqrt(np.diag(covariance)), rtol=1e-4)


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


@pytest.mark.parametrize("bound", [(-5.0, None), (None, 5.0), (-5.0, 5.0), (0.0, None), (0.0, 1e6)])
def test_bounds_out_of_the_way_change_nothing(bound):
    fit = least_squares_fit(line, START, NOISY, SIGMA, {"b": bound})
    assert fit.success
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], [A_HAT, B_HAT], rtol=SETTLED)
    np.testing.assert_allclose(fit.covariance, SIGMA**2 * COVARIANCE, rtol=1e-5)
    assert fit.status == {"a": "identified", "b": "identified"}


@pytest.mark.parametrize(
    ("bound", "start", "slope", "active"),
    [
        ((0.7, None), 1.0, 0.5, 0.7),
        ((None, 0.2), 0.1, 0.5, 0.2),
        ((0.7, 2.0), 1.0, 0.5, 0.7),
        ((-1.0, 0.2), -0.5, 0.5, 0.2),
        ((1e-3, None), 1.0, -0.5, 1e-3),
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


@pytest.mark.parametrize(
    ("name", "joined"),
    [("p0 * p1", lambda a, b: a * b), ("p0 / p1", lambda a, b: a / b), ("p0^2 / p1", lambda a, b: a**2 / b)],
)
@pytest.mark.parametrize("start", [(1.0, 1.0), (7.0, 0.2)])
@pytest.mark.parametrize("bounds", [None, {"p0": (0.0, None), "p1": (0.0, None)}])
def test_combinations(name, joined, start, bounds):
    joined_name = "p0 / p1^0.5" if name == "p0^2 / p1" else name  # the largest power is one
    fit = least_squares_fit(
        lambda p: joined(p["p0"], p["p1"]) * X, dict(zip(("p0", "p1"), start, strict=True)), PROPORTIONAL, SIGMA, bounds
    )
    assert fit.rank == 1
    assert fit.condition_number == np.inf
    assert fit.status == {"p0": "not identified", "p1": "not identified"}
    assert fit.standard_error == {"p0": np.inf, "p1": np.inf}
    assert list(fit.combinations) == [joined_name]
    value, error = fit.combinations[joined_name]
    power = 0.5 if name == "p0^2 / p1" else 1.0  # of the one parameter that the data hold
    assert value == pytest.approx(Q_HAT**power, rel=1e-6)
    assert error == pytest.approx(power * Q_HAT ** (power - 1) * Q_ERROR, rel=1e-6)


def test_a_sum_of_parameters():
    fit = least_squares_fit(lambda p: (p["p0"] + p["p1"]) * X, {"p0": 1.0, "p1": 2.0}, PROPORTIONAL, SIGMA)
    assert fit.value["p0"] + fit.value["p1"] == pytest.approx(Q_HAT, rel=SETTLED)
    assert fit.status == {"p0": "not identified", "p1": "not identified"}
    assert fit.standard_error == {"p0": np.inf, "p1": np.inf}
    assert fit.confidence_interval["p0"] == (-np.inf, np.inf)
    assert fit.rank == 1
    # along the sloppy direction, powers of the parameters, the sum stays as it is
    assert sum(fit.sloppy_direction[n] * fit.value[n] for n in ("p0", "p1")) == pytest.approx(0.0, abs=1e-9)
    assert fit.combinations == {}  # none that is a product


def test_a_parameter_without_effect():
    fit = least_squares_fit(line, START | {"c": 1.0}, NOISY, SIGMA)
    assert fit.status == {"a": "identified", "b": "identified", "c": "not identified"}
    assert fit.standard_error["c"] == np.inf
    assert fit.standard_error["a"] == pytest.approx(SIGMA * np.sqrt(COVARIANCE[0, 0]), rel=SETTLED)
    assert (fit.rank, fit.condition_number) == (2, np.inf)


def test_a_parameter_known_to_no_better_than_half_its_size():
    """The rule of the library: identified below a relative standard error of 0.5."""
    data = 0.02 * X + np.random.default_rng(5).normal(size=X.size)
    fit = least_squares_fit(lambda p: p["a"] * X, {"a": 0.02}, data, 1.0, {"a": (0.0, None)})
    estimate, error = np.sum(X * data) / np.sum(X**2), 1.0 / np.sqrt(np.sum(X**2))
    assert error > 0.5 * abs(estimate)
    assert fit.status["a"] in ("not identified", "at bound")
    assert fit.standard_error["a"] == np.inf


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


def test_noise_known_for_one_group(groups):
    fit = least_squares_fit(two_lines, LEVELS, groups, {"fine": 0.03, "coarse": None})
    assert fit.noise["fine"] == pytest.approx(0.03)
    assert fit.noise["coarse"] == pytest.approx(0.3, rel=4 / np.sqrt(2 * 29))  # four standard errors of a spread
    assert fit.noise_estimated


@pytest.fixture(scope="module")
def joint(groups):
    return least_squares_fit(
        two_lines, LEVELS, groups, {"fine": 0.03, "coarse": 0.3}, priors={"coarse_level": (-2.0, 0.1)}
    )


def test_told_by_one_group(joint):
    alone = joint.told_by("fine")
    assert alone.status == {"fine_level": "identified", "slope": "identified", "coarse_level": "not identified"}
    # the line through that group, its noise as given: sigma^2 (X'X)^-1, without the prior
    expected = 0.03 * np.sqrt(np.diag(COVARIANCE))
    np.testing.assert_allclose([alone.standard_error["fine_level"], alone.standard_error["slope"]], expected, rtol=1e-6)
    assert alone.value == joint.value
    assert alone.rank == 2


def test_told_by_all_groups_is_the_fit_without_its_prior(groups, joint):
    _, covariance, _, _ = weighted(groups, 0.03, 0.3)
    both = joint.told_by("fine", "coarse")
    np.testing.assert_allclose([both.standard_error[n] for n in LEVELS], np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert both.status["coarse_level"] == "identified"


# --- names, structures and compilation -----------------------------------------------------------


def test_names_of_an_array():
    fit = least_squares_fit(lambda p: p[0] + p[1] * X, np.ones(2), NOISY, SIGMA)
    assert fit.names == ("[0]", "[1]")
    np.testing.assert_allclose(list(fit.value.values()), [A_HAT, B_HAT], rtol=SETTLED)
    np.testing.assert_allclose(fit.parameters, [A_HAT, B_HAT], rtol=SETTLED)


def test_names_of_a_nested_mapping():
    def predict(p):
        return p["level"] + p["shape"]["slopes"][0] * X + p["shape"]["slopes"][1] * X**2

    start = {"level": 1.0, "shape": {"slopes": np.array([1.0, 0.1])}}
    fit = least_squares_fit(predict, start, NOISY, SIGMA, {"shape.slopes[1]": (-1.0, None)})
    expected = np.polynomial.polynomial.polyfit(X, NOISY, 2)
    assert set(fit.names) == {"level", "shape.slopes[0]", "shape.slopes[1]"}
    np.testing.assert_allclose(fit.parameters["shape"]["slopes"], expected[1:], rtol=1e-5)
    assert fit.value["shape.slopes[0]"] == pytest.approx(expected[1], rel=1e-5)


def test_the_same_model_again_is_not_compiled_again():
    traces = []

    def predict(p):
        traces.append(1)
        return p["a"] + p["b"] * X

    least_squares_fit(predict, START, NOISY)
    count = len(traces)
    assert count > 0
    again = least_squares_fit(predict, {"a": 3.0, "b": -1.0}, NOISY + 1.0)
    assert again.value["a"] == pytest.approx(A_HAT + 1.0, rel=SETTLED)
    assert len(traces) == count


# --- parameters that are not fitted, or measured otherwise ----------------------------------------

CURVED = {"a": 1.0, "b": {"slopes": np.array([1.0, 0.1])}}


def curved(p):
    return p["a"] + p["b"]["slopes"][0] * X + p["b"]["slopes"][1] * X**2


def test_a_fixed_parameter_keeps_its_start():
    fit = least_squares_fit(line, {"a": 1.9, "b": 1.0}, NOISY, SIGMA, fixed=["a"])
    assert fit.names == ("b",)
    assert float(fit.parameters["a"]) == 1.9
    slope = np.sum(X * (NOISY - 1.9)) / np.sum(X**2)  # least squares with the level given
    assert fit.value["b"] == pytest.approx(slope, rel=SETTLED)
    assert fit.standard_error["b"] == pytest.approx(SIGMA / np.sqrt(np.sum(X**2)), rel=SETTLED)
    assert fit.degrees_of_freedom == 29


@pytest.mark.parametrize(("fixed", "fitted"), [("b.slopes", ("a",)), ("b.slopes[1]", ("a", "b.slopes[0]"))])
def test_the_name_of_an_array_fixes_all_of_it(fixed, fitted):
    fit = least_squares_fit(curved, CURVED, NOISY, SIGMA, fixed=[fixed])
    assert fit.names == fitted
    columns = np.stack([np.ones_like(X), X, X**2], axis=1)[:, : len(fitted)]
    rest = (X + 0.1 * X**2) if len(fitted) == 1 else 0.1 * X**2
    expected = np.linalg.lstsq(columns, NOISY - rest, rcond=None)[0]
    np.testing.assert_allclose([fit.value[n] for n in fitted], expected, rtol=SETTLED)
    assert fit.parameters["b"]["slopes"][1] == 0.1


def test_shared_parameters_are_one():
    fit = least_squares_fit(curved, CURVED, NOISY, SIGMA, shared={"b.slopes[1]": "b.slopes[0]"})
    assert fit.names == ("a", "b.slopes[0]")
    columns = np.stack([np.ones_like(X), X + X**2], axis=1)
    expected, covariance = np.linalg.lstsq(columns, NOISY, rcond=None)[0], np.linalg.inv(columns.T @ columns)
    np.testing.assert_allclose(list(fit.value.values()), expected, rtol=SETTLED)
    np.testing.assert_allclose(fit.covariance, SIGMA**2 * covariance, rtol=SETTLED)
    np.testing.assert_allclose(fit.parameters["b"]["slopes"], [expected[1]] * 2, rtol=SETTLED)


def test_shared_with_a_fixed_one():
    fit = least_squares_fit(curved, CURVED, NOISY, SIGMA, fixed=["b.slopes[0]"], shared={"b.slopes[1]": "b.slopes[0]"})
    assert fit.names == ("a",)
    assert fit.value["a"] == pytest.approx(np.mean(NOISY - X - X**2), rel=SETTLED)
    np.testing.assert_array_equal(fit.parameters["b"]["slopes"], [1.0, 1.0])


def test_a_fixed_and_a_shared_parameter_among_others():
    """The two lines of the groups below with one level and the slope given: two weighted means."""
    data = {"fine": 1.0 + 0.5 * X, "coarse": 1.2 + 0.5 * X}
    fit = least_squares_fit(
        two_lines,
        {"fine_level": 0.0, "coarse_level": 0.0, "slope": 0.5},
        data,
        {"fine": 0.1, "coarse": 0.2},
        fixed={"slope"},
        shared={"coarse_level": "fine_level"},
    )
    assert fit.value["fine_level"] == pytest.approx((1.0 / 0.01 + 1.2 / 0.04) / (1 / 0.01 + 1 / 0.04), rel=SETTLED)


@pytest.mark.parametrize("bound", [None, (0.2, None), (None, 0.7), (0.2, 0.9)])
def test_a_uniform_prior_is_a_pair_of_bounds(bound):
    bounds = None if bound is None else {"b": bound}
    fit = least_squares_fit(line, {"a": 1.0, "b": 0.4}, NOISY, SIGMA, bounds, priors={"b": Uniform(0.3, 0.8)})
    assert fit.success
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], [A_HAT, B_HAT], rtol=SETTLED)
    lower, upper = (0.3 if bound is None else max(0.3, bound[0] or 0.3)), min(0.8, (bound or (0, 0.8))[1] or 0.8)
    i = fit.names.index("b")
    assert (fit.evidence.lower[i], fit.evidence.upper[i]) == (lower, upper)


def test_a_uniform_prior_off_the_data_ends_at_its_edge():
    fit = least_squares_fit(line, {"a": 1.0, "b": 0.65}, NOISY, SIGMA, priors={"b": Uniform(0.6, 0.7)})
    assert fit.status["b"] == "at bound"
    assert fit.value["b"] == pytest.approx(0.6, abs=1e-4)


def test_uniform_beside_gaussian_priors():
    both = {"a": Uniform(0.0, 5.0), "b": (0.6, 0.02)}
    fit = least_squares_fit(line, START, NOISY, SIGMA, priors=both)
    precision = DESIGN.T @ DESIGN / SIGMA**2 + np.diag([0.0, 1 / 0.02**2])  # conjugate; the bounds are far away
    expected = np.linalg.solve(precision, DESIGN.T @ NOISY / SIGMA**2 + [0.0, 0.6 / 0.02**2])
    np.testing.assert_allclose([fit.value["a"], fit.value["b"]], expected, rtol=SETTLED)


def test_a_scale_judges_what_is_zero():
    """An offset of 0.000 +- 0.01 is known well for what may be 1, and not for what may be 0.01."""
    level = NOISY - A_HAT - B_HAT * X  # the best level is 0
    error = SIGMA / np.sqrt(X.size)
    fits = {
        scale: least_squares_fit(lambda p: p["a"] + 0 * X, {"a": 0.0}, level, SIGMA, scales={"a": scale})
        for scale in (1.0, 0.01)
    }
    for fit in fits.values():
        assert fit.value["a"] == pytest.approx(0.0, abs=1e-8)
    assert fits[1.0].status["a"] == "identified"
    assert fits[1.0].standard_error["a"] == pytest.approx(error, rel=1e-4)
    assert error > 0.5 * 0.01
    assert fits[0.01].status["a"] == "not identified"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fixed": ["c"]}, "fixed: there is no parameter 'c'; there are a, b"),
        ({"fixed": ["a", "b"]}, "there is no parameter to fit"),
        ({"shared": {"c": "a"}}, "shared: there is no parameter 'c'; there are a, b"),
        ({"shared": {"a": "c"}}, "shared: there is no parameter 'c'; there are a, b"),
        ({"shared": {"a": "a"}}, "shared: a cannot follow a; name one parameter that is neither itself"),
        ({"shared": {"a": "b", "b": "a"}}, "shared: a cannot follow b"),
        ({"fixed": ["a"], "shared": {"a": "b"}}, "shared: a cannot follow b"),
        ({"fixed": ["a"], "bounds": {"a": (0.0, 2.0)}}, "bounds for 'a', which is not fitted; fitted are b"),
        ({"shared": {"a": "b"}, "priors": {"a": (0.0, 2.0)}}, "prior for 'a', which is not fitted; fitted are b"),
        ({"fixed": ["a"], "scales": {"a": 1.0}}, r"scale of 'a': needs a number > 0 and a parameter that is fitted"),
        ({"scales": {"a": 0.0}}, r"scale of 'a': needs a number > 0"),
        ({"scales": {"a": np.nan}}, r"scale of 'a': needs a number > 0"),
        ({"priors": {"c": Uniform(0.0, 1.0)}}, "prior for 'c'|bounds for 'c'"),
        ({"priors": {"a": Uniform(3.0, 4.0)}}, "a starts at 1, which is not inside its bounds 3 to 4"),
        ({"priors": {"a": Uniform(2.0, 0.0)}}, "prior for a: 2 to 0 is no range; write the lower first"),
        ({"loss": "tukey"}, "loss 'tukey' is not known; there are linear, soft_l1, huber, cauchy"),
        ({"starts": 0}, "starts must be a whole number of 1 or more, got 0"),
        ({"starts": 2.5}, r"starts must be a whole number of 1 or more, got 2\.5"),
        ({"starts": True}, "starts must be a whole number of 1 or more, got True"),
    ],
)
def test_refusals_of_options(change, message):
    with pytest.raises(InputError, match=f"^({message})"):
        least_squares_fit(line, START, NOISY, **change)


# --- information criteria -------------------------------------------------------------------------


def test_information_criteria_of_known_noise(known):
    """Akaike (1974) and Schwarz (1978): 2 k - 2 ln L and k ln n - 2 ln L, here of two parameters and 30 data."""
    log_likelihood = np.sum(stats.norm.logpdf(NOISY, DESIGN @ [A_HAT, B_HAT], SIGMA))
    assert known.log_likelihood == pytest.approx(log_likelihood, rel=1e-9)
    criteria = {"AIC": 4 - 2 * log_likelihood, "BIC": 2 * np.log(30) - 2 * log_likelihood}
    assert known.information_criteria == pytest.approx(criteria, rel=1e-9)


def test_information_criteria_of_estimated_noise(unknown):
    """The noise is a third parameter; the likelihood is that at its estimate without bias."""
    log_likelihood = np.sum(stats.norm.logpdf(NOISY, DESIGN @ [A_HAT, B_HAT], np.sqrt(RSS / 28)))
    criteria = {"AIC": 6 - 2 * log_likelihood, "BIC": 3 * np.log(30) - 2 * log_likelihood}
    assert unknown.information_criteria == pytest.approx(criteria, rel=1e-5)


def test_information_criteria_prefer_the_line_to_the_parabola():
    """One parameter more for what is nothing but noise: BIC knows, the rise in likelihood is below ln(30) / 2."""
    parabola = least_squares_fit(curved, CURVED, NOISY, SIGMA)
    straight = least_squares_fit(line, START, NOISY, SIGMA)
    assert 0 < parabola.log_likelihood - straight.log_likelihood < np.log(30) / 2
    assert straight.information_criteria["BIC"] < parabola.information_criteria["BIC"]


# --- failures and refusals -----------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [None, SIGMA])
def test_a_model_without_a_number_is_a_failure_that_says_so(sigma):
    fit = least_squares_fit(lambda p: jnp.log(-(p["a"] ** 2)) * X, {"a": -1.0}, NOISY, sigma)
    assert not fit.success
    assert "no number" in fit.result
    assert fit.restarted == (
        "the search ended where the model gives no number; 32 searches from other starts found nothing better"
    )
    assert fit.status["a"] == "not identified"
    assert fit.standard_error["a"] == np.inf


def test_too_few_steps_are_a_failure():
    fit = least_squares_fit(decay, {"height": 100.0, "rate": 10.0, "floor": -5.0}, DECAY, 0.03, max_steps=2)
    assert not fit.success
    assert "stopped short" in fit.result


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds": {"a": (2.0, 3.0)}}, "a starts at 1, which is not inside its bounds 2 to 3; move the start or the"),
        ({"bounds": {"a": (1.0, None)}}, "a starts at 1, which is not inside its bounds 1 to inf"),
        ({"bounds": {"a": (3.0, -3.0)}}, "a starts at 1, which is not inside its bounds 3 to -3"),
        ({"bounds": {"c": (0.0, 1.0)}}, "bounds for 'c', which is not fitted; fitted are a, b"),
        ({"priors": {"c": (0.0, 1.0)}}, "prior for 'c', which is not fitted; fitted are a, b"),
        ({"priors": {"a": (0.0, 0.0)}}, "prior for a: needs a mean and a standard deviation > 0, got 0.0, 0.0"),
        ({"priors": {"a": (np.nan, 1.0)}}, "prior for a: needs a mean and a standard deviation > 0, got nan, 1.0"),
        ({"sigma": 0.0}, "sigma of data must be > 0"),
        ({"sigma": -1.0}, "sigma of data must be > 0"),
        ({"sigma": np.nan}, "sigma of data must be > 0"),
        ({"sigma": [1.0, 2.0]}, r"sigma has 2 entries for 1 groups of data \(data\)"),
        ({"observed": np.where(X > 2.9, np.nan, NOISY)}, "data: entry 30 is not finite; leave it out"),
        ({"observed": np.zeros(0)}, "there are no data to fit"),
        ({"observed": {}}, "there are no data to fit"),
        ({"start": {"a": np.nan, "b": 1.0}}, "a starts at nan"),
    ],
)
def test_refusals(change, message):
    arguments = {"predict": line, "start": START, "observed": NOISY} | change
    with pytest.raises(InputError, match=f"^{message}"):
        least_squares_fit(**arguments)


def test_noise_of_a_group_that_is_not_there(groups):
    with pytest.raises(InputError, match="sigma"):
        least_squares_fit(two_lines, LEVELS, groups, {"fine": 0.03, "rough": 0.3})


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(InputError, match=r"double precision: call jax\.config\.update"):
        least_squares_fit(line, START, NOISY)


# --- what to be wary of --------------------------------------------------------------------------


@pytest.mark.parametrize("order", [("a", "c"), ("c", "a")])
def test_the_order_of_priors_does_not_matter(order):
    """No datum depends on c, and its prior leaves it as it was."""
    priors = {"a": (2.0, 0.5), "c": (1.0, 0.1)}
    fit = least_squares_fit(
        lambda p: line(p) + 0 * p["c"], START | {"c": 1.0}, NOISY, SIGMA, priors={name: priors[name] for name in order}
    )
    assert fit.status == {"a": "identified", "b": "identified", "c": "prior only"}
    assert fit.standard_error["c"] == pytest.approx(0.1)


def test_a_sum_is_no_product():
    """Of c + d only the sum is told; c d can be anything. Of c d the product is."""
    start = {"a": 1.0, "c": 1.0, "d": 1.0}
    of_sum = least_squares_fit(lambda p: p["a"] + (p["c"] + p["d"]) * X, start, NOISY + 2 * X, SIGMA)
    assert [of_sum.status[name] for name in "cd"] == ["not identified"] * 2
    assert of_sum.combinations == {}
    of_product = least_squares_fit(lambda p: p["a"] + p["c"] * p["d"] * X, start, NOISY + 2 * X, SIGMA)
    value, error = of_product.combinations["c * d"]
    assert value == pytest.approx(B_HAT + 2, rel=1e-6)
    assert error == pytest.approx(SIGMA * np.sqrt(np.linalg.inv(DESIGN.T @ DESIGN)[1, 1]), rel=1e-6)


def test_a_product_of_many_rows():
    """30,000 rows: what needs a square matrix of them needs 7 GB."""
    x = np.linspace(0.0, 3.0, 30_000)
    fit = least_squares_fit(lambda p: p["c"] * p["d"] * x, {"c": 1.0, "d": 1.0}, 2.0 * x + 0.1 * np.cos(50 * x), 0.1)
    value, error = fit.combinations["c * d"]
    assert value == pytest.approx(np.sum(x * (2.0 * x + 0.1 * np.cos(50 * x))) / np.sum(x**2), rel=1e-6)
    assert error == pytest.approx(0.1 / np.sqrt(np.sum(x**2)), rel=1e-6)


@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_an_outlier_is_pointed_out(sigma):
    """Its distance is that of statsmodels' externally studentised residual where the noise is estimated."""
    data = NOISY.copy()
    data[7] += 10 * SIGMA
    fit = least_squares_fit(line, START, data, sigma)
    (remark,) = fit.remarks
    hat = DESIGN @ np.linalg.inv(DESIGN.T @ DESIGN) @ DESIGN.T
    residual = (data - hat @ data)[7] / np.sqrt(1 - hat[7, 7])
    left = np.delete(np.arange(30), 7)
    alone = data[left] - DESIGN[left] @ np.linalg.lstsq(DESIGN[left], data[left], rcond=None)[0]
    distance = residual / (sigma or np.sqrt(np.sum(alone**2) / 27))
    assert f"entry 8 of data lies {distance:.2g} standard deviations off the model" in remark


def test_an_outlier_that_bends_the_model():
    """Of a log(1 + b x) one reading is five times too large: the distance is that from SciPy's fit to all others."""
    x = np.linspace(0.1, 3.0, 26)
    data = np.log1p(2.0 * x) + 0.002 * np.random.default_rng(3).normal(size=26)
    data[5] *= 5

    def model(x, a, b):
        return a * np.log1p(b * x)

    left = np.delete(np.arange(26), 5)
    (a, b), covariance = optimize.curve_fit(model, x[left], data[left], p0=[1.0, 2.0])
    scatter = np.sqrt(np.sum((data[left] - model(x[left], a, b)) ** 2) / 23)  # 25 data, 2 parameters
    slope = np.array([np.log1p(b * x[5]), a * x[5] / (1 + b * x[5])])
    distance = (data[5] - model(x[5], a, b)) / np.hypot(scatter, np.sqrt(slope @ covariance @ slope))
    start, bounds = {"a": 1.5, "b": 1.0}, {"b": (0.0, None)}
    fit = least_squares_fit(lambda p: p["a"] * jnp.log1p(p["b"] * x), start, data, bounds=bounds)
    assert any(f"entry 6 of data lies {distance:.0f} standard deviations off" in remark for remark in fit.remarks)


@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_honest_noise_has_hardly_ever_an_outlier(sigma):
    """One experiment in a hundred; of 200, more than 7 one time in a thousand."""
    rng = np.random.default_rng(5)
    alarms = [
        least_squares_fit(line, START, DESIGN @ [2.0, 0.5] + SIGMA * rng.normal(size=30), sigma) for _ in range(200)
    ]
    assert sum(bool(fit.remarks) for fit in alarms) <= stats.binom.ppf(0.999, 200, 0.01)


def test_data_met_exactly_tell_no_noise():
    fit = least_squares_fit(line, START, DESIGN @ [2.0, 0.5])
    assert fit.remarks == ("data is met exactly, which tells no noise: standard errors mean nothing; give the noise",)
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
    assert again.restarted.startswith("the search from the given start hardly explained the data; ")


def test_repeats_of_one_level_are_explained():
    """Their scatter is noise and nothing else, and their mean is told by it."""
    data = 5.0 + 0.1 * np.random.default_rng(1).normal(size=30)
    fit = least_squares_fit(lambda p: p["a"] + 0 * X, {"a": 1.0}, data)
    assert (fit.success, fit.status) == (True, {"a": "identified"})
    assert fit.value["a"] == pytest.approx(data.mean(), rel=1e-9)


def test_few_degrees_of_freedom_are_named():
    fit = least_squares_fit(lambda p: p["a"] + 0 * X[:2], {"a": 1.0}, NOISY[:2])
    assert any("noise is told by 1 degree(s) of freedom only" in remark for remark in fit.remarks)


@pytest.mark.parametrize("shift", [-0.3, 0.3])
def test_what_is_not_told_from_its_bound_has_a_limit_above(shift):
    """A slope of shift standard errors, at least 0: at most itself (or 0) and 1.96 standard errors."""
    error = SIGMA * np.sqrt(np.linalg.inv(DESIGN.T @ DESIGN)[1, 1])
    data = NOISY - (B_HAT - shift * error) * X
    fit = least_squares_fit(line, {"a": 1.0, "b": 1.0}, data, SIGMA, {"b": (0.0, None)})
    assert fit.status["b"] == ("at bound" if shift < 0 else "not identified")
    assert fit.bounded_above == ("b",)
    expected = (max(shift, 0.0) + stats.norm.ppf(0.975)) * error
    assert fit.confidence_interval["b"] == (0.0, pytest.approx(expected, rel=1e-3))
    assert shift > 0 or fit.value["b"] == 0


def test_predictions_of_another_size():
    with pytest.raises(InputError, match=r"predict gives arrays of \[30\] numbers where the data have \[4\]"):
        least_squares_fit(line, START, NOISY[:4])


def test_residuals_that_grow_are_told():
    """Noise of 1 % and of one size, the same draws; a line from 1 to 31."""
    x, draws = np.linspace(0.0, 3.0, 40), np.random.default_rng(5).normal(size=40)
    truth = 1.0 + 10.0 * x
    grown = least_squares_fit(lambda p: p["a"] + p["b"] * x, START, truth * (1 + 0.01 * draws))
    even = least_squares_fit(lambda p: p["a"] + p["b"] * x, START, truth + 0.1 * draws)
    assert any("residuals grow with the reading" in remark for remark in grown.remarks)
    assert not any("residuals grow" in remark for remark in even.remarks)
