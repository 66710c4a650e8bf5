"""`trace` of tendons that stretch and of a push, against a simulation that shares nothing with the library.

`benchmarks/stepped_reference.py` is the simulation, and says how it is made and run.
"""

import runpy

import numpy as np
import pytest
from bodies import PAPER, paper_body, stretching
from places import ROOT

import cddf_jax as cddf

SIMULATION = runpy.run_path(str(ROOT / "benchmarks" / "stepped_reference.py"))
CASES, Case, simulate = (SIMULATION[name] for name in ("CASES", "Case", "simulate"))

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
# how much 200 cells, and half as many short steps, change the limits together
ERRORS = {"antagonists": [0.004, 0.003, 0.02, 0.02], "push": [0.004, 0.003, 0.003]}
EA = 1e4  # N


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_trace_meets_the_simulation(name):
    """Within the error of the simulation and the error estimate of `trace`."""
    case = CASES[name]
    tensions = np.array(case.tension)
    body = stretching(paper_body("exact", num_tendons=len(case.sides)), EA)
    loads = [cddf.Loads(tip_force=force) for force in case.force] if name == "push" else None
    history = cddf.trace(body, tensions, loads, short_steps=32)
    tip = np.asarray(history.tip_tension).reshape(len(tensions), -1)
    found = np.column_stack([np.degrees(history.tip_angle), 1e3 * history.tip_position[:, 1], tip])
    largest = np.max(tip, axis=1)
    scales = [np.full(len(tip), np.degrees(1)), np.full(len(tip), 1e3 * PAPER["length"])] + [largest] * tip.shape[1]
    allowed = np.array(ERRORS[name]) + np.asarray(history.error_estimate)[:, None] * np.stack(scales, axis=1)
    assert np.all(np.abs(found - STORED[name]) < allowed), found - STORED[name]
    np.testing.assert_allclose(found, STORED[name], rtol=3e-3)  # however large the error estimate


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_simulation_still_makes_these_numbers(name):
    """With so few cells and steps that it is quick: the difference is theirs."""
    rough = simulate(CASES[name], 50, 16) * ([np.degrees(1), 1e3] + [1] * len(CASES[name].sides))
    np.testing.assert_allclose(rough, STORED[name], rtol=5e-3)


@pytest.mark.slow
def test_the_simulation_of_one_tendon_converges_to_the_exact_trace():
    """It knows no fronts, and its errors fall with the square of the cells; loops within loops, one below the other."""
    path = [60.0, 75.0, 60.0, 40.0, 65.0, 50.0, 20.0, 70.0]
    exact = cddf.trace(paper_body("exact"), path)
    expected = np.column_stack([exact.tip_angle, exact.tip_position[:, 1], exact.tip_tension])
    case = Case((1,), tuple((tension,) for tension in path), ((0.0, 0.0),) * len(path))
    rough, middle, fine = (simulate(case, cells, 1) for cells in (25, 50, 100))  # short steps would change nothing
    scale = np.max(expected, axis=0)
    errors = [np.max(np.abs(found - expected) / scale) for found in (rough, middle, fine)]
    assert errors[0] < 1e-3
    np.testing.assert_allclose(np.divide(errors[:2], errors[1:]), 4.0, rtol=0.15)
    limit = fine + (fine - middle) / 3
    np.testing.assert_allclose(limit / scale, expected / scale, atol=1e-5)  # fronts end within a cell
    np.testing.assert_allclose(np.degrees(limit[[1, 2], 0]), [69.313929, 67.619267], atol=5e-4)  # section 2
