"""Fits of tables with pull and release: against closed forms of one loop, and standard errors derived independently.

On the paper's body in the exact kinematics 1/T at the tip is a play of 1/T_base, clipped at 1/T_base -+ g with
g = (mu/E) int d/J; the tip angle has a closed form too.
"""

import dataclasses
from itertools import pairwise
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from bodies import paper_body
from kinds import bench_of
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from read_back import x_of, xy_of
from test_fit import COMPLIANCE, MU, E

import cddf_jax as cddf
from cddf_jax import figures
from cddf_jax.errors import InputError
from cddf_jax.identification.course import course_of, paths_of
from cddf_jax.identification.experiment_design import Candidate
from cddf_jax.identification.random_effects import errors_of_base
from cddf_jax.identification.tension_before import pasts_of
from cddf_jax.measurements.jitter import turns_of, without_jitter
from cddf_jax.measurements.table import Measurements
from cddf_jax.reports.fit_report import fit_as_dict, fit_as_markdown

UP = np.arange(5.0, 86.0, 5.0)
LOOP = np.concatenate([UP, UP[-2::-1]])
CELL, ANGLE = 0.1, np.radians(0.5)  # noise, N and rad
NOISE = {"tip_tension": CELL, "tip_angle": ANGLE}
ALL = ("friction_coefficient", "youngs_modulus", "tip_gain", "tip_zero")
BODY = paper_body("exact")


def loop(tension: ArrayLike = LOOP, mu=MU, modulus=E):
    """Tip tension and tip angle of a pull from rest and a release."""
    tension = np.asarray(tension, float)
    g, top = mu / modulus * COMPLIANCE, int(np.argmax(tension))
    largest, behind = tension[top], np.arange(tension.size) > top
    y, first = 1 / tension, 1 / largest
    inside = behind & (y < first + 2 * g)
    with np.errstate(invalid="ignore"):
        pull, stuck, out = y + g, np.full(y.size, first + g), y - g
        bent = np.log(1 + g * tension), np.log(y * (first + g) / ((y + first) / 2) ** 2), -np.log(1 - g * tension)
    choose = [inside, behind]
    return 1 / np.select(choose, [stuck, out], pull), np.select(choose, bent[1:], bent[0]) / mu


def table(tension=LOOP, columns=("tip_tension", "tip_angle"), rng=None, **more):
    """A table of a loop, noisy with a generator; steps are its rows."""
    read = dict(zip(NOISE, loop(tension), strict=True))
    if rng is not None:
        read = {name: values + NOISE[name] * rng.normal(size=values.size) for name, values in read.items()}
    own = {name: read[name] for name in columns}
    return Measurements.from_columns("bench", base_tension=tension, step=np.arange(len(tension)), **own, **more)


@pytest.fixture(scope="module")
def fitted():
    """A loop without noise, its rows out of order in the file."""
    rows = np.random.default_rng(1).permutation(LOOP.size)
    whole = table()
    shuffled = Measurements.from_columns("bench", **{name: values[rows] for name, values in whole.columns.items()})
    return cddf.fit(BODY, shuffled, ALL, noise=NOISE)


def test_a_loop_brings_the_truth_back(fitted):
    assert fitted.success
    np.testing.assert_allclose([fitted.value[name] for name in ALL[:3]], [MU, E, 1.0], rtol=1e-6)
    assert fitted.warnings == ()
    assert not fitted.model.experiments[0].on_one_curve


def test_standard_errors_of_a_loop(fitted):
    """As an independent derivation has them: 0.1 N, 0.5 degrees of noise; gain and zero of the tip cell free."""
    errors = [100 * fitted.standard_error[name] / fitted.value[name] for name in ALL[:3]]
    np.testing.assert_allclose(errors, [0.27, 0.17, 0.18], rtol=0.05)


