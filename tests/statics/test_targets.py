"""Targets in place of tensions: displacements and others, against closed forms and SciPy.

The closed form of docs/theory.md (16), with G(s) = int_0^s d/J ds and constant d in the exact kinematics, inverted:
T(s) = T_base / (1 + a T_base), a = mu G / E; phi(L) = ln(1 + a T_base) / mu; pulled length = d phi(L).
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, codes, lane, paper_body, paper_plain, replaced, stack, stretching
from kinds import root_of
from loaded_bodies import PlainLoads, largest_difference, loaded_reference
from refusals import refused
from scipy.integrate import quad

import cddf_jax as cddf
from cddf_jax import Status

d, MU, E = PAPER["tendon_offset"], PAPER["friction_coefficient"], PAPER["youngs_modulus"]
PLAIN = paper_plain("exact")
PAIR = paper_body("exact", num_tendons=2)
IN_OUT = (+1, -1)
G = PLAIN.compliance(PLAIN.length)
A = MU * G / E
CLOSED = 1e-9  # the solver promises 1e-8; a target is reached to 1e-9 of its size
ROUND_TRIP = 1e-7  # tensions found again from a displacement or an angle that SciPy computed to 1e-10


def curvature_tension(kappa, s):
    """T_base for a wanted curvature at s: T(s) = kappa E J / d."""
    local = kappa * E * PLAIN.second_moment(s) / d
    return local / (1 - MU / E * local * PLAIN.compliance(s))


def crossing_tension():
    """Where d kappa first reaches 1 somewhere: the closed form's kappa d = T(s) d^2 / (E J)."""
    s = np.linspace(0, PLAIN.length, 2001)
    flow = np.array([PLAIN.compliance(x) for x in s])
    J = np.array([PLAIN.second_moment(x) for x in s])
    return root_of(lambda T: np.max(T / (1 + MU / E * T * flow) * d**2 / (E * J)) - 1, 100.0, 1e5)


# --- one tendon ----------------------------------------------------------------------------------

RIGID = 1e30  # N, the axial stiffness of a tendon that stretches by nothing that counts
SOFT, FREE, SOFT_TENSION = 4000.0, 0.25, 60.0


def soft_displacement():
    """Pulled length = d phi + (T_base free + int T ds) / (E A), with T(s) of the closed form."""
    inside = quad(lambda s: PLAIN.closed_form(SOFT_TENSION, s), 0, PLAIN.length, epsabs=1e-12)[0]
    return d * np.log1p(A * SOFT_TENSION) / MU + (SOFT_TENSION * FREE + inside) / SOFT


def paper(*_):
    return paper_body("exact")


# one compiled program each: the body and the target of the wanted value and other numbers, and the lanes
PROGRAMS = {
    "displacement": (
        lambda *numbers: stretching(paper_body("exact"), *numbers),
        lambda x, *_: cddf.Displacement(x),
        [(0.012, RIGID, 0.0), (soft_displacement(), SOFT, FREE), (-0.002, RIGID, 0.0)],
    ),
    "tip_angle": (paper, cddf.TipAngle, [(1.0,), (0.5,), (-0.5,), (12.0,), (np.nan,)]),
    "tip_tension": (paper, cddf.TipTension, [(45.0,)]),
    "curvature": (paper, cddf.CurvatureAt, [(10.0, 0.09), (-3.0, 0.05), (5.0, -0.01), (5.0, 0.15)]),
}


class Lanes(NamedTuple):
    """The results of lanes; `slope` is that of the sum of their tensions, in reverse mode."""

    found: Any
    forward: Any  # derivatives of the tensions by the wanted values
    slope: Any
    slope_by_body: Any
    second: Any  # derivatives of `slope` by the wanted values, forward mode over reverse mode


@lru_cache
def lanes_of(name):
    body, target, lanes = PROGRAMS[name]
    wanted, *others = jnp.asarray(lanes, float).T

    def reach(body, *numbers):
        return cddf.solve(body, target(*numbers), throw=False)

    def total(wanted, bodies):
        found = jax.vmap(reach)(bodies, wanted, *others)
        return jnp.nansum(found.base_tension), found

    @jax.jit
    def everything(wanted, bodies):
        def slopes(wanted):
            slopes, found = jax.grad(total, (0, 1), has_aux=True)(wanted, bodies)
            return (slopes, found.base_tension[:, 0]), found

        at, along, found = jax.jvp(slopes, (wanted,), (jnp.ones_like(wanted),), has_aux=True)
        (slope, slope_by_body), _ = at
        return Lanes(found, along[1], slope, slope_by_body, along[0][0])

    return everything(wanted, stack([body(*rest) for _, *rest in lanes]))


