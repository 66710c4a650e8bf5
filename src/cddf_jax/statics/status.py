"""How a solve ended: a whole number with a name and words."""

from enum import IntEnum
from typing import SupportsInt

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int


class Status(IntEnum):
    """How a solve ended, with what happened and what helps."""

    _value_: int
    words: str

    def __new__(cls, code: int, words: str) -> "Status":
        """A member, which is its code."""
        member = int.__new__(cls, code)
        member._value_, member.words = code, words
        return member

    successful = 0, ""
    direction_contradicted = (
        1,
        "A tendon travels against its direction, so its friction has the wrong sign. Where the direction was stated, "
        "flip it or leave it out: +1 slides in at the base, -1 slides out. Where it was found, both directions are "
        "contradicted: part of the tendon sticks, and its tension depends on what was before: follow it with trace.",
    )
    inaccurate = 2, "The error estimate exceeds 1e-5: the body is too rough for its nodes. Raise nodes=."
    crossing = (
        3,
        "offset * curvature reaches 1: fibres of the body would cross at the tendon. "
        "Lower the tension or the offset, or stiffen the body.",
    )
    not_converged = 4, "The iteration did not settle. Raise nodes= or max_iterations, or lower tension and loads."
    unstable = (
        5,
        "The equilibrium is unstable: the smallest eigenvalue of its tangent is not positive, and a body leaves it. "
        "Lower the loads.",
    )
    load_limit = (
        6,
        "The path of equilibria, tensions first and then all loads together, ends before the full loads: the body "
        "snaps. Lower the loads, or raise the tension that holds them.",
    )
    slack = (7, "A tendon would have to push to give its displacement; the answer is that of a tendon without tension.")
    unreachable = (
        8,
        "No base tension between slack and crossing fibres reaches the target; the answer is the nearest one found. "
        "Change the target.",
    )
    undetermined = (
        9,
        "Other base tensions reach the targets just as well, for instance of antagonists that do not stretch. "
        "Give one of the tensions, or another target.",
    )
    locked = (
        10,
        "A tendon that slides out locks: its tension grows without bound before the tip. "
        "Lower its base tension, friction or wrap.",
    )
    too_many_turns = 11, "More turns of the base tension have to be remembered than max_turns. Raise max_turns=."
    unphysical = (
        12,
        "The body or its load is not physical (NaN, negative tension, modulus, friction or drag, a wall of no "
        "thickness, a direction other than +1 or -1, a place off the body). Give tensions of 0 or more; "
        "manipulator.validate() names what is wrong with a body.",
    )


# of the rows of an experiment, in the order in which warnings name them
NOTEWORTHY = (
    *(Status.unphysical, Status.locked, Status.not_converged, Status.load_limit, Status.slack, Status.unreachable),
    *(Status.undetermined, Status.crossing, Status.unstable, Status.inaccurate, Status.direction_contradicted),
)


def words_of(status: SupportsInt) -> str:
    """What happened in one solve and what helps; empty if it was successful."""
    return Status(int(status)).words


def in_words(status: ArrayLike) -> str:
    """One status in words: "successful", or what happened and what helps. Of a batch "3 successful, 1 locked"."""
    codes, counts = np.unique(np.asarray(status), return_counts=True)
    if np.ndim(status) == 0:
        return words_of(codes[0]) or "successful"
    return ", ".join(f"{count} {Status(code).name}" for code, count in zip(codes, counts, strict=True))


def first_of(*cases: tuple[Bool[Array, "*lanes"], Status | Int[Array, "*lanes"]]) -> Int[Array, "*lanes"]:
    """The status of the first case that holds; successful where none does."""
    found = jnp.int32(Status.successful)
    for holds, status in reversed(cases):
        found = jnp.where(holds, jnp.int32(status), found)
    return found
