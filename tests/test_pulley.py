"""Eq. (5): a weight raised over a fixed pulley."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cddf_jax as cddf


@pytest.mark.parametrize(
    ("weight", "friction", "wrap", "expected"),
    [
        (10.0, 0.42, np.pi / 2, 19.3428),  # by hand: 0.42 pi/2 = 0.659734, e^0.659734 = 1.93428
        (10.0, 0.42, np.pi, 37.4144),  # twice the wrap, the factor squared
        (7.0, 0.42, 0.0, 7.0),  # no wrap
        (7.0, 0.0, np.pi, 7.0),  # no friction
        (0.0, 0.42, np.pi, 0.0),  # no weight
    ],
)
def test_numbers(weight, friction, wrap, expected):
    assert cddf.pulling_tension(weight, friction, wrap) == pytest.approx(expected, rel=1e-5)


@given(st.floats(0.1, 100.0), st.floats(0.01, 1.5), st.floats(0.1, 10.0))
def test_friction_is_the_logarithm_of_the_ratio(weight, friction, wrap):
    """Eq. (5) turned round: mu = ln(T / W) / theta."""
    pulled = float(cddf.pulling_tension(weight, friction, wrap))
    assert np.log(pulled / weight) / wrap == pytest.approx(friction, rel=1e-10)


def test_two_pulleys_in_a_row_are_one_of_both_wraps():
    between = cddf.pulling_tension(10.0, 0.42, 0.5)
    assert cddf.pulling_tension(between, 0.42, 1.2) == pytest.approx(float(cddf.pulling_tension(10.0, 0.42, 1.7)))


def test_rows_and_derivatives():
    weight, wrap = np.array([5.0, 10.0]), np.array([1.0, 2.0])
    pulled, slope = jax.jvp(lambda mu: cddf.pulling_tension(weight, mu, wrap), (0.42,), (1.0,))
    np.testing.assert_allclose(pulled, weight * np.exp(0.42 * wrap), rtol=1e-14)
    np.testing.assert_allclose(slope, wrap * pulled, rtol=1e-14)  # dT/dmu = theta T
