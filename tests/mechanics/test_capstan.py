"""Every solver's oracle: the closed form of docs/theory.md (16), and the numbers printed there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    UNIT_CUBE,
    Draw,
    body_of,
    codes,
    draw_from,
    paper_body,
    paper_plain,
    paper_with,
    plain_of,
    random_draws,
    stack,
    two_slanted_tendons,
)
from hypothesis import given, settings
from loaded_bodies import reference_solution
from scipy.integrate import quad

import cddf_jax as cddf

TENSION_ACCURACY = 1e-8  # relative; issue 2, section 3
POSITION_ACCURACY = 1e-7  # per length; issue 2, section 3
PRINTED = 5e-13  # docs/theory.md prints 12 decimals

# docs/theory.md (16): tip tension (N) at 5, 10, 25, 50, 75, 85 N
BASE_TENSIONS = np.array([5.0, 10.0, 25.0, 50.0, 75.0, 85.0])
TIP_TENSIONS = np.array(
    [4.788621861321, 9.188782187535, 20.479905810209, 34.688076668284, 45.122927013148, 48.560059601631]
)


@eqx.filter_jit
def solve_draw(draw, kinematics):
    return cddf.solve(body_of(draw, kinematics), draw.base_tension, throw=False)


@jax.jit
def closed_form_of(draw, along):
    return cddf.closed_form_tension(body_of(draw, "published"), draw.base_tension, along)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@given(unit=UNIT_CUBE)
@settings(max_examples=20)
def test_random_bodies(kinematics, unit):
    """Published with converging offsets, exact with a constant one; SciPy's quadrature of d / J, and its DOP853."""
    draw = draw_from(unit, kinematics)
    plain = plain_of(draw, kinematics)
    solution = solve_draw(Draw(*map(jnp.asarray, draw)), kinematics)
    expected = plain.closed_form(draw.base_tension, draw.length)
    np.testing.assert_allclose(solution.tip_tension, [expected], rtol=TENSION_ACCURACY)
    reference = reference_solution(plain, draw.base_tension)
    miss = np.linalg.norm(solution.tip_position - reference.tip_position)
    assert miss <= POSITION_ACCURACY * draw.length
    assert abs(solution.tip_angle) <= np.pi


def test_no_false_alarm():
    """A solve with the accuracy above must not be called inaccurate; 200 bodies, seed 0."""
    result = jax.vmap(lambda draw: solve_draw(draw, "exact").status)(stack(random_draws("exact", 200, seed=0)))
    assert codes(result).count(cddf.Status.inaccurate) == 0
    assert codes(result) == [cddf.Status.successful] * 200


@given(unit=UNIT_CUBE)
@settings(max_examples=15)
def test_closed_form_is_the_formula(unit):
    """Against SciPy's adaptive quadrature, along the whole body."""
    draw = draw_from(unit, "published")
    plain, along = plain_of(draw, "published"), np.linspace(0, draw.length, 5)
    expected = [plain.closed_form(draw.base_tension, s) for s in along]
    ours = closed_form_of(Draw(*map(jnp.asarray, draw)), along)
    np.testing.assert_allclose(ours, expected, rtol=1e-11)  # 32 Gauss nodes on a taper of 0.3


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_printed_tip_tensions(kinematics):
    """docs/theory.md (16) prints them for the paper's body; they are the same in both kinematics."""
    np.testing.assert_allclose(paper_plain().compliance(0.14), 2.942783188998e4, atol=5e-9, rtol=0)  # G(L), m^-2
    body = paper_body(kinematics)
    closed = [cddf.closed_form_tension(body, tension, 0.14) for tension in BASE_TENSIONS]
    np.testing.assert_allclose(closed, TIP_TENSIONS, atol=PRINTED, rtol=1e-14)
    solved = [cddf.solve(body, tension).tip_tension[0] for tension in BASE_TENSIONS]
    np.testing.assert_allclose(solved, TIP_TENSIONS, rtol=TENSION_ACCURACY)


@pytest.mark.parametrize(
    ("kinematics", "x", "y", "angle"),
    [("published", 120.39593, 57.00182, 63.16687), ("exact", 117.34384, 60.28179, 69.31393)],
)
def test_printed_tip_poses(kinematics, x, y, angle):
    """docs/theory.md (16): mm and degrees at 75 N, five decimals."""
    solution = cddf.solve(paper_body(kinematics), 75.0)
    np.testing.assert_allclose(solution.tip_position * 1e3, [x, y], atol=0.6e-5)
    np.testing.assert_allclose(np.degrees(solution.tip_angle), angle, atol=0.6e-5)
    np.testing.assert_allclose(solution.tension_loss, [0.3984], atol=0.5e-4)  # "39.84 % loss at 75 N"


