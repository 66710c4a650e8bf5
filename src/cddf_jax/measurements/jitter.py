"""The base tension as it was set: its cell jitters, and a tendon with a history would take every jitter for a turn.

Readings of one hold become their mean. A turn counts where the tension comes back by more than the noise of the cell.
Between two turns the tension rises or falls only: the readings are brought to the nearest such course.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .holds import CLEAR_GAP, NO_STEP, hold_labels

SURE = 3.0  # standard deviations of each of two levels, by which they must differ where the tension turned
LARGEST_JITTER = 0.02  # of the largest tension; a larger way back is a turn, whatever the others are
LEAST_FREEDOM = 5  # of a noise that holds tell
LEAST_IN_HOLD, LEAST_HOLDS = 4, 8  # rows and holds that tell a ramp
ONE_WAY = 0.6  # of holds in which the readings go on as the levels do, less those in which they come back


class Steady(NamedTuple):
    """Readings of a base tension without their jitter."""

    tension: np.ndarray  # (rows,), N
    noise: float  # standard deviation of a reading, N; 0 where none was found or stated
    least_turn: float  # N, by how much the tension has to come back for a turn, at most
    num_ignored: int  # how many turns of the readings are noise


def without_jitter(readings: np.ndarray, noise: float | None = None) -> Steady:
    """What the cell would have read without noise, of one trial from rest.

    Args:
        readings: (rows,), N, in the order in which they were measured.
        noise: standard deviation of a reading, N; 0: every turn counts. None: that within holds, and where there are
            none the gap between small ways back and large ones.
    """
    if noise == 0 or readings.size < 2:
        return Steady(readings, 0.0, 0.0, 0)
    holds = hold_labels(readings[:, None], np.zeros(readings.size), noise)
    holds = np.arange(readings.size) if _is_ramp(readings, holds) else holds
    size = np.bincount(holds)
    first = readings[np.unique(holds, return_index=True)[1]]
    level = first + np.bincount(holds, readings - first[holds]) / size  # of equal readings the mean is the same
    if noise is None:
        noise = _within_holds(readings - level[holds], size)
    error = SURE * noise / np.sqrt(size)
    if noise == 0:
        error = np.full(level.size, 0.5 * _small_ways_back(level))
    steady = _between_turns(level, turns_of(level, error), size)
    ignored = turns_of(readings).size - turns_of(steady).size
    return Steady(steady[holds], noise or float(np.std(level - steady)), 2 * float(np.max(error)), ignored)


def turns_of(level: np.ndarray, error: np.ndarray | None = None) -> np.ndarray:
    """Where a tension turned, 0, 1, ...: the rows that hold a largest or a smallest one.

    Args:
        level: (rows,), from rest.
        error: (rows,), half of the way back that is no turn.
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


def _is_ramp(readings: np.ndarray, holds: np.ndarray) -> bool:
    """Whether readings change within holds as they do from hold to hold: what was taken for holds is a ramp."""
    size = np.bincount(holds)
    row = np.arange(readings.size)
    about = row - (np.bincount(holds, row) / size)[holds]
    slope, level = np.bincount(holds, about * readings), np.bincount(holds, readings) / size
    around = np.concatenate([level[:1], level, level[-1:]])
    alike = (np.sign(slope) * np.sign(around[2:] - around[:-2]))[size >= LEAST_IN_HOLD]
    return alike.size >= LEAST_HOLDS and bool(np.mean(alike) > ONE_WAY)


def _within_holds(error: np.ndarray, size: np.ndarray) -> float:
    """The standard deviation of a reading from the mean of its hold; 0 where too few tell."""
    freedom = int(np.sum(size - 1))
    return float(np.sqrt(np.sum(error**2) / freedom)) if freedom >= LEAST_FREEDOM else 0.0


def _small_ways_back(level: np.ndarray) -> float:
    """The least way back, N, from which on a threefold one leaves as many turns; 0 where none is smaller, or noise."""
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
    """The nearest levels, by least squares, that rise and fall in turn between the turns."""
    from scipy.optimize import isotonic_regression

    found = level.copy()
    ends = [0, *(turns + 1).tolist(), level.size]
    for part, (start, end) in enumerate(pairwise(ends)):
        if end > start:
            own = slice(start, end)
            found[own] = isotonic_regression(level[own], weights=weight[own], increasing=part % 2 == 0).x
    return found
