"""The part of the page that remembers: the past of the sliders, its loop in words, and the button that forgets it."""

from collections.abc import Callable

import panel as pn

from ..robot.manipulator import Manipulator
from .loop import Follower, Loop
from .model import Exploration, Settings
from .parts import words
from .past_moves import PastMoves, SetPoint, after_move, why_no_loop, why_not
from .words import loop_html, paragraph

FOLLOWING = "Following the path from rest, some seconds ..."


class PastPart:
    """What the sliders of one page have done since rest."""

    def __init__(self, exploration: Exploration, forgot: Callable[[], None]):
        self.exploration, self.forgot = exploration, forgot
        self.past = PastMoves()
        self.follower = Follower(exploration)
        self.text = words("past")
        self.button = pn.widgets.Button(name="Forget the past", on_click=lambda _: self.forget())

    @property
    def parts(self) -> list[pn.viewable.Viewable]:
        """The text, and the button if there may be something to forget."""
        at_rest = SetPoint((0.0,) * self.exploration.manipulator.num_tendons, ())
        return [self.text] if why_not(self.exploration.manipulator, at_rest) else [self.text, self.button]

    def after_move(self, settings: Settings) -> PastMoves:
        """The past after the sliders were moved."""
        self.past = after_move(self.past, self.exploration.manipulator, self.exploration.controls, settings)
        return self.past

    def forget(self) -> None:
        """Start again with a pull from rest to what is set."""
        self.past = PastMoves(tendon=self.past.tendon)
        self.forgot()

    def found(self, body: Manipulator, past: PastMoves, say: Callable[[str], None]) -> tuple[Loop | None, str] | None:
        """The loop of a past, and what is said of it; None if it was forgotten meanwhile. Called on a thread.

        Args:
            body: with the numbers that are set.
            past: of `after_move`.
            say: called with a text if the path has to be followed from rest.
        """
        if reason := why_no_loop(body, past):
            return None, paragraph(reason)
        if not self.follower.knows(past):
            say(paragraph(FOLLOWING))
        loop = self.follower.loop(body, past, lambda: self.past.goes_on_from(past))
        return None if loop is None else (loop if loop.shown else None, loop_html(loop))
