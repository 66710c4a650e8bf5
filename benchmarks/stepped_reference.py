"""Makes the numbers to which `tests/history/test_stepped_reference.py` compares `trace`; no line is the library's.

A simulation with NumPy and SciPy: short steps in time, friction that is regularised, no fronts. The body is cut into
equal cells of one tension T of each tendon and one curvature kappa; at the edges between them are the heading phi, the
moment M of the tip force, the slip w of each tendon, and its friction (exact kinematics, offset d on side +1 or -1):

    E J kappa = sum side d T + M      phi' = kappa      M' = F x t      w' = -(side d kappa + T / EA)
    T' = -mu sigma |kappa| T          sigma: share of the friction limit

with phi = 0 and T = T_base at the base, M = 0 and w = 0 at the tip. In each step the slip dw at an edge and sigma there
obey dw = eps / (1 - sigma) - eps / (1 + sigma), which tends to Coulomb's law where eps goes to zero. The equations are
solved by Newton's method as an interior point: dw = p - m with p (1 - sigma) = eps, m (1 + sigma) = eps and p, m > 0.

Errors fall with the square of the cells and with the first power of the steps; both are extrapolated.
Run it as `python benchmarks/stepped_reference.py`; it takes some minutes and prints what the test stores.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

LENGTH, RADII, INNER, OFFSET, YOUNG, MU = 0.140, (0.020, 0.013), 0.007, 0.010, 1.4e6, 0.42
EA = 1e4  # N
EPS = 1e-16  # m, of the regularised law
FIRST_EPS = 1e-6


class Case(NamedTuple):
    """A path: base tensions (steps, tendons), N, and tip forces (steps, 2), N."""

    sides: tuple[int, ...]
    tension: tuple[tuple[float, ...], ...]
    force: tuple[tuple[float, float], ...]


CASES = {
    "antagonists": Case((1, -1), ((75.0, 20.0), (60.0, 20.0)), ((0.0, 0.0),) * 2),
    "push": Case((1,), ((75.0,), (60.0,), (60.0,), (60.0,)), ((0.0, 0.0), (0.0, 0.0), (0.0, -1.0), (0.0, 0.0))),
}


class Body:
    """The cells and the equations; a state is (edges, unknowns), those of a cell with the edge at its end."""

    def __init__(self, sides, cells):
        self.arm, self.n, self.cells = OFFSET * np.array(sides, float), len(sides), cells
        n, self.h = self.n, LENGTH / cells
        self.width = np.full((cells, 1), self.h)  # between the middles of cells; half of one at the base
        self.width[0] /= 2
        middle = self.h * (np.arange(cells) + 0.5)
        outer = RADII[0] + (RADII[1] - RADII[0]) * middle / LENGTH
        self.stiffness = YOUNG * np.pi / 4 * (outer**4 - INNER**4)
        self.T, self.kappa, self.phi, self.M, self.w = slice(0, n), n, n + 1, n + 2, slice(n + 3, 2 * n + 3)
        self.sigma, self.p, self.m = (slice((2 + i) * n + 3, (3 + i) * n + 3) for i in range(3))
        self.size = 5 * n + 3
        self.colours = self._colours()
        self.places = self._places()

    def _colours(self):
        """(unknown, first edge, stride): columns of the Jacobian that share no row."""
        return [(k, first, 3) for k in range(self.size) for first in range(3)]

    def _places(self):
        """Colour, row and column of what may differ from zero in the Jacobian."""
        found, E, K = [], self.cells + 1, self.size
        for i, (k, first, stride) in enumerate(self.colours):
            edges = np.arange(first, E, stride)
            for beside in (-1, 0, 1):
                at = edges[(edges + beside >= 0) & (edges + beside < E)]
                row, column = np.meshgrid(np.arange(K), at * K + k)
                found.append([np.full(row.size, i), (row + column - k + beside * K).ravel(), column.ravel()])
        return np.concatenate(found, axis=1)

    def residual(self, x, slip, tension, force, eps):
        """Block tridiagonal; x may have leading axes. `slip`: before the step."""
        mean, step = (x[..., 1:, :] + x[..., :-1, :]) / 2, np.diff(x, axis=-2)
        size = mean[..., self.kappa, None] * np.where(mean[..., self.kappa, None].real < 0, -1.0, 1.0)
        sigma, p, m = (x[..., k] for k in (self.sigma, self.p, self.m))
        loss = MU * self.width * sigma[..., :-1, :] * size * mean[..., self.T]
        out = np.empty_like(x)
        out[..., 0, self.T] = x[..., 0, self.T] - tension
        out[..., 1:, self.T] = step[..., self.T] + loss
        out[..., 0, self.kappa] = step[..., 0, self.kappa]  # that of the first cell
        moment = x[..., 1:, self.T] @ self.arm + mean[..., self.M]
        out[..., 1:, self.kappa] = x[..., 1:, self.kappa] - moment / self.stiffness
        out[..., 0, self.phi] = x[..., 0, self.phi]
        out[..., 1:, self.phi] = step[..., self.phi] - self.h * x[..., 1:, self.kappa]
        c, s = np.cos(mean[..., self.phi]), np.sin(mean[..., self.phi])
        out[..., :-1, self.M] = step[..., self.M] + self.h * (c * force[1] - s * force[0])
        by = self.arm * x[..., 1:, self.kappa, None] + x[..., 1:, self.T] / EA
        out[..., :-1, self.w] = step[..., self.w] + self.h * by
        out[..., -1, self.M], out[..., -1, self.w] = x[..., -1, self.M], x[..., -1, self.w]
        out[..., self.sigma] = x[..., self.w] - slip - p + m
        out[..., self.p] = p * (1 - sigma) - eps
        out[..., self.m] = m * (1 + sigma) - eps
        return out

    def newton(self, x, *given):
        """The step of Newton's method; columns of the Jacobian by complex steps."""
        K, E, tiny = self.size, self.cells + 1, 1e-30
        moved = np.repeat(x[None].astype(complex), len(self.colours), axis=0)
        for i, (k, first, stride) in enumerate(self.colours):
            moved[i, first::stride, k] += 1j * tiny
        slopes = self.residual(moved, *given).imag / tiny
        half, (colour, row, column) = 2 * K - 1, self.places
        band = np.zeros((2 * half + 1, E * K))
        band[half + row - column, column] = slopes.reshape(len(slopes), -1)[colour, row]
        return -solve_banded((half, half), band, self.residual(x, *given).ravel()).reshape(x.shape)

    def after_step(self, x, tension, force):
        slip = x[:, self.w]
        x = x.copy()
        x[:, self.sigma] *= 0.9
        x[:, self.p] = FIRST_EPS / (1 - x[:, self.sigma])
        x[:, self.m] = FIRST_EPS / (1 + x[:, self.sigma])
        eps = FIRST_EPS
        for _ in range(150):
            change = self.newton(x, slip, tension, force, eps)
            part = 1.0  # of the way to where p, m or 1 +- sigma would be zero
            for value, by in (
                (x[:, self.p], change[:, self.p]),
                (x[:, self.m], change[:, self.m]),
                (1 - x[:, self.sigma], -change[:, self.sigma]),
                (1 + x[:, self.sigma], change[:, self.sigma]),
            ):
                shrinking = by < 0
                part = min(part, 0.99 * np.min(-value[shrinking] / by[shrinking], initial=np.inf))
            x = x + part * change
            if eps == EPS and part == 1.0 and np.max(np.abs(change[:, self.phi])) < 1e-9:
                return x
            if part > 0.5:
                eps = max(eps / 10, EPS)
        raise RuntimeError(f"no convergence at {tension}, {force}: regularised by {eps}")

    def tip(self, x):
        """Angle, rad; y, m; tensions, N."""
        heading = (x[1:, self.phi] + x[:-1, self.phi]) / 2
        tension = 1.5 * x[-1, self.T] - 0.5 * x[-2, self.T]  # from the middles of the last cells
        return np.array([x[-1, self.phi], self.h * np.sum(np.sin(heading)), *tension])


