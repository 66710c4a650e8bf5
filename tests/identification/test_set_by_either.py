"""Tables in which a tendon is set by its base tension in some rows, and by its displacement in the others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from test_displacement import ALL, ANGLE, LOOP, robot

import cddf_jax as cddf
from cddf_jax.history.path import given_path
from cddf_jax.history.stepped import Following, stepped_history
from cddf_jax.measurements.holds import holds_of
from cddf_jax.measurements.left_out import without

BY_TENSION = np.isin(np.arange(LOOP.size), [2, 3, 4, 8, 9, 13, 16])
OFFSET, CELL = 1e-3, 0.02  # m; noise, N


def table(**more):
    """A loop by its exact answer; the load cell reads in some rows, and the encoder in the others and two of these."""
    history = cddf.trace(robot(), [cddf.Displacement(LOOP)])
    both = np.isin(np.arange(LOOP.size), [3, 16])
    columns = {
        "step": np.arange(LOOP.size),
        "base_tension": np.where(BY_TENSION, history.base_tension, np.nan),
        "displacement": np.where(BY_TENSION & ~both, np.nan, LOOP + OFFSET),
        "tip_angle": history.tip_angle,
    }
    return cddf.Measurements.from_columns("simulated", **columns | more)


@pytest.fixture(scope="module")
def found():
    noise = {"base_tension": CELL, "displacement": 1e-5, "tip_angle": ANGLE}
    return cddf.fit(robot(1e6, 0.2, 1e-5), table(), ALL, noise=noise, nodes=24, short_steps=8)


@pytest.mark.slow
def test_some_base_tensions_bring_the_modulus(found):
    """Displacements and angles alone hold the product of modulus and compliance; tensions tell one from the other."""
    assert found.success
    assert set(found.status.values()) == {"identified"}
    truth = {"friction_coefficient": 0.3, "youngs_modulus": 1.4e6, "outside_compliance": 2e-5, "slack_offset": 1e-3}
    for name, value in truth.items():  # the numbers that the data were made with, by the exact answer
        assert abs(found.value[name] - value) < 0.1 * found.standard_error[name]
    assert len(found.residuals["simulated: displacement"]) == 2  # of the rows in which the tension is known as well
    assert {*found.input_noise} == {"simulated: base_tension", "simulated: displacement"}


@pytest.mark.slow
def test_predictions_know_both_ranges(found):
    by_length = found.predict("tip_angle", {"displacement": [0.005, 0.012, 0.02]}, history=True)
    assert by_length.extrapolated.tolist() == [False, False, True]  # the encoder read up to 13 mm
    largest = np.nanmax(table()["base_tension"])
    assert found.predict("tip_angle", [largest, 1.1 * largest]).extrapolated.tolist() == [False, True]


def test_a_path_by_either_is_the_path_by_displacement():
    """Between two turns a single tendon passes through the same states, whatever sets it; also under a load."""
    path, driven = given_path(robot(), [cddf.Displacement(LOOP)], cddf.Loads((0.0, -0.3)))
    kind = Following(driven, 24, 8, estimated=False)
    by_length = stepped_history(robot(), path, None, kind)
    flags = jnp.asarray(BY_TENSION[:, None])
    numbers = np.where(flags, by_length.base_tension, path.given)
    mixed = stepped_history(robot(), path._replace(given=numbers).partly_by_tension(flags), None, kind)
    assert not np.any(mixed.status)
    for name in ("base_tension", "tip_tension", "tip_angle", "tip_position", "tendon_displacement"):
        np.testing.assert_allclose(getattr(mixed, name), getattr(by_length, name), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_derivatives():
    """Forwards, backwards, and by differences of a pair of which each tendon is set by either."""
    pair = robot(tendons=2)
    lengths = 1e-3 * np.array([[1.9, 2.0], [5.0, 2.1], [8.0, 1.9], [9.0, 1.0]])
    path, driven = given_path(pair, [cddf.Displacement(own) for own in lengths.T], None)
    kind = Following(driven, 24, 8, estimated=False)
    flags = jnp.array([[False, False], [True, False], [False, True], [True, False]])
    numbers = np.where(flags, stepped_history(pair, path, None, kind).base_tension, lengths)

    def angles(numbers):
        mixed = path._replace(given=numbers).partly_by_tension(flags)
        return stepped_history(pair, mixed, None, kind).tip_angle

    slopes = jax.jacfwd(angles)(numbers)
    np.testing.assert_allclose(jax.jacrev(angles)(numbers), slopes, rtol=1e-6, atol=1e-8)
    change = np.random.default_rng(1).normal(size=numbers.shape) * np.where(flags, 1.0, 1e-3)
    apart = (angles(numbers + 1e-5 * change) - angles(numbers - 1e-5 * change)) / 2e-5
    np.testing.assert_allclose(apart, np.tensordot(slopes, change, 2), rtol=1e-4, atol=1e-7)


def test_empty_cells_of_a_file(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("T_base [N], displacement [mm], tip_angle [deg]\n1, , 2\n, 3, 4\n2, 2, 3\n", encoding="utf-8")
    read = cddf.read_measurements(path)
    assert read.has("displacement").tolist() == [False, False, True]  # in row 3 of the file it sets the tendon
    assert read.has("base_tension").tolist() == [True, False, True]
    np.testing.assert_allclose(read.actuation[:, 0], [1.0, 3e-3, 2.0])
    assert holds_of(read).tolist() == [0, 1, 2]
    (whole,) = (own for own in read.set_columns if own.by_length)
    assert whole.rows.tolist() == [False, True, False]


def test_an_empty_column_of_base_tensions_is_left_out():
    empty = np.full(2, np.nan)
    read = cddf.Measurements.from_columns("bench", base_tension=empty, displacement=[1e-3, 2e-3], tip_angle=[0.1, 0.2])
    assert "base_tension" not in read
    assert read.read_as == ("bench: base_tension holds no number and is not used",)


def test_what_is_refused():
    said = refused(table, displacement=np.where(BY_TENSION | (LOOP == 0), np.nan, LOOP))
    assert said == "simulated: row 1, column base_tension: must be finite, got nan; give a number or remove the row"
    said = refused(cddf.fit, robot(), table(), ["friction_coefficient", "backlash"])
    assert said == (
        "fit: simulated: row 3, column displacement: a base tension sets the tendon there, and backlash takes "
        "displacements in all rows; clear the base tensions of this tendon, or leave backlash out"
    )
    tensions = table(tip_tension=np.ones(LOOP.size))
    assert "row 1 has no base tension" in refused(cddf.model_free_friction, tensions)


def test_what_sets_a_tendon_is_no_reading_that_may_be_left_out():
    (left,), _ = without([table()], [1, 2, 4])
    assert left.actuation.tolist() == table().actuation.tolist()
    assert np.flatnonzero(left.has("displacement")).tolist() == [16]
    assert np.flatnonzero(~left.has("tip_angle")).tolist() == [0, 1, 3]
