"""Work in chunks, shared by all processes, whose result goes into memory or into a Zarr store: a sweep.

The store survives a kill or a power cut. A chunk belongs to one process. Its arrays are written one after the other,
each file in one step. A chunk is complete if all its files are there. The same work, started again, computes only the
other chunks.
"""

import itertools
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..errors import InputError, needed
from ..progress import stage
from .drafts import in_one_step

if TYPE_CHECKING:
    import xarray

COPIES = 3  # of a chunk in memory: as it is computed, gathered, written
IDENTITY = "identity"
REMEDY = "give another path, or delete it"
Region = dict[str, slice]  # of a chunk, by dimension


@dataclass(frozen=True)
class Layout:
    """A dataset before it is computed, and its chunks."""

    empty: "xarray.Dataset"  # its arrays are `not_computed`, and are written in this order
    chunks: dict[str, int]  # along the dimensions that all arrays have first, by name and in their order

    @property
    def size(self) -> int:
        """The number of items: combinations along the common dimensions."""
        return math.prod(self.empty.sizes[name] for name in self.chunks)

    @property
    def bytes_each(self) -> int:
        """Bytes of the answer for each item."""
        return sum(array.nbytes for array in self.empty.data_vars.values()) // self.size

    @property
    def chunk_size(self) -> int:
        return math.prod(self.chunks.values())

    def regions(self) -> Iterator[Region]:
        """The places of all chunks along the common dimensions, in the order of the answer."""
        sizes = self.empty.sizes
        along = ([slice(i, min(i + n, sizes[d])) for i in range(0, sizes[d], n)] for d, n in self.chunks.items())
        return (dict(zip(self.chunks, places, strict=True)) for places in itertools.product(*along))


def not_computed(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An array in which nothing has been computed yet: NaN, false or -1 everywhere, in no more memory than one."""
    return np.broadcast_to(np.array({"f": np.nan, "b": False}.get(dtype.kind, -1), dtype), shape)


def count(region: Region) -> int:
    """The number of items in a chunk."""
    return math.prod(places.stop - places.start for places in region.values())


def even_chunks(sizes: Sequence[int], most: int) -> tuple[int, ...]:
    """Chunks of nearly equal size with no more than `most` items; the last dimensions are not divided if possible."""
    chunks: list[int] = []
    for size in reversed(sizes):
        longest = max(most // math.prod(chunks), 1)
        chunks.append(-(-size // -(-size // longest)))
    return tuple(reversed(chunks))


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
    if out is None:
        _check_memory(layout, free)
        answer = layout.empty.copy(deep=True)
        arrays = {str(name): array.values for name, array in answer.data_vars.items()}
        _compute(layout, arrays, chunk, lambda region: False)
        return answer
    path = Path(out)
    layout, arrays = _opened(path, layout, identity)
    _compute(layout, arrays, chunk, lambda region: _is_complete(path, layout, arrays, region))
    return needed("xarray").open_zarr(path, chunks=None, consolidated=False)[[*arrays]]  # as they were asked for


def _compute(
    layout: Layout,
    arrays: Mapping[str, Any],
    chunk: Callable[[Layout, Region], Mapping[str, np.ndarray]],
    has: Callable[[Region], bool],
) -> None:
    """Write the chunks of this process that the arrays do not have yet."""
    rank, ranks = jax.process_index(), jax.process_count()
    mine = [region for i, region in enumerate(layout.regions()) if i % ranks == rank]
    missing = [region for region in mine if not has(region)]
    total, left = (sum(map(count, some)) for some in (mine, missing))
    done = False
    try:
        with stage("solving", total, total - left) as now:
            for region in missing:
                blocks = chunk(layout, region)
                for name, array in arrays.items():
                    array[tuple(region.values())] = blocks[name]
                now.done += count(region)
        done = True
    finally:
        all_done = _all_say("done", done)
    if not all_done:
        raise InputError("another process failed, and says why; complete chunks are kept: start the same work again")


def _check_memory(layout: Layout, free: float) -> None:
    """Refuse work whose result does not fit into the memory of this process."""
    if jax.process_count() > 1:
        raise InputError(f"{jax.process_count()} processes need out=, a store that all of them reach")
    wanted = layout.bytes_each * (layout.size + COPIES * layout.chunk_size)
    if wanted > free:
        raise InputError(f"this takes {wanted / 1e6:.4g} MB of memory, {free / 1e6:.4g} MB are free; give out=")


def _all_say(what: str, good: bool) -> bool:
    """Wait for all processes; whether all is well with each of them."""
    if jax.process_count() == 1:
        return good
    from jax.experimental import multihost_utils

    multihost_utils.sync_global_devices(f"cddf_jax: {what}")
    return bool(np.all(multihost_utils.process_allgather(np.array(good))))


# --- the store -------------------------------------------------------------------------------------


def _opened(path: Path, layout: Layout, identity: Callable[[], Mapping[str, object]]) -> tuple[Layout, dict[str, Any]]:
    """As `_same_work`; the store is made if it is missing."""
    needed("zarr")
    opened, trouble = (layout, {}), None
    for first in (True, False):  # process 0 makes it, then the others open it
        try:
            if (jax.process_index() == 0) == first:
                asked = identity()
                if first and not path.exists():
                    _create(path, layout, asked)
                opened = _same_work(path, layout, asked)
        except (InputError, OSError) as error:
            trouble = error
        if not _all_say("store", trouble is None):
            raise trouble or InputError(f"{path}: another process could not use the store, and says why")
    return opened


def _is_complete(path: Path, layout: Layout, arrays: Mapping[str, Any], region: Region) -> bool:
    """Whether every file of a chunk is there, and none is empty or damaged, as after a power cut."""
    place = [places.start // layout.chunks[name] for name, places in region.items()]
    try:
        for name, array in arrays.items():
            file = path.joinpath(name, "c", *map(str, place), *"0" * (array.ndim - len(place)))
            if not file.exists():  # Zarr would read missing values
                return False
            array[tuple(region.values())]
    except (RuntimeError, ValueError, OSError):  # a decompressor that fails, or a block of another size
        return False
    return True


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


def _same_work(path: Path, layout: Layout, identity: Mapping[str, object]) -> tuple[Layout, dict[str, Any]]:
    """The layout of the store at the path, which has chunks of its own, and its arrays, if it holds the same work."""
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
        arrays = {str(name): group[name] for name in layout.empty.data_vars}
    *_, last = arrays.values()
    return replace(layout, chunks=dict(zip(layout.chunks, last.chunks, strict=False))), arrays


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else text[:77] + "..."
