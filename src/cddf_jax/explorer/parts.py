"""The parts of the page: rows and columns, sliders, texts, headings, all in its style."""

from pathlib import Path
from typing import TypeAlias

import panel as pn
from bokeh.models import Slider
from bokeh.plotting import figure as BokehFigure  # noqa: N812  # a class, in spite of its name

from .controls import Control

STYLES = [Path(__file__).with_name("page.css").read_text(encoding="utf-8")]  # of every part of the page

Part: TypeAlias = pn.viewable.Viewable


def grid(*parts: Part, least: int) -> pn.Column:
    """Parts side by side, if each then has `least` pixels or more; else below each other."""
    return column(*parts, css_classes=["side-by-side"], styles={"--least": f"{least}px"})


def column(*parts: Part, **look: list[str] | dict[str, str]) -> pn.Column:
    """Parts below each other, as wide as the page."""
    return pn.Column(*parts, sizing_mode="stretch_width", margin=0, stylesheets=STYLES, **look)


def words(name: str) -> pn.pane.HTML:
    """An empty part for text, with its class in page.css."""
    classes = ["words", name]
    return pn.pane.HTML("", stylesheets=STYLES, sizing_mode="stretch_width", margin=(4, 8), css_classes=classes)


def plot(figure: BokehFigure | Slider) -> pn.pane.Bokeh:
    """A figure, or a slider that the browser handles alone, as wide as its place."""
    return pn.pane.Bokeh(figure, sizing_mode="stretch_width", margin=0)


def slider(control: Control) -> pn.widgets.EditableFloatSlider:
    """A slider with a field beside it, into which any number may be typed."""
    made = pn.widgets.EditableFloatSlider(
        name=f"{control.label} ({control.quantity.shown[1]})".removesuffix(" ()"),
        value=control.value,
        start=control.low,
        end=control.high,
        step=control.step,
        fixed_start=control.least,
        sizing_mode="stretch_width",
        format="0[.][0000000000]",
        margin=(4, 12),
    )
    for field in made.select(pn.widgets.FloatInput):  # a label of its own, for those who do not see the slider's
        field.name, field.stylesheets = made.name, [*field.stylesheets, *STYLES]
        field.css_classes = [*field.css_classes, "unseen"]
    return made


def title(text: str) -> pn.pane.HTML:
    """The heading of a part of the page."""
    return pn.pane.HTML(f"<h2>{text}</h2>", stylesheets=STYLES, margin=(0, 8))
