"""The minimum of a smooth function under smooth limits: SciPy's SLSQP with exact derivatives, checked by multipliers.

The multipliers are computed here. SciPy's SLSQP returns no multipliers of bounds, and the others of its last step only.
Here they are needed at any point, also where several sets of multipliers satisfy the conditions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.optimize import linprog, lsq_linear, minimize

TOLERANCE = 1e-6  # scaled: of limits, and of the first-order optimality
ACTIVE = 1e-5  # scaled: a limit or bound with a smaller margin is active
REFUSED = 1e3  # times the objective: the value where the function has no answer
RUNS = 4  # of SLSQP; each starts where the one before ended

Vector = Float[np.ndarray, " _"]
Matrix = Float[np.ndarray, "_ _"]


class Point(NamedTuple):
    """Values and derivatives at one point."""

    x: Vector
    objective: float
    gradient: Vector
    inequality: Vector  # may not be negative
    inequality_slopes: Matrix
    equality: Vector  # must be zero
    equality_slopes: Matrix
    usable: bool = True  # false where the function has no answer

    @property
    def violation(self) -> float:
        """The largest violation of a limit, scaled."""
        return float(max(np.max(-self.inequality, initial=0.0), np.max(np.abs(self.equality), initial=0.0)))


@dataclass(frozen=True)
class Optimality:
    """The first-order conditions of Karush, Kuhn and Tucker at a point, with the multipliers that satisfy them best."""

    residual: float  # largest entry of the Lagrangian's gradient, over that of the objective's or 1
    inequality: Vector  # multipliers, zero where there is a margin
    lower: Vector  # of the bounds
    upper: Vector
    equality: Vector
    active: np.ndarray  # indices of the active limits among inequalities, lower bounds, upper bounds, equalities
    slopes: Matrix  # of the active limits

    def range_of(
        self,
        inequality: ArrayLike = 0.0,
        equality: ArrayLike = 0.0,
        *,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = 0.0,
    ) -> tuple[float, float]:
        """The smallest and the largest weighted sum of multipliers that satisfy the conditions equally well.

        They differ where the active limits do not determine the multipliers uniquely. The optimal value then changes
        differently to both sides: relaxing the limits gains the smallest sum, tightening them costs the largest sum.

        Args:
            inequality, equality, lower, upper: weights of the multipliers of limits and bounds; a number for all of
                one kind, or one for each.
        """
        if not self.active.size:
            return 0.0, 0.0
        multipliers = self.inequality, self.lower, self.upper, self.equality
        given = zip((inequality, lower, upper, equality), multipliers, strict=True)
        cost = np.concatenate([np.broadcast_to(np.asarray(weights), own.shape) for weights, own in given])[self.active]
        own = np.concatenate(multipliers)[self.active]
        signed = self.active < sum(map(len, multipliers)) - self.equality.size  # an equality's may be negative
        options = {
            "A_eq": self.slopes.T,
            "b_eq": self.slopes.T @ own,
            "bounds": [(0.0 if positive else None, None) for positive in signed],
        }
        least, most = linprog(cost, **options), linprog(-cost, **options)
        return least.fun if least.status == 0 else -np.inf, -most.fun if most.status == 0 else np.inf


class LocalMinimum(NamedTuple):
    """Where a search ended."""

    point: Point
    optimality: Optimality
    history: list[tuple[float, float]]  # objective and violation of every iterate
    evaluations: int

    @property
    def feasible(self) -> bool:
        return self.point.violation <= TOLERANCE


VectorFunction = Callable[[Vector], Point]  # an objective and its limits, with derivatives
AfterIteration = Callable[[int, Point], None]


def minimise_constrained(
    function: VectorFunction,
    start: Vector,
    lower: Vector,
    upper: Vector,
    *,
    max_iterations: int = 300,
    after: AfterIteration = lambda count, point: None,
) -> LocalMinimum:
    """Search from one start with SLSQP, which starts again where it ended before it reached a stationary point.

    Args:
        function: values and exact first derivatives anywhere within the bounds.
        start: (unknowns,), usable.
        lower, upper: bounds of the unknowns, infinite for none.
        max_iterations: of all runs of SLSQP together.
        after: called after every iteration with its number and its point.
    """
    seen = _Seen(function, np.clip(start, lower, upper))
    history: list[tuple[float, float]] = []

    def iterated(x: Vector) -> None:
        point = seen(x)
        history.append((point.objective, point.violation))
        after(len(history), point)

    def run(x: Vector) -> LocalMinimum:
        with np.errstate(all="ignore"):
            found = minimize(
                lambda x: seen(x).objective,
                x,
                jac=lambda x: seen(x).gradient,
                bounds=list(zip(lower, upper, strict=True)),
                constraints=[
                    {"type": "ineq", "fun": lambda x: seen(x).inequality, "jac": lambda x: seen(x).inequality_slopes},
                    {"type": "eq", "fun": lambda x: seen(x).equality, "jac": lambda x: seen(x).equality_slopes},
                ],
                method="SLSQP",
                callback=iterated,
                options={"maxiter": max_iterations - len(history), "ftol": 1e-14},
            )
        last = seen(np.clip(found.x, lower, upper))
        point = last if last.usable and last.violation <= max(TOLERANCE, seen.best.violation) else seen.best
        return LocalMinimum(point, optimality(point, lower, upper), history, seen.count)

    local = run(np.clip(start, lower, upper))
    for _ in range(RUNS - 1):
        if not local.feasible or local.optimality.residual <= TOLERANCE or len(history) >= max_iterations:
            break
        local = run(local.point.x)
    return local


class _Seen:
    """The function, evaluated once at each point.

    Where it has no answer, a large objective and the slopes of the point before make the optimiser go back.
    """

    def __init__(self, function: VectorFunction, start: Vector):
        self.function, self.count = function, 1
        self.last = self.best = function(start)

    def __call__(self, x: Vector) -> Point:
        if not np.array_equal(x, self.last.x):
            self.count += 1
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


def optimality(point: Point, lower: Vector, upper: Vector) -> Optimality:
    """The multipliers that make the gradient of the Lagrangian smallest, and the size of that gradient."""
    unit = np.eye(point.x.size)
    margins = [point.inequality, point.x - lower, upper - point.x, np.zeros(point.equality.size)]
    slopes = np.concatenate([point.inequality_slopes, unit, -unit, point.equality_slopes])
    active = np.flatnonzero(np.concatenate(margins) <= ACTIVE)
    least = np.where(active < len(slopes) - point.equality.size, 0.0, -np.inf)
    multipliers = np.zeros(len(slopes))
    if active.size:
        fit = lsq_linear(slopes[active].T, point.gradient, (least, np.inf), method="bvls", tol=1e-14)
        multipliers[active] = fit.x
    left = float(np.max(np.abs(point.gradient - multipliers @ slopes)))
    parts = np.split(multipliers, np.cumsum([part.size for part in margins[:-1]]))
    inequality, at_lower, at_upper, equality = parts
    residual = left / max(1.0, float(np.max(np.abs(point.gradient))))
    return Optimality(residual, inequality, at_lower, at_upper, equality, active, slopes[active])


def relaxed(function: VectorFunction, rigid: int = 0) -> VectorFunction:
    """The problem of the least violation: one more unknown, the last, by which each limit may be violated.

    The objective is this unknown. Its minimum is the least violation possible, and the multipliers there show which
    limits contradict each other. The inequalities are those of the function, then its equalities from above, then
    from below.

    Args:
        function: whose limits are relaxed.
        rigid: how many inequalities, the last ones, may not be violated.
    """

    def values(x: Vector) -> Point:
        inner, by = function(x[:-1]), float(x[-1])
        soft = inner.inequality.size - rigid
        give = np.concatenate([np.ones(soft), np.zeros(rigid), np.ones(2 * inner.equality.size)])
        margins = np.concatenate([inner.inequality, inner.equality, -inner.equality]) + by * give
        slopes = np.concatenate([inner.inequality_slopes, inner.equality_slopes, -inner.equality_slopes])
        gradient = np.append(np.zeros(x.size - 1), 1.0)
        none = np.zeros((0, x.size))
        return Point(x, by, gradient, margins, np.column_stack([slopes, give]), np.zeros(0), none, inner.usable)

    return values


def least_violation(function: VectorFunction, start: Vector, lower: Vector, upper: Vector, rigid: int) -> LocalMinimum:
    """The minimum of `relaxed`: the point that violates the limits least. Its objective is the largest violation."""
    first = np.append(start, function(start).violation)
    return minimise_constrained(relaxed(function, rigid), first, np.append(lower, 0.0), np.append(upper, np.inf))
