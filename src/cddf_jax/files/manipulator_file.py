"""Manipulators in TOML files with units.

    name = "Smooth-Sil 940"              # optional free text, as is description; it is not kept
    length = "140 mm"
    outer_radius = { base = "20 mm", tip = "13 mm" }
    inner_radius = "7 mm"
    youngs_modulus = "1.4 MPa"
    friction_coefficient = 0.42
    density = "1070 kg/m^3"              # optional, 0 unless given
    drag = "0.5 N/m"                     # optional, none unless given: friction per length, tension or not
    yield_strain = "0.8 %"               # optional, or 0.008: `cddf solve` warns if the strain of the wall is larger
    kinematics = "published"             # optional, "exact" unless given
    offsets_outside_wall = true          # optional: tendons may run in the bore or outside the body
    mass_per_length = "0.12 kg/m"        # optional: mass besides density, such as many discs or cables
    friction_moment = "2 mN m"           # optional, none unless given: of friction inside the body
    stiffness_factor = 0.93              # optional, 1 unless given: multiplies all stiffnesses, as a fit finds it
    gravity = ["0 m/s^2", "-9.81 m/s^2"] # optional, none unless given: how the base is mounted against it; see below

    [[tendons]]                          # one such table per tendon
    offset = "10 mm"
    side = 1                             # optional, 1 or -1
    end = "100 mm"                       # optional, the tip unless given
    friction_coefficient = 0.3           # optional, the manipulator's unless given
    drag = "0.2 N/m"                     # optional, the manipulator's unless given
    axial_stiffness = "12 kN"            # optional, E A of the tendon, which does not stretch unless given
    free_length = "300 mm"               # optional, 0 unless given: outside the body, up to the actuator
    outside_compliance = "0.02 mm/N"     # optional, free_length / axial_stiffness unless given
    outside_friction = 0.3               # optional, none unless given: mu times wrap angle of a sheath or pulleys
    outside_drag = "0.5 N"               # optional, none unless given: friction there, whatever the tension

    [[point_mass]]                       # one such table per disc, camera or magnet, if there are any
    at = "140 mm"                        # arc length
    mass = "25 g"

A body is in space where a tendon has an angle around the axis, which is a profile too, with its unit:

    poissons_ratio = 0.5                 # optional, 0.5 unless given; up to 5 for a body that is soft in torsion
    extensible = true                    # optional: the axis stretches and shears
    axial_factor = 0.8                   # optional, 1 unless given: multiplies the axial stiffness
    shear_factor = 0.8                   # optional, 1 unless given: multiplies the shear stiffness
    rest_curvature = ["0 1/m", "2 1/m", "0 1/m"]  # optional, of the unloaded body: twist, about y, about z

    [[tendons]]
    offset = "10 mm"
    angle = "120 deg"                    # "deg", "rad" or "turn"; a helix is { base = "0 deg", tip = "1 turn" }

The angle counts from Y towards Z. Gravity and other loads are vectors in this frame at the base, however it is mounted.

`gravity` has two components (X, Y), or three (X, Y, Z), with which a body is solved in space. X runs along the straight
body from its base. So a body that hangs has `["9.81 m/s^2", "0 m/s^2"]`, one that stands `["-9.81 m/s^2", "0 m/s^2"]`.
The body needs a mass. Every command takes this gravity unless `--gravity`, or the key `gravity` of a load case, gives
another; zeros there switch it off. In Python it is an argument: `cddf.Loads(gravity=read_robot_file(path).gravity)`.

Where E I is known, bending_stiffness = "0.02 N m^2" stands in place of youngs_modulus; both radii may then be left out.
In space torsional_stiffness (N m^2) stands beside it, and where the axis is extensible axial_stiffness and
shear_stiffness (N). They replace what follows from radii, modulus and Poisson's ratio; without radii they are required.

A profile (radius, offset, angle, mass_per_length, youngs_modulus, a stiffness, each part of rest_curvature) is written
in one of these forms, in its own unit; arc lengths count from the base:

    "7 mm"                                                               Constant
    { base = "20 mm", tip = "13 mm" }                                    Linear; length = "..." if not the body's
    { ends = ["40 mm"], pieces = ["20 mm", { base = ..., tip = ... }] }  Piecewise, of profiles in turn
    { lines = [["0 mm", "20 mm"], ["60 mm", "15 mm"], ...] }             Piecewise.linear: [arc length, value]
    { spline = [["0 mm", "20 mm"], ["60 mm", "15 mm"], ...] }            Spline: [arc length, value], four or more

The cross-sections may be a table of their own, measured or from CAD (`cross_sections` shows its columns); then length,
radii and offsets are left out here, and a table [[tendons]] for each column of offsets only where there is more to say:

    cross_sections = "body.csv"          # beside this file; or { file = "body.csv", tolerance = "10 um" }

A passive link is the part of a body beyond the `end` of its tendons, of any radius:

    outer_radius = { lines = [["0 mm", "15 mm"], ["300 mm", "6 mm"], ["350 mm", "5 mm"]] }     and     end = "300 mm"

What is written reads back to the last bit, in float64.
"""

