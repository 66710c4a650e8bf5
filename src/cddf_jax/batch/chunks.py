"""A large dataset before it is computed, and the chunks in which it is computed."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray

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


def even_chunks(sizes: Sequence[int], most: int, single: Sequence[bool]) -> tuple[int, ...]:
    """Chunks of nearly equal size with no more than `most` items; the last dimensions are not divided if possible.

    `single` says of each dimension whether a chunk has the length 1 along it.
    """
    chunks: list[int] = []
    for size, alone in zip(reversed(sizes), reversed(single), strict=True):
        longest = 1 if alone else max(most // math.prod(chunks), 1)
        chunks.append(-(-size // -(-size // longest)))
    return tuple(reversed(chunks))
