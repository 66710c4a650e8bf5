"""Sum and difference of 1/T_tip on both branches: against the play operator 1/T_tip = 1/T_base +- g with a chosen g."""

import numpy as np
import pytest
from test_fit_of_loops import CELL, LOOP, loop, table
from test_model_free import MU, table_of

from cddf_jax.errors import InputError
from cddf_jax.identification.model_free import branches, model_free_friction, model_free_loop
from cddf_jax.measurements.table import Measurements

G = 0.42 / 1.4e6 * 2.942783188998e4  # (mu/E) int d/J of the paper's body, 1/N


def read(gain=1.0, zero=0.0, rng=None, **columns):
    tip = gain * loop()[0] + zero + (0.0 if rng is None else CELL * rng.normal(size=LOOP.size))
    return Measurements.from_columns("bench", base_tension=LOOP, tip_tension=tip, step=np.arange(33), **columns)


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_gain_and_loss_of_a_loop(gain):
    """17 rows of the pull; the front reaches the tip at 85 / (1 + 2 g 85) = 33.99 N: six rows below."""
    found = model_free_loop(read(gain))
    np.testing.assert_allclose([found.gain, found.loss], [gain, G], rtol=1e-9)
    assert [np.count_nonzero(found.branch == way) for way in (1, 0, -1)] == [17, 10, 6]
    assert any("The two cells do not agree" in line for line in found.verdict) == (gain != 1.0)


def test_intervals_of_the_gain():
    """300 loops with 0.1 N of noise: 95 % intervals hold it."""
    rng = np.random.default_rng(7)
    found = [model_free_loop(read(1.02, rng=rng)) for _ in range(300)]
    held = [low < 1.02 < high for low, high in (one.gain_interval for one in found)]
    assert 0.91 < np.mean(held) < 0.98
    spread = np.std([one.loss for one in found])
    assert (
        0.95 < np.mean([one.loss_standard_error for one in found]) / spread < 1.25
    )  # a jackknife errs on the wide side


def test_loops_within_the_loop_do_not_count():
    """75 -> 40 -> 60 -> 30 -> 10: 60 N is pulled again; 40 N is below the largest, but only partly slid out."""
    rows = Measurements.from_columns(
        "bench", base_tension=[20.0, 75, 40, 60, 30, 10], tip_tension=np.ones(6), step=range(6)
    )
    np.testing.assert_array_equal(branches(rows), [1, 1, -1, 0, -1, -1])


def test_friction_without_a_model_takes_the_pull():
    """Rows that come back are left out of the capstan law; mu is that which was put in."""
    found = model_free_friction(table())
    assert found.value == pytest.approx(MU, rel=1e-9)
    assert np.count_nonzero(np.isfinite(found.estimate)) == 17


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (table_of(np.ones(3), np.ones(3)), "0 rows in which all of the tendon slides out; 2 of each are needed"),
        (table(columns=["tip_angle"]), "no column 'tip_tension'; a loop needs base_tension and tip_tension"),
        (read(tip_force_y=np.ones(33)), "a loop without a model needs one tendon and no force on the body; use fit"),
    ],
)
def test_what_is_refused(rows, message):
    with pytest.raises(InputError, match=f"bench: .*{message}"):
        model_free_loop(rows)