import dataclasses
import os
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError, known_names, needed, within
from ..quantities import QUANTITIES, dimension_of
from ..robot.manipulator import STIFFNESSES, STRAINS, Manipulator, PointMass, Tendon
from ..robot.profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline, as_profile
from ..units import Dimension, quantity, written
from .cross_sections import TOLERANCE, read_cross_sections
from .writing import write_all

_Table = Mapping[str, Any]
_RADII = ("outer_radius", "inner_radius")
_PROFILES = (*_RADII, "youngs_modulus", *STIFFNESSES, "mass_per_length")
_TENDON_PROFILES = ("offset", "angle")
_SWITCHES = ("extensible", "offsets_outside_wall")
_OTHERS = ("kinematics", "rest_curvature", "gravity", *_SWITCHES, "name", "description", "point_mass", "cross_sections")
_UNLESS_GIVEN = {"free_length": 0.0, "poissons_ratio": 0.5}  # defaults, which are not written
_SECTIONS = "cross_sections"
_NUMBERS, _TENDON_NUMBERS = (
    tuple(field.name for field in dataclasses.fields(owner) if field.name in QUANTITIES and field.name not in others)
    for owner, others in ((Manipulator, ("length", *_PROFILES, *_OTHERS)), (Tendon, _TENDON_PROFILES))
)
FORMS = '"7 mm", { base, tip }, { ends, pieces }, { lines } or { spline }'


class RobotFile(NamedTuple):
    """The content of a robot file.

    Attributes:
        manipulator: the body, validated.
        columns: how those of its table of cross-sections were read, in words; empty without a table.
        offsets_outside_wall: whether tendons may run in the bore or outside the body.
        gravity: (X, Y) or (X, Y, Z) in the frame at the base, m/s^2, as `Loads` takes it; None where the file has none.
    """

    manipulator: Manipulator
    columns: dict[str, str]
    offsets_outside_wall: bool
    gravity: tuple[float, ...] | None = None


def read_manipulator(path: str | os.PathLike[str]) -> Manipulator:
    """The manipulator in a TOML file, validated; the module's text shows the format.

    A manipulator holds no gravity. If the file has some, a `UserWarning` says so; `read_robot_file` returns both.

    Raises:
        InputError: names the file, the key, the value and the remedy.
    """
    read = read_robot_file(path)
    if read.gravity is not None:
        remedy = "take both from read_robot_file, and give Loads(gravity=...) to solve"
        warnings.warn(f"{path}: its gravity is no part of a Manipulator; {remedy}", UserWarning, stacklevel=2)
    return read.manipulator


def read_robot_file(path: str | os.PathLike[str]) -> RobotFile:
    """As `read_manipulator`, with everything else in the file: how the base is mounted against gravity, and more.

    Raises:
        InputError: as `read_manipulator`.
    """
    with within(path, ValueError):
        table = read_toml(path, 'length = "140 mm"')
        _check_top(table)
        outside = _switch(table, "offsets_outside_wall")
        sections, columns = _read_sections(table, Path(path).parent) if _SECTIONS in table else (_sections(table), {})
        manipulator = _manipulator(table, sections).validate(offsets_outside_wall=outside)
        return RobotFile(manipulator, columns, outside, _gravity(table["gravity"]) if "gravity" in table else None)