def simulate(case, cells, steps):
    """Angle, y and tensions of the tip after each step of the path; each step in `steps` short ones."""
    body = Body(case.sides, cells)
    x = np.zeros((cells + 1, body.size))
    tension, force, tips = np.zeros(body.n), np.zeros(2), []
    for row, (next_tension, next_force) in enumerate(zip(np.array(case.tension), np.array(case.force), strict=True)):
        count = steps if row else 1  # from rest all tendons slide one way: one short step is exact
        for part in np.arange(1, count + 1) / count:
            here = tension + part * (next_tension - tension), force + part * (next_force - force)
            x = body.after_step(x, *here)
        tension, force = next_tension, next_force
        tips.append(body.tip(x))
    return np.array(tips)


def extrapolated(case, steps):
    """The limit of many cells and short steps, from 50 and 100 cells and from `steps` and half as many."""
    fine, half = simulate(case, 100, steps), simulate(case, 100, steps // 2)
    by_cells = simulate(case, 100, 32) - simulate(case, 50, 32)
    return fine + (fine - half) + by_cells / 3


def show(words, tips):
    print(words, *np.array2string(tips, precision=6, suppress_small=True).splitlines(), sep="\n  ", flush=True)


if __name__ == "__main__":
    for name, case in CASES.items():
        units = [np.degrees(1), 1e3] + [1] * len(case.sides)
        limit = extrapolated(case, 128 if name == "antagonists" else 64)
        show(f"{name}: angle, deg; y, mm; tensions, N", limit * units)
