"""`cddf explore`: a local page on which a body is bent by sliders, compared with data and fitted. Panel and Bokeh."""

import asyncio
import webbrowser
from collections.abc import Sequence
from typing import Any

import panel as pn
from panel.io.server import get_server
from tornado.websocket import WebSocketClosedError

from ..errors import InputError
from ..files.manipulator_file import RobotFile
from ..measurements.table import Measurements
from ..robot.manipulator import Manipulator, conical
from .model import Exploration
from .parts import STYLES, column
from .view import ExplorerView, Threads
from .words import paragraph

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


def page_of(exploration: Exploration, source: str, threads: Threads) -> pn.Column:
    """One browser's page: a head that names manipulator and data, a line for what is wrong, and the view."""
    view = ExplorerView(exploration, threads)
    parts = view.parts
    for name, part in parts.items():
        part.css_classes = [*part.css_classes, name]  # it may have a class already
    data = ", ".join(table.name for table in exploration.tables) or "no data"
    lines = [f"{source}; {data}", *exploration.notes]
    text = f"<h1>{TITLE}</h1>{''.join(map(paragraph, lines))}"
    head = pn.pane.HTML(text, stylesheets=STYLES, margin=(0, 8))
    return column(head, view.notice, column(*parts.values(), css_classes=["places"]), css_classes=["whole"])


def tell_unless_closed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """What goes wrong in the loop is told, but for a message to a page that was closed while it was computed."""
    if not isinstance(context.get("exception"), WebSocketClosedError):
        loop.default_exception_handler(context)


def serve(robot: RobotFile, tables: Sequence[Measurements], source: str, *, port: int, browser: bool) -> None:
    """Serve the page on this machine alone until Ctrl-C; its address is printed once it is ready.

    Args:
        robot: the body and its gravity.
        tables: measurements on it.
        source: the origin of the robot, in words for the page.
        port: 0 for a free one.
        browser: whether to open it.

    Raises:
        InputError: for a table or a gravity that does not fit the manipulator, or a port that is not available.
    """
    exploration = Exploration(robot.manipulator, tuple(tables), robot.gravity, robot.offsets_outside_wall)
    pn.extension(respect_explicit_sizing=True)
    with Threads() as threads:
        try:
            made = {"port": port, "address": ADDRESS, "title": TITLE}
            server = get_server(lambda: page_of(exploration, source, threads), **made)
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}; give another, or leave it out for a free one") from None
        url = f"http://localhost:{server.port}/"
        print(f"{url}  (Ctrl-C ends it)", flush=True)
        if browser:
            server.io_loop.add_callback(webbrowser.open, url)
        server.io_loop.add_callback(lambda: asyncio.get_running_loop().set_exception_handler(tell_unless_closed))
        server.start()
        server.io_loop.start()  # Panel ends it on Ctrl-C