def read_toml(path: str | os.PathLike[str], example: str) -> dict[str, Any]:
    """The tables of a TOML file; errors do not name it. `example` is a line of such a file."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError("is not UTF-8 text; save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML: {error}; quantities are quoted, as in {example}") from None


def write_manipulator(
    manipulator: Manipulator,
    path: str | os.PathLike[str],
    *,
    offsets_outside_wall: bool = False,
    gravity: Sequence[float] | None = None,
) -> None:
    """Write a manipulator as TOML, complete or not at all.

    Args:
        manipulator: its profiles must be those of this package.
        path: the file, replaced if there is one.
        offsets_outside_wall: allow tendons in the bore or outside the body, and say so in the file.
        gravity: (X, Y) or (X, Y, Z) in the frame at the base, m/s^2, of `read_robot_file`; None leaves it out.

    Raises:
        InputError: for a manipulator that `validate` refuses, a profile of another kind, a gravity of another number of
            components or one that is not finite, a file that cannot be written, or without the package tomli-w.
    """
    text = manipulator_text(manipulator, offsets_outside_wall=offsets_outside_wall, gravity=gravity)
    write_all(Path(path).parent, {Path(path).name: text})


def manipulator_text(
    manipulator: Manipulator, *, offsets_outside_wall: bool = False, gravity: Sequence[float] | None = None
) -> str:
    """The text that `write_manipulator` writes."""
    tomli_w = needed("tomli_w", "cli")
    manipulator.validate(offsets_outside_wall=offsets_outside_wall)
    table = _table(manipulator)
    if offsets_outside_wall:
        table["offsets_outside_wall"] = True
    if gravity is not None:
        table["gravity"] = [number_text(component, "acceleration") for component in gravity]
        _gravity(table["gravity"])  # what is written can be read
    return tomli_w.dumps(table)


# --- reading -------------------------------------------------------------------------------------


def _manipulator(table: _Table, sections: dict[str, Any]) -> Manipulator:
    length = sections["length"]
    found = sections | _values(table, length, _PROFILES)
    modulus = found.get("youngs_modulus")
    if isinstance(modulus, Constant):
        found["youngs_modulus"] = modulus.value  # a constant modulus stays a number, named "youngs_modulus"
    masses = []
    for i, mass in enumerate(_tables(table, "point_mass", "mass"), 1):
        with within(f"point_mass {i}"):
            check_keys(mass, ("at", "mass"))
            masses.append(PointMass(quantity(mass["at"], "length", "at"), quantity(mass["mass"], "mass", "mass")))
    return Manipulator(
        **found,
        point_masses=masses,
        kinematics=table.get("kinematics", "exact"),
        extensible=_switch(table, "extensible"),
        rest_curvature=_rest_curvature(table["rest_curvature"], length) if "rest_curvature" in table else None,
    )


def _gravity(value: object) -> tuple[float, ...]:
    """The acceleration of gravity in the frame at the base, m/s^2."""
    if not isinstance(value, list) or len(value) not in (2, 3):
        remedy = 'write ["0 m/s^2", "-9.81 m/s^2"], or three in space'
        raise InputError(f"gravity holds two components X, Y, or three in space, got {value!r}; {remedy}")
    return tuple(quantity(part, "acceleration", f"gravity {axis}") for part, axis in zip(value, "XYZ", strict=False))


def _switch(table: _Table, key: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{key} must be true or false, got {value!r}")
    return value


def _rest_curvature(value: object, length: float) -> list[Profile]:
    if not isinstance(value, list) or len(value) != len(STRAINS):
        remedy = '["0 1/m", "2 1/m", "0 1/m"]: twist, and curvature about y and about z'
        raise InputError(f"rest_curvature holds three profiles, got {value!r}; write {remedy}")
    parts = zip(value, STRAINS, strict=True)
    return [read_profile(part, length, f"rest_curvature: {name}", "curvature") for part, name in parts]


def _values(table: _Table, length: float, profiles: Sequence[str]) -> dict[str, Any]:
    """The profiles and numbers of a table by key, in SI; `length` is that of the body, m."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if key in profiles:
            found[key] = read_profile(value, length, key, dimension_of(key))
        elif key in QUANTITIES and key not in _OTHERS:
            found[key] = quantity(value, dimension_of(key), key)
    return found


