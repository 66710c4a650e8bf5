"""Derivatives in both modes and twice: against the closed form, against unrolled sweeps, against marching."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_plain
from numpy.polynomial import legendre
from scipy.integrate import quad

import cddf_jax as cddf

ACCURATE = 1e-8  # relative to the largest: what the solver promises for the tip tension
MARCHED = 1e-6  # the derivative of RK4 with 8 steps between nodes

# mu, E (MPa), base tension (N), outer radius at base and tip (mm): of order one to a hundred
PARAMETERS = jnp.array([0.42, 1.4, 60.0, 20.0, 13.0])
CASES = {
    "published": ("published", 1, +1, (0.010, 0.010)),
    "published, one out": ("published", 2, (+1, -1), (0.012, 0.009)),
    "exact, one out": ("exact", 2, (+1, -1), (0.010, 0.010)),
    "exact slanted, one out": ("exact", 2, (+1, -1), (0.012, 0.009)),
}


def body_from(parameters, kinematics, count, offset):
    mu, modulus, _, base, tip = parameters
    return paper_body(
        kinematics,
        friction_coefficient=mu,
        youngs_modulus=modulus * 1e6,
        outer_radius=jnp.stack([base, tip]) * 1e-3,
        tendon_offset=offset[0] if offset[0] == offset[1] else offset,
        num_tendons=count,
    )


def pulls(parameters, count):
    return parameters[2] * jnp.array([1.0, 0.25])[:count]


def solved(case, method=cddf.FixedPoint()):
    kinematics, count, direction, offset = CASES[case]

    def tip(parameters):
        body = body_from(parameters, kinematics, count, offset)
        solution = cddf.solve(body, pulls(parameters, count), direction=direction, method=method, throw=False)
        return jnp.concatenate([solution.tip_tension, 1e3 * solution.tip_position, solution.tip_angle[None]])

    return tip


def collocation(order):
    """Gauss nodes on [0, 1] and the end, the integrals of the Lagrange polynomials up to them."""
    x, _ = legendre.leggauss(order)
    columns = []
    for j in range(order):
        others = np.delete(x, j)
        basis = np.polynomial.Polynomial.fromroots(others) / np.prod(x[j] - others)
        integral = basis.integ(lbnd=-1)
        columns.append([*integral(x), integral(1.0)])
    return (np.append(x, 1.0) + 1) / 2, np.array(columns).T / 2


def unrolled(case, order=16, sweeps=40):
    """Plain Picard sweeps over one Gauss panel, differentiated as they stand; nothing from the library."""
    kinematics, count, direction, (d_base, d_tip) = CASES[case]
    x, Q = collocation(order)
    side, slope = np.array([1.0, -1.0])[:count, None], (d_tip - d_base) / 0.14
    d = (d_base + (d_tip - d_base) * x) * np.ones((count, 1))
    sliding = np.broadcast_to(np.asarray(direction, float), count)[:, None]

    def local(EJ, T):
        if kinematics == "published":
            return jnp.sum(side * d * T, 0) / (EJ + jnp.sum(T * d**2, 0))
        kappa = jnp.sum(side * d * T, 0) / EJ
        for _ in range(8 if slope else 0):  # Newton's method on E J kappa = sum sigma d T cos(alpha)
            q = 1 - side * d * kappa
            residual = EJ * kappa - jnp.sum(side * d * T * q / jnp.hypot(q, slope), 0)
            kappa = kappa - residual / (EJ + jnp.sum(d**2 * T * slope**2 / jnp.hypot(q, slope) ** 3, 0))
        return kappa

    def tip(parameters):
        mu, modulus, _, base, end = parameters
        T0 = pulls(parameters, count)[:, None]
        outer = (base + (end - base) * jnp.append(x, 0.0)) * 1e-3  # the last one: the base of the body
        stiffness = modulus * 1e6 * jnp.pi / 4 * (outer**4 - 0.007**4)
        EJ = stiffness[:-1]

        def psi(kappa, heading, d):
            return heading + jnp.arctan2(side * slope, 1 - side * d * kappa)

        def wrap(T):
            kappa = local(EJ, T)
            if kinematics == "published":
                return 0.14 * jnp.abs(kappa / (1 - side * d * kappa))[:, :-1] @ Q.T
            return jnp.abs(psi(kappa, 0.14 * Q @ kappa[:-1], d) - at_base)

        def local_at_base(EJ0, T0):
            kappa = jnp.sum(side * d_base * T0) / EJ0
            for _ in range(8):
                q = 1 - side * d_base * kappa
                residual = EJ0 * kappa - jnp.sum(side * d_base * T0 * q / jnp.hypot(q, slope))
                kappa -= residual / (EJ0 + jnp.sum(d_base**2 * T0 * slope**2 / jnp.hypot(q, slope) ** 3))
            return psi(kappa, 0.0, d_base)

        at_base = local_at_base(stiffness[-1], T0)

        def sweep(T, _):
            return T0 * jnp.exp(-sliding * mu * wrap(T)), None

        T, _ = jax.lax.scan(sweep, T0 * jnp.ones_like(d), None, length=sweeps)
        kappa = local(EJ, T)
        heading = 0.14 * Q @ kappa[:-1]
        position = 140 * Q[-1] @ jnp.stack([jnp.cos(heading), jnp.sin(heading)], -1)[:-1]
        return jnp.concatenate([T[:, -1], position, heading[-1:]])

    return tip


def assert_close(ours, theirs, tolerance):
    theirs = np.asarray(theirs)
    scale = np.max(np.abs(theirs), axis=tuple(range(1, theirs.ndim)), keepdims=True)
    np.testing.assert_allclose(ours / scale, theirs / scale, atol=tolerance, rtol=0)


def both_modes(function):
    """Value, forward and reverse derivative, compiled together."""
    return jax.jit(lambda p: (function(p), jax.jacfwd(function)(p), jax.jacrev(function)(p)))


@pytest.mark.parametrize("case", CASES)
def test_implicit_derivatives_are_those_of_unrolled_sweeps(case):
    value, forward, reverse = both_modes(solved(case))(PARAMETERS)
    expected = unrolled(case)
    np.testing.assert_allclose(value, expected(PARAMETERS), rtol=ACCURATE)
    slope = jax.jit(jax.jacfwd(expected))(PARAMETERS)
    assert_close(forward, slope, ACCURATE)
    assert_close(reverse, slope, ACCURATE)


def test_second_derivatives_are_those_of_unrolled_sweeps():
    case, weights = "exact, one out", jnp.array([1.0, -2.0, 0.3, 0.7, 5.0])
    ours = jax.jit(jax.hessian(lambda p: weights @ solved(case)(p)))(PARAMETERS)
    theirs = jax.jit(jax.hessian(lambda p: weights @ unrolled(case)(p)))(PARAMETERS)
    assert_close(ours, theirs, 1e-7)  # a second derivative loses a digit to the first
    np.testing.assert_allclose(ours, ours.T, rtol=1e-7, atol=1e-9)


def test_implicit_derivatives_are_those_of_marching():
    """Of antagonists in the published kinematics; slanted ones in the exact one are held to unrolled sweeps above."""
    case = "published, one out"
    marched = jax.jit(jax.jacfwd(solved(case, cddf.Marching(steps=4))))(PARAMETERS)
    assert_close(jax.jit(jax.jacfwd(solved(case)))(PARAMETERS), marched, MARCHED)


def closed_form_derivatives(mu, E, T, G):
    """Of T_tip = T / (1 + mu T G / E) by (mu, E in Pa, T), first and second, by hand."""
    c, k = 1 + mu * T * G / E, T * G / E
    first = np.array([-T * k / c**2, T * mu * k / (E * c**2), 1 / c**2])
    mu_mu = 2 * T * k**2 / c**3
    mu_E = T * k / (E * c**2) - 2 * mu * T * k**2 / (E * c**3)
    mu_T = -2 * k / c**3
    E_E = -2 * T * mu * k / (E**2 * c**2) + 2 * T * (mu * k) ** 2 / (E**2 * c**3)
    E_T = 2 * mu * k / (E * c**3)
    T_T = -2 * mu * G / (E * c**3)
    return first, np.array([[mu_mu, mu_E, mu_T], [mu_E, E_E, E_T], [mu_T, E_T, T_T]])


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_derivatives_of_the_closed_form(kinematics):
    def tip_tension(p):
        body = paper_body(kinematics, friction_coefficient=p[0], youngs_modulus=p[1])
        return cddf.solve(body, p[2], throw=False).tip_tension[0]

    point = jnp.array([0.42, 1.4e6, 75.0])
    first, second = closed_form_derivatives(*np.asarray(point), 2.942783188998e4)  # G: design.md section 3
    _, forward, reverse = both_modes(tip_tension)(point)
    np.testing.assert_allclose(forward, first, rtol=ACCURATE)
    np.testing.assert_allclose(reverse, first, rtol=ACCURATE)
    np.testing.assert_allclose(jax.jit(jax.hessian(tip_tension))(point), second, rtol=1e-7)


def test_derivatives_by_the_geometry():
    """dT_tip/dR = -T_tip^2 (mu/E) dG/dR with dG/dR = -int d pi R^3 (dR(s)/dR) / J^2, by SciPy."""
    plain = paper_plain()

    def compliance_slope(weight):
        def integrand(s):
            return -0.010 * np.pi * plain.outer_radius(s) ** 3 * weight(s / 0.14) / plain.second_moment(s) ** 2

        return quad(integrand, 0, 0.14, epsrel=1e-12)[0]

    slopes = np.array([compliance_slope(lambda x: 1 - x), compliance_slope(lambda x: x)])
    tip = plain.closed_form(75.0, 0.14)
    expected = -(tip**2) * 0.42 / 1.4e6 * slopes

    def solve_tip(radii):
        return cddf.solve(paper_body("published", outer_radius=radii), 75.0, throw=False).tip_tension[0]

    def closed_tip(radii):
        return cddf.closed_form_tension(paper_body("published", outer_radius=radii), 75.0, 0.14)

    radii = jnp.array([0.020, 0.013])
    np.testing.assert_allclose(jax.jit(jax.grad(solve_tip))(radii), expected, rtol=ACCURATE)
    _, forward, reverse = both_modes(closed_tip)(radii)
    np.testing.assert_allclose(forward, expected, rtol=1e-11)
    np.testing.assert_allclose(reverse, expected, rtol=1e-11)


def test_derivatives_by_a_kinked_offset_against_differences():
    """Finite turns included: both modes against central differences of the solver itself."""

    def tip(heights):
        body = paper_body("exact", tendon_offset=0.01)
        offset = cddf.Piecewise.linear(jnp.array([0.0, 0.05, 0.10, 0.14]), heights * 1e-2)
        body = cddf.Manipulator(0.14, body.outer_radius, body.inner_radius, (cddf.Tendon(offset),), 1.4e6, 0.42)
        solution = cddf.solve(body, 30.0, throw=False)
        return jnp.concatenate([solution.tip_tension, 1e2 * solution.tip_position])

    heights, h = jnp.array([0.8, 1.2, 1.0, 1.0]), 1e-4
    ends = jax.jit(jax.vmap(tip))(heights + h * jnp.concatenate([jnp.eye(4), -jnp.eye(4)]))
    differences = (ends[:4] - ends[4:]).T / (2 * h)
    _, forward, reverse = both_modes(tip)(heights)
    assert_close(forward, differences, 1e-6)  # h^2 and rounding over h
    assert_close(reverse, forward, ACCURATE)


def test_derivatives_without_friction_are_finite():
    """Mu = 0 lies inside the range of the model: dT_tip/dmu = -T^2 G / E by the closed form."""

    def tip_tension(mu):
        return cddf.solve(paper_body("exact", friction_coefficient=mu), 75.0, throw=False).tip_tension[0]

    slope = jax.jit(jax.grad(tip_tension))(0.0)
    np.testing.assert_allclose(slope, -(75.0**2) * 2.942783188998e4 / 1.4e6, rtol=ACCURATE)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_derivatives_without_tension_are_finite(kinematics):
    """The straight body: dT_tip/dT_base = 1 and d(tip angle)/dT_base = G / E by the closed form at T = 0."""

    def tip(tension):
        solution = cddf.solve(paper_body(kinematics), tension, throw=False)
        return jnp.stack([solution.tip_tension[0], solution.tip_angle])

    _, forward, reverse = both_modes(tip)(0.0)
    np.testing.assert_allclose(forward, [1.0, 2.942783188998e4 / 1.4e6], rtol=ACCURATE)
    np.testing.assert_allclose(reverse, forward, rtol=ACCURATE)


def test_the_fields_along_the_body_have_derivatives():
    """T(s) by the closed form at every node."""
    fields = jax.jacfwd(lambda mu: cddf.solve(paper_body(friction_coefficient=mu), 75.0, throw=False).tension[0])
    solution = cddf.solve(paper_body(), 75.0)
    G = np.array([paper_plain().compliance(s) for s in solution.arc_length])
    expected = -(np.asarray(solution.tension[0]) ** 2) * G / 1.4e6
    np.testing.assert_allclose(jax.jit(fields)(0.42), expected, rtol=1e-7, atol=1e-9)
