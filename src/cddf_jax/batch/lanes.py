"""One function for many inputs at once, on every device of this process; the devices do not wait for each other."""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int

from ..programs.kept import kept_program

CPU_BATCH = 512  # lanes at once on a core: they stay in its cache
ACCELERATOR_BATCH = 65536
CALL = 32  # batches of each device in one call, at most
LANES = PartitionSpec("lanes")
Inputs = TypeVar("Inputs")
Outputs = TypeVar("Outputs")


class Lanes(Generic[Inputs, Outputs]):
    """A function of one input, compiled once for many inputs, in equal shares for all devices of this process.

    Args:
        function: a pytree of numbers in, a pytree of arrays out. If it is itself a pytree, its arrays are arguments of
            the compiled program; another function with the same structure then uses the same program.
        count: the largest number of inputs; small jobs get a small program.
        each: how many solves the function makes of one input; as many fewer inputs are taken at once.
    """

    def __init__(self, function: Callable[[Inputs], Outputs], count: int, each: int = 1):
        devices = jax.local_devices()
        most = CPU_BATCH if devices[0].platform == "cpu" else ACCELERATOR_BATCH
        self.batch = min(max(most // each, 1), -(-count // len(devices)))
        width = self.batch * len(devices)
        batches = -(-count // width)
        calls = -(-batches // CALL)
        self.size = width * -(-batches // calls)  # of every call, so that one program serves all
        self._function, self._mesh = function, Mesh(np.array(devices), ("lanes",))

    def __call__(self, inputs: Inputs, count: int) -> Outputs:
        """The outputs for `count` inputs: both are pytrees of NumPy arrays with the inputs along the leading axis."""
        pieces = [_run(self._function, self._mesh, self.batch, *piece) for piece in self._pieces(inputs, count)]
        return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[:count], *pieces)

    def _pieces(self, inputs: Inputs, count: int) -> Iterator[tuple[Inputs, Array]]:
        sharding = NamedSharding(self._mesh, LANES)
        for start in range(0, count, self.size):
            lanes = np.minimum(np.arange(start, start + self.size), count - 1)  # the last one fills up
            chosen = jax.tree.map(lambda x, at=lanes: np.asarray(x)[at], inputs)
            yield jax.device_put((chosen, lanes), sharding)


@kept_program
@eqx.filter_jit
def _run(
    function: Callable[[Inputs], Outputs], mesh: Mesh, batch: int, inputs: Inputs, lanes: Int[Array, "lanes"]
) -> Outputs:
    numbers, rest = eqx.partition(function, eqx.is_array)

    def share(numbers: object, inputs: Inputs, lanes: Int[Array, "share"]) -> Outputs:
        own: Callable[[Inputs], Outputs] = eqx.combine(numbers, rest)  # pyright: ignore[reportAssignmentType]
        return jax.lax.map(lambda lane: own(lane[0]), (inputs, lanes), batch_size=batch)  # lanes: inputs may be none

    run = jax.shard_map(share, mesh=mesh, in_specs=(PartitionSpec(), LANES, LANES), out_specs=LANES)
    return run(numbers, inputs, lanes)
