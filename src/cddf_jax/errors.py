"""The error for bad input, and for a package that is not there."""

from typing import Any


class InputError(ValueError):
    """What a person typed or a file holds cannot be used; the message is one line with the remedy."""


def needed(package: str, extra: str = "sweep") -> Any:
    """A package that only an extra brings.

    Raises:
        InputError: says how to get it.
    """
    try:
        return __import__(package)
    except ImportError:
        raise InputError(f"this needs {package}; install it with: pip install 'cddf-jax[{extra}]'") from None
