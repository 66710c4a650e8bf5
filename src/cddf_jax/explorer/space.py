"""The body in space on the page: a view that is turned by dragging or by sliders, and three plane views."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Pan, PanStart
from bokeh.models import ColumnDataSource, CustomJS, Slider

from ..figures.geometry import AZIMUTH, ELEVATION, Drawn, drawn
from ..figures.looks import BLACK, GREY, PALE, PURPLE, Look
from ..measurements.markers import marker_column
from ..robot.manipulator import Manipulator
from ..units import round_number
from .model import Picture
from .past import Loop
from .plots import MARKS, PAST, Columns, Plot, TableColumns, bare_figure, look_of_legend, show_named, tendon_look

DRAW, TURN = (Path(__file__).with_name(f"{name}.js").read_text(encoding="utf-8") for name in ("space", "turn"))
# by plane: azimuth and elevation, deg, from where it is seen, and the coordinates to the right and up
PLANES = {"XY": (-90.0, 90.0, [0, 1]), "XZ": (-90.0, 0.0, [0, 2]), "YZ": (0.0, 0.0, [1, 2])}
LINES, POINTS = ("xs", "ys", "color", "dash", "width"), ("x", "y", "text", "color")
# the sources that space.js fills, with their columns: for every view, and for the view that can be turned
BODY = {
    **dict.fromkeys(("tube", "cap"), ("xs", "ys")),
    **dict.fromkeys(("under", "hidden", "over"), LINES),
    **{"ends": ("x", "y"), "heads": ("x", "y", "angle")},
}
SCENE = {
    **{"shadow": ("xs", "ys"), "floor": LINES, "names": POINTS},
    **{"data": ("x", "y"), "rows": ("x", "y")},
}
AHEAD, ASIDE, BELOW = 1.0, 0.5, 0.35  # of the length: how far the floor reaches from the base, and how low it is
REACH, WIDE = 0.62, 0.8  # of the length: what is always visible around the middle of the body, vertically and sideways
TIP = ("tip_x", "tip_y", "tip_z")
LEAST_EXTENT = np.array([[0.0, -0.35, -0.35], [1.0, 0.35, 0.35]])  # of the length, in plane views
HIDDEN = 0.35  # of the strength of a line
WALL = "#DDDDDD"
RINGS_APART = 4  # arc lengths


class Row(NamedTuple):
    """A line or a point of a picture, mm, as space.js takes it."""

    kind: str
    points: np.ndarray  # (points, 3)
    color: str = GREY
    dash: tuple[int, ...] = ()
    width: float = 1.0
    text: str = ""


def columns_of_rows(rows: Iterable[Row]) -> Columns:
    """The data of a source."""
    kind, points, color, dash, width, text = map(list, zip(*rows, strict=True))
    flat = [np.asarray(each, float).ravel() for each in points]
    return {"kind": kind, "points": flat, "color": color, "dash": list(map(list, dash)), "width": width, "text": text}


class SpacePlot:
    """The body to scale with its tendons and tip loads. The browser draws it, and turns it by itself."""

    over_arc_length = ("tension", "bending", "twist", "normal_force", "friction_force")  # what is drawn beside it

    def __init__(self, manipulator: Manipulator):
        self.length = 1e3 * float(manipulator.length)
        square = round_number(self.length / 4)
        self.floor = floor_rows(self.length, square)
        within: Look = {"margin": 0, "styles": {"padding": "4px 12px", "box-sizing": "border-box"}}
        self.angles = azimuth, elevation = [
            Slider(title=f"Seen from: {name} (deg)", start=-end, end=end, step=1, value=value, **within)
            for name, value, end in (("azimuth", AZIMUTH, 180), ("elevation", ELEVATION, 90))
        ]
        self.space = ColumnDataSource(columns_of_rows([Row("none", np.zeros((0, 3)))]))
        self.figure = bare_figure("", "", match_aspect=True, height=450, name="body")
        self.figure.axis.visible = self.figure.grid.visible = False
        self.figure.title.text = f"drag to turn; squares of {square:g} mm"
        self.now: list[Row] = []  # of the picture
        self.past: list[Row] = []  # the axis with its past
        self.places: dict[str, list[Row]] = {"data": [], "rows": []}
        self.extents: list[ColumnDataSource] = []  # of each figure, two corners that set its scale
        self.middle = (0.5 * self.length, 0.0, -0.1 * self.length)
        seen = self._sees(self.figure, BODY | SCENE, azimuth, elevation, self.middle)
        self.figure.patches("xs", "ys", source=seen["shadow"], fill_color=PALE, line_color=PALE)
        self.figure.multi_line("xs", "ys", source=seen["floor"], line_color="color", line_width="width")
        _draw_body(self.figure, seen, 12)
        words: Look = {"text": "text", "text_color": "color", "text_font_size": "12px"}
        self.figure.text("x", "y", source=seen["names"], text_align="center", text_baseline="middle", **words)
        for kind in self.places:
            self.figure.scatter("x", "y", source=seen[kind], name=kind, line_color=BLACK, **MARKS[kind])
            show_named(self.figure, kind, False)
        self._draw_legend()
        self.views: list[Plot] = []
        for plane, (around, up, _) in PLANES.items():
            x, y = (f"{axis} (mm)" for axis in plane)
            view = bare_figure(x, y, match_aspect=True, height=210, name=f"view_{plane}")
            _draw_body(view, self._sees(view, BODY, around, up, (0.0, 0.0, 0.0)), 10)
            self.views.append(view)
        turn = CustomJS(args={"azimuth": azimuth, "elevation": elevation}, code=TURN)
        for event in (PanStart, Pan):
            self.figure.js_on_event(event, turn)

    def _sees(
        self, fig: Plot, what: Mapping[str, Sequence[str]], azimuth: Any, elevation: Any, center: tuple[float, ...]
    ) -> dict[str, ColumnDataSource]:
        """The sources of a figure with its direction of view; the browser updates them."""
        seen = {name: ColumnDataSource({column: [] for column in columns}) for name, columns in what.items()}
        given = {"space": self.space, "azimuth": azimuth, "elevation": elevation, "center": list(center)}
        redraw = CustomJS(args={**given, **seen}, code=DRAW)
        self.space.js_on_change("data", redraw)
        for angle in (azimuth, elevation):
            if isinstance(angle, Slider):
                angle.js_on_change("value", redraw)
        extent = ColumnDataSource({"x": [0.0], "y": [0.0]})
        fig.x_range.renderers = fig.y_range.renderers = [fig.scatter("x", "y", source=extent, size=0, alpha=0)]
        self.extents.append(extent)
        return seen

    def _draw_legend(self) -> None:
        """The legend, with entries for what is drawn without one."""
        tendon = tendon_look(0) | {"line_width": 2}
        looks = {"straight": {"line_color": GREY, "line_dash": "dotted"}, "tendon": tendon}
        looks |= {"hidden": tendon | {"line_alpha": HIDDEN}, "with its past": PAST}
        for words, look in looks.items():
            self.figure.line([np.nan], [np.nan], legend_label=words, **look)
        legend = self.figure.legend[0]
        look_of_legend(self.figure)
        legend.orientation, legend.ncols, legend.spacing, legend.margin = "horizontal", len(looks), 12, 0
        self.figure.add_layout(legend, "above")

    def show(self, picture: Picture) -> None:
        """Draw an equilibrium."""
        what = drawn(picture.case.manipulator, picture.along, picture.case.loads)
        points = np.concatenate([what.points, self.length * LEAST_EXTENT])
        reach = max(REACH * self.length, float(np.max(np.linalg.norm(what.points - self.middle, axis=1))))
        wide = max(WIDE * self.length, reach)
        places = [np.array([[-wide, -reach], [wide, reach]]), *(points[:, plane] for _, _, plane in PLANES.values())]
        for extent, place in zip(self.extents, places, strict=True):
            low, high = place.min(axis=0), place.max(axis=0)
            extent.data = {"x": [low[0], high[0]], "y": [low[1], high[1]]}
        self.now = [*body_rows(what), *tendon_rows(what), *load_rows(what)]
        self._send()

    def show_loop(self, loop: Loop | None) -> None:
        """The axis of the body with its past; None for nothing."""
        past = [] if loop is None else [Row("past", 1e3 * loop.position, PURPLE, (6, 3), 2.0)]
        if past or self.past:
            self.past = past
            self._send()

    def show_points(self, kind: str, tables: Sequence[TableColumns]) -> None:
        """Positions of the tip and of markers with three coordinates: the readings for "data", the model for "rows"."""
        told = [Row(kind, place) for _, columns in tables for place in places_told(columns)]
        if told or self.places[kind]:
            self.places[kind] = told
            show_named(self.figure, kind, bool(told))
            self._send()

    def _send(self) -> None:
        """Send everything at once to the browser, as soon as there is a picture."""
        if self.now:
            places = (*self.places["data"], *self.places["rows"])
            self.space.data = columns_of_rows([*self.floor, *self.now, *self.past, *places])


def places_told(columns: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Of the tip and of each marker, (rows, 3), mm, where a table tells all three coordinates."""
    markers = dict.fromkeys(marker[1] for column in columns if (marker := marker_column(column)))
    every = [TIP, *(tuple(f"{axis}@{marker}" for axis in "xyz") for marker in markers)]
    told = [names for names in every if all(name in columns for name in names)]
    return [1e3 * np.stack([columns[name] for name in names], axis=1) for names in told]


