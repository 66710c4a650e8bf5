"""The past of the sliders: how tensions and loads have moved, and the loop on which the body came to its state.

The loop is found by `trace`. One tendon without loads is known by its turns, and its path is followed at once. Any
other path is followed in short steps, and the state after the last one is kept: a move costs its own steps alone.
"""

from collections.abc import Callable
from functools import reduce
from itertools import pairwise, takewhile
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.history import History
from ..history.trace import trace
from ..programs.kept import kept_program
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.status import Status
from .controls import tensions_and_loads
from .model import Exploration, Settings

NUM_LEGS = 12  # turns of one tendon without loads that are remembered at once
NUM_POINTS = 12  # of the path from each of these turns to the next
SHORT_STEPS = 2  # in each step of other paths
STEPS = 32  # over the range of a slider
HALVINGS = 3  # of a step that does not settle
SEVERAL_IN_SPACE = (
    "The past is not remembered here: the friction of several tendons in space is known only for a pull from rest."
)
LOADED_IN_SPACE = (
    "The past is not remembered here: in space it is known without loads only. It begins when all loads are zero."
)
BODY_CHANGED = "The body has changed: its past was forgotten."
STRAIGHT_PULL = "The past begins here: all tendons were pulled together from rest to what is set."

# --- the moves --------------------------------------------------------------------------------------

Turns = tuple[float, ...]  # tensions, N, at which the tension turned since rest, the present one last


class SetPoint(NamedTuple):
    """Tensions and loads, in the units of their controls and in their order."""

    tension: tuple[float, ...]
    load: tuple[float, ...]

    @property
    def alone(self) -> bool:
        """Whether there is one tendon without loads."""
        return len(self.tension) == 1 and not any(self.load)

    @property
    def numbers(self) -> np.ndarray:
        return np.array([*self.tension, *self.load])


class PastMoves(NamedTuple):
    """How tensions and loads have moved: straight from rest to the first point, and on from each to the next."""

    body: tuple[object, ...] = ()  # all else that is set
    points: tuple[SetPoint, ...] = ()  # the present one last
    tendon: int = 0  # whose tension moved last, from 0
    body_changed: bool = False  # and made it forget what was before

    @property
    def by_turns(self) -> bool:
        """Whether one tendon moved without loads, so that the turns of its tension are enough."""
        return all(point.alone for point in self.points)

    @property
    def turns(self) -> Turns:
        """Of the tension of one tendon."""
        return reduce(gone_on, (point.tension[0] for point in self.points), ())

    def goes_on_from(self, earlier: "PastMoves") -> bool:
        """Whether this is the same path, or the same and more."""
        return self.body == earlier.body and self.points[: len(earlier.points)] == earlier.points


def after_move(past: PastMoves, explored: Exploration, settings: Settings) -> PastMoves:
    """The past after the sliders were moved.

    A load is a step of the path. Another body forgets it, unless the turns of the tension are enough.
    """
    tensions, loads = ([control.name for control in kind] for kind in tensions_and_loads(explored.controls))
    point = SetPoint(*(tuple(settings.numbers[name] for name in names) for names in (tensions, loads)))
    others = (number for name, number in settings.numbers.items() if name not in {*tensions, *loads})
    body = (settings.kinematics, *others)
    if not past.points:
        return past._replace(body=body, points=(point,), body_changed=False)
    last = past.points[-1]
    if body != past.body and not past.by_turns:
        past = past._replace(points=(point,), body_changed=past.body_changed or len(past.points) > 1)
    elif why_not(explored.manipulator, point) or why_not(explored.manipulator, last):
        past = past._replace(points=(point,), body_changed=False)
    elif point != last:
        past = past._replace(points=(*past.points, point), body_changed=False)
    moved = [i for i, pair in enumerate(zip(last.tension, point.tension, strict=True)) if pair[0] != pair[1]]
    return past._replace(body=body, tendon=moved[0] if moved else past.tendon)


def why_not(manipulator: Manipulator, point: SetPoint) -> str:
    """The reason in one line why the past is not known at a point; empty if it is."""
    if not manipulator.in_space:
        return ""
    if manipulator.num_tendons > 1:
        return SEVERAL_IN_SPACE
    return LOADED_IN_SPACE if any(point.load) else ""


