"""Quantities with units: text such as "140 mm" to SI numbers, and back.

Sizes of units are decimal numbers, so that "140 mm" is 0.14 to the last bit. The units of `_UNITS` are known here. Pint
knows all others; it is imported only when one of them is used.
"""

import math
import re
from collections.abc import Sequence
from decimal import Context, Decimal
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, SupportsFloat, TypeAlias, cast

import numpy as np

from .errors import InputError

if TYPE_CHECKING:
    import pint

Dimension: TypeAlias = str  # one of those in `_UNITS`


class _Units(NamedTuple):
    si: str
    preferred: str  # what an engineer writes
    size: str = "1"  # of the preferred unit, in SI units, to 28 digits


_UNITS: dict[Dimension, _Units] = {
    "length": _Units("m", "mm", "1e-3"),
    "force": _Units("N", "N"),
    "pressure": _Units("Pa", "MPa", "1e6"),
    "density": _Units("kg/m^3", "kg/m^3"),
    "angle": _Units("rad", "deg", "0.01745329251994329576923690768"),
    "moment": _Units("N m", "N m"),
    "acceleration": _Units("m/s^2", "m/s^2"),
    "curvature": _Units("1/m", "1/m"),
    "stiffness": _Units("N/m", "N/m"),
    "compliance": _Units("m/N", "mm/N", "1e-3"),
    "stretch": _Units("1/N", "1/N"),
    "force per length": _Units("N/m", "N/m"),
    "torsional stiffness": _Units("N m^2", "N m^2"),
    "bending stiffness": _Units("N m^2", "N m^2"),
    "mass per length": _Units("kg/m", "kg/m"),
    "mass": _Units("kg", "g", "1e-3"),
    "volume": _Units("m^3", "cm^3", "1e-6"),
    "time": _Units("s", "s"),
    "energy": _Units("J", "mJ", "1e-3"),
    "strain": _Units("", "%", "1e-2"),
    "dimensionless": _Units("", ""),
}

DIMENSION_OF: dict[str, Dimension] = {known.si: dimension for dimension, known in _UNITS.items() if known.si}
DIMENSION_OF["1"] = "dimensionless"  # by the SI unit

_DECIMAL = Context(prec=40, traps=[])  # a float64 has 17 digits, the size of a unit 28 at most
_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)\b)(?:\s*([^\d\s.,+-].*)|\s+(1\s*/.*))?",
    re.I,
)
_SCALED = re.compile(r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)\s*([A-Za-zµ°%].*)")  # "0.05 mm", of a count
_WORDS = re.compile(r"(newton|degree|radian|(milli|centi)?met(er|re)|(kilo)?gram|second)s?|deg|rad", re.I)  # any case
_AMBIGUOUS = re.compile("grad|px|pixels?", re.I)  # degrees in German, but gon or giga-radians to pint; of a camera
_NEWTON_METRES = re.compile(r"([mk]?N)(m?m)")  # in one word, which pint reads as a unit of yarn


def quantity(text: object, dimension: Dimension, what: str) -> float:
    """The SI value of a number with its unit, such as "140 mm", "1.4 MPa" or "30 deg".

    Args:
        text: number and unit; for "dimensionless" a plain number, text or not; for "strain" a plain number or per cent.
        dimension: what is measured, such as "length" or "dimensionless".
        what: the name of the quantity, with which an error message begins.

    Raises:
        InputError: for text that is not a number, a missing, unknown or wrong unit, NaN or infinity.
    """
    match = None if isinstance(text, bool) else _QUANTITY.fullmatch(str(text).rstrip())
    plain = dimension == "dimensionless"
    example = "0.42" if plain else repr(f"12.5 {_UNITS[dimension].preferred}")
    if match is None:
        raise InputError(f"{what} is not a number, got {text!r}; write for example {example}")
    number, unit = match[1], match[2] or match[3]
    if plain and unit:
        raise InputError(f"{what} is a plain number, got {text!r}; leave the unit {unit!r} out")
    size = _size_in_si(unit or "", dimension, what, f"got {text!r}", example)
    value = float(_DECIMAL.multiply(_DECIMAL.create_decimal(number), size))
    if not math.isfinite(value):
        raise InputError(f"{what} must be finite, got {text!r}; write for example {example}")
    return value


