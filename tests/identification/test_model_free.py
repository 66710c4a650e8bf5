"""Friction from tensions and tip angles alone: the capstan law inverted, its errors, and what it warns of.

Expected values come from the capstan law itself, T_tip = T_base exp(-mu theta), with a mu that the test chooses;
standard errors from Monte Carlo with seeded noise; distributions from what a test statistic must follow.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from places import DATA
from refusals import refused
from scipy import stats

from cddf_jax.identification.model_free import model_free_friction
from cddf_jax.measurements.table import Measurements, read_measurements

MU = 0.42
BASE = np.tile(np.arange(10.0, 81.0, 10.0), 3)
ANGLE = np.log1p(MU / 1.4e6 * 2.942783188998e4 * BASE) / MU  # closed form of the paper's body, docs/theory.md (16)
NOISE = {"base_tension": 0.05, "tip_tension": 0.2, "tip_angle": np.radians(0.5)}
REPLICATES = 2000


def table_of(base, angle, mu: ArrayLike = MU, noise=None, rng: Any = None, **columns):
    """A table that follows the law, plus noise."""
    values = {"base_tension": base, "tip_tension": base * np.exp(-np.multiply(mu, angle)), "tip_angle": angle}
    if noise is not None:
        values = {name: exact + noise[name] * rng.standard_normal(len(base)) for name, exact in values.items()}
    return Measurements.from_columns("bench", **values, **columns)


def share(truths):
    return np.mean(list(truths))


# --- the value -----------------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [0.0, 1.5])
def test_exact_data_give_the_exact_value(mu):
    found = model_free_friction(table_of(BASE, ANGLE, mu))
    np.testing.assert_allclose(found.estimate, mu, atol=1e-13)  # rounding of exp and log over the smallest angle
    assert found.value == pytest.approx(mu, abs=1e-13)


def test_a_tendon_that_slides_out_and_a_body_that_bends_away_give_the_same():
    out = Measurements.from_columns(
        base_tension=BASE, tip_tension=BASE * np.exp(MU * ANGLE), tip_angle=-ANGLE, direction=-np.ones(24)
    )
    np.testing.assert_allclose(model_free_friction(out).estimate, MU, rtol=1e-13)
    assert model_free_friction(out).value == pytest.approx(MU, rel=1e-13)


@pytest.mark.parametrize("trial", [None, np.arange(24) % 5])
def test_it_is_the_line_through_the_origin(trial):
    """LAPACK's least squares of one column; its standard error from leaving out one row (trial) after another."""
    noisy = table_of(BASE, ANGLE, noise=NOISE, rng=np.random.default_rng(5))
    x, y = noisy["tip_angle"], np.log(noisy["base_tension"] / noisy["tip_tension"])
    solution = np.linalg.lstsq(x[:, None], y, rcond=None)[0]
    columns = {} if trial is None else {"trial": trial.astype(float)}
    found = model_free_friction(Measurements.from_columns("bench", **noisy.columns, **columns))
    assert found.value == pytest.approx(solution[0], rel=1e-13)
    labels = np.arange(24) if trial is None else trial
    left_out = np.array([np.sum((x * y)[labels != k]) / np.sum((x * x)[labels != k]) for k in np.unique(labels)])
    assert found.standard_error == pytest.approx(np.linalg.norm(left_out - found.value), rel=1e-10)
    half = stats.t(left_out.size - 1).ppf(0.975) * found.standard_error
    assert found.confidence_interval == pytest.approx((found.value - half, found.value + half))


# --- its standard error --------------------------------------------------------------------------


def covered_and_rejected(tips, base, angle, **columns):
    """How often the interval holds the truth, and how often one mu is rejected, for the tip tensions of each bench."""
    tables = [Measurements.from_columns(base_tension=base, tip_tension=t, tip_angle=angle, **columns) for t in tips]
    found = [model_free_friction(table) for table in tables]
    covered = share(low < MU < high for low, high in (each.confidence_interval for each in found))
    return covered, share(each.constancy.p_value < 0.05 for each in found)


def test_estimated_noise_of_few_rows_covers_as_it_says():
    noise = 0.02 * np.random.default_rng(6).standard_normal((REPLICATES, 8))
    base, angle = BASE[:8], ANGLE[:8]
    covered, rejected = covered_and_rejected(base * np.exp(-MU * angle + noise), base, angle)
    assert 0.94 < covered < 0.98  # eight rows, the jackknife errs a little to the safe side
    assert 0.02 < rejected < 0.06


def test_what_the_rows_of_a_trial_share_is_in_the_standard_error():
    """Six trials of four rows; of rows alone, the interval holds the truth in 67 % where friction scatters."""
    rng, trial = np.random.default_rng(11), np.repeat(np.arange(6), 4)
    mu = MU * (1 + 0.02 * rng.standard_normal((REPLICATES, 6)))[:, trial]
    tips = BASE * np.exp(-mu * ANGLE + 0.005 * rng.standard_normal((REPLICATES, 24)))
    covered, rejected = covered_and_rejected(tips, BASE, ANGLE, trial=trial)
    assert 0.93 < covered < 0.985  # the jackknife of few groups errs to the safe side
    assert rejected < 0.07


# --- one mu in all rows? -------------------------------------------------------------------------


