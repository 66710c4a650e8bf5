"""Fits of benches whose tendons are driven by displacement: what they determine, and what they do not."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kinds import bench_of
from refusals import refused

import cddf_jax as cddf
from cddf_jax.identification.course import course_of, paths_of
from cddf_jax.measurements.table import Measurements

D, MU, MODULUS, COMPLIANCE = 0.009, 0.3, 1.4e6, 2e-5  # m, 1, Pa, m/N
BOTH = ["friction_coefficient", "youngs_modulus"]
ALL = [*BOTH, "slack_offset", "outside_compliance"]
LOOP = 1e-3 * np.array([0, 2, 4, 6, 8, 10, 8, 6, 4, 2, 4, 6, 8, 10, 12, 10, 8, 6, 4, 2, 0.5])  # m
ANGLE, TENSION = 2e-4, 0.01  # noise, rad and N


def robot(modulus=MODULUS, mu=MU, compliance: float | None = COMPLIANCE, tendons=1):
    own = tuple(cddf.Tendon(D, side, outside_compliance=compliance) for side in (1, -1)[:tendons])
    numbers: dict[str, Any] = {"youngs_modulus": modulus, "friction_coefficient": mu}
    return cddf.Manipulator(length=0.14, outer_radius=0.012, inner_radius=0.007, tendons=own, **numbers)


def guess(compliance: float | None = 1e-5, tendons=1):
    return robot(1e6, 0.2, compliance, tendons)


def loop(offset=0.0, *, noisy=False, tensions=False, ordered=True):
    """The loop of one tendon, read by an encoder that shows `offset` where the tendon begins to pull."""
    history, random = cddf.trace(robot(), [cddf.Displacement(LOOP)]), np.random.default_rng(1)
    read = {"tip_angle": (history.tip_angle, ANGLE), "tip_tension": (history.tip_tension, TENSION)}
    columns = {"displacement": LOOP + offset}
    for name, (values, noise) in read.items():
        if name == "tip_angle" or tensions:
            columns[name] = np.asarray(values) + noisy * random.normal(0.0, noise, LOOP.size)
    columns |= {"step": np.arange(LOOP.size)} if ordered else {}
    return Measurements.from_columns("simulated", **columns)


KNOWN = {"displacement": 0.0, "tip_angle": ANGLE}


@pytest.mark.slow
def test_a_loop_with_tip_tensions_brings_the_truth_back():
    found = cddf.fit(guess(), loop(1e-3, tensions=True), ALL, noise=KNOWN | {"tip_tension": TENSION})
    assert found.success
    assert set(found.status.values()) == {"identified"}
    truth = {"friction_coefficient": MU, "youngs_modulus": MODULUS, "outside_compliance": COMPLIANCE}
    for name, value in {**truth, "slack_offset": 1e-3}.items():  # the numbers that the data were made with
        assert abs(found.value[name] - value) < 0.05 * found.standard_error[name]
    np.testing.assert_allclose(found.manipulator.tendon_outside_compliance, found.value["outside_compliance"])


def test_twice_the_modulus_and_half_the_compliance_give_the_same_shape():
    """Kappa = T d / (E J), and d times the tip angle plus C T is the displacement: T / E and E C decide both."""
    one, other = (
        cddf.trace(body, [cddf.Displacement(LOOP)])
        for body in (robot(), robot(modulus=2 * MODULUS, compliance=COMPLIANCE / 2))
    )
    np.testing.assert_allclose(other.tip_angle, one.tip_angle, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(other.tip_tension, 2 * one.tip_tension, rtol=1e-9, atol=1e-9)
    stiff = cddf.trace(robot(compliance=0.0), [cddf.Displacement(LOOP)])  # whatever friction and modulus are
    np.testing.assert_allclose(stiff.tip_angle, LOOP / D, atol=1e-9)


@pytest.mark.slow
def test_a_loop_that_runs_backwards_is_refused():
    """A body that is bent less on the way back than on the way there."""
    pulled = 1e-3 * np.array([*np.linspace(0, 12, 11), 10.5, 9, 7.5, 6, 4.5, 6.5, 8, 5, 3, 1])
    angle = 60 * pulled - np.where(np.arange(LOOP.size) > 10, 0.02, 0.0)
    table = Measurements.from_columns("simulated", displacement=pulled, tip_angle=angle, step=np.arange(LOOP.size))
    found = cddf.fit(guess(), table, ALL, noise={"displacement": 0.0, "tip_angle": 0.01}, starts=1)
    assert not found.success
    assert "run backwards" in found.result
    assert "identified" not in found.status.values()


@pytest.fixture(scope="module")
def by_angles():
    return cddf.fit(guess(), loop(1e-3, noisy=True), ALL, noise=KNOWN)


@pytest.mark.slow
def test_what_is_not_identified_may_be_predicted(by_angles):
    """As `test_predictions_along_a_loop` of tensions, by displacement."""
    path = 1.05 * LOOP
    truth = cddf.trace(robot(), [cddf.Displacement(path)]).tip_angle
    predicted = by_angles.predict("tip_angle", {"displacement": path + 1e-3}, history=True)
    assert np.all(np.abs(predicted.value - truth) < 3 * predicted.half_width)
    assert np.all(predicted.half_width < 2 * ANGLE)
    assert predicted.extrapolated.tolist() == (path > np.max(LOOP)).tolist()


@pytest.mark.slow
def test_tip_angles_hold_the_product_of_modulus_and_compliance(by_angles):
    found = by_angles
    assert found.status["youngs_modulus"] == found.status["outside_compliance"] == "not identified"
    assert found.status["friction_coefficient"] == found.status["slack_offset"] == "identified"
    assert refused(found.predict, "tip_angle", {"tip_force_y": -1.0}) == (
        "predict: the column base_tension is missing; add it"
    )
    (product,) = (line for line in found.verdict if line.startswith("outside_compliance * youngs_modulus"))
    assert "identified, although its factors are not" in product
    value = found.value["youngs_modulus"] * found.value["outside_compliance"]
    assert abs(value / (MODULUS * COMPLIANCE) - 1) < 0.02  # 1.7 % are four standard errors
    assert abs(found.value["friction_coefficient"] - MU) < 3 * found.standard_error["friction_coefficient"]


@pytest.mark.slow
@pytest.mark.parametrize("other", [None, "youngs_modulus", "outside_compliance"])
def test_stretch_of_the_tendon_shows_in_units_of_the_bending(other):
    """Without friction delta = d phi + T L / (E A) + C T, phi = T d L / (E J), and T drops out.

    Angles hold E J (1 / (E A) + C / L) / d^2 alone: the product with the modulus, or the sum of both compliances.
    """
    stretch, inertia = 1e-3, np.pi / 4 * (0.012**4 - 0.007**4)  # 1/N, m^4
    angle = LOOP / (D * (1 + MODULUS * inertia * stretch / D**2))
    table = Measurements.from_columns("closed form", displacement=LOOP, tip_angle=angle, step=np.arange(LOOP.size))
    start = robot(1e6 if other == "youngs_modulus" else MODULUS, 0.0, None)
    found = cddf.fit(start, table, ["tendon_stretch", *([other] if other else [])], noise=KNOWN)
    value = {**{"youngs_modulus": MODULUS, "outside_compliance": 0.0}, **found.value}
    whole = value["youngs_modulus"] * (value["tendon_stretch"] + value["outside_compliance"] / 0.14)
    assert whole == pytest.approx(MODULUS * stretch, rel=1e-4)
    assert {found.status[name] for name in found.names} == {"not identified" if other else "identified"}
    if other == "youngs_modulus":
        assert [*found.combinations] == ["tendon_stretch * youngs_modulus"]
    assert other is None or "a load cell at the tip" in found.verdict[-1]


@pytest.mark.slow
def test_without_compliance_tip_angles_tell_neither_friction_nor_modulus():
    """The angle is the displacement over d, whatever friction and modulus are."""
    angle = LOOP / D
    table = Measurements.from_columns("simulated", displacement=LOOP, tip_angle=angle, step=np.arange(LOOP.size))
    found = cddf.fit(guess(0.0), table, BOTH, noise=KNOWN)
    assert set(found.status.values()) == {"not identified"}
    np.testing.assert_allclose(found.residuals["simulated: tip_angle"], 0.0, atol=1e-9)


@pytest.mark.slow
def test_a_pair_brings_the_truth_back():
    there = 1e-3 * np.array([0, 4, 8, 10, 6, 2, 0, -4, -8, -6, -3, 0, 3, 6, 9])
    tension, seen = 0.4e-3, 2e-4  # both tendons are pulled taut by 0.4 mm; 0.2 mm of noise of the camera
    paths = [cddf.Displacement(way * there + tension) for way in (1, -1)]
    history, random = cddf.trace(robot(tendons=2), paths), np.random.default_rng(3)
    assert np.min(history.base_tension) > 1.0  # no tendon is slack
    x, y = np.asarray(history.tip_position).T + random.normal(0.0, seen, (2, there.size))
    columns = {"displacement": there, "displacement_2": -there, "tip_x": x, "tip_y": y, "step": np.arange(there.size)}
    columns["tip_tension"] = np.asarray(history.tip_tension)[:, 0] + random.normal(0.0, TENSION, there.size)
    table = Measurements.from_columns("simulated", **columns)
    free = [*BOTH, "slack_offset", "slack_offset_2", "outside_compliance"]
    noise = {"displacement": 5e-5, "tip_x": seen, "tip_y": seen, "tip_tension": TENSION}
    found = cddf.fit(guess(tendons=2), table, free, noise=noise)
    assert set(found.status.values()) == {"identified"}
    truth = {"friction_coefficient": MU, "youngs_modulus": MODULUS, "outside_compliance": COMPLIANCE}
    truth |= {"slack_offset": -tension, "slack_offset_2": -tension}
    for name, value in truth.items():
        assert abs(found.value[name] - value) < 3 * found.standard_error[name]
    assert not any("short_steps" in warning for warning in found.warnings)


@pytest.mark.slow
def test_one_tendon_by_tension_and_another_by_displacement():
    """As a `trace` with the same elements and increments; the encoder shows 1 mm where the tendon begins to pull."""
    there, pull, body = 1e-3 * np.array([0, 4, 8, 10, 6, 2, 6, 9]), np.full(8, 3.0), robot(tendons=2)
    history = cddf.trace(body, [pull, cddf.Displacement(there)], nodes=8, short_steps=4)
    columns = {"base_tension": pull, "displacement_2": there + 1e-3, "tip_angle": np.zeros(8), "step": range(8)}
    table = Measurements.from_columns("simulated", **columns)
    rows = bench_of(table, body, course=course_of(table, {"base_tension": 0.0, "displacement": 0.0})[0])
    found = rows.predict(body, {"slack_offset_2": np.asarray(1e-3)}, 12)
    np.testing.assert_allclose(found["tip_angle"], history.tip_angle, atol=1e-9)


@pytest.mark.slow
def test_a_plan_knows_the_lag():
    """The angle moves with the displacement, so that a loop at a known speed shows the time between them."""
    loops = cddf.Candidate("a loop", {"displacement": LOOP, "time": np.arange(LOOP.size)}, {"tip_angle": ANGLE})
    (ranked,) = cddf.plan(robot(), [loops], ["lag"]).ranking
    assert ranked.expected.status["lag"] == "identified"


# --- what stands between motor and tendon -----------------------------------------------------------


def course(displacement, **columns):
    table = Measurements.from_columns(
        "bench", displacement=displacement, tip_angle=np.zeros(len(displacement)), **columns
    )
    return course_of(table, {"displacement": 0.0}, timed="time" in columns)[0]


def test_backlash_holds_a_tendon_until_the_motor_has_come_back_by_it():
    path = np.array([0.0, 1.0, 2.0, 1.9, 1.5, 1.7, 2.1])
    behind = [0.0, 1.0, 2.0, 2.0, 1.8, 1.8, 2.1]  # by hand, with a play of 0.3
    here = course(path, step=np.arange(7))

    def followed(play):
        return here.true_displacement({"backlash": play}, jnp.asarray(here.readings), jnp.zeros(1))[0, :7, 0]

    np.testing.assert_allclose(followed(0.3), behind, atol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(followed)(0.3), [0, 0, 0, 0, 1, 1, 0], atol=1e-12)  # where it is dragged back


def test_a_lag_shows_the_motor_as_it_was_before():
    path, time = np.array([0.0, 1.0, 3.0, 3.0, 0.0]), np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    here = course(path, time=time)

    def shown(lag):
        return here.true_displacement({"lag": lag}, jnp.asarray(here.readings), jnp.zeros(1))[0, :5, 0]

    np.testing.assert_allclose(shown(0.25), [0.0, 0.75, 2.5, 3.0, 0.75], atol=1e-12)  # by hand
    np.testing.assert_allclose(jax.jacfwd(shown)(0.25), [0.0, -1.0, -2.0, 0.0, 3.0], atol=1e-12)  # less the slope


def test_trials_stay_where_each_row_is_pulled_from_rest():
    """Their friction may differ."""
    table = Measurements.from_columns("bench", displacement=[1e-3, 2e-3] * 2, tip_angle=np.zeros(4), trial=[*"aabb"])
    rows = paths_of(table, None)
    here = course_of(table, {"displacement": 0.0}, paths=rows)[0]
    bench = bench_of(table, robot(), course=here)
    assert here.each_from_rest
    assert bench.in_order is None
    assert np.asarray(bench.trial)[here.first_row].tolist() == [0, 0, 1, 1]


def test_where_a_tendon_begins_to_pull_does_not_contradict_a_direction():
    """-2 mm is pulled in from a slack tendon, whatever the encoder shows there."""
    assert course([-2e-3, 1e-3, 4e-3, 2e-3], direction=[1, 1, 1, -1], step=range(4)).readings[0, 0, 0] == -2e-3
    table = Measurements.from_columns(
        "bench", displacement=[2e-3, 1e-3], direction=[1, 1], tip_angle=[0, 0], step=[0, 1]
    )
    assert "is 1, but displacement falls there from 2 mm to 1 mm; correct" in refused(course_of, table)


def test_a_lag_asks_only_tables_of_displacement_for_times():
    pulled = Measurements.from_columns("bench", base_tension=[1.0, 2.0], tip_angle=[0, 0], step=[0, 1])
    assert course_of(pulled, timed=True)[0].time is None
    said = refused(course, [0.0, 1e-3, 2e-3], time=[0.0, 1.0, 1.0])
    assert "row 3, column time: lag needs times that rise with the rows; give times with more digits" in said


def test_turns_of_either_kind_of_column_are_told_in_its_unit():
    """Jitter of 1 um, which is below 1 % of the path, beside tensions that are exact."""
    there = np.repeat(1e-3 * np.array([1.0, 5.0, 9.0]), 6) + 1e-6 * np.random.default_rng(1).normal(size=18)
    columns = {"base_tension": np.arange(1.0, 19.0), "displacement_2": there, "tip_angle": np.zeros(18)}
    table = Measurements.from_columns("bench", **columns, step=range(18))
    found = course_of(table)[1]
    assert list(found) == ["base_tension", "displacement_2"]
    assert found["base_tension"].num_ignored == 0
    assert found["displacement_2"].num_ignored > 0
    assert found["displacement_2"].noise == pytest.approx(1e-6, rel=0.5)


# --- displacements as readings ----------------------------------------------------------------------


@pytest.mark.slow
def test_a_displacement_beside_base_tensions_is_a_reading():
    """With the tensions known, the displacement is d times the angle plus C T: it holds the compliance."""
    pulls = np.array([5.0, 10.0, 15.0, 20.0])
    shown = [cddf.solve(robot(), pull) for pull in pulls]
    moved = np.array([D * float(one.tip_angle) + COMPLIANCE * T for one, T in zip(shown, pulls, strict=True)])
    columns = {"base_tension": pulls, "displacement": moved, "tip_angle": [float(one.tip_angle) for one in shown]}
    table = Measurements.from_columns("simulated", **columns)
    noise = {"base_tension": 0.0, "displacement": 1e-5, "tip_angle": ANGLE}
    free = ["youngs_modulus", "outside_compliance"]
    start = replace(guess(), friction_coefficient=MU)
    found = cddf.fit(start, table, free, noise=noise)
    assert found.value["youngs_modulus"] == pytest.approx(MODULUS, rel=1e-6)
    assert found.value["outside_compliance"] == pytest.approx(COMPLIANCE, rel=1e-5)
    setting = cddf.BenchSetting(given={"outside_compliance": COMPLIANCE})
    known = cddf.fit(start, table, ["youngs_modulus"], noise=noise, setting=setting)
    np.testing.assert_allclose(known.manipulator.tendon_outside_compliance, COMPLIANCE)  # it is that of the body


@pytest.mark.slow
def test_how_rows_ended_is_the_same_with_and_without_derivatives():
    table = loop(1e-3)
    rows = bench_of(table, robot(), course=course_of(table)[0])
    known = {"slack_offset": 1.2e-3, "outside_compliance": COMPLIANCE}
    whole, bare = (each(robot(), known, 16) for each in (rows.evaluate, rows.solved))
    np.testing.assert_array_equal(bare.status, whole.status)
    np.testing.assert_array_equal(bare.direction_contradicted, whole.direction_contradicted)
    slack = LOOP - 0.2e-3 <= 0.0  # at both ends of the loop no part of the tendon pulls
    np.testing.assert_array_equal(np.asarray(bare.status) == cddf.Status.slack, slack)


# --- what is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"before": 5.0},
            "simulated: before is the base tension of an only tendon; begin each trial with a row of the",
        ),
        ({"free": ["lag"]}, "simulated: lag needs the column time; add it, or do not fit lag"),
        ({"noise": {"displacement": -1.0}}, "noise of displacement must be one standard deviation in m, 0 or more"),
    ],
)
def test_what_is_refused(options, message):
    table = Measurements.from_columns("simulated", displacement=LOOP, tip_angle=LOOP, step=np.arange(LOOP.size))
    assert message in refused(cddf.fit, guess(), table, **{"free": BOTH, **options})


def test_a_displacement_that_sets_a_tendon_is_needed_in_every_row():
    said = refused(Measurements.from_columns, "bench", displacement=[0.0, np.nan], tip_angle=[0.0, 0.1])
    assert said == "bench: row 2, column displacement: must be finite, got nan; give a number or remove the row"
    table = Measurements.from_columns("bench", base_tension=[1.0, 2.0], displacement=[1e-3, np.nan], tip_angle=[0, 0])
    assert table.has("displacement").tolist() == [True, False]
