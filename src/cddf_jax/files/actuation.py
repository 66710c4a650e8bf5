"""Tensions, targets and loads out of text: "75 N", "tip_angle=45 deg", "tip_position=0.1, 0.08 m", "0 N, -5 N"."""

from collections.abc import Callable, Sequence
from typing import TypeVar, cast

from ..errors import InputError, known_names
from ..quantities import dimension_of
from ..robot.loads import Loads, PointLoad
from ..robot.manipulator import Manipulator
from ..statics.targets import (
    CurvatureAt,
    Displacement,
    Target,
    TipAngle,
    TipPosition,
    TipStiffness,
    TipTension,
    TotalTension,
)
from ..units import quantity, shown, vector

Entry = TypeVar("Entry")
TARGETS: dict[str, Callable[..., object]] = {
    kind.quantity: kind for kind in (Displacement, TipAngle, TipTension, CurvatureAt, TotalTension, TipStiffness)
}


def read_actuation(texts: Sequence[str], manipulator: Manipulator) -> list[float | Target] | TipPosition:
    """Tensions (N) and targets out of texts such as "75 N" and "tip_angle=45 deg": one for all tendons or one each.

    A place of the tip, "tip_position=100, 80 mm from 1 N to 50 N", stands for all tendons.
    """
    name, count = "base_tension", manipulator.num_tendons
    if any(text.partition("=")[0].strip() == TipPosition.quantity for text in texts):
        if len(texts) > 1:
            raise InputError("a tip_position stands for all tendons; give it alone", where=name)
        return _place(name, texts[0], manipulator)
    entries = [_entry(name, text, manipulator) for text in texts]
    if any(isinstance(entry, Target) for entry in entries):
        if len(entries) != count:
            what = f"{len(entries)} given with a target among them"
            raise InputError(what, where=name, remedy=f"give one tension or target for each of {count}")
        return entries
    return one_for_each_tendon(name, entries, count)


def one_for_each_tendon(name: str, values: list[Entry], count: int) -> list[Entry]:
    """The values of an option that may be given once for all tendons."""
    if len(values) not in (1, count):
        raise InputError(f"{len(values)} given; give one for all, or one for each of {count}", where=name)
    return values * count if len(values) == 1 else values


def read_directions(given: Sequence[object] | None, manipulator: Manipulator) -> list[int] | None:
    """The directions of all tendons, from one for all or one for each; None if none is given."""
    name, found = "direction", []
    for value in given or ():
        if isinstance(value, bool) or value not in (1, -1):
            raise InputError(f"{name} {value}: give +1 for a tendon that slides in, -1 for one that slides out")
        found.append(int(str(value)))
    return one_for_each_tendon(name, found, manipulator.num_tendons) if given else None


def _entry(name: str, text: str, manipulator: Manipulator) -> float | Target:
    kind, equals, value = (part.strip() for part in text.partition("="))
    where = f"{name} {text!r}"
    if equals:
        entry = _target(name, where, kind, value, manipulator)
    else:
        kind, entry = "base_tension", quantity(text, "force", name)
    wanted = entry.value if isinstance(entry, Target) else entry
    if kind in ("base_tension", "tip_tension", "total_tension") and wanted < 0:
        raise InputError("a tendon cannot push; give 0 N or more", where=where)
    if kind == "tip_stiffness" and wanted <= 0:
        raise InputError("a stiffness is positive; give more than 0 N/m", where=where)
    return entry


def _place(name: str, text: str, manipulator: Manipulator) -> TipPosition:
    """A place of the tip, and after "from" and "to" the limits of the tensions."""
    what, where = f"{name} {TipPosition.quantity}", f"{name} {text!r}"
    rest, _, most = text.partition("=")[2].partition(" to ")
    place, _, least = rest.partition(" from ")
    value = vector(place.strip(), "length", what)
    if len(value) != (wanted := manipulator.components):
        raise InputError(f"{len(value)} components given; this body needs {wanted}", where=where)
    low = quantity(least.strip(), "force", what) if least else 0.0
    high = quantity(most.strip(), "force", what) if most else None
    if low < 0 or (high is not None and high < low):
        raise InputError("give a least tension of 0 N or more, and a largest that is not below it", where=where)
    return TipPosition(value, low, high)


def _target(name: str, where: str, kind: str, value: str, manipulator: Manipulator) -> Target:
    if kind not in TARGETS:
        remedy = known_names(kind, (*TARGETS, TipPosition.quantity))
        raise InputError(f"unknown target {kind!r}", where=where, remedy=remedy)
    if kind != "curvature":
        return cast(Target, TARGETS[kind](quantity(value, dimension_of(kind), f"{name} {kind}")))
    curvature, at, place = (part.strip() for part in value.partition(" at "))
    if not at:
        raise InputError("say where the curvature is wanted as in 'curvature=12 1/m at 70 mm'", where=where)
    arc_length = quantity(place, "length", f"{name} curvature at")
    if not 0 <= arc_length <= float(manipulator.length):
        remedy = f"give an arc length from 0 mm to {shown(manipulator.length, 'length')}"
        raise InputError(f"{place} is not on the body", where=where, remedy=remedy)
    target = CurvatureAt(quantity(curvature, "curvature", f"{name} curvature"), arc_length)
    return cast(Target, target)  # a field with a converter hides its type from the type checker


def read_loads(
    tip_force: str | None,
    tip_moment: str | None,
    gravity: str | None,
    points: Sequence[str] | None = None,
    mounted: tuple[float, ...] | None = None,
) -> Loads | None:
    """Dead loads out of texts such as "0 N, -5 N", "0.1 N m" and "0, -9.81 m/s^2"; None where there are none.

    In space each has three components, "0, -5, 1 N", the moment as well. `points` are loads at other places than the
    tip, such as "60 mm: 0, -1 N and 0.1 N m". `mounted` is the gravity of the robot file, m/s^2: it acts where no text
    gives gravity, and a text of zeros switches it off.
    """
    own = mounted if gravity is None else vector(gravity, "acceleration", "gravity")
    if mounted is not None and not any(own or ()):
        own = None
    if tip_force is None and tip_moment is None and own is None and not points:
        return None
    return Loads(
        (0.0, 0.0) if tip_force is None else vector(tip_force, "force", "tip_force"),
        0.0 if tip_moment is None else _moment(tip_moment, "tip_moment"),
        (0.0, 0.0) if own is None else own,
        [_point_load(text, "point_load") for text in points or ()],
    )


def _point_load(text: str, name: str) -> PointLoad:
    """A place, a force, and after "and" a moment."""
    place, colon, loads = text.partition(":")
    force, _, moment = (part.strip() for part in loads.partition(" and "))
    if not colon or not force:
        raise InputError(f"{name} needs a place and a force, got {text!r}; write for example '60 mm: 0, -1 N'")
    return PointLoad(
        quantity(place.strip(), "length", name), vector(force, "force", name), _moment(moment, name) if moment else 0.0
    )


def _moment(text: str, name: str) -> float | tuple[float, ...]:
    """A number in the plane, three components in space."""
    if "," not in text:
        return quantity(text, "moment", name)
    if text.count(",") != 2:
        raise InputError(f"{name} is one number in the plane and three in space, got {text!r}; write '0, 0, 0.1 N m'")
    return vector(text, "moment", name)