def vector(text: str, dimension: Dimension, what: str) -> tuple[float, ...]:
    """The SI values of components such as "0 N, -5 N", in space three, or with one unit for all "0, -5 N"."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) not in (2, 3):
        unit, wanted = _UNITS[dimension].preferred, "two components X, Y, or three in space"
        raise InputError(f"{what} needs {wanted}, got {text!r}; write for example '0 {unit}, -12.5 {unit}'")
    named = zip(_with_their_unit(parts), "XYZ", strict=False)
    return tuple(quantity(part, dimension, f"{what} {axis}") for part, axis in named)


def series(text: str, dimensions: Sequence[Dimension], what: str) -> tuple[list[float], Dimension]:
    """The SI values of a list such as "0 N, 75 N, 40 N", or with one unit for all "0, 75, 40 N", and their dimension.

    It is one of `dimensions`; if the unit is missing or unknown, the error message names the first of these. The
    message begins with `what`, as in `quantity`.
    """
    parts = _with_their_unit([part.strip() for part in text.split(",")])
    unit = _unit_of(parts[0])
    fitting: list[Dimension] = [one for one in dimensions if unit and unit_fits(unit, one)]
    dimension = (fitting or dimensions)[0]
    return [quantity(part, dimension, what) for part in parts], dimension


def _with_their_unit(parts: list[str]) -> list[str]:
    """The parts, in which numbers without a unit take the unit of the others, if these have the same one."""
    units = {unit for part in parts if (unit := _unit_of(part))}
    if len(units) != 1:
        return parts
    (unit,) = units
    return [f"{part} {unit}" if _QUANTITY.fullmatch(part) and not _unit_of(part) else part for part in parts]


def _unit_of(part: str) -> str | None:
    found = _QUANTITY.fullmatch(part)
    return found and (found[2] or found[3])


def to_si(values: np.ndarray, unit: str, dimension: Dimension, what: str) -> np.ndarray:
    """A whole column of numbers in one unit, such as "mm", converted to SI; for all dimensions but "dimensionless".

    Counts have a unit with a scale, such as "0.05 mm" for each; one below 0 turns the sign.

    Raises:
        InputError: for a missing, unknown or wrong unit; the message begins with `what`, the name of the column.
    """
    example = f"[{_UNITS[dimension].preferred}]"
    got, (scale, unit) = f"got [{unit}]" if unit else "got none", _scaled(unit)
    size = scale * _size_in_si(unit, dimension, what, got, example)
    inverse = 1 / size
    if size < 1 and inverse == int(inverse):  # division by 1000 rounds once
        return values / float(inverse)
    return values * float(size)


def _scaled(unit: str) -> tuple[Decimal, str]:
    """The number in front of a unit, 1 without one, and the unit."""
    found = _SCALED.fullmatch(unit)
    scale = Decimal(found[1]) if found else Decimal(1)
    return (scale, found[2]) if found and scale else (Decimal(1), unit)


def unit_fits(unit: str, dimension: Dimension) -> bool:
    """Whether a text is a unit of a dimension, or one for which `to_si` has its own message: a mass."""
    if dimension == "dimensionless":
        return False
    unit = _scaled(unit)[1]
    return _size(unit, dimension) is not None or (dimension == "force" and _is_mass(unit))


def written(value: float, dimension: Dimension) -> str:
    """The text of a finite SI value, such as "140 mm", that `quantity` turns back into the same float64.

    The unit is the preferred one if that is exact, else the SI unit.
    """
    if dimension == "dimensionless":
        return repr(float(value))
    si, unit, size = _UNITS[dimension]
    exact, size = Decimal(repr(float(value))), Decimal(size)
    for digits in (15, 16, 17):
        number = Context(prec=digits).divide(exact, size).normalize()
        if float(_DECIMAL.multiply(number, size)) == value:
            return f"{number:f} {unit}" if -6 <= number.adjusted() <= 15 else f"{number} {unit}"
    return f"{float(value)!r} {si}"


def shown(value: SupportsFloat | complex, dimension: Dimension) -> str:
    """The text of an SI value for people, rounded to five digits: "140 mm", "63.167 deg", of a plain number "0.42"."""
    scale, unit = preferred(dimension)
    return f"{float(np.asarray(value)) * scale:.5g} {unit}".rstrip()


def round_number(value: float) -> float:
    """The greatest of 1, 2 and 5 times a power of ten that does not exceed a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-12)))


def preferred(dimension: Dimension) -> tuple[float, str]:
    """The factor from the SI unit to the preferred unit, and this unit; 1 and "" for a plain number."""
    known = _UNITS[dimension]
    return float(1 / Decimal(known.size)), known.preferred


def si_unit(dimension: Dimension) -> str:
    """The unit of SI numbers; "1" for a plain number."""
    return _UNITS[dimension].si or "1"


def _size_in_si(unit: str, dimension: Dimension, what: str, got: str, example: str) -> Decimal:
    """How many SI units of the dimension one `unit` is."""
    if dimension == "moment":
        unit = _NEWTON_METRES.sub(r"\1 \2", unit)
    if (size := _size(unit, dimension)) is not None:
        return size
    if dimension == "force" and _is_mass(unit):
        example += "; a mass is not a force: did you mean gf or kgf, its weight?"
    unknown = f" with the unknown unit {unit!r}" if unit and _in_si(unit)[1] is None else ""
    raise InputError(f"{what} needs a unit of {dimension}, {got}{unknown}; write for example {example}")


def _size(unit: str, dimension: Dimension) -> Decimal | None:
    """How many SI units one `unit` is; None if it is none of this dimension."""
    known = _UNITS[dimension]
    if unit in (known.preferred, known.si):  # without pint
        return Decimal(known.size if unit == known.preferred else 1)
    size, base = _in_si(unit)
    return size if base is not None and base == _in_si(known.si)[1] else None


def _is_mass(unit: str) -> bool:
    return _in_si(unit)[1] == _in_si("kg")[1]


@cache
def _in_si(unit: str) -> tuple[Decimal, object]:
    """The size of a unit in SI base units, and these base units: None for an unknown unit."""
    if _AMBIGUOUS.fullmatch(unit):
        return Decimal("nan"), None
    try:
        spelt = unit.lower() if _WORDS.fullmatch(unit) else unit
        size, base = _registry().get_base_units(_registry().parse_units(spelt))
    except Exception:  # pint's parser raises errors of many kinds, AssertionError and TokenError among them
        return Decimal("nan"), None
    return Decimal(str(size)), base


@cache
def _registry() -> "pint.UnitRegistry":
    import pint

    return pint.UnitRegistry(non_int_type=cast("type[float]", Decimal))  # its annotation allows float alone
