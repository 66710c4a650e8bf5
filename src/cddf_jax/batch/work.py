"""Work in chunks, shared by all processes, with its result in a store: a sweep."""

import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import jax
import numpy as np

from ..errors import InputError
from ..progress import stage
from .chunks import Layout, Region, count
from .store import Memory, ZarrStore

if TYPE_CHECKING:
    import xarray

COPIES = 3  # of a chunk in memory: as it is computed, gathered, written


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


def _in_memory(layout: Layout, free: float) -> Memory:
    if jax.process_count() > 1:
        raise InputError(f"{jax.process_count()} processes need out=, a store that all of them reach")
    wanted = layout.bytes_each * (layout.size + COPIES * layout.chunk_size)
    if wanted > free:
        raise InputError(f"this takes {wanted / 1e6:.4g} MB of memory, {free / 1e6:.4g} MB are free; give out=")
    return Memory(layout)


def _on_disk(path: str | os.PathLike[str], layout: Layout, identity: Callable[[], Mapping[str, object]]) -> ZarrStore:
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
