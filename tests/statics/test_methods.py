"""How many passes the methods need, and what is said where they do not settle."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import codes, paper_body, paper_with, two_slanted_tendons

import cddf_jax as cddf


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


def test_literal_iteration_refuses_finite_turns():
    kinked = cddf.Tendon(cddf.Piecewise.linear([0.0, 0.05, 0.14], [0.008, 0.012, 0.010]))
    with pytest.raises(ValueError, match="LiteralIteration is not possible for tendons that turn by a finite angle"):
        cddf.solve(paper_with(kinked), 40.0, method=cddf.LiteralIteration())
    with pytest.raises(ValueError, match=r"LiteralIteration is a method without loads; use FixedPoint\(\) under loads"):
        cddf.solve(paper_body(), 40.0, cddf.Loads(), method=cddf.LiteralIteration())


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_a_locking_tendon_is_reported_as_such(kinematics):
    """Sliding out, the closed form of docs/theory.md (16) reads T_base / (1 - (mu/E) T_base G): no tip beyond 1."""
    limit = 1.4e6 / 0.42 / 2.942783188998e4
    body = paper_body(kinematics)
    solve = jax.jit(jax.vmap(lambda t: cddf.solve(body, t, direction=-1, throw=False).status))
    factors = jnp.array([1.01, 1.05, 1.2, 1.5, 2.0, 3.0, 10.0, 100.0])
    assert codes(solve(factors * limit)) == [cddf.Status.locked] * 8
    assert cddf.Status.locked not in codes(solve(jnp.linspace(0.1, 0.9, 8) * limit))
