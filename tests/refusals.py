"""What is refused, and in how many lines it is said."""

from collections.abc import Callable
from typing import Any

import pytest

from cddf_jax.errors import InputError

Errors = type[Exception] | tuple[type[Exception], ...]


def refused(call: Callable[..., Any], *arguments: Any, error: Errors = InputError, **options: Any) -> str:
    """What is said when a call is refused: one line."""
    with pytest.raises(error) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
