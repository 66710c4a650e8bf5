"""The errors of a bench: what is put into simulated readings comes out of the fit, with its true scatter."""

from typing import Any

import jax
import numpy as np
import pytest
from bodies import paper_body, paper_with
from kinds import bench_of
from refusals import refused
from scipy import stats
from test_fit import LEVELS, MU, E, closed_form, wrap

import cddf_jax as cddf
from cddf_jax.identification.bench import Bench, BenchModel, groups_of
from cddf_jax.identification.fit_inputs import noise_of, split_noise, unread_rows
from cddf_jax.identification.parameters import (
    OF_SPACE,
    OF_STRETCH,
    PARAMETERS,
    RUBBING,
    starting_value,
    unit_of,
    with_parameters,
)
from cddf_jax.identification.predictions import beyond_the_data
from cddf_jax.identification.tension_before import is_past
from cddf_jax.measurements.table import Measurements

BASE = np.tile(LEVELS, 6)
TRIAL = np.repeat(np.arange(6), LEVELS.size)
CELL, ANGLE = 0.2, 0.005  # standard deviations, N and rad


def readings(seed, base=BASE, mu: Any = MU, gain=1.0, zero=0.0, turned=0.0, pretension=0.0, **columns):
    """Tensions and angles of the closed form, exact kinematics, as imperfect instruments read them."""
    rng = np.random.default_rng(seed)
    tip = gain * (closed_form(base + pretension, mu) - pretension) + zero + CELL * rng.normal(size=base.size)
    angle = wrap(base + pretension, mu) + turned + ANGLE * rng.normal(size=base.size)
    return Measurements.from_columns("bench", base_tension=base, tip_tension=tip, tip_angle=angle, **columns)


@pytest.fixture(scope="module")
def paper():
    return paper_body("exact")


def within(fit, **truth):
    for name, value in truth.items():
        assert abs(fit.value[name] - value) < 4 * fit.standard_error[name], name


NOISE = {"tip_tension": CELL, "tip_angle": ANGLE}
BOTH = ("friction_coefficient", "youngs_modulus")


@pytest.mark.slow
def test_gain_and_zeros_of_the_instruments(paper):
    truth = {"tip_gain": 1.02, "tip_zero": 0.3, "angle_zero": 0.01}
    table = readings(1, gain=1.02, zero=0.3, turned=0.01)
    exact = NOISE | {"base_tension": 0.0}
    found = cddf.fit(paper, table, (*BOTH, *truth), {"tip_gain": (1.0, 0.03)}, noise=exact)
    assert found.success
    within(found, friction_coefficient=MU, youngs_modulus=E, **truth)
    assert set(found.status.values()) == {"identified"}
    # a fit that takes the cells at their word is far off
    plain = cddf.fit(paper, table, noise=exact)
    assert plain.reduced_chi_square > 2
    assert pytest.approx(2 * 5 - 2 * found.log_likelihood) == found.information_criteria["AIC"]
    assert found.information_criteria["AIC"] < plain.information_criteria["AIC"]


def test_what_the_cells_read(paper):
    """Under a pretension of 2 N: 1.02 (T - 2 N) + 0.5 N at the base, 1.1 (T_tip - 2 N) - 0.3 N at the tip."""
    tension = np.array([20.0, 50.0, 80.0])
    bench = bench_of(readings(1, 1.02 * (tension - 2.0) + 0.5), paper)
    errors = {"base_gain": 1.02, "base_zero": 0.5, "pretension": 2.0, "tip_gain": 1.1, "tip_zero": -0.3}
    read = jax.jit(lambda p: bench.predict(paper, p, 16))(errors | {"angle_zero": 0.01})
    np.testing.assert_allclose(read["tip_tension"], 1.1 * (closed_form(tension) - 2.0) - 0.3, rtol=1e-7)
    np.testing.assert_allclose(read["tip_angle"], wrap(tension) + 0.01, rtol=1e-7)


