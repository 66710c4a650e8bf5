"""What a tendon had before the first row of its trial: nothing, a stated largest base tension, or one to be fitted.

A largest tension is what the base cell would have read. The trial begins with a release from it to the first row.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Literal, NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..errors import InputError
from ..robot.manipulator import Manipulator
from ..statics.solve import solve

PARAMETER = "before"  # that of trial 2 alone is `before_2`
REST: Literal["rest"] = "rest"
LEAST_ABOVE = 1.02  # of the first reading, from where the search for a largest tension starts

One = float | Literal["rest"]
Before = One | Sequence[One]


class Start(NamedTuple):
    """How a trial begins."""

    largest: float | None  # N, as read; None for rest, or for what is to be found
    parameter: str = ""  # which is fitted; "" where none is

    @property
    def from_rest(self) -> bool:
        return self.largest is None and not self.parameter


class Past(eqx.Module):
    """What the tendon had before the first row of each trial of a table."""

    largest: Float[np.ndarray | Array, " trials"]  # N, as read; the first reading where the trial began at rest
    parameters: tuple[str, ...] = eqx.field(static=True)  # of each trial; "" where none is fitted

    def tension(self, parameters: Mapping[str, ArrayLike]) -> Float[Array, " trials"]:
        """As read, N."""
        stated = jnp.asarray(self.largest)
        return jnp.stack([jnp.asarray(parameters.get(name, stated[i])) for i, name in enumerate(self.parameters)])


def is_past(name: str) -> bool:
    """Whether a parameter is a largest tension before the first row."""
    return name == PARAMETER or (name.startswith(f"{PARAMETER}_") and name.removeprefix(f"{PARAMETER}_").isdigit())


def starts_of(counts: Sequence[int], before: Before, free: Collection[str]) -> list[list[Start]]:
    """How each trial begins, by table.

    Args:
        counts: of the trials of each table, 0 for a table without a history.
        before: as of `fit`.
        free: the parameters that are fitted.

    Raises:
        InputError: for what is neither rest nor a tension, another number of entries than trials, or the parameter of
            a trial that is not there.
    """
    total, listed = sum(counts), not isinstance(before, str) and np.ndim(cast("ArrayLike", before)) > 0
    fitted = [name for name in free if is_past(name)]
    given = cast("Sequence[One]", before) if listed else (cast("One", before),)
    entries: list[One] = [_checked(entry) for entry in given]
    if not total and (fitted or any(entry != REST for entry in entries)):
        raise InputError("before is used with a history only; leave it out, or give history=True")
    if listed and len(entries) != total:
        raise InputError(f"before must hold one entry for each of the {total} trials, got {len(entries)}")
    for name in fitted:
        number = name.removeprefix(PARAMETER).removeprefix("_")
        if number and not 1 <= int(number) <= total:
            raise InputError(f"{name} is that of trial {number}, and there are {total} with a history")
    starts = [_start(entry, k, fitted, listed) for k, entry in enumerate(entries if listed else entries * total, 1)]
    ends = np.cumsum([0, *counts])
    return [starts[ends[i] : ends[i + 1]] for i in range(len(counts))]


def _checked(entry: One) -> One:
    known = entry == REST if isinstance(entry, str) else np.ndim(entry) == 0 and 0 < entry < np.inf
    if not known:
        raise InputError(f'before must be "rest" or the largest base tension before the first row, N, got {entry!r}')
    return REST if isinstance(entry, str) else float(entry)


def _start(entry: One, number: int, fitted: Sequence[str], listed: bool) -> Start:
    """Of trial 1, 2, ...; a trial that is said to begin at rest does so, unless its own tension is fitted."""
    own, stated = f"{PARAMETER}_{number}", None if isinstance(entry, str) else entry
    common = PARAMETER in fitted and not (listed and stated is None)
    return Start(stated, own if own in fitted else PARAMETER if common else "")


def past_of(starts: Sequence[Start], first: Sequence[float], places: Sequence[str]) -> Past | None:
    """What was before the trials of a table; None where all began at rest.

    Args:
        starts: of the trials.
        first: their first readings, N.
        places: of these rows, in words.

    Raises:
        InputError: where a largest tension is smaller than that of the first row.
    """
    if all(start.from_rest for start in starts):
        return None
    for start, reading, place in zip(starts, first, places, strict=True):
        if start.largest is not None and start.largest < reading:
            raise InputError(
                f"{place}: before must be the largest base tension up to this row, {reading:.6g} N or more, got "
                f"{start.largest:.6g} N"
            )
    largest = [reading if s.largest is None else s.largest for s, reading in zip(starts, first, strict=True)]
    return Past(np.array(largest), tuple(start.parameter for start in starts))


def first_guesses(
    manipulator: Manipulator, tables: Sequence[tuple[Sequence[Start], np.ndarray]]
) -> dict[str, tuple[float, float]]:
    """By parameter, where the search starts, and the lower bound: the largest first reading of its trials, N.

    Once a release has reached the tip, nothing is left of the tension before it. So the search starts where the release
    to the first row has reached about half of the body.

    Args:
        manipulator: the body.
        tables: the trials of each table, and their first readings, N.
    """
    found: dict[str, tuple[float, float]] = {}
    for starts, first in tables:
        for start, reading in zip(starts, first.tolist(), strict=True):
            if start.parameter:
                guess, low = found.get(start.parameter, (0.0, 0.0))
                stated = 0.0 if start.largest is None else start.largest
                found[start.parameter] = max(guess, stated), max(low, reading, 0.0)
    return {name: (guess or _half_released(manipulator, low), low) for name, (guess, low) in found.items()}


def _half_released(manipulator: Manipulator, reading: float) -> float:
    """T / T_tip says what friction takes one way; a release has to overcome it twice."""
    if reading == 0:
        return 1.0
    tip = float(solve(manipulator, reading, throw=False).tip_tension[0])
    ratio = reading / tip if 0 < tip < reading else LEAST_ABOVE
    return reading * max(ratio, LEAST_ABOVE)
