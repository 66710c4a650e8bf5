"""The optimiser with limits on published problems: Hock and Schittkowski (1981), with their multipliers.

"HS n" is problem n of W. Hock, K. Schittkowski, Test Examples for Nonlinear Programming Codes (1981). Multipliers
follow from the conditions of Karush, Kuhn and Tucker at the published points, written beside them.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cddf_jax.designing.constrained import (
    TOLERANCE,
    Point,
    least_violation,
    local_minimum,
    minimise_constrained,
)

PRINTED = 1e-6  # the book prints seven to nine digits
MULTIPLIERS = 1e-5  # at points right to about 1e-8, of Lagrangians stationary to TOLERANCE


class Written:
    """A problem in plain formulas, its derivatives by JAX; `answers` is false where it has none."""

    def __init__(
        self,
        objective: Callable,
        inequality: Callable = lambda x: x[:0],
        equality: Callable = lambda x: x[:0],
        answers: Callable = lambda x: True,
    ):
        def array(function):
            return lambda x: jnp.stack([*function(x)]) if len(function(x)) else x[:0]

        self.parts = parts = (lambda x: jnp.asarray(objective(x)), array(inequality), array(equality))
        self.answers = answers
        self._values = jax.jit(lambda x: [part(x) for part in parts])
        self._slopes = jax.jit(lambda x: [jax.jacfwd(part)(x) for part in parts])

    def __call__(self, x: np.ndarray) -> Point:
        if not self.answers(x):
            return Point(x, np.nan, *[np.nan * x] * 4, usable=False)
        (f, g, h), (df, dg, dh) = jax.tree.map(np.asarray, (self._values(x), self._slopes(x)))
        equal = np.arange(g.size + h.size) >= g.size
        return Point(np.array(x), float(f), df, np.append(g, h), np.concatenate([dg, dh]), equal)


def on_both_sides(n: int, lower: float = -np.inf, upper: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, lower), np.full(n, upper)


# --- published problems --------------------------------------------------------------------------


def test_hock_schittkowski_71_with_its_multipliers():
    """HS 71: f = 17.0140173 at (1, 4.7429994, 3.8211503, 1.3794082); a product, a sphere and a bound hold it."""
    problem = Written(
        lambda x: x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2],
        lambda x: [x[0] * x[1] * x[2] * x[3] - 25.0],
        lambda x: [x @ x - 40.0],
    )
    found = minimise_constrained(problem, np.array([1.0, 5.0, 5.0, 1.0]), *on_both_sides(4, 1.0, 5.0))
    best = np.array([1.0, 4.7429994, 3.8211503, 1.3794082])
    assert found.point.objective == pytest.approx(17.0140173, rel=PRINTED / 100)
    assert found.point.x == pytest.approx(best, rel=PRINTED)
    assert found.feasible
    assert found.residual <= TOLERANCE
    # stationary in x2 and x3, which are on no bound: two equations for the multipliers of product and sphere
    x1, x2, x3, x4 = best
    product, sphere = np.linalg.solve(
        [[x1 * x3 * x4, 2 * x2], [x1 * x2 * x4, 2 * x3]],
        [x1 * x4, x1 * x4 + 1],
    )
    bound = x4 * (2 * x1 + x2 + x3) - product * x2 * x3 * x4 - sphere * 2 * x1
    assert found.limits == pytest.approx([product, sphere], rel=MULTIPLIERS)
    assert found.lower == pytest.approx([bound, 0, 0, 0], rel=MULTIPLIERS)
    assert not np.any(found.upper)


def test_rosen_suzuki_with_its_multipliers():
    """HS 43: f = -44 at (0, 1, 2, -1). There grad f = (-5, -3, -13, 5) = 1 (-1, -1, -5, 3) + 2 (-2, -1, -4, 1)."""
    problem = Written(
        lambda x: x @ (jnp.array([1.0, 1, 2, 1]) * x) + jnp.array([-5.0, -5, -21, 7]) @ x,
        lambda x: [
            8 - x @ x - jnp.array([1.0, -1, 1, -1]) @ x,
            10 - x @ (jnp.array([1.0, 2, 1, 2]) * x) + x[0] + x[3],
            5 - x @ (jnp.array([2.0, 1, 1, 0]) * x) - 2 * x[0] + x[1] + x[3],
        ],
    )
    nowhere = on_both_sides(4)
    found = minimise_constrained(problem, np.zeros(4), *nowhere)
    assert found.point.objective == pytest.approx(-44.0, rel=1e-9)
    assert found.point.x == pytest.approx([0, 1, 2, -1], abs=PRINTED)
    assert found.limits == pytest.approx([1, 0, 2], abs=MULTIPLIERS)
    assert found.residual <= TOLERANCE
    # at the origin no limit is used up, so the residual is the gradient (-5, -5, -21, 7) over its largest entry
    assert local_minimum(problem(np.zeros(4)), *nowhere).residual == pytest.approx(1.0, rel=1e-12)


# --- where it is hard ----------------------------------------------------------------------------


def test_where_there_is_no_answer_it_turns_back():
    """100 x - ln x, none for x <= 0: the first step from 1 goes to about -98; its minimum is at 0.01, 1 + ln 100."""
    seen = []

    def answers(x):
        seen.append(bool(x[0] > 0))
        return seen[-1]

    problem = Written(lambda x: 100 * x[0] - jnp.log(x[0]), answers=answers)
    found = minimise_constrained(problem, np.ones(1), *on_both_sides(1))
    assert not all(seen)  # it has been where there is none
    assert found.point.usable
    assert found.point.objective == pytest.approx(1 + np.log(100), rel=1e-10)
    assert found.point.x == pytest.approx([0.01], rel=1e-5)


# --- limits in one another's way -----------------------------------------------------------------


def test_the_least_violation_of_a_line_and_a_disc():
    """The line x + y >= 3, the disc x^2 + y^2 <= 2: x = y = a with 2 a = 3 - t and 2 a^2 = 2 + t, t = 4 - sqrt(11).

    The multipliers add up to 1 and balance: p (1, 1) = q 2 a (1, 1).
    """
    crossed, nowhere = Written(lambda x: x[0], lambda x: [x[0] + x[1] - 3.0, 2.0 - x @ x]), on_both_sides(2)
    least = 4 - np.sqrt(11.0)
    a = (3 - least) / 2
    found = least_violation(crossed, np.array([3.0, 0.0]), *nowhere)
    assert found.point.objective == pytest.approx(least, rel=1e-7)
    assert found.point.x == pytest.approx([a, a, least], abs=1e-5)
    assert found.limits == pytest.approx([2 * a / (1 + 2 * a), 1 / (1 + 2 * a)], rel=1e-5)
    assert found.residual <= TOLERANCE
    stuck = minimise_constrained(crossed, np.array([3.0, 0.0]), *nowhere)
    assert not stuck.feasible
    assert stuck.point.violation >= least - 1e-9  # no point breaks them less


def test_the_least_violation_of_an_equation_beyond_the_bounds():
    """The line x + y = 3 with both at most 1 is missed by 1, at the upper bounds, with multipliers 1."""
    problem = Written(lambda x: x[0], equality=lambda x: [x[0] + x[1] - 3.0])
    found = least_violation(problem, np.array([0.2, 0.7]), *on_both_sides(2, 0.0, 1.0))
    assert found.point.objective == pytest.approx(1.0, rel=1e-9)
    assert found.point.x == pytest.approx([1.0, 1.0, 1.0], abs=1e-8)
    assert found.limits == pytest.approx([1.0, 0.0], abs=1e-8)
    assert found.upper[:2] == pytest.approx([1.0, 1.0], abs=1e-8)


def test_a_bound_and_a_limit_at_one_point_share_their_multiplier():
    """The least x with x >= 0 twice, as a bound and as a limit: any two multipliers with the sum 1 meet the conditions,
    so that only relaxing both has a price. The term 2 y with y >= 0 has one bound, with the multiplier 2."""
    problem = Written(lambda x: x[0] + 2 * x[1], lambda x: (x[0],))
    held = local_minimum(problem(np.zeros(2)), *on_both_sides(2, 0.0, np.inf))
    assert held.residual < TOLERANCE
    first, second = np.eye(2)
    assert np.isnan(held.price(lower=first))
    assert np.isnan(held.price(1.0))
    assert held.price(1.0, lower=first) == pytest.approx(1.0, abs=1e-9)
    assert held.price(lower=second) == pytest.approx(2.0, abs=1e-9)
    assert held.price(upper=1.0) == pytest.approx(0.0, abs=1e-9)


def test_a_search_that_creeps_along_a_limit_is_stopped_at_its_best_point():
    """Maratos's example: (r^2 - 1) - x / 1000 outside of the circle r = 1 is least at (1, 0).

    A step along the tangent leaves the circle, which costs more than it gains, so that steps stay small.
    """
    creeping, start = Written(lambda x: x @ x - 1 - x[0] / 1000, lambda x: [x @ x - 1]), np.array([0.6, 0.8])
    found = minimise_constrained(creeping, start, *on_both_sides(2, -3.0, 3.0))
    assert not found.stationary
    assert found.feasible
    assert -1e-3 < found.point.objective < -0.6e-3
