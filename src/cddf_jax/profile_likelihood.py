"""The likelihood along one parameter: held at value after value, with all others fitted again.

Where the curvature at the minimum feigns an interval that the data do not close, the profile shows it.
Many values are searched at once, as lanes of one batch.
"""

from typing import NamedTuple

import numpy as np

from .levenberg_marquardt import LeastSquaresProblem, Outcome, minimise_all
from .parameter_space import Space
from .robust_loss import loss_of

LANES = 16  # on each side
NEAR = np.array([0.15, 0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.35, 1.7, 2.5])  # half-widths of the 95 % interval off
FAR = np.array([1.5, 3.0, 10.0, 30.0, 100.0, 1000.0])  # times the parameter's size beyond these
NARROW = 0.01  # of its distance from the estimate: a bracket about an end that needs no refinement
MOST_REFINEMENTS = 6
MAX_STEPS = 100  # of each search: along a flat valley it would creep on
CONTINUATIONS = 5  # of a search that creeps on above the threshold; after these it tells nothing


class Profile(NamedTuple):
    """One parameter's profile; rows by increasing value."""

    name: str
    value: np.ndarray
    rise: np.ndarray  # of the sum of squares over its minimum; inf where the model ends
    others: np.ndarray  # (values, parameters): all parameters, refitted
    names: tuple[str, ...]  # of the columns
    threshold: float  # the rise that ends the 95 % interval
    confidence_interval: tuple[float, float]  # where it does not close the bound, infinity, or where the model ends
    closed: tuple[bool, bool]  # below, above: by the data
    model_ends: tuple[bool, bool]  # below, above: there is no solution beyond, and the data have not spoken before


def profile_likelihood(
    problem: LeastSquaresProblem,
    noise: tuple[np.ndarray, ...],
    best: Outcome,
    names: tuple[str, ...],
    name: str,
    standard_error: float,
    quantile: float,
) -> Profile:
    """Profile one parameter, out to where its 95 % interval closes, or to its bounds.

    The noise is held at its estimate: for a linear model the interval is the t interval.

    Args:
        problem, noise, best: a fit, and where it ended.
        names: of the parameters.
        name: which one.
        standard_error: a first guess of its precision, may be infinite.
        quantile: half-width of a 95 % interval over its standard error.
    """
    i = names.index(name)
    estimate, space = float(best.parameters[i]), problem.space
    threshold = quantile**2 * _stretch(problem, best)
    size = float(max(best.size[i], space.scale[i]) if space.at_bound(best.parameters)[i] else best.size[i])
    half_width = min(quantile * standard_error, size)
    found = _Row(np.array([estimate]), np.zeros(1), best.z[None], best.parameters[None])
    for distances in (NEAR * half_width, NEAR[-1] * half_width + FAR * size):
        still_open = [sign for sign in (-1, +1) if _crossing(found, estimate, sign, threshold) is None]
        places = [x for sign in still_open for x in _ladder(space, i, estimate, sign * distances)]
        for begin in (_nearest, _ahead):  # a valley that a search jumps out of is followed by the other
            starts = [begin(found, space, i, estimate, place, threshold) for place in places]
            found = _join(found, _search(problem, noise, best, i, places, starts, threshold))
    for _ in range(MOST_REFINEMENTS):
        places = [x for sign in (-1, +1) for x in _around_crossing(found, estimate, sign, threshold)]
        if not places:
            break
        starts = [_nearest(found, space, i, estimate, place, threshold) for place in places]
        found = _join(found, _search(problem, noise, best, i, places, starts, threshold))
    below = _end(found, estimate, -1, threshold, float(space.lower[i]))
    above = _end(found, estimate, +1, threshold, float(space.upper[i]))
    return Profile(
        name, found.value, found.rise, found.parameters, names, threshold,
        confidence_interval=(below.value, above.value),
        closed=(below.closed, above.closed),
        model_ends=(below.model_ends, above.model_ends),
    )  # fmt: skip


class _Row(NamedTuple):
    value: np.ndarray
    rise: np.ndarray
    z: np.ndarray
    parameters: np.ndarray


def _stretch(problem: LeastSquaresProblem, best: Outcome) -> float:
    """The mean rise, over that of least squares, at one standard error: mean psi^2 over mean psi' (Huber 1981)."""
    if problem.loss == "linear":
        return 1.0
    kind, residual = loss_of(problem.loss), best.residual[: problem.num_data]
    spread = np.sum(kind.influence(residual) ** 2) / max(residual.size - best.z.size, 1)
    return float(spread / max(np.mean(kind.slope(residual)), 1e-300))


def _ladder(space: Space, i: int, estimate: float, distances: np.ndarray) -> np.ndarray:
    """Places on one side, ever farther off, inside the bounds."""
    places = estimate + distances
    bound = float(space.upper[i] if distances[-1] > 0 else space.lower[i])
    if np.isfinite(bound):  # ever nearer to the bound instead
        beyond = np.abs(places - estimate) > 0.8 * abs(bound - estimate)
        rungs = bound - (bound - estimate) * np.geomspace(0.2, 1e-4, max(int(beyond.sum()), 1))
        places[beyond] = rungs[: beyond.sum()]
    return places


