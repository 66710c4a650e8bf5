"""Progress of long work: the work reports it by `stage`, and `show_progress` shows it."""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import timedelta
from importlib.util import find_spec
from typing import Any, TypeVar

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
        """The stage with the present item, the items per second, and the time that the others will take."""
        if self.total in (None, 1):
            return self.what
        words = f"{self.what} {min(self.done + 1, self.total):,} of {self.total:,}"
        if self.done == self.before:
            return words
        rate = (self.done - self.before) / max(now - self.begun, TICK)
        speed = f", {rate:,.0f}/s" if rate >= 10 else ""
        return f"{words}{speed}, {timedelta(seconds=round((self.total - self.done) / rate))} left"


class Log:
    """Lines of text about stages that take long; the longer they take, the more time between two lines."""

    def __init__(self, write: Callable[[str], object]):
        self.write, self.next, self.last = write, PATIENCE, ""

    def show(self, words: str, part: float | None, seconds: float) -> None:
        """Show what is being done, how much of it (0 to 1, or None) is done, and how long all has taken."""
        if seconds >= self.next and words != self.last:
            self.write(f"{seconds:.0f} s: {words}\n")
            self.next, self.last = seconds + max(PATIENCE, RARER * seconds), words

    def hide(self) -> None:
        """Do nothing: lines of a log stay."""


class Bar:
    """A bar on a terminal instead of lines; it is removed when the work is done."""

    bar: Any = None

    def show(self, words: str, part: float | None, seconds: float) -> None:
        if seconds < PATIENCE:
            return
        if self.bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn
            from rich.table import Column

            text = TextColumn("{task.description}", markup=False, table_column=Column())  # wraps
            columns, console = (BarColumn(20), text), Console(stderr=True)
            self.bar = Progress(*columns, console=console, transient=True, auto_refresh=False, redirect_stdout=False)
            self.bar.start()
            self.bar.add_task("")
        total = None if part is None else 1.0
        self.bar.update(0, description=f"{seconds:.0f} s: {words}", total=total, completed=part or 0.0, refresh=True)

    def hide(self) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None


class Stages:
    """The present stages, the outermost first; `look` shows them. Between stages nothing is shown."""

    def __init__(self, screen: Log | Bar, clock: Callable[[], float] = time.monotonic):
        self.screen, self.clock, self.begun = screen, clock, clock()
        self.lock = threading.Lock()
        self.now: list[Stage] = []

    def look(self) -> None:
        with self.lock:
            if self.now:
                now, parts = self.clock(), [stage.done / stage.total for stage in self.now if stage.total]
                words = ": ".join(stage.in_words(now) for stage in self.now)
                self.screen.show(words, parts[-1] if parts else None, now - self.begun)

    def end(self, stage: Stage) -> None:
        with self.lock:
            self.now.remove(stage)
            if not self.now:
                self.screen.hide()


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

    Nothing is shown in the first 2 s. Then a terminal shows a bar until the work is done, if the package rich is there
    (`pip install "cddf-jax[cli]"`). Elsewhere each stage that takes long has a line, with the time so far.
    Work of other threads is not shown.
    """
    bar = sys.stderr.isatty() and find_spec("rich")
    shown = Stages(Bar() if bar else Log(lambda line: print(line, end="", file=sys.stderr, flush=True)))
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
