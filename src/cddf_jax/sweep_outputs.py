"""What a sweep can be asked for, with dimensions and units."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .axes import Dimension
from .chunks import Coordinate, Variable
from .equilibrium import RESULTS

COMPONENTS = ("X", "Y")
SUCCESSFUL, RESULT = VERDICTS = "successful", "result"
RESULT_NAMES = tuple(RESULTS._name_to_item)  # equinox has no public way to them; in the order of their codes


class Output(NamedTuple):
    """A quantity of an `Equilibrium`."""

    unit: str
    meaning: str
    dims: tuple[str, ...] = ()


OUTPUTS = {
    "tip_position": Output("m", "position of the tip", ("component",)),
    "tip_angle": Output("rad", "heading of the tip"),
    "tip_tension": Output("N", "tip tension", ("tendon",)),
    "tension_loss": Output("1", "loss of tension", ("tendon",)),
    "tendon_displacement": Output("m", "tendon displacement", ("tendon",)),
    "base_tension": Output("N", "base tension", ("tendon",)),
    "target_miss": Output("", "reached less wanted, SI", ("tendon",)),
    "base_moment": Output("N m", "moment of the loads at the base"),
    "load_fraction": Output("1", "fraction of the loads carried"),
    "num_load_steps": Output("1", "steps of the loads"),
    "stable": Output("", "stability"),
    "direction": Output("1", "direction of sliding, +1 in and -1 out", ("tendon",)),
    "direction_contradicted": Output("", "travel against the direction", ("tendon",)),
    "error_estimate": Output("1", "estimated relative error"),
    "num_iterations": Output("1", "iterations"),
    "peak_strain": Output("1", "peak strain of the wall"),
    "peak_strain_at": Output("m", "arc length of the peak strain"),
    "arc_length": Output("m", "arc length", ("point",)),
    "curvature": Output("1/m", "curvature", ("point",)),
    "heading": Output("rad", "heading", ("point",)),
    "position": Output("m", "position", ("point", "component")),
    "tension": Output("N", "tension", ("tendon", "point")),
    "wrap_angle": Output("rad", "wrap angle", ("tendon", "point")),
    "normal_force": Output("N/m", "normal force on the body", ("tendon", "point", "component")),
    "friction_force": Output("N/m", "friction force on the body", ("tendon", "point", "component")),
}


def variable(name: str, array: Any, shape: Mapping[str, int], unit_by: str = "", by: str = "") -> Variable:
    """An output of `array`'s shape and type for every solve, or its derivative by what has the unit `unit_by`."""
    if name == RESULT:
        attrs = {
            "long_name": RESULT,
            "flag_values": [*range(len(RESULT_NAMES))],
            "flag_meanings": " ".join(RESULT_NAMES),
        }
        return Variable(tuple(shape), tuple(shape.values()), np.dtype(np.int8), attrs)
    if name == SUCCESSFUL:
        attrs = {"long_name": "solved without any doubt"}
        return Variable(tuple(shape), tuple(shape.values()), np.dtype(bool), attrs)
    own = tuple(f"{name}_{i}" for i in range(array.ndim))
    known = OUTPUTS.get(name, Output("", name, own))
    unit, meaning = known.unit, known.meaning
    if by:
        unit, meaning = unit and quotient(unit, unit_by), f"{meaning}, by {by}"
    attrs = {"long_name": meaning} | ({"units": unit} if unit else {})
    return Variable((*shape, *known.dims), (*shape.values(), *array.shape), np.dtype(array.dtype), attrs)


def slope_name(output: str, by: str) -> str:
    """What the derivative of an output is called."""
    return f"{output}_by_{by}"


def quotient(unit: str, by: str) -> str:
    """The unit of a derivative: "N" by "Pa" is "N/Pa"."""
    if by == "1":
        return unit
    return f"{unit}/({by})" if " " in by or "/" in by else f"{unit}/{by}"


def coordinates(dimensions: tuple[Dimension, ...], units: Mapping[str, str], variables: Mapping[str, Variable]) -> dict:
    """What labels the answer."""
    coords: dict[str, Coordinate] = {}
    for dimension in dimensions:
        for name, values in dimension.numbers.items():
            coords[name] = ((dimension.name,), values, {"units": units[name]})
        for name, values in dimension.options.items():
            labels = [value if isinstance(value, int | str) else repr(value) for value in values]
            coords[name] = ((dimension.name,), np.asarray(labels), {})
    sizes = {dim: size for v in variables.values() for dim, size in zip(v.dims, v.shape, strict=True)}
    if "tendon" in sizes:
        coords["tendon"] = (("tendon",), np.arange(sizes["tendon"]), {"long_name": "place among the tendons"})
    if "component" in sizes:
        coords["component"] = (("component",), np.array(COMPONENTS), {})
    return coords
