"""Bodies for the tests, and the same bodies in plain numbers for SciPy, see loaded_bodies.py."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import quad

import cddf_jax as cddf

# docs/theory.md (16): the paper's manipulator, Liu et al. (2020), section IV
PAPER = {
    "length": 0.14,
    "outer_radius": (0.020, 0.013),
    "inner_radius": 0.007,
    "tendon_offset": 0.010,
    "youngs_modulus": 1.4e6,
    "friction_coefficient": 0.42,
}


# a slender rod, so that a curl stays clear of its own offset
ROD = {
    "length": 0.2,
    "outer_radius": (0.004, 0.004),
    "inner_radius": 0.0,
    "tendon_offset": 0.002,
    "youngs_modulus": 1e6,
    "friction_coefficient": 0.3,
}
RIGIDITY = 1e6 * np.pi / 4 * 0.004**4  # E J of the rod, N m^2


# for tests that compile for either kinematics, and say much the same of both
one_kinematics_at_once = pytest.mark.parametrize(
    "kinematics", ["exact", pytest.param("published", marks=pytest.mark.slow)]
)


def paper_body(kinematics: str = "published", **changes: Any) -> cddf.Manipulator:
    return cddf.conical(**{**PAPER, "kinematics": kinematics, **changes})


def paper_with(*tendons: cddf.Tendon, kinematics: str = "exact", **changes: Any) -> cddf.Manipulator:
    """The paper's body with other tendons."""
    return replace(paper_body(kinematics), tendons=tendons, **changes)


def stretching(body: cddf.Manipulator, stiffness: float, free_length: float = 0.0) -> cddf.Manipulator:
    """The body with tendons that stretch: their stiffness E A, N, and their length outside the body, m."""
    tendons = tuple(replace(t, axial_stiffness=stiffness, free_length=free_length) for t in body.tendons)
    return replace(body, tendons=tendons)


def three_tendon_tube() -> cddf.Manipulator:
    """A tube of silicone in space, of 200 mm, with tendons 120 degrees apart; friction 0.3 and 1 MPa."""
    return cddf.Manipulator(
        length=0.2,
        outer_radius=0.0114,
        inner_radius=0.003,
        youngs_modulus=1e6,
        friction_coefficient=0.3,
        tendons=[cddf.Tendon(offset=0.0086, angle=0.11 + k * 2 * np.pi / 3) for k in range(3)],
    )


def two_slanted_tendons(kinematics: str = "exact", **changes: Any) -> cddf.Manipulator:
    """Tapering offsets on both sides, 12 to 9 mm."""
    return paper_body(kinematics, tendon_offset=(0.012, 0.009), num_tendons=2, **changes)


def stack(bodies: Sequence[Any]) -> Any:
    """Lanes for `vmap`: the numbers of several equal trees, one after the other."""
    return jax.tree.map(lambda *numbers: jnp.stack([jnp.asarray(x) for x in numbers]), *bodies)


def lane(batch: Any, i: int) -> Any:
    return jax.tree.map(lambda x: x[i], batch)


def codes(status: jax.Array) -> list[int]:
    """The statuses of a batch as plain numbers."""
    return np.ravel(status).tolist()


def replaced(body: cddf.Manipulator, **numbers: Any) -> cddf.Manipulator:
    return eqx.tree_at(
        lambda body: [getattr(body, name) for name in numbers], body, [jnp.asarray(x, float) for x in numbers.values()]
    )


def both_modes(function: Callable) -> Callable:
    """Value, forward and reverse derivative of a function of a vector, traced once and compiled together.

    Reverse mode is what `vjp` does: the linear map of forward mode, transposed.
    """

    @jax.jit
    def derivatives(p):
        value, along = jax.linearize(function, p)
        basis = jnp.eye(value.size).reshape(*value.shape, *value.shape)
        back = jax.linear_transpose(along, p)
        for _ in value.shape:
            back = jax.vmap(back)
        return value, jax.vmap(along, out_axes=-1)(jnp.eye(p.size)), back(basis)[0]

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


def body_of(draw: Draw, kinematics: Any) -> cddf.Manipulator:
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


def draw_from(unit: Sequence[float], kinematics: str) -> Draw:
    """A body as section 3 of issue 2 wants them.

    Taper ratio 0.3 to 1, tension loss up to 80 %, wrap angle of the tendon up to 180 degrees (which
    in the published kinematics exceeds the tip angle), d kappa up to 0.95.
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
    bound = 0.95 if kinematics == "exact" else 0.95 / (1 - 0.95)  # published: kappa = kappa_c / (1 + d kappa_c)
    length = max(2 * outer * (1 + 19 * slenderness), d_kappa_times_length / bound)
    tension = rising / length * youngs_modulus / friction
    return Draw(length, outer, bore * outer, offset, taper, youngs_modulus, friction, tension)


def random_draws(kinematics: str, count: int, seed: int) -> list[Draw]:
    rng = np.random.default_rng(seed)
    return [draw_from(unit, kinematics) for unit in rng.random((count, 8))]


# --- the same in plain numbers -------------------------------------------------------------------


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
        """G(s) of docs/theory.md (16), by adaptive quadrature."""
        return quad(lambda x: self.offsets[0](x) / self.second_moment(x), 0, s, epsabs=0, epsrel=1e-13, limit=200)[0]

    def closed_form(self, base_tension: float, s: float) -> float:
        """T(s) of one tendon that slides in, docs/theory.md (16)."""
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
