"""Rotations in space as quaternions (w, x, y, z), which need not have the length 1.

Integration by Gauss nodes keeps the length of a quaternion from one end of a panel to the other. At the nodes
themselves the length has the error of the quadrature; every function here divides by it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .arrays import cos_sin

Vector = Float[Array, "*#points 3"]
Quaternion = Float[Array, "*#points 4"]
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product a x b."""

    def moved(x: Vector) -> Vector:
        return jnp.concatenate([x[..., 1:], x[..., :1]], axis=-1)

    return moved(a * moved(b) - moved(a) * b)


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """The rotation q, then p."""
    w = p[..., :1] * q[..., :1] - jnp.sum(p[..., 1:] * q[..., 1:], axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + cross(p[..., 1:], q[..., 1:])
    return jnp.concatenate([w, vector], axis=-1)


def of_turn(turn: Vector) -> Quaternion:
    """The rotation about the direction of `turn` by an angle that is the length of `turn`, rad."""
    angle = length_of(turn)[..., None]
    cosine, sine = cos_sin(angle / 2)
    turns = angle > 0
    return jnp.concatenate([cosine, jnp.where(turns, sine / jnp.where(turns, angle, 1.0), 0.5) * turn], axis=-1)


def inverse(q: Quaternion) -> Quaternion:
    """The inverse rotation; the quaternion keeps its length."""
    return jnp.concatenate([q[..., :1], -q[..., 1:]], axis=-1)


def turned_by(q: Quaternion, rate: Vector) -> Quaternion:
    """The derivative q (0, rate) / 2 of a rotation; `rate` is the rate of turning in its own axes, rad per unit."""
    w = -jnp.sum(q[..., 1:] * rate, axis=-1, keepdims=True)
    return 0.5 * jnp.concatenate([w, q[..., :1] * rate + cross(q[..., 1:], rate)], axis=-1)


def in_fixed_frame(q: Quaternion, vector: Vector) -> Vector:
    """The components in the fixed frame of a vector v given in the axes of the rotation: R v."""
    across = cross(q[..., 1:], vector)
    twice = 2.0 / jnp.sum(q**2, axis=-1, keepdims=True)
    return vector + twice * (q[..., :1] * across + cross(q[..., 1:], across))


def in_own_frame(q: Quaternion, vector: Vector) -> Vector:
    """The components in the axes of the rotation of a vector v given in the fixed frame: R^T v."""
    return in_fixed_frame(inverse(q), vector)


def as_matrix(q: Quaternion) -> Float[Array, "*points 3 3"]:
    """R, whose columns are the axes of the rotation."""
    axes = jnp.broadcast_to(jnp.eye(3, dtype=q.dtype), (*q.shape[:-1], 3, 3))
    return jnp.swapaxes(in_fixed_frame(q[..., None, :], axes), -1, -2)


def small_turn(change: Quaternion, q: Quaternion) -> Vector:
    """The small rotation vector, rad, in the fixed frame, by which a small change of the quaternion turns."""
    return 2.0 * product(change, inverse(q))[..., 1:] / jnp.sum(q**2, axis=-1, keepdims=True)


def length_of(vector: Float[Array, "*points n"]) -> Float[Array, "*points"]:
    """The length of a vector, with the derivative zero where it is zero."""
    square = jnp.sum(vector**2, axis=-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def tilt(q: Quaternion) -> Float[Array, "*points"]:
    """The angle between the first axis and the rotated first axis, rad, from 0 to pi; at 0 its derivative is zero."""
    across = length_of(q[..., 2:])
    return 2.0 * jnp.arctan2(across, length_of(q[..., :2]))
