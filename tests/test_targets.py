"""What may stand in place of a tension: displacements and targets, against closed forms and SciPy.

The closed form of design.md section 3, with G(s) = int_0^s d/J ds and constant d in the exact kinematics, inverted:
T(s) = T_base / (1 + a T_base), a = mu G / E; phi(L) = ln(1 + a T_base) / mu; pulled length = d phi(L).
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, codes, lane, paper_body, paper_plain, replaced, stack
from jax.sharding import AxisType, PartitionSpec
from loaded_bodies import random_loaded
from scipy.integrate import quad
from scipy.optimize import brentq

import cddf_jax as cddf

R = cddf.RESULTS
d, MU, E = PAPER["tendon_offset"], PAPER["friction_coefficient"], PAPER["youngs_modulus"]
PLAIN = paper_plain("exact")
G = PLAIN.compliance(PLAIN.length)
A = MU * G / E
CLOSED = 1e-9  # the solver promises 1e-8; a target is reached to 1e-9 of its size
ROUND_TRIP = 1e-7  # tensions found again from a displacement or an angle that SciPy computed to 1e-10


def curvature_tension(kappa, s):
    """T_base for a wanted curvature at s: T(s) = kappa E J / d."""
    local = kappa * E * PLAIN.second_moment(s) / d
    return local / (1 - MU / E * local * PLAIN.compliance(s))


CASES = {
    "displacement": (lambda x: cddf.Displacement(x), 0.012, lambda x: np.expm1(MU * x / d) / A),
    "tip_angle": (lambda x: cddf.TipAngle(x), 1.0, lambda x: np.expm1(MU * x) / A),
    "tip_tension": (lambda x: cddf.TipTension(x), 45.0, lambda x: x / (1 - A * x)),
    "total_tension": (lambda x: cddf.TotalTension(x), 30.0, lambda x: x),
    "curvature": (lambda x: cddf.CurvatureAt(x, 0.09), 10.0, lambda x: curvature_tension(x, 0.09)),
}


@pytest.mark.parametrize("name", CASES)
def test_one_tendon_against_the_closed_form(name):
    """The tension that is found, and its derivative in forward mode."""
    target, wanted, tension = CASES[name]

    def found(x):
        return cddf.solve(paper_body("exact"), target(x), throw=False).base_tension[0]

    value, forward = jax.jit(lambda x: jax.jvp(found, (x,), (1.0,)))(wanted)
    h = 1e-3 * wanted
    slope = (tension(wanted - 2 * h) - 8 * tension(wanted - h) + 8 * tension(wanted + h) - tension(wanted + 2 * h)) / (
        12 * h
    )
    assert value == pytest.approx(tension(wanted), rel=CLOSED)
    assert forward == pytest.approx(slope, rel=1e-7)  # the difference quotient of fourth order


def test_reverse_mode_and_the_second_derivative():
    """T = expm1(mu phi) / a: its derivative is mu exp(mu phi) / a, and so on."""

    def found(x):
        return cddf.solve(paper_body("exact"), cddf.TipAngle(x), throw=False).base_tension[0]

    first, second = jax.jit(lambda x: (jax.grad(found)(x), jax.hessian(found)(x)))(1.0)
    assert first == pytest.approx(MU * np.exp(MU) / A, rel=1e-8)
    assert second == pytest.approx(MU**2 * np.exp(MU) / A, rel=1e-7)


def test_a_tendon_that_stretches():
    """Pulled length = d phi + (T_base free + int T ds) / (E A), with T(s) of the closed form."""
    stiffness, free = 4000.0, 0.25
    body = replace(paper_body("exact"), tendons=(cddf.Tendon(d, axial_stiffness=stiffness, free_length=free),))
    tension = 60.0
    inside = quad(lambda s: PLAIN.closed_form(tension, s), 0, PLAIN.length, epsabs=1e-12)[0]
    pulled = d * np.log1p(A * tension) / MU + (tension * free + inside) / stiffness
    found = cddf.solve(body, cddf.Displacement(pulled))
    assert found.base_tension == pytest.approx(tension, rel=CLOSED)
    assert cddf.solve(body, tension).tendon_displacement == pytest.approx(pulled, rel=CLOSED)


LANES = 5


@pytest.mark.parametrize(("kinematics", "count", "target"), [("exact", 1, "angle"), ("published", 2, "displacement")])
def test_round_trip_under_loads(kinematics, count, target):
    """SciPy's displacement or tip angle of random loaded bodies leads back to the tension that made it."""
    rng = np.random.default_rng(70 + count)
    problems = [random_loaded(rng, kinematics, count, slanted=False) for _ in range(LANES)]
    bodies = stack([cddf.conical(**p.conical) for p in problems])
    loads = stack([cddf.Loads(*p.loads) for p in problems])
    tension = jnp.asarray([np.broadcast_to(p.base_tension, count) for p in problems], float)
    direction = np.broadcast_to(problems[0].direction, count).astype(float)
    angle = np.array([p.reference.tip_angle for p in problems])
    displacement = np.array([p.reference.displacement[0] for p in problems])
    make, wanted = {"angle": (cddf.TipAngle, angle), "displacement": (cddf.Displacement, displacement)}[target]

    @jax.jit
    @jax.vmap
    def solve(body, load, wanted, tension):
        return cddf.solve(body, (make(wanted), *tension[1:]), load, direction=direction, throw=False)

    found = solve(bodies, loads, jnp.asarray(wanted), tension)
    assert set(codes(found.result)) <= {int(R.successful._value), int(R.direction_contradicted._value)}
    np.testing.assert_allclose(found.base_tension, tension, rtol=ROUND_TRIP)
    np.testing.assert_allclose(found.tip_angle, angle, atol=1e-8)
    np.testing.assert_allclose(found.tendon_displacement[:, 0], displacement, atol=1e-8)