@pytest.mark.slow
def test_tolerances_of_the_dimensions_widen_the_modulus(paper):
    """E J is what bends: an outer radius known to 0.1 mm leaves E uncertain by dlnE = -dlnJ/dR dR, here about 2 %."""
    table = readings(4)
    tight = cddf.fit(paper, table, noise=NOISE)
    prior = {"outer_radius_error": (0.0, 1e-4)}
    loose = cddf.fit(paper, table, (*BOTH, *prior), prior, noise=NOISE)
    assert loose.status["outer_radius_error"] == "prior only"
    within(loose, friction_coefficient=MU, youngs_modulus=E)
    assert loose.standard_error["friction_coefficient"] == pytest.approx(
        tight.standard_error["friction_coefficient"], rel=0.05
    )
    # G = int d/J ds weighs the slope of ln J; by differences of the body's own compliance
    h = 1e-6

    def compliance(radius_error):
        body = with_parameters(paper, {"outer_radius_error": radius_error})
        s = np.linspace(0, 0.14, 2001)
        return np.trapezoid(0.010 / np.asarray(body.second_moment(s)), s)

    slope = (compliance(h) - compliance(-h)) / (2 * h) / compliance(0.0)
    expected = np.hypot(tight.standard_error["youngs_modulus"] / E, slope * 1e-4)
    assert loose.standard_error["youngs_modulus"] / E == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_friction_that_differs_from_trial_to_trial(paper):
    """Six deviations of ln mu, drawn with standard deviation 0.1; what they are is seen to 1 %."""
    rng = np.random.default_rng(3)
    deviations = 0.1 * rng.normal(size=6)
    table = readings(5, mu=MU * np.exp(deviations)[TRIAL], trial=TRIAL)
    # with a prior that says next to nothing, on a parameter that comes after the trials
    found = cddf.fit(paper, table, priors={"youngs_modulus": (1.4e6, 0.7e6)}, noise=NOISE, per_trial=True)
    effects = np.array([effect.value for effect in found.trial_effects.values()])
    # the mean of six is not the truth; what differs between trials is
    np.testing.assert_allclose(effects - effects.mean(), deviations - deviations.mean(), atol=0.02)
    # with effects known this well, EM ends at their root mean square about 0
    assert found.trial_spread == pytest.approx(np.sqrt(np.mean(effects**2)), rel=0.2)
    # the mean over trials has the scatter of six draws, not that of 102 rows
    assert found.standard_error["friction_coefficient"] / MU == pytest.approx(found.trial_spread / np.sqrt(6), rel=0.1)
    pooled = cddf.fit(paper, table, noise=NOISE)
    assert pooled.standard_error["friction_coefficient"] < 0.2 * found.standard_error["friction_coefficient"]
    assert any("trial to trial" in line for line in found.verdict)

    # t-statistics with 5 degrees of freedom, because six trials determine the spread; the rows determine the modulus
    def quantile(name):
        low, high = found.confidence_interval[name]
        return (high - low) / 2 / found.standard_error[name]

    assert quantile("friction_coefficient") == pytest.approx(stats.t.ppf(0.975, 5), rel=0.02)
    assert quantile("youngs_modulus") == pytest.approx(stats.norm.ppf(0.975), rel=1e-3)
    assert found.trial_spread == pytest.approx(deviations.std(ddof=1), rel=0.1)  # as seen to 1 % of friction each
    # AIC of the readings as draws that correlate within a trial, by SciPy's multivariate normal
    mu, modulus, step = found.value["friction_coefficient"], found.value["youngs_modulus"], 1e-4

    def predicted(moved):
        both = [model(BASE, mu * np.exp(effects[TRIAL] + moved), modulus) for model in (closed_form, wrap)]
        return np.concatenate(both)

    sigma, trial = np.repeat([CELL, ANGLE], BASE.size), np.tile(TRIAL, 2)
    slope = (predicted(step) - predicted(-step)) / (2 * step) / sigma
    without_effects = predicted(0.0) / sigma - slope * effects[trial]
    residual = np.concatenate([table["tip_tension"], table["tip_angle"]]) / sigma - without_effects
    covariance = np.eye(trial.size) + found.trial_spread**2 * np.outer(slope, slope) * (trial[:, None] == trial)
    likelihood = stats.multivariate_normal.logpdf(residual, cov=covariance) - np.sum(np.log(sigma))
    assert found.information_criteria["AIC"] == pytest.approx(2 * 3 - 2 * likelihood, abs=0.01)
    assert pooled.information_criteria["AIC"] > found.information_criteria["AIC"] + 100


