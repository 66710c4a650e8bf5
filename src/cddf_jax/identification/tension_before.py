"""The base tensions before the first row of a trial: none (rest), stated ones, or ones that are fitted.

They are what the base cells would have read. For one tendon it is the largest tension, from which it was released to
the first row. The tensions of several tendons rose linearly from rest to those before, and went from these to the first
row.
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

PARAMETER = "before"  # of tendon 1 in all trials
REST: Literal["rest"] = "rest"
ABOVE = 1.2  # times the first reading: where a search starts

One = float | Literal["rest"] | Sequence[float]
Before = One | Sequence[One]


class Past(eqx.Module):
    """The base tensions before the first row of each trial of a table, by trial and tendon."""

    stated: Float[np.ndarray | Array, "trials tendons"]  # N, as read; 0 at rest, NaN for that of the first row
    parameters: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # those that are fitted; "" where none is

    @property
    def at_rest(self) -> bool:
        """Whether all trials begin at rest."""
        return not any(map(any, self.parameters)) and not np.any(self.stated)

    def followed_by(self, first: Float[np.ndarray, "trials tendons"], places: Sequence[str]) -> "Past":
        """The same with all tensions known.

        Args:
            first: the readings of the first rows, N.
            places: of these rows, in words for messages.

        Raises:
            InputError: where the largest tension of a single tendon is smaller than that of the first row.
        """
        stated = np.where(np.isnan(self.stated), first, self.stated)
        for one, row, place in zip(stated, first, places, strict=True):
            if one.size == 1 and 0 < one[0] < row[0]:
                raise InputError(
                    f"{place}: before must be the largest base tension up to this row, {row[0]:.6g} N or more, got "
                    f"{one[0]:.6g} N"
                )
        return Past(stated, self.parameters)

    def tension(self, parameters: Mapping[str, ArrayLike]) -> Float[Array, "trials tendons"]:
        """The tensions before the first rows, as read, N."""
        rows = zip(self.parameters, jnp.asarray(self.stated), strict=True)
        return jnp.stack(
            [jnp.stack([jnp.asarray(parameters.get(*one)) for one in zip(*row, strict=True)]) for row in rows]
        )

    @property
    def in_words(self) -> list[str]:
        """For each trial "rest", "80 N", "60 N and 20 N", or "fitted (before)" with the name of the parameter."""
        return [
            " and ".join(
                f"fitted ({name})" if name else shown(tension, "force") for name, tension in zip(*row, strict=True)
            )
            if any(row[0]) or np.any(row[1])
            else REST
            for row in zip(self.parameters, np.asarray(self.stated), strict=True)
        ]


def is_past(name: str) -> bool:
    """Whether a parameter is a tension before the first row."""
    return _place(name) is not None


def _place(name: str) -> tuple[int, int | None] | None:
    """The tendon, 1, 2, ..., and the trial, 1, 2, ... or None for all, of a parameter; None for other parameters."""
    found = re.fullmatch(rf"{PARAMETER}(?:_tendon_([1-9]\d*))?(?:_(\d+))?", name)
    if not found:
        return None
    tendon, trial = found.groups()
    return int(tendon or 1), None if trial is None else int(trial)


def pasts_of(counts: Sequence[int], before: Before, free: Collection[str], tendons: int = 1) -> list[Past]:
    """How the trials of each table begin.

    Args:
        counts: numbers of trials, by table; 0 for a table without a history.
        before: as in `fit`.
        free: the parameters that are fitted.
        tendons: the number of tendons.

    Raises:
        InputError: for an entry that is neither "rest" nor one tension per tendon, another number of entries than
            trials, or the parameter of a trial or tendon that does not exist.
    """
    check_numbers("before", [entry for entry in jax.tree.leaves(before) if not isinstance(entry, str)])
    total, listed = sum(counts), not np.isscalar(before)
    fitted = {place: name for name in free if (place := _place(name))}
    given = cast("Sequence[One]", before) if listed else (cast("One", before),)
    entries = [_checked(entry, tendons) for entry in given]
    if not total and (fitted or any(entries)):
        raise InputError("before is used with a history only; leave it out, or give history=True")
    if listed and len(entries) != total:
        raise InputError(f"before must hold one entry for each of the {total} trials, got {len(entries)}")
    for (tendon, trial), name in fitted.items():
        if trial is not None and not 1 <= trial <= total:
            raise InputError(f"{name} belongs to trial {trial}, but only {total} have a history; fit one of these")
        if tendon > tendons:
            raise InputError(f"{name} belongs to tendon {tendon}, but the body has {tendons}; fit one of these")
    stated, parameters = np.zeros((total, tendons)), []
    for k, entry in enumerate(entries if listed else entries * total):
        common = None if listed and not entry else fitted  # a trial listed as "rest" has only parameters of its own
        own = [fitted.get((i, k + 1), (common or {}).get((i, None), "")) for i in range(1, tendons + 1)]
        stated[k] = entry or (np.nan if any(own) else 0.0)
        parameters.append(tuple(own))
    ends = np.cumsum([0, *counts]).tolist()
    return [Past(stated[i:k], tuple(parameters[i:k])) for i, k in pairwise(ends)]


def _checked(entry: One, tendons: int) -> tuple[float, ...]:
    """The entry as one number for each tendon; empty for rest."""
    if isinstance(entry, str) and entry == REST:
        return ()
    try:
        numbers = np.atleast_1d(np.asarray(entry, float))
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if numbers.shape == (tendons,) and np.all(numbers >= 0) and 0 < np.sum(numbers) < np.inf:
        return tuple(numbers.tolist())
    what = "the largest base tension before the first row, N"
    if tendons > 1:
        what = f"the base tensions of {tendons} tendons before the first row, N, in a list of trials such as [(60, 20)]"
    raise InputError(f'before must be "rest" or {what}, got {entry!r}')


def first_guesses(
    tables: Sequence[tuple[Past, Float[np.ndarray, "trials tendons"]]],
) -> dict[str, tuple[float, float]]:
    """By parameter, where the search starts, and the lower bound, N.

    Once a release has reached the tip, the tension before it has no effect any more. So the search starts a little
    above the first row. A single tendon had at least the tension of the first row; with several tendons each may have
    had less.

    Args:
        tables: the trials of each table, and the readings of their first rows, N.
    """
    most: dict[str, tuple[float, float]] = {}  # stated tension, and reading of the first row: the largest of all trials
    alone = all(rows.shape[1] == 1 for _, rows in tables)
    for past, rows in tables:
        for names, own, row in zip(past.parameters, np.nan_to_num(past.stated), rows, strict=True):
            for i, name in enumerate(names):
                if name:  # by displacement rows need no tension of every tendon
                    before = most.get(name, (0.0, 0.0))
                    most[name] = max(before[0], float(own[i])), max(before[1], float(row[i]))
    return {
        name: (stated or ABOVE * reading or 1.0, reading if alone else 0.0) for name, (stated, reading) in most.items()
    }
