"""The state in which the past has left the body, and the loop on which it came there, by `trace`.

One tendon without loads is known by its turns: each part of its path, from turn to turn, is found at once. Any other
path is followed in short steps, and the state after the last one is kept: a move costs the steps of that move alone.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.history import History
from ..history.trace import trace
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.status import Status
from .controls import tensions_and_loads
from .model import Exploration
from .past_moves import NUM_LEGS, PastMoves, SetPoint, Turns, corners

NUM_POINTS = 12  # of each part of the path of one tendon without loads
SHORT_STEPS = 2  # in each step of other paths
STEPS = 32  # over the range of a slider
HALVINGS = 3  # of a step that does not settle


class EndState(NamedTuple):
    """The body at the end of a path; SI."""

    front: Array  # (tendons,), up to where, from the base, each slid last
    error_estimate: Array
    status: Array
    position: Array  # (points, components) of the axis


class Rows(NamedTuple):
    """States along a path, step first; SI."""

    base_tension: np.ndarray  # (steps, tendons)
    tip_tension: np.ndarray  # (steps, tendons)
    tip_angle: np.ndarray  # (steps,)


class Loop(NamedTuple):
    """The path since the end of the pull from rest, and the state at its end; NumPy."""

    rows: Rows
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
        base, tip = self.rows.base_tension[:, self.tendon], self.rows.tip_tension[:, self.tendon]
        since = max(int(np.argmax(base != base[0])) - 1, 0)
        return base[since:], tip[since:], self.rows.tip_angle[since:]


class Followed(NamedTuple):
    """A path as far as it was followed in short steps."""

    past: PastMoves
    history: History  # of the last step
    rows: tuple[Rows, ...]  # of each step
    state: EndState | None  # None at rest

    @property
    def is_lost(self) -> bool:
        """Whether a step failed, after which nothing is known."""
        return bool(self.rows) and bool(np.isnan(self.rows[-1].tip_angle[-1]))


class Follower:
    """Finds the loops of a manipulator, and keeps what the next one goes on from."""

    def __init__(self, exploration: Exploration):
        self.exploration = exploration
        self.tensions, self.loads = tensions_and_loads(exploration.controls)
        self.parts: dict[Turns, tuple[Rows, EndState]] = {}  # of a path without loads, by the turns up to their ends
        self.parts_of: tuple[object, ...] = ()  # their body
        self.followed: Followed | None = None

    def knows(self, past: PastMoves) -> bool:
        """Whether most of a path is known already."""
        return past.by_turns or (self.followed is not None and past.goes_on_from(self.followed.past))

    def loop(self, body: Manipulator, past: PastMoves, wanted: Callable[[], bool] = lambda: True) -> Loop | None:
        """The loop at the end of a path.

        Args:
            body: with the numbers that are set.
            past: for which `why_no_loop` gives no reason.
            wanted: asked before each step; None comes back if it says no.
        """
        if past.by_turns:
            return Loop(*self._by_turns(body, past), past.tendon, by_turns=True)
        found = self._in_short_steps(body, past, wanted)
        if found is None or found.state is None:
            return None
        self.followed = found._replace(past=past)
        return Loop(_joined(found.rows), found.state, past.tendon, by_turns=False)

    # --- one tendon without loads ----------------------------------------------------------------

    def _by_turns(self, body: Manipulator, past: PastMoves) -> tuple[Rows, EndState]:
        known = self.parts if self.parts_of == past.body else {}
        last = past.turns
        ends = [last[: i + 1] for i in range(len(last))]
        self.parts = {turns: known.get(turns) or self._part(body, turns) for turns in ends}
        self.parts_of = past.body
        pull, *rest = (rows for rows, _ in self.parts.values())
        return _joined([_last(pull), *rest]), self.parts[last][1]

    def _part(self, body: Manipulator, turns: Turns) -> tuple[Rows, EndState]:
        """The path from the turn before the last to the last one, or to the first one from rest."""
        path = [0.0] * (NUM_LEGS + 1 - len(turns)) + list(turns)
        dense = np.linspace(path[-2], path[-1], NUM_POINTS + 1)[1:]
        found = _after_turns(body, np.array(path[:-1]), dense, self.exploration.arc_length)
        tip, angle, state = jax.tree.map(np.asarray, found)
        return Rows(dense[:, None], tip[:, None], angle), state

    # --- short steps -----------------------------------------------------------------------------

    def _in_short_steps(self, body: Manipulator, past: PastMoves, wanted: Callable[[], bool]) -> Followed | None:
        if self.followed is not None and self.knows(past):
            found = self.followed
            start, ends = found.past.points[-1], past.points[len(found.past.points) :]
        else:
            end, *ends = corners(past.points)
            history = _rest(body, self._given(_numbers(end.at_rest))[1])
            found = self._straight(body, Followed(past, history, (), None), end.at_rest, end, wanted)
            found, start = found and found._replace(rows=found.rows[-1:]), end
        for end in ends:
            found, start = found and self._straight(body, found, start, end, wanted), end
        return found

    def _straight(
        self, body: Manipulator, found: Followed, start: SetPoint, end: SetPoint, wanted: Callable[[], bool]
    ) -> Followed | None:
        """Follow a straight part of the path; None where it is no longer wanted."""
        first, last = map(_numbers, (start, end))
        ranges = np.array([control.high for control in (*self.tensions, *self.loads)])
        count = max(1, int(np.ceil(STEPS * np.max(np.abs(last - first) / ranges))))
        for here, there in pairwise(np.linspace(first, last, count + 1)):
            if not wanted():
                return None
            found = self._stepped(body, found, here, there)
        return found

    def _stepped(
        self, body: Manipulator, found: Followed, start: np.ndarray, end: np.ndarray, halvings: int = HALVINGS
    ) -> Followed:
        """One step further; where it does not settle, two of half the size."""
        if found.is_lost:
            return found
        tension, loads = self._given(end)
        history, *numbers = _step(body, tension, loads, found.history, self.exploration.arc_length)
        tip, angle, state = jax.tree.map(np.asarray, tuple(numbers))
        rows = (*found.rows, Rows(tension[None], tip[None], angle[None]))
        new = found._replace(history=history, rows=rows, state=state)
        if new.is_lost and halvings > 0:
            middle = (start + end) / 2
            half = self._stepped(body, found, start, middle, halvings - 1)
            return self._stepped(body, half, middle, end, halvings - 1)
        return new

    def _given(self, numbers: np.ndarray) -> tuple[np.ndarray, Loads]:
        """Tensions and loads of a place on the path."""
        count = len(self.tensions)
        by_name = {control.name: float(x) for control, x in zip(self.loads, numbers[count:], strict=True)}
        return numbers[:count], self.exploration.loads(by_name)


def _numbers(point: SetPoint) -> np.ndarray:
    return np.array([*point.tension, *point.load])


def _last(rows: Rows) -> Rows:
    return Rows(*(x[-1:] for x in rows))


def _joined(parts: Sequence[Rows]) -> Rows:
    return Rows(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


# --- compiled once for each kind of body ----------------------------------------------------------


@eqx.filter_jit
def _after_turns(
    body: Manipulator,
    turns: Float[ArrayLike, " turns"],
    path: Float[ArrayLike, " steps"],
    arc_length: Float[ArrayLike, " points"],
) -> tuple[Array, Array, EndState]:
    """Tip tension and angle along a path after some turns, and the state at its end."""
    history = trace(body, jnp.concatenate([turns, path]), max_turns=NUM_LEGS + 1, throw=False)
    count = np.size(path)
    return history.tip_tension[-count:], history.tip_angle[-count:], _state(history, arc_length)


@eqx.filter_jit
def _rest(body: Manipulator, loads: Loads) -> History:
    """The body under loads before its tendons are pulled."""
    nothing = jnp.zeros((1, body.num_tendons))
    return trace(body, nothing, loads, short_steps=SHORT_STEPS, throw=False)


@eqx.filter_jit
def _step(
    body: Manipulator,
    tension: Float[ArrayLike, " tendons"],
    loads: Loads,
    start: History,
    arc_length: Float[ArrayLike, " points"],
) -> tuple[History, Array, Array, EndState]:
    """The history that goes on by one step; tip tensions and tip angle, and the state."""
    pulled = jnp.asarray(tension)[None]
    history = trace(body, pulled, [loads], start=start, short_steps=SHORT_STEPS, throw=False)
    return history, jnp.atleast_1d(history.tip_tension[-1]), history.tip_angle[-1], _state(history, arc_length)


def _state(history: History, arc_length: Float[ArrayLike, " points"]) -> EndState:
    position = history.at(arc_length).position[-1]
    front = jnp.atleast_1d(history.front[-1])
    return EndState(front, history.error_estimate[-1], history.status[-1], position)
