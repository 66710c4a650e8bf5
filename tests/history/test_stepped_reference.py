"""`trace` of tendons that stretch and of a push, against a simulation that shares nothing with the library.

`make_stepped_reference.py` beside this file is the simulation, and says how it is made and run.
"""

import equinox as eqx
import numpy as np
import pytest
from make_stepped_reference import CASES, Case, simulate

import cddf_jax as cddf

pytestmark = pytest.mark.slow
BODY = {
    "length": 0.140,
    "outer_radius": (0.020, 0.013),
    "inner_radius": 0.007,
    "tendon_offset": 0.010,
    "youngs_modulus": 1.4e6,
    "friction_coefficient": 0.42,
}
# of the tip after each step: angle (deg), y (mm), tensions (N)
STORED = {
    "antagonists": [[45.8581, 44.2926, 53.5883, 27.9912], [44.2819, 40.7652, 50.638, 24.147]],
    "push": [
        [69.3139, 60.2818, 45.1229],
        [67.6189, 57.3641, 45.1230],
        [65.0292, 52.8653, 46.8088],
        [66.1265, 54.7960, 46.8088],
    ],
}
# how much 200 cells, or half as many short steps, change the limits
ERRORS = {"antagonists": [0.004, 0.003, 0.02, 0.02], "push": [0.003, 0.003, 0.003]}
EA = 1e4  # N


def stretching(num_tendons):
    body = cddf.conical(**BODY, num_tendons=num_tendons)
    stiffness = [np.asarray(EA)] * num_tendons
    return eqx.tree_at(lambda b: [t.axial_stiffness for t in b.tendons], body, stiffness, is_leaf=lambda x: x is None)


@pytest.mark.parametrize("name", CASES)
def test_trace_meets_the_simulation(name):
    """Within the error of the simulation and the error estimate of `trace`."""
    case = CASES[name]
    tensions = np.array(case.tension)
    if name == "push":
        loads = [cddf.Loads(tip_force=force) for force in case.force]
        history = cddf.trace(stretching(1), tensions[:, 0], loads, short_steps=32)
    else:
        history = cddf.trace(stretching(2), tensions, short_steps=32)
    tip = np.asarray(history.tip_tension).reshape(len(tensions), -1)
    found = np.column_stack([np.degrees(history.tip_angle), 1e3 * history.tip_position[:, 1], tip])
    largest = np.max(tip, axis=1)
    scales = [np.full(len(tip), np.degrees(1)), np.full(len(tip), 1e3 * BODY["length"])] + [largest] * tip.shape[1]
    allowed = np.array(ERRORS[name]) + np.asarray(history.error_estimate)[:, None] * np.stack(scales, axis=1)
    assert np.all(np.abs(found - STORED[name]) < allowed), found - STORED[name]
    np.testing.assert_allclose(found, STORED[name], rtol=3e-3)  # however large the error estimate


@pytest.mark.parametrize("name", CASES)
def test_the_simulation_still_makes_these_numbers(name):
    """With so few cells and steps that it is quick: the difference is theirs."""
    rough = simulate(CASES[name], 50, 16) * ([np.degrees(1), 1e3] + [1] * len(CASES[name].sides))
    np.testing.assert_allclose(rough, STORED[name], rtol=5e-3)


def test_the_simulation_of_one_tendon_is_the_exact_play():
    """hysteresis.md, section 2: angles and tip tension, whatever EA; 75 N and back to 60 N."""
    one = Case((1,), ((75.0,), (60.0,)), ((0.0, 0.0),) * 2)
    rough, fine = (simulate(one, cells, 16) for cells in (50, 100))
    limit = fine + (fine - rough) / 3
    np.testing.assert_allclose(np.degrees(limit[:, 0]), [69.313929, 67.619267], atol=1e-3)
    np.testing.assert_allclose(limit[:, 2], 45.122927, atol=1e-3)
