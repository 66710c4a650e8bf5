"""One function for many inputs at once, on every device of this process, without a word between the devices."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

CPU_BATCH = 512  # lanes at once on a core: they stay in its cache
ACCELERATOR_BATCH = 65536
CALL = 32  # batches of each device in one call, at most
LANES = PartitionSpec("lanes")


class Lanes:
    """A function of one input, compiled once for many, in equal shares for the devices.

    Args:
        function: a pytree of numbers in, a pytree of arrays out. If it is itself a pytree, its arrays are arguments of
            the program, which serves others of its kind as well.
        count: how many inputs there will be at most, which keeps small jobs small.
        devices: of this process; all of them unless given.
    """

    def __init__(self, function: Callable[[Any], Any], count: int, devices: Sequence[Any] | None = None):
        devices = jax.local_devices() if devices is None else devices
        most = CPU_BATCH if devices[0].platform == "cpu" else ACCELERATOR_BATCH
        self.batch = min(most, -(-count // len(devices)))
        width = self.batch * len(devices)
        batches = -(-count // width)
        calls = -(-batches // CALL)
        self.size = width * -(-batches // calls)  # of every call, so that one program serves all
        self._function, self._mesh = function, Mesh(np.array(devices), ("lanes",))

    def __call__(self, inputs: Any, count: int) -> Any:
        """The outputs as NumPy arrays for `count` inputs, along the leading axis."""
        pieces = [_run(self._function, self._mesh, self.batch, *piece) for piece in self._pieces(inputs, count)]
        return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[:count], *pieces)

    def _pieces(self, inputs: Any, count: int) -> Iterator[Any]:
        sharding = NamedSharding(self._mesh, LANES)
        for start in range(0, count, self.size):
            lanes = np.minimum(np.arange(start, start + self.size), count - 1)  # the last one fills up
            chosen = jax.tree.map(lambda x, at=lanes: np.asarray(x)[at], inputs)
            yield jax.device_put((chosen, lanes), sharding)


@eqx.filter_jit
def _run(function: Callable[[Any], Any], mesh: Mesh, batch: int, inputs: Any, lanes: Any) -> Any:
    numbers, rest = eqx.partition(function, eqx.is_array)

    def share(numbers: Any, inputs: Any, lanes: Any) -> Any:
        own = eqx.combine(numbers, rest)
        return jax.lax.map(lambda lane: own(lane[0]), (inputs, lanes), batch_size=batch)  # lanes: inputs may be none

    run = jax.shard_map(share, mesh=mesh, in_specs=(PartitionSpec(), LANES, LANES), out_specs=LANES)
    return run(numbers, inputs, lanes)
