"""Where a result in chunks goes: into memory, or into a Zarr store that survives a kill or a power cut.

A chunk belongs to one process. Its variables are written one after the other, each file in one step. A chunk is
complete if all its files are there. The same work, started again, computes only the other chunks.
"""

import errno
import json
import os
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, needed
from .chunks import Index, Layout
from .drafts import in_one_step

if TYPE_CHECKING:
    import xarray

IDENTITY = "identity"


class Memory:
    """Keeps everything in memory."""

    def __init__(self, layout: Layout):
        self.layout = layout
        self._arrays = {name: np.full(v.shape, v.missing, v.dtype) for name, v in layout.variables.items()}

    def has(self, index: Index) -> bool:
        return False

    def write(self, index: Index, blocks: Mapping[str, np.ndarray]) -> None:
        for name, block in blocks.items():
            self._arrays[name][self.layout.region(index)] = block

    def values(self) -> dict[str, np.ndarray]:
        return self._arrays

    def dataset(self) -> "xarray.Dataset":
        data = {name: (v.dims, self._arrays[name], v.attrs) for name, v in self.layout.variables.items()}
        return needed("xarray").Dataset(data, self.layout.coords, self.layout.attrs)


class ZarrStore:
    """A Zarr store on disk.

    If it exists already, the work goes on with its chunks. A store of other work, or of another program, is refused.
    The identity is all that the result depends on, JSON. `create` says whether this process makes a missing store.
    """

    def __init__(
        self, path: str | os.PathLike[str], layout: Layout, identity: Mapping[str, object], *, create: bool = True
    ):
        zarr = needed("zarr")
        self.path = Path(path)
        if create and not self.path.exists():
            _create(self.path, layout, identity)
        self._group = _same_work(zarr, self.path, identity, layout.variables)
        chunks = self._group[next(iter(layout.variables))].chunks[: len(layout.shape)]
        self.layout = replace(layout, chunks=tuple(chunks))

    def has(self, index: Index) -> bool:
        """Whether a chunk is complete: every file is there, and none is empty or damaged, as after a power cut."""
        try:
            for name, variable in self.layout.variables.items():
                place = (*index, *(0,) * (len(variable.shape) - len(index)))
                if not (self.path / name / "c" / Path(*map(str, place))).stat().st_size:
                    return False
                self._group[name][self.layout.region(index)]
        except (RuntimeError, ValueError, OSError):  # no file, a decompressor that fails, or a block of another size
            return False
        return True

    def write(self, index: Index, blocks: Mapping[str, np.ndarray]) -> None:
        region = self.layout.region(index)
        try:
            for name in self.layout.variables:
                self._group[name][region] = blocks[name]
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise InputError(f"{self.path}: the disk is full; free some of it and start the same work again") from None

    def values(self) -> dict[str, np.ndarray]:
        return {name: self._group[name][...] for name in self.layout.variables}

    def dataset(self) -> "xarray.Dataset":
        found = needed("xarray").open_zarr(self.path, chunks=None, consolidated=False)
        return found[[*self.layout.variables]]  # in the order in which they were asked for


def _create(path: Path, layout: Layout, identity: Mapping[str, object]) -> None:
    """An empty store."""
    with in_one_step(path) as draft:
        attrs = {**layout.attrs, IDENTITY: json.dumps(identity)}
        labels = needed("xarray").Dataset(coords=layout.coords, attrs=attrs)
        texts = {name: labels[name].astype(object) for name in labels.coords if labels[name].dtype.kind == "U"}
        labels.assign_coords(texts).to_zarr(draft, zarr_format=3, consolidated=False)
        group = needed("zarr").open_group(draft)
        for name, variable in layout.variables.items():
            own = variable.shape[len(layout.shape) :]
            group.create_array(
                name,
                shape=variable.shape,
                chunks=(*layout.chunks, *(max(size, 1) for size in own)),
                dtype=variable.dtype,
                fill_value=variable.missing,
                dimension_names=variable.dims,
                attributes=variable.attrs,
                config={"write_empty_chunks": True},
            )


def _same_work(zarr: ModuleType, path: Path, identity: Mapping[str, object], names: Collection[str]) -> Any:
    """The group at the path, if it holds the same work."""
    remedy = "give another path, or delete it"
    try:
        group = zarr.open_group(path, mode="r+")
        found = json.loads(group.attrs[IDENTITY])
    except (FileNotFoundError, FileExistsError, NotADirectoryError, KeyError, ValueError, zarr.errors.BaseZarrError):
        raise InputError(f"{path} exists and was not written by cddf_jax; {remedy}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path} exists and was not written by cddf_jax; {remedy}")
    both = found.keys() & identity.keys()
    for name in sorted({*found, *identity}, key=lambda name: (name == "structure", name not in both, name)):
        if name not in found or name not in identity:
            whose = "the work asked for" if name in found else "it"
            raise InputError(f"{path} holds other work: {whose} has no {name}; {remedy}")
        if found[name] != identity[name]:
            differs = f"its {name} is {_short(found[name])}, not {_short(identity[name])}"
            raise InputError(f"{path} holds other work: {differs}; {remedy}")
    for name in names:
        if name not in group:
            raise InputError(f"{path} is damaged: its array {name!r} cannot be read; {remedy}")
    return group


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
