"""Work in chunks, shared by all processes, with its result in a store: a sweep."""

import os
from collections.abc import Callable, Mapping

import jax
import numpy as np

from ..errors import InputError
from ..progress import stage
from .chunks import Index, Layout
from .store import Memory, ZarrStore

COPIES = 3  # of a chunk in memory: as it is computed, gathered, written


def carry_out(
    what: str,
    layout: Layout,
    identity: Callable[[], Mapping[str, object]],
    chunk: Callable[[Layout, Index], Mapping[str, np.ndarray]],
    out: str | os.PathLike[str] | None = None,
    allowed: float = np.inf,
) -> Memory | ZarrStore:
    """Compute the chunks that are missing, each process its share; return when all processes are done.

    Chunks do not depend on each other. A chunk that is computed again gives the same numbers.

    Args:
        what: the work in a word for the progress line, "solving".
        identity: all that the result depends on, JSON; only computed for a store.
        chunk: computes the result in the region of one chunk.
        out: path of a Zarr store; None for memory.
        allowed: memory, bytes.
    """
    store = _store(layout, identity, out, allowed)
    layout, rank, ranks = store.layout, jax.process_index(), jax.process_count()
    mine = [index for i, index in enumerate(layout.indices()) if i % ranks == rank]
    missing = [index for index in mine if not store.has(index)]
    total, left = (sum(layout.count(index) for index in some) for some in (mine, missing))
    done = False
    try:
        with stage(what, total, total - left) as now:
            for index in missing:
                store.write(index, chunk(layout, index))
                now.done += layout.count(index)
        done = True
    finally:
        all_done = _all_say("done", done)
    if not all_done:
        raise InputError("another process failed, and says why; complete chunks are kept: start the same work again")
    return store


def _store(
    layout: Layout, identity: Callable[[], Mapping[str, object]], out: str | os.PathLike[str] | None, allowed: float
) -> Memory | ZarrStore:
    if out is None:
        if jax.process_count() > 1:
            raise InputError(f"{jax.process_count()} processes need out=, a store that all of them reach")
        _check_memory(layout.bytes_each * (layout.size + COPIES * layout.chunk_size), allowed, "give out= or memory=")
        return Memory(layout)
    store, trouble = None, None
    for create in (True, False):  # process 0 makes it, then the others open it
        try:
            if (jax.process_index() == 0) == create:
                store = ZarrStore(out, layout, identity(), create=create)
                needed = COPIES * layout.bytes_each * store.layout.chunk_size
                _check_memory(needed, allowed, "give memory= or another out=")
        except (InputError, OSError) as error:
            trouble = error
        if not _all_say("store", trouble is None):
            raise trouble or InputError(f"{out}: another process could not use the store, and says why")
    assert store is not None
    return store


def _check_memory(wanted: int, allowed: float, remedy: str) -> None:
    if wanted > allowed:
        raise InputError(f"this takes {wanted / 1e6:.4g} MB of memory, {allowed / 1e6:.4g} MB are allowed; {remedy}")


def _all_say(what: str, good: bool) -> bool:
    """Wait for all processes; whether all is well with each of them."""
    if jax.process_count() == 1:
        return good
    from jax.experimental import multihost_utils

    multihost_utils.sync_global_devices(f"cddf_jax: {what}")
    return bool(np.all(multihost_utils.process_allgather(np.array(good))))
