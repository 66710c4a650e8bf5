"""Loads at any arc length: against SciPy's integration of the elastica with capstan friction, and loads at the tip."""

from typing import Any

import jax
import numpy as np
import pytest
from bodies import both_modes
from kinds import root_of
from refusals import refused
from scipy.integrate import solve_ivp

import cddf_jax as cddf

LENGTH, OUTER, INNER, OFFSET, E, MU = 0.2, 0.0114, 0.003, 0.008, 1e6, 0.3
TENSION, PLACE, FORCE, MOMENT = (5.0, 1.0), 0.083, (0.02, -0.15), 0.004
QUICK = {"nodes": 4, "short_steps": 2, "estimate_error": False, "throw": False}
POINT = cddf.Loads(points=[cddf.PointLoad(PLACE, FORCE, MOMENT)])


def pair(in_space=False):
    """A tube with a tendon on either side."""
    sides: list[dict[str, Any]] = [{"angle": 0.0}, {"angle": np.pi}] if in_space else [{"side": 1}, {"side": -1}]
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=OUTER,
        inner_radius=INNER,
        youngs_modulus=E,
        friction_coefficient=MU,
        tendons=[cddf.Tendon(offset=OFFSET, **side) for side in sides],
    )


def by_scipy(direction):
    """X, Y, phi and both tensions at the tip: shooting for the moment at the base, with a jump of M at the load."""
    stiffness = E * np.pi / 4 * (OUTER**4 - INNER**4)

    def rate(_, y, force):
        _, _, phi, first, second, moment = y
        kappa = (moment + OFFSET * (first - second)) / stiffness
        lost = MU * abs(kappa) * np.array(direction) * [first, second]
        return [np.cos(phi), np.sin(phi), kappa, *-lost, np.sin(phi) * force[0] - np.cos(phi) * force[1]]

    def tip(base_moment):
        y = np.array([0.0, 0.0, 0.0, *TENSION, base_moment])
        for start, end, force in ((0.0, PLACE, FORCE), (PLACE, LENGTH, (0.0, 0.0))):
            y = solve_ivp(rate, (start, end), y, args=(force,), rtol=1e-11, atol=1e-13).y[:, -1]
            y[5] -= MOMENT if end == PLACE else 0.0
        return y

    return tip(root_of(lambda moment: tip(moment)[5], -0.2, 0.2, xtol=1e-14))[:5]


@pytest.mark.parametrize("in_space", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_force_and_a_moment_at_a_place(in_space):
    found = cddf.solve(pair(in_space), TENSION, POINT, direction=(1, 1))
    x, y, phi, *tensions = by_scipy((1, 1))
    np.testing.assert_allclose(found.tip_position[:2], [x, y], atol=1e-9)
    np.testing.assert_allclose(found.tip_tension, tensions, rtol=1e-8)
    if not in_space:
        np.testing.assert_allclose(found.tip_angle, phi, rtol=1e-8)


@pytest.mark.slow
def test_a_path_ends_where_solve_does():
    """Both tendons keep their direction while tensions and load grow, so that the answer is that without history."""
    half = cddf.Loads(points=[cddf.PointLoad(PLACE, np.multiply(0.5, FORCE), 0.5 * MOMENT)])
    found = cddf.trace(pair(), [[2.5, 0.5], TENSION], [half, POINT], short_steps=16)
    x, y, phi, *tensions = by_scipy((1, -1))
    np.testing.assert_allclose(found.tip_position[-1], [x, y], atol=1e-6)
    np.testing.assert_allclose(found.tip_angle[-1], phi, atol=1e-5)
    np.testing.assert_allclose(found.tip_tension[-1], tensions, atol=1e-5)
    balance = found.energies.work - found.energies.friction_loss - found.energies.stored_energy
    np.testing.assert_allclose(balance, 0.0, atol=1e-4 * float(found.energies.work[-1]))


def test_at_the_tip_it_is_a_load_on_the_tip():
    at_tip = cddf.Loads(points=[cddf.PointLoad(LENGTH, FORCE, MOMENT)])
    one, other = (cddf.solve(pair(), TENSION, each, direction=(1, 1)) for each in (at_tip, cddf.Loads(FORCE, MOMENT)))
    np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=1e-12)
    np.testing.assert_allclose(one.base_moment, other.base_moment, rtol=1e-12)


