"""The parameters of a fit: their names, bounds, priors, and the change of variable that the optimiser sees."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .errors import InputError


class Prior(NamedTuple):
    """A Gaussian prior."""

    mean: Any
    standard_deviation: Any


def names_of(start: Any) -> tuple[str, ...]:
    """One name per number: the key of a mapping, with an index where the value is an array."""
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(start)[0]:
        name = jax.tree_util.keystr(path, simple=True, separator=".") or ("" if np.ndim(leaf) else "parameter")
        indices = np.ndindex(np.shape(leaf))
        names += [name + "".join(f"[{i}]" for i in index) for index in indices]
    return tuple(names)


def _known(kind: str, names: tuple[str, ...], given: Mapping[str, Any]) -> None:
    for name in given:
        if name not in names:
            raise InputError(f"{kind} for {name!r}, which is not fitted; fitted are {', '.join(names)}")


def bounds_of(names: tuple[str, ...], start: np.ndarray, bounds: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    _known("bounds", names, bounds)
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for i, name in enumerate(names):
        low, high = bounds.get(name, (None, None))
        lower[i], upper[i] = -np.inf if low is None else low, np.inf if high is None else high
        if not lower[i] < start[i] < upper[i]:
            raise InputError(
                f"{name} starts at {start[i]:g}, which is not inside its bounds {lower[i]:g} to {upper[i]:g}; "
                "move the start or the bounds"
            )
    return lower, upper


def priors_of(names: tuple[str, ...], priors: Mapping[str, tuple[float, float]]) -> dict[int, Prior]:
    _known("prior", names, priors)
    for name, (mean, deviation) in priors.items():
        if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
            raise InputError(f"prior for {name}: needs a mean and a standard deviation > 0, got {mean}, {deviation}")
    return {names.index(name): Prior(*map(np.float64, prior)) for name, prior in priors.items()}


class Space(eqx.Module):
    """The change of variable from dimensionless, unbounded z to the parameters."""

    start: Float[np.ndarray | Array, " n"]
    lower: Float[np.ndarray | Array, " n"]
    upper: Float[np.ndarray | Array, " n"]
    kinds: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, start: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self.start, self.lower, self.upper = start, lower, upper
        finite = zip(np.isfinite(lower), np.isfinite(upper), strict=True)
        self.kinds = tuple(("free", "below", "above", "between")[2 * int(a) + int(b)] for a, b in finite)

    def size(self, value: np.ndarray) -> np.ndarray:
        """What to measure each parameter by: its value, its start or 1, the first that is not 0."""
        start = np.abs(np.asarray(self.start))
        return np.where(value == 0, np.where(start == 0, 1.0, start), np.abs(value))

    def first(self) -> Float[Array, " n"]:
        def inverse(kind, start, lower, upper):
            return jnp.log((start - lower) / (upper - start)) if kind == "between" else 0.0

        return jnp.asarray(
            [inverse(*args) for args in zip(self.kinds, self.start, self.lower, self.upper, strict=True)]
        )

    def parameters(self, z: Float[Array, " n"]) -> Float[Array, " n"]:
        def one(i, kind):
            if kind == "free":
                return self.start[i] + jnp.where(self.start[i] == 0, 1.0, jnp.abs(self.start[i])) * z[i]
            if kind == "above":  # bounded below
                return self.lower[i] + (self.start[i] - self.lower[i]) * jnp.exp(z[i])
            if kind == "below":  # bounded above
                return self.upper[i] - (self.upper[i] - self.start[i]) * jnp.exp(z[i])
            return self.lower[i] + (self.upper[i] - self.lower[i]) * jax.nn.sigmoid(z[i])

        return jnp.stack([one(i, kind) for i, kind in enumerate(self.kinds)])

    def at_bound(self, value: np.ndarray) -> np.ndarray:
        """Whether the optimiser pushed a parameter against a bound."""
        start = np.asarray(self.start)
        below = value - self.lower < 1e-5 * (start - self.lower)
        above = self.upper - value < 1e-5 * (self.upper - start)
        return (np.isfinite(self.lower) & below) | (np.isfinite(self.upper) & above)
