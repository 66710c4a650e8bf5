"""Bodies under dead loads, from NumPy and SciPy alone: no line here uses the library's mechanics.

Model: docs/theory.md. N(s) = F + int_s^L rho A g; M_ext' = -(t x N), M_ext(L) = m;
published: E J kappa = sum sigma d T q + M_ext, theta' = |kappa / q|, q = 1 - sigma d kappa;
exact: E J kappa = sum sigma d T q / sqrt(q^2 + d'^2) + M_ext, theta = turning of psi = phi + atan2(sigma d', q).
"""

from collections.abc import Callable
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from bodies import PlainBody
from kinds import root_of
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


class PlainLoads(NamedTuple):
    """Dead loads in the fixed frame, docs/theory.md: F (N), m (N m), g (m/s^2)."""

    tip_force: tuple[float, float] = (0.0, 0.0)
    tip_moment: float = 0.0
    gravity: tuple[float, float] = (0.0, 0.0)

    def times(self, fraction: float) -> "PlainLoads":
        (fx, fy), m, (gx, gy) = self
        return PlainLoads((fraction * fx, fraction * fy), fraction * m, (fraction * gx, fraction * gy))


class LoadedReference(NamedTuple):
    tip_tension: np.ndarray  # at its anchor where a tendon ends before the tip
    wrap_angle: np.ndarray  # there too
    tip_angle: float
    tip_position: np.ndarray
    displacement: np.ndarray  # straight less bent length of each tendon's path
    base_moment: float  # M_ext(0)
    arc_length: np.ndarray  # where the integrator stepped; twice where it restarted
    heading: np.ndarray
    curvature: np.ndarray
    position: np.ndarray
    turning_points: np.ndarray  # where kappa (slanted and exact: psi' of a tendon) passes through 0; jumps aside


def largest_difference(solution: Any, reference: LoadedReference, body: PlainBody) -> float:
    """Of tip tensions (relative), angles, tip position, displacements (per length), base moment (per E J / L)."""
    unit = body.youngs_modulus * body.second_moment(0.0) / body.length
    pairs = [
        (solution.tip_tension, reference.tip_tension, np.where(reference.tip_tension > 0, reference.tip_tension, 1.0)),
        (solution.wrap_angle[:, -1], reference.wrap_angle, 1.0),
        (solution.tip_angle, reference.tip_angle, 1.0),
        (solution.tip_position, reference.tip_position, body.length),
        (solution.tendon_displacement, reference.displacement, body.length),
        (solution.base_moment, reference.base_moment, unit),
    ]
    return float(max(np.max(np.abs(np.asarray(ours) - theirs) / size) for ours, theirs, size in pairs))


class NotFoundError(RuntimeError):
    """No equilibrium at the end of the path: a fold in the loads, or a trial shape without meaning."""


def _area(body: PlainBody, s: Any) -> Any:
    return np.pi * (body.outer_radius(s) ** 2 - body.inner_radius(s) ** 2)


# --- shooting ------------------------------------------------------------------------------------


def loaded_reference(
    body: PlainBody,
    base_tension: Any,
    loads: PlainLoads = PlainLoads(),
    density: float = 0.0,
    direction: Any = +1,
    rtol: float = 1e-11,
    aim: float = 1e-12,
) -> LoadedReference:
    """Equilibrium at constant base tensions, docs/theory.md, by shooting on M_ext(0).

    The tensions come first (M_ext(0) = 0 without loads), then the loads grow from 0 to 1. The steps
    are short enough for the tip to turn by less than half a radian, so that the branch is followed.
    At the end no more than `aim` of the moment at the tip is missing, per E J / L at the base.

    Raises:
        NotFoundError: where the branch ends (a fold) before the loads are all there.
    """
    shot = _Shot(body, base_tension, loads, density, direction)
    if loads == PlainLoads():
        return shot.fly(0.0, 0.0, rtol, True).reference
    done, step, slope = [(0.0, 0.0, shot.fly(0.0, 0.0, 1e-6).tip_angle)], 0.25, 1.0
    while done[-1][0] < 1:
        target = min(1.0, done[-1][0] + step)
        (l0, m0, _), (l1, m1, angle) = done[-2:] if len(done) > 1 else [(-1.0, 0.0, 0.0), done[0]]
        try:
            guess = m1 + (m1 - m0) * (target - l1) / (l1 - l0)
            moment, flight, new_slope = _root(shot, target, guess, slope, 1e-6, 1e-5)
            if abs(flight.tip_angle - angle) > 0.5 or new_slope * slope < 0:
                raise NotFoundError("too long a step")
        except (NotFoundError, FloatingPointError):
            step /= 2
            if step < 1e-4:
                raise NotFoundError(f"no equilibrium found beyond {l1:.4f} of the loads") from None
            continue
        done.append((target, moment, flight.tip_angle))
        slope, step = new_slope, 1.5 * step
    return _root(shot, 1.0, done[-1][1], slope, rtol, aim, True)[1].reference


