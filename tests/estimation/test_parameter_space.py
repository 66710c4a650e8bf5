"""Names and bounds of parameters, and the searches from other starts."""

import jax.numpy as jnp
import numpy as np
import pytest
from straight_line import A_HAT, B_HAT, NOISY, SIGMA, START, X, line

from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.parameter_space import parameter_space

SETTLED = 1e-6  # what is quadratic near the minimum loses half of the digits of the cost


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


# --- scales ---------------------------------------------------------------------------------------


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


def test_information_criteria_prefer_the_line_to_the_parabola():
    """One parameter more for what is nothing but noise: BIC knows, the rise in likelihood is below ln(30) / 2."""

    def curved(p):
        return p["a"] + p["b"] * X + p["c"] * X**2

    parabola = least_squares_fit(curved, START | {"c": 0.1}, NOISY, SIGMA)
    straight = least_squares_fit(line, START, NOISY, SIGMA)
    assert 0 < parabola.log_likelihood - straight.log_likelihood < np.log(30) / 2
    assert straight.information_criteria["BIC"] < parabola.information_criteria["BIC"]


# --- other starts ------------------------------------------------------------------------------


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
    assert far.value["w"] == pytest.approx(near.value["w"], rel=1e-6)
    assert far.starts.size > 1


def test_what_data_leave_open_is_not_searched_for_long():
    """A product that the data tell is no trouble."""
    product = least_squares_fit(
        lambda p: p["c"] * p["d"] * X, {"c": 1.0, "d": 1.0}, 1.5 * X + 0.01 * np.cos(9 * X), SIGMA
    )
    assert (product.restarted, product.starts.size) == ("", 0)


def test_other_starts_lie_within_the_bounds():
    lower, upper = np.array([[-np.inf, -np.inf, 1.0, -np.inf, 1.0], [np.inf, np.inf, np.inf, 4.0, 5.0]])
    space = parameter_space(tuple("abcde"), np.array([-3.0, 0.0, 2.0, 2.0, 2.0]), lower, upper)
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
