"""The two kinds of error that a user meets: bad input, and a solve that failed."""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from types import ModuleType


def in_utf8(text: object) -> str:
    r"""A text or path with characters that UTF-8 has. Other bytes, which file names may hold, are shown as "\xff"."""
    return str(text).encode("utf-8", sys.getfilesystemencodeerrors()).decode("utf-8", "backslashreplace")


class InputError(ValueError):
    """Input of a user or in a file cannot be used. The message is one line: "where: what; remedy"."""

    def __init__(self, what: str, *, where: str = "", remedy: str = ""):
        place = f"{where}: " if where else ""
        super().__init__(in_utf8(f"{place}{what}; {remedy}" if remedy else f"{place}{what}"))


Kind = type[Exception] | tuple[type[Exception], ...]


@contextmanager
def within(place: str | os.PathLike[str], kind: Kind = InputError) -> Iterator[None]:
    """Errors in the block name the place in which they arose, such as a file.

    Args:
        place: put before the places that an error has already.
        kind: of errors, one or several; `ValueError` if the block calls code that raises no `InputError`.

    Raises:
        InputError: for any error of that kind.
    """
    try:
        yield
    except kind as error:
        raise InputError(str(error), where=str(place)) from None


def known_names(name: str, known: Iterable[str]) -> str:
    """The remedy for an unknown name: the known one that is like it, or else all of them."""
    known = tuple(known)
    close = get_close_matches(name, known, 1)
    return f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"


class SolveError(RuntimeError):
    """A solve failed; the message is that of its status."""


def needed(package: str, extra: str = "sweep") -> ModuleType:
    """A package that belongs to an extra.

    Raises:
        InputError: if it is missing; the message says how to install it.
    """
    try:
        return __import__(package)
    except ImportError:
        raise InputError(f"this needs {package}; install it with: pip install 'cddf-jax[{extra}]'") from None
