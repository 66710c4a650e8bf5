"""Arguments and results in JSON: what a program depends on, and the structure of its outputs.

Only values and classes of cddf_jax and of the packages that it uses can be described, each by its name. Functions and
classes of a user cannot.
"""

import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh

PACKAGES = ("cddf_jax", "equinox", "jax", "optimistix", "lineax", "numpy", "builtins")


class NotDescribedError(Exception):
    """Something without a name by which another process finds it."""


class Place(NamedTuple):
    """Stands for an array."""

    of: Any  # JSON: the signature of an argument, or the number of an output


def describe(value: Any) -> Any:
    """A value in JSON; arrays in it must be replaced by a `Place`.

    Raises:
        NotDescribedError: for something that only this process knows, and for an array.
    """
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        return {"float": value.hex()}
    if isinstance(value, Place):
        return {"place": value.of}
    if type(value) in (tuple, list):
        return {type(value).__name__: list(map(describe, value))}
    if type(value) is dict:
        return {"dict": [[describe(key), describe(item)] for key, item in value.items()]}
    if isinstance(value, np.dtype):
        return {"dtype": value.str}
    if isinstance(value, jax.tree_util.PyTreeDef):
        return {"structure": describe(value.unflatten(map(Place, range(value.num_leaves))))}
    if isinstance(value, Mesh):
        return {"mesh": _described_mesh(value)}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return {"named": name_of(type(value)), "items": list(map(describe, value))}
    if is_dataclass(value) and not isinstance(value, type):
        return {"object": name_of(type(value)), "fields": {key: describe(item) for key, item in vars(value).items()}}
    return {"name": name_of(value)}


def rebuild(described: Any) -> Any:
    """The value that was described.

    Raises:
        NotDescribedError: for an unknown kind of description, or a name of another package.
    """
    if not isinstance(described, dict):
        return described
    kind, content = next(iter(described.items()))
    if kind not in _REBUILT:
        raise NotDescribedError(f"{kind!r}")
    if kind == "object":
        return _rebuilt_object(_named(content), described["fields"])
    if kind == "named":
        return _named(content)(*map(rebuild, described["items"]))
    return _REBUILT[kind](content)


_REBUILT: dict[str, Callable[[Any], Any]] = {
    "float": float.fromhex,
    "place": Place,
    "tuple": lambda items: tuple(map(rebuild, items)),
    "list": lambda items: list(map(rebuild, items)),
    "dict": lambda items: {rebuild(key): rebuild(item) for key, item in items},
    "dtype": np.dtype,
    "structure": lambda tree: jax.tree.structure(rebuild(tree), is_leaf=lambda leaf: isinstance(leaf, Place)),
    "mesh": lambda mesh: Mesh(np.array(jax.local_devices()).reshape(mesh[1]), mesh[0]),
    "name": lambda name: _named(name),
    "named": lambda _: None,
    "object": lambda _: None,
}


def name_of(value: Any) -> str:
    """The name by which another process finds a class or a function.

    Raises:
        NotDescribedError: where there is none, or it is that of another package.
    """
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    try:
        full = f"{module}:{name}"
        if _named(full) is value:
            return full
    except (AttributeError, KeyError):
        pass
    raise NotDescribedError(f"{value!r} of {type(value)}")


def _named(name: str) -> Any:
    module, _, path = name.partition(":")
    if module.partition(".")[0] not in PACKAGES:
        raise NotDescribedError(name)
    if module not in sys.modules:
        __import__(module)
    found = sys.modules[module]
    for part in path.split("."):
        found = getattr(found, part)
    return found


def _rebuilt_object(kind: type, fields: dict[str, Any]) -> Any:
    """An object made without calling its class, as JAX makes it from leaves: its checks have passed already."""
    made = object.__new__(kind)
    for name, item in fields.items():
        object.__setattr__(made, name, rebuild(item))
    return made


def _described_mesh(mesh: Mesh) -> list[Any]:
    """Axis names and sizes of a mesh over all devices of this process."""
    if mesh.devices.ravel().tolist() != jax.local_devices():
        raise NotDescribedError(f"{mesh}")
    return [list(mesh.axis_names), list(mesh.devices.shape)]
