"""Compiled programs as bytes, and back again.

All uses of jaxlib's client are in this file. The public functions of JAX for this need pickle. If the client of another
version differs, `UnavailableError` is raised, and nothing is kept.
"""

import math
import os
import re
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jaxlib.lapack
import numpy as np
from jax.core import ShapedArray
from jax.sharding import Mesh, NamedSharding, PartitionSpec, Sharding, SingleDeviceSharding
from jaxlib import xla_client

from ..application import is_tested_jaxlib

CALLED = ("lapack_", "Sharding", "SPMD", "xla.sdy")  # calls that every process finds; others may be this process's own
SMALL = 64  # numbers of an array that goes in with others, because a transfer of its own takes longer than a copy
# What XLA is asked for on the CPU, in the words of jaxlib 0.10. With fusion emitters compiling takes twice as long, for
# code no faster. The order of least memory lets a small operation begin when the one before ends; otherwise two cores
# share them, and wait for each other longer than the operations take.
OPTIONS: dict[str, str | bool] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}


class UnavailableError(Exception):
    """The program cannot be kept, or what was kept cannot be used."""


class Signature(NamedTuple):
    """An array that goes into a program or comes out of it."""

    shape: tuple[int, ...]
    dtype: str
    weak: bool = False  # whether its type is weak, as that of a Python number
    spec: tuple[str | None, ...] | None = None  # how its axes are shared by the devices; None on one device

    @staticmethod
    def read(shape: Sequence[int], dtype: str, weak: bool, spec: Sequence[str | None] | None) -> "Signature":
        """A signature from lists, as in JSON."""
        return Signature(tuple(shape), dtype, weak, None if spec is None else tuple(spec))

    @property
    def aval(self) -> ShapedArray:
        """The abstract value for JAX."""
        return ShapedArray(self.shape, np.dtype(self.dtype), self.weak)


class Interface(NamedTuple):
    """The inputs and outputs of a program."""

    inputs: tuple[Signature, ...]
    outputs: tuple[Signature, ...]
    mesh: Mesh | None  # its devices, if there are several
    lapack: bool  # whether it calls LAPACK