@pytest.mark.parametrize(
    ("columns", "free", "combination", "pull", "whole"),
    [
        (["tip_tension", "tip_angle"], ALL, np.eye(4)[:3], [1.37, 0.40, 0.83], [0.27, 0.17, 0.18]),
        (["tip_angle"], ALL[:2], np.eye(2), [4.9, 1.2], [1.4, 0.30]),
        (["tip_tension"], ALL[:3], [[1, -1, 0]], [0.97], [0.24]),
    ],
)
def test_standard_errors_of_a_pull_and_of_a_loop(fitted, columns, free, combination, pull, whole):
    """Of the same derivation; from the derivatives of what is read, the covariance of the logarithms of parameters."""
    truth = dict(zip(ALL, [MU, E, 1.0, 0.0], strict=True))
    slopes = fitted.model.experiments[0].evaluate(BODY, truth, 16).derivatives
    order, places = np.argsort(fitted.tables[0]["step"]), [sorted(ALL).index(name) for name in free]
    size = [truth[name] or 1.0 for name in free]  # the zero of the cell in N
    scaled = [slopes[column][order][:, places] * size / NOISE[column] for column in columns]
    for rows, expected in ((17, pull), (33, whole)):
        read = np.concatenate([values[:rows] for values in scaled])
        covariance = np.linalg.pinv(read.T @ read, rcond=1e-9)
        errors = [100 * np.sqrt(np.array(way) @ covariance @ way) for way in np.asarray(combination, float)]
        np.testing.assert_allclose(errors, expected, rtol=0.05)


def test_predictions_along_a_loop(fitted):
    """By the closed forms; the intervals of all readings hold as much as there are parameters (trace of the hat)."""
    gone = 0.0
    for column, expected in zip(NOISE, loop(), strict=True):
        found = fitted.predict(column, LOOP, history=True)
        np.testing.assert_allclose(found.value, expected, rtol=1e-6)
        gone += np.sum((found.half_width / 1.959964 / NOISE[column]) ** 2)
        assert not np.any(found.extrapolated)
    assert gone == pytest.approx(len(ALL), rel=1e-5)


@pytest.mark.slow
def test_a_fit_of_a_loop_is_drawn_as_a_loop(fitted):
    """Lines by the closed form in the order of the path; readings by their branch, the residuals beside them."""
    axes = figures.draw_fit(fitted, column="tip_angle", axes=Figure().subplots())
    lines = {line.get_label(): line for line in axes.lines if str(line.get_label()).startswith("model")}
    for label, first, last in (("model, pulled", 5.0, 85.0), ("model, released", 85.0, 5.0)):
        x, y = xy_of(lines[label])
        assert (x[0], x[-1]) == (first, last)
        expected = loop(x)[1]
        np.testing.assert_allclose(y, np.degrees(expected), rtol=1e-6)
    markers = {line.get_label(): x_of(line) for line in axes.lines if line.get_linestyle() == "None"}
    assert {"data, pulled", "data, released"} <= set(markers)
    np.testing.assert_allclose(np.sort(markers["data, pulled"]), UP)
    np.testing.assert_allclose(np.sort(markers["data, released"]), UP[:-1])
    axes = figures.draw_residuals(fitted, column="tip_angle", axes=Figure().subplots())
    drawn = sum(len(x_of(line)) for line in axes.lines if line.get_marker() in ("o", "v"))
    assert drawn == LOOP.size


@pytest.mark.slow
def test_trials_pretension_drag_and_zeros():
    """Two trials of different length, each from rest, of a body with a drag; cells zeroed under a pretension."""
    body = paper_body("exact", drag=4.0)
    paths = [LOOP, np.array([20.0, 60.0, 40.0, 75.0, 30.0, 10.0, 50.0])]
    as_long = [np.pad(path, (0, LOOP.size - path.size), "edge") for path in paths]  # one program for both
    read = [(cddf.trace(body, path + 1.5), slice(own.size)) for path, own in zip(as_long, paths, strict=True)]
    tip = np.concatenate([history.tip_tension[rows] for history, rows in read]) - 1.5
    angle = np.concatenate([history.tip_angle[rows] for history, rows in read]) + 0.02
    columns = {"base_tension": np.concatenate(paths) + 0.3, "tip_tension": tip, "tip_angle": angle}
    columns |= {"trial": np.repeat(["a", "b"], [33, 7]), "step": np.concatenate([np.arange(33), np.arange(7)])}
    truth = {"friction_coefficient": MU, "youngs_modulus": E, "drag": 4.0, "pretension": 1.5}
    truth |= {"base_zero": 0.3, "angle_zero": 0.02}
    found = cddf.fit(body, Measurements.from_columns("bench", **columns), tuple(truth), noise=NOISE)
    for name, value in truth.items():
        assert abs(found.value[name] - value) < 0.01 * found.standard_error[name] + 1e-9, name


