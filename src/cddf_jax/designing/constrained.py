"""The minimum of a smooth function under smooth limits: SciPy's SLSQP with exact derivatives, checked by multipliers.

The multipliers are computed here. SciPy's SLSQP returns no multipliers of bounds, and the others of its last step only.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.optimize import linprog, lsq_linear, minimize

TOLERANCE = 1e-6  # scaled: of limits, and of the first-order optimality
ACTIVE = 1e-5  # scaled: a limit or bound with a smaller margin is active
UNIQUE = 1e-5  # relative: multipliers that differ by less are the same
REFUSED = 1e3  # times the objective: the value where the function has no answer
ITERATIONS = 200  # of one search, at most
OUT_OF_STEPS = 9  # status of SLSQP at the largest number of iterations: its last point was only tried

Vector = Float[np.ndarray, " _"]
Matrix = Float[np.ndarray, "_ _"]


class Point(NamedTuple):
    """Values and derivatives at one point."""

    x: Vector
    objective: float
    gradient: Vector
    margins: Vector  # of the limits: may not be negative, and of an equation must be zero
    slopes: Matrix  # of the margins
    equal: np.ndarray  # which limits are equations
    usable: bool = True  # false where the function has no answer

    @property
    def violation(self) -> float:
        """The largest violation of a limit, scaled."""
        return float(np.max(np.where(self.equal, np.abs(self.margins), -self.margins), initial=0.0))


class LocalMinimum(NamedTuple):
    """Where a search ended, with the multipliers that satisfy the conditions of Karush, Kuhn and Tucker best there."""

    point: Point
    residual: float  # largest entry of the Lagrangian's gradient, over that of the objective's or 1
    limits: Vector  # multipliers, zero where there is a margin
    lower: Vector  # of the bounds
    upper: Vector
    active: np.ndarray  # indices of the active ones among limits, lower bounds, upper bounds
    slopes: Matrix  # of the active ones
    least: Vector  # of the active multipliers: 0, or of an equation minus infinity

    @property
    def feasible(self) -> bool:
        return self.point.violation <= TOLERANCE

    @property
    def stationary(self) -> bool:
        return self.residual <= TOLERANCE

    def price(self, limits: ArrayLike = 0.0, *, lower: ArrayLike = 0.0, upper: ArrayLike = 0.0) -> float:
        """A weighted sum of multipliers: how much the objective becomes smaller if limits are relaxed by the weights.

        NaN if several sets of multipliers satisfy the conditions and give different sums: the best objective has a
        kink there. The weights are a number for all limits of one kind, or one for each.
        """
        if not self.active.size:
            return 0.0
        multipliers = self.limits, self.lower, self.upper
        given = zip((limits, lower, upper), multipliers, strict=True)
        cost = np.concatenate([np.broadcast_to(np.asarray(weights), own.shape) for weights, own in given])[self.active]
        options = {
            "A_eq": self.slopes.T,
            "b_eq": self.slopes.T @ np.concatenate(multipliers)[self.active],
            "bounds": [(least, None) for least in self.least],
        }
        least, most = linprog(cost, **options), linprog(-cost, **options)
        if least.status != 0 or most.status != 0:
            return np.nan
        return least.fun if -most.fun - least.fun <= UNIQUE * max(1.0, abs(least.fun), abs(most.fun)) else np.nan


VectorFunction = Callable[[Vector], Point]  # an objective and its limits, with derivatives


def minimise_constrained(function: VectorFunction, start: Vector, lower: Vector, upper: Vector) -> LocalMinimum:
    """Search from one start with SLSQP.

    Args:
        function: values and exact first derivatives anywhere within the bounds.
        start: (unknowns,), usable.
        lower, upper: bounds of the unknowns, infinite for none.
    """
    seen = _Seen(function, np.clip(start, lower, upper))
    equal = seen.last.equal
    with np.errstate(all="ignore"):
        found = minimize(
            lambda x: seen(x).objective,
            seen.last.x,
            jac=lambda x: seen(x).gradient,
            bounds=list(zip(lower, upper, strict=True)),
            constraints=[
                {"type": "ineq", "fun": lambda x: seen(x).margins[~equal], "jac": lambda x: seen(x).slopes[~equal]},
                {"type": "eq", "fun": lambda x: seen(x).margins[equal], "jac": lambda x: seen(x).slopes[equal]},
            ],
            method="SLSQP",
            options={"maxiter": ITERATIONS, "ftol": 1e-14},
        )
        last, most = seen(np.clip(found.x, lower, upper)), max(TOLERANCE, seen.best.violation)
    done = found.status != OUT_OF_STEPS and last.usable and last.violation <= most
    return local_minimum(last if done else seen.best, lower, upper)


class _Seen:
    """The function, evaluated once at each point.

    Where it has no answer, a large objective and the slopes of the best point make the optimiser go back.
    """

    def __init__(self, function: VectorFunction, start: Vector):
        self.function = function
        self.last = self.best = function(start)

    def __call__(self, x: Vector) -> Point:
        if not np.array_equal(x, self.last.x):
            self.last = self.function(np.array(x))
            if not self.last.usable:
                wall = abs(self.best.objective) * REFUSED + REFUSED
                self.last = self.best._replace(x=np.array(x), objective=wall, usable=False)
            elif _rank(self.last) < _rank(self.best):
                self.best = self.last
        return self.last


def _rank(point: Point) -> tuple[float, float]:
    """Smaller is better: first the violation; where both satisfy the limits, the objective."""
    return max(point.violation, TOLERANCE), point.objective


def local_minimum(point: Point, lower: Vector, upper: Vector) -> LocalMinimum:
    """The multipliers that make the gradient of the Lagrangian smallest, and the size of that gradient."""
    unit, count = np.eye(point.x.size), point.margins.size
    slopes = np.concatenate([point.slopes, unit, -unit])
    margins = np.concatenate([point.margins, point.x - lower, upper - point.x])
    equal = np.pad(point.equal, (0, 2 * point.x.size))
    active = np.flatnonzero(equal | (margins <= ACTIVE))
    least = np.where(equal[active], -np.inf, 0.0)
    multipliers = np.zeros(margins.size)
    if active.size:
        fit = lsq_linear(slopes[active].T, point.gradient, (least, np.inf), method="bvls", tol=1e-14)
        multipliers[active] = fit.x
    left = float(np.max(np.abs(point.gradient - multipliers @ slopes)))
    residual = left / max(1.0, float(np.max(np.abs(point.gradient))))
    limits, *bounds = np.split(multipliers, [count, count + point.x.size])
    return LocalMinimum(point, residual, limits, bounds[0], bounds[1], active, slopes[active], least)


def least_violation(function: VectorFunction, start: Vector, lower: Vector, upper: Vector) -> LocalMinimum:
    """The point that violates the limits least; its objective is the largest violation there.

    One more unknown, the last, is how much each limit may be violated, and this unknown is made small. The multipliers
    show which limits contradict each other: first those of all limits, then of the equations from below.
    """

    def relaxed(x: Vector) -> Point:
        inner, by = function(x[:-1]), float(x[-1])
        margins = np.append(inner.margins, -inner.margins[inner.equal]) + by
        slopes = np.concatenate([inner.slopes, -inner.slopes[inner.equal]])
        slopes = np.column_stack([slopes, np.ones(margins.size)])
        return Point(x, by, np.eye(x.size)[-1], margins, slopes, np.zeros(margins.size, bool), inner.usable)

    first = np.append(start, function(start).violation)
    return minimise_constrained(relaxed, first, np.append(lower, 0.0), np.append(upper, np.inf))
