"""Sweeps as NetCDF and CSV files, each written complete or not at all."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..batch.chunks import Layout, even_chunks
from ..batch.drafts import in_one_step
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
        places = {name: np.arange(size) for name, size in layout.shape.items() if name not in answer.coords}
        for i, block in enumerate(blocks_of(layout, answer.assign_coords(places))):
            columns = _axis_columns(layout, block) | _output_columns(layout, block)
            pandas.DataFrame(columns).to_csv(file, index=False, header=i == 0)


def blocks_of(layout: Layout, answer: "xarray.Dataset") -> Iterator["xarray.Dataset"]:
    """The dataset in blocks, in the order of its rows, each as large as memory allows."""
    sizes = list(layout.shape.values())
    rows = replace(layout, chunks=even_chunks(sizes, layout.chunk_size, [False] * len(sizes)))
    for index in rows.indices():
        yield answer.isel(dict(zip(layout.shape, rows.region(index), strict=True))).load()


def _axis_columns(layout: Layout, block: "xarray.Dataset") -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for dimension in layout.shape:
        of_it = [name for name, labels in block.coords.items() if labels.dims == (dimension,)]
        for name in sorted(of_it, key=lambda name: name != dimension):
            every = block[name].broadcast_like(block[RESULT]).transpose(*layout.shape)
            found[_head(str(name), block[name].attrs)] = every.values.ravel()
    return found


def _output_columns(layout: Layout, block: "xarray.Dataset") -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for name, variable in layout.variables.items():
        if not is_short(layout, name) or name in VERDICTS:
            continue
        values, own = block[name].values, len(layout.shape)
        for place, label in labelled(name, variable.dims[own:], variable.shape[own:]):
            found[_head(label, variable.attrs)] = values[(..., *place)].ravel()
    return found | {RESULT: np.array([*Status.__members__])[block[RESULT].values.ravel()]}


def labelled(name: str, dims: Sequence[str], shape: Sequence[int]) -> Iterator[tuple[tuple[int, ...], str]]:
    """Index and name of each number of an output, "tip_position.X" or "tip_tension_2"; a single one is not numbered."""
    for place in np.ndindex(*shape):
        parts = zip(dims, place, shape, strict=True)
        ends = (f".{LABELS[d][i]}" if d in LABELS else of_tendon("", i) for d, i, n in parts if n > 1)
        yield place, "".join([name, *ends])


def _head(name: str, attrs: Mapping[str, object]) -> str:
    unit = attrs.get("units", "1")
    return name if unit == "1" else f"{name} [{unit}]"


def is_short(layout: Layout, name: str) -> bool:
    """Whether an output has one or a few numbers for each solve, and is not a line along the body."""
    return "point" not in layout.variables[name].dims