@pytest.mark.slow
def test_friction_that_differs_from_trial_to_trial():
    deviations = np.array([0.1, -0.05, 0.02, -0.07])
    own = [np.stack(loop(mu=MU * np.exp(deviation))) for deviation in deviations]
    tip, angle = np.concatenate(own, axis=1)
    rng = np.random.default_rng(2)
    columns = {"base_tension": np.tile(LOOP, 4), "trial": np.repeat(range(4), 33), "step": np.tile(np.arange(33), 4)}
    columns |= {"tip_tension": tip + CELL * rng.normal(size=132), "tip_angle": angle + ANGLE * rng.normal(size=132)}
    found = cddf.fit(BODY, Measurements.from_columns("bench", **columns), noise=NOISE, per_trial=True)
    effects = np.array([effect.value for effect in found.trial_effects.values()])
    np.testing.assert_allclose(effects - effects.mean(), deviations - deviations.mean(), atol=0.02)


# --- order, directions, bodies ---------------------------------------------------------------------


def test_the_order_of_the_file_where_it_is_asked_for():
    columns = {name: values for name, values in table().columns.items() if name != "step"}
    assert [rows.tolist() for rows in paths_of(Measurements.from_columns("bench", **columns), True) or ()] == [
        [*range(33)]
    ]
    assert paths_of(table(), False) is None


def test_a_direction_is_compared_with_the_order():
    way = np.where(np.arange(33) > 16, -1.0, 1.0)
    course_of(table(direction=way))
    way[20] = 1.0
    message = (
        r"bench: row 21, column direction: is 1, but base_tension falls there from 70 N to 65 N; correct the label or "
        r"the order of the rows, or give history=False \(--no-history\)"
    )
    with pytest.raises(InputError, match=message):
        course_of(table(direction=way))


def test_a_history_that_cannot_be_followed():
    gap = {"base_tension": [10.0, 60.0, 20.0], "tip_tension": [9.0, np.nan, 22.0]}
    with pytest.raises(
        InputError, match="1 rows without a reading are left out, but the path from row to row needs them"
    ):
        cddf.fit(BODY, Measurements.from_columns("bench", **gap), history=True)


def test_a_row_without_a_reading_is_still_a_step():
    """60 N were not read, but turned the tendon: the path of three steps stays, and one reading is missing."""
    columns = {"base_tension": [10.0, 60.0, 20.0], "tip_tension": [9.0, np.nan, 22.0], "step": [1, 2, 3]}
    gap = Measurements.from_columns("bench", **columns)
    np.testing.assert_array_equal(course_of(gap)[0].readings[0, :3, 0], [10.0, 60.0, 20.0])
    np.testing.assert_array_equal(bench_of(gap, BODY).read_in["tip_tension"], [0, 2])


# --- what was before the first row ---------------------------------------------------------------------

RELEASED = np.array([40.0, 30, 45, 60, 75, 85, 60, 40, 20, 10])


def released(before=57.0, tension=RELEASED):
    """A table whose tendon had a larger tension before its first row: what is left of a path that began there."""
    tip, angle = (np.asarray(x) for x in _play([before, *tension]))
    columns = {"base_tension": tension, "tip_tension": tip[1:], "tip_angle": angle[1:], "step": range(len(tension))}
    return Measurements.from_columns("bench", **columns)


def unread(**more):
    """The same rows; their readings do not matter."""
    columns = {"base_tension": RELEASED, "tip_angle": np.zeros(RELEASED.size), "step": range(RELEASED.size)}
    return Measurements.from_columns("bench", **columns, **more)


def _play(path):
    """Tip tension and tip angle of a path from rest: of `trace`, which is tested by itself."""
    history = cddf.trace(BODY, path)
    return history.tip_tension, history.tip_angle


def scaled_slopes(free):
    """Of tip tension and tip angle over their noise by the logarithms of parameters, as the bench has them."""
    table = released()
    truth = {"friction_coefficient": MU, "youngs_modulus": E, "before": 57.0}
    course = course_of(table, past=pasts_of([1], "rest", ["before"])[0])[0]
    slopes = bench_of(table, BODY, course=course).evaluate(BODY, truth, 16).derivatives
    places = [sorted(truth).index(name) for name in free]
    return [slopes[column][:, places] * [truth[name] for name in free] / NOISE[column] for column in NOISE]


