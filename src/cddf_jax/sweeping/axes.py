"""The axes of a sweep: what varies along each dimension of its answer."""

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from ..errors import InputError, within
from ..mechanics.problem import Method
from ..robot.manipulator import KINEMATICS
from ..robot.named_numbers import Case, holds, stem_and_tendon
from ..robot.validation import check_weight
from ..statics.arguments import check_nodes

OPTIONS = ("nodes", "method", "kinematics")  # each value is a program of its own
PATH = "path"  # the attribute of an answer that names the dimension whose base tensions were traced in their order
RESERVED = ("tendon", "point", "component", "axis", "result", "successful")


class Dimension(NamedTuple):
    """A dimension of the answer; everything along it has one length."""

    name: str
    numbers: dict[str, np.ndarray]  # by the name of a number of the case
    options: dict[str, tuple[object, ...]]

    @property
    def size(self) -> int:
        return len(next(iter((self.numbers | self.options).values())))


def dimensions_of(axes: object) -> tuple[Dimension, ...]:
    """The dimensions of a sweep from its argument `axes`.

    Raises:
        InputError: names the axis and the remedy.
    """
    if not isinstance(axes, Mapping) or not axes:
        raise InputError('sweep: axes must be a dictionary such as {"base_tension": values}, with one axis or more')
    found = tuple(_dimension(name, values) for name, values in axes.items())
    names = [name for dimension in found for name in (*dimension.numbers, *dimension.options)]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"sweep: {name!r} varies along two axes; let it vary along one")
        inner = [other for other in names if holds(name, other)]
        if inner:
            raise InputError(f"sweep: {name!r} holds {inner[0]!r}; let only one of them vary")
    return found


def _dimension(name: object, values: object) -> Dimension:
    if not isinstance(name, str) or not name or "/" in name or name in RESERVED:
        raise InputError(f"sweep: a dimension cannot be called {name!r}; rename it")
    together = values if isinstance(values, Mapping) else {name: values}
    if not together:
        raise InputError(f"sweep: nothing varies along the axis {name!r}; give names and values")
    options = {key: _options(key, given) for key, given in together.items() if key in OPTIONS}
    numbers = {key: _numbers(key, given) for key, given in together.items() if key not in OPTIONS}
    sizes = {key: len(given) for key, given in (numbers | options).items()}
    if len(set(sizes.values())) > 1:
        got = ", ".join(f"{key} {size}" for key, size in sizes.items())
        raise InputError(f"sweep: what varies together along {name!r} must have one length, got {got}")
    return Dimension(name, numbers, options)


def _numbers(name: str, given: object) -> np.ndarray:
    try:
        values = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"sweep: the axis {name!r} must be a list of numbers, got {given!r}") from None
    if values.ndim != 1 or values.size == 0:
        raise InputError(f"sweep: the axis {name!r} must be a list of one number or more, got shape {values.shape}")
    if stem_and_tendon(name.split(".")[0])[0] == "direction" and not np.all(np.abs(values) == 1):
        raise InputError(f"sweep: the axis {name!r} must hold 1 for sliding in and -1 for sliding out, got {given!r}")
    if not np.all(np.isfinite(values)):
        place = int(np.argmin(np.isfinite(values)))
        raise InputError(f"sweep: the axis {name!r} holds {values[place]} at place {place}; leave it out")
    return values


def _options(name: str, given: object) -> tuple[object, ...]:
    values = tuple(given) if isinstance(given, list | tuple | np.ndarray | range) else ()
    values = tuple(value.item() if isinstance(value, np.generic) else value for value in values)
    if not values:
        raise InputError(f"sweep: the axis {name!r} must be a list of one value or more, got {given!r}")
    for value in values:
        if name == "nodes":
            with within("sweep", ValueError):
                check_nodes(value)
        elif name == "kinematics" and value not in KINEMATICS:
            raise InputError(f"sweep: kinematics {value!r} is not known; there are {', '.join(KINEMATICS)}")
        elif name == "method" and (not isinstance(value, Method) or isinstance(value, type)):
            raise InputError(f"sweep: method must be one such as FixedPoint(), got {value!r}")
    return values


