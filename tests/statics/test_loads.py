"""Dead loads on the tip and gravity, against SciPy (loaded_bodies.py), textbooks, and by symmetry and scaling."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    PAPER,
    RIGIDITY,
    ROD,
    PlainBody,
    both_modes,
    constant,
    paper_body,
    paper_plain,
    straight,
)
from loaded_bodies import (
    PlainLoads,
    elastica_tip,
    largest_difference,
    loaded_reference,
)
from refusals import refused
from scipy.integrate import quad

import cddf_jax as cddf

AGREES = 1e-9  # the reference integrates with a relative tolerance of 1e-11 per step
WITH_KINKS = 1e-7  # what `solve` promises of the length where the curvature changes its sign
TEXTBOOK = 1e-9  # formulas evaluated to round-off; the solver promises 1e-8
ROUNDING = 1e-12  # the same operations in another order
SETTLED = 1e-10  # passes and Newton's method stop at a relative change of 1e-12
LENGTH = PAPER["length"]


# --- textbook ------------------------------------------------------------------------------------


def test_a_tapered_cantilever_under_a_small_force():
    """Castigliano's F int (L - s)^2 / (E J) ds; the rest is of second order in the slope of 1e-4."""
    force = 1e-3
    solution = cddf.solve(paper_body("exact"), 0.0, cddf.Loads(tip_force=(0.0, force)))
    second_moment = paper_plain().second_moment
    expected = force / 1.4e6 * quad(lambda s: (LENGTH - s) ** 2 / second_moment(s), 0, LENGTH, epsrel=1e-13)[0]
    assert 1e-6 < expected / LENGTH < 1e-4
    np.testing.assert_allclose(solution.tip_position[1], expected, rtol=1e-7)
    np.testing.assert_allclose(solution.base_moment, force * LENGTH, rtol=1e-7)


@pytest.mark.parametrize("alpha", [-5.0, 20.0])
def test_the_elastica(alpha):
    """Bisshopp and Drucker (1945): a uniform cantilever under a transverse dead force alpha E J / L^2 at its tip."""
    x, y, angle = elastica_tip(alpha)
    assert alpha < 20 or np.degrees(angle) > 87
    solution = cddf.solve(cddf.conical(**ROD), 0.0, cddf.Loads(tip_force=(0.0, alpha * RIGIDITY / 0.2**2)))
    np.testing.assert_allclose(solution.tip_position / 0.2, [x, y], atol=TEXTBOOK)
    np.testing.assert_allclose(solution.tip_angle, angle, atol=TEXTBOOK)
    # the moment at the base is the force times its reach
    np.testing.assert_allclose(solution.base_moment, alpha * x * RIGIDITY / 0.2, rtol=TEXTBOOK)


@pytest.mark.parametrize("turns", [-0.7, 1.6])
def test_a_tip_moment_makes_a_circle(turns):
    """The curvature m / (E J) everywhere, also more than once around."""
    kappa = 2 * np.pi * turns / 0.2
    solution = cddf.solve(cddf.conical(**ROD), 0.0, cddf.Loads(tip_moment=kappa * RIGIDITY))
    angle = 2 * np.pi * turns
    tip = np.array([np.sin(angle), 1 - np.cos(angle)]) / angle
    np.testing.assert_allclose(solution.tip_position / 0.2, tip, atol=TEXTBOOK)
    np.testing.assert_allclose(solution.heading, kappa * solution.arc_length, atol=TEXTBOOK * abs(angle))
    np.testing.assert_allclose(solution.curvature, kappa, rtol=TEXTBOOK)
    np.testing.assert_allclose(solution.base_moment, kappa * RIGIDITY, rtol=TEXTBOOK)


# --- bodies that are not smooth ------------------------------------------------------------------


