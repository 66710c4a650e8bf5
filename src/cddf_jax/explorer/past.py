"""The past of the sliders: how the tension of one tendon without loads has moved, and the loop that `trace` finds."""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.trace import trace
from ..robot.manipulator import Manipulator
from ..statics.status import Status
from .controls import tensions_and_loads
from .model import Exploration, Settings

NUM_LEGS = 12  # turns that are remembered at once
NUM_POINTS = 12  # of the path from each of these turns to the next
SEVERAL = "The past is remembered for one tendon. For several, follow a path with cddf trace."
LOADED = "The past is remembered without loads only. It begins when all loads are zero; cddf trace follows loads."

Turns = tuple[float, ...]  # tensions, N, at which the tension turned since rest, the present one last


class Loop(NamedTuple):
    """The path since the end of the pull from rest, step first, and the state at its end; NumPy, SI."""

    base_tension: np.ndarray
    tip_tension: np.ndarray
    tip_angle: np.ndarray
    tendon_displacement: np.ndarray
    front: np.ndarray  # up to where, from the base, the tendon slid last
    status: np.ndarray
    position: np.ndarray  # (points, components) of the axis

    @property
    def shown(self) -> bool:
        """Whether there are numbers to show."""
        return int(self.status) in (Status.successful, Status.inaccurate)


def after_move(turns: Turns, explored: Exploration, settings: Settings) -> Turns:
    """The turns after the sliders were moved; none where the past is not known."""
    tensions, loads = tensions_and_loads(explored.controls)
    if len(tensions) > 1 or any(settings.numbers[control.name] for control in loads):
        return ()
    return gone_on(turns, settings.numbers[tensions[0].name])


def why_no_loop(manipulator: Manipulator, turns: Turns) -> str:
    """The reason in one line; empty if there is a loop."""
    if manipulator.num_tendons > 1:
        return SEVERAL
    if not turns:
        return LOADED
    if len(turns) > NUM_LEGS:
        return f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."
    return "" if len(turns) > 1 else "Drag the base tension back, and the loop appears here."


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


def loop_of(body: Manipulator, turns: Turns, arc_length: np.ndarray) -> Loop:
    """The loop at the end of a path, for which `why_no_loop` gives no reason."""
    ends = np.array([0.0] * (NUM_LEGS + 1 - len(turns)) + list(turns))
    path = np.concatenate([np.linspace(*leg, NUM_POINTS + 1)[1:] for leg in pairwise(ends)])
    tip, angle, pulled_in, *state = map(np.asarray, _along(body, path, arc_length))
    since = -NUM_POINTS * (len(turns) - 1) - 1  # without the pull from rest
    return Loop(path[since:], tip[since:], angle[since:], pulled_in[since:], *state)


@eqx.filter_jit
def _along(
    body: Manipulator, path: Float[ArrayLike, " steps"], arc_length: Float[ArrayLike, " points"]
) -> tuple[Array, ...]:
    """Tip tension, tip angle and displacement along a path; front, status and axis at its end."""
    history = trace(body, path, max_turns=NUM_LEGS + 1, throw=False)
    end = history.front[-1], history.status[-1], history.at(arc_length).position[-1]
    return history.tip_tension, history.tip_angle, history.tendon_displacement, *end
