"""One manipulator on the page: its sliders, its figures and numbers, its fit, and the files that can be saved."""

import io
import logging
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

import panel as pn

from .. import figures
from ..errors import InputError, SolveError
from ..estimation.determination import IDENTIFIED
from ..quantities import QUANTITIES
from ..reports.export import fields_csv
from .controls import from_si, rounded
from .model import Exploration, Picture, Settings
from .parts import column, grid, plot, slider, title, words
from .past import Loop, Moves, after_move, loop_of, why_no_loop
from .plots import AlongPlots, BodyPlot, TableColumns, TensionPlots
from .space import SpacePlot
from .words import lines_html, loop_html, numbers_html, paragraph

if TYPE_CHECKING:
    from ..identification.fit import Fit

FILES = {
    "explorer.pdf": "Figure (PDF)",
    "explorer.png": "Figure (PNG)",
    "body.toml": "Body as set (TOML)",
    "fields.csv": "Fields along the body (CSV)",
}
SLIDES = {"as found": 0, "slides in": 1, "slides out": -1}


class Threads(ExitStack):
    """Four threads, so that quick work never waits for long work such as compiling."""

    def __init__(self):
        super().__init__()
        self.pictures, self.pasts, self.comparisons, self.fits = each = [ThreadPoolExecutor(1) for _ in range(4)]
        self.ended = False
        for threads in each:
            self.callback(threads.shutdown, cancel_futures=True)
        self.callback(setattr, self, "ended", True)


