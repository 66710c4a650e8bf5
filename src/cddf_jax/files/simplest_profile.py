"""The simplest profile that passes all points along a body at a tolerance.

Between two points it is a straight line, unless a smooth curve through the points stays between their values.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from ..errors import InputError
from ..robot.profiles import Constant, Linear, Piecewise, Profile, Spline
from ..units import shown

MOST_KNOTS = 64  # of a spline
MOST_LINES = 1000
BETWEEN = 257  # places between two points at which a smooth curve is looked at


def simplest_profile(arc_length: np.ndarray, values: np.ndarray, tolerance: float) -> Profile:
    """A number, a straight line, a cubic spline or a chain of straight lines; a step at an arc length given twice.

    A spline is taken if it needs no more knots than the chain has points, stays within the values of neighbouring
    points between them, and does not turn back there, all at the tolerance. The chain passes as few points of the
    table as possible. If the values on both sides of a step differ by no more than the tolerance, their mean is taken.

    Args:
        arc_length: m, the first 0, increasing, except that inner ones may be given twice.
        values: m, at these arc lengths; at a step the one towards the base first.
        tolerance: m, the most by which the profile may miss a value.

    Raises:
        InputError: if the chain would need too many lines.
    """
    parts = _between_steps(arc_length, values, tolerance)
    pieces = [_straight(*part, tolerance) or _curved(*part, tolerance) for part in parts]
    if len(pieces) == 1:
        return pieces[0]
    return Piecewise([float(s[-1]) for s, _ in parts[:-1]], pieces)


def _between_steps(s: np.ndarray, values: np.ndarray, tolerance: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """The points of each part without steps."""
    twice = np.flatnonzero(np.diff(s) == 0)
    jumps = np.abs(values[twice + 1] - values[twice]) > tolerance
    values, same = values.copy(), twice[~jumps]
    values[same] = 0.5 * (values[same] + values[same + 1])
    steps = np.concatenate([[0], twice[jumps] + 1, [len(s)]])
    kept = [np.setdiff1d(np.arange(first, last), same + 1) for first, last in pairwise(steps)]
    return [(s[part], values[part]) for part in kept]


def _straight(s: np.ndarray, values: np.ndarray, tolerance: float) -> Profile | None:
    """A number or one straight line, if that is near enough."""
    if np.ptp(values) <= 2 * tolerance:
        return Constant(0.5 * (np.min(values) + np.max(values)))
    slope, base = np.polyfit(s / s[-1], values, 1)
    if np.max(np.abs(base + slope * s / s[-1] - values)) > tolerance:
        return None
    ends = s[[0, -1]]
    return Piecewise.linear(ends, base + slope * ends / s[-1]) if s[0] > 0 else Linear(base, base + slope, s[-1])


def _curved(s: np.ndarray, values: np.ndarray, tolerance: float) -> Profile:
    """A spline or a chain of straight lines."""
    corners = _corners(s, values, tolerance)
    spline = _spline(s, values, tolerance, len(corners))
    if spline is not None:
        return spline
    if len(corners) > MOST_LINES + 1:
        raise InputError(
            f"neither {MOST_KNOTS} knots of a spline nor {MOST_LINES} straight lines pass its points at "
            f"{shown(tolerance, 'length')}; give a greater tolerance, or smooth the points"
        )
    return Piecewise.linear(s[corners], values[corners])


def _corners(s: np.ndarray, values: np.ndarray, tolerance: float) -> list[int]:
    """The points at which a chain of straight lines bends: the worst point becomes a corner, again and again."""
    corners = [0, len(s) - 1]
    while len(corners) <= MOST_LINES + 1:
        miss = np.abs(np.interp(s, s[corners], values[corners]) - values)
        if miss.max() <= tolerance:
            break
        corners = sorted([*corners, int(miss.argmax())])
    return corners


# --- smooth curves -------------------------------------------------------------------------------


def _spline(s: np.ndarray, values: np.ndarray, tolerance: float, most: int) -> Spline | None:
    """The least-squares spline with the fewest evenly spaced knots that suffice; None if none does."""
    from scipy.interpolate import make_lsq_spline

    for knots in range(4, min(MOST_KNOTS, len(s), most) + 1):
        at = np.linspace(s[0], s[-1], knots)
        every = np.concatenate([[s[0]] * 4, at[2:-2], [s[-1]] * 4])  # not-a-knot: none at the second and last but one
        try:
            curve = make_lsq_spline(s, values, every)
        except (ValueError, np.linalg.LinAlgError):  # too few points between two knots
            return None
        if np.max(np.abs(curve(s) - values)) <= tolerance and not _strays(curve, s, values, tolerance):
            return Spline(at, curve(at))
    return None


def _strays(curve: Callable[[np.ndarray], np.ndarray], s: np.ndarray, values: np.ndarray, tolerance: float) -> bool:
    """Whether a curve leaves the range of two neighbouring points, or turns back between them."""
    grid = s[:-1, None] + np.diff(s)[:, None] * np.linspace(0.0, 1.0, BETWEEN)
    height, before, after = curve(grid), values[:-1, None], values[1:, None]
    beyond = np.maximum(np.minimum(before, after) - height, height - np.maximum(before, after))
    rise = np.sign(after - before) * height
    back = np.maximum.accumulate(rise, axis=1) - rise
    return bool(np.any(beyond > tolerance) or np.any(back > 2 * tolerance))  # no monotone curve is that near