@pytest.mark.slow
def test_a_stepped_body_with_a_passive_tip_link():
    """Two tendons of their own offsets and friction end at 100 mm; beyond it the body is passive, under loads."""
    outer = cddf.Piecewise([0.06], [cddf.Constant(0.018), cddf.Constant(0.014)])
    tendons = (
        cddf.Tendon(cddf.Linear(0.011, 0.008, LENGTH), end=0.10, friction_coefficient=0.2),
        cddf.Tendon(cddf.Linear(0.009, 0.010, LENGTH), side=-1, end=0.10, friction_coefficient=0.35),
    )
    body = cddf.Manipulator(LENGTH, outer, 0.007, tendons, 1.4e6, 9.0, density=1100.0)
    plain = paper_plain(
        "exact",
        (+1, -1),
        outer_radius=lambda s: np.where(s < 0.06, 0.018, 0.014),
        offsets=[straight(0.011, 0.008, LENGTH), straight(0.009, 0.010, LENGTH)],
        slopes=[constant(-0.003 / LENGTH), constant(0.001 / LENGTH)],
        friction=[0.2, 0.35],
        ends=(0.10, 0.10),
        breaks=(0.06,),
    )
    loads = PlainLoads((0.3, -2.0), 0.02, (0.0, -9.81))
    solution = cddf.solve(body, (50.0, 10.0), cddf.Loads(*loads), direction=(+1, -1))
    reference = loaded_reference(plain, (50.0, 10.0), loads, 1100.0, (+1, -1))
    assert largest_difference(solution, reference, plain) < AGREES
    beyond = solution.at(jnp.asarray([0.101, 0.13]))
    np.testing.assert_array_equal(beyond.tension, 0.0)
    assert abs(beyond.curvature[0]) > 1.0


# --- limits and symmetries -----------------------------------------------------------------------

PAIR_LOADS = cddf.Loads(tip_force=(-0.5, -1.0), tip_moment=0.03, gravity=(2.0, -9.81))
mirrored = cddf.Loads(tip_force=(-0.5, 1.0), tip_moment=-0.03, gravity=(2.0, 9.81))


def solved_pair(loads: cddf.Loads | None = PAIR_LOADS, tension=(60.0, 15.0), direction=(+1, -1), **changes):
    body = paper_body("exact", num_tendons=2, **{"density": 1070.0, **changes})
    return cddf.solve(body, tension, loads, direction=direction)


def test_loads_of_zero_are_no_loads():
    none = solved_pair(None)
    zero = solved_pair(cddf.Loads())
    np.testing.assert_allclose(zero.tendon_displacement, none.tendon_displacement, rtol=SETTLED)
    along = none.at(zero.arc_length)  # under loads there are more elements
    for name in ("position", "heading", "tension", "wrap_angle"):
        np.testing.assert_allclose(getattr(zero, name), getattr(along, name), rtol=SETTLED, atol=SETTLED)
    np.testing.assert_allclose(zero.friction_force, along.friction_force, rtol=1e-8, atol=1e-8)
    assert zero.base_moment == none.base_moment == 0.0
    assert (int(none.num_load_steps), int(zero.num_load_steps)) == (0, 1)
    assert (float(none.load_fraction), bool(none.stable)) == (1.0, True)


def test_the_mirror_image():
    """The tendons change sides, and Y changes its sign."""
    one, other = solved_pair(), solved_pair(mirrored, (15.0, 60.0), (-1, +1))
    np.testing.assert_allclose(other.position, one.position * np.array([1, -1]), atol=SETTLED)
    np.testing.assert_allclose(other.curvature, -one.curvature, rtol=SETTLED, atol=SETTLED)
    np.testing.assert_allclose(other.tension, one.tension[::-1], rtol=SETTLED)
    np.testing.assert_allclose(other.base_moment, -one.base_moment, rtol=SETTLED)
    np.testing.assert_allclose(other.num_load_steps, one.num_load_steps)


