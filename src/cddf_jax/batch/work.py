"""Work in chunks, shared by all processes, whose result goes into memory or into a Zarr store: a sweep.

The store survives a kill or a power cut. A chunk belongs to one process. Its arrays are written one after the other,
each file in one step. A chunk is complete if all its files are there. The same work, started again, computes only the
other chunks.
"""

import errno
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..errors import InputError, needed
from ..progress import stage
from .chunks import Layout, Region, count, not_computed
from .drafts import in_one_step

if TYPE_CHECKING:
    import xarray

COPIES = 3  # of a chunk in memory: as it is computed, gathered, written
IDENTITY = "identity"
REMEDY = "give another path, or delete it"


def carry_out(
    layout: Layout,
    identity: Callable[[], Mapping[str, object]],
    chunk: Callable[[Layout, Region], Mapping[str, np.ndarray]],
    out: str | os.PathLike[str] | None,
    free: float,
) -> "xarray.Dataset":
    """Compute the chunks that are missing, each process its share; return when all processes are done.

    Chunks do not depend on each other. A chunk that is computed again gives the same numbers.

    Args:
        layout: what to compute; the chunks of a store that is there already stand in place of its own.
        identity: all that the result depends on, JSON; only computed for a store.
        chunk: computes the result in the region of one chunk.
        out: path of a Zarr store; None for memory.
        free: memory, bytes.
    """
    store = _in_memory(layout, free) if out is None else _on_disk(out, layout, identity)
    layout, rank, ranks = store.layout, jax.process_index(), jax.process_count()
    mine = [region for i, region in enumerate(layout.regions()) if i % ranks == rank]
    missing = [region for region in mine if not store.has(region)]
    total, left = (sum(map(count, some)) for some in (mine, missing))
    done = False
    try:
        with stage("solving", total, total - left) as now:
            for region in missing:
                store.write(region, chunk(layout, region))
                now.done += count(region)
        done = True
    finally:
        all_done = _all_say("done", done)
    if not all_done:
        raise InputError("another process failed, and says why; complete chunks are kept: start the same work again")
    return store.dataset()


def _in_memory(layout: Layout, free: float) -> "Memory":
    if jax.process_count() > 1:
        raise InputError(f"{jax.process_count()} processes need out=, a store that all of them reach")
    wanted = layout.bytes_each * (layout.size + COPIES * layout.chunk_size)
    if wanted > free:
        raise InputError(f"this takes {wanted / 1e6:.4g} MB of memory, {free / 1e6:.4g} MB are free; give out=")
    return Memory(layout)


def _on_disk(path: str | os.PathLike[str], layout: Layout, identity: Callable[[], Mapping[str, object]]) -> "ZarrStore":
    store, trouble = None, None
    for create in (True, False):  # process 0 makes it, then the others open it
        try:
            if (jax.process_index() == 0) == create:
                store = ZarrStore(path, layout, identity(), create=create)
        except (InputError, OSError) as error:
            trouble = error
        if not _all_say("store", trouble is None):
            raise trouble or InputError(f"{path}: another process could not use the store, and says why")
    assert store is not None
    return store


def _all_say(what: str, good: bool) -> bool:
    """Wait for all processes; whether all is well with each of them."""
    if jax.process_count() == 1:
        return good
    from jax.experimental import multihost_utils

    multihost_utils.sync_global_devices(f"cddf_jax: {what}")
    return bool(np.all(multihost_utils.process_allgather(np.array(good))))


# --- where the result goes -------------------------------------------------------------------------


class Memory:
    """Keeps everything in memory."""

    def __init__(self, layout: Layout):
        self.layout, self._answer = layout, layout.empty.copy(deep=True)

    def has(self, region: Region) -> bool:
        return False

    def write(self, region: Region, blocks: Mapping[str, np.ndarray]) -> None:
        for name, block in blocks.items():
            self._answer[name][region] = block

    def dataset(self) -> "xarray.Dataset":
        return self._answer


