"""The likelihood along one parameter: held at value after value, with all others fitted again.

Where the curvature at the minimum suggests an interval that the data do not close, the profile shows it.
Many values are searched at once, as lanes of one batch.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .levenberg_marquardt import Minimum, minimise_all
from .parameter_space import TINY, ParameterSpace
from .robust_loss import LOSSES

LANES = 16  # on each side
NEAR = np.array([0.15, 0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.35, 1.7, 2.5])  # half-widths of the 95 % interval off
FAR = np.array([1.5, 3.0, 10.0, 30.0, 100.0, 1000.0])  # times the parameter's size beyond these
NARROW = 0.01  # of its distance from the estimate: a bracket about an end that needs no refinement
BESIDE = 0.02  # of the way from a guess of the end to the ends of its bracket
MOST_REFINEMENTS = 6
MAX_STEPS = 100  # of each search: along a flat valley it would go on in tiny steps
CONTINUATIONS = 5  # of a search that is still above the threshold; after these it is left out


class Profile(NamedTuple):
    """One parameter's profile; rows by increasing value."""

    name: str
    value: np.ndarray
    rise: np.ndarray  # of the sum of squares over its minimum; inf where the model ends
    others: np.ndarray  # (values, parameters): all parameters, refitted
    names: tuple[str, ...]  # of the columns
    threshold: float  # the rise that ends the 95 % interval
    confidence_interval: tuple[float, float]  # a side that does not close ends at the bound, infinity or model's end
    closed: tuple[bool, bool]  # below, above: by the data
    model_ends: tuple[bool, bool]  # below, above: the model has no solution beyond, and the data did not close before


def profile_likelihood(minimum: Minimum, name: str, standard_error: float, quantile: float) -> Profile:
    """Profile one parameter, out to where its 95 % interval closes, or to its bounds.

    The noise is held at its estimate: for a linear model the interval is the t interval.

    Args:
        minimum: where the fit ended.
        name: of the parameter.
        standard_error: a first guess of its precision, may be infinite.
        quantile: half-width of a 95 % interval over its standard error.
    """
    best, space = minimum.outcome, minimum.problem.space
    i = space.names.index(name)
    walk = _Walk(minimum, i, quantile**2 * _stretch(minimum))
    size = float(max(best.size[i], space.scale[i]) if space.at_bound(best.parameters)[i] else best.size[i])
    half_width = min(quantile * standard_error, size)
    found = _Points(np.array([walk.estimate]), np.zeros(1), best.z[None], best.parameters[None])
    for distances in (NEAR * half_width, NEAR[-1] * half_width + FAR * size):
        still_open = [sign for sign in (-1, +1) if walk.crossing(found, sign) is None]
        places = [place for sign in still_open for place in walk.ladder(sign * distances)]
        for begin in (walk.nearest, walk.ahead):  # a valley that a search jumps out of is followed by the other
            found = found.join(walk.search(places, [begin(found, place) for place in places]))
    for _ in range(MOST_REFINEMENTS):
        places = [place for sign in (-1, +1) for place in walk.around_crossing(found, sign)]
        if not places:
            break
        found = found.join(walk.search(places, [walk.nearest(found, place) for place in places]))
    low, low_closed, low_ends = walk.end(found, -1, float(space.lower[i]))
    high, high_closed, high_ends = walk.end(found, +1, float(space.upper[i]))
    return Profile(
        name, found.value, found.rise, found.parameters, space.names, walk.threshold,
        confidence_interval=(low, high),
        closed=(low_closed, high_closed),
        model_ends=(low_ends, high_ends),
    )  # fmt: skip


def _stretch(minimum: Minimum) -> float:
    """The mean rise, over that of least squares, at one standard error: mean psi^2 over mean psi' (Huber 1981)."""
    problem, best = minimum
    if problem.loss == "linear":
        return 1.0
    kind, residual = LOSSES[problem.loss], best.residual[: problem.num_data]
    spread = np.sum(kind.influence(residual) ** 2) / max(residual.size - best.z.size, 1)
    return float(spread / max(np.mean(kind.slope(residual)), TINY))


class _Points(NamedTuple):
    """Places of the profile that are known, by increasing value."""

    value: np.ndarray
    rise: np.ndarray
    z: np.ndarray
    parameters: np.ndarray

    def join(self, other: "_Points") -> "_Points":
        """Both, and of equal values the lower one."""
        both = _Points(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))
        order = np.lexsort([both.rise, both.value])
        both = _Points(*(x[order] for x in both))
        first = np.append(True, np.diff(both.value) > 0)
        return _Points(*(x[first] for x in both))


class _Crossing(NamedTuple):
    """Between which values the profile first crosses the threshold, and where a line through the roots would."""

    inner: float
    outer: float
    guess: float