def test_millimetres_and_megapascals():
    """N/mm^2 is MPa: moments in N mm, densities in kg/mm^3."""
    loads = cddf.Loads((-0.5, -1.0), 30.0, (2.0, -9.81))
    mm = solved_pair(
        loads,
        length=140.0,
        outer_radius=(20.0, 13.0),
        inner_radius=7.0,
        tendon_offset=10.0,
        youngs_modulus=1.4,
        density=1070e-9,
    )
    si = solved_pair()
    np.testing.assert_allclose(mm.position, si.position * 1e3, rtol=SETTLED, atol=1e3 * SETTLED)
    np.testing.assert_allclose(mm.tip_tension, si.tip_tension, rtol=SETTLED)
    np.testing.assert_allclose(mm.base_moment, si.base_moment * 1e3, rtol=SETTLED)
    np.testing.assert_allclose(mm.friction_force, si.friction_force / 1e3, rtol=1e-8, atol=1e-9)


# --- methods, precision, transformations ---------------------------------------------------------

# on the paper's body: the tendon bends it up, the loads bend its tip back down
OPPOSING = PlainLoads((0.5, -4.0), -0.05, (1.0, -9.81))


OPPOSED = paper_body("exact", density=1070.0)


def test_a_load_may_push_a_tendon_back_further_than_its_tension_draws_it_in():
    """That contradicts no direction."""
    solution = cddf.solve(OPPOSED, 5.0, cddf.Loads(*OPPOSING))
    assert solution.tendon_displacement[0] < 0
    assert solution.status == cddf.Status.successful


# --- derivatives ---------------------------------------------------------------------------------

# of the tip and the base by multiples of every number that enters
NUMBERS = ["Fx", "Fy", "m", "gx", "gy", "density", "E", "mu", "R base", "R tip", "r", "d", "T", "L"]
VALUES = np.array([0.5, -4.0, -0.05, 1.0, -9.81, 1070, 1.4e6, 0.42, 0.020, 0.013, 0.007, 0.010, 60.0, 0.14])


def tip_and_base(times):
    """Order one each: tip tension, position, angle, base moment; and last the status."""
    fx, fy, m, gx, gy, density, E, mu, base, tip, r, d, T, length = times * VALUES
    body = cddf.conical(
        length=length,
        outer_radius=(base, tip),
        inner_radius=r,
        tendon_offset=d,
        youngs_modulus=E,
        friction_coefficient=mu,
        density=density,
    )
    solution = cddf.solve(body, T, cddf.Loads((fx, fy), m, (gx, gy)), throw=False)
    last = jnp.stack([solution.tip_angle, solution.base_moment, solution.status])
    return jnp.concatenate([solution.tip_tension / 30, 10 * solution.tip_position, last])


def reference_tip_and_base(times):
    fx, fy, m, gx, gy, density, E, mu, base, tip, r, d, T, length = times * VALUES
    plain = PlainBody(length, straight(base, tip, length), constant(r), [constant(d)], E, [mu], "exact")
    found = loaded_reference(plain, T, PlainLoads((fx, fy), m, (gx, gy)), density)
    return np.concatenate([found.tip_tension / 30, 10 * found.tip_position, [found.tip_angle, found.base_moment]])


LANES = {
    "opposing": (1070.0, OPPOSING, cddf.Status.successful),
    "NaN force": (1070.0, PlainLoads((np.nan, 1.0)), cddf.Status.unphysical),
    "infinite gravity": (1070.0, PlainLoads(gravity=(0.0, np.inf)), cddf.Status.unphysical),
    "NaN moment": (1070.0, PlainLoads(tip_moment=np.nan), cddf.Status.unphysical),
    "negative density": (-1.0, OPPOSING, cddf.Status.unphysical),
    # 60 N against 30 N at 213.5 degrees: the path of equilibria ends at 91 % of the force, see test_continuation.py
    "no equilibrium": (1070.0, PlainLoads((-13.42, -8.88)), cddf.Status.load_limit),
    "a force": (500.0, PlainLoads((0.0, 2.0)), cddf.Status.successful),
}
STATUS = np.array([status for *_, status in LANES.values()])
GOOD = np.flatnonzero(np.equal(STATUS, cddf.Status.successful))
TIMES = np.array([
    [*loads.tip_force, loads.tip_moment, *loads.gravity, density, *VALUES[6:]] / VALUES
    for density, loads, _ in LANES.values()
])  # fmt: skip


