"""Colours, dashes and markers of figures and of the explorer. No Matplotlib.

The colours are those of Okabe and Ito, safe for colour-blind readers. They always come with a line style or a marker of
their own, so that a grey print can be read.
"""

from typing import Any, TypeAlias

LookValue: TypeAlias = Any  # one property of what is drawn, for Matplotlib or Bokeh: a colour, a width, a marker
Look: TypeAlias = dict[str, LookValue]

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    *("#000000", "#E69F00", "#56B4E9", "#009E73"),
    *("#F0E442", "#0072B2", "#D55E00", "#CC79A7"),
)
GREY, PALE = "#7F7F7F", "#E8E8E8"
# one style per curve: a colour, a dash pattern and a marker that belong together
CURVES: tuple[Look, ...] = tuple(
    {"color": color, "linestyle": dashes, "marker": marker}
    for color, dashes, marker in (
        (BLUE, "-", "o"),
        (VERMILION, "--", "s"),
        (GREEN, "-.", "^"),
        (PURPLE, ":", "D"),
        (ORANGE, (0, (5, 1, 1, 1, 1, 1)), "v"),
        (BLACK, (0, (6, 2)), "x"),
    )
)
