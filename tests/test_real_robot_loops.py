"""The study of a real robot, fitting/real_robot_loops.py; the loops are those of data/opencr_v4."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

STUDY = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[1] / "fitting" / "real_robot_loops.py")))


def test_the_loops_are_planar_tables_of_nine_tendons():
    loops = STUDY.read()
    assert len(loops) == 9
    for loop in loops:
        pulled, across = loop.table["displacement"], loop.table["tip_y"]
        assert across[np.argmax(pulled)] - across[np.argmin(pulled)] > 0.04  # m: a pull bends it towards +y
        assert np.ptp(loop.aside) < np.ptp(loop.table["tip_y"]) / 4


@pytest.mark.slow
def test_one_loop_is_fitted_by_each_model():
    """A model with one more parameter fits no worse; the product of modulus and compliance is that of its order."""
    loop = STUDY.read()[3]
    found = STUDY.fits(3, loop)
    assert all(fit.success for fit in found.values())
    plain = STUDY.misfit(found["no friction"])
    assert plain < 3e-3  # m, of a path of 70 mm
    assert STUDY.misfit(found["lag"]) < 1.01 * plain
    assert "friction_coefficient" not in found["no friction"].names