def test_a_drift_is_found():
    rng = np.random.default_rng(7)
    drift = 0.001  # 1/N: 0.07 over the bench, some 5 standard errors
    found = [model_free_friction(table_of(BASE, ANGLE, MU + drift * (BASE - 45), NOISE, rng)) for _ in range(300)]
    assert share(each.constancy.p_value < 0.05 for each in found) > 0.95
    assert np.mean([each.constancy.slope for each in found]) == pytest.approx(drift, rel=0.05)
    assert any("drifts with base tension by more than chance" in line for line in found[0].verdict)


# --- rows that determine little ------------------------------------------------------------------


@pytest.mark.parametrize("row", [(20.0, 20.1, 1e-300), (20.0, 0.0, 0.3), (0.0, 0.1, 0.001)])
def test_rows_without_an_angle_or_a_tension_are_left_out(row):
    table = table_of(BASE, ANGLE, noise=NOISE, rng=np.random.default_rng(10))
    more = Measurements.from_columns(
        **{name: [value, *table[name]] for name, value in zip(table.columns, row, strict=True)}
    )
    one, other = model_free_friction(table), model_free_friction(more)
    assert (one.value, one.standard_error) == (other.value, other.standard_error)
    assert np.isnan(other.estimate[0])
    assert "of 24 of 25 rows" in other.verdict[0]


def test_of_a_loop_the_rows_of_the_pull_count():
    """20 -> 75 -> 40 -> 60 -> 10 N: the capstan law holds for the first two rows, and is off by a half elsewhere."""
    base, way = np.array([20.0, 75, 40, 60, 10]), np.array([1, 1, 0.5, 0.5, 0.5])
    table = Measurements.from_columns(
        base_tension=base, tip_tension=base * np.exp(-MU * way), tip_angle=np.ones(5), step=range(5)
    )
    found = model_free_friction(table)
    assert found.value == pytest.approx(MU, rel=1e-9)
    assert np.isfinite(found.estimate).tolist() == [True, True, False, False, False]


def test_with_several_tendons_the_stated_direction_counts_in_any_order():
    """Tendon 1 slides out while the other is pulled: T_tip = T_base exp(mu theta)."""
    pull = {"base_tension": np.full(4, 10.0), "base_tension_2": np.linspace(30.0, 75.0, 4)}
    angle = np.linspace(-0.2, -0.8, 4)
    read = {"tip_tension": 10.0 * np.exp(MU * np.abs(angle)), "tip_angle": angle}
    stated = {"direction": np.full(4, -1.0), "direction_2": np.ones(4), "step": np.arange(4.0)}
    found = model_free_friction(Measurements.from_columns("pair", **pull, **read, **stated))
    assert found.value == pytest.approx(MU, rel=1e-12)
    assert np.count_nonzero(np.isfinite(found.estimate)) == 4


def test_one_row_determines_the_value_but_not_its_noise():
    table = table_of(BASE[:1], ANGLE[:1])
    found = model_free_friction(table)
    assert found.value == pytest.approx(MU)
    assert (found.standard_error, found.confidence_interval) == (np.inf, (-np.inf, np.inf))
    assert np.isnan(found.constancy.p_value)
    assert any("do not show whether it depends on base tension: measure more rows" in line for line in found.verdict)


def test_one_row_that_outweighs_all_others_is_alone():
    table = Measurements.from_columns(base_tension=[20, 30, 40], tip_tension=[20, 30, 30], tip_angle=[1e-6, 1e-6, 1])
    found = model_free_friction(table)
    assert found.standard_error == np.inf
    assert np.isnan(found.constancy.p_value)


def test_one_level_cannot_show_a_drift():
    """The base cell's noise would make one: it moves base tension and estimate together."""
    level = np.full(12, 50.0)
    table = table_of(level, np.full(12, 0.9), noise=NOISE, rng=np.random.default_rng(12))
    found = model_free_friction(table)
    assert np.isnan(found.constancy.slope)
    assert np.isfinite(found.standard_error)


def test_what_the_verdict_cannot_check_it_mentions():
    both = model_free_friction(table_of(BASE, ANGLE, tip_force_y=np.ones(24)))
    assert any("A force acts on the body" in line for line in both.verdict)


def test_the_shipped_table():
    """data/README.md: mu 0.42; friction differs by 1 % from trial to trial, three of them, and the gain is 1.001."""
    table = read_measurements(DATA / "tip_angle_simulated.csv")
    found = model_free_friction(table)
    shared = np.hypot(0.0042 / np.sqrt(3), 0.001 / np.mean(table["tip_angle"]))
    assert abs(found.value - 0.42) < 3 * np.hypot(found.standard_error, shared)
    # the scatter of three trials is chi-distributed with 2 degrees of freedom: 99 % lie below 2.15 times the true one
    assert found.standard_error < 2.15 * 0.004


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"tip_tension": None}, "bench: no column 'tip_tension'; friction without a model needs base_tension,"),
        ({"tip_angle": [0, 0]}, "bench: no row has tensions and a tip angle other than 0; measure at tensions"),
        ({"base_tension_2": [5, 5]}, "bench: several tendons and no column 'direction'; add it: 1 where"),
    ],
)
def test_errors(columns, message):
    given = {"base_tension": [10, 20], "tip_tension": [9, 17], "tip_angle": [0.2, 0.4]} | columns
    table = Measurements.from_columns("bench", **{name: values for name, values in given.items() if values is not None})
    assert refused(model_free_friction, table).startswith(message)
