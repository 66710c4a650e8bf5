"""Searches that begin where the objective has no slope: a bore of radius 0, no tension.

A solid rod with a tendon outside, exact kinematics (docs/theory.md, (13) and (16)): to turn the tip by phi it takes
T = E (exp(mu phi) - 1) / (mu d H), H = int_0^L ds / J, and J = pi / 4 (R^4 - r^4) has no slope at r = 0.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

import cddf_jax as cddf

L, OFFSET, E, MU, ANGLE = 0.2, 6e-3, 2e9, 0.2, np.pi / 4
OUTER, WALL = (2.2e-3, 1.8e-3), 0.5e-3
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
S, SHARES = (NODES + 1) / 2 * L, WEIGHTS / 2 * L
OUTSIDE = {"offsets_outside_wall": True, "nodes": 8}
START, AWAY = (0.0, 0.0), (0.2e-3, 0.2e-3)  # radii of the bore at base and tip


def second_moment(base, tip):
    radii = [ends[0] + (ends[1] - ends[0]) * S / L for ends in (OUTER, (base, tip))]
    return np.pi / 4 * (radii[0] ** 4 - radii[1] ** 4)


def tension(base, tip):
    return E * np.expm1(MU * ANGLE) / (MU * OFFSET * (SHARES @ (1 / second_moment(base, tip))))


def plain_sag(base, tip):
    """Of the tip per newton across the straight rod, int (L - s)^2 / (E J) ds."""
    return SHARES @ ((L - S) ** 2 / second_moment(base, tip)) / E


def plain_volume(base, tip):
    """Of a frustum with a bore that is one."""
    return np.pi * L / 3 * (sum(R**2 for R in OUTER) + np.prod(OUTER) - base**2 - base * tip - tip**2)


SOLID = float(plain_sag(*START))


def sag(body, equilibrium):
    return jnp.sum(SHARES * (L - S) ** 2 / body.stiffness(S))


def rod(bore):
    inner = cddf.Linear(*bore, length=L)
    outer = cddf.Linear(*OUTER, L)
    options: dict[str, Any] = {"youngs_modulus": E, "friction_coefficient": MU}
    return cddf.Manipulator(length=L, outer_radius=outer, inner_radius=inner, tendons=(cddf.Tendon(OFFSET),), **options)


def bored(bore, most_sag, most_volume=1.0):
    """The least tension for the angle, the bore free from 0 on."""
    return cddf.design(
        rod(bore),
        cddf.Least("base_tension"),
        free=("inner_radius",),
        bounds={"inner_radius": (0.0, 1.6e-3)},
        constraints=[
            cddf.Limit("wall_thickness", least=WALL),
            cddf.Limit(sag, most=most_sag),
            cddf.Limit("volume", most=most_volume * plain_volume(*START)),
        ],
        cases=cddf.LoadCase(cddf.TipAngle(ANGLE)),
        **OUTSIDE,
    )


@pytest.mark.parametrize("bore", [START, AWAY])
def test_a_bore_grows_from_nothing_to_the_best(bore):
    """Against SciPy on the closed form, which begins far from 0. The sag holds the base back, the wall the tip."""
    found = bored(bore, 1.1 * SOLID)
    limits = [
        {"type": "ineq", "fun": lambda x: 1.1 - plain_sag(*(1e-3 * x)) / SOLID},
        {"type": "ineq", "fun": lambda x: 1e3 * (np.array(OUTER) - WALL) - x},
    ]
    start, bounds = np.array([0.8, 0.8]), [(0.0, 1.6)] * 2
    best = minimize(lambda x: tension(*(1e-3 * x)), start, bounds=bounds, constraints=limits, options={"ftol": 1e-12})
    assert best.success
    assert found.success, found.result
    assert found.objective == pytest.approx(best.fun, rel=1e-6)
    assert np.array(list(found.value.values())) == pytest.approx(1e-3 * best.x, rel=1e-5)
    assert found.objectives[0].start == pytest.approx(tension(*bore), rel=1e-8)
    assert len(found.starts) == (2 if bore == START else 1)
    assert ("Of 2 searches " in str(found)) == (bore == START)


def test_a_limit_that_only_a_bore_keeps():
    """The volume has no slope at a bore of 0 either: a solid rod breaks the limit, and is not the last word."""
    found = bored(START, 2 * SOLID, 0.9)
    assert found.success, found.result
    assert found.blocking == ()
    assert plain_volume(*found.value.values()) <= 0.9 * plain_volume(*START) * (1 + 1e-6)


def test_a_bore_of_nothing_that_is_the_best():
    """The sag allows no bore. The bounds of 0 have no price."""
    found = bored(START, SOLID * (1 + 1e-9))
    assert found.success, found.result
    assert list(found.value.values()) == list(START)
    for number in found.free.values():
        assert number.status == "at lower bound"
        assert number.multiplier == 0.0
    assert len(found.starts) == 2


@pytest.mark.slow
def test_a_tension_grows_from_nothing_to_the_best():
    """The straight body's tip is farthest out, whichever way it bends; T of the angle that is allowed, 0.5 rad."""
    found = cddf.design(
        rod(START),
        cddf.Least("tip_x"),
        free=("base_tension",),
        bounds={"base_tension": (0.0, 20.0)},
        constraints=[cddf.Limit("tip_angle", most=0.5)],
        cases=cddf.LoadCase(0.0),
        **OUTSIDE,
    )
    assert found.success, found.result
    wanted = E * np.expm1(MU * 0.5) / (MU * OFFSET * (SHARES @ (1 / second_moment(*START))))
    assert found.value["base_tension"] == pytest.approx(wanted, rel=1e-6)
