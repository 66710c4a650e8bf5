"""Progress of long work: the work reports it by `stage`, and `show_progress` shows it."""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

PATIENCE = 2.0  # s, during which nothing is shown
RARER = 0.25  # of the time so far: the least time between two lines of a log
TICK = 0.1  # s, between two updates
Item = TypeVar("Item")


@dataclass(eq=False)
class Stage:
    """A stage of work. The work changes `what` and `done`."""

    what: str
    total: int | None  # number of items; None if they are not counted
    done: int
    before: int  # items that were done before it began
    begun: float  # s, of the clock

    def in_words(self, now: float) -> str:
        """The stage with the present item, and the time that the others will take."""
        if self.total in (None, 1):
            return self.what
        words = f"{self.what} {min(self.done + 1, self.total):,} of {self.total:,}"
        if self.done == self.before:
            return words
        rate = (self.done - self.before) / max(now - self.begun, TICK)
        return f"{words}, {timedelta(seconds=round((self.total - self.done) / rate))} left"


class Stages:
    """The present stages, the outermost first. `look` writes lines about those that take long, ever more rarely."""

    def __init__(self, write: Callable[[str], object], clock: Callable[[], float] = time.monotonic):
        self.write, self.clock, self.begun = write, clock, clock()
        self.next, self.last = PATIENCE, ""
        self.lock = threading.Lock()
        self.now: list[Stage] = []

    def look(self) -> None:
        with self.lock:
            words, seconds = ": ".join(stage.in_words(self.clock()) for stage in self.now), self.clock() - self.begun
            if words and seconds >= self.next and words != self.last:
                self.write(f"{seconds:.0f} s: {words}\n")
                self.next, self.last = seconds + max(PATIENCE, RARER * seconds), words

    def end(self, stage: Stage) -> None:
        with self.lock:
            self.now.remove(stage)


SHOWN: ContextVar[Stages | None] = ContextVar("SHOWN", default=None)


@contextmanager
def stage(what: str, total: int | None = None, done: int = 0) -> Iterator[Stage]:
    """Report a stage of work, such as "searching", if progress is shown; also a decorator.

    `total` is the number of items, if they are counted, and `done` the number of those that are done already.
    """
    shown = SHOWN.get()
    here = Stage(what, total, done, done, shown.clock() if shown else 0.0)
    if shown:
        shown.now.append(here)
    try:
        yield here
    finally:
        if shown:
            shown.end(here)


def each(what: str, items: Sequence[Item]) -> Iterator[Item]:
    """Go through items, and report the present one."""
    with stage(what, len(items)) as here:
        for here.done, item in enumerate(items):
            yield item


@contextmanager
def show_progress() -> Iterator[None]:
    """Show the progress of long work on standard error: `with cddf.show_progress(): fit = cddf.fit(robot, table)`.

    Nothing is shown in the first 2 s. Then each stage that takes long has a line, with the time so far. Work of other
    threads is not shown.
    """
    shown = Stages(lambda line: print(line, end="", file=sys.stderr, flush=True))
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(TICK):
            shown.look()

    watcher, before = threading.Thread(target=watch, daemon=True), SHOWN.set(shown)
    watcher.start()
    try:
        yield
    finally:
        SHOWN.reset(before)
        ended.set()
        watcher.join()
