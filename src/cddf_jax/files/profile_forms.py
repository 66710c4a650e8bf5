"""Profiles in robot files: a text with its unit, or a table; read and written."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError, within
from ..robot.profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline
from ..units import Dimension, quantity, written

FORMS = '"7 mm", { base, tip }, { ends, pieces }, { lines } or { spline }'


def read_profile(value: object, length: float, where: str, kind: Dimension) -> Profile:
    """A profile in one of its forms; the length is that of the body, m. Messages begin with `where`."""
    match value:
        case str() | int() | float():
            return Constant(quantity(value, kind, where))
        case {"base": base, "tip": tip, **rest} if rest.keys() <= {"length"}:
            ends = quantity(base, kind, f"{where}: base"), quantity(tip, kind, f"{where}: tip")
            return Linear(*ends, length=quantity(rest["length"], "length", f"{where}: length") if rest else length)
        case {"ends": list(ends), "pieces": list(pieces), **rest} if not rest:
            joints = [quantity(end, "length", f"{where}: ends") for end in ends]
            parts = [read_profile(piece, length, f"{where}: piece {i}", kind) for i, piece in enumerate(pieces, 1)]
            make = partial(Piecewise, joints, parts)
        case {"lines": list(points), **rest} if not rest:
            make = partial(Piecewise.linear, *_points(points, f"{where}: lines", kind))
        case {"spline": list(points), **rest} if not rest:
            make = partial(Spline, *_points(points, f"{where}: spline", kind))
        case _:
            raise InputError(f"{where} is not a profile, got {value!r}; write {FORMS}")
    with within(where, ValueError):  # errors of the profile itself, such as a wrong number of values
        return make()


def _points(points: Sequence[object], where: str, kind: Dimension) -> tuple[list[float], list[float]]:
    knots, values, before = [], [], None
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            raise InputError(f'{where} holds pairs [arc length, value], got {point!r}; write ["60 mm", "15 mm"]')
        knots.append(quantity(point[0], "length", where))
        values.append(quantity(point[1], kind, where))
        if len(knots) > 1 and knots[-1] <= knots[-2]:
            raise InputError(f"{where}: arc lengths must increase, got {point[0]!r} after {before!r}")
        before = point[0]
    return knots, values


def profile_form(profile: Profile, length: ArrayLike, where: str, kind: Dimension) -> object:
    """A profile in one of the forms that `read_profile` reads."""
    value = partial(number_text, kind=kind)
    match profile:
        case Constant():
            return value(profile.value)
        case Linear():
            own = {} if profile.length == length else {"length": number_text(profile.length)}
            return {"base": value(profile.base), "tip": value(profile.tip), **own}
        case Piecewise():
            pieces = [
                profile_form(piece, length, f"{where}: piece {i}", kind) for i, piece in enumerate(profile.pieces, 1)
            ]
            return {"ends": [number_text(end) for end in profile.ends], "pieces": pieces}
        case Polyline() | Spline():
            points = zip(profile.arc_length, profile.values, strict=True)
            form = "lines" if isinstance(profile, Polyline) else "spline"
            return {form: [[number_text(s), value(v)] for s, v in points]}
    raise InputError(
        f"{where}: a profile of type {type(profile).__name__} cannot be written to a file; "
        "sample it into a Spline or Piecewise.linear"
    )


def number_text(value: ArrayLike, kind: Dimension = "length") -> float | str:
    """A number for a file, with its unit if it has one."""
    number = float(np.asarray(value))
    return number if kind in ("dimensionless", "strain") else written(number, kind)
