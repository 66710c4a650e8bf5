"""The optimiser with limits on published problems: Hock and Schittkowski (1981), with their multipliers.

Values: "HS n" is problem n of W. Hock, K. Schittkowski, Test Examples for Nonlinear Programming Codes (1981). Multipliers
follow from the conditions of Karush, Kuhn and Tucker at the published points, written beside them.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cddf_jax.constrained import TOLERANCE, Point, Relaxed, least_violation, minimise, optimality

PRINTED = 1e-6  # the book prints seven to nine digits
MULTIPLIERS = 1e-5  # at points right to about 1e-8, of Lagrangians stationary to TOLERANCE
NONE = np.zeros(0)


class Written:
    """A problem in plain formulas, its derivatives by JAX; `answers` is false where it has none."""

    def __init__(
        self,
        objective: Callable,
        inequality: Callable = lambda x: x[:0],
        equality: Callable = lambda x: x[:0],
        answers: Callable = lambda x: True,
    ):
        parts = [lambda x: jnp.asarray(objective(x)), *(lambda x, f=f: jnp.stack([*f(x), *x[:0]]) if len(f(x)) else x[:0] for f in (inequality, equality))]
        self.answers = answers
        self._values = jax.jit(lambda x: [part(x) for part in parts])
        self._slopes = jax.jit(lambda x: [jax.jacfwd(part)(x) for part in parts])

        def weighted(x, weights):
            return weights[0] * parts[0](x) + weights[1] @ parts[1](x) + weights[2] @ parts[2](x)

        def product(x, weights, along):
            return jax.jvp(lambda x: jax.grad(weighted)(x, weights), (x,), (along,))[1]

        self._product = jax.jit(product)

    def __call__(self, x: np.ndarray) -> Point:
        if not self.answers(x):
            return Point(x, *[np.nan] * 6, usable=False)
        (f, g, h), (df, dg, dh) = jax.tree.map(np.asarray, (self._values(x), self._slopes(x)))
        return Point(np.array(x), float(f), df, g, dg, h, dh)

    def curvature(self, x, weights, along):
        return np.asarray(self._product(x, (float(weights[0]), *map(np.asarray, weights[1:])), along))
