"""Rotations in space as quaternions (w, x, y, z), which need not have the length 1.

Integration by Gauss nodes keeps the length of a quaternion from one end of an element to the other. At the nodes
themselves the length has the error of the quadrature; every function here divides by it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .arrays import cos_sin, sum_of

Vector = Float[Array, "*#points 3"]
Quaternion = Float[Array, "*#points 4"]
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def parts_of(vector: Float[Array, "*points n"]) -> list[Float[Array, "*points 1"]]:
    """The components, each in an array of its own, as XLA computes sums of products fastest in a batch."""
    return jnp.split(vector, vector.shape[-1], axis=-1)


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product a x b."""
    return jnp.concatenate(_cross(parts_of(a), parts_of(b)), axis=-1)


def cofactors(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The cofactors: each row times that of the matrix is the determinant, and the other rows are at right angles."""
    twice = jnp.concatenate([matrix, matrix])
    return cross(twice[1:4], twice[2:5])


def solve_three(matrix: Float[Array, "3 3"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """The solution of three linear equations by Cramer's rule; not finite where the matrix is singular."""
    by_rows = cofactors(matrix)
    return sum_of([x * row for x, row in zip(parts_of(vector), by_rows, strict=True)]) / dot(matrix[0], by_rows[0])


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """The rotation q, then p."""
    (v, *a), (w, *b) = parts_of(p), parts_of(q)
    vector = [v * y + w * x + z for x, y, z in zip(a, b, _cross(a, b), strict=True)]
    return jnp.concatenate([v * w - _dot(a, b), *vector], axis=-1)


def of_turn(turn: Vector) -> Quaternion:
    """The rotation about the direction of `turn` by an angle that is the length of `turn`, rad."""
    angle = length_of(turn)[..., None]
    cosine, sine = cos_sin(angle / 2)
    turns = angle > 0
    return jnp.concatenate([cosine, jnp.where(turns, sine / jnp.where(turns, angle, 1.0), 0.5) * turn], axis=-1)


def about(axis: Float[Array, "3"], angle: Float[Array, "*points"]) -> Quaternion:
    """The rotation about a unit vector by an angle, rad."""
    cosine, sine = cos_sin(angle[..., None] / 2)
    return jnp.concatenate([cosine, *(sine * part for part in axis)], axis=-1)


def turned_by(q: Quaternion, rate: Vector) -> Quaternion:
    """The derivative q (0, rate) / 2 of a rotation; `rate` is the rate of turning in its own axes, rad per unit."""
    (w, *axis), rates = parts_of(0.5 * q), parts_of(rate)
    vector = [w * x + y for x, y in zip(rates, _cross(axis, rates), strict=True)]
    return jnp.concatenate([-_dot(axis, rates), *vector], axis=-1)


def in_fixed_frame(q: Quaternion, vector: Vector) -> Vector:
    """The components in the fixed frame of a vector v given in the axes of the rotation: R v."""
    return _rotated(q, vector, jnp.add)


def in_own_frame(q: Quaternion, vector: Vector) -> Vector:
    """The components in the axes of the rotation of a vector v given in the fixed frame: R^T v."""
    return _rotated(q, vector, jnp.subtract)


def _rotated(q: Quaternion, vector: Vector, plus: Callable[[Array, Array], Array]) -> Vector:
    """R v = v + 2 a x (a x v + w v) / |q|^2 for a quaternion (w, a); R^T v with a minus sign in the place of `plus`."""
    w, *axis = parts = parts_of(q)
    along = parts_of(vector)
    inner = [plus(x, w * y) for x, y in zip(_cross(axis, along), along, strict=True)]
    return vector + 2.0 / _dot(parts, parts) * jnp.concatenate(_cross(axis, inner), axis=-1)


def turned_across(q: Quaternion, vector: Vector) -> Vector:
    """R v for a rotation of length 1 and a vector v at right angles to its axis."""
    w, *axis = parts_of(q)
    parts = parts_of(vector)
    across = _cross(axis, parts)
    return jnp.concatenate([(2.0 * w * w - 1.0) * x + 2.0 * w * y for x, y in zip(parts, across, strict=True)], axis=-1)


def first_axis(q: Quaternion) -> Vector:
    """The first axis of the rotation in the fixed frame: R (1, 0, 0)."""
    w, x, y, z = parts = parts_of(q)
    twice = 2.0 / _dot(parts, parts)
    return jnp.concatenate([1.0 - twice * (y * y + z * z), twice * (x * y + w * z), twice * (x * z - w * y)], axis=-1)


def as_matrix(q: Quaternion) -> Float[Array, "*points 3 3"]:
    """R, whose columns are the axes of the rotation."""
    axes = jnp.broadcast_to(jnp.eye(3, dtype=q.dtype), (*q.shape[:-1], 3, 3))
    return jnp.swapaxes(in_fixed_frame(q[..., None, :], axes), -1, -2)


def rotation_vector(matrix: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The rotation vector of a rotation by less than half a turn, rad; `of_turn` goes the other way."""
    twice_sine = jnp.stack([matrix[i, j] - matrix[j, i] for i, j in ((2, 1), (0, 2), (1, 0))])
    sine = length_of(twice_sine) / 2
    turns = sine > 0
    angle = jnp.arctan2(sine, (jnp.trace(matrix) - 1) / 2)
    return twice_sine / 2 * jnp.where(turns, angle / jnp.where(turns, sine, 1.0), 1.0)


def small_turn(change: Quaternion, q: Quaternion) -> Vector:
    """The small rotation vector, rad, in the fixed frame, by which a small change of the quaternion turns."""
    (v, *a), parts = parts_of(change), parts_of(q)
    w, *b = parts
    twice = 2.0 / _dot(parts, parts)
    turn = [twice * (w * x - v * y - z) for x, y, z in zip(a, b, _cross(a, b), strict=True)]
    return jnp.concatenate(turn, axis=-1)


def dot(a: Float[Array, "*points n"], b: Float[Array, "*points n"]) -> Float[Array, "*points"]:
    """The inner product."""
    return _dot(parts_of(a), parts_of(b))[..., 0]


def _dot(a: list[Array], b: list[Array]) -> Array:
    return sum_of([x * y for x, y in zip(a, b, strict=True)])


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def length_of(vector: Float[Array, "*points n"]) -> Float[Array, "*points"]:
    """The length of a vector, with the derivative zero where it is zero."""
    return square_root(dot(vector, vector))


@jax.custom_jvp
def square_root(square: Array) -> Array:
    """The square root, with the derivative zero where it is zero."""
    return jnp.sqrt(square)


@square_root.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    root = square_root(*primals)
    positive = root > 0
    return root, jnp.where(positive, 0.5 * tangents[0] / jnp.where(positive, root, 1.0), 0.0)


def direction_of(vector: Float[Array, "*points n"]) -> Float[Array, "*points n"]:
    """The unit vector along a vector; zero for a vector of length zero."""
    length = length_of(vector)[..., None]
    return vector / jnp.where(length > 0, length, 1.0)


def tilt(q: Quaternion) -> Float[Array, "*points"]:
    """The angle between the first axis and the rotated first axis, rad, from 0 to pi; at 0 its derivative is zero."""
    across = length_of(q[..., 2:])
    return 2.0 * jnp.arctan2(across, length_of(q[..., :2]))
