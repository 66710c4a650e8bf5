"""The study of the measured body, fitting/soft_tentacle.py: what one modulus predicts, and what the data do not tell.

Moduli and errors are those that the issue's independent check found (8.9 mm published, 9.7 mm exact, 0.29 to 0.34 MPa).
"""

import runpy
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PlainBody, straight
from loaded_bodies import PlainLoads, loaded_reference
from places import ROOT

import cddf_jax as cddf

STUDY = SimpleNamespace(**runpy.run_path(str(ROOT / "fitting" / "soft_tentacle.py")))
MODULUS = {"published": 302e3, "exact": 336e3}  # Pa, that of the least sum of squares, as `test_one_modulus` shows
ERROR = {"published": 8.9e-3, "exact": 9.8e-3}  # m

if not STUDY.TABLE.exists():
    pytest.skip(f"the measured data are not here: {STUDY.TABLE}", allow_module_level=True)


@pytest.fixture(scope="module")
def poses():
    return STUDY.read_poses()


def test_frames(poses):
    """Of the poses nearest to straight, 1.5 N: X runs down the body, markers lie where their offsets put them."""
    assert poses.in_plane.shape == (14, 4, 2)
    straight = np.isclose(poses.tension, 1.53846)
    assert np.count_nonzero(straight) == 2
    # no marker is farther from its place on the straight body than the body bends there, which is a few cm at the tip
    place = np.stack([STUDY.MARKER + STUDY.AHEAD, 0.5 * STUDY.ASIDE], axis=-1)
    off = poses.in_plane[straight] - place
    assert np.max(np.abs(off[..., 0])) < 0.011
    assert np.all(off[:, 1:, 1] > 0)
    assert np.all(np.diff(off[..., 1], axis=1) > 0)  # it bends towards the tendon that is pulled
    # README: planar to about 11 mm at the tip below 7 N
    assert np.max(np.abs(poses.out_of_plane[poses.tension < 7.0, 3])) < 0.011


@pytest.mark.slow
@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_one_modulus(poses, kinematics):
    """One modulus predicts 112 coordinates within 10 mm, and 3 % less or more predict them less well."""
    residuals = STUDY.by_modulus(poses, kinematics, MODULUS[kinematics] * np.array([0.97, 1.0, 1.03]))
    assert residuals[1].size == 112
    below, here, above = STUDY.rms(residuals, (1, 2, 3))
    assert here < below
    assert here < above
    assert here < 0.010
    np.testing.assert_allclose(here, ERROR[kinematics], atol=1e-4)
    table = STUDY.per_pose(poses, residuals[1])
    assert [row["tension"] for row in table] == sorted(poses.tension)
    np.testing.assert_allclose(np.sqrt(np.mean([row["rms"] ** 2 for row in table])), here, rtol=1e-12)
    assert {row["pose"]: row["out_of_plane"] for row in table}["m2_u025"] > 0.02  # 7.7 N: out of the plane


@pytest.mark.slow
def test_friction_is_not_identified(poses):
    """Freed, the friction goes where the errors of the model push it: the two tendons of one body disagree."""
    free = ("youngs_modulus", "friction_coefficient")
    found = STUDY.fit(STUDY.prediction(poses, "published"), poses, free)
    assert found.success
    assert found.status["friction_coefficient"] == "not identified"
    assert np.isinf(found.standard_error["friction_coefficient"])
    assert found.correlation[0, 1] < -0.95  # README: -0.97 to -0.99
    # the error that the fit was told, 9 mm common to a pose, is the one that is left
    np.testing.assert_allclose(STUDY.rms(found.residuals), 8.3e-3, atol=1e-4)


def pose_by_scipy(tension, kinematics):
    """The solution with friction as well, mu = 0.2."""
    first, link = straight(15.41e-3, 6.42e-3, 0.305), straight(6.42e-3, 4.80e-3, 0.055)
    slope = -0.0295
    plain = PlainBody(
        0.36,
        lambda s: first(s) if s < 0.305 else link(s - 0.305),
        lambda s: 0.0,
        [lambda s: 11.4e-3 + slope * s],
        MODULUS[kinematics],
        [0.2],
        kinematics,
        slopes=[lambda s: slope],
        ends=(0.305,),
        breaks=(0.305,),
    )
    return loaded_reference(plain, tension, PlainLoads(gravity=(9.81, 0.0)), 1318.0)


# of the length: the accuracy that issue 3 asks for where the curvature changes its sign
ACCURATE = 1e-6 * 0.36


@pytest.mark.slow
@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_marker_by_scipy(poses, kinematics):
    """One pose: tip, its angle and the tension there; the marker ahead by the compiled program of `by_modulus`."""
    tension = float(poses.tension[1])
    reference = pose_by_scipy(tension, kinematics)
    predict = eqx.filter_jit(STUDY.prediction(poses, kinematics, 0.2))
    marker = predict({"youngs_modulus": jnp.asarray(MODULUS[kinematics])})[1, 3]
    ahead = STUDY.AHEAD[3] * np.array([np.cos(reference.tip_angle), np.sin(reference.tip_angle)])
    np.testing.assert_allclose(marker, reference.tip_position + ahead, atol=ACCURATE)
    body, loads = STUDY.body(MODULUS[kinematics], 0.2, kinematics), cddf.Loads(gravity=(9.81, 0.0))
    equilibrium = cddf.solve(body, tension, loads)
    np.testing.assert_allclose(equilibrium.tip_position, reference.tip_position, atol=ACCURATE)
    np.testing.assert_allclose(equilibrium.tip_angle, reference.tip_angle, atol=1e-6)
    np.testing.assert_allclose(equilibrium.tip_tension, reference.tip_tension, rtol=1e-6)