class ZarrStore:
    """A Zarr store on disk.

    If it exists already, the work goes on with its chunks. A store of other work, or of another program, is refused.
    The identity is all that the result depends on, JSON. `create` says whether this process makes a missing store.
    """

    def __init__(
        self, path: str | os.PathLike[str], layout: Layout, identity: Mapping[str, object], *, create: bool = True
    ):
        needed("zarr")
        self.path = Path(path)
        if create and not self.path.exists():
            _create(self.path, layout, identity)
        self._arrays = _same_work(self.path, layout, identity)
        *_, last = self._arrays.values()
        self.layout = replace(layout, chunks=dict(zip(layout.chunks, last.chunks, strict=False)))

    def has(self, region: Region) -> bool:
        """Whether a chunk is complete: every file is there, and none is empty or damaged, as after a power cut."""
        place = [places.start // self.layout.chunks[name] for name, places in region.items()]
        try:
            for name, array in self._arrays.items():
                file = self.path.joinpath(name, "c", *map(str, place), *"0" * (array.ndim - len(place)))
                if not file.exists():  # Zarr would read missing values
                    return False
                array[tuple(region.values())]
        except (RuntimeError, ValueError, OSError):  # a decompressor that fails, or a block of another size
            return False
        return True

    def write(self, region: Region, blocks: Mapping[str, np.ndarray]) -> None:
        try:
            for name, array in self._arrays.items():
                array[tuple(region.values())] = blocks[name]
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise InputError(f"{self.path}: the disk is full; free some of it and start the same work again") from None

    def dataset(self) -> "xarray.Dataset":
        found = needed("xarray").open_zarr(self.path, chunks=None, consolidated=False)
        return found[[*self._arrays]]  # in the order in which they were asked for


def _create(path: Path, layout: Layout, identity: Mapping[str, object]) -> None:
    """An empty store."""
    with in_one_step(path) as draft:
        labels = layout.empty.drop_vars([*layout.empty.data_vars]).assign_attrs({IDENTITY: json.dumps(identity)})
        texts = {name: labels[name].astype(object) for name in labels.coords if labels[name].dtype.kind == "U"}
        labels.assign_coords(texts).to_zarr(draft, zarr_format=3, consolidated=False)
        group = needed("zarr").open_group(draft)
        for name, array in layout.empty.data_vars.items():
            own = array.shape[len(layout.chunks) :]
            group.create_array(
                name,
                shape=array.shape,
                chunks=(*layout.chunks.values(), *(max(size, 1) for size in own)),
                dtype=array.dtype,
                fill_value=not_computed((), array.dtype)[()],
                dimension_names=array.dims,
                attributes=array.attrs,
            )


def _same_work(path: Path, layout: Layout, identity: Mapping[str, object]) -> dict[str, Any]:
    """The arrays of the store at the path, if it holds the same work."""
    zarr = needed("zarr")
    try:
        group = zarr.open_group(path, mode="r+")
        found = dict(json.loads(group.attrs[IDENTITY]))
    except (FileNotFoundError, FileExistsError, NotADirectoryError, LookupError, TypeError, ValueError):
        raise InputError(f"{path} exists and was not written by cddf_jax; {REMEDY}") from None
    for name in sorted({**found, **identity}, key=lambda name: name == "structure"):  # which says least of all
        was, asked = (each.get(name, "missing") for each in (found, identity))
        if was != asked:
            raise InputError(f"{path} holds other work: its {name} is {_short(was)}, not {_short(asked)}; {REMEDY}")
    if lost := [name for name in layout.empty.data_vars if name not in group]:
        raise InputError(f"{path} is damaged: its array {lost[0]!r} cannot be read; {REMEDY}")
    with zarr.config.set({"array.write_empty_chunks": True}):  # a chunk in which all solves failed has its files too
        return {str(name): group[name] for name in layout.empty.data_vars}


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
