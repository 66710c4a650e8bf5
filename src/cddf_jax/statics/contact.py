"""Whether a bent body touches itself. The model has no contact forces."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import ArrayLike

from ..mechanics.problem import State
from .equilibrium import Dense, Equilibrium

STATIONS = 401
BESIDE = 1e-5  # of the length, from a joint to the station beyond it, so that positions differ in single precision too
# if headings differ by less, cross-sections pi R apart along the axis are pi R cos(pi/4) > 2 R apart in space
TURNS = np.pi / 2
PROJECTIONS, NEAR = 60, 1e-4  # of points on two cylinders; distance over the sum of radii that counts as touching


class Contact(NamedTuple):
    """Two arc lengths of a body whose cross-sections touch."""

    arc_length: float  # m, of the cross-section that is nearer to the base
    other: float  # m, of the other one
    distance: float  # m, between the two points of the neutral axis


def self_contact(equilibrium: Equilibrium) -> Contact | None:
    """Where the wall of a bent body touches or overlaps another part of itself; None where it does not.

    The body is a row of cylinders between 401 arc lengths and its joints, in the plane a row of rectangles. Two of them
    touch if they share a point and are farther apart along the body than pi times the larger of their radii. Nearer
    ones share a point only where the bend is sharper than the radius, R kappa > 1.
    A tube bent to a full circle, 2 pi, touches itself with its ends. If several pairs touch, the result is the pair
    with the smallest distance of the neutral axis over the sum of the radii. Clamp, tendons and disks are not
    considered.

    Args:
        equilibrium: one solve, on the host; a body without an outer radius or without a solution has no contact.

    Raises:
        ValueError: for a batch or traced values.
    """
    if isinstance(equilibrium.tip_angle, Tracer) or np.ndim(equilibrium.tip_angle) > 0:
        raise ValueError("self_contact: needs one equilibrium, not a batch and not traced; take one lane out of it")
    body = equilibrium._dense.manipulator
    if not equilibrium.has_wall or not _comes_round(equilibrium):
        return None
    s = _stations(float(body.length), np.asarray(body.breakpoints, float))
    along = jax.tree.map(np.asarray, _centre_line(equilibrium._dense, s))
    radius = np.asarray(body.radii(s)[0])
    i, j = _far_pairs(s, along.position, radius)
    touching = _cylinders_touch(along.position, radius, i, j)
    if not np.any(touching):
        return None
    i, j = i[touching], j[touching]
    distance = np.linalg.norm(along.position[i] - along.position[j + 1], axis=-1)
    nearest = np.argmin(distance / (radius[i] + radius[j + 1]))
    return Contact(float(s[i[nearest]]), float(s[j[nearest] + 1]), float(distance[nearest]))


def _comes_round(equilibrium: Equilibrium) -> bool:
    """Whether the body turns far enough to touch itself; False where the headings are NaN."""
    if not equilibrium.in_space:
        return bool(np.ptp(equilibrium.heading) >= TURNS)
    tangent = np.asarray(equilibrium.frame)[:, :, 0]
    mean = np.sum(tangent, axis=0)
    return bool(np.min(tangent @ mean) <= np.cos(TURNS / 2) * np.linalg.norm(mean))


@eqx.filter_jit
def _centre_line(dense: Dense, arc_length: ArrayLike) -> State:
    return jax.vmap(dense.state)(jnp.asarray(arc_length))


def _stations(length: float, joints: np.ndarray) -> np.ndarray:
    joints = joints[(joints > 0) & (joints < length)]
    return np.unique(np.concatenate([np.linspace(0.0, length, STATIONS), joints, joints + BESIDE * length]))


def _far_pairs(s: np.ndarray, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of pieces that are far apart along the body, and whose axes are near enough to touch."""
    reach = np.maximum(radius[:-1], radius[1:]) + np.diff(s)  # of a piece from its first neutral point
    i, j = np.triu_indices(len(reach), 1)
    apart = s[j] - s[i + 1]
    far = apart > np.pi * np.maximum(reach[i], reach[j])
    near = np.linalg.norm(position[i] - position[j], axis=-1) <= reach[i] + reach[j]
    return i[far & near], j[far & near]


def _cylinders_touch(position: np.ndarray, radius: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Whether pieces i and j of a tube share a point; alternating projections find their nearest points.

    Args:
        position: of the axis (stations, components), m.
        radius: of the tube (stations,), m.
        i, j: pairs of pieces; piece k lies between stations k and k + 1.
    """
    middle, chord = 0.5 * (position[1:] + position[:-1]), np.diff(position, axis=0)
    half = 0.5 * np.linalg.norm(chord, axis=-1)
    axis, wide = chord / (2.0 * half[:, None]), 0.5 * (radius[1:] + radius[:-1])

    def onto(piece: np.ndarray, point: np.ndarray) -> np.ndarray:
        away, along = point - middle[piece], axis[piece]
        ahead = np.sum(away * along, axis=-1)
        across = away - ahead[:, None] * along
        far = np.maximum(np.linalg.norm(across, axis=-1), np.finfo(float).tiny)
        inside = np.minimum(1.0, wide[piece] / far)[:, None] * across
        return middle[piece] + np.clip(ahead, -half[piece], half[piece])[:, None] * along + inside

    one = middle[i]
    other = onto(j, one)
    for _ in range(PROJECTIONS):
        one = onto(i, other)
        other = onto(j, one)
    return np.linalg.norm(one - other, axis=-1) <= NEAR * (wide[i] + wide[j])