def why_no_loop(manipulator: Manipulator, past: PastMoves) -> str:
    """The reason in one line; empty if there is a loop."""
    if reason := why_not(manipulator, past.points[-1]):
        return reason
    turns = past.turns if past.by_turns else past.points
    if past.by_turns and len(turns) > NUM_LEGS:
        return f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."
    if len(turns) > 1:
        return ""
    text = "Drag the base tension back, and the loop appears here."
    if manipulator.num_tendons > 1:
        text = f"{STRAIGHT_PULL} Drag a base tension back, and its loop appears here."
    return f"{BODY_CHANGED} " * past.body_changed + text


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


# --- the loop ---------------------------------------------------------------------------------------


class EndState(NamedTuple):
    """The body at the end of a path; SI."""

    front: Array  # (tendons,), up to where, from the base, each slid last
    error_estimate: Array
    status: Array
    position: Array  # (points, components) of the axis


class Loop(NamedTuple):
    """The path since the end of the pull from rest, step first, and the state at its end; NumPy, SI."""

    base_tension: np.ndarray  # (steps, tendons)
    tip_tension: np.ndarray  # (steps, tendons)
    tip_angle: np.ndarray  # (steps,)
    state: EndState
    tendon: int  # whose tension moved last, from 0
    by_turns: bool  # whether one tendon moved without loads

    @property
    def shown(self) -> bool:
        """Whether there are numbers to show."""
        return int(self.state.status) in (Status.successful, Status.inaccurate)

    @property
    def over_tension(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Base and tip tension of that tendon, and the tip angle, since its tension has moved."""
        base, tip = self.base_tension[:, self.tendon], self.tip_tension[:, self.tendon]
        since = max(int(np.argmax(base != base[0])) - 1, 0)
        return base[since:], tip[since:], self.tip_angle[since:]


class Step(NamedTuple):
    """A step of a path that is followed in short steps."""

    history: History | None  # from which the next one goes on; kept of the last step alone
    base_tension: np.ndarray  # (tendons,)
    tip_tension: np.ndarray
    tip_angle: np.ndarray
    state: EndState

    @property
    def is_lost(self) -> bool:
        """Whether it failed, after which nothing is known."""
        return bool(np.isnan(self.tip_angle))


class Follower:
    """Finds the loops of a manipulator, and keeps what the next one goes on from."""

    def __init__(self, exploration: Exploration):
        self.exploration = exploration
        self.tensions, self.loads = tensions_and_loads(exploration.controls)
        self.followed: PastMoves | None = None  # in short steps
        self.steps: list[Step] = []  # of this path

    def knows(self, past: PastMoves) -> bool:
        """Whether most of a path is known already."""
        return past.by_turns or (self.followed is not None and past.goes_on_from(self.followed))

    def loop(self, body: Manipulator, past: PastMoves, wanted: Callable[[], bool] = lambda: True) -> Loop | None:
        """The loop at the end of a path.

        Args:
            body: with the numbers that are set.
            past: for which `why_no_loop` gives no reason.
            wanted: asked before each step; None comes back if it says no.
        """
        if past.by_turns:
            path = np.array([0.0] * (NUM_LEGS + 1 - len(past.turns)) + list(past.turns))
            dense = np.concatenate([np.linspace(*leg, NUM_POINTS + 1)[1:] for leg in pairwise(path)])
            tip, angle, state = jax.tree.map(np.asarray, _along(body, dense, self.exploration.arc_length))
            since = -NUM_POINTS * (len(past.turns) - 1) - 1  # without the pull from rest
            return Loop(dense[since:, None], tip[since:, None], angle[since:], state, past.tendon, by_turns=True)
        if not self._follow(body, past, wanted):
            return None
        base = np.stack([step.base_tension for step in self.steps])
        tip = np.stack([step.tip_tension for step in self.steps])
        angle = np.stack([step.tip_angle for step in self.steps])
        return Loop(base, tip, angle, self.steps[-1].state, past.tendon, by_turns=False)

    def _follow(self, body: Manipulator, past: PastMoves, wanted: Callable[[], bool]) -> bool:
        """Follow a path as far as it is not known yet; false if it was no longer wanted."""
        if self.followed is not None and self.knows(past):
            steps, start, ends = self.steps, self.followed.points[-1], past.points[len(self.followed.points) :]
        else:
            alone = PastMoves(points=tuple(takewhile(lambda point: point.alone, past.points)))
            turns = [past.points[0]._replace(tension=(tension,)) for tension in remembered(alone.turns)]
            first, *ends = [*turns, *past.points[len(alone.points) :]]
            start = first._replace(tension=(0.0,) * len(self.tensions))  # the loads rest on the body before the pull
            rest = self._step(body, start.numbers, None)
            pull = self._straight(body, rest, start, first, wanted)
            if pull is None:
                return False
            steps, start = pull[-1:], first
        for end in ends:
            new = self._straight(body, steps[-1], start, end, wanted)
            if new is None:
                return False
            steps, start = [*steps, *new], end
        self.followed, self.steps = past, [*(step._replace(history=None) for step in steps[:-1]), steps[-1]]
        return True

    def _straight(
        self, body: Manipulator, before: Step, start: SetPoint, end: SetPoint, wanted: Callable[[], bool]
    ) -> list[Step] | None:
        """The steps of a straight part of the path; None where it is no longer wanted."""
        first, last, steps = start.numbers, end.numbers, [before]
        ranges = np.array([control.high for control in (*self.tensions, *self.loads)])
        count = max(1, int(np.ceil(STEPS * np.max(np.abs(last - first) / ranges))))
        for here, there in pairwise(np.linspace(first, last, count + 1)):
            if not wanted():
                return None
            steps += self._stepped(body, steps[-1], here, there)
        return steps[1:]

    def _stepped(
        self, body: Manipulator, before: Step, start: np.ndarray, end: np.ndarray, halvings: int = HALVINGS
    ) -> list[Step]:
        """One step further; where it does not settle, two of half the size."""
        if before.is_lost or before.history is None:
            return []
        new = self._step(body, end, before.history)
        if not new.is_lost or halvings == 0:
            return [new]
        middle = (start + end) / 2
        half = self._stepped(body, before, start, middle, halvings - 1)
        return [*half, *self._stepped(body, half[-1], middle, end, halvings - 1)]

    def _step(self, body: Manipulator, numbers: np.ndarray, start: History | None) -> Step:
        """The body after a step to some tensions and loads; without a start, at rest under the loads."""
        tension = numbers[: len(self.tensions)]
        by_name = {c.name: float(x) for c, x in zip(self.loads, numbers[len(tension) :], strict=True)}
        given = tension, self.exploration.loads(by_name), start, self.exploration.arc_length
        history, tip, angle, state = _followed(body, *given)
        return Step(history, tension, np.asarray(tip), np.asarray(angle), jax.tree.map(np.asarray, state))


# --- compiled once for each kind of body ----------------------------------------------------------


@kept_program
@eqx.filter_jit
def _along(
    body: Manipulator, path: Float[ArrayLike, " steps"], arc_length: Float[ArrayLike, " points"]
) -> tuple[Array, Array, EndState]:
    """Tip tension and angle along a path of one tendon, and the state at its end."""
    history = trace(body, path, max_turns=NUM_LEGS + 1, throw=False)
    return history.tip_tension, history.tip_angle, _state(history, arc_length)


@kept_program
@eqx.filter_jit
def _followed(
    body: Manipulator,
    tension: Float[ArrayLike, " tendons"],
    loads: Loads,
    start: History | None,
    arc_length: Float[ArrayLike, " points"],
) -> tuple[History, Array, Array, EndState]:
    """The history that goes on by one step, or begins under the loads; tip tensions and tip angle, and the state."""
    after = loads if start is None else [loads]
    history = trace(body, jnp.asarray(tension)[None], after, start=start, short_steps=SHORT_STEPS, throw=False)
    return history, jnp.atleast_1d(history.tip_tension[-1]), history.tip_angle[-1], _state(history, arc_length)


def _state(history: History, arc_length: Float[ArrayLike, " points"]) -> EndState:
    position = history.at(arc_length).position[-1]
    front = jnp.atleast_1d(history.front[-1])
    return EndState(front, history.error_estimate[-1], history.status[-1], position)
