"""The past of the base tension: where it turned, and the state in which it leaves a single tendon without loads."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.trace import trace
from ..programs.kept import kept_program
from ..robot.manipulator import Manipulator
from ..robot.named_numbers import Case
from ..statics.equilibrium import RESULTS, code_of, result_of

NUM_LEGS = 12  # parts of the path from turn to turn, the first one from rest
NUM_POINTS = 12  # of each part in the figures

Turns = tuple[float, ...]  # tensions, N, at which the tension turned since rest, the present one last


class Loop(NamedTuple):
    """The path since the first turn of the base tension, step first, and the present state; NumPy, SI."""

    base_tension: np.ndarray
    tip_tension: np.ndarray
    tip_angle: np.ndarray
    front: float  # m, up to which the tendon slid last
    position: np.ndarray  # (points, 2) of the body now
    message: str  # why there is no answer; else empty


def gone_on(turns: Turns, tension: float) -> Turns:
    """The turns after the tension has moved to another one; forgotten turns may be left out."""
    if turns and tension == turns[-1]:
        return turns
    before = turns[-2] if len(turns) > 1 else 0.0
    if turns and (turns[-1] - before) * (tension - turns[-1]) >= 0:  # in the same direction as before
        turns = turns[:-1]
    turns = (*turns, tension)
    return turns if len(turns) <= NUM_LEGS else remembered(turns)


def remembered(turns: Turns) -> Turns:
    """The turns without closed loops: a tension that passes an earlier turn deletes it and the one after it."""
    found: list[float] = []
    for tension in turns:
        while len(found) > 1 and (tension - found[-2]) * (found[-2] - found[-1]) >= 0:
            del found[-2:]
        found.append(tension)
    return tuple(found)


def why_no_loop(case: Case, turns: Turns) -> str:
    """The reason in one line; empty if there is a loop."""
    if case.in_space:
        return "The past is not remembered here: that is for one tendon in the plane; cddf trace follows one in space."
    if case.manipulator.num_tendons > 1 or case.loads is not None:
        return "The past is not remembered here: that is for one tendon without loads."
    if len(turns) > NUM_LEGS:
        return f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."
    return "" if len(turns) > 1 else "Drag the base tension back, and the loop appears here."


def loop(case: Case, turns: Turns, arc_length: Float[ArrayLike, " points"]) -> Loop:
    """The loop of a case along its turns.

    Args:
        case: one tendon, without loads; its tension is not used.
        turns: N, two or more, and at most `NUM_LEGS`.
        arc_length: m, places of the body that is drawn.
    """
    path = densely(turns)
    tension, angle, front, position, result = map(np.asarray, _traced(case.manipulator, path, arc_length))
    words = RESULTS[result_of(int(result))] if np.isnan(angle[-1]) else ""
    since = slice(-NUM_POINTS * (len(turns) - 1) - 1, None)  # the first turn
    return Loop(path[since], tension[since], angle[since], float(front), position, words)


def densely(turns: Sequence[float]) -> np.ndarray:
    """The path from rest with points between turns; it always has the same length, so that one program serves all."""
    ends = [0.0] * (NUM_LEGS + 1 - len(turns)) + list(turns)
    legs = [np.linspace(a, b, NUM_POINTS + 1)[1:] for a, b in pairwise(ends)]
    return np.concatenate(legs)


@kept_program
@eqx.filter_jit
def _traced(
    body: Manipulator, path: Float[ArrayLike, " steps"], arc_length: Float[ArrayLike, " points"]
) -> tuple[Array, ...]:
    """Tip tension and angle along the path, and at its end the front, the positions and the code of the result."""
    history = trace(body, path, max_turns=NUM_LEGS + 1, throw=False)
    position = history.at(arc_length).position[-1]
    return history.tip_tension, history.tip_angle, history.front[-1], position, code_of(history.result)[-1]
