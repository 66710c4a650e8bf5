"""Holds and repeats are distinguished; readings of a hold that are alike are noticed."""

import numpy as np
import pytest
from bodies import paper_body
from scipy import stats

import cddf_jax as cddf
from cddf_jax.measurements.holds import average_holds, correlation_of_rows, hold_labels
from cddf_jax.measurements.table import Measurements
from cddf_jax.reports import fit_report as report

LEVELS = np.arange(10.0, 81.0, 10.0)


def autoregressive(shape, lag_one, rng):
    """Noise of variance 1 along the last axis: e_k = r e_(k-1) + sqrt(1 - r^2) draw."""
    draws = rng.normal(size=shape)
    noise = draws.copy()
    for k in range(1, shape[-1]):
        noise[..., k] = lag_one * noise[..., k - 1] + np.sqrt(1 - lag_one**2) * draws[..., k]
    return noise


# --- what is a hold ------------------------------------------------------------------------------


def runs(levels, trial=None):
    labels = hold_labels(np.asarray(levels, float)[:, None], np.zeros(len(levels)) if trial is None else trial)
    return np.bincount(labels).tolist()


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ([5, 5, 5, 10, 10, 5, 5], [3, 2, 2]),  # the same level later is a repeat
        ([5, 10, 15, 20, 25], [1, 1, 1, 1, 1]),
        ([5, 10, 15, 5, 10, 15], [1] * 6),  # repeats, no holds
        ([0, 0, 0, 50, 50], [3, 2]),
        ([7], [1]),
        (np.linspace(0, 80, 400), [1] * 400),  # a ramp, 0.25 % a row
        (np.abs(np.linspace(-80, 80, 801)), [1] * 801),  # down and up
        ([1, 2, 3, 4, 10, 20], [1] * 6),
    ],
)
def test_holds_of_levels(levels, expected):
    assert runs(levels) == expected


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2, 0.5])
def test_holds_under_noise_of_the_input(noise):
    """Up to 0.6 % of the largest level, with steps of 10 N."""
    levels = np.repeat(LEVELS, 50) + noise * np.random.default_rng(1).normal(size=400)
    assert runs(levels) == [50] * 8


def test_a_hold_ends_with_its_trial_and_where_another_column_changes():
    assert runs([5, 5, 5, 5], np.array([0, 0, 1, 1])) == [2, 2]
    levels = np.stack([np.full(6, 20.0), [5, 5, 5, 9, 9, 9]], axis=1)
    np.testing.assert_array_equal(hold_labels(levels, np.zeros(6)), [0, 0, 0, 1, 1, 1])


# --- how alike its rows are ----------------------------------------------------------------------


@pytest.mark.parametrize("lag_one", [0.5, 0.9, 0.98])
def test_correlation_from_row_to_row(lag_one):
    """2,000 holds of 50, to four standard errors."""
    residual = autoregressive((2000, 50), lag_one, np.random.default_rng(2))
    found = correlation_of_rows(residual.ravel(), np.repeat(np.arange(2000), 50))
    assert found == pytest.approx(lag_one, abs=4 * np.sqrt((1 - lag_one**2) / 1e5) + 1e-3)


def test_independent_rows_hardly_ever_alarm():
    """One experiment in a thousand; of 500, more than 5 less than one time in 10,000. Without holds there is none."""
    rng, holds = np.random.default_rng(3), np.repeat(np.arange(8), 50)
    alarms = sum(correlation_of_rows(rng.normal(size=400), holds) > 0 for _ in range(500))
    assert alarms <= stats.binom.ppf(0.9999, 500, 1e-3)
    assert correlation_of_rows(np.ones(20), np.arange(20)) == 0


# --- one reading a hold --------------------------------------------------------------------------


def test_one_reading_a_hold():
    table = Measurements.from_columns(
        "bench",
        trial=["a", "a", "a", "b", "b", "b"],
        base_tension=[5.0, 5.0, 10.0, 10.0, 10.0, 5.0],
        tip_tension=[4.0, 4.2, 9.0, 8.0, 8.2, 4.4],
        direction=[1.0, 1.0, 1.0, 1.0, 1.0, -1.0],
    )
    found = average_holds(table)
    np.testing.assert_array_equal(found["base_tension"], [5, 10, 10, 5])
    np.testing.assert_allclose(found["tip_tension"], [4.1, 9.0, 8.1, 4.4], rtol=1e-15)
    np.testing.assert_array_equal(found["direction"], [1, 1, 1, -1])
    np.testing.assert_array_equal(found["trial"], [0, 0, 1, 1])
    np.testing.assert_array_equal(found.rows, [1, 3, 4, 6])  # where each begins
    assert found.read_as == ("bench: each hold averaged to one reading: 6 rows became 4",)
    assert average_holds(found) is found


def test_a_fit_reports_holds():
    """A pulley test of five weights, 30 samples each: in the first lines of the report, and no more once averaged."""
    weight = np.repeat([2.0, 5.0, 10.0, 15.0, 20.0], 30)
    noise = 0.1 * autoregressive((5, 30), 0.9, np.random.default_rng(7)).ravel()
    pull = weight * np.exp(0.42 * np.pi) + noise  # eq. (5)
    table = Measurements.from_columns("drum", weight=weight, wrap_angle=np.full(150, np.pi), pulling_tension=pull)
    fits = [cddf.fit(paper_body(), t, free=("friction_coefficient",)) for t in (table, average_holds(table))]
    heads = [report.fit_as_markdown(fit, {}).partition("| parameter")[0] for fit in fits]
    told = "150 in 5 holds are not as many independent ones: standard errors are too small"
    assert [told in head for head in heads] == [True, False]
    # of equal holds the weighted means are the same to first order, and the standard error is that of five readings
    assert fits[1].value["friction_coefficient"] == pytest.approx(fits[0].value["friction_coefficient"], rel=1e-3)
    assert fits[1].degrees_of_freedom == 4
    assert str(fits[1].alone["drum"]) == fits[1].verdict[0]  # one table, in the words of the whole
