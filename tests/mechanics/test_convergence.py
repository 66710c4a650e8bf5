"""How fast the error falls with the number of nodes, and whether the error estimate is large enough."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import body_of, one_kinematics_at_once, paper_body, paper_plain, plain_of, random_draws, stack
from loaded_bodies import reference_solution
from scipy.integrate import quad

import cddf_jax as cddf

FLOOR = 1e-11  # DOP853 at 1e-12, and the passes


def tip_errors(nodes):
    """Tension (relative), position (per length) at the tip of the paper's body."""
    solution, plain = cddf.solve(paper_body("exact"), 75.0, nodes=nodes, throw=False), paper_plain("exact")
    position = np.linalg.norm(solution.tip_position - reference_solution(plain, 75.0).tip_position) / 0.14
    return np.array([abs(solution.tip_tension[0] / plain.closed_form(75.0, 0.14) - 1), position])


def test_the_error_falls_spectrally():
    """Gauss's rule: each further node of the one panel divides the error by rho^2.

    The wall of the paper's body would vanish at s = 13/7 L, x = 2.714 on the panel scaled to [-1, 1], so
    rho = x + sqrt(x^2 - 1) = 5.24 and rho^2 = 27.4. Measured: 27 for the tension.
    """
    rate = (2.714 + np.sqrt(2.714**2 - 1)) ** 2
    errors = np.array([tip_errors(nodes) for nodes in (4, 5, 6)])
    assert np.all(errors[0] < 1e-4)
    falls = errors[:-1] / errors[1:]
    assert np.all(falls > 0.6 * rate)
    np.testing.assert_allclose(falls[:, 0], rate, rtol=0.1)
    assert np.all(tip_errors(16) < FLOOR)  # two panels of 8
    assert np.all(tip_errors(8) < 4e-5)  # promised by docs/theory.md (16)


# --- the error estimate --------------------------------------------------------------------------


def true_errors(kinematics, draws, solutions):
    """Of tension (relative), position (per length) and angle at the tip."""
    rows = []
    for i, draw in enumerate(draws):
        found = reference_solution(plain_of(draw, kinematics), draw.base_tension)
        tension = solutions.tip_tension[i, 0] / found.tip_tension[0] - 1
        position = np.max(np.abs(solutions.tip_position[i] - found.tip_position)) / draw.length
        rows.append(max(abs(tension), position, abs(solutions.tip_angle[i] - found.tip_angle)))
    return np.array(rows)


@one_kinematics_at_once
def test_the_estimate_is_not_below_the_error(kinematics):
    """Over 64 random bodies (seed 5), with too few nodes on purpose; it may fall short by a factor of two.

    No lane may be wrong by more than 1e-5 and called successful.
    """
    draws = random_draws(kinematics, 64, seed=5)
    nodes = 6 if kinematics == "exact" else 4

    def solve(draw):
        return cddf.solve(body_of(draw, kinematics), draw.base_tension, nodes=nodes, throw=False)

    solutions = jax.jit(jax.vmap(solve))(stack(draws))
    errors = true_errors(kinematics, draws, solutions)
    assert np.all(errors <= 2 * np.asarray(solutions.error_estimate) + FLOOR)
    successful = np.asarray(solutions.status == cddf.Status.successful)
    assert np.any(successful)
    assert np.any(~successful)
    assert np.all(errors[successful] < 1e-5)


# --- bodies too rough for their nodes ------------------------------------------------------------


KINK = 0.0613  # m, at no node of any rule


def kinked(s):
    return 0.013 + 0.09 * jnp.abs(s - KINK)


def wiggling(s):
    return 0.016 + 0.003 * jnp.sin(900.0 * s)


def body_with(outer_radius):
    return cddf.Manipulator(0.14, outer_radius, 0.007, (cddf.Tendon(0.01),), 1.4e6, 0.42)


@pytest.mark.parametrize("profile", [kinked, wiggling], ids=lambda f: f.__name__)
def test_an_undeclared_roughness_is_detected(profile):
    solution = cddf.solve(body_with(profile), 40.0, throw=False)
    assert solution.status == cddf.Status.inaccurate
    assert solution.error_estimate > 1e-5
    assert np.isfinite(solution.tip_tension[0])
    with pytest.raises(cddf.SolveError, match=r"too rough for its nodes\. Raise nodes="):
        cddf.solve(body_with(profile), 40.0)


def test_the_estimate_tells_small_kinks_and_steps_that_are_not_declared():
    """Of the outer radius; against the same radius with a declared break, under no load."""
    at = np.repeat([0.021, 0.05, 0.0618, 0.1333], 4)
    slope, step = np.tile([[0.02, 0.001, 0.0, 0.0], [0.0, 0.0, 1e-3, 1e-5]], 4)  # -, m

    def solved(profile):
        return jax.jit(jax.vmap(lambda *given: cddf.solve(body_with(profile(*given)), 60.0, throw=False)))(
            at, slope, step
        )

    def undeclared(at, slope, step):
        return lambda s: 0.016 - slope * jnp.abs(s - at) + step * (s > at)

    def declared(at, slope, step):
        inner = cddf.Linear(0.016 - slope * at, 0.016 + slope * (0.14 - at), 0.14)
        outer = cddf.Linear(0.016 + slope * at + step, 0.016 - slope * (0.14 - at) + step, 0.14)
        return cddf.Piecewise(at[None], [inner, outer])

    found, exact = solved(undeclared), solved(declared)
    apart = np.abs(found.tip_tension[:, 0] / exact.tip_tension[:, 0] - 1), np.abs(found.tip_angle - exact.tip_angle)
    assert np.all(np.maximum(*apart) <= found.error_estimate)
    assert np.all(found.error_estimate <= 1e3 * np.maximum(*apart))


def test_declared_breaks_restore_the_accuracy():
    heights = np.array(kinked(np.array([0.0, KINK, 0.14])))
    declared = cddf.Piecewise.linear([0.0, KINK, 0.14], heights)
    plain = paper_plain("exact", outer_radius=lambda s: float(kinked(s)), breaks=(KINK,))
    compliance = quad(lambda s: 0.010 / plain.second_moment(s), 0, 0.14, points=[KINK], epsabs=0, epsrel=1e-12)[0]
    expected = 40.0 / (1 + 0.42 / 1.4e6 * 40.0 * compliance)
    solution = cddf.solve(body_with(declared), 40.0)
    assert solution.status == cddf.Status.successful
    np.testing.assert_allclose(solution.tip_tension, [expected], rtol=1e-8)
    rough = cddf.solve(body_with(kinked), 40.0, throw=False)
    assert abs(rough.tip_tension[0] / expected - 1) > 1e-6  # not idle: without the break it is wrong


@pytest.mark.slow
def test_the_estimate_knows_how_errors_grow_under_large_loads():
    """A force of 22 (base) to 147 (tip) E J / L^2 pulls the tip, and errors in the bending grow along the body."""
    body = cddf.conical(
        length=0.2,
        outer_radius=(0.016, 0.010),
        inner_radius=0.002,
        tendon_offset=(0.010, 0.005),
        youngs_modulus=1e6,
        friction_coefficient=0.3,
        density=1100.0,
    )
    loads = cddf.Loads((28.3, 5.8), 0.02, (-7.2, 4.4))
    coarse, fine = cddf.solve(body, 19.1, loads), cddf.solve(body, 19.1, loads, nodes=40)
    error = abs(coarse.tip_angle - fine.tip_angle)
    assert 1e-12 < error < 2 * coarse.error_estimate < 1e-6