# --- two tendons ---------------------------------------------------------------------------------

PAIR = paper_body("exact", num_tendons=2)
IN_OUT = (+1, -1)


def test_two_tendons_for_an_angle_and_a_total_tension():
    """Frictionless and parallel: E kappa J = d (T1 - T2), so phi = (T1 - T2) G / E, and T1 + T2 is given."""
    body = replaced(PAIR, friction_coefficient=0.0)
    found = cddf.solve(body, (cddf.TipAngle(0.6), cddf.TotalTension(120.0)), direction=IN_OUT)
    difference = 0.6 * E / G
    assert found.base_tension == pytest.approx([60 + difference / 2, 60 - difference / 2], rel=CLOSED)


def test_friction_costs_tension():
    found = cddf.solve(PAIR, (cddf.TipAngle(0.6), cddf.TotalTension(120.0)), direction=IN_OUT)
    again = cddf.solve(PAIR, found.base_tension, direction=IN_OUT)
    assert again.tip_angle == pytest.approx(0.6, abs=CLOSED)
    assert jnp.sum(found.base_tension) == pytest.approx(120.0, rel=CLOSED)
    assert found.base_tension[0] - found.base_tension[1] > 0.6 * E / G


def test_tip_stiffness_is_the_inverse_of_the_compliance_across_the_tip():
    """Co-contraction stiffens in the published kinematics: E J + sum T d^2."""
    body = paper_body("published", num_tendons=2)
    found = cddf.solve(body, (cddf.TipAngle(0.5), cddf.TipStiffness(350.0)), direction=IN_OUT)
    assert found.tip_angle == pytest.approx(0.5, abs=CLOSED)
    compliance = cddf.tip_compliance(body, found.base_tension, direction=IN_OUT)[:2, :2]
    across = np.array([-np.sin(0.5), np.cos(0.5)])
    assert 1 / (across @ compliance @ across) == pytest.approx(350.0, rel=1e-7)


def test_a_displacement_beside_a_tension():
    """The frictionless pair again: d phi = d (T1 - T2) G / E is what the first tendon is pulled in."""
    body = replaced(PAIR, friction_coefficient=0.0)
    found = cddf.solve(body, (cddf.Displacement(0.005), 20.0), direction=IN_OUT)
    assert found.base_tension == pytest.approx([20.0 + 0.005 / d * E / G, 20.0], rel=CLOSED)
    assert found.tendon_displacement == pytest.approx([0.005, -0.005], rel=CLOSED)


# --- what cannot be reached ----------------------------------------------------------------------


def crossing_tension():
    """Where d kappa first reaches 1 somewhere: the closed form's kappa d = T(s) d^2 / (E J)."""
    s = np.linspace(0, PLAIN.length, 2001)
    flow = np.array([PLAIN.compliance(x) for x in s])
    J = np.array([PLAIN.second_moment(x) for x in s])
    return brentq(lambda T: np.max(T / (1 + MU / E * T * flow) * d**2 / (E * J)) - 1, 100.0, 1e5)