@pytest.mark.slow
def test_slopes_by_what_was_before():
    """Central differences of traced paths, the second row of which is released from 57 N."""
    ends = [_play([before, *RELEASED]) for before in (57.0 * (1 - 1e-4), 57.0 * (1 + 1e-4))]
    expected = [np.asarray(high - low)[1:] / 2e-4 for low, high in zip(*ends, strict=True)]
    found = scaled_slopes(["before"])
    for slopes, column, differences in zip(found, NOISE, expected, strict=True):
        np.testing.assert_allclose(slopes[:, 0] * NOISE[column], differences, atol=1e-5 * np.max(np.abs(differences)))
    assert np.all(found[0][:3] > 0)  # up to 45 N; 60 N passes what was before
    assert not np.any(found[0][3:])


@pytest.mark.slow
def test_what_was_before_is_found():
    """Without noise the true values are found from any start of the friction; a stated tension counts as known."""
    free = ("friction_coefficient", "youngs_modulus", "before")
    start = eqx.tree_at(lambda body: body.friction_coefficient, BODY, 0.35)
    found = cddf.fit(start, released(), free, noise=NOISE)
    np.testing.assert_allclose([found.value[name] for name in free], [MU, E, 57.0], rtol=1e-6)
    assert found.status["before"] == "identified"
    covariance = np.linalg.inv(sum(rows.T @ rows for rows in scaled_slopes(free)))
    errors = np.sqrt(np.diag(covariance)) * [MU, E, 57.0]
    np.testing.assert_allclose([found.standard_error[name] for name in free], errors, rtol=1e-3)
    stated = cddf.fit(BODY, released(), noise=NOISE, before=57.0)
    assert stated.standard_error["friction_coefficient"] <= found.standard_error["friction_coefficient"]
    np.testing.assert_allclose(stated.value["friction_coefficient"], MU, rtol=1e-6)
    text = fit_as_markdown(stated, {})
    assert "With history: bench. Before the first row: 57 N." in text
    of_report = fit_as_markdown(found, {})
    assert "Before the first row: fitted (before)." in of_report
    assert fit_as_dict(found, {})["unit"]["before"] == "N"


@pytest.mark.slow
def test_where_nothing_is_left_of_what_was_before():
    """Released to 5 N, all of the tendon has slid out: 1/5 > 1/60 + 2 g. From rest it ends on the first row."""
    free = ("friction_coefficient", "youngs_modulus", "before")
    low = np.array([5.0, *RELEASED[1:]])
    found = cddf.fit(BODY, released(tension=low), free, noise=NOISE)
    assert 1 / 60 + 2 * MU / E * COMPLIANCE < 1 / 5
    assert found.status["before"] == "not identified"
    assert "has an effect only if the release to that row has not reached the tip" in found.verdict[-1]
    from_rest = cddf.fit(BODY, released(before=40.0), free, noise=NOISE)
    assert from_rest.status["before"] == "at bound"
    assert "before = 40 N: at bound, at most 40.2" in str(from_rest)


@pytest.mark.slow
def test_trials_begin_in_their_own_ways():
    """The first at rest, the second released from 60 N: stated one by one, or the second alone to be found."""
    tip, angle = (np.concatenate([x, y[1:]]) for x, y in zip(_play(RELEASED), _play([60.0, *RELEASED]), strict=True))
    columns = {"base_tension": np.tile(RELEASED, 2), "trial": np.repeat(["a", "b"], 10), "step": np.tile(range(10), 2)}
    both = Measurements.from_columns("bench", **columns, tip_tension=tip, tip_angle=angle)
    course = course_of(both, past=pasts_of([2], "rest", ["before_2"])[0])[0]
    np.testing.assert_array_equal(course.path({"before_2": 50.0})[:, 0, 0], [0.0, 50.0])  # 0 N is rest
    assert course_of(both, past=pasts_of([2], ["rest", 60.0], [])[0])[0].past_in_words == ["rest", "60 N"]
    bench = bench_of(both, BODY, course=course)
    truth = {"friction_coefficient": MU, "youngs_modulus": E, "before_2": 60.0}
    read = bench.predict(BODY, {name: np.asarray(value) for name, value in truth.items()}, 16)
    np.testing.assert_allclose(read["tip_tension"], tip, rtol=1e-9)
    np.testing.assert_allclose(read["tip_angle"], angle, rtol=1e-9)


