"""Points along the body to the simplest profile that passes them all at a tolerance.

Simple is what costs the solver least: every joint of a profile ends a panel of its own.
"""

import numpy as np
from scipy.interpolate import make_lsq_spline

from .errors import InputError
from .profiles import Constant, Linear, Piecewise, Profile, Spline
from .units import shown

MOST_KNOTS = 64  # of a spline
MOST_LINES = 64


def simplest_profile(arc_length: np.ndarray, values: np.ndarray, tolerance: float, name: str) -> Profile:
    """A number, a straight line, a spline of few knots or a chain of straight lines, whichever has fewest pieces.

    Args:
        arc_length: m, increasing, the first 0; two or more.
        values: m, at these arc lengths.
        tolerance: m, the most by which the profile may miss a value.
        name: of the quantity, with which an error begins.

    Raises:
        InputError: where more pieces are needed than a solve should have.
    """
    length = arc_length[-1]
    if np.ptp(values) <= 2 * tolerance:
        return Constant(0.5 * (np.min(values) + np.max(values)))
    slope, base = np.polyfit(arc_length / length, values, 1)
    if np.max(np.abs(base + slope * arc_length / length - values)) <= tolerance:
        return Linear(base, base + slope, length)
    spline, corners = _spline(arc_length, values, tolerance), _corners(arc_length, values, tolerance)
    if spline is not None and len(spline.values) - 3 <= len(corners) - 1:
        return spline
    if len(corners) > MOST_LINES + 1:
        raise InputError(
            f"{name}: neither {MOST_KNOTS} knots of a spline nor {MOST_LINES} straight lines pass its points at "
            f"{shown(tolerance, 'length')}; give a greater tolerance, or smooth the points"
        )
    return Piecewise.linear(arc_length[corners], values[corners])


def _spline(s: np.ndarray, values: np.ndarray, tolerance: float) -> Spline | None:
    """The least-squares spline of the fewest evenly spaced knots that is near enough; None if none is."""
    for knots in range(4, min(MOST_KNOTS, len(s)) + 1):
        at = np.linspace(s[0], s[-1], knots)
        every = np.concatenate([[s[0]] * 4, at[2:-2], [s[-1]] * 4])  # not-a-knot: none at the second and last but one
        try:
            curve = make_lsq_spline(s, values, every)
        except (ValueError, np.linalg.LinAlgError):  # too few points between two knots
            return None
        if np.max(np.abs(curve(s) - values)) <= tolerance:
            return Spline(at, curve(at))
    return None


def _corners(s: np.ndarray, values: np.ndarray, tolerance: float) -> list[int]:
    """The points at which a chain of straight lines bends: the worst point becomes a corner, again and again."""
    corners = [0, len(s) - 1]
    while len(corners) <= MOST_LINES + 1:
        miss = np.abs(np.interp(s, s[corners], values[corners]) - values)
        if miss.max() <= tolerance:
            break
        corners = sorted([*corners, int(miss.argmax())])
    return corners
