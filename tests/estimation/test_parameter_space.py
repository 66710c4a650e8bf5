"""Names and bounds of parameters, and the searches from other starts."""

import numpy as np
import pytest
from straight_line import A_HAT, B_HAT, NOISY, SIGMA, START, X

from cddf_jax.estimation.least_squares import least_squares_fit

SETTLED = 1e-6  # what is quadratic near the minimum loses half of the digits of the cost


# --- names, structures and compilation -----------------------------------------------------------


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


@pytest.mark.parametrize(("read", "scale", "known"), [(3.0, 1.0, False), (7.0, 1.0, True), (0.0, 3.0, True)])
def test_what_may_be_zero_is_not_identified_because_noise_made_it_large(read, scale, known):
    """One reading with an error of 1.2: 3.0 may be a large error, 7.0 is no error, and 3.0 matters more than 1.2."""
    fit = least_squares_fit(lambda p: p["a"][None], {"a": 0.1}, np.array([read]), 1.2, scales={"a": scale})
    assert (fit.status["a"] == "identified") == known
