"""What makes a sweep this one and no other, by names that a message can tell."""

import hashlib
import re
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import jax
import numpy as np

from .axes import Dimension
from .case import Case

SHOWN = 8  # numbers that are told themselves; more of them by their digest


def identity(
    case: Case,
    dimensions: tuple[Dimension, ...],
    options: Mapping[str, Any],
    observables: Mapping[str, Callable],
    others: Mapping[str, Any],
) -> dict[str, Any]:
    """JSON that two sweeps share when they give the same answer.

    Args:
        case: what no axis names.
        dimensions: of the answer, with the values along them.
        options: by name.
        observables: functions, told by their code.
        others: JSON as it is.
    """
    leaves, structure = jax.tree.flatten_with_path(case)
    body = case.manipulator
    along = np.linspace(0.0, float(np.asarray(body.length)), 101)  # what a function as a profile holds, no leaf shows
    profiles = [body.outer_radius, body.inner_radius, *(tendon.offset for tendon in body.tendons)]
    told: dict[str, Any] = {_name(path): _told(leaf) for path, leaf in leaves}
    told |= {f"option {name}": _told(value) for name, value in options.items()}
    for dimension in dimensions:
        told[f"axis {dimension.name}"] = {k: _told(v) for k, v in (dimension.numbers | dimension.options).items()}
    return told | {
        "order of axes": [dimension.name for dimension in dimensions],
        "kind of body and loads": _digest(_without_addresses(str(structure))),
        "radii and offsets": _told(np.stack([np.asarray(profile(along), float) for profile in profiles])),
        "observables": {name: _code(function) for name, function in observables.items()},
        "version of cddf_jax": version("cddf_jax"),
        **others,
    }


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".").removeprefix("manipulator.")


def _told(value: Any) -> Any:
    """A value in JSON, or the digest of a long one."""
    if isinstance(value, tuple | list):
        return [_told(item) for item in value]
    if isinstance(value, int | str):
        return value
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return _without_addresses(repr(value))
    return numbers.tolist() if numbers.size <= SHOWN else f"{numbers.shape}, {_digest(numbers.tobytes())}"


def _code(function: Callable) -> str:
    """What a function does, as far as its code and its constants tell."""
    code = getattr(function, "__code__", None)
    if code is None:
        return _without_addresses(repr(function))
    cells = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    return _digest(_without_addresses(repr((code.co_code, code.co_consts, code.co_names, cells))))


def _without_addresses(text: str) -> str:
    return re.sub(r" at 0x[0-9a-fA-F]+", "", text)


def _digest(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]
