"""One function for many inputs at once, on every device of this process, without a word between the devices."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

CPU_BATCH = 512  # lanes at once on a core: they stay in its cache
ACCELERATOR_BATCH = 65536
CALL = 16  # batches of each device in one call


class Lanes:
    """A function of one input, compiled once for many, in equal shares for the devices.

    Args:
        function: a pytree of numbers in, a pytree of arrays out.
        count: how many inputs there will be at most, which keeps small jobs small.
        devices: of this process; all of them unless given.
    """

    def __init__(self, function: Callable[[Any], Any], count: int, devices: Sequence[Any] | None = None):
        devices = jax.local_devices() if devices is None else devices
        most = CPU_BATCH if devices[0].platform == "cpu" else ACCELERATOR_BATCH
        batch = min(most, -(-count // len(devices)))
        width = batch * len(devices)
        self.size = width * min(CALL, -(-count // width))  # of every call, so that one program serves all
        mesh, lanes = Mesh(np.array(devices), ("lanes",)), PartitionSpec("lanes")
        self._sharding = NamedSharding(mesh, lanes)

        def share(inputs: Any) -> Any:
            return jax.lax.map(function, inputs, batch_size=batch)

        self._run = jax.jit(jax.shard_map(share, mesh=mesh, in_specs=lanes, out_specs=lanes))

    def __call__(self, inputs: Any) -> Any:
        """The outputs as NumPy arrays, for inputs with one leading axis of any length."""
        count = len(jax.tree.leaves(inputs)[0])
        pieces = [self._run(piece) for piece in self._pieces(inputs, count)]
        return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[:count], *pieces)

    def _pieces(self, inputs: Any, count: int) -> Iterator[Any]:
        for start in range(0, count, self.size):
            lanes = np.minimum(np.arange(start, start + self.size), count - 1)  # the last one fills up
            yield jax.device_put(jax.tree.map(lambda x, at=lanes: np.asarray(x)[at], inputs), self._sharding)
