"""The same body with another length, everything along it in proportion, or with another taper."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError
from .manipulator import Manipulator, Tendon
from .profiles import Constant, Linear, Number, Piecewise, Polyline, Profile, Spline


def stretched(manipulator: Manipulator, length: ArrayLike) -> Manipulator:
    """The body with another length, everything along it in proportion: tapers, knots, joints, anchors, places."""
    ratio, rest = length / jnp.asarray(manipulator.length), manipulator.rest_curvature

    def tendon(old: Tendon) -> Tendon:
        angle, end = old.angle, old.end
        return replace(
            old,
            offset=_stretched(old.offset, ratio),
            angle=None if angle is None else _stretched(angle, ratio),
            end=None if end is None else end * ratio,
        )

    return replace(
        manipulator,
        length=length,
        tendons=tuple(tendon(old) for old in manipulator.tendons),
        point_masses=tuple(replace(old, arc_length=old.arc_length * ratio) for old in manipulator.point_masses),
        rest_curvature=rest and tuple(_stretched(part, ratio) for part in rest),
        **{name: _stretched(old, ratio) for name, old in manipulator.profiles.items() if "." not in name},
    )


def _stretched(profile: Profile, ratio: Number) -> Profile:
    match profile:
        case Constant():
            return profile
        case Linear():
            return replace(profile, length=profile.length * ratio)
        case Polyline() | Spline():
            return replace(profile, arc_length=profile.arc_length * ratio)
        case Piecewise():
            return Piecewise(profile.ends * ratio, [_stretched(piece, ratio) for piece in profile.pieces])
    raise InputError(
        f"a profile of type {type(profile).__name__} cannot be stretched with the length; keep the length fixed"
    )


def tapered(profile: Profile, base: float, tip: float, length: ArrayLike) -> Profile:
    """The profile with other values at base and tip, m, by adding a straight line.

    Raises:
        InputError: for a profile of a type that this package does not define.
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