@lru_cache
def lanes():
    """The values of all lanes and their derivatives in both modes."""
    return jax.jit(jax.vmap(both_modes(tip_and_base)))(TIMES)


@pytest.mark.slow
def test_failing_lanes_report_themselves_and_spoil_nothing():
    values, _, reverse = lanes()
    np.testing.assert_array_equal(values[:, -1], STATUS)
    bad = np.delete(np.arange(len(LANES)), GOOD)
    assert np.all(np.isnan(values[bad, :-1]))
    np.testing.assert_array_equal(reverse[bad], 0.0)
    for i in GOOD:
        np.testing.assert_allclose(values[i, :-1], reference_tip_and_base(TIMES[i]), atol=10 * AGREES)


def slope(function, at, direction, h=1e-4):
    return (function(at + h * direction) - function(at - h * direction)) / (2 * h)


@pytest.mark.slow
def test_derivatives_by_every_number():
    """Forward and reverse against differences of the reference: h^2 and its 1e-11 over h leave 1e-6."""
    _, forward, reverse = lanes()
    for i, name in enumerate(NUMBERS):
        expected = slope(reference_tip_and_base, TIMES[0], np.eye(len(NUMBERS))[i])
        np.testing.assert_allclose(forward[0, :-1, i], expected, atol=1e-6, err_msg=name)
    direction = np.random.default_rng(3).normal(size=len(NUMBERS)) / 4
    np.testing.assert_allclose(
        forward[-1, :-1] @ direction, slope(reference_tip_and_base, TIMES[-1], direction), atol=1e-6
    )
    np.testing.assert_allclose(reverse[GOOD], forward[GOOD], atol=1e-9)


@pytest.mark.slow
def test_a_second_derivative():
    """Along a direction, forward over reverse, against differences of the reference: h^4 and its 1e-11 over h^2."""
    weights, h = np.array([1.0, -0.5, 0.7, 0.3, 2.0]), 1e-2
    direction = np.random.default_rng(3).normal(size=len(NUMBERS)) / 4
    found = jax.jit(jax.jacfwd(jax.grad(lambda step: weights @ tip_and_base(1.0 + step * direction)[:-1])))(0.0)
    a, b, c, d, e = (weights @ reference_tip_and_base(1.0 + i * h * direction) for i in (-2, -1, 0, 1, 2))
    assert found == pytest.approx((-a + 16 * b - 30 * c + 16 * d - e) / (12 * h**2), rel=1e-5)


# --- what is refused -----------------------------------------------------------------------------


BATCH = cddf.Loads(np.zeros((3, 2)), np.zeros(3), np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("call", "given", "message"),
    [
        (cddf.Loads, (3.0,), "Loads: tip_force must have two or three components (X, Y, Z), got shape ()"),
        (cddf.Loads, ((0.0, 1.0), 0.0, (0.0,)), "gravity must have two or three components"),
        (cddf.solve, (OPPOSED, 60.0, 5), "solve: loads must be a Loads, as in Loads(tip_force=(0.0, -1.0)), got 5"),
        (cddf.solve, (OPPOSED, 60.0, cddf.Loads), "solve: loads must be a Loads, as in Loads("),
        (cddf.solve, (OPPOSED, 60.0, BATCH), "loads.tip_force must have shape (2,) or (3,), got (3, 2); batch with"),
        (
            cddf.solve,
            (OPPOSED, 60.0, eqx.tree_at(lambda loads: loads.tip_moment, cddf.Loads(), np.zeros(4))),
            "loads.tip_moment must have shape () or (3,), got (4,)",
        ),
    ],
)
def test_loads_that_are_refused(call, given, message):
    assert message in refused(call, *given, error=(TypeError, ValueError))
