"""A function evaluated by one kept program; else JAX would compile a program for every operation."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .kept import kept_program


def evaluated(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function of the library or of a callable pytree, such as a profile, with NumPy arrays.

    Numbers among the arguments must be arrays, as every Python number makes another program.
    """
    return jax.tree.map(np.asarray, _called(function, *arguments))


@kept_program
@eqx.filter_jit
def _called(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)