def _draw_body(fig: Plot, seen: dict[str, ColumnDataSource], size: int) -> None:
    """The tube with its tendons, and the tip loads, from back to front; `size` of arrow heads in pixels."""
    line: Look = {"line_color": "color", "line_dash": "dash", "line_width": "width"}
    fig.multi_line("xs", "ys", source=seen["under"], **line)
    fig.patches("xs", "ys", source=seen["tube"], fill_color=GREY, line_color=GREY, line_width=2)
    fig.patches("xs", "ys", source=seen["tube"], fill_color=WALL, line_color=WALL, line_width=0.5)
    fig.patches("xs", "ys", source=seen["cap"], fill_color="white", line_color=GREY)
    fig.multi_line("xs", "ys", source=seen["hidden"], line_alpha=HIDDEN, **line)
    fig.multi_line("xs", "ys", source=seen["over"], **line)
    fig.scatter("x", "y", source=seen["ends"], color=BLACK, size=size / 2)
    fig.scatter("x", "y", source=seen["heads"], angle="angle", marker="triangle", color=PURPLE, size=size)


# --- rows of a picture -----------------------------------------------------------------------------


def body_rows(what: Drawn) -> list[Row]:
    """The body, its plate, and the straight body."""
    body, straight = what.body, what.straight
    return [
        *(Row("ring", ring) for ring in body.rings[_some(straight.midline[:, 0]), :-1]),
        Row("axis", body.midline),
        Row("radius", np.outer(body.outer_radius, [1.0, 0.0, 0.0])),
        Row("ahead", body.frame[-1, :, 0]),
        Row("plate", what.plate_edge, BLACK),
        *(Row("rest", line, dash=(2, 4)) for line in (straight.midline, straight.rings[-1])),
    ]


