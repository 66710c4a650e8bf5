"""Whether the state of a body is determined whose tendons stick in some elements and slide in others: NumPy alone.

Nodes s_k = k h carry the strain u_k, twist and bending about y and z (in the plane the last), and the tensions T_ki;
elements lie between them. With q = e_x + u x rho + rho', t = q / |q| and B_i = rho_i x t_i, by which the length of a
tendon changes with the strain, the equations are

    K u + sum_i T_i B_i = R^T M,  M_k = (r_N - r_k) x F          at each node, F the force on the tip
    T_k - T_k+1 = sigma 2 tanh(mu |delta| / 2) (T_k + T_k+1) / 2   where a tendon slides in (1) or out (-1)
    w_k = sum_j>k h_j (|q_0| - |q|)_j stays                        where it sticks
    T_0 is given

with the turning delta = t_k+1 - t_k + h u x t of the tendon. Their derivatives, by finite differences, form a square
matrix. Directions that it does not see are not determined by the equations: tensions of tendons that stick together,
which no change of the shape goes with. Where the largest change of the shape by a small moment grows without limit, the
body snaps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

MOVE, LOST, SHAPELESS = 1e-5, 1e-7, 1e-4  # of a scaled unknown, singular value, part of the shape in a direction


class Determined(NamedTuple):
    """What a matrix of derivatives tells."""

    open_tensions: int  # directions that are not determined and in which only tensions change
    open_shapes: int  # those in which the shape changes
    compliance: float  # largest change of the shape by a moment on it, over that of the body without tendons
    missing: float  # largest moment that is missing in the equilibrium, over that of the tendons


@dataclass(frozen=True)
class Body:
    """A body with E J, tendons that may be slanted or wind, and one friction coefficient; SI units."""

    length: float
    stiffness: Callable[[np.ndarray], np.ndarray]  # E J of an arc length
    twist: float  # stiffness of twist over E J
    tendons: tuple[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], ...]  # offset and angle of an arc length
    friction: float
    in_space: bool

    def determined(self, tension: np.ndarray, strain: np.ndarray, slides: np.ndarray, force: np.ndarray) -> Determined:
        """Judge a state.

        Args:
            tension: (nodes, tendons), N.
            strain: (nodes, 3), twist and bending about y and z, 1/m.
            slides: (elements, tendons), 1 in, -1 out, 0 for a tendon that sticks.
            force: (3,), on the tip, N.
        """
        count, free = tension.shape[1], slice(0, 3) if self.in_space else slice(2, 3)
        nodes, pull = len(tension), max(np.max(tension), 1e-3)
        arm, soft = 0.01, self.stiffness(np.zeros(1))[0]
        scale = np.concatenate([np.full(tension.size, pull), np.full(strain[:, free].size, pull * arm / soft)])
        start = np.concatenate([tension.ravel(), strain[:, free].ravel()]) / scale

        def rows(x: np.ndarray) -> np.ndarray:
            x, bent = x * scale, strain.copy()
            bent[:, free] = x[tension.size :].reshape(nodes, -1)
            moments, drops, slips = self._missing(x[: tension.size].reshape(nodes, count), bent, slides, force)
            held = np.where(slides == 0, slips / (pull * arm**2 * self.length / soft), drops / pull)
            return np.concatenate([moments[:, free].ravel() / (pull * arm), x[:count] / pull, held.ravel()])

        moved = MOVE * np.eye(start.size)
        matrix = np.stack([(rows(start + by) - rows(start - by)) / (2 * MOVE) for by in moved], axis=1)
        left, sizes, right = np.linalg.svd(matrix)
        seen = sizes > LOST * sizes[0]
        shapes = np.linalg.norm(right[:, tension.size :], axis=1)
        at_moments = left[: start.size - tension.size]  # the rows of moments come first
        response = (right[seen, tension.size :].T / sizes[seen]) @ at_moments[:, seen].T
        lacks = np.max(np.abs(rows(start)[: start.size - tension.size]))
        open_ones = shapes[~seen] < SHAPELESS
        return Determined(int(np.sum(open_ones)), int(np.sum(~open_ones)), float(np.linalg.norm(response, 2)), lacks)

    def _missing(
        self, tension: np.ndarray, strain: np.ndarray, slides: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moments at the nodes, drops of tension less friction, slips."""
        elements = len(tension) - 1
        h, s = self.length / elements, np.linspace(0.0, self.length, elements + 1)
        frames, steps = [np.eye(3)], []
        for mean in (strain[1:] + strain[:-1]) / 2:
            steps.append(h * (frames[-1] @ _turn(h / 2 * mean))[:, 0])
            frames.append(frames[-1] @ _turn(h * mean))
        beyond = np.concatenate([np.cumsum(np.array(steps)[::-1], axis=0)[::-1], np.zeros((1, 3))])
        moment = np.einsum("kji,kj->ki", np.array(frames), np.cross(beyond, force))
        bend = self.stiffness(s)[:, None] * [self.twist, 1.0, 1.0] * strain - moment
        weight = np.full((elements, 1), h)
        weight[-1] /= 2
        drops, slips = np.zeros_like(slides, float), np.zeros_like(slides, float)
        for i, tendon in enumerate(self.tendons):
            place, slope = _route(tendon, s)
            path = np.array([1.0, 0.0, 0.0]) + slope
            q = path + np.cross(strain, place)
            size = np.linalg.norm(q, axis=1, keepdims=True)
            t = q / size
            bend += tension[:, i : i + 1] * np.cross(place, t)
            shorter = weight * (np.linalg.norm(path, axis=1, keepdims=True) - size)[1:]
            slips[:, i] = np.cumsum(shorter[::-1, 0])[::-1]
            turn = np.diff(t, axis=0) + h * np.cross((strain[1:] + strain[:-1]) / 2, (t[1:] + t[:-1]) / 2)
            angle = np.sqrt(np.sum(turn**2, axis=1) + 1e-22)
            limit = np.tanh(self.friction * angle / 2) * (tension[1:, i] + tension[:-1, i])
            drops[:, i] = -np.diff(tension[:, i]) - slides[:, i] * limit
        return bend, drops, slips


def _turn(vector: np.ndarray) -> np.ndarray:
    """The rotation by a vector, Rodrigues."""
    angle = np.linalg.norm(vector) + 1e-300
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _route(tendon: Callable, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rho and rho' of a tendon, by differences."""

    def place(s: np.ndarray) -> np.ndarray:
        offset, angle = tendon(s)
        return np.stack([0.0 * s, offset * np.cos(angle), offset * np.sin(angle)], axis=1)

    d = 1e-6
    return place(s), (place(s + d) - place(s - d)) / (2 * d)