def reference_solution(body: PlainBody, base_tension: Any, direction: Any = +1) -> LoadedReference:
    """The same without loads, where nothing has to be shot at, integrated with a relative tolerance of 1e-12."""
    return loaded_reference(body, base_tension, direction=direction, rtol=1e-12)


class _Flight(NamedTuple):
    miss: float  # M_ext(L) - m, per E J / L at the base
    tip_angle: float
    reference: Any


def _root(
    shot: "_Shot", fraction: float, moment: float, slope: float, rtol: float, aim: float, fine: bool = False
) -> tuple[float, _Flight, float]:
    """Secant method for the base moment, until it hits or, near round-off, gets no closer."""
    flight = shot.fly(moment, fraction, rtol, fine)
    for _ in range(12):
        if abs(flight.miss) < aim:
            return moment, flight, slope
        change = np.clip(-flight.miss / slope, -0.5, 0.5)
        nearer = shot.fly(moment + change, fraction, rtol, fine)
        if abs(nearer.miss) >= abs(flight.miss) and abs(flight.miss) < 30 * aim:
            return moment, flight, slope
        slope = (nearer.miss - flight.miss) / change
        moment, flight = moment + change, nearer
    raise NotFoundError("the secant method does not converge")


class _Shot:
    """The initial-value problem in (wrap angles, phi, x, y, M_ext, mass inboard, displacements) for given M_ext(0).

    The sign with which each tendon turns is constant in a piece, so that everything is smooth in it;
    pieces end at breaks, anchors and where an event finds a turning rate of 0. In the exact
    kinematics a wrap angle is that at the start of the piece plus sign (psi - psi_start), without psi'.
    """

    def __init__(self, body: PlainBody, base_tension: Any, loads: PlainLoads, density: float, direction: Any):
        n = self.n = len(body.sides)
        self.body, self.loads, self.density = body, loads, density
        self.base = np.broadcast_to(np.asarray(base_tension, float), n)
        self.gain = np.broadcast_to(np.asarray(direction, float), n) * np.asarray(body.friction)
        self.side = np.asarray(body.sides, float)
        self.ends = np.asarray(body.ends if len(body.ends) else [np.inf] * n, float)
        self.exact = body.kinematics == "exact"
        self.slanted = self.exact and body.slopes is not None
        self.unit = body.youngs_modulus * body.second_moment(0.0) / body.length  # of moments
        inner = [s for s in (*body.breaks, *self.ends) if 0 < s < body.length]
        self.stops = sorted({0.0, body.length, *inner})
        areas = [quad(lambda s: _area(body, s), a, b, epsabs=0, epsrel=1e-13)[0] for a, b in pairwise(self.stops)]
        self.total_mass = density * sum(areas)

    def fly(self, moment: float, fraction: float, rtol: float, fine: bool = False) -> _Flight:
        """From base to tip; `moment` per E J / L at the base."""
        n, length = self.n, self.body.length
        self.force = fraction * np.asarray(self.loads.tip_force, float)
        self.gravity = fraction * np.asarray(self.loads.gravity, float)
        self.rtol, self.fine, self.kappa, self.sign = rtol, fine, 0.0, np.ones(n)
        size = [1.0] * n + [1.0, length, length, self.unit, max(self.total_mass, 1e-300)] + [length] * n
        self.atol = 1e-2 * rtol * np.asarray(size)
        self.rows, self.turning_points, psi = [], [], None
        y = np.zeros(2 * n + 5)
        y[n + 3] = moment * self.unit
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            for start, stop in pairwise(self.stops):
                y, psi = self._piece(y, psi, start, stop)
        miss = (y[n + 3] - fraction * self.loads.tip_moment) / self.unit
        if not fine:
            return _Flight(miss, y[n], None)
        s, phi, kappa, position = (np.concatenate(x) for x in zip(*self.rows, strict=True))
        tension, wrap, shorter = self.base * np.exp(-self.gain * y[:n]), y[:n], y[n + 5 :]
        found = (tension, wrap, y[n], y[n + 1 : n + 3], shorter, moment * self.unit, s, phi, kappa, position)
        return _Flight(miss, y[n], LoadedReference(*found, np.array(self.turning_points)))

    def _piece(self, y: np.ndarray, psi_before: Any, start: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
        n, tiny, faint = self.n, 1e-12 * self.body.length, 1e-8 / self.body.length
        self.start, self.stop, self.present = start, stop, self.ends >= stop
        y = y.copy()
        # at a break a slanted tendon turns by a finite angle, on one side or the other
        self.wrap0, self.psi0 = y[:n].copy(), psi_before
        if self.slanted and psi_before is not None:
            self._choose_signs(lambda: self._local(start, y)[-1] - psi_before, 1e-12)
            y[:n] = self._wrap(self._local(start, y)[-1])
        if self.slanted:
            self.wrap0, self.psi0 = y[:n].copy(), None
            self.psi0 = self._local(start, y)[-1]
            self._choose_signs(lambda: self._turning(start, y), faint)
        else:
            self.psi0 = np.full(n, y[n])
            self.sign = np.full(n, 1.0 if self._local(start, y)[0] >= 0 else -1.0)
        events = self._events(faint)
        while stop - start > tiny:
            options = {"method": "DOP853", "rtol": self.rtol, "atol": self.atol}
            longest = (stop - self.start) / (24 if self.fine else 6)
            out = solve_ivp(self._rate, (start, stop), y, events=events, max_step=longest, **options)
            if out.status < 0:
                raise NotFoundError(out.message)
            turned = np.array([len(t) > 0 for t in out.t_events]) & (out.status == 1)
            if np.any(turned) and self.fine:  # the event's state is interpolated: integrate up to there instead
                out = solve_ivp(self._rate, (start, out.t[-1]), y, max_step=longest, **options)
            start, y = out.t[-1], out.y[:, -1].copy()
            local = [self._local(s, z) for s, z in zip(out.t, out.y.T, strict=True)] if self.fine else []
            if self.fine:
                self.rows.append((out.t, out.y[n], np.array([x[0] for x in local]), out.y[n + 1 : n + 3].T))
            psi = self._local(start, y)[-1]
            y[:n] = self._wrap(psi) if self.exact else y[:n]
            self.wrap0, self.psi0 = y[:n].copy(), psi
            if np.any(turned):
                self.turning_points.append(start)
                self.sign = self.sign * np.where(turned, -1.0, 1.0)
        return y, self.psi0

    def _choose_signs(self, turn: Callable, slack: float) -> None:
        """The signs of the tendons' turning that lead to turns of these signs."""
        for signs in product((1.0, -1.0), repeat=self.n):
            self.sign = np.array(signs)
            if np.all((self.sign * turn() >= -slack) | ~self.present):
                return
        raise NotFoundError("no way for the tendons to turn at the start of a piece")

    def _events(self, faint: float) -> list[Callable]:
        """Zeros of the turning rates, a little late: sign * rate = -faint. What that changes is of second order."""

        def event(i):
            def rate(s, y):
                if not self.present[i] and self.slanted:
                    return 1.0
                turning = self._turning(s, y)[i] if self.slanted else self._local(s, y)[0]
                return self.sign[i] * turning + faint

            vars(rate).update(terminal=True, direction=-1)
            return rate

        return [event(i) for i in range(self.n if self.slanted else 1)]

    def _inside(self, s: float) -> float:
        span = 1e-13 * self.body.length
        return min(max(s, self.start + span), self.stop - span)

    def _section(self, s: float) -> tuple[float, np.ndarray, np.ndarray]:
        body, s = self.body, self._inside(s)
        d = np.array([offset(s) for offset in body.offsets])
        slope = np.zeros(self.n) if body.slopes is None else np.array([f(s) for f in body.slopes])
        return body.youngs_modulus * body.second_moment(s), d, slope

    def _wrap(self, psi: np.ndarray) -> np.ndarray:
        if self.psi0 is None:
            return self.wrap0
        return self.wrap0 + np.where(self.present, self.sign * (psi - self.psi0), 0.0)

    def _local(self, s: float, y: np.ndarray) -> tuple:
        """Kappa from the local balance of moments; then q, d', psi."""
        n, side = self.n, self.side
        EJ, d, slope = self._section(s)
        phi, moment, pull = y[n], y[n + 3], np.where(self.present, self.base, 0.0)
        if not self.exact:
            T = pull * np.exp(-self.gain * y[:n])
            kappa = (np.sum(side * d * T) + moment) / (EJ + np.sum(T * d**2))
            return kappa, 1 - side * d * kappa, slope, np.full(n, phi)
        if not self.slanted:
            psi = np.full(n, phi)
            kappa = (np.sum(side * d * pull * np.exp(-self.gain * self._wrap(psi))) + moment) / EJ
            return kappa, 1 - side * d * kappa, slope, psi
        kappa = self.kappa
        for _ in range(50):
            q = 1 - side * d * kappa
            size = np.hypot(q, slope)
            psi = phi + np.arctan2(side * slope, q)
            T = pull * np.exp(-self.gain * self._wrap(psi))
            turn = 0.0 if self.psi0 is None else d * slope / size**2  # dpsi/dkappa
            # derivative of sum sigma d T q / size with respect to kappa
            rise = -np.sum(T * d**2 * slope**2 / size**3) - np.sum(
                self.gain * self.sign * turn * side * d * T * q / size
            )
            change = (np.sum(side * d * T * q / size) + moment - EJ * kappa) / (EJ - rise)
            kappa += change
            if abs(change) < 1e-10 * (abs(kappa) + 1 / self.body.length):  # the next one would be round-off
                break
        else:
            raise NotFoundError("no curvature balances the section")
        self.kappa = kappa
        q = 1 - side * d * kappa
        return kappa, q, slope, phi + np.arctan2(side * slope, q)

    def _turning(self, s: float, y: np.ndarray) -> np.ndarray:
        """The rates psi' of slanted tendons by central differences along the path; only to find where they vanish."""
        h = 1e-5 * (self.stop - self.start)
        middle, rate = min(max(s, self.start + h), self.stop - h), self._rate(s, y)
        ahead, behind = (self._local(x, y + (x - s) * rate)[-1] for x in (middle + h, middle - h))
        return (ahead - behind) / (2 * h)

    def _rate(self, s: float, y: np.ndarray) -> np.ndarray:
        n = self.n
        kappa, q, slope, _ = self._local(s, y)
        c, sn = np.cos(y[n]), np.sin(y[n])
        nx, ny = self.force + self.gravity * (self.total_mass - y[n + 4])
        wrap = np.where(self.present, self.sign * kappa / q, 0.0) if not self.exact else np.zeros(n)
        shorter = np.where(self.present, np.sqrt(1 + slope**2) - np.sqrt(q**2 + slope**2), 0.0)
        weight = self.density * _area(self.body, self._inside(s)) if self.density else 0.0
        return np.concatenate([wrap, [kappa, c, sn, -(c * ny - sn * nx), weight], shorter])


# --- textbook ------------------------------------------------------------------------------------


def elastica_tip(alpha: float) -> tuple[float, float, float]:
    """Uniform cantilever, transverse dead force F at its tip, alpha = F L^2 / (E J): (x/L, y/L, tip angle).

    Bisshopp and Drucker, Quarterly of Applied Mathematics 3 (1945) 272: with k^2 = (1 + sin phi_L) / 2
    and sin a = 1 / (k sqrt 2), sqrt(alpha) = K(k) - F(a, k), y/L = 1 - 2 (E(k) - E(a, k)) / sqrt(alpha)
    and x/L = sqrt(2 sin(phi_L) / alpha).
    """
    root = np.sqrt(abs(alpha))

    def parts(phi):
        m = (1 + np.sin(phi)) / 2
        return m, np.arcsin(1 / np.sqrt(2 * m))

    def surplus(phi):
        m, a = parts(phi)
        return ellipk(m) - ellipkinc(a, m) - root

    angle = root_of(surplus, 1e-9, np.pi / 2 - 1e-7, xtol=1e-15, rtol=1e-15)
    m, a = parts(angle)
    y = 1 - 2 * (ellipe(m) - ellipeinc(a, m)) / root
    return np.sqrt(2 * np.sin(angle)) / root, np.sign(alpha) * y, np.sign(alpha) * angle