def test_a_first_row_may_be_a_release():
    down = unread(direction=[-1, -1, 1, 1, 1, 1, -1, -1, -1, -1])
    for past in (*pasts_of([1], 60.0, ()), *pasts_of([1], "rest", ["before"])):
        course_of(down, past=past)
    with pytest.raises(InputError, match="column direction: is -1, but base_tension rises there from 0 N to 40 N"):
        course_of(down)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"before": 30.0},
            "fit: bench: row 1: before must be the largest base tension up to this row, 40 N or more, g",
        ),
        (
            {"before": "up"},
            "fit: before must be \"rest\" or the largest base tension before the first row, N, got 'up'",
        ),
        ({"before": [60.0, 60.0]}, "fit: before must hold one entry for each of the 1 trials, got 2"),
        ({"free": ["before_3"]}, "fit: before_3 belongs to trial 3, but only 1 have a history"),
        ({"free": ["before"], "history": False}, "fit: before is used with a history only; leave it out, or give hist"),
    ],
)
def test_an_invalid_past_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        cddf.fit(BODY, unread(), **given)


# --- several tendons, and forces on the tip -------------------------------------------------------------

PAIR = paper_body("exact", num_tendons=2)
PULLS = np.concatenate([np.linspace(10, 70, 10), np.linspace(64, 4, 10)])


def pair_table(**more):
    """A path of a tendon against another; the readings do not matter."""
    columns = {"base_tension": PULLS, "base_tension_2": np.full(20, 20.0), "tip_angle": np.zeros(20)}
    return Measurements.from_columns("pair", step=range(20), **columns | more)


def test_the_course_of_several_tendons():
    """Jitter of either cell is no step; forces that change begin with none, those that stay rest on the body first."""
    rng = np.random.default_rng(6)
    second = np.repeat(20.0, 20) + 0.02 * rng.normal(size=20)
    course, found = course_of(pair_table(base_tension_2=second))
    steady = found["base_tension_2"]
    assert course.short_steps == 4
    assert course.forces is None
    assert course.readings.shape == (1, 20, 2)
    np.testing.assert_allclose(course.readings[0, :, 0], PULLS)
    np.testing.assert_allclose(course.readings[0, :, 1], np.mean(second))
    assert steady.noise == pytest.approx(np.std(second, ddof=1), rel=0.1)
    force = np.where(np.arange(20) < 10, -0.2, -0.5)
    course = course_of(pair_table(tip_force_y=force))[0]
    np.testing.assert_allclose(np.asarray(course.forces)[0, :, 0, 1], force)
    assert course.stays == (False,)
    both = course_of(pair_table(**{"tip_force_y": force, "force_y@60mm": np.full(20, -0.2)}))[0]
    assert both.stays == (False, True)
    with pytest.raises(InputError, match="pair: before is the base tension of an only tendon; begin each trial with a"):
        course_of(pair_table(), past=pasts_of([1], 60.0, ())[0])
    with pytest.raises(InputError, match="fit: short_steps must be a whole number of 2 or more, got 1"):
        cddf.fit(PAIR, pair_table(), short_steps=1)


@pytest.mark.slow
def test_a_loop_of_two_tendons_brings_the_truth_back():
    """Seed stated before; simulated with 16 increments and twice the elements, fitted with 4 from another start."""
    rng, noise = np.random.default_rng(20261123), {"tip_tension": 0.1, "tip_tension_2": 0.1, "tip_angle": ANGLE}
    history = cddf.trace(PAIR, np.stack([PULLS, np.full(20, 20.0)], axis=1), short_steps=16)
    read = {"tip_tension": history.tip_tension[:, 0], "tip_tension_2": history.tip_tension[:, 1]}
    read = {name: values + 0.1 * rng.normal(size=20) for name, values in read.items()}
    read["tip_angle"] = history.tip_angle + ANGLE * rng.normal(size=20)
    start = eqx.tree_at(lambda b: (b.friction_coefficient, b.youngs_modulus), PAIR, (0.35, 1.2e6))
    found = cddf.fit(start, pair_table(**read), noise=noise)
    assert found.success
    for name, truth in (("friction_coefficient", MU), ("youngs_modulus", E)):
        low, high = found.confidence_interval[name]
        assert low < truth < high
        assert found.standard_error[name] < 0.01 * truth
        assert found.moved_by_steps[name] < 0.5
    assert not any("increments" in warning for warning in found.warnings)
    assert "The increments of the history move the estimates by at most 0." in fit_as_markdown(found, {})
    path = np.stack([PULLS, np.full(20, 20.0)], axis=1)
    along = found.predict("tip_angle", path, history=True)
    np.testing.assert_allclose(along.value, read["tip_angle"] - found.residuals["pair: tip_angle"], rtol=1e-9)


