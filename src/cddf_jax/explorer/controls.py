"""The numbers that can be changed: their names, their ranges, and their units as shown."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple, SupportsFloat

import numpy as np
from jaxtyping import ArrayLike

from ..identification.parameters import starting_value, stiffness_parameter
from ..measurements.table import Measurements
from ..numerics.arrays import evaluated
from ..quantities import QUANTITIES, Quantity
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.named_numbers import of_tendon
from ..units import round_number

FITTED = ("friction_coefficient", "youngs_modulus", "stiffness_factor")  # a body has one of the last two
RADII = ("outer_radius.base", "outer_radius.tip")
LOADS = ("tip_force", "tip_moment", "gravity")


class Control(NamedTuple):
    """One number that can be changed, in the unit that is shown."""

    name: str
    value: float
    low: float
    high: float
    least: float | None = None  # the least number that may be typed
    which: str = ""  # which of several numbers of one kind it is, in words

    @property
    def quantity(self) -> Quantity:
        """The kind of number: "base_tension" of "base_tension_2", "outer_radius" of "outer_radius.tip"."""
        return QUANTITIES[re.split(r"_\d|\.", self.name)[0]]

    @property
    def label(self) -> str:
        return self.quantity.label + self.which

    @property
    def step(self) -> float:
        return round_number((self.high - self.low) / 200)


def controls_of(
    body: Manipulator, tables: Sequence[Measurements], arc_length: np.ndarray, gravity: Sequence[float] = ()
) -> tuple[Control, ...]:
    """Everything that can be changed, tensions first and loads last, with ranges about the numbers of a body.

    Args:
        body: whose numbers they are.
        tables: of measurements on it; the range contains their tensions.
        arc_length: m, a grid along it.
        gravity: m/s^2, the components at the start; 0 for those that are left out.
    """
    name = stiffness_parameter(body)
    mu, value = float(body.friction_coefficient), from_si(starting_value(body, name), QUANTITIES[name])
    friction = Control(FITTED[0], mu, 0.0, max(1.0, _above(2 * mu)), 0.0)
    own = all(tendon.friction_coefficient is not None for tendon in body.tendons)
    stiffness = Control(name, value, round_number(0.2 * value), _above(2.5 * value), 1e-6)
    tensions = _tensions(body, tables, arc_length)
    return (*tensions, *([] if own else [friction]), stiffness, *_radii(body), *_loads(body, arc_length, gravity))


def _tensions(body: Manipulator, tables: Sequence[Measurements], s: np.ndarray) -> list[Control]:
    offset = np.maximum(evaluated(Manipulator.offset, body, s), 1e-3 * float(body.length))
    stiffness = evaluated(Manipulator.stiffness, body, s)
    turn = np.max(np.trapezoid(offset / stiffness, s))  # of the tip per tension, without friction
    most = min(2.0 / turn, 0.3 * float(np.min(stiffness / offset**2)))
    measured = [float(np.nanmax(table["base_tension"])) for table in tables if "base_tension" in table]
    high = _above(max([most, *measured]))
    which = [f" {i + 1}" if body.num_tendons > 1 else "" for i in range(body.num_tendons)]
    return [
        Control(of_tendon("base_tension", i), 0.0 if i else 0.75 * high, 0.0, high, 0.0, text)
        for i, text in enumerate(which)
    ]


def _radii(body: Manipulator) -> list[Control]:
    if body.outer_radius is None or not body.stiffened_by_radii:
        return []
    ends = evaluated(body.outer_radius, np.array([0.0, body.length]))
    ends = [from_si(end, QUANTITIES["outer_radius"]) for end in ends]
    which = (" at the base", " at the tip")
    return [Control(n, r, 0.5 * r, 1.5 * r, 0.0, text) for n, r, text in zip(RADII, ends, which, strict=True)]


def _loads(body: Manipulator, s: np.ndarray, gravity: Sequence[float]) -> list[Control]:
    length, stiffness = float(body.length), float(np.median(evaluated(Manipulator.stiffness, body, s)))
    force, moment = _above(0.6 * stiffness / length**2), _above(0.3 * stiffness / length)
    most: dict[str, float] = dict(zip(LOADS, (force, moment, max([10.0, *map(abs, gravity)])), strict=True))
    start = {f"gravity.{i}": float(value) for i, value in enumerate(gravity)}
    return [
        Control(name, start.get(name, 0.0), -most[kind], most[kind], which=f" {axis}".rstrip())
        for kind, components in load_components(body).items()
        for name, axis in components.items()
    ]


def load_components(body: Manipulator) -> dict[str, dict[str, str]]:
    """Names and axes of the components of each load that can act; a moment in the plane has one and no axis."""
    kinds = [kind for kind in LOADS if kind != "gravity" or body.has_mass]
    found = {kind: {f"{kind}.{i}": axis for i, axis in enumerate("XYZ"[: body.components])} for kind in kinds}
    return found if body.in_space else found | {"tip_moment": {"tip_moment": ""}}


def loads_by_name(body: Manipulator, numbers: Mapping[str, ArrayLike]) -> Loads | None:
    """Loads from their components by name, SI, each a number or a path; None if all are zero."""
    given = {kind: np.stack([numbers[name] for name in names], -1) for kind, names in load_components(body).items()}
    if not any(map(np.any, given.values())):
        return None
    return Loads(**(given if body.in_space else given | {"tip_moment": given["tip_moment"][..., 0]}))


# --- units -----------------------------------------------------------------------------------------


def in_si(value: float, quantity: Quantity) -> float:
    """A number in its shown unit, converted to SI without rounding errors: 12.7 mm is 0.0127."""
    return float(f"{value / quantity.shown[0]:.15g}")


def from_si(value: SupportsFloat, quantity: Quantity) -> float:
    """An SI number in its shown unit."""
    return float(f"{float(value) * quantity.shown[0]:.15g}")


def rounded(value: float, low: float, high: float) -> float:
    """A value rounded to two digits of the half-width of its 95 % interval from low to high."""
    half_width = 0.5 * (high - low)
    if not 0 < half_width < np.inf:
        return value
    return round(value, 1 - int(np.floor(np.log10(half_width))))


def _above(value: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that is not below a positive value."""
    return 1.0 / round_number(1.0 / value)
