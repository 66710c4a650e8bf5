"""Labels of sweeps: the dataset in the units of its labels, and words for axes, outputs and results."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..quantities import QUANTITIES
from ..statics.status import Status
from ..sweeping.axes import OPTIONS, PATH
from ..sweeping.one_solve import COMPONENTS, RESULT
from ..units import DIMENSION_OF, preferred

if TYPE_CHECKING:
    import xarray

# which part of an output
PARTS: dict[str, Callable[[Any], str]] = {
    "tendon": lambda number: f"of tendon {number + 1}",
    "component": str,
    "axis": lambda axis: f"axis {axis}",
}


def in_label_units(answer: "xarray.Dataset") -> "xarray.Dataset":
    """A sweep in the units of its labels, NaN where there is no number; the results are a coordinate of each output."""
    there = answer[RESULT] >= 0
    for array in answer.data_vars.values():
        if array.dtype.kind == "f":
            there = there & array.notnull().all([d for d in array.dims if d not in there.dims])

    def shown(array: "xarray.DataArray") -> tuple[object, np.ndarray, dict[str, object]]:
        name, unit = str(array.name), array.attrs.get("units", "1")
        scale, unit = preferred(DIMENSION_OF[unit]) if unit in DIMENSION_OF else (1.0, unit)
        if name in QUANTITIES and QUANTITIES[name].in_percent:
            scale, unit = QUANTITIES[name].shown
        # integers and booleans cannot be NaN: other outputs show where there is no number
        values = array if array.dtype.kind == "f" else array.where(there).transpose(*array.dims)
        attrs = {"words": name_in_words(name), "unit": unit, "yes_or_no": array.dtype.kind == "b"}
        attrs["is_path"] = name == answer.attrs.get(PATH)
        return array.dims, np.asarray(scale * values), attrs

    outputs = {name: shown(array) for name, array in answer.data_vars.items() if name != RESULT}
    numbers = {name: shown(c) for name, c in answer.coords.items() if is_numeric(c.values) and name not in PARTS}
    return answer.assign(outputs).assign_coords(numbers).set_coords(RESULT)


def is_numeric(values: np.ndarray) -> bool:
    return bool(np.issubdtype(values.dtype, np.number))


def value_words(coordinate: "xarray.DataArray", place: int) -> str:
    """The value at a place along a dimension: "tendon 2", "exact kinematics", "Friction coefficient = 0.4"."""
    name, value = str(coordinate.name), coordinate.values[place]
    if name in PARTS:
        return PARTS[name](value).removeprefix("of ")
    if name in OPTIONS or "words" not in coordinate.attrs:
        return f"{value} {name}"
    words = f"{coordinate.attrs['words']} = {value:.4g} {coordinate.attrs['unit']}"
    return words.strip().replace("-", "\N{MINUS SIGN}")


def axis_label(array: "xarray.DataArray") -> str:
    """Name, part of an output, and unit: "Tip tension of tendon 2 (N)"."""
    at = {} if array.name in array.coords else array.coords
    parts = [words(at[name].item()) for name, words in PARTS.items() if name in at and not at[name].ndim]
    unit = f"({array.attrs['unit']})" if array.attrs["unit"] else ""
    return " ".join(filter(None, [array.attrs["words"], *parts, unit]))


def name_in_words(name: str) -> str:
    """The name of a number or output in words: "loads.tip_force.1" is "Tip force Y".

    The value of a target is called so: "Base tension target".
    """
    if name in QUANTITIES:
        return QUANTITIES[name].label
    parts = name.removeprefix("loads.").replace("tendons.", "tendon.").replace(".value", ".target").split(".")
    places = COMPONENTS if parts[0] in ("tip_force", "tip_moment", "gravity") else range(1, 100)
    words = " ".join(str(places[int(part)]) if part.isdigit() else part for part in parts).replace("_", " ")
    return words[:1].upper() + words[1:]


def results_in_words(codes: np.ndarray) -> str:
    """The results of the solves that were not successful."""
    return ", ".join(Status(code).name.replace("_", " ") for code in np.unique(codes) if code != Status.successful)
