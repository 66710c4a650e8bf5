"""The identity of a piece of work: all numbers and functions that its result depends on, by name."""

import hashlib
import re

import jax
import numpy as np

SHOWN = 8  # numbers that are recorded themselves; more of them are recorded as a digest


def numbers_of(tree: object) -> dict[str, object]:
    """The numbers of a pytree by their names, and the digest of its structure."""
    leaves, structure = jax.tree.flatten_with_path(tree)
    without_addresses = re.sub(r" at 0x[0-9a-fA-F]+", "", str(structure))  # in memory, which differ from run to run
    found: dict[str, object] = {"structure": digest(without_addresses)}
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
    numbers = np.asarray(value, np.float64)
    if numbers.size <= SHOWN:
        return numbers.tolist()
    first, last = numbers.ravel()[[0, -1]]
    content = numbers.tobytes() + str(numbers.shape).encode()
    return f"{numbers.size} numbers, {first:.6g} to {last:.6g}, digest {digest(content)}"


def digest(content: str | bytes) -> str:
    """Sixteen characters that differ for different contents."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]
