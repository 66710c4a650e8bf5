"""Bodies for the tests, and what SciPy makes of them without a line of the library's mechanics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import cddf_jax as cddf

# design.md section 3: the paper's manipulator, Liu et al. (2020), section IV
PAPER = {
    "length": 0.14,
    "outer_radius": (0.020, 0.013),
    "inner_radius": 0.007,
    "tendon_offset": 0.010,
    "youngs_modulus": 1.4e6,
    "friction_coefficient": 0.42,
}


# for tests that compile for either kinematics, and say much the same of both
one_kinematics_at_once = pytest.mark.parametrize(
    "kinematics", ["exact", pytest.param("published", marks=pytest.mark.slow)]
)


def paper_body(kinematics: str = "published", **changes: Any) -> cddf.Manipulator:
    return cddf.conical(**{**PAPER, "kinematics": kinematics, **changes})


def two_slanted_tendons(kinematics: str = "exact", **changes: Any) -> cddf.Manipulator:
    """Tapering offsets on both sides, 12 to 9 mm."""
    return paper_body(kinematics, tendon_offset=(0.012, 0.009), num_tendons=2, **changes)


def stack(bodies: Sequence[Any]) -> Any:
    """Lanes for `vmap`: the numbers of several equal trees, one after the other."""
    return jax.tree.map(lambda *numbers: jnp.stack([jnp.asarray(x) for x in numbers]), *bodies)


# compiled: `Equilibrium.at` outside jit dispatches one operation after the other
fields_at = eqx.filter_jit(lambda solution, arc_length: solution.at(arc_length))


def lane(batch: Any, i: int) -> Any:
    return jax.tree.map(lambda x: x[i], batch)


def codes(result: cddf.RESULTS) -> list[int]:
    """The result codes of a batch as plain numbers."""
    return np.ravel(result._value).tolist()


def code(result: cddf.RESULTS) -> int:
    return int(result._value)


def replaced(body: cddf.Manipulator, **numbers: Any) -> cddf.Manipulator:
    return eqx.tree_at(
        lambda body: [getattr(body, name) for name in numbers], body, [jnp.asarray(x, float) for x in numbers.values()]
    )


def both_modes(function: Callable) -> Callable:
    """Value, forward and reverse derivative of a function of a vector, compiled together."""

    def with_value(p):
        value = function(p)
        return value, value

    @jax.jit
    def derivatives(p):
        forward, value = jax.jacfwd(with_value, has_aux=True)(p)
        return value, forward, jax.jacrev(function)(p)

    return derivatives


def twice(function: Callable) -> Callable:
    """The same, and the second derivative: reverse mode, and all of that in forward mode."""

    def with_value(p):
        value = function(p)
        return value, value

    def reverse(p):
        both = jax.jacrev(with_value, has_aux=True)(p)
        return both, both

    @jax.jit
    def derivatives(p):
        (second, forward), (reversed_, value) = jax.jacfwd(reverse, has_aux=True)(p)
        return value, forward, reversed_, second

    return derivatives


# --- random bodies -------------------------------------------------------------------------------


class Draw(NamedTuple):
    """A conical body and a tension: numbers, or arrays of lanes."""

    length: Any
    outer_radius: Any  # base, m
    inner_radius: Any  # base, m
    offset: Any  # published: base, m; exact: constant, m
    taper: Any  # tip radius over base radius
    youngs_modulus: Any
    friction_coefficient: Any
    base_tension: Any


def body_of(draw: Draw, kinematics: str) -> cddf.Manipulator:
    def both_ends(x):
        return jnp.stack([jnp.asarray(x), draw.taper * x])

    return cddf.conical(
        length=draw.length,
        outer_radius=both_ends(draw.outer_radius),
        inner_radius=both_ends(draw.inner_radius),
        tendon_offset=both_ends(draw.offset) if kinematics == "published" else draw.offset,
        youngs_modulus=draw.youngs_modulus,
        friction_coefficient=draw.friction_coefficient,
        kinematics=kinematics,
    )


def plain_of(draw: Draw, kinematics: str) -> "PlainBody":
    def tapered(x):
        return lambda s: x * (1 + (draw.taper - 1) * s / draw.length)

    offset = tapered(draw.offset) if kinematics == "published" else lambda s: draw.offset
    return PlainBody(
        draw.length,
        tapered(draw.outer_radius),
        tapered(draw.inner_radius),
        [offset],
        draw.youngs_modulus,
        [draw.friction_coefficient],
        kinematics,
    )


# each number between 0 and 1: taper, bore, offset in the wall, slenderness, size, modulus, loss, wrap
UNIT_CUBE = st.tuples(*[st.floats(0.0, 1.0, allow_subnormal=False)] * 8)


def draw_from(unit: Sequence[float], kinematics: str, d_kappa: float = 0.95) -> Draw:
    """A body as section 3 of issue 2 wants them.

    Taper ratio 0.3 to 1, tension loss up to 80 %, wrap angle of the tendon up to 180 degrees (which
    in the published kinematics exceeds the tip angle), d kappa up to `d_kappa`.
    """
    taper, bore, place, slenderness, size, modulus, loss, wrap = unit
    taper, bore = 0.3 + 0.7 * taper, 0.8 * bore
    outer = 10 ** (-3 + 2.5 * size)
    offset = outer * (bore + (0.99 - bore) * place) + 0.02 * outer * (place < 0.02)
    loss, youngs_modulus = 0.002 + 0.798 * loss, 10 ** (4 + 7 * modulus)
    # the loss is 1 - exp(-mu wrap), the wrap between 3 (or what mu = 2 needs) and 180 degrees
    mu_wrap = -np.log1p(-loss)
    least = max(np.radians(3.0), mu_wrap / 2)
    total = least + (np.pi - least) * wrap
    friction = mu_wrap / total
    if kinematics == "exact":
        offset *= taper
    # compliance and curvature per length, so that the length can keep d kappa below 0.95
    x = np.linspace(0, 1, 401)
    shrink = 1 + (taper - 1) * x
    d = offset * (shrink if kinematics == "published" else np.ones_like(x))
    J = np.pi / 4 * outer**4 * (1 - bore**4) * shrink**4
    G = np.concatenate([[0], np.cumsum((d[1:] / J[1:] + d[:-1] / J[:-1]) / 2 * np.diff(x))])
    rising = np.expm1(mu_wrap) / G[-1]
    d_kappa_times_length = np.max(d * rising * d / J / (friction * (1 + rising * G)))
    bound = (
        d_kappa if kinematics == "exact" else d_kappa / (1 - d_kappa)
    )  # published: kappa = kappa_c / (1 + d kappa_c)
    length = max(2 * outer * (1 + 19 * slenderness), d_kappa_times_length / bound)
    tension = rising / length * youngs_modulus / friction
    return Draw(length, outer, bore * outer, offset, taper, youngs_modulus, friction, tension)


def draws(kinematics: str, d_kappa: float = 0.95) -> st.SearchStrategy[Draw]:
    return UNIT_CUBE.map(lambda unit: draw_from(unit, kinematics, d_kappa))


def random_draws(kinematics: str, count: int, seed: int) -> list[Draw]:
    rng = np.random.default_rng(seed)
    return [draw_from(unit, kinematics) for unit in rng.random((count, 8))]


# --- an independent solution ---------------------------------------------------------------------


def constant(value: float) -> Callable:
    return lambda s: value


def straight(base: float, tip: float, length: float) -> Callable:
    return lambda s: base + (tip - base) * s / length


@dataclass
class PlainBody:
    """A manipulator in plain floats and functions. Tendon i lies on side sides[i]."""

    length: float
    outer_radius: Callable
    inner_radius: Callable
    offsets: list[Callable]
    youngs_modulus: float
    friction: list[float]
    kinematics: str
    sides: Sequence[int] = (+1,)
    slopes: list[Callable] | None = None  # d'; None where every offset is constant or irrelevant
    ends: Sequence[float] = ()  # anchors; empty for all at the tip
    breaks: Sequence[float] = ()  # where the body is not smooth

    def second_moment(self, s: float) -> float:
        return np.pi / 4 * (self.outer_radius(s) ** 4 - self.inner_radius(s) ** 4)

    def compliance(self, s: float) -> float:
        """G(s) of design.md section 3, by adaptive quadrature."""
        return quad(lambda x: self.offsets[0](x) / self.second_moment(x), 0, s, epsabs=0, epsrel=1e-13, limit=200)[0]

    def closed_form(self, base_tension: float, s: float) -> float:
        """T(s) of one tendon that slides in, design.md section 3."""
        return base_tension / (1 + self.friction[0] / self.youngs_modulus * base_tension * self.compliance(s))


def paper_plain(kinematics: str = "published", sides: Sequence[int] = (+1,), **changes: Any) -> PlainBody:
    count, length = len(sides), PAPER["length"]
    fields = {
        "length": length,
        "outer_radius": straight(0.020, 0.013, length),
        "inner_radius": constant(0.007),
        "offsets": [constant(0.010)] * count,
        "youngs_modulus": 1.4e6,
        "friction": [0.42] * count,
        "kinematics": kinematics,
        "sides": sides,
    }
    return PlainBody(**{**fields, **changes})


class Reference(NamedTuple):
    tip_tension: np.ndarray  # at its anchor where a tendon ends before the tip
    wrap_angle: np.ndarray
    tip_angle: float
    tip_position: np.ndarray
    displacement: np.ndarray
    arc_length: np.ndarray  # where the integrator stepped
    heading: np.ndarray
    position: np.ndarray


def reference_solution(body: PlainBody, base_tension: Any, direction: Any = +1) -> Reference:
    """Integrate heading and wrap angles from the base with DOP853, relative tolerance 1e-12."""
    return _Integration(body, base_tension, direction).run()


class _Integration:
    """An initial-value problem for (wrap angles, heading, position, displacements), restarted at every break.

    Slanted tendons in the exact kinematics need no theta': while tendon i turns one way, its wrap
    angle is that at the start of the piece plus |psi_i(s) - psi_i(start)|, and psi_i follows from
    heading and curvature alone. So the state is the heading, and the curvature the root of the local
    moment balance in which psi_i enters both the tension and the arm.
    """

    def __init__(self, body: PlainBody, base_tension: Any, direction: Any):
        count = len(body.sides)
        self.body, self.count = body, count
        self.base = np.broadcast_to(np.asarray(base_tension, float), count)
        self.direction = np.broadcast_to(np.asarray(direction, float), count)
        self.gain = self.direction * np.asarray(body.friction)
        self.side = np.asarray(body.sides, float)
        self.ends = np.asarray(body.ends if len(body.ends) else [np.inf] * count, float)
        self.by_angle = body.kinematics == "exact" and body.slopes is not None
        self.kappa = 0.0

    def run(self) -> Reference:
        body, n = self.body, self.count
        stops = sorted({0.0, body.length, *body.breaks, *(end for end in self.ends if end < body.length)})
        y, psi, rows = np.zeros(2 * n + 3), None, []
        for start, stop in pairwise(stops):
            y, psi, row = self._piece(y, psi, start, stop)
            rows.append(row)
        s, values = np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
        tension = self.base * np.exp(-self.gain * y[:n])
        return Reference(tension, y[:n], y[n], y[n + 1 : n + 3], y[n + 3 :], s, values[:, n], values[:, n + 1 : n + 3])

    def _piece(self, y, psi_before, start, stop):
        span = 1e-13 * self.body.length
        self.inside = lambda s: min(max(s, start + span), stop - span)
        n, present = self.count, self.ends >= stop
        self.present = present
        y = y.copy()
        if self.by_angle:
            if psi_before is not None:
                y[:n] = self._turn(start, y, psi_before)
            return self._by_angle(y, start, stop)
        out = solve_ivp(self._rate, (start, stop), y, method="DOP853", rtol=1e-12, atol=1e-14)
        return out.y[:, -1], np.zeros(n), (out.t, out.y.T)

    # geometry at one arc length

    def _section(self, s):
        s = self.inside(s)
        body = self.body
        d = np.array([offset(s) for offset in body.offsets])
        slope = np.zeros(self.count) if body.slopes is None else np.array([f(s) for f in body.slopes])
        return body.youngs_modulus * body.second_moment(s), d, slope

    def _shortening(self, d, slope, kappa):
        rate = np.sqrt(1 + slope**2) - np.sqrt((1 - self.side * d * kappa) ** 2 + slope**2)
        return np.where(self.present, rate, 0.0)

    def _rate(self, s, y):
        """theta', phi', u', displacement' where theta' needs no kappa'."""
        n = self.count
        EJ, d, slope = self._section(s)
        T = np.where(self.present, self.base * np.exp(-self.gain * y[:n]), 0.0)
        if self.body.kinematics == "published":
            kappa = np.sum(self.side * d * T) / (EJ + np.sum(T * d**2))
            turning = np.abs(kappa / (1 - self.side * d * kappa))
        else:
            kappa = np.sum(self.side * d * T) / EJ
            turning = np.full(n, np.abs(kappa))
        turning = np.where(self.present, turning, 0.0)
        return np.concatenate([turning, [kappa, np.cos(y[n]), np.sin(y[n])], self._shortening(d, slope, kappa)])

    def _psi(self, d, slope, kappa, heading):
        return heading + np.arctan2(self.side * slope, 1 - self.side * d * kappa)

    def _balance(self, s, heading, wrap_of):
        """Kappa from E J kappa = sum sigma d T q / sqrt(q^2 + d'^2), T from the wrap angle that psi implies."""
        EJ, d, slope = self._section(s)

        def residual(kappa):
            wrap = wrap_of(self._psi(d, slope, kappa, heading))
            T = np.where(self.present, self.base * np.exp(-self.gain * wrap), 0.0)
            q = 1 - self.side * d * kappa
            return EJ * kappa - np.sum(self.side * d * T * q / np.hypot(q, slope))

        # the root next to the last one: away from it a trial angle may stand for any tension
        centre, half = self.kappa, 1e-3 * np.sum(d * self.base) / EJ + 1e-9 / self.body.length
        while residual(centre - half) > 0 or residual(centre + half) < 0:
            half *= 2
        self.kappa = brentq(residual, centre - half, centre + half, xtol=1e-14, rtol=1e-14)
        return self.kappa, d, slope

    def _turn(self, s, y, psi_before):
        n, before = self.count, y[: self.count].copy()

        def wrap_of(psi):
            return before + np.where(self.present, np.abs(psi - psi_before), 0.0)

        kappa, d, slope = self._balance(s, y[n], wrap_of)
        return wrap_of(self._psi(d, slope, kappa, y[n]))

    def _by_angle(self, y, start, stop):
        n = self.count
        kappa, d, slope = self._balance(start, y[n], lambda psi: y[:n])
        psi_start = self._psi(d, slope, kappa, y[n])
        sign = np.ones(n)
        for _ in range(3):
            out, psi = self._integrate_by_angle(y, start, stop, psi_start, sign)
            turned = np.sign(psi[-1] - psi_start)
            if np.all((turned == sign) | ~self.present):
                break
            sign = np.where(self.present, turned, sign)
        steps = np.diff(psi, axis=0) * sign
        assert np.all(steps[:, self.present] > -1e-11), "a tendon turns back inside a smooth piece: add a break"
        wrap = y[:n] + np.where(self.present, sign * (psi[-1] - psi_start), 0.0)
        rows = np.concatenate([np.zeros((len(out.t), n)), out.y.T], axis=1)
        return np.concatenate([wrap, out.y[:, -1]]), psi[-1], (out.t, rows)

    def _integrate_by_angle(self, y, start, stop, psi_start, sign):
        n = self.count

        def wrap_of(psi):
            return y[:n] + np.where(self.present, sign * (psi - psi_start), 0.0)

        def rate(s, z):
            kappa, d, slope = self._balance(s, z[0], wrap_of)
            return np.concatenate([[kappa, np.cos(z[0]), np.sin(z[0])], self._shortening(d, slope, kappa)])

        def psi_at(s, heading):
            kappa, d, slope = self._balance(s, heading, wrap_of)
            return self._psi(d, slope, kappa, heading)

        out = solve_ivp(rate, (start, stop), y[n:], method="DOP853", rtol=1e-12, atol=1e-14)
        return out, np.array([psi_at(s, heading) for s, heading in zip(out.t, out.y[0], strict=True)])