HEAVY = cddf.Loads(tip_force=(0.0, -0.3), gravity=(0.0, -9.81))
AS_FITTED: dict[str, Any] = {"nodes": 8, "short_steps": 4}  # of `trace`: the cells and steps of a fit with 12 nodes


def heavy():
    """The body with the weight of silicone rubber."""
    return dataclasses.replace(paper_body("exact"), density=1070.0)


@pytest.mark.slow
def test_a_row_without_readings_says_what_two_tendons_had_before():
    """As a `trace` with the same increments that begins there."""
    path = np.stack([[45.0, 75, 15], np.full(3, 20.0)], axis=1)
    history = cddf.trace(PAIR, path, before=[62.0, 20.0], **AS_FITTED, throw=False)
    columns = {"base_tension": [62.0, *path[:, 0]], "base_tension_2": np.full(4, 20.0), "step": range(4)}
    read = {name: [np.nan, 0.0, 0.0, 0.0] for name in ("tip_tension", "tip_angle")}
    table = Measurements.from_columns("pair", **columns, **read)
    shown = bench_of(table, PAIR, course=course_of(table)[0]).predict(PAIR, {}, 12)
    np.testing.assert_allclose(shown["tip_tension"], history.tip_tension[:, 0], rtol=1e-9)
    np.testing.assert_allclose(shown["tip_angle"], history.tip_angle, atol=1e-9)


@pytest.mark.slow
def test_a_tip_force_that_changes_under_gravity():
    """As a `trace` under gravity alone, and another that goes on from there with the forces."""
    path, before = np.array([50.0, 65.0, 30.0, 10.0]), 60.0
    force = np.array([[0.1, -0.2], [0.0, -0.4], [0.0, -0.4], [0.0, 0.0]])
    gravity = cddf.Loads(gravity=HEAVY.gravity)
    first = cddf.trace(heavy(), [before], gravity, **AS_FITTED)
    loads = [dataclasses.replace(gravity, tip_force=pair) for pair in force]
    history = cddf.trace(heavy(), path, loads, start=first, **AS_FITTED)
    columns = {"base_tension": path, "tip_force_x": force[:, 0], "tip_force_y": force[:, 1], "step": range(4)}
    read = {"tip_tension": np.zeros(4), "tip_angle": np.zeros(4), "tip_y": np.zeros(4)}
    table = Measurements.from_columns("bench", **columns, **read)
    course = course_of(table, past=pasts_of([1], before, ())[0], stepped=True)[0]
    rows = bench_of(table, heavy(), course=course, setting=cddf.BenchSetting(loads=gravity))
    shown = rows.predict(heavy(), {}, 12)
    np.testing.assert_allclose(shown["tip_tension"], history.tip_tension, rtol=1e-9)
    np.testing.assert_allclose(shown["tip_angle"], history.tip_angle, atol=1e-9)
    np.testing.assert_allclose(shown["tip_y"], history.tip_position[:, 1], atol=1e-11)


def test_loads_of_all_rows_leave_no_exact_answer():
    """Nor one curve on which all rows lie."""
    course, _ = course_of(table(UP), stepped=True)
    assert course.short_steps == 4
    setting = cddf.BenchSetting(loads=HEAVY)
    rows = bench_of(table(UP), heavy(), course=course, setting=setting)
    assert not rows.on_one_curve
    pull = {"base_tension": PULLS[:10], "base_tension_2": np.full(10, 20.0), "tip_angle": np.zeros(10)}
    pair = Measurements.from_columns("pair", step=range(10), **pull)
    assert not bench_of(pair, PAIR, course=course_of(pair)[0]).on_one_curve
    assert bench_of(table(UP), BODY, course=course_of(table(UP))[0]).on_one_curve
    with pytest.raises(InputError, match=r"bench: loads\.gravity: the body has no weight"):
        cddf.fit(BODY, table(UP), setting=setting)


# --- jitter of the base cell -----------------------------------------------------------------------


def held(rng, deviation, samples=50):
    return np.repeat(LOOP, samples) + deviation * rng.normal(size=samples * LOOP.size)


@pytest.mark.parametrize("deviation", [0.05, 0.5])
def test_samples_of_a_hold_are_no_turns(deviation):
    """50 samples of each level: the noise is found, the level is their mean, and one turn is left."""
    found = without_jitter(held(np.random.default_rng(3), deviation))
    assert found.noise == pytest.approx(deviation, rel=0.1)
    np.testing.assert_array_equal(np.unique(turns_of(found.tension)), np.unique(turns_of(found.tension))[:1])
    np.testing.assert_allclose(found.tension[::50], LOOP, atol=4 * deviation / np.sqrt(50))
    assert found.num_ignored > 400


