"""The past of the sliders: how tensions and loads have moved since rest, and the path that `trace` finds."""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.trace import trace
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.status import Status
from .controls import LOADS, in_si, load_components, loads_by_name
from .model import Exploration, Settings

NUM_MOVES = 20  # that are remembered
NUM_POINTS = 8  # of the path along each of them
NODES, SHORT_STEPS = 8, 2  # in each step to a point, where the answer is not exact: a page must not wait
PARALLEL = 1e-9  # 1 less the cosine between two moves that count as one

Moves = tuple[tuple[float, ...], ...]  # base tensions and components of the loads, SI, after each move since rest


class Loop(NamedTuple):
    """The path since the first move, step first, and the state at its end; NumPy, SI."""

    base_tension: np.ndarray  # of the tendon that moved last, as the next four
    tip_tension: np.ndarray
    tendon_displacement: np.ndarray
    front: np.ndarray  # up to where, from the base, it slid last
    tip_angle: np.ndarray
    error_estimate: np.ndarray  # as in `History`
    status: np.ndarray
    position: np.ndarray  # (points, components) of the axis

    @property
    def shown(self) -> bool:
        """Whether there are numbers to show."""
        return int(self.status) in (Status.successful, Status.inaccurate, Status.slack)


def after_move(moves: Moves, explored: Exploration, settings: Settings) -> Moves:
    """The moves after the sliders were moved; one that goes on in the direction of the last is one with it."""
    moving = [control for control in explored.controls if control.quantity.name in ("base_tension", *LOADS)]
    here = tuple(in_si(settings.numbers[control.name], control.quantity) for control in moving)
    if not moves:
        return (here,)
    last, new = (
        np.subtract(b, a) for a, b in pairwise([_first(moves, explored.manipulator.num_tendons), *moves, here][-3:])
    )
    if not np.any(new):
        return moves
    onwards = last @ new >= (1 - PARALLEL) * np.linalg.norm(last) * np.linalg.norm(new)
    return (*moves[: -1 if onwards else None], here)


def _first(moves: Moves, num_tendons: int) -> tuple[float, ...]:
    """Where the first move began: no tension, under the loads of the file."""
    return (0.0,) * num_tendons + moves[0][num_tendons:]


def why_no_loop(moves: Moves) -> str:
    """The reason in one line; empty if there is a path to show."""
    if len(moves) > NUM_MOVES:
        return f"More than {NUM_MOVES} moves are remembered at once; forget the past to go on."
    return "" if len(moves) > 1 else "Drag the base tension back, or another tension or load: a path appears here."


def loop_of(body: Manipulator, moves: Moves, tendon: int, arc_length: np.ndarray) -> Loop:
    """The path of one tendon, counted from 0, for which `why_no_loop` gives no reason."""
    start = _first(moves, body.num_tendons)
    ends = np.array([start] * (NUM_MOVES + 1 - len(moves)) + list(moves))
    path = np.concatenate([ends[:1], *(np.linspace(*leg, NUM_POINTS + 1)[1:] for leg in pairwise(ends))])
    tension, acting = np.split(path, [body.num_tendons], axis=1)
    names = [name for components in load_components(body).values() for name in components]
    loads = loads_by_name(body, dict(zip(names, acting.T, strict=True)))
    *of_tendons, angle, error, status, position = map(np.asarray, _along(body, tension, loads, arc_length))
    pull, tip, pulled_in, front = (x.reshape(len(path), -1)[:, tendon] for x in (tension, *of_tendons))
    since = slice(-NUM_POINTS * (len(moves) - 1) - 1, None)
    return Loop(pull[since], tip[since], pulled_in[since], front[-1], angle[since], error, status, position)


@eqx.filter_jit
def _along(
    body: Manipulator,
    path: Float[ArrayLike, "steps tendons"],
    loads: Loads | None,
    arc_length: Float[ArrayLike, " points"],
) -> tuple[Array, ...]:
    """Tip tension, displacement, front and tip angle along a path; error estimate, status and axis at its end."""
    nodes = 16 if loads is None and body.num_tendons == 1 else NODES
    history = trace(body, path, loads, nodes=nodes, max_turns=NUM_MOVES + 1, short_steps=SHORT_STEPS, throw=False)
    position = history.at(arc_length).position[-1]
    ends = history.error_estimate[-1], history.status[-1], position
    return history.tip_tension, history.tendon_displacement, history.front, history.tip_angle, *ends
