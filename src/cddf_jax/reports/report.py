"""The one form of an answer: words, numbers for JSON, and the files that go with them."""

import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from .. import figures
from ..files.writing import as_json, write_all
from ..progress import each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content: TypeAlias = "str | Figure"


class Report(NamedTuple):
    """The answer of a command.

    Attributes:
        name: of the file with the answer, without .json.
        text: for people.
        answer: for JSON, in SI units.
        files: makes what else is written to a folder, by name: text, or a figure, which becomes a PDF and a PNG. It is
            called only then, since drawing takes long.
        failure: why the work failed, in one line; empty where it succeeded.
    """

    name: str
    text: str
    answer: dict[str, object]
    files: Callable[[], Mapping[str, Content]]
    failure: str = ""

    def write(self, folder: str | Path) -> None:
        """Write all files, or none."""
        made, files = self.files(), {f"{self.name}.json": as_json(self.answer)}
        for name in each("file", list(made)):
            what = made[name]
            files |= {name: what} if isinstance(what, str) else figures.render(what, name)
        write_all(folder, files)


def versions(*more: str) -> dict[str, str]:
    """The versions with which something was computed, also of `more` packages."""
    names = ("cddf-jax", "jax", "jaxlib", "numpy", "scipy", "optimistix", "equinox", *more)
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
