"""The free numbers of a design: their names, their bounds, and the bodies that they make."""

import re
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from ..numerics.given_numbers import check_numbers
from ..robot.manipulator import Manipulator
from ..statics.named_numbers import Case, stem_and_tendon
from ..units import DIMENSION_OF, Dimension
from .load_cases import LoadCase

VALUE = re.compile(r"(pieces\.\d+\.?)*(base|tip|values\.\d+|\d+)?")  # a part of a profile
PLACE = re.compile(r"\.(ends\.\d+|arc_length\.\d+|length|end)$")  # an arc length: of such a part, or of an anchor
WIDE = 10.0  # default bounds: a tenth of the start value, and ten times it; for an angle half a turn either way
Vector = Float[Array | np.ndarray, " n"]
Bounds = Mapping[str, tuple[float, float]]  # (lower, upper) by name, SI


class FreeNumbers(eqx.Module):
    """Free numbers x, scaled to z = (x - lower) / size.

    Several names in one entry share one number, such as the offsets of all tendons by "tendons.*.offset".
    """

    names: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    start: Vector
    lower: Vector
    upper: Vector
    size: Vector

    def label(self, i: int) -> str:
        """The name of a free number in tables."""
        names = self.names[i]
        return names[0] if len(names) == 1 else names[0].replace("tendons.0.", "tendons.*.")

    @property
    def scaled_start(self) -> np.ndarray:
        return np.asarray(self.scaled(self.start))

    @property
    def ranges(self) -> np.ndarray:
        """The upper bounds of the scaled numbers; their lower bounds are 0."""
        return np.asarray(self.scaled(self.upper))

    def numbers(self, z: Vector) -> Vector:
        return self.lower + self.size * z

    def scaled(self, numbers: Vector) -> Vector:
        return (numbers - self.lower) / self.size

    def applied(self, manipulator: Manipulator, case: LoadCase, z: Vector) -> tuple[Manipulator, LoadCase]:
        """Body and load case with the free numbers in them."""
        x = self.numbers(jnp.asarray(z))
        return case.with_numbers(manipulator, {name: x[i] for i, names in enumerate(self.names) for name in names})


def dimension_in(case: Case, name: str) -> Dimension:
    """The dimension of a number of a case, whose targets are angles or places in the place of tensions."""
    return DIMENSION_OF[case.unit(name)]


def free_numbers_of(case: Case, free: Sequence[str], bounds: Bounds) -> FreeNumbers:
    """The free numbers with these names, and their bounds; the case is the start.

    A name is that of a number, or of a profile for all its values: "outer_radius", "length", "tendons.*.offset".
    """
    if any(stem_and_tendon(str(name))[0] == "direction" for name in free):
        raise InputError("design: a direction cannot be free; it is 1 or -1")
    if isinstance(free, str) or not free or not all(isinstance(name, str) for name in free):
        raise InputError('design: free must list one name or more, as in free=("outer_radius",)')
    for name in bounds:
        if name not in free:
            raise InputError(f"design: {name!r} has bounds and is not free; add it to free")
    rows, dimensions = [], []
    for group in free:
        for tied in numbers_under(case, group):
            value = _shared(case, group, tied)
            dimensions.append(dimension_in(case, tied[0]))
            rows.append((tied, value, *_bounds_of(group, value, bounds, dimensions[-1])))
    flat = [name for tied, *_ in rows for name in tied]
    for name in flat:
        if flat.count(name) > 1:
            raise InputError(f"design: {name!r} is free twice; leave one out")
    names = tuple(tied for tied, *_ in rows)
    start, low, high = np.transpose([numbers for _, *numbers in rows])
    origin = (start == 0) | (np.array(dimensions) == "angle")  # numbers that have no size of their own
    size = np.minimum(high - low, np.where(origin, np.inf, np.abs(start)))
    return FreeNumbers(names, start, low, high, size)


def _shared(case: Case, group: str, tied: tuple[str, ...]) -> float:
    """The start value of numbers that share one value."""
    values = [float(np.asarray(case.number(name))) for name in tied]
    if np.ptp(values) > 1e-9 * np.max(np.abs(values)):
        listed = ", ".join(f"{value:g}" for value in values)
        raise InputError(f"design: {group!r} starts at different values, {listed}; make them one, or name each tendon")
    return values[0]


def _bounds_of(group: str, value: float, bounds: Bounds, dimension: Dimension) -> tuple[float, float]:
    if group not in bounds:
        if dimension == "angle":  # whose zero is arbitrary
            return value - np.pi, value + np.pi
        if value <= 0:
            raise InputError(f"design: {group!r} starts at {value:g}; give it bounds")
        return value / WIDE, value * WIDE
    check_numbers(f"design: the bounds of {group!r}", bounds[group])
    try:
        lower, upper = (float(x) for x in bounds[group])
    except (TypeError, ValueError):
        got = np.asarray(bounds[group]).tolist()
        raise InputError(f"design: the bounds of {group!r} must be (lower, upper), got {got!r}") from None
    if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
        raise InputError(f"design: the bounds of {group!r} must be finite and increase, got {lower:g} and {upper:g}")
    if not lower <= value <= upper:
        raise InputError(
            f"design: {group!r} starts at {value:g}, outside its bounds {lower:g} to {upper:g}; "
            "widen them or start elsewhere"
        )
    return lower, upper


def numbers_under(case: Case, group: str) -> list[tuple[str, ...]]:
    """The numbers that a free name stands for, each with those that share its value."""
    if "*" not in group:
        return [(name,) for name in _within(case, group)]
    if not group.startswith("tendons.*."):
        raise InputError(f"design: {group!r}: a * stands for all tendons, as in 'tendons.*.offset'")
    each = [_within(case, group.replace("*", str(i))) for i in range(case.manipulator.num_tendons)]
    if len({len(names) for names in each}) > 1:
        raise InputError(f"design: {group!r}: the tendons are of different kinds; name them one by one")
    return list(zip(*each, strict=True))


def _within(case: Case, name: str) -> list[str]:
    """The numbers that a name stands for: of a profile its values, not their arc lengths."""
    inside = [other for other in case.numbers if other.startswith(f"{name}.") and not PLACE.search(other)]
    if inside and all(VALUE.fullmatch(other.removeprefix(f"{name}.")) for other in inside):
        return inside
    number = case.number(name)
    if not isinstance(number, float | np.ndarray | jax.Array) or np.ndim(number) != 0:
        raise InputError(f"design: {name!r} is not a number here; give it a value at the start, or name a part of it")
    return [name]
