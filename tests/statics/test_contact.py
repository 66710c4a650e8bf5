"""Where a bent body touches itself, and the strain of its wall: against circles."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from bodies import paper_body

import cddf_jax as cddf

LENGTH, RADIUS, OFFSET, MODULUS = 0.140, 0.004, 0.002, 50e6
# a rod without friction bends to a circle: kappa = T d / (E J)
ROD = cddf.conical(
    length=LENGTH,
    outer_radius=RADIUS,
    inner_radius=0.0,
    tendon_offset=OFFSET,
    youngs_modulus=MODULUS,
    friction_coefficient=0.0,
)
STIFFNESS = MODULUS * np.pi / 4 * RADIUS**4


def bent(angle, body=ROD):
    """The rod bent by an angle, deg."""
    return cddf.solve(body, np.radians(angle) / LENGTH * STIFFNESS / OFFSET)


@pytest.mark.parametrize("angle", [60.0, 359.9, 360.1, 800.0])
@pytest.mark.slow
def test_a_tube_touches_itself_from_a_full_circle_on(angle):
    """Two places of a circle of radius rho that lie on each other are 2 pi rho apart, or a multiple."""
    found = cddf.self_contact(bent(angle))
    assert (found is not None) == (angle > 360)
    if found is not None:
        turns = (found.other - found.arc_length) / (360.0 / angle * LENGTH)
        assert turns == pytest.approx(round(turns), abs=0.01)  # a station is 1/400 of the length
        assert found.distance < 2 * RADIUS


@pytest.mark.parametrize(("bend", "touches"), [(0.9, True), (1.1, False)])
def test_a_hairpin_whose_legs_lie_on_each_other(bend, touches):
    """Stiff leg, soft half turn, stiff leg: the legs are two bend radii apart, two radii of the rod touch."""
    bore = 0.99999 * RADIUS
    soft, kappa = 1 - 0.99999**4, 1 / (bend * RADIUS)  # of the stiffness; the legs bend by that little too
    leg = 0.5 * (LENGTH - np.pi / kappa)
    pieces = [cddf.Constant(0.0), cddf.Constant(bore), cddf.Constant(0.0)]
    body = replace(ROD, inner_radius=cddf.Piecewise([leg, LENGTH - leg], pieces))
    eq = cddf.solve(body, kappa * soft * STIFFNESS / OFFSET)
    assert eq.tip_angle == pytest.approx(np.pi + 2 * leg * soft * kappa, rel=1e-6)
    assert (cddf.self_contact(eq) is not None) == touches


def test_the_strain_of_a_cone_is_largest_at_its_tip():
    """Kappa = T d / (E J), published kinematics with T d^2 beside E J, docs/theory.md; the tip is the thinnest."""
    eq = cddf.solve(paper_body(), 75.0)
    second_moment = np.pi / 4 * (0.013**4 - 0.007**4)
    tension = 45.122927013148  # docs/theory.md (16)
    kappa = tension * 0.010 / (1.4e6 * second_moment + tension * 0.010**2)
    assert eq.peak_strain == pytest.approx(0.013 * kappa, rel=1e-9)
    assert eq.peak_strain_at == pytest.approx(0.140, abs=1e-9)


def test_the_strain_of_a_step_is_that_of_its_thick_side():
    """One curvature of a soft thick piece and a stiff thin one: E J is that of the bore; the radius decides."""
    second_moment = 1e-12
    radius = (0.004, 0.006)
    bores = [(r**4 - 4 / np.pi * second_moment) ** 0.25 for r in radius]
    outer, inner = (cddf.Piecewise([0.05], [cddf.Constant(r) for r in both]) for both in (radius, bores))
    body = replace(ROD, outer_radius=outer, inner_radius=inner)
    eq = cddf.solve(body, 1.0)
    kappa = 1.0 * OFFSET / (MODULUS * second_moment)
    assert eq.peak_strain == pytest.approx(0.006 * kappa, rel=1e-9)
    assert eq.peak_strain_at == pytest.approx(0.05, abs=1e-9)


def test_strain_under_jit_vmap_and_its_derivative():
    """Of the circle R T d / (E J): linear in the tension."""
    tension = np.array([1.0, 3.0])
    value, slope = jax.vmap(jax.value_and_grad(lambda t: cddf.solve(ROD, t).peak_strain))(tension)
    np.testing.assert_allclose(value, RADIUS * tension * OFFSET / STIFFNESS, rtol=1e-9)
    np.testing.assert_allclose(slope, RADIUS * OFFSET / STIFFNESS, rtol=1e-9)


def test_remarks_on_strain_and_contact():
    eq = bent(400.0, replace(ROD, yield_strain=0.08))
    strain, contact = eq.remarks
    # R kappa = 4 mm * 400 deg / 140 mm = 0.19947
    assert strain.startswith("The wall is strained by 19.95 % at s = 0 mm, more than its yield_strain of 8 %")
    assert contact.startswith("The body touches itself, s = ")
    # 4 mm * 160 deg / 140 mm = 0.0798
    assert bent(160.0, replace(ROD, yield_strain=0.08)).remarks == ()


def test_a_failed_solve_has_no_strain_and_no_contact():
    eq = cddf.solve(ROD, -1.0, throw=False)
    assert np.isnan(eq.peak_strain)
    assert cddf.self_contact(eq) is None
    assert eq.remarks == ()
