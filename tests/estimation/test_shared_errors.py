"""Errors of inputs, against generalised least squares and restricted likelihood with dense covariances in NumPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.residuals import NO_ERRORS, InputErrors

ROWS = 12
X = np.linspace(1.0, 3.0, ROWS)
TRUTH = {"a": 0.5, "b": 2.0}
NOISE = {"one": 0.03, "two": 0.05}
INPUT = 0.04


def model(p, x=X):
    """Two readings of each row; the last three of `two` also remember the input of row 6."""
    kept = jnp.where(jnp.arange(ROWS) >= 9, x[5], x)
    return {"one": p["a"] * x, "two": p["a"] * kept + p["b"]}


def by_input(p):
    """The derivatives of the readings by the inputs."""
    two = p["a"] * np.eye(ROWS)
    two[9:] = 0.0
    two[9:, 5] = p["a"]
    return {"one": p["a"] * np.eye(ROWS), "two": two}


def inputs(sigma):
    return InputErrors(
        lambda p: {"x": {name: np.asarray(own) for name, own in by_input(p).items()}}, {"x": sigma}, {"x": 0.3}
    )


def draw(seed=0, size=INPUT):
    rng = np.random.default_rng(seed)
    read = {name: np.asarray(own) for name, own in model(TRUTH, X + size * rng.normal(size=ROWS)).items()}
    return {name: own + NOISE[name] * rng.normal(size=ROWS) for name, own in read.items()}


def dense(variances, slope=TRUTH["a"]):
    """The covariance of all readings for the variances of both columns and of the input."""
    effect = np.concatenate([*by_input({"a": slope}).values()])
    return np.diag(np.repeat(variances[:2], ROWS)) + variances[2] * effect @ effect.T


DESIGN = np.stack([np.concatenate([X, np.where(np.arange(ROWS) >= 9, X[5], X)]), np.repeat([0.0, 1.0], ROWS)], axis=1)


def generalised(variances, data, slope):
    """Estimate and standard errors of generalised least squares."""
    weight = np.linalg.inv(dense(variances, slope))
    covariance = np.linalg.inv(DESIGN.T @ weight @ DESIGN)
    return covariance @ DESIGN.T @ weight @ np.concatenate([*data.values()]), np.sqrt(np.diag(covariance))


def test_known_errors_of_inputs_are_generalised_least_squares():
    data = draw()
    found = least_squares_fit(model, TRUTH, data, NOISE, inputs=inputs(INPUT))
    variances = np.array([*NOISE.values(), INPUT]) ** 2
    value, error = generalised(variances, data, found.value["a"])
    np.testing.assert_allclose([*found.value.values()], value, rtol=1e-6)
    np.testing.assert_allclose([*found.standard_error.values()], error, rtol=1e-3)
    left = np.concatenate([*data.values()]) - DESIGN @ value
    covariance = dense(variances, found.value["a"])
    square, logarithm = left @ np.linalg.solve(covariance, left), np.linalg.slogdet(2 * np.pi * covariance)[1]
    assert found.log_likelihood == pytest.approx(-0.5 * (square + logarithm), rel=1e-6)
    np.testing.assert_allclose(found.residuals["one"], left[:ROWS], atol=1e-9)


def test_estimated_errors_of_inputs_have_the_largest_restricted_likelihood():
    data = draw(seed=3, size=0.1)
    found = least_squares_fit(model, TRUTH, data, inputs=inputs(None))
    read = np.concatenate([*data.values()])

    def height(logarithms):
        covariance = dense(np.exp(logarithms), found.value["a"])
        weight = np.linalg.inv(covariance)
        information = DESIGN.T @ weight @ DESIGN
        left = read - DESIGN @ np.linalg.solve(information, DESIGN.T @ weight @ read)
        return np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1] + left @ weight @ left

    best = minimize(height, np.log([1e-3, 1e-3, 1e-2]), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    expected = np.exp(best.x / 2)
    np.testing.assert_allclose([*found.noise.values(), found.input_noise["x"]], expected, rtol=1e-3)


def test_scatter_that_errors_of_inputs_explain_is_not_met_exactly():
    """`one` scatters by a twentieth of what the given errors of inputs make: no noise besides, and it is not met."""
    data = draw() | {"one": TRUTH["a"] * X + 0.001 * np.cos(50 * X)}
    found = least_squares_fit(model, TRUTH, data, inputs=inputs(INPUT))
    assert found.noise["one"] < 1e-6
    assert 0.0005 < np.std(found.residuals["one"]) < 0.0015
    said = "one scatters as errors of what was set make it, its own noise is estimated as 0; give it"
    assert [remark for remark in found.remarks if remark.startswith("one ")] == [said]


def test_inputs_without_errors_change_nothing():
    """With 1e-9 of noise, and where none is seen in data that have none."""
    data = draw(seed=2, size=0.0)
    plain, tiny, unseen = (
        least_squares_fit(model, TRUTH, data, inputs=given) for given in (NO_ERRORS, inputs(1e-9), inputs(None))
    )
    assert unseen.input_noise == {"x": 0.0}
    for found in (tiny, unseen):
        for name in plain.names:
            assert found.value[name] == pytest.approx(plain.value[name], rel=1e-6)
            np.testing.assert_allclose(found.confidence_interval[name], plain.confidence_interval[name], rtol=1e-6)


@pytest.mark.parametrize(("slope", "result"), [(0.7, "successful"), (10.0, "the noise estimates did not settle")])
def test_an_effect_that_jumps_with_the_estimate(slope, result):
    """An input moves reading `one` where m < 0, else `two`: the weighted mean of both then has the other sign.

    By the weights w = 1 / (1 + slope^2) it goes to and fro between 0.3 (1 - w) / (1 + w) and the opposite: by 0.6
    standard errors for a slope of 0.7, by 14 for 10. Both readings are nearer to the mean than their noise: these
    standard errors are of their scatter.
    """

    def by_input(p):
        first = float(p["m"]) < 0
        return {"x": {"one": np.array([[slope * first]]), "two": np.array([[slope * (not first)]])}}

    data, noise = {"one": np.array([-0.3]), "two": np.array([0.3])}, {"one": 1.0, "two": 1.0}
    inputs = InputErrors(by_input, {"x": 1.0}, {"x": 1.0})

    def mean(p):
        return {"one": p["m"][None], "two": p["m"][None]}

    found = least_squares_fit(mean, {"m": 0.1}, data, noise, inputs=inputs, accuracy=1e-6)
    assert found.result.startswith(result)
    weight = 1 / (1 + slope**2)
    assert abs(found.value["m"]) == pytest.approx(0.3 * (1 - weight) / (1 + weight), rel=1e-6)


def test_where_the_model_has_no_slope_an_input_has_no_effect():
    """As without errors of inputs; a search can pass a place where the slopes have no number."""
    data = draw()
    without = least_squares_fit(model, {"a": 1.0, "b": 1.0}, data, NOISE)
    slopes = InputErrors(
        lambda p: {"x": {name: np.full((ROWS, ROWS), np.nan) for name in NOISE}}, {"x": INPUT}, {"x": 0.3}
    )
    found = least_squares_fit(model, {"a": 1.0, "b": 1.0}, data, NOISE, inputs=slopes)
    assert found.success
    for name, value in without.value.items():
        assert found.value[name] == pytest.approx(value, rel=1e-9)
        assert found.standard_error[name] == pytest.approx(without.standard_error[name], rel=1e-9)
