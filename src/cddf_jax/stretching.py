"""A body of another length."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp

from .errors import InputError
from .manipulator import Manipulator, Tendon
from .profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline


def stretched(manipulator: Manipulator, length: Any) -> Manipulator:
    """The body with another length, everything along it in proportion: tapers, knots, joints, anchors, places."""
    ratio = length / jnp.asarray(manipulator.length)

    def tendon(old: Tendon) -> Tendon:
        return replace(old, offset=_stretched(old.offset, ratio), end=None if old.end is None else old.end * ratio)

    return replace(
        manipulator,
        length=length,
        tendons=tuple(tendon(old) for old in manipulator.tendons),
        point_masses=tuple(replace(old, arc_length=old.arc_length * ratio) for old in manipulator.point_masses),
        **{name: _stretched(old, ratio) for name, old in manipulator.profiles.items() if "." not in name},
    )


def _stretched(profile: Profile, ratio: Any) -> Profile:
    match profile:
        case Constant():
            return profile
        case Linear():
            return replace(profile, length=profile.length * ratio)
        case Polyline() | Spline():
            return replace(profile, arc_length=profile.arc_length * ratio)
        case Piecewise():
            return Piecewise(profile.ends * ratio, [_stretched(piece, ratio) for piece in profile.pieces])
    raise InputError(f"a profile of type {type(profile).__name__} cannot follow the length; hold the length")