class ExplorerView:
    """The sliders and what follows from them.

    Every change is solved on another thread and then drawn. If sliders move faster than that, old changes are left out.
    """

    def __init__(self, exploration: Exploration, threads: Threads):
        self.exploration, self.threads = exploration, threads
        assert pn.state.curdoc is not None
        self.document = pn.state.curdoc
        self.settings: Settings = exploration.start
        self.picture: Picture | None = None
        self.fitted: Fit | None = None
        self.moves: Moves = ()  # of tensions and loads, as far as they are remembered
        self.tendon = 0  # whose tension moved last
        body, s = exploration.manipulator, exploration.arc_length
        self.body = SpacePlot(body) if body.in_space else BodyPlot(body, s)
        self.along = AlongPlots(self.body.over_arc_length, body.num_tendons, s)
        self.tension = TensionPlots(body.num_tendons, exploration.over)
        self._show_points("data", [(table, table.columns) for table in exploration.tables])
        self._make_controls()
        self._make_words()
        parts = {
            "body": [plot(self.body.figure), grid(*map(plot, self.body.angles), least=200)],
            "numbers": [self.numbers],
            "along": [grid(*map(plot, (*self.body.views, *self.along.figures.values())), least=230)],
            "past": [self.past_text, self.forget_button],
        }
        self.drawn = {name: column(*part) for name, part in parts.items()}
        self.drawn["tension"] = column(grid(*map(plot, self.tension.figures.values()), least=330), self.drawn["past"])
        self.closed = False  # once the page is gone, nothing more is drawn
        pn.state.on_session_destroyed(lambda _: setattr(self, "closed", True))
        pn.state.onload(self.change)

    # --- widgets ---------------------------------------------------------------------------------

    def _make_controls(self) -> None:
        self.sliders = {control.name: slider(control) for control in self.exploration.controls}
        self.directions = [
            pn.widgets.Select(name=f"Tendon {i}", options=SLIDES, value=direction or 0, width=105)
            for i, direction in enumerate(self.settings.direction, 1)
        ]
        self.reset = pn.widgets.Button(name="Back to the file's numbers", on_click=lambda _: self._start_again())
        for widget in (*self.sliders.values(), *self.directions):
            widget.param.watch(lambda _: self.change(), "value")

    def _make_words(self) -> None:
        self.notice, self.numbers, self.verdict, self.past_text = map(words, ("notice", "numbers", "verdict", "past"))
        self.forget_button = pn.widgets.Button(name="Forget the past", on_click=lambda _: self.forget())
        self.fit_button = pn.widgets.Button(name="Fit friction and modulus", button_type="primary")
        self.fit_button.disabled = not self.exploration.tables
        self.take_over = pn.widgets.Button(name="Set the sliders to the fit", visible=False)
        self.fit_button.on_click(lambda _: self.start_fit())
        self.take_over.on_click(lambda _: self._take_over())

    def _file(self, name: str) -> io.BytesIO:
        if (picture := self.picture) is None:
            raise InputError("there is nothing to save yet; wait for the first picture")
        case = picture.case
        if name == "body.toml":
            return io.BytesIO(self.exploration.toml(case).encode())
        if name == "fields.csv":
            return io.BytesIO(fields_csv(picture.along).encode())
        figure = figures.equilibrium_figure(case.manipulator, picture.equilibrium, case.loads)
        return io.BytesIO(figures.render(figure, "explorer")[name])

    @property
    def parts(self) -> dict[str, pn.Column]:
        """The parts of the page, by their names in page.css."""
        buttons = pn.FlexBox(self.fit_button, self.take_over)
        fit = column(title("What the data tell"), buttons, self.verdict)
        downloads = [
            pn.widgets.FileDownload(callback=partial(self._file, name), filename=name, label=label, width=210)
            for name, label in FILES.items()
        ]
        files = column(title("Save"), pn.FlexBox(*downloads))
        chosen = pn.FlexBox(*(self.directions if len(self.directions) > 1 else []))
        return {
            "body": self.drawn["body"],
            "numbers": self.drawn["numbers"],
            "side": column(*self.sliders.values(), chosen, self.reset),
            "tension": self.drawn["tension"],
            "along": self.drawn["along"],
            "rest": column(fit, files),
        }

    # --- changes ---------------------------------------------------------------------------------

    def move_to(self, settings: Settings) -> None:
        """Set the sliders."""
        for name, value in settings.numbers.items():
            moved = self.sliders[name]
            moved.param.update(start=min(moved.start, value), end=max(moved.end, value), value=value)
        for widget, direction in zip(self.directions, settings.direction, strict=True):
            widget.value = direction or 0

    def _start_again(self) -> None:
        """Go back to the numbers of the file, without a past."""
        self.move_to(self.exploration.start)
        self.forget()

    def forget(self) -> None:
        """Begin the past again with a pull from rest to what is set."""
        self.moves = ()
        self.change()

    def change(self) -> None:
        """Solve for the present positions of the sliders."""
        numbers = {name: float(each.value) for name, each in self.sliders.items()}
        directions = tuple(widget.value or None for widget in self.directions)
        tensions = self.exploration.controls[: self.exploration.manipulator.num_tendons]
        moved = [i for i, each in enumerate(tensions) if numbers[each.name] != self.settings.numbers[each.name]]
        self.tendon = moved[0] if moved else self.tendon
        self.settings = Settings(numbers, directions)
        self._mark("computing", True, self.drawn)
        self.moves = after_move(self.moves, self.exploration, self.settings)
        self.threads.pictures.submit(self._guarded, self._draw, self.settings, self.moves, self.tendon)

    def _guarded(self, function: Callable[..., None], settings: Settings, *arguments: object) -> None:
        """Call a function on a thread, unless there are newer settings; show errors on the page."""
        if settings is not self.settings or self.closed:
            return
        try:
            function(settings, *arguments)
        except (InputError, SolveError) as error:
            self._on_page(self._refuse, str(error))
        except Exception as error:
            if self.threads.ended:  # they take no more work
                return
            logging.getLogger(__name__).exception("explorer")
            self._on_page(self._refuse, f"{type(error).__name__}: {error}")

    def _draw(self, settings: Settings, moves: Moves, tendon: int) -> None:
        """Make the picture, and then start on another thread what takes longer."""
        picture = self.exploration.picture(self.exploration.case(settings))
        self._on_page(self._show, settings, picture, tendon)
        if picture.good:
            self.threads.pasts.submit(self._guarded, self._remember, settings, picture, moves, tendon)
            self.threads.comparisons.submit(self._guarded, self._compare, settings, picture, tendon)

    def _compare(self, settings: Settings, picture: Picture, tendon: int) -> None:
        curve = self.exploration.curve(picture.case, tendon)
        rows = self.exploration.in_rows(picture.case.manipulator)
        self._on_page(self.tension.show_curve, curve)
        self._on_page(self._show_points, "rows", rows)
        self._on_page(self._done, settings, ["tension"])

    def _show_points(self, kind: str, tables: Sequence[TableColumns]) -> None:
        """Readings, or what the body shows in their rows."""
        self.tension.show_points(kind, tables)
        self.body.show_points(kind, tables)

    def _remember(self, settings: Settings, picture: Picture, moves: Moves, tendon: int) -> None:
        """Show the path of the tendon that moved last, or why there is none."""
        body, loop = picture.case.manipulator, None
        if not (text := why_no_loop(moves)):
            loop = loop_of(body, moves, tendon, self.exploration.arc_length)
        self._on_page(self._show_loop, settings, loop, loop_html(loop, tendon) if loop else paragraph(text))

    def _show_loop(self, settings: Settings, loop: Loop | None, text: str) -> None:
        shown = loop if loop is not None and loop.shown else None
        self.tension.show_loop(shown)
        self.body.show_loop(shown)
        self.past_text.object = text
        self._done(settings, ["past"])

    def _on_page(self, function: Callable[..., None], *arguments: object) -> None:
        """Call a function on the thread of the page; all its changes are sent together."""
        if not self.closed:
            self.document.add_next_tick_callback(partial(_held, function, *arguments))

    def _show(self, settings: Settings, picture: Picture, tendon: int) -> None:
        if not picture.good:
            self._refuse(picture.message)
            return
        self.picture = picture
        self._mark_stale(on=False)
        self._done(settings, ["body", "numbers", "along"])
        self.body.show(picture)
        self.along.show(picture)
        self.tension.follow(tendon)
        self.tension.show_now(picture)
        self.numbers.object = numbers_html(picture)
        self._say(picture.message)

    def _done(self, settings: Settings, parts: Iterable[str]) -> None:
        """Mark parts as computed, unless there are newer settings."""
        if settings is self.settings:
            self._mark("computing", False, parts)

    def _mark(self, mark: str, on: bool, parts: Iterable[str]) -> None:
        """Mark parts for page.css. A style, because the browser would lay out the whole page for a class."""
        for part in map(self.drawn.__getitem__, parts):
            part.styles = part.styles | {f"--{mark}": "on" if on else "off"}

    def _mark_stale(self, *, on: bool) -> None:
        self._mark("stale", on, self.drawn.keys() - {"past"})  # which is drawn within another part

    def _refuse(self, message: str) -> None:
        """Say what is wrong; the last good picture stays, in grey."""
        self._mark("computing", False, self.drawn)
        self._mark_stale(on=True)
        self._say(message)

    def _say(self, text: str) -> None:
        """What is wrong; "" for nothing."""
        self.notice.object = f'<div role="alert">{paragraph(text)}</div>' if text else ""

    # --- the fit ---------------------------------------------------------------------------------

    def start_fit(self) -> None:
        """Fit on a thread of its own."""
        self.fit_button.loading = True
        self.take_over.visible = False
        self.verdict.object = '<p role="status">Fitting, some seconds ...</p>'
        self.threads.fits.submit(self._fit)

    def _fit(self) -> None:
        from ..reports.fit_report import fit_in_words

        try:
            fitted = self.exploration.fit()
            text = fit_in_words(fitted)
            text += "\nbody: that of the file, wherever the sliders stand"
            if not fitted.success:
                text += f"\nthe fit failed: {fitted.result}"
            self._on_page(self._show_fit, fitted, text)
        except Exception as error:
            if not isinstance(error, InputError):
                logging.getLogger(__name__).exception("explorer")
            self._on_page(self._show_fit, None, str(error))

    def _show_fit(self, fitted: "Fit | None", text: str) -> None:
        self.fitted, self.fit_button.loading = fitted, False
        self.verdict.object = lines_html(text)
        self.take_over.visible = bool(self._identified())

    def _identified(self) -> list[str]:
        """The parameters that the data determine; only these are taken over."""
        if self.fitted is None or not self.fitted.success:
            return []
        return [name for name in self.fitted.names if self.fitted.status[name] == IDENTIFIED]

    def _take_over(self) -> None:
        """Set the sliders, to as many digits as the 95 % intervals tell."""
        fitted, found = self.fitted, dict(self.settings.numbers)
        assert fitted is not None
        for name in self._identified():
            numbers = (fitted.value[name], *fitted.confidence_interval[name])
            found[name] = rounded(*(from_si(number, QUANTITIES[name]) for number in numbers))
        self.move_to(self.settings._replace(numbers=found))


def _held(function: Callable[..., None], *arguments: object) -> None:
    """Call a function, and send all its changes together."""
    with pn.io.hold():
        function(*arguments)
