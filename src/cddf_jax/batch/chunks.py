"""A large result in chunks: arrays over common dimensions."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Variable(NamedTuple):
    """One array of the answer."""

    dims: tuple[str, ...]  # those that are common, then its own
    shape: tuple[int, ...]
    dtype: np.dtype
    attrs: Mapping[str, object]

    @property
    def missing(self) -> float | bool | int:
        """The value where nothing has been computed yet."""
        return {"f": np.nan, "b": False}.get(self.dtype.kind, -1)


Coordinate = tuple[tuple[str, ...], np.ndarray, Mapping[str, object]]  # as xarray takes it
Index = tuple[int, ...]  # of a chunk


@dataclass(frozen=True)
class Layout:
    """The shape of the answer and of its chunks, before it is computed."""

    shape: dict[str, int]  # of the common dimensions, by name
    chunks: Index  # along the same dimensions
    coords: dict[str, Coordinate]
    variables: dict[str, Variable]  # written in this order
    attrs: Mapping[str, object]

    @property
    def size(self) -> int:
        """The number of items."""
        return int(np.prod(list(self.shape.values())))

    @property
    def bytes_each(self) -> int:
        """Bytes of the answer for each item."""
        own = (int(np.prod(v.shape[len(self.shape) :])) * v.dtype.itemsize for v in self.variables.values())
        return sum(own)

    @property
    def chunk_size(self) -> int:
        return int(np.prod(self.chunks))

    def count(self, index: Index) -> int:
        """The number of items in a chunk."""
        return int(np.prod([places.stop - places.start for places in self.region(index)]))

    def indices(self) -> Iterator[Index]:
        """The indices of all chunks, in the order of the answer."""
        counts = (-(-size // chunk) for size, chunk in zip(self.shape.values(), self.chunks, strict=True))
        return itertools.product(*map(range, counts))

    def region(self, index: Index) -> tuple[slice, ...]:
        """The places of a chunk along the common dimensions."""
        along = zip(index, self.chunks, self.shape.values(), strict=True)
        return tuple(slice(i * chunk, min((i + 1) * chunk, size)) for i, chunk, size in along)


def even_chunks(sizes: Sequence[int], most: int, single: Sequence[bool]) -> Index:
    """Chunks of nearly equal size with no more than `most` items; the last dimensions are not divided if possible.

    `single` says of each dimension whether a chunk has the length 1 along it.
    """
    chunks: list[int] = []
    for size, alone in zip(reversed(sizes), reversed(single), strict=True):
        longest = 1 if alone else max(most // int(np.prod([1, *chunks])), 1)
        chunks.append(-(-size // -(-size // longest)))
    return tuple(reversed(chunks))
