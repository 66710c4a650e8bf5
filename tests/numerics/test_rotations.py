"""Rotations as quaternions of any length, against SciPy's, and three equations, against NumPy's."""

import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cddf_jax.numerics.rotations import as_matrix, first_axis, in_fixed_frame, in_own_frame, rotation_vector

RNG = np.random.default_rng(3)
LONG = jnp.asarray(RNG.normal(size=(7, 4)))  # not of length 1
SCIPY = Rotation.from_quat(LONG, scalar_first=True)
VECTORS = jnp.asarray(RNG.normal(size=(7, 3)))


def test_vectors_are_rotated_as_by_scipy():
    assert_allclose(in_fixed_frame(LONG, VECTORS), SCIPY.apply(np.array(VECTORS)), rtol=1e-13, atol=1e-14)
    assert_allclose(in_own_frame(LONG, VECTORS), SCIPY.inv().apply(np.array(VECTORS)), rtol=1e-13, atol=1e-14)
    assert_allclose(as_matrix(LONG), SCIPY.as_matrix(), rtol=1e-13, atol=1e-14)
    assert_allclose(first_axis(LONG), SCIPY.as_matrix()[..., 0], rtol=1e-13, atol=1e-14)


def test_rotation_vectors_are_those_of_scipy():
    for rotation in (*SCIPY, Rotation.identity()):
        short = Rotation.from_rotvec(0.9 * rotation.as_rotvec())  # of less than half a turn
        assert_allclose(rotation_vector(short.as_matrix()), short.as_rotvec(), rtol=1e-12, atol=1e-14)
    nearly = np.array([1e-9, -2e-9, 3e-9])
    assert_allclose(rotation_vector(Rotation.from_rotvec(nearly).as_matrix()), nearly, rtol=1e-6)
