"""Sweeps as CSV files, written complete or not at all."""

from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..batch.drafts import in_one_step
from ..errors import needed
from ..statics.named_numbers import of_tendon
from ..statics.status import Status
from .one_solve import AXES, COMPONENTS, RESULT, VERDICTS

if TYPE_CHECKING:
    import xarray

LABELS = {"component": COMPONENTS, "axis": AXES}  # along a dimension; other dimensions have numbers


def write_csv(answer: "xarray.Dataset", path: Path) -> None:
    """Write a table with a row for each solve: what varies, the outputs except those along the body, the result."""
    pandas = needed("pandas")
    places = {name: np.arange(answer.sizes[name]) for name in answer[RESULT].dims if name not in answer.coords}
    with in_one_step(path) as draft:
        pandas.DataFrame(_columns(answer.assign_coords(places).load())).to_csv(draft, index=False)


def _columns(answer: "xarray.Dataset") -> dict[str, np.ndarray]:
    """The columns of a table, by their heads: "tip_position.X" or "tip_tension_2", a single number without an end."""
    result = answer[RESULT]
    columns = {str(name): answer[name] for axis in result.dims for name in _along(axis, answer)}
    for name, array in answer.data_vars.items():
        if is_short(array) and name not in VERDICTS:
            own = list(zip(array.dims, array.shape, strict=True))[result.ndim :]
            for place in np.ndindex(*(size for _, size in own)):
                parts = ((str(dim), i) for (dim, size), i in zip(own, place, strict=True) if size > 1)
                ends = (f".{LABELS[dim][i]}" if dim in LABELS else of_tendon("", i) for dim, i in parts)
                columns["".join([str(name), *ends])] = array[(..., *place)]
    heads = {name: f"{name} [{unit}]" for name, c in columns.items() if (unit := c.attrs.get("units", "1")) != "1"}
    every = {heads.get(name, name): c.broadcast_like(result).transpose(*result.dims) for name, c in columns.items()}
    named = result.copy(data=np.array([*Status.__members__])[result.values])
    return {head: column.values.ravel() for head, column in (every | {RESULT: named}).items()}


def _along(axis: Hashable, answer: "xarray.Dataset") -> list[Hashable]:
    """The names of all that varies along a dimension, its own name first."""
    return sorted((name for name, c in answer.coords.items() if c.dims == (axis,)), key=lambda name: name != axis)


def is_short(array: "xarray.DataArray") -> bool:
    """Whether an output has one or a few numbers for each solve, and is not a line along the body."""
    return "point" not in array.dims
