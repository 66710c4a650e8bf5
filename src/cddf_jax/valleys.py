"""Looks far along the valleys of a sum of squares, where the curvature at its minimum tells too little."""

import itertools
from typing import NamedTuple

import numpy as np

from .determination import (
    AT_BOUND,
    IDENTIFIED,
    LARGEST_RELATIVE_ERROR,
    NOT_IDENTIFIED,
    Determination,
    Evidence,
    spectrum_of,
)
from .levenberg_marquardt import LeastSquaresProblem, Outcome, evaluate, minimise
from .parameter_space import Space

CLOSING_RISE = 2.0  # of the sum of squares, times that at the end of a 95 % interval


class Profiles(NamedTuple):
    """What holding one parameter after the other far off told."""

    open: np.ndarray  # by parameter: whether its 95 % interval is open on a side, for all that was tried
    least_rise: float  # of the sum of squares, over all that was tried
    lower: np.ndarray | None  # z of the place where it rose least, had it fallen there
    bounded_above: tuple[int, ...]  # of those that are not told from their lower bound


def profiles_of(
    problem: LeastSquaresProblem, noise, outcome: Outcome, evidence: Evidence, told: Determination, max_steps: int
) -> Profiles:
    """Hold each parameter that looks identified at values ever farther off and fit the others again.

    The curvature at a minimum can feign an interval where the valley is flat beyond. A side is closed where
    the sum of squares has risen by twice what ends a 95 % interval.
    """
    opened, least, lower = np.zeros(len(told.names), bool), 0.0, None

    def closed(i: int, error: float, places: list[float]) -> bool:
        nonlocal least, lower
        for place in places:
            held = np.where(np.arange(len(opened)) == i, place, np.nan)
            moved = minimise(problem, noise, outcome.z, held, max_steps)
            rise = float(moved.cost - outcome.cost)
            if rise < least:
                least, lower = rise, np.where(np.isnan(held), moved.z, problem.space.inverse(i, place))
            expected = ((place - outcome.parameters[i]) / error) ** 2
            if not rise <= min(CLOSING_RISE * told.quantile**2, 0.5 * expected):  # NaN: the model ends there
                return True
        return False

    for i, name in enumerate(told.names):
        if told.status[name] == IDENTIFIED:
            error = told.standard_error[name]
            sides = _sides(problem.space, i, told.value[name], told.quantile * error)
            opened[i] = not all(closed(i, error, places) for places in sides)
    error = spectrum_of(evidence.jacobian).relative_error * evidence.size
    near = np.isfinite(problem.space.lower) & (outcome.parameters - told.quantile * error <= problem.space.lower)
    near &= [told.status[name] in (NOT_IDENTIFIED, AT_BOUND) for name in told.names]
    high = outcome.parameters + told.quantile * error
    limited = [
        i for i in np.flatnonzero(near & np.isfinite(high) & (high < problem.space.upper)).tolist()
        if closed(i, error[i], [high[i], outcome.parameters[i] + 2 * told.quantile * error[i]])
    ]  # fmt: skip
    return Profiles(opened, least, lower, tuple(limited))


def are_products(problem: LeastSquaresProblem, noise, outcome: Outcome, told: Determination, max_steps: int) -> bool:
    """Whether what is not identified may be doubled along the valley: if not, it is no product that is determined."""
    lost = np.array([told.status[name] == NOT_IDENTIFIED for name in told.names])
    if np.count_nonzero(lost) < 2 or np.any(outcome.parameters[lost] <= 0) or not np.all(np.isfinite(outcome.jacobian)):
        return True
    _, values, directions = np.linalg.svd(np.linalg.qr(outcome.jacobian, mode="r"))  # all directions, however many rows
    for singular, direction in itertools.zip_longest(values, directions, fillvalue=0.0):
        along = np.where(lost, direction, 0.0)
        if singular * LARGEST_RELATIVE_ERROR > 1 or np.linalg.norm(along) < 0.7:
            continue
        for factor in (0.5, 2.0):
            place = outcome.parameters * factor ** (along / np.abs(along).max())
            if np.any(place <= problem.space.lower) or np.any(place >= problem.space.upper):
                continue
            moved = minimise(problem, noise, outcome.z, np.where(lost, place, np.nan), max_steps)
            if not moved.cost - outcome.cost <= CLOSING_RISE * told.quantile**2:
                return False
    return True


def nearest_to_start(
    problem: LeastSquaresProblem, noise, outcome: Outcome, opened: np.ndarray, quantile: float, max_steps: int
) -> Outcome:
    """Along an open valley any place will do: the one at the start of the first open parameter, if it fits."""
    i, first = int(np.argmax(opened)), problem.space.first()
    held = np.where(np.arange(len(first)) == i, problem.space.start, np.nan)
    moved = minimise(problem, noise, outcome.z, held, max_steps)
    there = evaluate(problem, noise, np.where(np.isnan(held), moved.z, first))
    return there if there.cost - outcome.cost <= CLOSING_RISE * quantile**2 else outcome


def _sides(space: Space, i: int, value: float, half_width: float) -> tuple[list[float], list[float]]:
    """Places below and above an estimate: 2 and 10 half-widths of its interval off, and a fifth and five times it."""
    lower, upper = float(space.lower[i]), float(space.upper[i])
    below, above = ([value + sign * factor * half_width for factor in (2, 10)] for sign in (-1, 1))
    if np.isfinite(lower):
        below = [max(place, value - 0.9 * (value - lower)) for place in below]
    if np.isfinite(upper):
        above = [min(place, value + 0.9 * (upper - value)) for place in above]
    if np.isfinite(lower) and not np.isfinite(upper):
        below.append(lower + (value - lower) / 5)
        above.append(lower + (value - lower) * 5)
    return below, above