def _check_top(table: _Table) -> None:
    """Refuse unknown keys, and those that a table of cross-sections has already; `Manipulator` checks what belongs
    together.
    """
    body, from_table = ("length", *_RADII), _SECTIONS in table
    if from_table and (twice := [key for key in body if key in table]):
        raise InputError(f"{twice[0]} and {_SECTIONS} are both given; leave one of them out")
    required = ("friction_coefficient",) if from_table else ("length", "friction_coefficient", "tendons")
    check_keys(table, required, (*body, "tendons", *_PROFILES, *_NUMBERS, *_OTHERS))


def _sections(table: _Table) -> dict[str, Any]:
    """Length and tendons from their keys."""
    length, tendons = quantity(table["length"], "length", "length"), []
    for number, own in enumerate(_tables(table, "tendons", "tendon"), 1):
        with within(f"tendon {number}", ValueError):
            check_keys(own, ("offset",), ("side", "angle", *_TENDON_NUMBERS))
            tendons.append(Tendon(side=own.get("side", 1), **_values(own, length, _TENDON_PROFILES)))
    return {"length": length, "tendons": tendons}


def _tables(table: _Table, key: str, one: str) -> list[_Table]:
    """The tables below the lines [[key]], one for each `one`."""
    found = table.get(key, [])
    if not isinstance(found, list) or not all(isinstance(own, dict) for own in found):
        raise InputError(f"{key} must be one table per {one}; write each below a line [[{key}]]")
    return found


