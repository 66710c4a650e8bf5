"""One case of a sweep: a manipulator, how it is actuated and loaded, and the names of all numbers in it.

A name is a path of attributes and places, as in Python and counted as there: "youngs_modulus", "outer_radius.tip",
"tendons.0.offset" (of a constant profile its value), "loads.tip_force.1". How the tendons are actuated is named as in
tables, which count tendons from 1: "base_tension" and "direction" of all tendons, "base_tension_2" of tendon 2.
"""

import re
from collections.abc import Mapping
from difflib import get_close_matches
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..quantities import QUANTITIES
from .loads import Loads
from .manipulator import Manipulator
from .profiles import Constant
from .reshape import stretched

OWN = ("base_tension", "loads", "direction")  # parts of a case beside the parts of its manipulator
_OF_ONE_TENDON = re.compile(r"(base_tension|direction)_([1-9]\d*)")
_NOT_OF_NOTHING = ("outer_radius", "inner_radius", "youngs_modulus", "bending_stiffness", "mass_per_length")


class Case(eqx.Module):
    """What is solved once."""

    manipulator: Manipulator
    base_tension: Any  # a number, one per tendon, or targets; None where it is swept
    loads: Loads | None
    direction: Any  # numbers, or one entry per tendon with None where it is to be found

    def number(self, name: str) -> Any:
        """The number of a name.

        Raises:
            InputError: names what is not there, and what is.
        """
        return _Path(self, name).number

    def with_numbers(self, numbers: Mapping[str, Any]) -> "Case":
        """The case with other numbers, which may be traced; with another "length" all that runs along stretches."""
        case, others = self, dict(numbers)
        if "length" in others:
            case = eqx.tree_at(lambda case: case.manipulator, case, stretched(case.manipulator, others.pop("length")))
        for name, number in others.items():
            case = _Path(case, name).replaced(number)
        return case

    def unit(self, name: str) -> str:
        """The SI unit of a number, "1" for none."""
        parts = name.split(".")
        target = _Path(self, name).parent
        wanted = getattr(type(target), "quantity", None)
        if stem_and_tendon(parts[0])[0] == "base_tension" and wanted is not None:
            return QUANTITIES["arc_length" if parts[-1] == "arc_length" else wanted].unit
        return unit_of_name(name)


def unit_of_name(name: str) -> str:
    """The SI unit of a number or a profile by its name alone, "1" for none."""
    stem, *rest = stem_and_tendon(name.split(".")[0])[0], *name.split(".")
    place = len(rest) > 1 and rest[-2 if rest[-1].isdigit() else -1] in ("arc_length", "ends", "length")
    return "m" if place else next((QUANTITIES[part].unit for part in (stem, *rest) if part in QUANTITIES), "1")


def of_tendon(name: str, place: int) -> str:
    """The name of what one of several tendons has: "base_tension_2" of the tendon at place 1."""
    return f"{name}_{place + 1}"


def holds(whole: str, part: str) -> bool:
    """Whether a name stands for several numbers and another one for some of them."""
    stem, tendon = stem_and_tendon(part.split(".")[0])
    return part.startswith(f"{whole}.") or (tendon is not None and stem == whole)


def stem_and_tendon(name: str) -> tuple[str, int | None]:
    """ "base_tension" and 1, the place of the tendon, of "base_tension_2"; None for what is not of one tendon."""
    found = _OF_ONE_TENDON.fullmatch(name)
    return (found[1], int(found[2]) - 1) if found else (name, None)


class _Path:
    """The way from a case to one of its numbers."""

    def __init__(self, case: Case, name: str):
        self.case, self.name = case, name
        first, *rest = name.split(".")
        stem, tendon = stem_and_tendon(first)
        if first in ("base_tension", "direction") and rest and rest[0].isdigit():
            instead = ".".join([of_tendon(first, int(rest[0])), *rest[1:]])
            raise InputError(f"{name!r} is no number of a case: tendons count from 1; write {instead!r}")
        self.steps = [stem, *([] if tendon is None else [str(tendon)]), *rest]
        if stem not in OWN:
            self.steps = ["manipulator", *self.steps]
        node: Any = case
        self.parent: Any = case
        self.component: int | None = None  # of an array, which is no node of the tree
        for depth, step in enumerate(self.steps):
            self.parent = node
            if step not in _parts(node):
                raise InputError(self._unknown(depth, node))
            if _is_vector(node):
                self.component = int(step)
            node = _step(node, step)
        if isinstance(node, Constant):
            self.steps.append("value")
            self.parent, node = node, node.value
        if node is None and self.steps[-1] in _NOT_OF_NOTHING:
            raise InputError(f"{name}: the body has none, and what it has in its place would stay; give it one first")
        self.number = node
        whole = self.steps[-1] in ("base_tension", "direction")  # one number for all tendons
        if not whole and node is not None and (not isinstance(node, jax.Array | np.ndarray | float) or np.ndim(node)):
            of_tendons = name in ("base_tension", "direction")
            parts = _parts(node)
            inside = ", ".join(of_tendon(name, int(part)) if of_tendons else f"{name}.{part}" for part in parts)
            raise InputError(f"{name} is not one number; name a number of it: {inside or 'it has none'}")

    def _unknown(self, depth: int, node: Any) -> str:
        step, known = self.steps[depth], sorted(_parts(node))
        stem, tendon = stem_and_tendon(self.name.split(".")[0])
        if depth == 1 and tendon is not None:
            count = self.case.manipulator.num_tendons
            why = f"the manipulator has {count} tendon(s)" if known else f"{stem} is one for all tendons; give one each"
            return f"{self.name!r} is no number of a case: {why}"
        if node is self.case.manipulator:
            known += OWN
        close = get_close_matches(step, known, 1)
        remedy = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known) or 'none'}"
        inside = ".".join(self.steps[:depth]).removeprefix("manipulator").removeprefix(".")
        there = f"{inside} has" if inside else "there is"
        return f"{self.name!r} is no number of a case: {there} no {step!r}; {remedy}"

    def replaced(self, number: Any) -> Case:
        def where(case: Case) -> Any:
            return reduce(_step, self.steps if self.component is None else self.steps[:-1], case)

        if self.component is not None:
            number = jnp.asarray(where(self.case)).at[self.component].set(number)
        return eqx.tree_at(where, self.case, number, is_leaf=lambda x: x is None)


def _is_vector(node: Any) -> bool:
    return isinstance(node, jax.Array | np.ndarray) and np.ndim(node) == 1


def _parts(node: Any) -> list[str]:
    """The names of what a node holds."""
    if isinstance(node, tuple | list) or _is_vector(node):
        return [str(i) for i in range(len(node))]
    fields = getattr(type(node), "__dataclass_fields__", {})
    return [name for name, field in fields.items() if not field.metadata.get("static", False)]


def _step(node: Any, step: str) -> Any:
    return node[int(step)] if step.isdigit() else getattr(node, step)