@dataclass(frozen=True)
class _Walk:
    """The way from the estimate of parameter i to where the sum of squares has risen by the threshold."""

    minimum: Minimum
    i: int
    threshold: float

    @property
    def space(self) -> ParameterSpace:
        return self.minimum.problem.space

    @property
    def estimate(self) -> float:
        return float(self.minimum.outcome.parameters[self.i])

    def ladder(self, distances: np.ndarray) -> np.ndarray:
        """Places on one side, ever farther off, inside the bounds."""
        places = self.estimate + distances
        bound = float(self.space.upper[self.i] if distances[-1] > 0 else self.space.lower[self.i])
        if np.isfinite(bound):  # ever nearer to the bound instead
            beyond = np.abs(places - self.estimate) > 0.8 * abs(bound - self.estimate)
            rungs = bound - (bound - self.estimate) * np.geomspace(0.2, 1e-4, max(int(beyond.sum()), 1))
            places[beyond] = rungs[: beyond.sum()]
        return places

    def nearest(self, known: _Points, place: float) -> np.ndarray:
        """Where to begin a search, z: where that of the nearest place towards the estimate ended."""
        there = self._inward(known, place, np.finfo(float).max)
        return known.z[there[0] if there.size else 0]

    def ahead(self, known: _Points, place: float) -> np.ndarray:
        """The same on the straight line from the estimate through the nearest place within the interval, in z."""
        there = self._inward(known, place, self.threshold)
        if there.size < 2:  # the estimate itself is one of them
            return self.nearest(known, place)
        near, far = known.z[there[0]], known.z[there[-1]]
        at = self.space.inverse(self.i, np.array([place, known.value[there[0]], known.value[there[-1]]]))
        return near + (near - far) * (at[0] - at[1]) / (at[1] - at[2])

    def _inward(self, known: _Points, place: float, most: float) -> np.ndarray:
        """The known rows between a place and the estimate whose rise is not over the most, the nearest first."""
        inward = (known.value - place) * np.sign(self.estimate - place) > 0
        there = np.flatnonzero(inward & (known.rise <= most))
        return there[np.argsort(np.abs(known.value[there] - place), kind="stable")]

    def search(self, wanted: list[float], starts: list[np.ndarray]) -> _Points:
        """Fit all others with the parameter held, each search from a start of its own, all in one batch.

        A search that ran out of steps bounds the rise from above only: it goes on while the rise is over the threshold.
        """
        problem, best = self.minimum
        if not wanted:
            return _Points(np.empty(0), np.empty(0), best.z[None][:0], best.parameters[None][:0])
        places = np.resize(wanted, 2 * LANES)  # always as many, so that nothing is compiled anew
        z = np.resize(np.stack(starts), (places.size, best.z.size))
        held = np.full(z.shape, np.nan)
        held[:, self.i] = places
        problem = replace(problem, max_steps=MAX_STEPS)
        there, rounds_left = minimise_all(problem, z, held), CONTINUATIONS
        while np.any(creeping := ~there.solved & (there.cost - best.cost > self.threshold)) and rounds_left:
            there, rounds_left = minimise_all(problem, there.z, held), rounds_left - 1
        rise = np.where(np.isfinite(there.cost), there.cost - best.cost, np.inf)
        kept = ~creeping | np.isinf(rise)
        return _Points(*(x[kept] for x in (places, rise, there.z, there.parameters)))

    def crossing(self, found: _Points, sign: int) -> _Crossing | None:
        """On one side of the estimate, -1 or +1; None where the profile stays below the threshold."""
        side = sign * (found.value - self.estimate) >= 0
        order = np.argsort(np.abs(found.value[side] - self.estimate), kind="stable")
        value, root = found.value[side][order], np.sqrt(np.maximum(found.rise[side][order], 0.0))
        over = np.flatnonzero(root > np.sqrt(self.threshold))
        if over.size == 0:
            return None
        k = over[0]
        inner, outer = float(value[k - 1]), float(value[k])
        if not np.isfinite(root[k]):  # the model ends between the two
            return _Crossing(inner, outer, inner)
        part = (np.sqrt(self.threshold) - root[k - 1]) / (root[k] - root[k - 1])
        return _Crossing(inner, outer, float(inner + part * (outer - inner)))

    def around_crossing(self, found: _Points, sign: int) -> np.ndarray:
        """Places that narrow a crossing; none where it is narrow enough."""
        crossing = self.crossing(found, sign)
        if crossing is None:
            return np.empty(0)
        inner, outer, guess = crossing
        if abs(outer - inner) < NARROW * abs(outer - self.estimate):
            return np.empty(0)
        close = [(1 - BESIDE) * guess + BESIDE * end for end in crossing[:2]]
        spots = np.append(np.linspace(inner, outer, 9)[1:-1], [guess, *close])
        return np.unique(spots[(spots - inner) * (spots - outer) < 0])

    def end(self, found: _Points, sign: int, bound: float) -> tuple[float, bool, bool]:
        """Where the interval ends on one side, whether the data make this end, and whether the end of the model does.

        It is the bound where the likelihood does not close the interval.
        """
        crossing = self.crossing(found, sign)
        if crossing is None or not np.any(np.isfinite(found.rise[found.value != self.estimate])):
            return bound, False, False
        ends = bool(np.isinf(found.rise[found.value == crossing.outer][0]))
        return crossing.guess, not ends, ends
