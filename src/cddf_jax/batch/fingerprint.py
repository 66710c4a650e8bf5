"""The identity of a piece of work: all numbers and functions that its result depends on, by name."""

import hashlib
import re
from collections.abc import Callable

import jax
import numpy as np

SHOWN = 8  # numbers that are recorded themselves; more of them are recorded as a digest


def numbers_of(tree: object) -> dict[str, object]:
    """The numbers of a pytree by their names, and the digest of its structure."""
    leaves, structure = jax.tree.flatten_with_path(tree)
    found: dict[str, object] = {"structure": digest(without_addresses(str(structure)))}
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        found[name.removeprefix("manipulator.")] = recorded(leaf)
    return found


def recorded(value: object) -> object:
    """A value in JSON, or the digest of a long one."""
    if isinstance(value, tuple | list):
        return [recorded(item) for item in value]
    if isinstance(value, int | str):
        return value
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return without_addresses(repr(value))
    if numbers.size <= SHOWN:
        return numbers.tolist()
    first, last = numbers.ravel()[[0, -1]]
    content = numbers.tobytes() + str(numbers.shape).encode()
    return f"{numbers.size} numbers, {first:.6g} to {last:.6g}, digest {digest(content)}"


def code_digest(function: Callable[..., object]) -> str:
    """A digest of the code and the constants of a function."""
    code = getattr(function, "__code__", None)
    if code is None:
        return without_addresses(repr(function))
    cells = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    return digest(without_addresses(repr((code.co_code, code.co_consts, code.co_names, cells))))


def without_addresses(text: str) -> str:
    """A text without addresses in memory, which differ from run to run."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", text)


def digest(content: str | bytes) -> str:
    """Sixteen characters that differ for different contents."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]