def _inward(known: _Row, estimate: float, place: float, most: float) -> np.ndarray:
    """The known rows between a place and the estimate whose rise is not over the most, the nearest first."""
    inward = (known.value - place) * np.sign(estimate - place) > 0
    there = np.flatnonzero(inward & (known.rise <= most))
    return there[np.argsort(np.abs(known.value[there] - place), kind="stable")]


def _nearest(known: _Row, space: Space, i: int, estimate: float, place: float, threshold: float) -> np.ndarray:
    """Where to begin a search, z: where that of the nearest place towards the estimate ended."""
    there = _inward(known, estimate, place, np.finfo(float).max)
    return known.z[there[0] if there.size else 0]


def _ahead(known: _Row, space: Space, i: int, estimate: float, place: float, threshold: float) -> np.ndarray:
    """The same on the straight line from the estimate through the nearest place within the interval, in z."""
    there = _inward(known, estimate, place, threshold)
    if there.size < 2:  # the estimate itself is one of them
        return _nearest(known, space, i, estimate, place, threshold)
    near, far = known.z[there[0]], known.z[there[-1]]
    at = space.inverse(i, np.array([place, known.value[there[0]], known.value[there[-1]]]))
    return near + (near - far) * (at[0] - at[1]) / (at[1] - at[2])


def _search(
    problem: LeastSquaresProblem,
    noise,
    best: Outcome,
    i: int,
    wanted: list[float],
    starts: list[np.ndarray],
    threshold: float,
) -> _Row:
    """Fit all others with the parameter held, each search from a start of its own.

    A search that stops for want of steps bounds the rise from above only: it goes on while that is over the threshold.
    """
    if not wanted:
        return _Row(np.empty(0), np.empty(0), best.z[None][:0], best.parameters[None][:0])
    places = np.resize(wanted, 2 * LANES)  # always as many, so that nothing is compiled anew
    z = np.resize(np.stack(starts), (places.size, best.z.size))
    held = np.full(z.shape, np.nan)
    held[:, i] = places
    there, rounds_left = minimise_all(problem, noise, z, held, max_steps=MAX_STEPS), CONTINUATIONS
    while np.any(creeping := ~there.solved & (there.cost - best.cost > threshold)) and rounds_left:
        there, rounds_left = minimise_all(problem, noise, there.z, held, max_steps=MAX_STEPS), rounds_left - 1
    rise = np.where(np.isfinite(there.cost), there.cost - best.cost, np.inf)
    kept = ~creeping | np.isinf(rise)
    return _Row(*(x[kept] for x in (places, rise, there.z, there.parameters)))


def _join(a: _Row, b: _Row) -> _Row:
    """Both, by increasing value, and of equal values the lower one."""
    both = _Row(*(np.concatenate(pair) for pair in zip(a, b, strict=True)))
    order = np.lexsort([both.rise, both.value])
    both = _Row(*(x[order] for x in both))
    first = np.append(True, np.diff(both.value) > 0)
    return _Row(*(x[first] for x in both))


def _outward(found: _Row, estimate: float, sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and signed roots of the rise on one side, from the estimate on."""
    side = sign * (found.value - estimate) >= 0
    order = np.argsort(np.abs(found.value[side] - estimate), kind="stable")
    return found.value[side][order], np.sqrt(np.maximum(found.rise[side][order], 0.0))


def _crossing(found: _Row, estimate: float, sign: int, threshold: float) -> tuple[float, float, float] | None:
    """Between which values the profile first crosses the threshold, and where a line through the roots would."""
    value, root = _outward(found, estimate, sign)
    over = np.flatnonzero(root > np.sqrt(threshold))
    if over.size == 0:
        return None
    k = over[0]
    if not np.isfinite(root[k]):  # the model ends between the two
        return float(value[k - 1]), float(value[k]), float(value[k - 1])
    part = (np.sqrt(threshold) - root[k - 1]) / (root[k] - root[k - 1])
    return float(value[k - 1]), float(value[k]), float(value[k - 1] + part * (value[k] - value[k - 1]))


def _around_crossing(found: _Row, estimate: float, sign: int, threshold: float) -> np.ndarray:
    crossing = _crossing(found, estimate, sign, threshold)
    if crossing is None:
        return np.empty(0)
    inner, outer, guess = crossing
    if abs(outer - inner) < NARROW * abs(outer - estimate):
        return np.empty(0)
    spots = np.append(
        np.linspace(inner, outer, 9)[1:-1], [guess, 0.98 * guess + 0.02 * inner, 0.98 * guess + 0.02 * outer]
    )
    return np.unique(spots[(spots - inner) * (spots - outer) < 0])


class _End(NamedTuple):
    value: float
    closed: bool
    model_ends: bool


def _end(found: _Row, estimate: float, sign: int, threshold: float, bound: float) -> _End:
    """One end of the interval, and what makes it: the likelihood never does where the fit itself has none."""
    if not np.any(np.isfinite(found.rise[found.value != estimate])):
        return _End(bound, False, False)
    crossing = _crossing(found, estimate, sign, threshold)
    if crossing is None:
        return _End(bound, False, False)
    ends = bool(np.isinf(found.rise[found.value == crossing[1]][0]))
    return _End(crossing[2], not ends, ends)