class Pack(NamedTuple):
    """Small arrays of one type, which go into a program as one row of numbers."""

    dtype: str
    members: tuple[int, ...]  # their numbers among all inputs
    shapes: tuple[tuple[int, ...], ...]

    def row(self, arrays: Sequence[Any]) -> np.ndarray:
        """All numbers in one row."""
        members = [arrays[i] for i in self.members]
        flat = [x.ravel() if type(x) is np.ndarray else np.asarray(x).ravel() for x in members]
        return np.concatenate(flat, dtype=self.dtype, casting="same_kind")

    def parts(self, row: jax.Array) -> dict[int, jax.Array]:
        """The arrays again, by their numbers."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes])[:-1].tolist()
        parts = zip(self.members, jax.numpy.split(row, ends), self.shapes, strict=True)
        return {i: part.reshape(shape) for i, part, shape in parts}


class Packing(NamedTuple):
    """How the arrays of a call become the inputs of its program: packs first, then the arrays that go in alone."""

    packs: tuple[Pack, ...]
    alone: tuple[int, ...]

    @staticmethod
    def of(inputs: Sequence[Signature], mesh: Mesh | None) -> "Packing":
        """The packing that follows from the shapes and types."""
        small: dict[str, list[int]] = {}
        on_cpu = jax.default_backend() == "cpu"  # elsewhere arrays of JAX would go to the host and back
        for i, one in enumerate(inputs):
            alone = mesh is not None or one.weak or one.spec is not None or math.prod(one.shape) > SMALL
            if on_cpu and not alone:
                small.setdefault(one.dtype, []).append(i)
        packs = [Pack(dtype, tuple(at), tuple(inputs[i].shape for i in at)) for dtype, at in small.items()]
        packed = {i for pack in packs for i in pack.members}
        return Packing(tuple(packs), tuple(i for i in range(len(inputs)) if i not in packed))

    def packed(self, arrays: Sequence[Any]) -> list[Any]:
        """The inputs of the program."""
        return [*[pack.row(arrays) for pack in self.packs], *[arrays[i] for i in self.alone]]

    def unpacked(self, inputs: Sequence[jax.Array]) -> list[jax.Array]:
        """The arrays, from the inputs of the program; traced."""
        found = dict(zip(self.alone, inputs[len(self.packs) :], strict=True))
        for pack, row in zip(self.packs, inputs, strict=False):
            found |= pack.parts(row)
        return [found[i] for i in range(len(found))]

    def signatures(self, inputs: Sequence[Signature]) -> list[Signature]:
        """Those of the inputs of the program."""
        rows = [Signature((sum(map(math.prod, pack.shapes)),), pack.dtype) for pack in self.packs]
        return [*rows, *[inputs[i] for i in self.alone]]


class Program:
    """A compiled program with flat lists of arrays in and out.

    Args:
        executable: of jaxlib's client.
        interface: its arrays and devices.
    """

    def __init__(self, executable: Any, interface: Interface):
        self.interface, self._executable, self._mesh = interface, executable, interface.mesh
        self._packing = Packing.of(interface.inputs, interface.mesh)
        inputs = self._packing.signatures(interface.inputs)
        self._inputs = [(one.aval, np.dtype(one.dtype), self._sharding(one)) for one in inputs]
        self._devices = jax.local_devices()[:1]  # of a program without a mesh
        outputs = [(one.aval, self._sharding(one), self._mesh is not None) for one in interface.outputs]
        with _as_expected():
            self._results = [xla_client.array_result_handler(*one, _skip_checks=True) for one in outputs]

    def _sharding(self, one: Signature) -> Sharding:
        if self._mesh is None:
            return SingleDeviceSharding(jax.local_devices()[0])
        return NamedSharding(self._mesh, PartitionSpec(*(one.spec or ())))

    def __call__(self, arrays: Sequence[Any]) -> list[jax.Array]:
        """Run it.

        Raises:
            UnavailableError: if the arrays do not fit.
        """
        with _as_expected():
            packed = self._packing.packed(arrays)
            placed = [self._placed(array, *wanted) for array, wanted in zip(packed, self._inputs, strict=True)]
            return self._executable.execute_sharded(placed).consume_with_handlers(self._results)

    def _placed(self, array: Any, aval: ShapedArray, dtype: np.dtype, sharding: Sharding) -> jax.Array:
        if self._mesh is not None:
            return jax.device_put(array, sharding)
        if isinstance(array, jax.Array):
            return array
        return xla_client.batched_device_put(aval, sharding, [np.asarray(array, dtype)], self._devices, False)

    def as_bytes(self) -> bytes:
        """Bytes from which `loaded` makes the program again."""
        with _as_expected():
            return _client().serialize_executable(self._executable)


def compiled(
    function: Callable[..., Any], arrays: Sequence[Any], inputs: tuple[Signature, ...], mesh: Mesh | None
) -> Program:
    """Trace and compile a function of arrays that gives a list of arrays.

    Raises:
        UnavailableError: for a program that only this process can run, because it calls back into Python.
    """
    packing = Packing.of(inputs, mesh)
    placed = packing.packed(arrays) if mesh is None else _on_mesh(arrays, inputs, mesh)
    traced = jax.jit(lambda *given: function(*packing.unpacked(given)), keep_unused=True).trace(*placed)
    lowered = traced.lower()
    called = set(re.findall(r"custom_call @([\w.]+)", lowered.as_text()))
    others = sorted(name for name in called if not name.startswith(CALLED))
    if others or traced.jaxpr.effects:
        raise UnavailableError(f"it has effects, or calls {others}")
    done = lowered.compile(compiler_options=_options())
    found = zip(jax.tree.leaves(lowered.out_info), jax.tree.leaves(done.output_shardings), strict=True)
    if not all(is_within_reach(sharding) for sharding in jax.tree.leaves(done.output_shardings)):
        raise UnavailableError("its outputs are elsewhere")
    outputs = tuple(Signature(one.shape, one.dtype.name, spec=spec_of(sharding)) for one, sharding in found)
    lapack = any(name.startswith("lapack_") for name in called)
    return Program(done.runtime_executable(), Interface(inputs, outputs, mesh, lapack))


def _options() -> dict[str, str | bool]:
    """What XLA is asked for, unless the user's flags say it."""
    if not is_tested_jaxlib() or jax.default_backend() != "cpu":
        return {}
    given = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in OPTIONS.items() if name not in given}


def loaded(content: bytes, interface: Interface) -> Program:
    """The program from its bytes. They hold machine code, and must come from a trusted place.

    Raises:
        UnavailableError: if the client does not accept them.
    """
    with _as_expected():
        if interface.lapack:  # JAX prepares it while it traces
            jaxlib.lapack.prepare_lapack_call("potrf_ffi", np.dtype(np.float64))
        devices = jax.local_devices()[:1] if interface.mesh is None else interface.mesh.devices.ravel().tolist()
        return Program(_client().deserialize_executable(content, devices), interface)


def _on_mesh(arrays: Sequence[Any], inputs: Sequence[Signature], mesh: Mesh) -> list[jax.Array]:
    pairs = zip(arrays, inputs, strict=True)
    return [jax.device_put(x, NamedSharding(mesh, PartitionSpec(*(one.spec or ())))) for x, one in pairs]


def spec_of(sharding: Sharding) -> tuple[str | None, ...] | None:
    """How the axes of an array are shared by a mesh of devices; None on one device."""
    return tuple(sharding.spec) if isinstance(sharding, NamedSharding) else None


def is_within_reach(sharding: Sharding) -> bool:
    """Whether an array lies on the first device of this process, or is shared by a mesh in a simple way."""
    if isinstance(sharding, NamedSharding):
        return all(part is None or isinstance(part, str) for part in sharding.spec)
    return isinstance(sharding, SingleDeviceSharding) and sharding.device_set == {jax.local_devices()[0]}


def _client() -> Any:
    return jax.local_devices()[0].client


@contextmanager
def _as_expected():
    """Turn every error of the client into `UnavailableError`."""
    try:
        yield
    except (AttributeError, TypeError, ValueError, RuntimeError) as error:  # RuntimeError: those of the client, too
        raise UnavailableError(f"{type(error).__name__}: {error}") from error