def lane_of(name, wanted):
    """The lane of a wanted value: equilibrium, and the slope of its tension in both modes."""
    lanes, i = lanes_of(name), [x for x, *_ in PROGRAMS[name][2]].index(wanted)
    return lane(lanes.found, i), (lanes.forward[i], lanes.slope[i])


CASES = {
    "displacement": (0.012, lambda x: np.expm1(MU * x / d) / A),
    "tip_angle": (1.0, lambda x: np.expm1(MU * x) / A),
    "tip_tension": (45.0, lambda x: x / (1 - A * x)),
    "curvature": (10.0, lambda x: curvature_tension(x, 0.09)),
}


@pytest.mark.parametrize(
    "name",
    [case if case == "tip_angle" else pytest.param(case, marks=pytest.mark.slow) for case in CASES],
)
def test_one_tendon_against_the_closed_form(name):
    """The tension that is found, and its derivative in both modes."""
    wanted, tension = CASES[name]
    found, slopes = lane_of(name, wanted)
    h = 1e-3 * wanted
    slope = (tension(wanted - 2 * h) - 8 * tension(wanted - h) + 8 * tension(wanted + h) - tension(wanted + 2 * h)) / (
        12 * h
    )
    assert found.base_tension[0] == pytest.approx(tension(wanted), rel=CLOSED)
    assert slopes == pytest.approx((slope, slope), rel=1e-7)  # the difference quotient of fourth order


@pytest.mark.slow
def test_a_tendon_that_stretches():
    """The tension from which `soft_displacement` was computed."""
    pulled = soft_displacement()
    found, _ = lane_of("displacement", pulled)
    assert found.base_tension == pytest.approx(SOFT_TENSION, rel=CLOSED)
    assert found.tendon_displacement == pytest.approx(pulled, rel=CLOSED)


# --- under loads ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_tip_angle_of_a_loaded_body_leads_back_to_its_tension():
    """SciPy's for 20 N."""
    loads = PlainLoads((0.0, -1.0), 0.02)
    reference = loaded_reference(PLAIN, 20.0, loads)
    found = cddf.solve(paper_body("exact"), cddf.TipAngle(reference.tip_angle), cddf.Loads(*loads))
    assert found.base_tension == pytest.approx([20.0], rel=ROUND_TRIP)
    np.testing.assert_allclose(found.tip_position, reference.tip_position, atol=1e-8)


@pytest.mark.slow
def test_slack_under_a_load_is_what_the_load_leaves():
    """A force that bends the body towards the tendon takes up more tendon than the micrometer does.

    How the body hangs without tension, and how it bends with 30 N, is SciPy's.
    """
    force, plain = (0.0, 6.0), paper_plain("published", IN_OUT)
    hanging, bent = (loaded_reference(plain, (T, 0.0), PlainLoads(force), direction=IN_OUT) for T in (0.0, 30.0))
    taken_up = hanging.displacement[0]
    assert taken_up > 0.001
    body, loads = paper_body("published", num_tendons=2), cddf.Loads(force)

    def solve(wanted):
        return cddf.solve(body, (cddf.Displacement(wanted), 0.0), loads, direction=IN_OUT, throw=False)

    wanted = jnp.array([0.8 * taken_up, 0.4 * taken_up, bent.displacement[0]])
    found = jax.jit(jax.vmap(solve))(wanted)
    assert codes(found.status) == [Status.slack, Status.slack, Status.successful]
    for i, reference in enumerate((hanging, hanging, bent)):
        assert largest_difference(lane(found, i), reference, plain) < ROUND_TRIP
    np.testing.assert_array_equal(found.base_tension[:2], 0.0)
    assert found.base_tension[2, 0] == pytest.approx(30.0, rel=ROUND_TRIP)


# --- two tendons ---------------------------------------------------------------------------------


def test_two_tendons_for_an_angle_and_a_total_tension():
    """Frictionless and parallel: E kappa J = d (T1 - T2), so phi = (T1 - T2) G / E, and T1 + T2 is given."""
    body = replaced(PAIR, friction_coefficient=0.0)
    found = cddf.solve(body, (cddf.TipAngle(0.6), cddf.TotalTension(120.0)), direction=IN_OUT)
    difference = 0.6 * E / G
    assert found.base_tension == pytest.approx([60 + difference / 2, 60 - difference / 2], rel=CLOSED)


