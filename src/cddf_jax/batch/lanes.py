"""A function for many inputs at once, on all devices of this process; the devices do not wait for each other."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int

CPU_BATCH = 256  # lanes at once on a core: they stay in its cache, and a slow one holds up few
ACCELERATOR_BATCH = 65536
CALL = 32  # batches of each device in one call, at most
LANES = PartitionSpec("lanes")
Inputs = TypeVar("Inputs")
Outputs = TypeVar("Outputs")


def in_lanes(function: Callable[[Inputs], Outputs], inputs: Inputs, count: int, most: int, each: int = 1) -> Outputs:
    """A function of one input for many inputs, compiled once, in equal shares for all devices of this process.

    Args:
        function: a pytree of numbers in, a pytree of arrays out. If it is itself a pytree, its arrays are arguments of
            the compiled program; another function with the same structure then uses the same program.
        inputs: a pytree of NumPy arrays with the inputs along the leading axis; so are the outputs.
        count: the number of inputs.
        most: the largest `count` of all calls, so that they share one program.
        each: number of solves for one input; the more there are, the fewer inputs are taken at once.
    """
    devices = jax.local_devices()
    at_once = CPU_BATCH if devices[0].platform == "cpu" else ACCELERATOR_BATCH
    batch = min(max(at_once // each, 1), -(-most // len(devices)))
    width = batch * len(devices)
    batches = -(-most // width)
    size = width * -(-batches // -(-batches // CALL))  # of every call, so that one program serves all
    mesh, pieces = Mesh(np.array(devices), ("lanes",)), []
    for start in range(0, count, size):
        lanes = np.minimum(np.arange(start, start + size), count - 1)  # the last input is repeated to fill a call
        chosen = jax.tree.map(lambda x, at=lanes: np.asarray(x)[at], inputs)
        placed = jax.device_put((chosen, lanes), NamedSharding(mesh, LANES))
        pieces.append(_run(function, mesh, batch, *placed))
    return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[:count], *pieces)


@eqx.filter_jit
def _run(
    function: Callable[[Inputs], Outputs], mesh: Mesh, batch: int, inputs: Inputs, lanes: Int[Array, "lanes"]
) -> Outputs:
    numbers, rest = eqx.partition(function, eqx.is_array)

    def share(numbers: object, inputs: Inputs, lanes: Int[Array, "share"]) -> Outputs:
        own: Callable[[Inputs], Outputs] = eqx.combine(numbers, rest)  # pyright: ignore[reportAssignmentType]
        return jax.lax.map(lambda lane: own(lane[0]), (inputs, lanes), batch_size=batch)  # lanes: inputs may be none

    # unchecked: where lanes differ in the branch of a `cond`, JAX's check of what varies over the devices fails
    run = jax.shard_map(share, mesh=mesh, in_specs=(PartitionSpec(), LANES, LANES), out_specs=LANES, check_vma=False)
    return run(numbers, inputs, lanes)