def check_names(
    dimensions: tuple[Dimension, ...], sensitivities: tuple[str, ...], case: Case, wall_is_seen: bool
) -> None:
    """Refuse names that are not numbers of the case, and numbers that have no effect.

    Args:
        dimensions: what varies.
        sensitivities: names to differentiate by.
        case: what is solved.
        wall_is_seen: whether an output depends on the outer radius itself, as the strain of the wall does.

    Raises:
        InputError: names it, and what is near.
    """
    swept = {name for dimension in dimensions for name in dimension.numbers}
    for name in swept:
        case.number(name)
    length = None if "length" in swept else float(np.asarray(case.manipulator.length))
    for dimension in dimensions:
        for name, values in dimension.numbers.items():
            outside = values[(values <= 0) | (values > (length or np.inf))]
            if re.fullmatch(r"tendons\.\d+\.end", name) and outside.size:
                raise InputError(
                    f"sweep: the axis {name!r} holds {outside[0]:g} m, which is not on the body; leave it out"
                )
    for name, remedy in _idle(swept, case, wall_is_seen).items():
        raise InputError(f"sweep: {name!r} has no effect here; {remedy}")
    tension = case.base_tension
    if tension is None and "base_tension" not in swept:
        raise InputError("sweep: base_tension is neither given nor an axis; give one of the two")
    for name in sensitivities:
        if name in OPTIONS or stem_and_tendon(name)[0] == "direction":
            raise InputError(f"sweep: nothing can be differentiated by {name!r}; take it out of the sensitivities")
        if case.number(name) is None and name not in swept:
            raise InputError(f"sweep: the case has no {name!r} to differentiate by; give it a value")
        wider = [other for other in swept if holds(other, name) or holds(name, other)]
        if wider:
            close = get_close_matches(name, wider, 1) or wider
            raise InputError(f"sweep: {name!r} and the axis {close[0]!r} overlap; differentiate by {close[0]!r} itself")


def _idle(swept: set[str], case: Case, wall_is_seen: bool) -> dict[str, str]:
    """Numbers that have no effect on the answer, each with the remedy."""
    found: dict[str, str] = {}
    if "yield_strain" in swept:
        found["yield_strain"] = "it only says when a solve warns; ask for the output peak_strain"
    for i, tendon in enumerate(case.manipulator.tendons):
        stiff = tendon.axial_stiffness is None and f"tendons.{i}.axial_stiffness" not in swept
        if f"tendons.{i}.free_length" in swept and stiff:
            found[f"tendons.{i}.free_length"] = "the tendon does not stretch; give it an axial_stiffness"
    body, loads = case.manipulator, case.loads
    for name in ("friction_coefficient", "drag"):
        if name in swept and all(getattr(tendon, name) is not None for tendon in body.tendons):
            found[name] = f"every tendon has its own; let 'tendons.0.{name}' vary"
    gravity = {name for name in swept if name.startswith("loads.gravity.")}
    weightless = loads is None or not np.any(np.asarray(loads.gravity))
    masses = {name for name in swept if name.split(".")[0] in ("density", "mass_per_length", "point_masses")}
    if masses and not gravity and weightless:
        found[min(masses)] = "there is no gravity; give loads=Loads(gravity=(0.0, -9.81))"
    if gravity and not masses and not body.has_mass:
        found[min(gravity)] = "the body has no weight; give it density, mass_per_length or point_masses"
    if not masses and not gravity:
        check_weight(body, loads)
    if "poissons_ratio" in swept and not case.in_space:
        found["poissons_ratio"] = "it matters in space; give the tendons an angle"
    for name in sorted(swept & {"axial_factor", "shear_factor"}):
        if not body.extensible:
            found[name] = "the axis does not stretch; make the body extensible"
    dense = "density" in swept or np.any(np.asarray(body.density))
    if not body.stiffened_by_radii and not (dense and (gravity or not weightless)):
        for name in sorted(swept):
            if name.startswith("inner_radius") or (name.startswith("outer_radius") and not wall_is_seen):
                found[name] = "the bending_stiffness of this body is given beside it; let that vary"
    return found
