"""Single precision: within 1e-5 of double, and single throughout."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_with, two_slanted_tendons

import cddf_jax as cddf

SINGLE = 1e-5  # relative to tension, length, radian; issue 2, section 3


def single(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tree)


def assert_all_single(tree):
    kinds = {str(x.dtype) for x in jax.tree.leaves(tree) if hasattr(x, "dtype")}
    assert not kinds & {"float64", "complex128"}


LOADS = cddf.Loads((0.5, -4.0), -0.05, (1.0, -9.81))
HELIX = paper_with(cddf.Tendon(0.010, angle=cddf.Linear(0.0, np.pi, 0.14)))  # half a turn


@pytest.mark.parametrize(
    ("body", "tension", "direction", "loads"),
    [
        (paper_body("published"), 75.0, +1, None),
        (paper_body("exact"), 75.0, +1, None),
        (HELIX, 75.0, +1, None),
        pytest.param(two_slanted_tendons(), (75.0, 20.0), (+1, -1), None, marks=pytest.mark.slow),
        pytest.param(paper_body("exact", density=1070.0), 60.0, +1, LOADS, marks=pytest.mark.slow),
    ],
    ids=["published", "exact", "helix", "slanted pair", "loads"],
)
def test_numbers_in_single_precision_stay_there(body, tension, direction, loads):
    double = cddf.solve(body, tension, loads, direction=direction)
    ours = cddf.solve(single(body), jnp.asarray(tension, jnp.float32), single(loads), direction=direction)
    assert_all_single(ours)
    np.testing.assert_allclose(ours.tip_tension, double.tip_tension, rtol=SINGLE)
    np.testing.assert_allclose(ours.tip_position, double.tip_position, atol=SINGLE * 0.14)
    np.testing.assert_allclose(ours.tip_angle, double.tip_angle, atol=SINGLE)
    np.testing.assert_allclose(ours.tension, double.tension, rtol=SINGLE)
    assert ours.status == cddf.Status.successful


def test_a_target_in_single_precision():
    """The closed form of docs/theory.md (16), whose G(L) is printed there: T_base = (exp(mu phi(L)) - 1) E / (mu G)."""
    wanted = (np.exp(0.42 * 1.0) - 1) * 1.4e6 / (0.42 * 2.942783188998e4)
    found = cddf.solve(single(paper_body("exact")), single(cddf.TipAngle(1.0)))
    assert_all_single(found)
    np.testing.assert_allclose(found.base_tension, [wanted], rtol=SINGLE)


def test_without_x64_everything_is_single():
    """Against the tip tension printed in docs/theory.md (16)."""
    with jax.enable_x64(False):
        solution = cddf.solve(paper_body("published"), 75.0)
        closed = cddf.closed_form_tension(paper_body("published"), 75.0, 0.14)
        at = solution.at(np.float32(0.07))
    for tree in (solution, closed, at):
        assert_all_single(tree)
    np.testing.assert_allclose(solution.tip_tension, [45.122927013148], rtol=SINGLE)
    np.testing.assert_allclose(closed, 45.122927013148, rtol=SINGLE)


def test_derivatives_in_single_precision():
    """dT_tip/dT_base = (T_tip/T_base)^2 by the closed form."""

    def tip_tension(tension):
        return cddf.solve(single(paper_body("exact")), tension, throw=False).tip_tension[0]

    tension = jnp.asarray(75.0, jnp.float32)
    forward, reverse = jax.jit(lambda t: (jax.jacfwd(tip_tension)(t), jax.grad(tip_tension)(t)))(tension)
    assert forward.dtype == reverse.dtype == jnp.float32
    np.testing.assert_allclose([forward, reverse], (45.122927013148 / 75) ** 2, rtol=SINGLE)