@pytest.mark.parametrize(
    ("target", "nearest"),
    [
        (cddf.TipAngle(-0.5), 0.0),
        (cddf.TipAngle(12.0), crossing_tension()),
        (cddf.TipTension(200.0), crossing_tension()),
        (cddf.CurvatureAt(-3.0, 0.05), 0.0),
        (cddf.TipTension(-1.0), 0.0),
    ],
    ids=repr,
)
def test_an_unreachable_target_gives_the_nearest(target, nearest):
    found = cddf.solve(paper_body("exact"), target, throw=False)
    assert found.result == R.unreachable
    assert found.base_tension[0] == pytest.approx(nearest, rel=1e-5, abs=1e-9)
    assert abs(found.target_miss[0]) > 1e-3
    plain = cddf.solve(paper_body("exact"), found.base_tension)
    np.testing.assert_allclose(found.tip_angle, plain.tip_angle, atol=1e-12)
    with pytest.raises(cddf.SolveError, match=r"^The nearest that can be reached misses the targets by .* \(SI\)"):
        cddf.solve(paper_body("exact"), target)


def test_the_published_tip_tension_has_a_supremum():
    """T_tip < E / (mu G) for any base tension, design.md section 3; the published curvature never crosses."""
    found = cddf.solve(paper_body("published"), cddf.TipTension(1.01 * E / (MU * G)), throw=False)
    assert found.result == R.unreachable
    assert 0.9 * E / (MU * G) < found.tip_tension[0] < E / (MU * G)
    assert found.target_miss[0] == pytest.approx(float(found.tip_tension[0]) - 1.01 * E / (MU * G), rel=1e-9)


def test_a_tendon_cannot_push():
    found = cddf.solve(paper_body("exact"), cddf.Displacement(-0.002), throw=False)
    assert found.result == R.slack
    assert found.base_tension[0] == 0.0
    assert found.target_miss == pytest.approx([0.002], rel=1e-12)
    with pytest.raises(cddf.SolveError, match="A tendon would have to push"):
        cddf.solve(paper_body("exact"), cddf.Displacement(-0.002))


def test_a_slack_tendon_leaves_the_other_its_displacement():
    """Rigid antagonists, 8 mm in and 12 mm out: the second goes slack, the first is one tendon alone (CASES)."""
    targets = (cddf.Displacement(0.008), cddf.Displacement(-0.012))
    found = cddf.solve(PAIR, targets, direction=IN_OUT, throw=False)
    assert found.result == R.slack
    np.testing.assert_allclose(found.tendon_displacement, [0.008, -0.008], rtol=CLOSED)
    np.testing.assert_allclose(found.target_miss, [0.0, 0.004], atol=1e-11)
    assert found.base_tension == pytest.approx([np.expm1(MU * 0.008 / d) / A, 0.0], rel=CLOSED)


def test_slack_under_a_load_is_what_the_load_leaves():
    """A force that bends the body towards the tendon takes up more tendon than the micrometer does."""
    body, loads = paper_body("exact"), cddf.Loads(tip_force=(0.0, 6.0))
    hanging = cddf.solve(body, 0.0, loads)
    taken_up = float(hanging.tendon_displacement[0])
    assert taken_up > 0.001
    slack = cddf.solve(body, cddf.Displacement(0.8 * taken_up), loads, throw=False)
    assert slack.result == R.slack
    np.testing.assert_allclose(slack.position, hanging.position, atol=1e-12)
    taut = cddf.solve(body, cddf.Displacement(1.2 * taken_up), loads)
    assert taut.base_tension[0] > 0
    assert taut.tendon_displacement == pytest.approx([1.2 * taken_up], rel=CLOSED)


def test_antagonists_that_do_not_stretch_leave_their_tensions_open():
    """Parallel tendons on a midline that does not stretch: d phi and -d phi, whatever the tensions."""
    targets = (cddf.Displacement(0.005), cddf.Displacement(-0.005))
    assert cddf.solve(PAIR, targets, direction=IN_OUT, throw=False).result == R.undetermined
    with pytest.raises(cddf.SolveError, match="Other base tensions give what is wanted just as well"):
        cddf.solve(PAIR, targets, direction=IN_OUT)
    apart = (cddf.Displacement(0.005), cddf.Displacement(-0.004))
    assert cddf.solve(PAIR, apart, direction=IN_OUT, throw=False).result != R.successful


def test_antagonists_that_stretch_have_their_tensions():
    """Frictionless: delta_i = +-d (T1 - T2) G / E + T_i (L + free) / (E A)."""
    soft, free = 3000.0, 0.1
    tendons = tuple(cddf.Tendon(d, side, axial_stiffness=soft, free_length=free) for side in (+1, -1))
    body = replaced(replace(PAIR, tendons=tendons), friction_coefficient=0.0)
    tension = np.array([80.0, 30.0])
    bend = d * (tension[0] - tension[1]) * G / E
    wanted = np.array([bend, -bend]) + tension * (PLAIN.length + free) / soft
    found = cddf.solve(body, tuple(cddf.Displacement(x) for x in wanted), direction=IN_OUT)
    assert found.base_tension == pytest.approx(tension, rel=1e-8)


