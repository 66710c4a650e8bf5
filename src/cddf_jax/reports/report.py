"""The one form of an answer: words, numbers for JSON, and the files that go with them."""

import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from ..files.writing import write_all
from ..progress import each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Files: TypeAlias = dict[str, str | bytes]  # content by name


class Report(NamedTuple):
    """The answer of a command.

    Attributes:
        text: for people.
        answer: for JSON, in SI units.
        files: makes what is written to a folder; it is called only then, since drawing takes long.
        failure: why the work failed, in one line; empty where it succeeded.
    """

    text: str
    answer: dict[str, object]
    files: Callable[[], Files]
    failure: str = ""

    def write(self, folder: str | Path) -> None:
        """Write all files, or none."""
        write_all(folder, self.files())


def rendered(figures: "Mapping[str, Figure]") -> Files:
    """Figures as PDF and PNG, by the name of each without its suffix."""
    from ..figures.style import render

    files: Files = {}
    for name in each("figure", list(figures)):
        files |= render(figures[name], name)
    return files


def versions(*more: str) -> dict[str, str]:
    """The versions with which something was computed, also of `more` packages."""
    names = ("cddf-jax", "jax", "jaxlib", "numpy", "scipy", "optimistix", "equinox", *more)
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
