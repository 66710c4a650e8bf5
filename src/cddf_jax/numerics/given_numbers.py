"""Numbers as a user gives them from Python: what NumPy would turn into a number that nobody meant is refused."""

from decimal import Decimal
from numbers import Real
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..units import DIMENSION_OF

_SHOWN = 60  # characters of what was given
_ALONE = "give the number alone, in SI units"
_UNIT = "a number with a unit", f"{_ALONE} (pint: value.to_base_units().magnitude)"
_MASK = "a masked value", "leave it out, or in a table give values.filled(numpy.nan)"
_TRUTH = "a truth value", "give numbers"
_OTHER = "something other than a number", "give numbers in SI units"
_OF_KIND = {
    "b": _TRUTH,
    "c": ("a complex number", "give real numbers"),
    **dict.fromkeys("mM", ("a date or duration", "give times as numbers, in seconds")),
    **dict.fromkeys("SUT", ("text", _ALONE)),
}


def check_numbers(what: str, given: object) -> None:
    """Refuse units, masked values, text, truth values, dates and complex numbers; traced arrays pass.

    NumPy drops units and masks without an error, and reads "75" and True as numbers. None in a list passes, as it is
    a missing reading. An array of xarray may name an SI unit, as the results of a sweep do.

    Args:
        what: which numbers, for the message; "" where they have no name.
        given: a number, an array, a column of a table, or a list of them.

    Raises:
        InputError: says what is wrong, shows what was given, and names the remedy.
    """
    if type(given) in (float, int):
        return
    if isinstance(given, list | tuple):
        for entry in given:
            if entry is not None:
                check_numbers(what, entry)
    elif objection := _objection(given):
        (found, remedy), got = objection, " ".join(repr(given).split())
        got = got if len(got) <= _SHOWN else got[:_SHOWN] + "..."
        raise InputError(f"{found} cannot be used, got {got}", where=what, remedy=remedy)


def check_whole(what: str, given: object, least: int) -> None:
    """Check a number that counts something.

    Raises:
        InputError: for anything but a whole number of `least` or more.
    """
    if isinstance(given, bool) or not isinstance(given, int) or given < least:
        raise InputError(f"{what} must be a whole number of {least} or more, got {given!r}")


def _objection(given: Any) -> tuple[str, str] | None:
    """What is wrong, and the remedy; None for plain numbers."""
    if isinstance(given, jax.Array):
        return _OF_KIND.get(given.dtype.kind)
    if isinstance(given, bool):
        return _TRUTH
    if _has_unit(given):
        return _UNIT
    if np.ma.is_masked(given):
        return _MASK
    try:
        kind = given.dtype.kind if hasattr(given, "dtype") else np.asarray(given).dtype.kind
        entries = [entry for entry in np.ravel(given) if entry is not None] if kind == "O" and np.ndim(given) else None
    except Exception:  # objects may refuse to become an array by errors of any kind
        return _OTHER
    if kind != "O":
        return _OF_KIND.get(kind)
    if entries is None:
        return None if isinstance(given, Real | Decimal) else _OTHER
    return next(filter(None, map(_objection, entries)), None)


def _has_unit(given: Any) -> bool:
    """Whether an object carries a unit, other than an SI unit that an array of xarray names."""
    attributes = getattr(given, "attrs", None)  # of xarray and pandas
    if isinstance(attributes, dict) and (unit := attributes.get("units")):
        return unit not in DIMENSION_OF
    inner = getattr(given, "data", None) if attributes is not None else None
    dtype = getattr(given, "dtype", None)
    if getattr(dtype, "kind", "") in ("m", "M"):  # whose unit is that of time
        return False
    return any(hasattr(part, name) for part in (given, dtype, inner) for name in ("units", "unit"))
