"""The minimum of a smooth function under smooth limits: SciPy's optimisers, exact derivatives, multipliers as proof."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import NonlinearConstraint, linprog, lsq_linear, minimize
from scipy.sparse.linalg import LinearOperator

TOLERANCE = 1e-6  # scaled: of limits, and of the first-order optimality
ACTIVE = 1e-5  # a margin below it is used up
REFUSED = 1e3  # times the objective: where there is no answer
POLISHING = 50  # iterations


class Point(NamedTuple):
    """All that is known at one point."""

    x: np.ndarray
    objective: float
    gradient: np.ndarray
    inequality: np.ndarray  # may not be negative
    inequality_slopes: np.ndarray  # (rows, unknowns)
    equality: np.ndarray
    equality_slopes: np.ndarray
    usable: bool = True  # false where there is no answer, and the numbers are none

    @property
    def violation(self) -> float:
        """The largest, scaled."""
        return float(max(np.max(-self.inequality, initial=0.0), np.max(np.abs(self.equality), initial=0.0)))


Weights = tuple[float, np.ndarray, np.ndarray]  # of objective, inequalities, equalities


class Function(Protocol):
    """What is to be made small, and its limits."""

    def __call__(self, x: np.ndarray) -> Point: ...

    def curvature(self, x: np.ndarray, weights: Weights, along: np.ndarray) -> np.ndarray:
        """The Hessian product of objective, inequalities and equalities summed with these weights."""
        ...


@dataclass(frozen=True)
class Optimality:
    """The first-order conditions of Karush, Kuhn and Tucker at a point, with the multipliers that meet them best."""

    residual: float  # largest entry of the Lagrangian's gradient, over that of the objective's or 1
    inequality: np.ndarray  # multipliers, zero where a margin is left
    equality: np.ndarray
    lower: np.ndarray  # of the bounds
    upper: np.ndarray
    columns: np.ndarray  # (unknowns, all that is used up): the slopes of inequalities, bounds and equalities, in turn
    least: np.ndarray  # what each of their multipliers may be at least: 0, or -inf of an equality
    active: np.ndarray  # the places of the inequalities among them
    at_lower: np.ndarray  # and of the bounds
    at_upper: np.ndarray

    def range_of(
        self, inequality: Any = 0.0, equality: Any = 0.0, *, lower: Any = 0.0, upper: Any = 0.0
    ) -> tuple[float, float]:
        """The least and the largest of a weighted sum of multipliers that meet the conditions equally well.

        They differ where limits bind at one place: by the theory of the optimal value under a perturbation, giving way
        is then worth the least and tightening costs the largest.

        Args:
            inequality, equality, lower, upper: weights of the multipliers of limits and bounds, one each or for all.
        """
        if self.columns.shape[1] == 0:
            return 0.0, 0.0
        held = (inequality, self.inequality, self.active), (lower, self.lower, self.at_lower)
        held = *held, (upper, self.upper, self.at_upper), (equality, self.equality, slice(None))
        cost = np.concatenate([np.broadcast_to(weights, each.shape)[active] for weights, each, active in held])
        own = np.concatenate([self.inequality[self.active], self.bound_multipliers, self.equality])
        bounds = [(None if np.isinf(low) else low, None) for low in self.least]
        ends = []
        for sign in (1.0, -1.0):
            found = linprog(sign * cost, A_eq=self.columns, b_eq=self.columns @ own, bounds=bounds, method="highs")
            ends.append(sign * found.fun if found.status == 0 else sign * -np.inf)
        return ends[0], ends[1]

    @property
    def bound_multipliers(self) -> np.ndarray:
        """Of the bounds that are reached, lower ones first."""
        return np.concatenate([self.lower[self.at_lower], self.upper[self.at_upper]])


class Local(NamedTuple):
    """Where a search ended."""

    point: Point
    optimality: Optimality
    history: list[tuple[float, float]]  # objective and violation of every iterate
    evaluations: int

    @property
    def feasible(self) -> bool:
        return self.point.violation <= TOLERANCE


Watch = Callable[[int, Point], None]


def minimise(
    function: Function,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    max_iterations: int = 300,
    watch: Watch = lambda count, point: None,
) -> Local:
    """Search from one start, by SLSQP; where it stops short of a stationary point go on with Hessian products.

    Args:
        function: values and exact first derivatives anywhere within the bounds.
        start: (unknowns,), usable.
        lower, upper: bounds of the unknowns, infinite for none.
        max_iterations: of SLSQP.
        watch: called after every iterate.
    """
    seen = _Memory(function, np.clip(start, lower, upper))
    history: list[tuple[float, float]] = []

    def after(x: np.ndarray) -> None:
        point = seen(x)
        history.append((point.objective, point.violation))
        watch(len(history), point)

    with np.errstate(all="ignore"):
        found = minimize(
            lambda x: seen(x).objective,
            np.clip(start, lower, upper),
            jac=lambda x: seen(x).gradient,
            bounds=list(zip(lower, upper, strict=True)),
            constraints=[
                {"type": "ineq", "fun": lambda x: seen(x).inequality, "jac": lambda x: seen(x).inequality_slopes},
                {"type": "eq", "fun": lambda x: seen(x).equality, "jac": lambda x: seen(x).equality_slopes},
            ],
            method="SLSQP",
            callback=after,
            options={"maxiter": max_iterations, "ftol": 1e-14},
        )
    last = seen(np.clip(found.x, lower, upper))
    point = last if last.usable and last.violation <= max(TOLERANCE, seen.best.violation) else seen.best
    local = Local(point, optimality(point, lower, upper), history, seen.count)
    if local.feasible and local.optimality.residual > TOLERANCE:
        local = _polished(seen, local, lower, upper)
    return local._replace(evaluations=seen.count)


class _Memory:
    """The function, asked once at each point; where it has no answer, one that sends the optimiser back."""

    def __init__(self, function: Function, start: np.ndarray):
        self.function, self.count = function, 1
        self.last = self.best = function(start)

    def __call__(self, x: np.ndarray) -> Point:
        if not np.array_equal(x, self.last.x):
            self.count += 1
            self.last = self.function(np.array(x))
            if not self.last.usable:
                wall = abs(self.best.objective) * REFUSED + REFUSED
                self.last = self.best._replace(x=np.array(x), objective=wall, usable=False)
            elif _better(self.last, self.best):
                self.best = self.last
        return self.last


def _better(one: Point, other: Point) -> bool:
    """Less violated; where both keep to the limits, the smaller objective."""
    violations = [max(point.violation, TOLERANCE) for point in (one, other)]
    if violations[0] != violations[1]:
        return violations[0] < violations[1]
    return one.objective < other.objective


def _polished(seen: _Memory, local: Local, lower: np.ndarray, upper: np.ndarray) -> Local:
    """The stationary point on the limits that are used up, by SciPy's trust region and exact Hessian products.

    Kept if it breaks no other limit and is nearer to optimal.
    """
    held = _Held(seen, local)
    if held.free.size == 0:
        return local
    limits: Any = NonlinearConstraint(held.limits, 0.0, 0.0, jac=held.limit_slopes, hess=held.limit_curvature)  # type: ignore[arg-type]
    found = minimize(
        lambda y: held(y).objective,
        held.base[held.free],
        jac=lambda y: held(y).gradient[held.free],
        hess=lambda y: held.product(y, (1.0, *held.no_weights())),
        constraints=[limits] if held.rows.size or local.point.equality.size else [],
        method="trust-constr",
        options={"maxiter": POLISHING, "gtol": 1e-10, "xtol": 1e-14, "initial_tr_radius": 1e-3},
    )
    point = seen(np.clip(held.full(found.x), lower, upper))
    better = local._replace(point=point, optimality=optimality(point, lower, upper))
    good = point.usable and better.feasible and better.optimality.residual < local.optimality.residual
    return better if good else local


class _Held:
    """The function where the limits that are used up stay so, by the unknowns that are on no bound."""

    def __init__(self, seen: _Memory, local: Local):
        self.seen, self.base = seen, local.point.x
        self.rows = np.flatnonzero(local.optimality.inequality > 0)
        self.free = np.flatnonzero((local.optimality.lower <= 0) & (local.optimality.upper <= 0))

    def full(self, y: np.ndarray, elsewhere: float | None = None) -> np.ndarray:
        x = self.base.copy() if elsewhere is None else np.full(self.base.size, elsewhere)
        x[self.free] = np.ravel(y)
        return x

    def __call__(self, y: np.ndarray) -> Point:
        return self.seen(self.full(y))

    def limits(self, y: np.ndarray) -> np.ndarray:
        return np.concatenate([self(y).inequality[self.rows], self(y).equality])

    def limit_slopes(self, y: np.ndarray) -> np.ndarray:
        return np.concatenate([self(y).inequality_slopes[self.rows], self(y).equality_slopes])[:, self.free]

    def no_weights(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.seen.best.inequality.size), np.zeros(self.seen.best.equality.size)

    def limit_curvature(self, y: np.ndarray, multipliers: np.ndarray) -> LinearOperator:
        inequality, _ = self.no_weights()
        inequality[self.rows] = multipliers[: self.rows.size]
        return self.product(y, (0.0, inequality, multipliers[self.rows.size :]))

    def product(self, y: np.ndarray, weights: Weights) -> LinearOperator:
        def along(v: np.ndarray) -> np.ndarray:
            return self.seen.function.curvature(self.full(y), weights, self.full(v, elsewhere=0.0))[self.free]

        size = (self.free.size, self.free.size)
        return LinearOperator(size, matvec=along, dtype=np.float64)  # type: ignore[call-arg]


def optimality(point: Point, lower: np.ndarray, upper: np.ndarray) -> Optimality:
    """The multipliers that come nearest to making the Lagrangian stationary, and how near that is."""
    active = np.flatnonzero(point.inequality <= ACTIVE)
    at_lower, at_upper = np.flatnonzero(point.x <= lower + ACTIVE), np.flatnonzero(point.x >= upper - ACTIVE)
    unit = np.eye(point.x.size)
    rows = [point.inequality_slopes[active], unit[at_lower], -unit[at_upper], point.equality_slopes]
    columns = np.concatenate(rows).T
    count = columns.shape[1] - point.equality.size
    multipliers, least = np.zeros(0), np.concatenate([np.zeros(count), np.full(point.equality.size, -np.inf)])
    if columns.size:
        multipliers = lsq_linear(columns, point.gradient, (least, np.inf), method="bvls", tol=1e-14).x
    left = point.gradient - columns @ multipliers
    parts = np.split(multipliers, np.cumsum([active.size, at_lower.size, at_upper.size]))

    def spread(values: np.ndarray, places: np.ndarray, size: int) -> np.ndarray:
        full = np.zeros(size)
        full[places] = values
        return full

    return Optimality(
        residual=float(np.max(np.abs(left))) / max(1.0, float(np.max(np.abs(point.gradient)))),
        inequality=spread(parts[0], active, point.inequality.size),
        equality=parts[3],
        lower=spread(parts[1], at_lower, point.x.size),
        upper=spread(parts[2], at_upper, point.x.size),
        columns=columns,
        least=least,
        active=active,
        at_lower=at_lower,
        at_upper=at_upper,
    )


class Relaxed:
    """The limits of a function alone: the unknown behind the others is what every one of them may be broken by.

    Its minimum tells the least violation that can be had, and its multipliers which limits are in one another's way.
    """

    def __init__(self, function: Function, rigid: int = 0):
        self.function, self.rigid = function, rigid  # so many inequalities at the end are kept

    def __call__(self, x: np.ndarray) -> Point:
        inner, by = self.function(x[:-1]), x[-1]
        soft = inner.inequality.size - self.rigid
        give = np.concatenate([np.ones(soft), np.zeros(self.rigid)])
        ones = np.ones(inner.equality.size)
        margins = [inner.inequality + by * give, by + inner.equality, by - inner.equality]
        slopes = [
            np.column_stack([inner.inequality_slopes, give]),
            np.column_stack([inner.equality_slopes, ones]),
            np.column_stack([-inner.equality_slopes, ones]),
        ]
        gradient = np.append(np.zeros(x.size - 1), 1.0)
        none = np.zeros((0, x.size))
        return Point(x, by, gradient, np.concatenate(margins), np.concatenate(slopes), np.zeros(0), none, inner.usable)

    def curvature(self, x: np.ndarray, weights: Weights, along: np.ndarray) -> np.ndarray:
        n = self.function(x[:-1])
        rows, zeros = n.inequality.size, n.equality.size
        above, below = weights[1][rows : rows + zeros], weights[1][rows + zeros :]
        inner = self.function.curvature(x[:-1], (0.0, weights[1][:rows], above - below), along[:-1])
        return np.append(inner, 0.0)


def least_violation(function: Function, start: np.ndarray, lower: np.ndarray, upper: np.ndarray, rigid: int) -> Local:
    """The point that breaks the limits least, their largest violation as the objective; of `Relaxed`."""
    relaxed = Relaxed(function, rigid)
    first = np.append(start, function(start).violation)
    return minimise(relaxed, first, np.append(lower, 0.0), np.append(upper, np.inf))
