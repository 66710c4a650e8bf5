"""The base tension before the first row of a trial: none (rest), a stated one, or one that is fitted.

It is what the base cell would have read: the largest tension of the only tendon, from which it was released to the
first row. Trials of several tendons, or by displacement, begin with a row of what was set before.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import Literal, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..errors import InputError
from ..numerics.given_numbers import check_numbers
from ..units import shown

PARAMETER = "before"  # in all trials
REST: Literal["rest"] = "rest"
ABOVE = 1.2  # times the first reading: where a search starts

One = float | Literal["rest"]
Before = One | Sequence[One]


class Past(eqx.Module):
    """The base tension before the first row of each trial of a table."""

    stated: Float[np.ndarray | Array, " trials"]  # N, as read; 0 at rest, and where only a search will tell
    parameters: tuple[str, ...] = eqx.field(static=True)  # those that are fitted; "" where none is

    @property
    def at_rest(self) -> bool:
        """Whether all trials begin at rest."""
        return not any(self.parameters) and not np.any(self.stated)

    def check(self, first: Float[np.ndarray, " trials"], places: Sequence[str]) -> None:
        """Refuse a largest tension that is smaller than that of the first row.

        Args:
            first: the readings of the first rows, N.
            places: of these rows, in words for messages.

        Raises:
            InputError: names the first such row.
        """
        for one, row, place in zip(self.stated, first, places, strict=True):
            if 0 < one < row:
                raise InputError(
                    f"{place}: before must be the largest base tension up to this row, {row:.6g} N or more, got "
                    f"{one:.6g} N"
                )

    def tension(self, parameters: Mapping[str, ArrayLike]) -> Float[Array, "trials 1"]:
        """The tensions before the first rows, as read, N."""
        own = zip(self.parameters, jnp.asarray(self.stated), strict=True)
        return jnp.stack([jnp.asarray(parameters.get(*one)) for one in own])[:, None]

    @property
    def in_words(self) -> list[str]:
        """For each trial "rest", "80 N", or "fitted (before)" with the name of the parameter."""
        return [
            f"fitted ({name})" if name else shown(tension, "force") if tension else REST
            for name, tension in zip(self.parameters, np.asarray(self.stated), strict=True)
        ]


def is_past(name: str) -> bool:
    """Whether a parameter is a tension before the first row."""
    return re.fullmatch(rf"{PARAMETER}(_[1-9]\d*)?", name) is not None


def pasts_of(counts: Sequence[int], before: Before, free: Collection[str]) -> list[Past]:
    """How the trials of each table begin.

    Args:
        counts: numbers of trials, by table; 0 for a table without a history.
        before: as in `fit`.
        free: the parameters that are fitted.

    Raises:
        InputError: for an entry that is neither "rest" nor a tension, another number of entries than trials, or the
            parameter of a trial that does not exist.
    """
    check_numbers("before", [entry for entry in jax.tree.leaves(before) if not isinstance(entry, str)])
    total, listed = sum(counts), not np.isscalar(before)
    given = cast("Sequence[One]", before) if listed else (cast("One", before),)
    entries = [_checked(entry) for entry in given]
    fitted = {int(name.partition("_")[2] or 0): name for name in free if is_past(name)}  # 0 stands for all trials
    if not total and (fitted or any(entries)):
        raise InputError("before is used with a history only; leave it out, or give history=True")
    if listed and len(entries) != total:
        raise InputError(f"before must hold one entry for each of the {total} trials, got {len(entries)}")
    for trial, name in fitted.items():
        if trial > total:
            raise InputError(f"{name} belongs to trial {trial}, but only {total} have a history; fit one of these")
    stated = np.array(entries if listed else entries * total)
    # a trial listed as "rest" has only a parameter of its own
    common = ["" if listed and not tension else fitted.get(0, "") for tension in stated]
    parameters = [fitted.get(trial, name) for trial, name in enumerate(common, 1)]
    ends = np.cumsum([0, *counts]).tolist()
    return [Past(stated[i:k], tuple(parameters[i:k])) for i, k in pairwise(ends)]


def _checked(entry: One) -> float:
    """The entry as a tension, N; 0 for rest."""
    if isinstance(entry, str) and entry == REST:
        return 0.0
    if not isinstance(entry, str) and np.ndim(entry) == 0 and 0 < float(entry) < np.inf:
        return float(entry)
    raise InputError(f'before must be "rest" or the largest base tension before the first row, N, got {entry!r}')


def first_guesses(tables: Sequence[tuple[Past, Float[np.ndarray, " trials"]]]) -> dict[str, tuple[float, float]]:
    """By parameter, where the search starts, and the lower bound, N: the tension of the first row.

    Once a release has reached the tip, the tension before it has no effect any more. So the search starts a little
    above the first row.

    Args:
        tables: the trials of each table, and the readings of their first rows, N.
    """
    most: dict[str, tuple[float, float]] = {}  # stated tension, and reading of the first row: the largest of all trials
    for past, first in tables:
        for name, own, row in zip(past.parameters, past.stated, first, strict=True):
            if name:
                stated, reading = most.get(name, (0.0, 0.0))
                most[name] = max(stated, float(own)), max(reading, float(row))
    return {name: (stated or ABOVE * reading or 1.0, reading) for name, (stated, reading) in most.items()}