def test_lanes_that_cannot_reach_harm_no_neighbour():
    """The gradient of a sum over a batch is that of the lanes that reach their target; a held lane has none."""
    angles = jnp.array([0.5, -1.0, 1.0, 15.0, jnp.nan])

    def solve(angle):
        return cddf.solve(paper_body("exact"), cddf.TipAngle(angle), throw=False)

    def total(angles):
        return jnp.nansum(jax.vmap(solve)(angles).base_tension)

    batch, slope = jax.jit(jax.vmap(solve))(angles), jax.jit(jax.grad(total))(angles)
    expected = [R.successful, R.unreachable, R.successful, R.unreachable, R.unphysical]
    assert codes(batch.result) == [int(code._value) for code in expected]
    for i in (0, 2):
        assert lane(batch, i).base_tension[0] == pytest.approx(np.expm1(MU * float(angles[i])) / A, rel=CLOSED)
        assert slope[i] == pytest.approx(MU * np.exp(MU * float(angles[i])) / A, rel=1e-8)
    np.testing.assert_array_equal(slope[jnp.array([1, 3, 4])], 0.0)
    assert np.all(np.isnan(lane(batch, 4).base_tension))


def test_derivatives_by_the_body_at_constant_angle():
    """The tension expm1(mu phi) E / (mu G), by E and by mu."""
    slope = jax.jit(jax.grad(lambda body: cddf.solve(body, cddf.TipAngle(1.0), throw=False).base_tension[0]))(
        jax.tree.map(jnp.asarray, paper_body("exact"))
    )
    tension = np.expm1(MU) / A
    assert slope.youngs_modulus == pytest.approx(tension / E, rel=1e-8)
    assert slope.friction_coefficient == pytest.approx(E / (MU * G) * np.exp(MU) - tension / MU, rel=1e-8)


# --- how it is asked -----------------------------------------------------------------------------


def test_a_target_of_one_tendon_needs_no_tuple():
    lone, listed = (cddf.solve(paper_body("exact"), x) for x in (cddf.TipAngle(0.4), [cddf.TipAngle(0.4)]))
    assert lone.base_tension == listed.base_tension


@pytest.mark.parametrize(
    ("tension", "error", "message"),
    [
        (cddf.TipAngle(0.4), ValueError, "with a target, base_tension must hold one tension or target per tendon (2)"),
        ((cddf.TipAngle(0.4),) * 3, ValueError, "one tension or target per tendon (2), got 3"),
        ((cddf.TipAngle, 5.0), TypeError, "solve: TipAngle needs a value, as in TipAngle(...)"),
    ],
    ids=repr,
)
def test_refusals(tension, error, message):
    with pytest.raises(error) as refusal:
        cddf.solve(PAIR, tension)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_place_off_the_body_is_refused():
    for place in (-0.01, 0.15):
        found = cddf.solve(paper_body("exact"), cddf.CurvatureAt(5.0, place), throw=False)
        assert found.result == R.unphysical
        assert np.isnan(found.tip_angle)


def test_float32():
    """Single precision reaches its targets to about 1e-5."""
    body = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), paper_body("exact"))
    with jax.enable_x64(False):
        found = cddf.solve(body, cddf.TipAngle(1.0))
    assert found.base_tension.dtype == jnp.float32
    assert found.base_tension[0] == pytest.approx(np.expm1(MU) / A, rel=1e-4)


def test_numbers_of_a_target_are_leaves():
    target = eqx.tree_at(lambda target: target.value, cddf.TipAngle(0.4), jnp.asarray(0.7))
    assert cddf.solve(paper_body("exact"), target).tip_angle == pytest.approx(0.7, abs=CLOSED)


def test_shard_map():
    """A target under a load, four devices against one."""

    def tension(angle):
        body, loads = paper_body("exact"), cddf.Loads(tip_force=(0.0, -1.0))
        return jax.vmap(lambda x: cddf.solve(body, cddf.TipAngle(x), loads, throw=False).base_tension[0])(angle)

    lanes, angles = PartitionSpec("lanes"), jnp.linspace(0.3, 0.6, 4)
    mesh = jax.make_mesh((4,), ("lanes",), axis_types=(AxisType.Auto,))
    sharded = jax.jit(jax.shard_map(tension, mesh=mesh, in_specs=lanes, out_specs=lanes))(angles)
    np.testing.assert_allclose(sharded, jax.jit(tension)(angles), rtol=1e-10)
