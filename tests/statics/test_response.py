"""Compliance and Jacobian of the tip: textbook, closed form, SciPy, reciprocity."""

import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain, replaced
from loaded_bodies import PlainLoads, loaded_reference

import cddf_jax as cddf

LENGTH, d, MU, E = (PAPER[name] for name in ("length", "tendon_offset", "friction_coefficient", "youngs_modulus"))
LOADS = cddf.Loads(tip_force=(1.0, -2.0), tip_moment=0.02)
# one structure of each kinematics: one tendon, and two of which one slides out
CASES = {
    "exact": (paper_body("exact"), paper_plain("exact"), 40.0, +1),
    "published": (paper_body("published", num_tendons=2), paper_plain("published", (+1, -1)), (60.0, 20.0), (+1, -1)),
}


def compliance_of(name, **changes):
    body, _, tension, direction = CASES[name]
    return np.asarray(cddf.tip_compliance(replaced(body, **changes), tension, LOADS, direction=direction))


@pytest.mark.slow
def test_a_uniform_cantilever():
    """Straight and without tension: L^3 / (3 E J), L^2 / (2 E J), L / (E J); nothing along the axis."""
    body = paper_body("exact", outer_radius=(0.015, 0.015))
    stiffness = float(body.stiffness(0.0))
    y, phi, both = LENGTH**3 / (3 * stiffness), LENGTH / stiffness, LENGTH**2 / (2 * stiffness)
    expected = [[0, 0, 0], [0, y, both], [0, both, phi]]
    found = cddf.tip_compliance(body, 0.0, cddf.Loads(), direction=+1)  # without any load: one program for all
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_against_differences_of_the_reference(name):
    """Central differences of SciPy's shooting, steps h of 1e-3 N and 1e-4 N m: error h^2, noise 1e-10 / h."""
    _, plain, tension, direction = CASES[name]
    wrench = np.array([1.0, -2.0, 0.02])

    def pose(wrench):
        loads = PlainLoads((wrench[0], wrench[1]), wrench[2])
        found = loaded_reference(plain, tension, loads, direction=direction)
        return np.array([*found.tip_position, found.tip_angle])

    steps = np.diag([1e-3, 1e-3, 1e-4])
    columns = [(pose(wrench + h) - pose(wrench - h)) / (2 * np.max(h)) for h in steps]
    np.testing.assert_allclose(compliance_of(name), np.stack(columns, axis=1), rtol=2e-5, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_reciprocity_and_its_loss(name):
    """At constant tensions a frictionless body has a potential, so C is symmetric (Maxwell, Betti)."""
    smooth = compliance_of(name, friction_coefficient=0.0)
    np.testing.assert_allclose(smooth, smooth.T, rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(smooth) > 0)
    rough = compliance_of(name)
    assert np.max(np.abs(rough - rough.T) / np.abs(rough)) > 0.02


@pytest.mark.slow
def test_the_tip_cannot_turn_where_a_displacement_is_held():
    """Without friction the pulled length of a parallel tendon is d phi."""
    body = paper_body("exact", friction_coefficient=0.0)
    held = cddf.tip_compliance(body, cddf.Displacement(0.005), nodes=8)
    np.testing.assert_allclose(held[2], 0.0, atol=1e-9)
    assert np.max(np.abs(held[:2, :2])) > 1e-4


def test_jacobian_against_the_closed_form():
    """phi(L) = ln(1 + a T) / mu with a = mu G / E, docs/theory.md (16)."""
    plain, tension = paper_plain("exact"), 40.0
    a = MU * plain.compliance(LENGTH) / E
    jacobian = cddf.tip_jacobian(paper_body("exact"), tension)
    assert jacobian.loads is None
    by_tension = a / (1 + a * tension) / MU
    assert jacobian.base_tension[2] == pytest.approx(by_tension, rel=1e-8)
    assert jacobian.manipulator.youngs_modulus[2] == pytest.approx(-by_tension * tension / E, rel=1e-8)
    by_mu = by_tension * tension / MU - np.log1p(a * tension) / MU**2
    assert jacobian.manipulator.friction_coefficient[2] == pytest.approx(by_mu, rel=1e-8)


def test_a_failed_solve_has_no_jacobian():
    assert np.all(np.isnan(cddf.tip_jacobian(paper_body("exact"), -1.0).base_tension))
