"""The past of the sliders: how tensions and loads have moved since the straight body. No mechanics here."""

from collections.abc import Sequence
from functools import reduce
from itertools import takewhile
from typing import NamedTuple

from ..robot.manipulator import Manipulator
from .controls import Control, tensions_and_loads
from .model import Settings

NUM_LEGS = 12  # turns of one tendon without loads that are remembered at once
SEVERAL_IN_SPACE = (
    "The past is not remembered here: the friction of several tendons in space is known only for a pull from rest."
)
LOADED_IN_SPACE = (
    "The past is not remembered here: in space it is known without loads only. It begins when all loads are zero."
)
BODY_CHANGED = "The body has changed: its past was forgotten."
STRAIGHT_PULL = "The past begins here: all tendons were pulled together from rest to what is set."

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
    def at_rest(self) -> "SetPoint":
        """The same loads on the body without tensions."""
        return SetPoint((0.0,) * len(self.tension), self.load)


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


def after_move(past: PastMoves, manipulator: Manipulator, controls: Sequence[Control], settings: Settings) -> PastMoves:
    """The past after the sliders were moved.

    A load is a step of the path. Another body forgets it, unless the turns of the tension are enough.
    """
    tensions, loads = ([control.name for control in kind] for kind in tensions_and_loads(controls))
    point = SetPoint(*(tuple(settings.numbers[name] for name in names) for names in (tensions, loads)))
    others = (number for name, number in settings.numbers.items() if name not in {*tensions, *loads})
    body = (settings.kinematics, *others)
    if not past.points:
        return past._replace(body=body, points=(point,), body_changed=False)
    last = past.points[-1]
    if body != past.body and not past.by_turns:
        past = past._replace(points=(point,), body_changed=past.body_changed or len(past.points) > 1)
    elif why_not(manipulator, point) or why_not(manipulator, last):
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
    turns = past.turns if past.by_turns else ()
    if len(turns) > NUM_LEGS:
        return f"More than {NUM_LEGS} turns are remembered at once; forget the past to go on."
    if len(turns or corners(past.points)) > 1:
        return ""
    text = "Drag the base tension back, and the loop appears here."
    if manipulator.num_tendons > 1:
        text = f"{STRAIGHT_PULL} Drag a base tension back, and its loop appears here."
    return f"{BODY_CHANGED} " * past.body_changed + text


def corners(points: Sequence[SetPoint]) -> list[SetPoint]:
    """The points without those that lie on the way of one slider, and without closed loops of one tendon alone."""
    alone = tuple(takewhile(lambda point: point.alone, points))
    found = [points[0]._replace(tension=(tension,)) for tension in remembered(PastMoves(points=alone).turns)]
    for point in points[len(alone) :]:
        if found and _goes_straight_on(found[-2] if len(found) > 1 else found[0].at_rest, found[-1], point):
            found.pop()
        found.append(point)
    return found


def _goes_straight_on(before: SetPoint, last: SetPoint, point: SetPoint) -> bool:
    """Whether one number alone moves, and goes on in its direction."""
    first, then = (_changes(*ends) for ends in ((before, last), (last, point)))
    return len(first) == 1 and first.keys() == then.keys() and all(first[i] * then[i] > 0 for i in first)


def _changes(start: SetPoint, end: SetPoint) -> dict[int, float]:
    """By how much each number changes that does."""
    pairs = enumerate(zip((*start.tension, *start.load), (*end.tension, *end.load), strict=True))
    return {i: b - a for i, (a, b) in pairs if a != b}


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
