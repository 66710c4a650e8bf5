"""The base tension without the jitter of its cell: in a history every jitter would count as a turn.

Readings of one hold become their mean. A turn counts if the tension then comes back by more than the noise of the cell.
Between two turns the tension only rises or only falls: the readings are replaced by the nearest such values. Where
every turn counts, the readings stay as they are.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .holds import CLEAR_GAP, NO_STEP, hold_labels, is_ramp

SURE = 3.0  # standard deviations of each of two levels by which these differ, if the tension turned
LARGEST_JITTER = 0.02  # of the largest tension; a larger way back is always a turn
LEAST_FREEDOM = 5  # degrees of freedom from which the noise within holds is estimated
STEP = 3.0  # standard deviations between the means before and after a step within a hold


class Steady(NamedTuple):
    """Readings of a base tension without their jitter."""

    tension: np.ndarray  # (rows,), N
    noise: float  # standard deviation of a reading, N; 0 if none was found or stated
    least_turn: float  # N: a larger way back is a turn
    num_ignored: int  # how many turns of the readings are noise


def without_jitter(readings: np.ndarray, noise: float | None = None) -> Steady:
    """The readings of one trial from rest, without the noise of the cell.

    Args:
        readings: (rows,), N, in the order in which they were measured.
        noise: standard deviation of a reading, N; with 0 every turn counts. None: it is estimated from the scatter
            within holds, or without holds from the gap between small ways back and large ones.
    """
    if noise == 0 or readings.size < 2:
        return Steady(readings, 0.0, 0.0, 0)
    one = np.zeros(readings.size, int)
    holds = hold_labels(readings[:, None], one) if noise is None else one
    holds = _split(readings, holds, _scatter(readings, holds) if noise is None else noise)
    holds = np.arange(readings.size) if is_ramp(readings, holds) else holds
    level, size = _means(readings, holds), np.bincount(holds)
    noise = _scatter(readings, holds) if noise is None else noise
    error = SURE * noise / np.sqrt(size)
    if noise == 0:
        error = np.full(level.size, 0.5 * _small_ways_back(level))
    steady = _between_turns(level, turns_of(level, error), size)
    noise = noise or float(np.std(level - steady))
    ignored = turns_of(readings).size - turns_of(steady).size
    tension = steady[holds] if ignored else readings
    return Steady(tension, noise, 2 * float(np.max(error)), ignored)


def turns_of(level: np.ndarray, error: np.ndarray | None = None) -> np.ndarray:
    """The rows, from 0, at which a tension turned.

    Args:
        level: (rows,), from rest.
        error: (rows,): a way back counts as a turn if it is larger than the sum of the errors at its ends.
    """
    error = np.zeros(level.size) if error is None else error
    turns, extreme, direction = [], 0, 1.0
    for row in range(1, level.size):
        ahead = direction * (level[row] - level[extreme])
        if ahead >= 0:
            extreme = row
        elif -ahead > error[row] + error[extreme]:
            turns.append(extreme)
            extreme, direction = row, -direction
    return np.array(turns, int)


def _means(readings: np.ndarray, holds: np.ndarray) -> np.ndarray:
    """(holds,), the mean of each hold; of equal readings it is the same."""
    first = readings[np.unique(holds, return_index=True)[1]]
    return first + np.bincount(holds, readings - first[holds]) / np.bincount(holds)


def _scatter(readings: np.ndarray, holds: np.ndarray) -> float:
    """The standard deviation of a reading from the mean of its hold; 0 if there are too few readings."""
    freedom = readings.size - int(np.max(holds)) - 1
    error = readings - _means(readings, holds)[holds]
    return float(np.sqrt(np.sum(error**2) / freedom)) if freedom >= LEAST_FREEDOM else 0.0


def _split(readings: np.ndarray, holds: np.ndarray, noise: float) -> np.ndarray:
    """The holds, divided where the means of two parts differ by more than the noise."""
    total, new = np.append(0.0, np.cumsum(readings)), np.append(True, np.diff(holds) != 0)
    parts = list(pairwise([*np.flatnonzero(new).tolist(), readings.size])) if noise else []
    while parts:
        start, end = parts.pop()
        if end - start < 2:
            continue
        middle = np.arange(start + 1, end)
        before, after = middle - start, end - middle
        apart = (total[end] - total[middle]) / after - (total[middle] - total[start]) / before
        over = np.abs(apart) / np.sqrt(1 / before + 1 / after)
        if np.max(over) > STEP * noise:
            step = int(middle[np.argmax(over)])
            new[step] = True
            parts += [(start, step), (step, end)]
    return np.cumsum(new) - 1


def _small_ways_back(level: np.ndarray) -> float:
    """A way back, N, that separates noise from turns; 0 if no turn is noise, or if there is no clear gap.

    A threefold one leaves as many turns.
    """
    largest = float(np.max(level))

    def turns_beyond(way: float) -> int:
        return turns_of(level, np.full(level.size, 0.5 * way)).size

    every = turns_beyond(0.0)
    for part in np.geomspace(NO_STEP, LARGEST_JITTER, 16):
        left = turns_beyond(part * largest)
        if left == every:
            return 0.0
        if left == turns_beyond(CLEAR_GAP * part * largest):
            return float(part * largest)
    return 0.0


def _between_turns(level: np.ndarray, turns: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The nearest levels, by least squares, that rise or fall monotonically between the turns."""
    from scipy.optimize import isotonic_regression

    found = level.copy()
    ends = [0, *(turns + 1).tolist(), level.size]
    for part, (start, end) in enumerate(pairwise(ends)):
        if end > start:
            own = slice(start, end)
            found[own] = isotonic_regression(level[own], weights=weight[own], increasing=part % 2 == 0).x
    return found