def test_jitter_biases_a_play_and_means_of_holds_do_not():
    """The largest of 50 readings lies 2.25 standard deviations above their mean, and the tip keeps it."""
    rng, deviation, raw, steady = np.random.default_rng(4), 0.3, [], []
    g = MU / E * COMPLIANCE
    for _ in range(200):
        readings = held(rng, deviation)[: 50 * 18]  # up, and one level back: the tip rests
        for path, found in ((readings, raw), (without_jitter(readings).tension, steady)):
            found.append(1 / (1 / np.max(path) + g))
    bias = [(np.mean(tips) - loop()[0][16]) / (deviation / (1 + 85 * g) ** 2) for tips in (raw, steady)]
    assert bias[0] == pytest.approx(2.25, abs=0.15)  # expected largest of 50 normal draws
    assert abs(bias[1]) < 0.1


def test_a_ramp_with_jitter_has_one_turn():
    rng = np.random.default_rng(5)
    ramp = np.concatenate([np.linspace(0, 80, 800), np.linspace(80, 10, 700)]) + 0.2 * rng.normal(size=1500)
    found = without_jitter(ramp)
    assert turns_of(found.tension).size == 1
    clean = np.concatenate([np.linspace(0, 80, 800), np.linspace(80, 10, 700)])
    assert np.max(np.abs(found.tension - clean)) < 0.8
    assert np.abs(np.mean(found.tension - clean)) < 0.02


STAIRS = np.concatenate([np.arange(1.0, 12.1), np.arange(11.5, 0.0, -1.0)])  # N


@pytest.mark.parametrize("path", [LOOP, [80, 20, 60, 30, 50, 38, 45], [10], STAIRS])
def test_real_turns_stay(path):
    """Loops within loops, a zigzag that shrinks, and a staircase with steps smaller than the noise that is stated."""
    path = np.asarray(path, float)
    for noise in (None, 0.0, 0.05, 0.3, *([1.0] if path is STAIRS else [])):
        found = without_jitter(path, noise)
        np.testing.assert_allclose(found.tension, path)
        assert found.num_ignored == 0


def test_a_small_turn_counts_where_it_is_stated():
    """Half a newton back at 85 N is taken for jitter unless the noise is given."""
    path = np.array([20.0, 40, 60, 85, 84.5, 85.5, 60, 40, 20])
    assert without_jitter(path).num_ignored == 2
    assert without_jitter(path, 0.05).num_ignored == 0
    assert all(b >= a for a, b in pairwise(without_jitter(path).tension[:6]))
    np.testing.assert_array_equal(without_jitter(path, 0.0).tension, path)


# --- noise of the base cell -------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [None, 0.1])
def test_the_peak_of_held_samples_stays(noise):
    """20 samples at 12 and 20 at 11.5 N: their means, within four standard errors of 0.1 N / sqrt(20)."""
    readings = np.repeat(STAIRS, 20) + 0.1 * np.random.default_rng(6).normal(size=480)
    found = without_jitter(readings, noise).tension
    assert turns_of(found).size == 1
    np.testing.assert_allclose([np.max(found), found[250]], [12.0, 11.5], atol=0.09)


def test_derivatives_by_base_tensions_follow_the_memory(fitted):
    """Every reading by every base tension, against differences of the closed form; the tip remembers the peak."""
    errors = errors_of_base(fitted.model, fitted.tables, {})
    slopes = errors.slopes(fitted.parameters)["bench: base_tension"]
    step, away = fitted.tables[0]["step"].astype(int), 1e-3
    moved = [np.stack([loop(LOOP + sign * away * unit) for sign in (-1, 1)]) for unit in np.eye(LOOP.size)]
    expected = np.stack([(up - down) / (2 * away) for down, up in moved])  # (levels, columns, steps)
    for column, name in enumerate(NOISE):
        np.testing.assert_allclose(slopes[f"bench: {name}"], expected[:, column, step].T, atol=1e-6)
    assert np.count_nonzero(np.abs(slopes["bench: tip_tension"][:, 16]) > 1e-6) > 5


