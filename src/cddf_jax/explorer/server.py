"""`cddf explore`: a local page on which a body is bent by sliders, compared with data and fitted. Panel and Bokeh."""

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import panel as pn
from panel.io.server import get_server

from ..errors import InputError
from ..files.manipulator_file import RobotFile, read_robot_file
from ..measurements.table import Measurements
from ..measurements.trials import read_tables
from ..progress import stage
from ..robot.manipulator import Manipulator, conical
from .model import Exploration
from .parts import STYLES, column
from .view import ExplorerView, Threads

T = TypeVar("T")

ADDRESS = "127.0.0.1"  # this machine alone
TITLE = "cddf explorer"
PAPER = "the manipulator of Liu et al. (2020), as no file was given"  # the source that the page names


def papers_manipulator() -> Manipulator:
    """The body of Liu et al. (2020), section IV, one tendon parallel to the axis, exact kinematics."""
    return conical(
        length=0.140,
        outer_radius=(0.020, 0.013),
        inner_radius=0.007,
        tendon_offset=0.010,
        youngs_modulus=1.4e6,
        friction_coefficient=0.42,
    )


@dataclass(frozen=True)
class PageContent:
    """The content of a page when it is opened, and after a file was loaded."""

    exploration: Exploration
    source: str  # of the manipulator, in words
    threads: Threads


class Page:
    """One browser's page: files are loaded here, and the view of a manipulator is renewed with each."""

    def __init__(self, content: PageContent):
        self.content = content
        self.notice = pn.pane.HTML("", stylesheets=STYLES, sizing_mode="stretch_width", css_classes=["notice"])
        self.head = pn.pane.HTML("", stylesheets=STYLES, margin=(0, 8))
        self.robot_file = pn.widgets.FileInput(accept=".toml", name="Manipulator (TOML)", width=175, margin=(0, 4))
        self.data_files = pn.widgets.FileInput(
            accept=".csv,.tsv,.txt,.lvm,.xlsx", name="Data (CSV or .xlsx, one or several)", multiple=True, width=185
        )
        self.robot_file.param.watch(lambda _: self._load(self._read_robot), "value")
        self.data_files.param.watch(lambda _: self._load(self._read_data), "value")
        self.view: ExplorerView | None = None
        self.place = column(css_classes=["places"])
        self._renew()

    @property
    def layout(self) -> pn.Column:
        """The whole page."""
        head = pn.FlexBox(self.head, self.robot_file, self.data_files, align_items="center", gap="4px 12px")
        return column(head, self.notice, self.place, css_classes=["whole"])

    def say(self, text: str) -> None:
        """One line at the head of the page that says what is wrong, or none."""
        self.notice.object = f'<p role="alert">{_escaped(text)}</p>' if text else ""

    def _renew(self) -> None:
        if self.view is not None:
            self.view.close()
        self.view = ExplorerView(self.content.exploration, self.say, self.content.threads)
        parts = self.view.parts
        for name, part in parts.items():
            part.css_classes = [*part.css_classes, name]  # it may have a class already
        self.place[:] = list(parts.values())
        tables = self.content.exploration.tables
        data = ", ".join(table.name for table in tables) or "no data loaded"
        notes = [f"<p>{_escaped(line)}</p>" for line in self.content.exploration.notes]
        self.head.object = f"<h1>{TITLE}</h1><p>{_escaped(self.content.source)}; {_escaped(data)}</p>{''.join(notes)}"

    def _load(self, read: Callable[[], PageContent]) -> None:
        """Read a file that was chosen; a bad one leaves everything as it was."""
        try:
            self.content = read()
        except InputError as error:
            self.say(str(error))
            return
        self.say("")
        self._renew()

    def _read_robot(self) -> PageContent:
        """A manipulator without a table of cross-sections: a file from a browser has no files beside it."""
        name = str(self.robot_file.filename)
        read = _read(lambda paths: read_robot_file(paths[0]), {name: self.robot_file.value})
        exploration = replace(self.content.exploration, manipulator=read.manipulator, gravity=read.gravity)
        return replace(self.content, exploration=exploration, source=name)

    def _read_data(self) -> PageContent:
        files = zip(map(str, self.data_files.filename), self.data_files.value, strict=True)
        exploration = replace(self.content.exploration, tables=_read(read_tables, dict(files)))
        return replace(self.content, exploration=exploration)


def _escaped(text: str) -> str:
    return escape(" ".join(text.split()))


def _read(reader: Callable[[list[Path]], T], files: Mapping[str, bytes]) -> T:
    """What `reader` reads from files that the browser sent; messages name files without their folder."""
    with TemporaryDirectory() as folder:
        paths = [Path(folder) / Path(name).name for name in files]
        for path, content in zip(paths, files.values(), strict=True):
            path.write_bytes(content)
        try:
            return reader(paths)
        except InputError as error:
            raise error.at(
                *(Path(place).name if place.startswith(folder) else place for place in error.where)
            ) from None


def serve(
    robot: RobotFile,
    tables: Sequence[Measurements],
    source: str,
    *,
    port: int = 0,
    browser: bool = True,
    say: Callable[[str], None] = print,
) -> None:
    """Serve the page on this machine alone until Ctrl-C.

    Args:
        robot: the body and its gravity.
        tables: measurements on it.
        source: the origin of the robot, in words for the page.
        port: 0 for a free one.
        browser: whether to open it.
        say: called with a line that has the address, once the page is ready.

    Raises:
        InputError: for a table or a gravity that does not fit the manipulator, or a port that is not available.
    """
    exploration = Exploration(robot.manipulator, tuple(tables), robot.gravity)
    pn.extension(respect_explicit_sizing=True)
    with Threads() as threads:
        with stage("preparing the page"):
            content = PageContent(exploration, source, threads)
        try:
            server = get_server(lambda: Page(content).layout, port=port, address=ADDRESS, title=TITLE)
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}; give another, or leave it out for a free one") from None
        url = f"http://localhost:{server.port}/"
        say(f"{url}  (Ctrl-C ends it)")
        if browser:
            server.io_loop.add_callback(webbrowser.open, url)
        server.start()
        server.io_loop.start()  # Panel ends it on Ctrl-C
