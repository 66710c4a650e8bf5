"""The names of all numbers in a case: a manipulator with its tensions, loads and directions.

A name is a path of attributes and indices as in Python, counted from 0: "youngs_modulus", "outer_radius.tip",
"tendons.0.offset" (the value of a constant profile), "loads.tip_force.1". Tensions and directions have the names that
they have in tables, where tendons count from 1: "base_tension" and "direction" of all tendons, "base_tension_2" of
tendon 2.

"tendons.0.angle.winding" is by how much a linear angle grows from base to tip, rad. It takes the place of the tip, so
that tendons with different angles at the base may share it.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..quantities import QUANTITIES
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.reshape import stretched

WHOLE = ("base_tension", "direction")  # may be one number for all tendons
_OF_ONE_TENDON = re.compile(r"(base_tension|direction)_([1-9]\d*)")
_NOT_OF_NOTHING = ("outer_radius", "inner_radius", "youngs_modulus", "bending_stiffness", "mass_per_length")

_WINDING = re.compile(r"(tendons\.\d+\.angle)\.winding")

Place = tuple[int, tuple[int, ...]]  # of a number: the leaf of the case, and the index in an array


class Case(eqx.Module):
    """The input of one solve."""

    manipulator: Manipulator
    base_tension: Any  # a number, one per tendon, or targets; None where it is swept
    loads: Loads | None
    direction: Any  # numbers, or one entry per tendon, None for one to be found

    @property
    def components(self) -> int:
        """How many components positions have; static."""
        return max(self.manipulator.components, 2 if self.loads is None else self.loads.components)

    @property
    def in_space(self) -> bool:
        """Whether body or loads leave the plane; static."""
        return self.components == 3

    def number(self, name: str) -> Any:
        """The number of a name.

        Raises:
            InputError: for an unknown name, with the known ones.
        """
        if name in WHOLE:
            return getattr(self, name)
        leaves, places, _ = self._flat()
        if tip := tip_of_winding(name):
            if tip not in places:
                raise InputError(f"{name} needs a linear angle; give the tendon Linear(0, 0, length)")
            return self.number(tip) - self.number(_base_of(tip))
        leaf, index = _place(name, leaves, places)
        return leaves[leaf][index] if index else leaves[leaf]

    def with_numbers(self, numbers: Mapping[str, Any]) -> "Case":
        """The case with other numbers, which may be traced; another "length" stretches everything along the body."""
        case, others = self, dict(numbers)
        if "length" in others:
            case = replace(case, manipulator=stretched(case.manipulator, others.pop("length")))
        case = replace(case, **{name: others.pop(name) for name in WHOLE if name in others})
        windings = {tip: others.pop(name) for name in tuple(others) if (tip := tip_of_winding(name))}
        if twice := [tip for tip in windings if tip in others]:
            raise InputError(f"{twice[0]} follows from base and winding; leave out one of tip and winding")
        case = case._with_leaves(others)
        tips = {tip: case.number(_base_of(tip)) + winding for tip, winding in windings.items()}
        return case.with_numbers(tips) if tips else case

    def _with_leaves(self, numbers: Mapping[str, Any]) -> "Case":
        leaves, places, structure = self._flat()
        for name, number in numbers.items():
            leaf, index = _place(name, leaves, places)
            leaves[leaf] = jnp.asarray(leaves[leaf]).at[index].set(number) if index else number
        return jax.tree.unflatten(structure, leaves)

    @property
    def numbers(self) -> dict[str, Any]:
        """Every single number by its name."""
        leaves, places, _ = self._flat()
        there = {name: place for name, place in places.items() if leaves[place[0]] is not None}
        return {name: leaves[leaf][index] if index else leaves[leaf] for name, (leaf, index) in there.items()}

    def unit(self, name: str) -> str:
        """The SI unit of a number, "1" for none."""
        self.number(name)
        stem, tendon = stem_and_tendon(name.split(".")[0])
        if stem == "base_tension":
            given = self.base_tension if tendon is None else self.base_tension[tendon]
            if wanted := getattr(given, "quantity", ""):
                return QUANTITIES["arc_length" if name.endswith(".arc_length") else wanted].unit
        return unit_of_name(name)

    def _flat(self) -> tuple[list[Any], dict[str, Place], Any]:
        """All leaves, the place of every number among them by its name, and the structure."""
        paths, structure = jax.tree.flatten_with_path(self, is_leaf=lambda x: x is None)
        places: dict[str, Place] = {}
        for i, (path, leaf) in enumerate(paths):
            own = jax.tree_util.keystr(path, simple=True, separator=".").removeprefix("manipulator.")
            for index in np.ndindex(np.shape(leaf)):
                places[_short(_counted(".".join([own, *map(str, index)])))] = i, index
        return [leaf for _, leaf in paths], places, structure


def tip_of_winding(name: str) -> str:
    """ "tendons.0.angle.tip" of "tendons.0.angle.winding"; "" of any other name."""
    found = _WINDING.fullmatch(name)
    return f"{found[1]}.tip" if found else ""


def _base_of(tip: str) -> str:
    return f"{tip.removesuffix('.tip')}.base"


def unit_of_name(name: str) -> str:
    """The SI unit of a number or a profile by its name alone, "1" for none."""
    stem, *rest = stem_and_tendon(name.split(".")[0])[0], *name.split(".")
    place = len(rest) > 1 and rest[-2 if rest[-1].isdigit() else -1] in ("arc_length", "ends", "length")
    return "m" if place else next((QUANTITIES[part].unit for part in (stem, *rest) if part in QUANTITIES), "1")


def of_tendon(name: str, place: int) -> str:
    """The name of a number of one tendon: "base_tension_2" for the tendon with index 1."""
    return f"{name}_{place + 1}"


def holds(whole: str, part: str) -> bool:
    """Whether the name `whole` stands for several numbers, and `part` for some of them."""
    stem, tendon = stem_and_tendon(part.split(".")[0])
    return part.startswith(f"{whole}.") or (tendon is not None and stem == whole)


def stem_and_tendon(name: str) -> tuple[str, int | None]:
    """ "base_tension" and the index 1 for "base_tension_2"; the name and None if it is not that of one tendon."""
    found = _OF_ONE_TENDON.fullmatch(name)
    return (found[1], int(found[2]) - 1) if found else (name, None)


def _place(name: str, leaves: list[Any], places: Mapping[str, Place]) -> Place:
    """The place of a number, by its name.

    Raises:
        InputError: for an unknown name, with the known ones.
    """
    place = places.get(_short(name))
    if place is None:
        raise InputError(_unknown(name, places))
    if leaves[place[0]] is None and name in _NOT_OF_NOTHING:
        raise InputError(f"{name}: the body has none, and uses something else in its place; give the body one first")
    return place


def _unknown(name: str, places: Mapping[str, Place]) -> str:
    if inside := [other for other in places if holds(name, other)]:
        return f"{name} is not one number; name a number of it: {', '.join(inside)}"
    known = dict.fromkeys(other.split(".")[0] for other in places)
    stem, tendon = stem_and_tendon(name)
    if tendon is not None and of_tendon(stem, 0) not in places:
        remedy = f"give {stem} a number for each tendon; then each of them has a name"
    elif (counted := _counted(name)) != name:
        remedy = f"tendons count from 1; write {counted!r}"
    elif name.startswith("loads.points."):
        remedy = "there is no such point load; give it first, by --point-load or Loads(points=...)"
    elif close := get_close_matches(name, [*known, *places], 1):
        remedy = f"did you mean {close[0]!r}?"
    else:
        remedy = f"known are {', '.join(known)}"
    return f"{name!r} is not a number of the body, its tensions or its loads; {remedy}"


def _counted(name: str) -> str:
    """ "base_tension_2" for "base_tension.1"."""
    return re.sub(r"^(base_tension|direction)\.(\d+)", lambda found: of_tendon(found[1], int(found[2])), name)


def _short(name: str) -> str:
    """ "outer_radius" for the value of a constant profile, "outer_radius.value"; a target keeps its value."""
    return name if name.startswith(WHOLE) else name.removesuffix(".value")
