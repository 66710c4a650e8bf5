"""The parameters of a fit: their names, bounds, priors, and the change of variable that the optimiser sees."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..errors import InputError
from ..numerics.given_numbers import check_numbers

Numbers = np.ndarray | Array
Bounds = Mapping[str, tuple[float | None, float | None]]  # by parameter, (lower, upper), None for no bound
TINY = 1e-300  # keeps a divisor from being 0
FREE, BELOW, BETWEEN = (False, False), (True, False), (True, True)  # bounded below, above
FLIPPED = 0.25  # of further starts: share in which a parameter without bounds has the other sign


class Prior(NamedTuple):
    """A Gaussian prior."""

    mean: float | Numbers
    standard_deviation: float | Numbers


Priors = Mapping[str, Prior | tuple[float, float]]  # by parameter


def names_of(start: PyTree) -> tuple[str, ...]:
    """One name per number: the key of a mapping, with an index where the value is an array."""
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(start)[0]:
        name = jax.tree_util.keystr(path, simple=True, separator=".") or ("" if np.ndim(leaf) else "parameter")
        indices = np.ndindex(np.shape(leaf))
        names += [name + "".join(f"[{i}]" for i in index) for index in indices]
    return tuple(names)


def _known(kind: str, names: tuple[str, ...], given: Collection[str]) -> None:
    for name in given:
        if name not in names:
            raise InputError(f"{kind} for {name!r}, which is not fitted; fitted are {', '.join(names)}")


def bounds_of(names: tuple[str, ...], start: np.ndarray, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds in the order of the names; infinite without a bound."""
    _known("bounds", names, bounds)
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for i, name in enumerate(names):
        low, high = bounds.get(name, (None, None))
        check_numbers(f"bounds for {name}", [low, high])
        lower[i], upper[i] = -np.inf if low is None else low, np.inf if high is None else high
        if not lower[i] < start[i] < upper[i]:
            raise InputError(
                f"{name} starts at {start[i]:g}, which is not inside its bounds {lower[i]:g} to {upper[i]:g}; "
                "move the start or the bounds"
            )
    return lower, upper


def priors_of(names: tuple[str, ...], priors: Priors) -> dict[int, Prior]:
    """The priors, by the number of their parameter."""
    _known("prior", names, priors)
    found = {}
    for name, prior in priors.items():
        check_numbers(f"prior for {name}", prior)
        if isinstance(prior, str) or np.shape(np.asarray(prior)) != (2,):
            raise InputError(f"prior for {name}: needs (mean, standard deviation), SI units, got {prior!r}")
        mean, deviation = prior
        if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
            raise InputError(f"prior for {name}: needs a mean and a standard deviation > 0, got {mean}, {deviation}")
        found[names.index(name)] = Prior(np.float64(mean), np.float64(deviation))
    return dict(sorted(found.items()))  # as JAX orders them


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ParameterSpace:
    """The change of variable from dimensionless, unbounded z to the parameters.

    The optimiser sees the logarithm of the distance from a bound, the logit between two bounds, and else a scaled
    value.
    """

    names: tuple[str, ...] = field(metadata={"static": True})
    start: Float[Numbers, " n"]
    lower: Float[Numbers, " n"]
    upper: Float[Numbers, " n"]
    scale: Float[Numbers, " n"]
    least_size: Float[Numbers, " n"]
    bounded: tuple[tuple[bool, bool], ...] = field(metadata={"static": True})  # below, above

    def size(self, value: Float[Numbers, " n"]) -> Float[Numbers, " n"]:
        """The size of each parameter: its value, or if that is smaller the scale that was given."""
        xp = value.__array_namespace__()
        return xp.maximum(xp.where(value == 0, self.scale, xp.abs(value)), self.least_size)

    def first(self) -> Float[np.ndarray, " n"]:
        """The z of the start."""
        return np.array([self.inverse(i, self.start[i]) for i in range(len(self.names))])

    def _bound(self, i: int) -> float | Numbers:
        """The bound of a parameter with one bound."""
        return self.lower[i] if self.bounded[i] == BELOW else self.upper[i]

    def inverse(self, i: int, value: ArrayLike) -> np.ndarray:
        """The z_i of values of parameter i inside its bounds."""
        value, start = np.asarray(value), self.start[i]
        if self.bounded[i] == FREE:
            return np.asarray((value - start) / self.scale[i])
        if self.bounded[i] == BETWEEN:
            return np.asarray(np.log((value - self.lower[i]) / (self.upper[i] - value)))
        return np.asarray(np.log((value - self._bound(i)) / (start - self._bound(i))))

    def parameters(self, z: Float[Numbers, " n"]) -> Float[Array, " n"]:
        """The parameters at z, inside their bounds."""

        def one(i, bounded):
            if bounded == FREE:
                return self.start[i] + self.scale[i] * z[i]
            if bounded == BETWEEN:
                return self.lower[i] + (self.upper[i] - self.lower[i]) * jax.nn.sigmoid(z[i])
            return self._bound(i) + (self.start[i] - self._bound(i)) * jnp.exp(z[i])

        return jnp.stack([one(i, bounded) for i, bounded in enumerate(self.bounded)])

    def elsewhere(self, draw: np.ndarray, decades: float) -> np.ndarray:
        """The z of another start.

        A parameter with a bound changes its distance from the bound by up to `decades` powers of ten. A parameter
        without bounds changes its size by as much, and in one draw of four its sign. `draw`, (n,), is uniform on (0,
        1).
        """
        same = draw >= FLIPPED
        size = np.where(same, (draw - FLIPPED) / (1 - FLIPPED), draw / FLIPPED)
        sign = np.where(same, 1.0, -1.0) * np.where(self.start < 0, -1.0, 1.0)
        moved = sign * self.size(self.start) * 10 ** (decades * (2 * size - 1))
        bounded = self.first() + np.log(10) * decades * (2 * draw - 1)
        return np.where([one == FREE for one in self.bounded], (moved - self.start) / self.scale, bounded)

    def times_the_start(self, value: np.ndarray) -> np.ndarray:
        """A parameter over its start, both counted from a bound; without bounds the larger of ratio and inverse."""
        size = self.size(self.start)

        def one(i, bounded):
            if bounded == FREE:
                times = np.abs(value[i]) / size[i]
                return times if self.start[i] == 0 else max(times, 1 / max(times, TINY))
            return 1.0 if bounded == BETWEEN else (value[i] - self._bound(i)) / (self.start[i] - self._bound(i))

        return np.array([one(i, bounded) for i, bounded in enumerate(self.bounded)])

    def at_bound(self, value: np.ndarray) -> np.ndarray:
        """Whether the optimiser pushed a parameter against a bound."""
        below = value - self.lower < 1e-5 * (self.start - self.lower)
        above = self.upper - value < 1e-5 * (self.upper - self.start)
        return (np.isfinite(self.lower) & below) | (np.isfinite(self.upper) & above)


def parameter_space(
    names: tuple[str, ...], start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray | None = None
) -> ParameterSpace:
    """The space of some parameters; infinite bounds are none.

    `scale`, (n,), are sizes that matter for parameters that may be 0; NaN: the size of the start (1 if it is 0).
    """
    given = np.full(np.shape(start), np.nan) if scale is None else scale
    known = np.isfinite(given)
    own = np.where(start == 0, 1.0, np.abs(start))
    bounded = tuple(zip((lower > -np.inf).tolist(), (upper < np.inf).tolist(), strict=True))
    return ParameterSpace(names, start, lower, upper, np.where(known, given, own), np.where(known, given, 0.0), bounded)
