"""The study of a real robot, fitting/real_robot_loops.py; the loops are those of data/opencr_v4 and data/opencr_v6."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cddf_jax.identification.curves import model_loops
from cddf_jax.measurements.loop_sense import runs_backwards

STUDY = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[1] / "fitting" / "real_robot_loops.py")))


def test_the_loops_are_tables_of_nine_tendons_and_of_four():
    assert [STUDY.pulled_by(table) for table in STUDY.read()][1:] == [f"displacement_{i}" for i in range(2, 10)]
    assert len(STUDY.read("v6")) == 4
    angles = [float(tendon.angle.value) for tendon in STUDY.robot(STUDY.read()).tendons]
    apart = np.diff(np.unwrap(np.reshape(angles, (3, 3)), axis=1), axis=1)
    np.testing.assert_allclose(apart, 2 * np.pi / 3, atol=0.5)  # the tendons of a segment lie 120 degrees apart


def test_loops_of_the_other_robot_run_backwards():
    assert all("run backwards" in runs_backwards(loop) for loop in STUDY.read("v6"))
    assert not any(map(runs_backwards, STUDY.read()))


@pytest.mark.slow
def test_a_friction_moment_explains_a_loop():
    """An independent study of the same data has 0.85e-3 / mm for the nine loops together, and 2.8 mm of misfit."""
    loops = STUDY.read()[3:4]
    body = STUDY.robot(STUDY.read())
    camera = [f"camera_{part}" for part in ("x", "y", "z", "turn_y", "turn_z")]
    free = ["friction_moment", "outside_compliance", "slack_offset_4", "tendon_angle_error_4", *camera]
    found = STUDY.cddf.fit(body, loops, free, noise=STUDY.EXACT, starts=1)
    assert found.success
    assert STUDY.misfit(found) < 1.5e-3
    assert 0.7e-3 < found.value["friction_moment"] / float(body.stiffness(0.0)) / 1e3 < 1.0e-3
    (curve,) = model_loops(found, found.groups[0])  # in increments it goes through the predictions of the rows
    np.testing.assert_allclose(curve.value, loops[0]["tip_x"] - found.residuals[found.groups[0].label], rtol=1e-9)