@pytest.mark.slow
def test_trials_that_do_not_differ(paper):
    found = cddf.fit(paper, readings(6, trial=TRIAL), noise=NOISE, per_trial=True)
    assert found.trial_spread < 0.01
    within(found, friction_coefficient=MU, youngs_modulus=E)


@pytest.mark.slow
def test_every_parameter_reaches_the_readings(paper):
    """Each parameter of a bench with one tendon changes what is read, by a derivative that differences confirm.

    `before` and friction besides that on the body belong to benches with a history (test_fit_of_loops.py,
    test_friction_elsewhere.py), backlash and lag to those driven by displacement (test_displacement.py). The direction
    of gravity, and what leaves the plane, belong to bodies in space (test_fit_in_space.py).
    """
    bench = Bench(np.array([[30.0], [60.0]]), (None,))
    elsewhere = (*OF_SPACE, *OF_STRETCH, "gravity_turn_z", "backlash", "lag", *RUBBING)
    names = [name for name in PARAMETERS if not is_past(name) and name not in elsewhere]
    parameters = {name: starting_value(paper, name) for name in names}
    value, slope, *_ = bench.evaluate(paper, parameters, 16)
    for i, name in enumerate(sorted(parameters)):
        step = 1e-4 * max(abs(parameters[name]), PARAMETERS[name].scale)
        ends = [bench.evaluate(paper, parameters | {name: parameters[name] + sign * step}, 16)[0] for sign in (1, -1)]
        size = np.zeros(2)
        for column in value:
            difference = (ends[0][column] - ends[1][column]) / (2 * step)
            np.testing.assert_allclose(
                slope[column][:, i], difference, rtol=1e-4, atol=1e-6 * np.max(np.abs(difference)) + 1e-9
            )
            size = np.maximum(size, np.abs(difference))
        assert np.all(size > 0), name


def test_which_rows_lie_beyond_the_data():
    """By hand, in base tension and in either component of a force on the tip or at 60 mm; a pulley test holds none."""

    def rows(**columns):
        return Measurements.from_columns("rows", **columns, tip_angle=np.zeros(len(columns["base_tension"])))

    data = rows(base_tension=[10.0, 40.0], tip_force_y=[-1.0, -1.0], **{"force_y@60mm": [0.0, -2.0]})
    wanted = {"base_tension": [20.0] * 5 + [41.0], "tip_force_y": [-1.0, -1.1, *[-1.0] * 4]}
    wanted |= {"tip_force_x": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], "force_y@6cm": [-1.0, 0.0, 0.0, -2.1, 0.1, 0.0]}
    assert beyond_the_data(rows(**wanted), [data]).tolist() == [False, True, True, True, True, True]
    pulley = Measurements.from_columns("pulley", weight=[1.0], wrap_angle=[1.0], pulling_tension=[1.5])
    assert beyond_the_data(rows(base_tension=[10.0]), [pulley]).tolist() == [True]
    assert beyond_the_data(rows(base_tension=[10.0]), [rows(base_tension=[5.0, 20.0])]).tolist() == [False]
    pair = rows(base_tension=[10.0, 10.0], base_tension_2=[0.0, 1.0])
    assert beyond_the_data(pair, [rows(base_tension=[5.0, 20.0])]).tolist() == [False, True]
    driven = Measurements.from_columns("driven", displacement=[1e-3], displacement_2=[1e-3], tip_angle=[0.0])
    assert beyond_the_data(pair, [driven]).tolist() == [True, True]  # no tension is known, and none was 0