@pytest.mark.slow
def test_tip_stiffness_is_the_inverse_of_the_compliance_across_the_tip():
    """A tendon stiffens in the published kinematics: E J + T d^2.

    The compliance is the difference quotient of SciPy's deflections, of fourth order: 1e-9, noise 1e-12 m / (C h).
    """
    found = cddf.solve(paper_body("published"), cddf.TipStiffness(350.0), nodes=12)
    plain = paper_plain("published")
    across = np.array([-np.sin(found.tip_angle), np.cos(found.tip_angle)])

    def deflection(force):
        return across @ loaded_reference(plain, found.base_tension, PlainLoads(tuple(force * across))).tip_position

    h = 0.1
    slope = (8 * (deflection(h) - deflection(-h)) - (deflection(2 * h) - deflection(-2 * h))) / (12 * h)
    assert 1 / slope == pytest.approx(350.0, rel=1e-6)


# --- what cannot be reached ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "wanted", "nearest"),
    [
        ("tip_angle", -0.5, 0.0),
        ("tip_angle", 12.0, crossing_tension()),
        pytest.param("curvature", -3.0, 0.0, marks=pytest.mark.slow),
    ],
)
def test_an_unreachable_target_gives_the_nearest(name, wanted, nearest):
    found, _ = lane_of(name, wanted)
    assert found.status == Status.unreachable
    assert found.base_tension[0] == pytest.approx(nearest, rel=1e-5, abs=1e-9)
    assert abs(found.target_miss[0]) > 1e-3
    plain = cddf.solve(paper_body("exact"), found.base_tension)
    np.testing.assert_allclose(found.tip_angle, plain.tip_angle, atol=1e-12)
    if name == "tip_angle":
        with pytest.raises(cddf.SolveError, match=r"^The nearest that can be reached misses the targets by .* \(SI\)"):
            cddf.solve(paper_body("exact"), cddf.TipAngle(wanted))


def test_the_published_tip_tension_has_a_supremum():
    """T_tip < E / (mu G) for any base tension, docs/theory.md (16); the published curvature never crosses."""
    found = cddf.solve(paper_body("published"), cddf.TipTension(1.01 * E / (MU * G)), throw=False)
    assert found.status == Status.unreachable
    assert 0.9 * E / (MU * G) < found.tip_tension[0] < E / (MU * G)
    assert found.target_miss[0] == pytest.approx(float(found.tip_tension[0]) - 1.01 * E / (MU * G), rel=1e-9)


@pytest.mark.slow
def test_a_tendon_cannot_push():
    found, _ = lane_of("displacement", -0.002)
    assert found.status == Status.slack
    assert found.base_tension[0] == 0.0
    assert found.target_miss == pytest.approx([0.002], rel=1e-12)


def soft_pair(axial_stiffness, free_length, **changes):
    """Antagonists that stretch."""
    return replaced(stretching(PAIR, axial_stiffness, free_length), **{"friction_coefficient": MU, **changes})


def solved_pair(body, pulled, **options):
    return cddf.solve(body, tuple(cddf.Displacement(x) for x in pulled), direction=IN_OUT, **options)


@pytest.mark.slow
def test_a_slack_tendon_leaves_the_other_its_displacement():
    """Rigid antagonists, 8 mm in and 12 mm out: the second goes slack, the first is one tendon alone (CASES)."""
    body, pulled = soft_pair(RIGID, 0.0), (0.008, -0.012)
    found = solved_pair(body, pulled, throw=False)
    assert found.status == Status.slack
    np.testing.assert_allclose(found.tendon_displacement, [0.008, -0.008], rtol=CLOSED)
    np.testing.assert_allclose(found.target_miss, [0.0, 0.004], atol=1e-11)
    assert found.base_tension == pytest.approx([np.expm1(MU * 0.008 / d) / A, 0.0], rel=CLOSED)
    with pytest.raises(cddf.SolveError, match="A tendon would have to push"):
        solved_pair(body, pulled)


@pytest.mark.slow
@pytest.mark.parametrize("let_out", [(-0.001, -0.001), (-0.005, -0.001)])
def test_antagonists_that_are_let_out_hang_loose(let_out):
    """A body without tension is straight and pulls nothing in."""
    found = cddf.solve(soft_pair(RIGID, 0.0), tuple(map(cddf.Displacement, let_out)), throw=False)
    assert found.status == Status.slack
    np.testing.assert_array_equal(found.base_tension, 0.0)
    np.testing.assert_allclose(found.target_miss, np.abs(let_out), rtol=1e-12)


