"""Holds and repeats: consecutive rows that were read while nothing was changed are not independent readings.

A hold is a run of consecutive rows of one trial at the same commanded level. The same level later, or in another
trial, is a repeat. Samples of one hold have slow drifts in common; repeats do not.
"""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from .columns import is_reading
from .order import ORDER
from .table import Measurements

SAME_LEVEL = 0.01  # of the largest of a column: levels that differ by less are one, if the data show no other noise
NO_STEP = 5e-4  # of the largest: a smaller change is not a step
CLEAR_GAP = 3.0  # between the largest change within holds and the smallest step from hold to hold
LARGEST_NOISE = 0.05  # of the largest: larger changes are steps, with any gaps
STEP = 5.0  # standard deviations from the mean of a hold
MEDIAN_CHANGE = 0.954  # of the size of a change, for noise of standard deviation 1
MOST_STEPS = 0.2  # of the changes; with more steps the median of the changes is not noise
LEAST_IN_HOLD, LEAST_HOLDS = 4, 8  # rows in a hold, and such holds, that can show a ramp
ONE_WAY = 0.6  # share of holds whose readings change as the levels do, less the share of opposite ones, of a ramp
ALARM = NormalDist().inv_cdf(1 - 1e-3)  # standard deviations of a correlation of independent readings
LEAST_PAIRS = 10
LEAST_RESIDUAL = 0.1  # over the noise; smaller residuals that are alike make no error too small


def hold_labels(levels: ArrayLike, trial: ArrayLike) -> np.ndarray:
    """The hold of each row, counted from 0 in the order of the rows.

    Consecutive rows belong to one hold if no level changes by more than the noise of the levels. This noise is the
    first that applies: the largest change below the widest gap among the changes, if at least half of the changes lie
    below it; 5 standard deviations, estimated from the median of the changes, if a few changes are larger; 1 % of the
    largest level. If the levels then change in one direction within holds, as in a slow ramp, each row is its own hold.

    Args:
        levels: (rows, columns), what was set.
        trial: (rows,), labels; a hold ends with its trial.
    """
    largest = np.maximum(np.max(np.abs(levels), axis=0), 1e-300)
    scaled = np.asarray(levels, float) / largest
    rows, label = len(scaled), np.asarray(trial)
    within = label[1:] == label[:-1]
    change = np.diff(scaled, axis=0)
    limit, by_gap = _noise_of_levels(np.max(np.abs(change), axis=1, initial=0.0)[within])
    new = np.append(True, ~within)
    mean, count = scaled[0].tolist(), 1
    for row, level in enumerate(scaled.tolist()):
        if new[row] or any(abs(there - here) > limit for there, here in zip(level, mean, strict=True)):
            new[row], mean, count = True, level, 1
        else:
            count += 1
            mean = [here + (there - here) / count for there, here in zip(level, mean, strict=True)]
    labels = np.cumsum(new) - 1
    return labels if by_gap or not any(is_ramp(column, labels) for column in scaled.T) else np.arange(rows)


def _noise_of_levels(change: np.ndarray) -> tuple[float, bool]:
    """The largest change that is noise, and whether a gap in the changes shows it."""
    if change.size > 1:
        ordered = np.sort(np.maximum(change, NO_STEP))
        gap = int(np.argmax(ordered[1:] / ordered[:-1]))
        below, above = ordered[gap], ordered[gap + 1]
        if above >= CLEAR_GAP * below and below <= LARGEST_NOISE and 2 * (gap + 1) >= change.size:
            return float(below), True
        limit = STEP * float(np.median(change)) / MEDIAN_CHANGE
        steps = np.mean(change > limit)
        if SAME_LEVEL < limit <= LARGEST_NOISE and 0 < steps <= MOST_STEPS:
            return limit, False
    return SAME_LEVEL, False


def is_ramp(level: np.ndarray, holds: np.ndarray) -> bool:
    """Whether levels change within holds as they do from hold to hold: then they are a ramp, and not holds."""
    size, row = np.bincount(holds), np.arange(level.size)
    about = row - (np.bincount(holds, row) / size)[holds]
    slope, mean = np.bincount(holds, about * level), np.bincount(holds, level) / size
    around = np.concatenate([mean[:1], mean, mean[-1:]])
    alike = (np.sign(slope) * np.sign(around[2:] - around[:-2]))[size >= LEAST_IN_HOLD]
    return alike.size >= LEAST_HOLDS and bool(np.mean(alike) > ONE_WAY)


def correlation_of_rows(residual: np.ndarray, labels: np.ndarray) -> float:
    """The correlation of residuals from row to row, among rows with the same label.

    It is 0 where independent readings could be as correlated by chance, and where residuals are far below the noise.

    Args:
        residual: (rows,), over their noise, in the order of measurement.
        labels: (rows,), the hold or the trial of each.
    """
    same = labels[1:] == labels[:-1]
    one, other = residual[1:][same], residual[:-1][same]
    size = float(np.sum(one**2 + other**2) / 2)
    correlation = float(one @ other) / size if size > 0 else 0.0
    clear = one.size >= LEAST_PAIRS and correlation > ALARM / np.sqrt(one.size) and size >= LEAST_RESIDUAL**2 * one.size
    return correlation if clear else 0.0


def holds_of(table: Measurements) -> np.ndarray:
    """The hold of each row of a table, by the order of measurement, its trials and what was set."""
    pulls = [own.column for own in table.set_columns]
    others = {column for column in table.columns if not is_reading(column, table.columns)} - {*pulls, "trial", *ORDER}
    levels = [np.where(own.rows, table[own.column], 0.0) for own in table.set_columns]
    levels, labels = np.stack([*levels, *map(table.__getitem__, others)], axis=1), np.zeros(len(table), int)
    labels[table.order] = hold_labels(levels[table.order], table.trial[table.order])
    return labels


def average_holds(table: Measurements) -> Measurements:
    """One reading for each hold: the mean of its rows. A fit may take these means as independent.

    The scatter of the means about the model includes what the rows of a hold have in common. A fit estimates it from
    the means.

    Args:
        table: as it was read.

    Returns:
        The table of means, each with the row of the file in which its hold begins. A table without holds is returned
        unchanged.
    """
    order = table.order
    columns, rows = {name: own[order] for name, own in table.columns.items()}, table.rows[order]
    labels = holds_of(table)[order]
    first, size = np.unique(labels, return_index=True, return_counts=True)[1:]
    if np.all(size == 1):
        return table
    means = {name: values[first] if name == "trial" else _mean(values, labels) for name, values in columns.items()}
    said = f"{table.name}: each hold averaged to one reading: {len(table)} rows became {first.size}"
    return replace(table, columns=means, rows=rows[first], read_as=(*table.read_as, said))


def _mean(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The mean over the rows of each hold that were read; NaN if none was read."""
    there = np.isfinite(values)
    count = np.bincount(labels, there)
    total = np.bincount(labels, np.where(there, values, 0.0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