def test_offsets_and_anchors_that_the_closed_form_takes():
    """A tendon keeps the tension of its anchor beyond it; a linear offset that is level is constant."""
    anchored = paper_with(cddf.Tendon(0.01, end=0.1), kinematics="published")
    found = cddf.closed_form_tension(anchored, 75.0, np.array([0.1, 0.12, 0.14]))
    np.testing.assert_allclose(found, paper_plain().closed_form(75.0, 0.1), rtol=1e-12)
    level = paper_body("exact", tendon_offset=(0.01, 0.01))
    np.testing.assert_allclose(cddf.closed_form_tension(level, 75.0, 0.14), TIP_TENSIONS[4], rtol=1e-12)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (two_slanted_tendons("published"), "closed_form_tension holds for one tendon, not for 2; use solve"),
        (
            paper_body("exact", tendon_offset=(0.012, 0.009)),
            "in the exact kinematics for a Constant tendon offset only, not for Linear",
        ),
        (paper_with(cddf.Tendon(0.010, angle=cddf.Linear(0.0, 6.0, 0.140))), "a tendon parallel to the axis of a body"),
        (paper_with(cddf.Tendon(0.010), rest_curvature=(0.0, 0.0, 10.0)), "of a body that is straight at rest"),
        (paper_with(cddf.Tendon(0.010, outside_drag=1.0)), "closed_form_tension: .* act along a history; use trace"),
    ],
    ids=["two tendons", "slanted", "winding", "bent at rest", "friction along a history"],
)
def test_refusals_do_not_depend_on_being_traced(body, message):
    for tension in (cddf.closed_form_tension, eqx.filter_jit(cddf.closed_form_tension)):
        with pytest.raises(ValueError, match=message):
            tension(body, 75.0, 0.14)


def test_wrap_angle_also_without_friction():
    """Of a cylinder theta = log(1 + mu x) / mu with x = T d L / (E J): x - mu x^2 / 2 + mu^2 x^3 / 3 for a small mu."""
    cylinder = paper_body("exact", outer_radius=(0.016, 0.016))
    x = 75.0 * 0.010 * 0.140 / (1.4e6 * np.pi / 4 * (0.016**4 - 0.007**4))

    def wrap(mu):
        body = eqx.tree_at(lambda body: body.friction_coefficient, cylinder, mu)
        return cddf.solve(body, 75.0, throw=False).wrap_angle[0, -1]

    mu = np.array([0.0, 1e-9, 1e-5, 0.42])
    slope = x / (0.42 * (1 + 0.42 * x)) - np.log1p(0.42 * x) / 0.42**2
    slopes = np.append(-(x**2) / 2 + 2 * mu[:3] * x**3 / 3 - 3 * mu[:3] ** 2 * x**4 / 4, slope)
    found, there = jax.vmap(jax.value_and_grad(wrap))(mu)
    np.testing.assert_allclose(found[0], x, rtol=1e-13)
    np.testing.assert_allclose(found[1:], np.log1p(mu[1:] * x) / mu[1:], rtol=1e-12)
    np.testing.assert_allclose(there, slopes, rtol=1e-11)
    np.testing.assert_allclose(jax.jvp(wrap, (0.0,), (1.0,))[1], slopes[0], rtol=1e-11)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_without_friction_the_tension_is_that_at_the_base(kinematics):
    """Exact: kappa = d T / (E J); published, eq. (17) integrated: d T / (E J + T d^2). SciPy integrates to the tip."""
    solution = cddf.solve(paper_body(kinematics, friction_coefficient=0.0), 50.0)
    np.testing.assert_array_equal(solution.tension, 50.0)
    np.testing.assert_array_equal(solution.tension_loss, 0.0)

    def curvature(s):
        return 0.010 * 50.0 / (1.4e6 * paper_plain().second_moment(s) + (kinematics == "published") * 50.0 * 0.010**2)

    np.testing.assert_allclose(solution.curvature, curvature(np.asarray(solution.arc_length)), rtol=1e-12)
    np.testing.assert_allclose(solution.tip_angle, quad(curvature, 0, 0.14, epsrel=1e-13)[0], atol=1e-9)


def test_no_tension_no_bending():
    solution = cddf.solve(paper_body("published"), 0.0)
    np.testing.assert_array_equal(solution.curvature, 0.0)
    np.testing.assert_array_equal(solution.tip_tension, 0.0)
    np.testing.assert_allclose(solution.tip_position, [0.14, 0.0], atol=1e-12)


# --- the pulley, eq. (5): a weight raised over a fixed pulley ------------------------------------


def test_the_pull_over_a_pulley():
    """By hand: 0.42 pi / 2 = 0.659734 and e^0.659734 = 1.93428; twice the wrap; no wrap, no friction, no weight.

    And dT/dmu = theta T.
    """
    weight, mu = np.array([10.0, 10.0, 7.0, 7.0, 0.0]), np.array([0.42, 0.42, 0.42, 0.0, 0.42])
    wrap = np.pi * np.array([0.5, 1.0, 0.0, 1.0, 1.0])
    pulled, slope = jax.jvp(lambda mu: cddf.pulling_tension(weight, mu, wrap), (mu,), (np.ones(5),))
    np.testing.assert_allclose(pulled, [19.3428, 37.4144, 7.0, 7.0, 0.0], rtol=1e-5)
    np.testing.assert_allclose(pulled, weight * np.exp(mu * wrap), rtol=1e-14)
    np.testing.assert_allclose(slope, wrap * pulled, rtol=1e-14)