def _read_sections(table: _Table, folder: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """The body in the CSV file that is named, with the numbers in the tables of the tendons, and its columns."""
    file, tolerance = _named(table[_SECTIONS], folder)
    sections = read_cross_sections(file, tolerance=tolerance)
    tendons = list(sections.tendons)
    tables = _tables(table, "tendons", "tendon") if "tendons" in table else [{}] * len(tendons)
    if len(tables) != len(tendons):
        raise InputError(f"tendons: {len(tables)} tables for {len(tendons)} columns of offsets; write as many, or none")
    for i, own in enumerate(tables):
        with within(f"tendon {i + 1}", ValueError):
            check_keys(own, (), ["angle", *(key for key in _TENDON_NUMBERS if key != "end")])
            tendons[i] = dataclasses.replace(tendons[i], **_values(own, sections.length, _TENDON_PROFILES))
    return sections.body | {"tendons": tendons}, sections.columns


def _named(value: object, folder: Path) -> tuple[Path, float]:
    """The CSV file that is named, and its tolerance, m."""
    match value:
        case str(file):
            return folder / file, TOLERANCE
        case {"file": str(file), "tolerance": str(tolerance), **rest} if not rest:
            return folder / file, quantity(tolerance, "length", f"{_SECTIONS}: tolerance")
    raise InputError(f'{_SECTIONS} must name a CSV file, "body.csv" or {{ file = "body.csv", tolerance = "10 um" }}')


def check_keys(table: _Table, required: Sequence[str], others: Sequence[str] = ()) -> None:
    """Refuse unknown keys, and require those that must be there."""
    known = dict.fromkeys((*required, *others))
    for key in table:
        if key not in known:
            raise InputError(f"unknown key {key!r}", remedy=known_names(key, known))
    for key in required:
        if key not in table:
            raise InputError(f"{key} is missing; add it")


# --- writing -------------------------------------------------------------------------------------


def _table(manipulator: Manipulator) -> dict[str, object]:
    length = manipulator.length
    masses = [
        {"at": number_text(point.arc_length), "mass": number_text(point.mass, "mass")}
        for point in manipulator.point_masses
    ]
    with within("rest_curvature"):
        bent = [profile_form(part, length, "curvature") for part in manipulator.rest_curvature or ()]
    table = _forms(manipulator, ("length", *_PROFILES, *_NUMBERS), length)
    table |= {"kinematics": manipulator.kinematics, "extensible": manipulator.extensible}
    table |= {"rest_curvature": bent, "point_mass": masses, "tendons": []}
    for number, tendon in enumerate(manipulator.tendons, 1):
        with within(f"tendon {number}"):
            side = {"side": tendon.side} if tendon.angle is None else {}
            table["tendons"].append(side | _forms(tendon, (*_TENDON_PROFILES, *_TENDON_NUMBERS), length))
    return {key: value for key, value in table.items() if value is not False and value != []}


def _forms(owner: Manipulator | Tendon, keys: Iterable[str], length: ArrayLike) -> dict[str, Any]:
    """The profiles and numbers that the owner has, by key."""
    found = {}
    for key in keys:
        value = getattr(owner, key)
        if value is not None and not (key in _UNLESS_GIVEN and value == _UNLESS_GIVEN[key]):
            with within(key):
                found[key] = profile_form(as_profile(value), length, dimension_of(key))
    return found


# --- profiles ------------------------------------------------------------------------------------


def read_profile(value: object, length: float, name: str, kind: Dimension) -> Profile:
    """A profile in one of its forms; the length is that of the body, m. Messages begin with `name`."""
    if isinstance(value, str | int | float):
        return Constant(quantity(value, kind, name))
    with within(name, ValueError):  # also for errors of the profile itself, such as a wrong number of values
        match value:
            case {"base": base, "tip": tip, **rest} if rest.keys() <= {"length"}:
                ends = quantity(base, kind, "base"), quantity(tip, kind, "tip")
                return Linear(*ends, length=quantity(rest["length"], "length", "length") if rest else length)
            case {"ends": list(ends), "pieces": list(pieces), **rest} if not rest:
                joints = [quantity(end, "length", "ends") for end in ends]
                parts = [read_profile(own, length, f"piece {i}", kind) for i, own in enumerate(pieces, 1)]
                return Piecewise(joints, parts)
            case {"lines": list(points), **rest} if not rest:
                return Piecewise.linear(*_points(points, "lines", kind))
            case {"spline": list(points), **rest} if not rest:
                return Spline(*_points(points, "spline", kind))
    raise InputError(f"{name} is not a profile, got {value!r}; write {FORMS}")


def _points(points: Sequence[object], name: str, kind: Dimension) -> tuple[list[float], list[float]]:
    knots, values = [], []
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            raise InputError(f'{name} holds pairs [arc length, value], got {point!r}; write ["60 mm", "15 mm"]')
        knots.append(quantity(point[0], "length", name))
        values.append(quantity(point[1], kind, name))
    return knots, values


def profile_form(profile: Profile, length: ArrayLike, kind: Dimension) -> object:
    """A profile in one of the forms that `read_profile` reads."""
    value = partial(number_text, kind=kind)
    match profile:
        case Constant():
            return value(profile.value)
        case Linear():
            own = {} if profile.length == length else {"length": number_text(profile.length)}
            return {"base": value(profile.base), "tip": value(profile.tip), **own}
        case Piecewise():
            pieces = [profile_form(piece, length, kind) for piece in profile.pieces]
            return {"ends": [number_text(end) for end in profile.ends], "pieces": pieces}
        case Polyline() | Spline():
            points = zip(profile.arc_length, profile.values, strict=True)
            form = "lines" if isinstance(profile, Polyline) else "spline"
            return {form: [[number_text(s), value(v)] for s, v in points]}
    raise InputError(
        f"a profile of type {type(profile).__name__} cannot be written to a file; "
        "sample it into a Spline or Piecewise.linear"
    )


def number_text(value: ArrayLike, kind: Dimension = "length") -> float | str:
    """A number for a file, with its unit if it has one."""
    number = float(np.asarray(value))
    return number if kind in ("dimensionless", "strain") else written(number, kind)
