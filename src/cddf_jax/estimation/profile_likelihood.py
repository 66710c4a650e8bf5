"""The profile of a parameter: it is held at one value after another, and the others are fitted again.

The curvature at the minimum may suggest an interval that the data do not close. The profile shows that.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..progress import stage
from .levenberg_marquardt import Minimum, hold_one

NEAR = np.array([0.15, 0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.35, 1.7, 2.5])  # distances in half-widths of the interval
FAR = np.array([1.5, 3.0, 10.0, 30.0, 100.0, 1000.0])  # further distances, in sizes of the parameter
NARROW = 1e-6  # of its distance from the estimate: accuracy of an end
STEEP = 10.0  # times the root of the threshold: the value of an infinite rise in the search for an end


class Profile(NamedTuple):
    """One parameter's profile; rows by increasing value."""

    name: str
    value: np.ndarray
    rise: np.ndarray  # of the sum of squares over its minimum; inf where the model has no solution
    threshold: float  # the rise that ends the 95 % interval
    confidence_interval: tuple[float, float]  # an open side ends at the bound, at infinity or where the model ends
    closed: tuple[bool, bool]  # below, above: whether the data close the interval
    model_ends: tuple[bool, bool]  # below, above: whether an open side ends where the model has no solution beyond


@stage("searching")
def profile_likelihood(minimum: Minimum, name: str, standard_error: float, quantile: float) -> Profile:
    """The profile of one parameter, up to where its 95 % interval closes, or to its bounds.

    The noise is held at its estimate: for a linear model the interval is the t interval. The standard error is a first
    guess, and may be infinite. The quantile is the half-width of a 95 % interval over its standard error.
    """
    best, space = minimum.outcome, minimum.problem.space
    i, threshold = space.names.index(name), quantile**2
    size = float(max(best.size[i], space.scale[i]) if space.at_bound(best.parameters)[i] else best.size[i])
    half_width = min(quantile * standard_error, size)
    estimate = _Point(float(best.parameters[i]), 0.0, best.z)
    sides = [_Side(minimum, i, threshold, float(bound[i]), [estimate]) for bound in (space.lower, space.upper)]
    for sign, side in zip((-1, 1), sides, strict=True):
        for distances in (NEAR * half_width, NEAR[-1] * half_width + FAR * size):
            if side.crossed is None:
                for place in side.ladder(sign * distances):
                    side.look(place)
    below, above = sides
    if any(np.isfinite(point.rise) for side in sides for point in side.points[1:]):
        ends = [side.end() for side in sides]
    else:
        ends = [(side.bound, False, False) for side in sides]
    low_to_high = [*reversed(below.points), *above.points[1:]]
    value, rise, _ = map(np.array, zip(*low_to_high, strict=True))
    interval, closed, model_ends = zip(*ends, strict=True)
    return Profile(name, value, rise, threshold, interval, closed, model_ends)


class _Point(NamedTuple):
    """A point of the profile."""

    value: float
    rise: float
    z: np.ndarray


@dataclass(frozen=True)
class _Side:
    """The way from the estimate of parameter i to where the sum of squares has risen by the threshold."""

    minimum: Minimum
    i: int
    threshold: float
    bound: float
    points: list[_Point]  # by their distance from the estimate, which is the first

    def distance(self, place: float) -> float:
        """The distance from the estimate."""
        return abs(place - self.points[0].value)

    def ladder(self, distances: np.ndarray) -> np.ndarray:
        """Places further and further away, inside the bound."""
        estimate, bound = self.points[0].value, self.bound
        places = estimate + distances
        if np.isfinite(bound):  # nearer and nearer to the bound instead
            beyond = np.abs(distances) > 0.8 * self.distance(bound)
            rungs = bound - (bound - estimate) * np.geomspace(0.2, 1e-4, max(int(beyond.sum()), 1))
            places[beyond] = rungs[: beyond.sum()]
        return places

    def look(self, place: float) -> float:
        """The rise with the parameter held at a place and all others fitted again; infinite where the model ends.

        A search begins on the straight line, in z, from the estimate through the nearest known place. If it leaves the
        valley, another one begins at the nearest place. A search that ran out of steps is an upper limit of the rise:
        above the threshold it is ignored.
        """
        space, (first, *_) = self.minimum.problem.space, self.points
        inward = [p for p in self.points if np.isfinite(p.rise) and self.distance(p.value) < self.distance(place)]
        near = inward[-1] if inward else first
        with np.errstate(divide="ignore", invalid="ignore"):  # an estimate on its bound is infinitely far away in z
            at = space.inverse(self.i, np.array([place, near.value, first.value]))
            ahead = near.z + (near.z - first.z) * (at[0] - at[1]) / (at[1] - at[2])
        found, solved = _Point(place, np.inf, near.z), True
        for z in [ahead] * bool(np.all(np.isfinite(ahead))) + [near.z]:
            moved, rise = self.minimum.refit(hold_one(near.z.size, self.i, place), z)
            if rise < found.rise:
                found, solved = _Point(place, rise, moved.z), bool(moved.solved)
            if found.rise <= self.threshold:
                break
        if solved or found.rise <= self.threshold:
            self.points.append(found)
            self.points[:] = sorted(self.points, key=lambda point: self.distance(point.value))
        return found.rise

    @property
    def crossed(self) -> int | None:
        """The number of the first point above the threshold; None if the profile stays below it."""
        return next((k for k, point in enumerate(self.points) if point.rise > self.threshold), None)

    def end(self) -> tuple[float, bool, bool]:
        """The end of the interval on this side, whether the data close it there, and whether the model ends there.

        Without either it is the bound.
        """
        from scipy.optimize import root_scalar

        k = self.crossed
        if k is None:
            return self.bound, False, False
        inner, outer, limit = self.points[k - 1].value, self.points[k].value, np.sqrt(self.threshold)

        def over(place: float) -> float:
            known = {point.value: point.rise for point in self.points}
            rise = known[place] if place in known else self.look(place)
            return min(float(np.sqrt(max(rise, 0.0))), STEEP * limit) - limit

        place = float(root_scalar(over, bracket=(inner, outer), xtol=NARROW * self.distance(outer)).root)
        ends = bool(np.isinf(self.points[self.crossed or 0].rise))
        return place, not ends, ends