def test_which_rows_lie_on_one_curve(paper):
    """A free body of one tendon that is pulled in has one answer for each base tension; nothing else has."""
    columns = {"base_tension": [10.0, 20.0], "tip_tension": [9.0, 18.0]}
    others = {
        "forces": (paper, {"tip_force_y": [0.0, -1.0]}),
        "slides out": (paper, {"direction": [1.0, -1.0]}),
        "two tendons": (paper_body("exact", num_tendons=2), {"base_tension_2": [0.0, 0.0]}),
    }
    rubbing = paper_with(cddf.Tendon(0.010, outside_friction=0.3))  # which acts along a history only
    rows = unread_rows(Measurements.from_columns("bench", **columns), rubbing, cddf.BenchSetting(), ())
    assert isinstance(rows, Bench)
    assert not rows.on_one_curve
    assert bench_of(Measurements.from_columns("bench", **columns), paper).on_one_curve
    for body, extra in others.values():
        assert not bench_of(Measurements.from_columns("bench", **columns, **extra), body).on_one_curve


@pytest.mark.parametrize(
    ("name", "unit"),
    [  # by hand
        ("youngs_modulus", "Pa"),
        ("tip_zero_2", "N"),
        ("friction_coefficient", "1"),
        ("friction_coefficient / youngs_modulus", "1/Pa"),
        ("drag * length^2 / youngs_modulus^0.5", "N/m m^2/Pa^0.5"),
        ("1 / drag / youngs_modulus", "1/(N/m)/Pa"),
        ("c * d", ""),
    ],
)
def test_units_of_parameters_and_of_their_products(name, unit):
    assert unit_of(name) == unit


def test_noise_follows_its_readings():
    """A column that sets the tendons of one table and is read in another."""
    lengths = {"displacement": [1e-3, 2e-3, 3e-3]}
    driven = Measurements.from_columns("driven", **lengths, tip_angle=[0.1, 0.2, 0.3])
    pulled = Measurements.from_columns("pulled", base_tension=[5.0, 10.0, 15.0], **lengths)
    predicted, of_base = split_noise({"displacement": 1e-4}, [driven, pulled])
    assert predicted == of_base == {"displacement": 1e-4}
    (group,) = groups_of([pulled], BenchModel(paper_body("exact"), (bench_of(pulled, paper_body("exact")),), 16))
    assert noise_of([group], predicted) == {"pulled: displacement": 1e-4}
    for given in (np.array([1e-4, 2e-4]), [1e-4], -1.0, np.nan):
        said = refused(cddf.fit, paper_body("exact"), pulled, noise={"displacement": given})
        assert "noise of displacement must be one standard deviation in m, 0 or more" in said


@pytest.mark.parametrize("name", ["tip_gain_3", "base_gain_0"])
def test_parameters_of_tendons_that_are_not_there(name):
    table = Measurements.from_columns("bench", base_tension=[5.0], base_tension_2=[0.0], tip_angle=[0.1])
    said = refused(cddf.fit, paper_body("exact", num_tendons=2), table, ("friction_coefficient", name))
    assert said == f"{name}: there is no such tendon, the body has 2; they count from 1"


@pytest.mark.slow
def test_antagonists_may_hang_slack_in_turn():
    """Tendon 2 alone bends the body of the plane as tendon 1 does, to the other side."""
    body, lengths = paper_body("exact", num_tendons=2), np.array([2e-3, 4e-3])
    tables = (
        Measurements.from_columns("one", **{name: lengths}, tip_angle=[0.2, 0.4])
        for name in ("displacement", "displacement_2")
    )
    rows = [unread_rows(table, body, cddf.BenchSetting(), ()) for table in tables]
    one, other = (each.solved(body, {}, 16).tip_angle for each in rows if isinstance(each, Bench))
    np.testing.assert_allclose(other, -one, rtol=1e-12)
    assert np.all(one > 0.1)
