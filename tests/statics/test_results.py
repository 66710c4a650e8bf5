"""The results of a solve: codes, messages, fields anywhere along the body, displacements; and input that is refused."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import codes, paper_body, paper_plain, stack, two_slanted_tendons
from kinds import root_of
from refusals import refused

import cddf_jax as cddf
from cddf_jax import Status


@pytest.fixture(scope="module")
def pair():
    return cddf.solve(two_slanted_tendons(), (75.0, 20.0), direction=(+1, -1))


# --- codes ---------------------------------------------------------------------------------------


CROSSING = paper_body("exact", youngs_modulus=3e5, friction_coefficient=0.05)
FAILURES = {
    "unphysical": (paper_body("exact"), 30.0, 0.5, Status.unphysical, r"direction other than \+1 or -1"),
    "overflow": (
        paper_body("exact", friction_coefficient=1e200, youngs_modulus=1e-200),
        75.0,
        +1,
        Status.not_converged,
        r"did not settle\. Raise nodes= or max_iterations",
    ),
    "crossing": (CROSSING, 200.0, +1, Status.crossing, "cross"),
    "locked": (paper_body("exact"), 1.01 * 1.4e6 / 0.42 / 2.942783188998e4, -1, Status.locked, "locks"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_has_its_code_and_is_raised_with_its_message(failure):
    body, tension, direction, expected, message = FAILURES[failure]
    solution = cddf.solve(body, tension, direction=direction, throw=False)
    assert solution.status == expected
    with pytest.raises(cddf.SolveError, match=message):
        cddf.solve(body, tension, direction=direction)
    assert np.all(np.isnan(solution.at(0.07).position)) == (expected != Status.crossing)


def test_a_crossing_keeps_its_numbers_and_is_one():
    """Offset times curvature at the tip by the closed form: d^2 T / (E J) >= 1."""
    body, tension, *_ = FAILURES["crossing"]
    plain = paper_plain("exact", youngs_modulus=3e5, friction=[0.05])
    assert 0.010**2 * plain.closed_form(tension, 0.14) / (3e5 * plain.second_moment(0.14)) > 1
    solution = cddf.solve(body, tension, throw=False)
    np.testing.assert_allclose(solution.tip_tension, [plain.closed_form(tension, 0.14)], rtol=1e-6)


def test_few_passes_settle_strong_friction():
    """The errors of passes over the whole body fall like c^n / n!, docs/theory.md (16).

    A slanted pair with 77 % loss: c = -ln(1 - 0.77) = 1.46, and c^n / n! is 1e-12 at n = 18.
    """
    solution = cddf.solve(two_slanted_tendons(friction_coefficient=1.2), (150.0, 20.0), direction=+1, throw=False)
    assert solution.tension_loss[0] > 0.7
    assert solution.num_iterations < 18


def test_too_few_passes_are_reported():
    dragged, hasty = replace(paper_body("exact"), drag=10.0), cddf.FixedPoint(max_iterations=2)
    solution = cddf.solve(dragged, 75.0, method=hasty, throw=False)
    assert solution.status == cddf.Status.not_converged
    assert np.all(np.isnan(solution.tip_tension))


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_a_locking_tendon_is_reported_as_such(kinematics):
    """Sliding out, the closed form of docs/theory.md (16) reads T_base / (1 - (mu/E) T_base G): no tip beyond 1."""
    limit = 1.4e6 / 0.42 / 2.942783188998e4
    body = paper_body(kinematics)
    solve = jax.jit(jax.vmap(lambda t: cddf.solve(body, t, direction=-1, throw=False).status))
    factors = jnp.array([1.01, 1.05, 1.2, 1.5, 2.0, 3.0, 10.0, 100.0])
    assert codes(solve(factors * limit)) == [cddf.Status.locked] * 8
    assert cddf.Status.locked not in codes(solve(jnp.linspace(0.1, 0.9, 8) * limit))


def test_a_tendon_that_locks_under_a_load_is_reported_as_such():
    """Fibres cross before it locks, and nothing lies between the two: also where coarse elements do not see the lock.

    The elements with kinks alone see it from 112.5222 to 112.5246 N.
    """
    push = cddf.Loads(tip_force=(0.0, 2.0))
    solve = jax.jit(jax.vmap(lambda t: cddf.solve(paper_body("exact"), t, push, direction=-1, throw=False).status))
    found = codes(solve(112.5234 + 5e-4 * jnp.arange(-4, 5)))
    locked = found.count(cddf.Status.locked)
    assert 2 <= locked <= 7
    assert found == [cddf.Status.crossing] * (9 - locked) + [cddf.Status.locked] * locked


# --- arguments -----------------------------------------------------------------------------------


REFUSED = [
    ({"base_tension": (1.0, 2.0, 3.0)}, "solve: base_tension must be a number or one per tendon (2), got shape (3,)"),
    ({"base_tension": np.ones((2, 1))}, "one per tendon (2), got shape (2, 1)"),
    ({"base_tension": [[1.0]]}, "one per tendon (2), got shape (1, 1)"),
    ({"direction": (None, None, 1)}, "solve: direction must be a number or one per tendon (2), got 3 entries"),
    ({"direction": (None, (1, 1))}, "solve: direction must be a number or one per tendon (2), got shape (2,)"),
    *(({"nodes": nodes}, "nodes must be a whole number of 4 or more, got") for nodes in (3, 16.0, True)),
    *(({"method": method}, "method must be one such as FixedPoint") for method in ("literal", cddf.FixedPoint)),
]


@pytest.mark.parametrize(("given", "message"), REFUSED, ids=repr)
def test_arguments_that_are_refused(given, message):
    told = {"base_tension": 20.0, **given}
    assert message in refused(cddf.solve, two_slanted_tendons(), **told, error=(TypeError, ValueError))


# --- fields --------------------------------------------------------------------------------------


def test_the_capstan_law_along_the_body(pair):
    """Eq. (8): T = T_base exp(-mu theta) sliding in, exp(+mu theta) sliding out."""
    sign = np.array([[1.0], [-1.0]])
    expected = np.array([[75.0], [20.0]]) * np.exp(-sign * 0.42 * np.asarray(pair.wrap_angle))
    # at inner nodes tension and wrap angle are collocated apart
    np.testing.assert_allclose(pair.tension, expected, rtol=1e-7)
    np.testing.assert_allclose(pair.tip_tension, expected[:, -1], rtol=1e-9)


def test_at_outside_the_body_is_nan(pair):
    at = pair.at(jnp.array([-1e-9, 0.0, 0.14, 0.14 + 1e-9, jnp.nan]))
    outside = [True, False, False, True, True]
    np.testing.assert_array_equal(np.isnan(at.heading), outside)
    np.testing.assert_array_equal(np.isnan(at.position[:, 0]), outside)
    np.testing.assert_array_equal(np.isnan(at.tension[0]), outside)


def test_at_can_be_differentiated(pair):
    """Of the heading the curvature, of the position the axis t: docs/theory.md (1)."""
    s = jnp.asarray(0.0613)
    slope = jax.jit(jax.jacfwd(lambda s: (pair.at(s).heading, pair.at(s).position)))(s)
    at = pair.at(s)
    np.testing.assert_allclose(slope[0], at.curvature, rtol=1e-5)  # the slope of an interpolant of degree 8
    np.testing.assert_allclose(slope[1], [np.cos(at.heading), np.sin(at.heading)], rtol=1e-5)


# --- what hides between the nodes ----------------------------------------------------------------


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def of_notched_body(place, width):
    """Of a smooth notch at `place`, 8 mm deep: the error of the tip tension, and whether the solve is successful."""

    def notch(arc_length):
        return 0.020 - 0.008 * jnp.exp(-(((arc_length - place) / width) ** 2))

    body = cddf.Manipulator(0.14, notch, 0.007, (cddf.Tendon(0.010),), 1.4e6, 0.42, kinematics="published")
    solution = cddf.solve(body, 75.0, throw=False)
    exact = cddf.closed_form_tension(body, 75.0, 0.14, nodes=960)
    return solution.tip_tension[0] / exact - 1, solution.status == Status.successful


@pytest.mark.parametrize("width", [1e-3, 1.5e-3, 3e-3])
def test_a_notch_between_the_nodes_is_seen(width):
    """At any arc length: no body whose tension differs from the closed form by 1e-5 may be called successful.

    The oracle is the closed form over 60 panels of Gauss nodes, 960 in all.
    """

    miss, passed = of_notched_body(jnp.linspace(0.0, 0.14, 141), width)
    assert np.abs(miss).max() > 1e-3  # the notch matters
    assert np.abs(miss)[np.asarray(passed)].max(initial=0.0) < 1e-5


def test_crossing_is_seen_at_the_very_tip():
    """Without friction d kappa = T d^2 / (E J), largest at the tip of a cone: 1.005 there, below 1 at the nodes."""
    body = paper_body("exact", friction_coefficient=0.0)
    stiffness = 1.4e6 * np.pi / 4 * (0.013**4 - 0.007**4)
    result = cddf.solve(body, 1.005 * stiffness / 0.010**2, throw=False).status
    assert result == Status.crossing


def test_crossing_is_seen_before_a_joint():
    """The wall is thinnest just before a joint, between two nodes: d kappa = d^2 T / (E J), eq. (13)."""
    radius = cddf.Piecewise([0.07], [cddf.Linear(0.02, 0.0075, 0.07), 0.02])
    body = replace(paper_body("exact", friction_coefficient=0.0), outer_radius=radius, tendons=(cddf.Tendon(0.0073),))
    unit = 1.4e6 * np.pi / 4 * (0.0075**4 - 0.007**4) / 0.0073**2
    assert cddf.solve(body, 0.98 * unit, nodes=32).status == Status.successful
    said = refused(cddf.solve, body, 1.02 * unit, nodes=32, error=cddf.SolveError)
    assert said.startswith("tendon 1: offset * curvature is 1.02 at s = 70 mm")


def test_at_the_anchor_of_a_tendon_is_what_lies_before_it():
    """E J kappa = d T (1 - d kappa) / |t_c|, eq. (13) with eq. (3) normalised, solved by SciPy."""
    slope, end, tension = 0.020 / 0.140, 0.07, 150.0
    tendon = cddf.Tendon(cddf.Linear(0.002, 0.022, 0.14), end=end)
    body = replace(paper_body("exact", friction_coefficient=0.0), tendons=(tendon,))
    d, stiffness = 0.002 + slope * end, float(body.stiffness(jnp.asarray(end)))
    kappa = root_of(lambda k: stiffness * k - d * tension * (1 - d * k) / np.hypot(1 - d * k, slope), 0.0, 1 / d)
    there = cddf.solve(body, tension).at(end)
    np.testing.assert_allclose(there.curvature, kappa, rtol=1e-9)
    np.testing.assert_allclose(there.tension, [tension], rtol=1e-12)


def test_a_batch_is_refused_with_what_to_map():
    body = paper_body()
    bodies = jax.tree.map(lambda x: np.stack([x, x]), body)
    some = replace(body, youngs_modulus=np.array([1.4e6, 1.4e6]))
    for many, name in ((bodies, "length"), (some, "youngs_modulus")):
        for call, pull in ((cddf.solve, 75.0), (cddf.trace, [75.0])):
            said = refused(call, many, pull)
            assert said.startswith(
                f"{call.__name__}: {name} of the body has the shape (2,), as in a batch of bodies; use"
            )
    one = cddf.solve(body, 75.0)
    batch = stack([one, one])
    assert "use jax.vmap(lambda equilibrium: equilibrium.at(s))(equilibria)" in refused(batch.at, 0.07)
    mapped = jax.jit(jax.vmap(lambda equilibrium: equilibrium.at(0.07)))(batch)
    np.testing.assert_allclose(mapped.tension[1], one.at(0.07).tension, rtol=1e-14)  # as the remedy says


# --- in words: numbers with units in a few lines, shapes where numbers are traced or batched ---------


@pytest.mark.parametrize(("ratio", "count"), [(0.5, 0), (0.8, 1)])  # an isotropic material has 0.5 at most
def test_a_poissons_ratio_that_no_material_has(ratio, count):
    body = replace(paper_body("exact"), poissons_ratio=ratio)
    remarks = cddf.solve(body, 40.0, space=True).remarks
    assert [remark.startswith("poissons_ratio = 0.8 is above 0.5") for remark in remarks] == [True] * count
    assert cddf.solve(body, 40.0).remarks == ()  # in the plane nothing depends on it


def test_under_vmap_and_jit_there_are_shapes():
    told = []

    def tip(tension):
        bent = cddf.solve(paper_body(), tension)
        told.extend([str(bent), str(replace(paper_body(), length=tension))])
        return bent

    batch = jax.jit(jax.vmap(tip))(np.array([10.0, 75.0, -1.0]))
    assert "tip_position=f64[2]" in told[0]
    assert told[1].startswith("Manipulator(")
    assert "tip_position=f64[3,2]" in str(batch)
    assert cddf.in_words(batch.status) == "2 successful, 1 unphysical"
