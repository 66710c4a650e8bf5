"""The figures of the explorer, in Bokeh; new data redraw them."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from bokeh.core.properties import value
from bokeh.models import Arrow, ColumnDataSource, HoverTool, NormalHead, VeeHead
from bokeh.plotting import figure

from ..figures.geometry import Body, drawn, lines_along, straight_body
from ..figures.looks import BLACK, BLUE, CURVES, GREEN, GREY, PALE, PURPLE, VERMILION, Look
from ..measurements.readings import kind_of, of_tendons, tendon_number
from ..measurements.table import Measurements
from ..mechanics.fields import in_the_plane
from ..quantities import QUANTITIES
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from .model import Curve, Picture
from .past import Loop

Plot: TypeAlias = Any  # a Bokeh figure, whose attributes type checkers do not know
Columns: TypeAlias = dict[str, Any]  # of a source: arrays and lists by name
TableColumns: TypeAlias = tuple[Measurements, Mapping[str, np.ndarray]]  # a table, and columns of its rows
Points: TypeAlias = tuple[np.ndarray, np.ndarray, str]  # places, values and one colour

NUM_ARROWS = 11  # along each tendon
LONGEST_ARROW = 0.2  # of the length of the body
DASHES = {"-": [], "--": [6], "-.": [6, 4, 2, 4], ":": [2, 4]}
OF_BODY = ("curvature", "bending", "twist")  # one line, not one for each tendon
ARROW = ("x_start", "y_start", "x_end", "y_end")  # columns of arrows, as Bokeh calls them
MARKS: dict[str, Look] = {  # of readings, and of the model in their rows
    "data": {"size": 6, "fill_color": "white", "legend_label": "data"},
    "rows": {"size": 7, "marker": "x", "legend_label": "model at the data"},
}
PAST: Look = {"line_color": PURPLE, "line_dash": [6, 3], "line_width": 2}
NONE = np.zeros((0, 2))  # points
NOTHING_PULLED: Columns = {name: [0.0] for name in ("base", "pull", "tension", "angle")}


def tendon_look(number: int) -> Look:
    """Colour and dashes of a tendon, counted from 0."""
    style = CURVES[number % len(CURVES)]
    return {"line_color": style["color"], "line_dash": DASHES.get(style["linestyle"], [6, 3])}


def bare_figure(x_label: str, y_label: str, **options: Any) -> Plot:
    look: Look = {"tools": "", "toolbar_location": None, "sizing_mode": "stretch_width", "min_border": 4}
    made: Plot = figure(x_axis_label=x_label, y_axis_label=y_label, **(look | options))
    for axis in (*made.xaxis, *made.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "13px"
        axis.major_label_text_font_size = "12px"
        axis.axis_line_color = axis.major_tick_line_color = GREY
        axis.minor_tick_line_color = None
    made.title.text_font_style, made.title.text_font_size = "normal", "13px"
    made.outline_line_color = None
    made.grid.grid_line_color = PALE
    return made


def look_of_legend(fig: Plot) -> None:
    legend = fig.legend[0]
    legend.location, legend.label_text_font_size = "top_left", "12px"
    legend.background_fill_alpha, legend.border_line_color = 0.7, None
    legend.padding = legend.spacing = 2


class BodyPlot:
    """The body to scale with walls, bore, tendons, force densities and tip loads; the rest shape dotted."""

    over_arc_length = ("tension", "curvature", "normal_force", "friction_force")  # what is drawn beside it
    angles = views = ()

    def __init__(self, manipulator: Manipulator, arc_length: np.ndarray):
        self.figure = bare_figure("X (mm)", "Y (mm)", match_aspect=True, height=450, name="body")
        points = {name: ColumnDataSource(_xy(NONE)) for name in ("midline", "past", "ends", "moment")}
        looks = [tendon_look(i) for i in range(manipulator.num_tendons)]
        self.style: Columns = {"color": [x["line_color"] for x in looks], "dash": [x["line_dash"] for x in looks]}
        tendons = ColumnDataSource(_lines([NONE] * len(looks)) | self.style)
        self.sources = {"walls": ColumnDataSource(_lines([])), "tendons": tendons, **points}
        self._draw_surroundings(manipulator, straight_body(manipulator, arc_length))
        self._draw_body()
        self._draw_forces()
        look_of_legend(self.figure)
        show_named(self.figure, "past", False)

    def _draw_surroundings(self, manipulator: Manipulator, straight: Body) -> None:
        """The rest shape, the clamp, and space for the bend."""
        fig, length, sides = self.figure, straight.midline[-1, 0], {tendon.side for tendon in manipulator.tendons}
        low, high = (-0.6 if -1 in sides else -0.2), (0.75 if 1 in sides else 0.2)
        fig.scatter([-0.06 * length, 1.1 * length], [low * length, high * length], size=0, alpha=0)
        half = straight.outer_radius[0] + 0.06 * length
        bare = {"fill_alpha": 0, "line_alpha": 0, "hatch_pattern": "/", "hatch_color": GREY}
        fig.quad(left=[-0.05 * length], right=[0.0], bottom=[-half], top=[half], **bare)
        fig.line([0.0, 0.0], [-half, half], color=BLACK, line_width=1.5)
        fig.line(*straight.outline.T, color=GREY, line_dash="dotted", legend_label="at rest")

    def _draw_body(self) -> None:
        fig, source = self.figure, self.sources
        fig.patches("xs", "ys", source=source["walls"], fill_color=PALE, line_color=GREY)
        fig.line("x", "y", source=source["midline"], color=GREY, line_dash="dashdot")
        fig.line("x", "y", source=source["past"], name="past", legend_label="with its past", **PAST)
        look = {"line_color": "color", "line_dash": "dash", "line_width": 1.5, "legend_label": "tendon"}
        fig.multi_line("xs", "ys", source=source["tendons"], **look)
        fig.scatter("x", "y", source=source["ends"], color=BLACK, size=6)

    def _draw_forces(self) -> None:
        for name, color in (("normal", GREEN), ("friction", VERMILION)):
            self._arrows(name, NormalHead(size=7, fill_color=color, line_color=color), 2)
            self.figure.line([np.nan], [np.nan], color=color, line_width=2, legend_label=f"{name} force per length")
        for name in ("force", "turn"):
            self._arrows(name, VeeHead(size=12, fill_color=PURPLE, line_color=PURPLE), 3)
        self.figure.line("x", "y", source=self.sources["moment"], color=PURPLE, line_width=3)

    def _arrows(self, name: str, head: NormalHead | VeeHead, width: float) -> None:
        source = self.sources[name] = ColumnDataSource(_arrow_data(NONE, NONE))
        look: Look = {"line_width": width, "line_color": head.line_color}
        self.figure.add_layout(Arrow(end=head, source=source, **look))

    def show(self, picture: Picture) -> None:
        """Draw an equilibrium."""
        along, sources = in_the_plane(picture.along, "BodyPlot"), self.sources
        what = drawn(picture.case.manipulator, along, picture.case.loads)
        sources["walls"].data = _lines(what.body.walls)
        sources["midline"].data = _xy(what.body.midline)
        sources["tendons"].data = self.style | _lines(what.tendons)
        sources["ends"].data = _xy(what.anchors)
        greatest = float(np.max(np.linalg.norm([along.normal_force, along.friction_force], axis=-1)))  # N/m
        size, points = LONGEST_ARROW * what.length / max(greatest, 1e-12), what.tendons.shape[1]
        at = np.linspace(0.02 * points, 0.98 * points - 1, NUM_ARROWS).astype(int)
        starts = what.tendons[:, at, :2]
        there = np.isfinite(starts[..., 0])
        for name, force in (("normal", along.normal_force), ("friction", along.friction_force)):
            sources[name].data = _arrow_data(starts[there], (starts + size * np.asarray(force)[:, at])[there])
        self.figure.title.text = f"longest arrow {greatest:.4g} N/m"
        # the sliders load the tip only: there is one arrow of each or none
        force, turn = (next(iter(arrows), NONE)[:, :2] for arrows in (what.force_arrows, what.moment_arrows))
        sources["force"].data = _arrow_data(force[:1], force[-1:])
        sources["moment"].data = _xy(turn)
        sources["turn"].data = _arrow_data(turn[-2:-1], turn[-1:])

    def show_points(self, kind: str, tables: Sequence[TableColumns]) -> None:
        """Measured positions are drawn in space only."""

    def show_loop(self, loop: Loop | None) -> None:
        """The axis of the body with its past; None for nothing."""
        if loop is not None:
            self.sources["past"].data = _xy(1e3 * loop.position)
        show_named(self.figure, "past", loop is not None)


def _xy(points: np.ndarray) -> Columns:
    return {"x": points[:, 0], "y": points[:, 1]}


def _lines(lines: Sequence[np.ndarray] | np.ndarray) -> Columns:
    return {"xs": [line[:, 0] for line in lines], "ys": [line[:, 1] for line in lines]}


def _arrow_data(starts: np.ndarray, ends: np.ndarray) -> Columns:
    return dict(zip(ARROW, (*starts.T, *ends.T), strict=True))


def show_named(fig: Plot, name: str, there: bool) -> None:
    """Show or hide a named glyph and its entry in the legend."""
    (drawn,) = (renderer for renderer in fig.renderers if renderer.name == name)
    drawn.visible = there
    for item in fig.legend[0].items:
        if drawn in item.renderers:
            item.visible = there


class AlongPlots:
    """Tension, curvature and the forces per length over the arc length."""

    def __init__(self, names: Sequence[str], num_tendons: int, arc_length: np.ndarray):
        at_rest: Columns = {f"{name}_{i}": 0 * arc_length for name in names for i in range(num_tendons)}
        self.figures, self.source = {}, ColumnDataSource({"s": 1e3 * arc_length} | at_rest)
        ends = {"x_range": (0, 1e3 * arc_length[-1])}
        for name in names:
            label = f"{QUANTITIES[name].label} ({QUANTITIES[name].shown[1]})"
            fig = self.figures[name] = bare_figure("Arc length (mm)", label, height=210, name=name, **ends)
            fig.xaxis.ticker.desired_num_ticks = 4
            if name not in ("curvature", "twist"):
                fig.y_range.start = 0
            for i in range(1 if name in OF_BODY else num_tendons):
                look = {"line_color": BLACK} if name in OF_BODY else tendon_look(i)
                fig.line("s", f"{name}_{i}", source=self.source, line_width=2, **look)
            fig.add_tools(HoverTool(mode="vline", tooltips=[("s", "@s{0.0} mm"), (label, "$y{0.000}")]))

    def show(self, picture: Picture) -> None:
        data: Columns = {"s": 1e3 * picture.along.arc_length}
        for name in self.figures:
            lines = lines_along(picture.case.manipulator, picture.along, name)
            data |= {f"{name}_{i}": line for i, line in enumerate(lines)}
        self.source.data = data


class TensionPlots:
    """Tip tension and tip angle over base tension or displacement: model, present state, data, the model in their rows.

    Tip tensions are drawn over what set the same tendon; the angle and the model belong to the tendon whose tension
    moved last.
    """

    def __init__(self, num_tendons: int, over: str = "base_tension"):
        """`over`: the kind of column that set the tendons."""
        self.columns = of_tendons(over, num_tendons)
        self.of_model = {"displacement": "tendon_displacement"}.get(over, over)  # its name in what is computed
        self.label, (self.scale, self.unit) = QUANTITIES[over].label, QUANTITIES[over].shown
        self.looks = [tendon_look(i)["line_color"] if num_tendons > 1 else BLACK for i in range(num_tendons)]
        self.tendon = 0  # whose tension moved last
        self.curve = ColumnDataSource(NOTHING_PULLED)
        labels = {"tension": "Tip tension (N)", "angle": "Tip angle (deg)"}
        self.points = {
            name: {kind: ColumnDataSource(_points(())) for kind in ("data", "rows", "now", "past", "loop")}
            for name in labels
        }
        self.shown: dict[str, Sequence[TableColumns]] = {"data": (), "rows": ()}
        self.figures = {
            name: bare_figure(f"{self.label} ({self.unit})", y, height=255, name=f"tip_{name}")
            for name, y in labels.items()
        }
        words = "without loss" if over == "base_tension" else "base tension"
        free = {"color": GREY, "line_dash": "dotted", "legend_label": words}
        self.figures["tension"].line("base", "pull", source=self.curve, **free)
        for name in labels:
            self._draw(self.figures[name], name)
        self._name_tendon()

    def _draw(self, fig: Plot, name: str) -> None:
        points = self.points[name]
        fig.line("base", name, source=self.curve, line_width=2, color=BLUE, legend_label="model", name="model")
        fig.line("base", "value", source=points["loop"], name="loop", legend_label="with its past", **PAST)
        marks = {
            **{kind: look | {"line_color": "color"} for kind, look in MARKS.items()},
            "now": {"size": 12, "marker": "diamond", "color": VERMILION, "legend_label": "now"},
            "past": {"size": 9, "marker": "circle", "color": PURPLE, "legend_label": "with its past"},
        }
        for kind, look in marks.items():
            fig.scatter("base", "value", source=points[kind], name=kind, **look)
        look_of_legend(fig)
        for kind in ("data", "rows", "loop", "past"):
            show_named(fig, kind, False)

    def follow(self, tendon: int) -> None:
        """Draw over the tension of a tendon, which counts from 0, what belongs to that which moved last."""
        if tendon == self.tendon:
            return
        self.tendon, self.curve.data = tendon, NOTHING_PULLED
        self._name_tendon()
        for kind, tables in self.shown.items():
            self.show_points(kind, tables)

    def _name_tendon(self) -> None:
        if len(self.looks) == 1:
            return
        self.figures["angle"].xaxis.axis_label = f"{self.label} of tendon {self.tendon + 1} ({self.unit})"
        for fig in self.figures.values():
            (item,) = (item for item in fig.legend[0].items if item.renderers[0].name == "model")
            item.label = value(f"model for tendon {self.tendon + 1}")

    def show_points(self, kind: str, tables: Sequence[TableColumns]) -> None:
        """Columns of tables over what set the tendons: readings for "data", the model in their rows for "rows"."""
        self.shown[kind] = tables
        found: dict[str, list[Points]] = {name: [] for name in self.points}
        for table, columns in tables:
            for column, values in columns.items():
                tip, of_tendon = kind_of(column), tendon_number(column) - 1
                over = self.columns[of_tendon if tip == "tip_tension" else self.tendon]
                if over not in table:
                    continue
                if tip == "tip_tension":
                    found["tension"].append((self.scale * table[over], values, self.looks[of_tendon]))
                elif tip == "tip_angle":
                    found["angle"].append((self.scale * table[over], np.degrees(values), BLACK))
        for name, parts in found.items():
            self.points[name][kind].data = _points(parts)
            show_named(self.figures[name], kind, bool(parts))

    def _base(self, found: Loop | Equilibrium | Curve) -> np.ndarray:
        """What is drawn over, as it is shown."""
        return self.scale * np.asarray(getattr(found, self.of_model))

    def show_loop(self, loop: Loop | None) -> None:
        """The loop of the tension, and the present state with its past; None for nothing."""
        if loop is not None:
            for name, values in (("tension", loop.tip_tension), ("angle", np.degrees(loop.tip_angle))):
                base = self._base(loop)
                self.points[name]["loop"].data = _points([(base, values, PURPLE)])
                self.points[name]["past"].data = _points([(base[-1:], values[-1:], BLACK)])
        for fig in self.figures.values():
            for kind in ("loop", "past"):
                show_named(fig, kind, loop is not None)

    def show_now(self, picture: Picture) -> None:
        """The present state, as the sliders are set."""
        found, i = picture.equilibrium, self.tendon
        base = self._base(found)
        self.points["tension"]["now"].data = _points([(base, np.asarray(found.tip_tension), BLACK)])
        self.points["angle"]["now"].data = _points([(base[i : i + 1], np.degrees([found.tip_angle]), BLACK)])

    def show_curve(self, curve: Curve) -> None:
        """The model over the whole range of the tension that moved last."""
        if curve.tendon != self.tendon:
            return  # another one has moved meanwhile
        angle = np.degrees(curve.tip_angle)
        own = {"pull": curve.base_tension, "tension": curve.tip_tension, "angle": angle}
        self.curve.data = Columns(base=self._base(curve), **own)
        rises = not angle[-1] < angle[0]
        self.figures["angle"].legend[0].location = "top_left" if rises else "top_right"  # beside the curve


def _points(parts: Sequence[Points]) -> Columns:
    """The data of a source from places, values and one colour for each part."""
    base, value = (np.concatenate([np.zeros(0), *(part[i] for part in parts)]) for i in range(2))
    return {"base": base, "value": value, "color": [color for x, _, color in parts for _ in x]}