def test_noise_of_the_base_cell_widens_the_intervals():
    """By generalised least squares with the closed form: 0.5 N of noise of the base cell; gain and zero are free."""
    deviation = np.repeat([CELL, ANGLE], LOOP.size)
    by_tip = np.stack([np.append(tip, np.zeros(LOOP.size)) for tip in (loop()[0], np.ones(LOOP.size))], axis=1)
    size, away = np.array([MU, E]), 1e-4
    ends = [[np.concatenate(loop(LOOP, *(size * (1 + s * away * u)))) for s in (-1, 1)] for u in np.eye(2)]
    slope = np.column_stack([*((up - down) / (2 * away) for down, up in ends), by_tip])
    moved = [[np.concatenate(loop(LOOP + s * 1e-3 * u)) for s in (-1, 1)] for u in np.eye(LOOP.size)]
    effect = np.stack([(up - down) / 2e-3 for down, up in moved], axis=1)
    covariance = np.diag(deviation**2) + 0.25 * effect @ effect.T
    expected = np.sqrt(np.diag(np.linalg.inv(slope.T @ np.linalg.solve(covariance, slope))))
    found = cddf.fit(BODY, table(), ALL, noise=NOISE | {"base_tension": 0.5})
    errors = [found.standard_error[name] / size for name, size in zip(ALL, [MU, E, 1.0, 1.0], strict=True)]
    np.testing.assert_allclose(errors, expected, rtol=0.01)


# --- report and plan -------------------------------------------------------------------------------


def test_coming_back_down_is_a_candidate(fitted):
    """The loop once more: standard errors fall by the square root of 2."""
    again = Candidate("loop", {"base_tension": LOOP, "step": range(33)}, NOISE)
    expected = cddf.plan(fitted, [again], num=1).ranking[0].expected
    for name in ALL:
        assert expected.standard_error[name] == pytest.approx(fitted.standard_error[name] / np.sqrt(2), rel=1e-6)
    winding = dataclasses.replace(BODY, tendons=(cddf.Tendon(0.010, angle=cddf.Linear(0.0, 1.0, 0.140)),))
    for body, follows in ((BODY, True), (winding, True), (PAIR, False)):  # a pair is pulled in turn
        names = [candidate.name for candidate in cddf.standard_candidates(body, 85.0)]
        assert ("tip tensions and angles, pulled and come back down" in names) == follows


# --- creep and jitter -----------------------------------------------------------------------------


def changed(columns):
    """The loop of the fixture with other readings, so that programs are shared; noise from a seed."""
    rng = np.random.default_rng(11)
    noisy = table(rng=rng).columns
    return cddf.fit(BODY, Measurements.from_columns("bench", **{**noisy, **columns(noisy)}), ALL, noise=NOISE)


def test_standard_errors_of_readings_whose_neighbours_are_alike():
    """The scatter of many fits, of noise r_k = 0.7 r_(k-1) + white; each fit by its linearisation."""
    rng, slow = np.random.default_rng(8), np.zeros((1000, 2, LOOP.size))
    for k in range(LOOP.size):
        white = rng.normal(size=slow.shape[:2])
        slow[..., k] = 0.7 * slow[..., k - 1] + np.sqrt(1 - 0.7**2) * white if k else white
    read = zip(NOISE, loop(), slow[0], strict=True)
    columns = {name: value + NOISE[name] * own for name, value, own in read}
    table = Measurements.from_columns("bench", base_tension=LOOP, step=np.arange(LOOP.size), **columns)
    fit = cddf.fit(BODY, table, ALL[:2], noise=NOISE)
    assert fit.neighbours == pytest.approx(0.7, abs=0.15)
    assert "times those of independent readings" in fit.warnings[0]
    rows = {label: slow[:, list(NOISE).index(label.split(": ")[-1])] for label in fit.evidence.rows}
    scatter = np.std(np.concatenate([*rows.values()], axis=1) @ np.linalg.pinv(fit.evidence.jacobian).T, axis=0)
    assert [fit.standard_error[name] for name in ALL[:2]] == pytest.approx(scatter * fit.evidence.size, rel=0.25)


def test_creep_drifts():
    """The tip angle creeps by 5 % until the last row; without creep nothing is said."""
    found = changed(lambda read: {"tip_angle": read["tip_angle"] * (1 + 0.05 * np.arange(33) / 32)})
    assert any("bench: tip_angle: residuals drift from the first row to the last" in text for text in found.remarks)
    assert not changed(lambda read: {}).remarks