def test_antagonists_that_do_not_stretch_leave_their_tensions_open():
    """Parallel tendons on a midline that does not stretch: d phi and -d phi, for all tensions."""
    body = soft_pair(RIGID, 0.0)
    assert solved_pair(body, (0.005, -0.005), throw=False).status == Status.undetermined
    with pytest.raises(cddf.SolveError, match="Other base tensions reach the targets just as well"):
        solved_pair(body, (0.005, -0.005))
    assert solved_pair(body, (0.005, -0.004), throw=False).status != Status.successful


def test_antagonists_that_stretch_have_their_tensions():
    """Frictionless: delta_i = +-d (T1 - T2) G / E + T_i (L + free) / (E A)."""
    soft, free = 3000.0, 0.1
    body = soft_pair(soft, free, friction_coefficient=0.0)
    tension = np.array([80.0, 30.0])
    bend = d * (tension[0] - tension[1]) * G / E
    wanted = np.array([bend, -bend]) + tension * (PLAIN.length + free) / soft
    found = solved_pair(body, wanted)
    assert found.base_tension == pytest.approx(tension, rel=1e-8)


def test_lanes_that_cannot_reach_harm_no_neighbour():
    """The gradient of a sum over a batch is that of the lanes that reach their target; a held lane has none.

    T = expm1(mu phi) / a: its derivative is mu exp(mu phi) / a, and so on.
    """
    batch, slope, second = lanes_of("tip_angle").found, lanes_of("tip_angle").slope, lanes_of("tip_angle").second
    good, far = Status.successful, Status.unreachable
    assert codes(batch.status) == [good, good, far, far, Status.unphysical]
    for i, angle in enumerate((1.0, 0.5)):
        assert lane(batch, i).base_tension[0] == pytest.approx(np.expm1(MU * angle) / A, rel=CLOSED)
        assert slope[i] == pytest.approx(MU * np.exp(MU * angle) / A, rel=1e-8)
        assert second[i] == pytest.approx(MU**2 * np.exp(MU * angle) / A, rel=1e-7)
    np.testing.assert_array_equal(slope[2:], 0.0)
    assert np.all(np.isnan(lane(batch, 4).base_tension))


def test_derivatives_by_the_body_at_constant_angle():
    """The tension expm1(mu phi) E / (mu G), by E and by mu."""
    slope, tension = lane(lanes_of("tip_angle").slope_by_body, 0), np.expm1(MU) / A
    assert slope.youngs_modulus == pytest.approx(tension / E, rel=1e-8)
    assert slope.friction_coefficient == pytest.approx(E / (MU * G) * np.exp(MU) - tension / MU, rel=1e-8)


# --- how it is asked -----------------------------------------------------------------------------


def test_a_target_of_one_tendon_needs_no_tuple():
    lone, listed = (cddf.solve(paper_body("exact"), x) for x in (cddf.TipAngle(0.4), [cddf.TipAngle(0.4)]))
    assert lone.base_tension == listed.base_tension


@pytest.mark.parametrize(
    ("tension", "message"),
    [
        (cddf.TipAngle(0.4), "with a target, base_tension must hold one tension or target per tendon (2)"),
        ((cddf.TipAngle(0.4),) * 3, "one tension or target per tendon (2), got 3"),
        ((cddf.TipAngle, 5.0), "solve: TipAngle needs a value, as in TipAngle(...)"),
        ((cddf.Displacement([1e-3, 2e-3]), 5.0), "solve: Displacement must hold one number for its tendon"),
    ],
    ids=repr,
)
def test_refusals(tension, message):
    assert message in refused(cddf.solve, PAIR, tension, error=(TypeError, ValueError))


def test_what_no_body_in_space_can_have():
    """In space the angle lies between two axes, 0 to pi, and the curvature is a size."""
    body = replace(paper_body("exact"), tendons=(cddf.Tendon(offset=0.01, angle=0.0),))
    for target in (cddf.TipAngle(3.5), cddf.TipAngle(-0.3)):
        said = refused(cddf.solve, body, target)
        assert said.startswith("solve: tip_angle of a body in space is 0 or more and at most 180 deg, got ")
    assert "curvature of a body in space is 0 or more, got -5" in refused(cddf.solve, body, cddf.CurvatureAt(-5.0, 0.1))
    assert refused(cddf.trace, body, cddf.TipAngle([1.0, 3.5])).startswith("trace: tip_angle of a body in space")


@pytest.mark.slow
def test_a_place_off_the_body_is_refused():
    found = lanes_of("curvature").found
    assert codes(found.status)[2:] == [Status.unphysical] * 2
    assert np.all(np.isnan(found.tip_angle[2:]))
