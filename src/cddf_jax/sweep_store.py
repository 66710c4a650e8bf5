"""Where the numbers of a sweep go: into memory, or chunk by chunk into a Zarr store that survives everything.

A chunk of the store belongs to one process. Of its variables `result` is written last, each file in one step: where it
is there, the chunk is whole, and whoever starts the same sweep again goes on with the others.
"""

import errno
import json
import os
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .errors import InputError
from .sweep_layout import RESULT, Index, Layout

if TYPE_CHECKING:
    import xarray

IDENTITY = "cddf_sweep"


class Store(Protocol):
    """Takes the chunks of a sweep."""

    layout: Layout

    def has(self, index: Index) -> bool: ...
    def write(self, index: Index, blocks: Mapping[str, np.ndarray]) -> None: ...
    def dataset(self) -> "xarray.Dataset": ...


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

    def dataset(self) -> "xarray.Dataset":
        xarray = needed("xarray")
        layout = self.layout
        data = {name: (v.dims, self._arrays[name], v.attrs) for name, v in layout.variables.items()}
        return xarray.Dataset(data, layout.coords, layout.attrs)


class ZarrStore:
    """A Zarr store on disk.

    Args:
        path: of the store; one that is there already is gone on with.
        layout: of the sweep; where a store is there already, its chunks hold.
        identity: what makes this sweep, JSON.
        create: whether this process makes the store where there is none.

    Raises:
        InputError: where `path` holds something else, or another sweep.
    """

    def __init__(
        self, path: str | os.PathLike[str], layout: Layout, identity: Mapping[str, Any], *, create: bool = True
    ):
        zarr = needed("zarr")
        self.path = Path(path)
        if create and not self.path.exists():
            _create(zarr, self.path, layout, identity)
        self._group = _same_sweep(zarr, self.path, identity)
        self.layout = replace(layout, chunks=tuple(self._group[RESULT].chunks))

    def has(self, index: Index) -> bool:
        return (self.path / RESULT / "c" / Path(*map(str, index))).exists()

    def write(self, index: Index, blocks: Mapping[str, np.ndarray]) -> None:
        region = self.layout.region(index)
        try:
            for name in sorted(blocks, key=lambda name: name == RESULT):
                self._group[name][region] = blocks[name]
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise InputError(f"{self.path}: the disk is full; free some of it and start the same sweep again") from None

    def dataset(self) -> "xarray.Dataset":
        found = needed("xarray").open_zarr(self.path, chunks=None, consolidated=False)
        return found[[*self.layout.variables]]  # in the order in which they were asked for


def needed(package: str) -> Any:
    """A package that only sweeps need.

    Raises:
        InputError: says how to get it.
    """
    try:
        return __import__(package)
    except ImportError:
        raise InputError(f"sweep: needs {package}; install it with: pip install 'cddf-jax[sweep]'") from None


def _create(zarr: Any, path: Path, layout: Layout, identity: Mapping[str, Any]) -> None:
    """An empty store, which takes its place in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        others = " ".join(name for name in layout.coords if name not in layout.shape)  # xarray's name for coordinates
        attrs = layout.attrs | {"coordinates": others, IDENTITY: json.dumps(identity)}
        group = zarr.create_group(draft, zarr_format=3, attributes=attrs)
        for name, (dims, values, attrs) in layout.coords.items():
            text = values.dtype.kind in "OU"
            array = group.create_array(
                name, shape=values.shape, dtype=str if text else values.dtype, dimension_names=dims, attributes=attrs
            )
            array[...] = values.astype(object) if text else values
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
        os.rename(draft, path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _same_sweep(zarr: Any, path: Path, identity: Mapping[str, Any]) -> Any:
    """The group at the path.

    Raises:
        InputError: where it is not one of this very sweep.
    """
    remedy = "give another path, or delete it"
    try:
        group = zarr.open_group(path, mode="r+")
        found = json.loads(group.attrs[IDENTITY])
    except (FileNotFoundError, NotADirectoryError, KeyError, ValueError, zarr.errors.BaseZarrError):
        raise InputError(f"{path} is there and is no sweep; {remedy}") from None
    if not isinstance(found, dict):
        raise InputError(f"{path} is there and is no sweep; {remedy}")
    for name in sorted({*found, *identity}):
        ours, theirs = identity.get(name), found.get(name)
        if ours != theirs:
            raise InputError(
                f"{path} holds another sweep: its {name} is {_short(theirs)}, not {_short(ours)}; {remedy}"
            )
    return group


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