def _some(arc_length: np.ndarray) -> np.ndarray:
    """Which arc lengths have a ring: some of the grid, and both sides of each joint."""
    close = np.diff(arc_length) < 1e-6 * arc_length[-1]
    found = np.arange(arc_length.size) % RINGS_APART == 0
    found[-1] = True
    return found | np.append(close, False) | np.append(False, close)


def tendon_rows(what: Drawn) -> list[Row]:
    """Each tendon, its anchor, and its number beside the plate if there are several."""
    rows = []
    for i, (path, anchor) in enumerate(zip(what.tendons, what.anchors, strict=True)):
        look, beside = tendon_look(i), path[0] / np.linalg.norm(path[0])
        rows.append(Row("tendon", path, look["line_color"], tuple(look["line_dash"]), 2.0))
        rows.append(Row("end", anchor))
        if len(what.tendons) > 1:
            rows.append(Row("name", (what.plate + 0.04 * what.length) * beside, BLACK, text=str(i + 1)))
    return rows


def load_rows(what: Drawn) -> list[Row]:
    """The lines of the arrows of force and moment; the heads point along the last piece."""
    return [Row("load", line, PURPLE, width=3.0) for line in (*what.force_arrows, *what.moment_arrows)]


def floor_rows(length: float, square: float) -> list[Row]:
    """Squares below a straight body along X, and the names of the axes along two edges, all mm."""
    ahead, aside, below = (square * np.ceil(part * length / square) for part in (AHEAD, ASIDE, BELOW))
    x, y = np.arange(0.0, ahead + 0.5 * square, square), np.arange(-aside, aside + 0.5 * square, square)
    beside = 0.06 * length
    return [
        Row("floor", np.array([0.0, 0.0, -below])),
        *(Row("grid", np.array([[at, -aside, -below], [at, aside, -below]]), PALE) for at in x),
        *(Row("grid", np.array([[0.0, at, -below], [ahead, at, -below]]), PALE) for at in y),
        Row("name", np.array([ahead + beside, 0.0, -below]), text="X"),
        Row("name", np.array([0.0, aside + beside, -below]), text="Y"),
    ]
