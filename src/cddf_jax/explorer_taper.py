"""A body with another taper, whatever form its profile has."""

from typing import Any

import numpy as np

from .errors import InputError
from .profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline


def tapered(profile: Profile, base: float, tip: float, length: Any) -> Profile:
    """The profile with other values at base and tip, m: what is added to it in between is a straight line.

    Raises:
        InputError: for a profile that is none of this package's.
    """
    if isinstance(profile, Constant) or (isinstance(profile, Linear) and profile.length == length):
        return Linear(base, tip, length)
    rise = base - float(profile(0.0)), tip - float(profile(length))
    return _raised(profile, Linear(*rise, length))


def _raised(profile: Profile, by: Linear) -> Profile:
    match profile:
        case Constant():
            return Linear(profile.value + by.base, profile.value + by.tip, by.length)
        case Linear():
            return Linear(profile.base + by.base, profile.tip + float(by(profile.length)), profile.length)
        case Piecewise():
            return Piecewise(profile.ends, [_raised(piece, by) for piece in profile.pieces])
        case Polyline() | Spline():
            return type(profile)(profile.arc_length, profile.values + np.asarray(by(profile.arc_length)))
    name, remedy = type(profile).__name__, "sample it into a Spline or Piecewise.linear"
    raise InputError(f"a profile of type {name} cannot be tapered; {remedy}")
