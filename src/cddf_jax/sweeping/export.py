"""Sweeps as NetCDF and CSV files, each written complete or not at all."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..batch.drafts import in_one_step
from ..batch.work import Layout, even_chunks
from ..errors import needed
from ..statics.named_numbers import of_tendon
from ..statics.status import Status
from .one_solve import AXES, COMPONENTS, RESULT, VERDICTS

if TYPE_CHECKING:
    import xarray

LABELS = {"component": COMPONENTS, "axis": AXES}  # along a dimension; other dimensions have numbers


def write_netcdf(answer: "xarray.Dataset", path: Path) -> None:
    """Write the whole dataset as a NetCDF file."""
    whole = answer.load().drop_encoding()
    texts = {name: (c.dims, list(map(str, c.values))) for name, c in whole.coords.items() if c.dtype.kind == "T"}
    with in_one_step(path) as draft:  # SciPy's writer knows only texts of a fixed length
        whole.assign_coords(texts).to_netcdf(draft, engine="scipy", format="NETCDF3_64BIT")


def write_csv(layout: Layout, answer: "xarray.Dataset", path: Path) -> None:
    """Write a table with a row for each solve: what varies, the outputs except those along the body, the result."""
    pandas = needed("pandas")
    with in_one_step(path) as draft, open(draft, "w", encoding="utf-8", newline="") as file:
        places = {name: np.arange(answer.sizes[name]) for name in layout.chunks if name not in answer.coords}
        for i, block in enumerate(blocks_of(layout, answer.assign_coords(places))):
            pandas.DataFrame(_columns(block)).to_csv(file, index=False, header=i == 0)


def blocks_of(layout: Layout, answer: "xarray.Dataset") -> Iterator["xarray.Dataset"]:
    """The dataset in blocks, in the order of its rows, each as large as memory allows."""
    sizes = [answer.sizes[name] for name in layout.chunks]
    rows = even_chunks(sizes, layout.chunk_size, [False] * len(sizes))
    for region in replace(layout, chunks=dict(zip(layout.chunks, rows, strict=True))).regions():
        yield answer.isel(region).load()


def _columns(block: "xarray.Dataset") -> dict[str, np.ndarray]:
    """The columns of a table of some solves, by their heads."""
    result = block[RESULT]
    columns = {str(name): block[name] for axis in result.dims for name in _along(axis, block)}
    for name, array in block.data_vars.items():
        if is_short(array) and name not in VERDICTS:
            labels = labelled(str(name), array.dims[result.ndim :], array.shape[result.ndim :])
            columns |= {label: array[(..., *place)] for place, label in labels}
    heads = {name: f"{name} [{unit}]" for name, c in columns.items() if (unit := c.attrs.get("units", "1")) != "1"}
    every = {heads.get(name, name): c.broadcast_like(result).transpose(*result.dims) for name, c in columns.items()}
    named = result.copy(data=np.array([*Status.__members__])[result.values])
    return {head: column.values.ravel() for head, column in (every | {RESULT: named}).items()}


def _along(axis: Hashable, block: "xarray.Dataset") -> list[Hashable]:
    """The names of all that varies along a dimension, its own name first."""
    return sorted((name for name, c in block.coords.items() if c.dims == (axis,)), key=lambda name: name != axis)


def labelled(name: str, dims: Sequence[Hashable], shape: Sequence[int]) -> Iterator[tuple[tuple[int, ...], str]]:
    """Index and name of each number of an output, "tip_position.X" or "tip_tension_2"; a single one is not numbered."""
    for place in np.ndindex(*shape):
        parts = zip(dims, place, shape, strict=True)
        ends = (f".{LABELS[str(d)][i]}" if d in LABELS else of_tendon("", i) for d, i, n in parts if n > 1)
        yield place, "".join([name, *ends])


def is_short(array: "xarray.DataArray") -> bool:
    """Whether an output has one or a few numbers for each solve, and is not a line along the body."""
    return "point" not in array.dims
