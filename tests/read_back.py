"""What matplotlib has drawn, as arrays and texts."""

import numpy as np


def xy_of(line) -> np.ndarray:
    """Of shape (2, points)."""
    return np.asarray(line.get_data())


def x_of(line) -> np.ndarray:
    return xy_of(line)[0]


def y_of(line) -> np.ndarray:
    return xy_of(line)[1]


def legend_of(what) -> list[str]:
    """The texts in the legend of axes, or in all those of a figure."""
    legends = getattr(what, "legends", None) or [what.get_legend()]
    return [text.get_text() for legend in legends for text in legend.get_texts()]