@pytest.mark.slow
def test_derivatives_by_place_force_and_moment():
    """Both modes against central differences."""

    def tip(numbers):
        place, force, moment = numbers
        loads = cddf.Loads(points=[cddf.PointLoad(place, (0.0, force), moment)])
        return cddf.solve(pair(), TENSION, loads, direction=(1, 1), throw=False).tip_position[1:]

    at, step = np.array([PLACE, FORCE[1], MOMENT]), np.array([1e-5, 1e-4, 1e-5])
    derivatives = both_modes(tip)
    _, *modes = derivatives(at)
    ends = [[derivatives(at + sign * h)[0][0] for sign in (+1, -1)] for h in np.diag(step)]
    differences = [(ahead - behind) / (2 * h) for (ahead, behind), h in zip(ends, step, strict=True)]
    for mode in modes:
        np.testing.assert_allclose(mode[0], differences, rtol=1e-6)


def test_a_lane_whose_load_is_beside_the_body():
    @jax.vmap
    def status(place):
        loads = cddf.Loads(points=[cddf.PointLoad(place, FORCE)])
        return cddf.solve(pair(), TENSION, loads, direction=(1, 1), throw=False).status

    found = status(np.array([PLACE, 0.3, 0.1]))
    np.testing.assert_array_equal(found == cddf.Status.unphysical, [False, True, False])


REFUSED = [
    (lambda: cddf.PointLoad(0.1, (1.0,)), "PointLoad: force must have two or three components"),
    (lambda: cddf.Loads(points=[0.1]), "must hold PointLoad"),  # pyright: ignore[reportArgumentType]
    (
        lambda: cddf.solve(pair(), TENSION, cddf.Loads(points=[cddf.PointLoad(0.3, FORCE)])),
        "loads.points.0: arc_length must lie above 0 and up to the tip at 200 mm, got 300 mm; put the load on",
    ),
    (
        lambda: cddf.trace(pair(), [TENSION], cddf.Loads(), start=cddf.trace(pair(), [TENSION], [POINT], **QUICK)),
        "trace: start has point loads at other places; give those that do not act 0 N from rest on",
    ),
    (
        lambda: cddf.trace(pair(), [TENSION, TENSION], [POINT, cddf.Loads()]),
        "all loads of a path must have the same points; give those that do not act 0 N",
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_what_is_refused(make, message):
    assert message in refused(make, error=(TypeError, ValueError))


@pytest.mark.slow
def test_joints_at_one_place_turn_a_tendon_once():
    """A tendon without tension, a joint where nothing changes and a load of nothing at a knot change nothing."""
    body: dict[str, Any] = {"length": LENGTH, "outer_radius": OUTER, "youngs_modulus": E, "friction_coefficient": MU}
    knots = cddf.Piecewise.linear([0.0, 0.1, 0.2], [0.008, 0.005, 0.008])
    one, other = cddf.Tendon(knots), cddf.Tendon(knots, side=-1)
    level = cddf.Piecewise.linear([0.0, 0.1, 0.2], [INNER] * 3)
    alone = cddf.solve(cddf.Manipulator(**body, inner_radius=INNER, tendons=[one]), 5.0).tip_tension[0]
    found = [
        cddf.solve(cddf.Manipulator(**body, inner_radius=INNER, tendons=[one, other]), (5.0, 0.0)).tip_tension[0],
        cddf.solve(cddf.Manipulator(**body, inner_radius=level, tendons=[one]), 5.0).tip_tension[0],
    ]
    np.testing.assert_allclose(found, alone, rtol=1e-9)
    nothing = cddf.Loads(points=[cddf.PointLoad(0.1, (0.0, 0.0))])
    loaded = cddf.solve(cddf.Manipulator(**body, inner_radius=INNER, tendons=[one]), 5.0, nothing)
    np.testing.assert_allclose(loaded.tip_tension, alone, rtol=1e-8)


def test_a_moment_at_the_tip_is_that_on_the_tip():
    """Also for a slanted tendon, which turns with the curvature but rubs on nothing beyond its anchor."""
    tendon = cddf.Tendon(cddf.Linear(0.008, 0.004, LENGTH))
    body = cddf.Manipulator(LENGTH, OUTER, INNER, youngs_modulus=E, friction_coefficient=MU, tendons=[tendon])
    at_place = cddf.Loads(points=[cddf.PointLoad(LENGTH, (0.0, 0.0), 0.01)])
    found = [cddf.solve(body, 5.0, loads).tip_tension[0] for loads in (at_place, cddf.Loads(tip_moment=0.01))]
    np.testing.assert_allclose(*found, rtol=1e-12)
