"""The parameters of a fit: their names, bounds, priors, and the change of variable that the optimiser sees."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .errors import InputError

FLIPPED = 0.25  # of further starts: share in which a parameter without bounds has the other sign


class Prior(NamedTuple):
    """A Gaussian prior."""

    mean: Any
    standard_deviation: Any


class Uniform(NamedTuple):
    """A uniform prior: bounds by another name."""

    low: float
    high: float


class Layout(NamedTuple):
    """Which numbers of the parameters are fitted, and how all of them follow from these."""

    names: tuple[str, ...]  # of those that are fitted
    start: np.ndarray
    unravel: Callable[[Array], Any]  # from the fitted numbers to the structure of the parameters


def lay_out_parameters(start: Any, fixed: Collection[str], shared: Mapping[str, str]) -> Layout:
    """Leave out what is fixed at its start, and what is to equal another parameter.

    Args:
        start: a pytree of numbers or arrays.
        fixed: names that keep their start; the name of an array stands for all of its numbers.
        shared: by name, the name of the parameter that it shares the value of.

    Raises:
        InputError: for names that are none, nothing left to fit, or a chain of shared parameters.
    """
    flat, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), start))
    every = names_of(start)

    def known(name, kind):
        if name not in every:
            raise InputError(f"{kind}: there is no parameter {name!r}; there are {', '.join(every)}")
        return every.index(name)

    held = {i for i, name in enumerate(every) if name in fixed or name.partition("[")[0] in fixed}
    for name in fixed:
        if name not in every and not any(other.startswith(f"{name}[") for other in every):
            known(name, "fixed")
    source = {known(name, "shared"): known(other, "shared") for name, other in shared.items()}
    for i, j in source.items():
        if j in source or i in held:
            raise InputError(f"shared: {every[i]} cannot follow {every[j]}; name one parameter that is neither itself")
    fitted = [i for i in range(len(every)) if i not in held and i not in source]
    if not fitted:
        raise InputError("there is no parameter to fit")
    if len(fitted) == len(every):
        return Layout(every, np.asarray(flat), unravel)
    numbers = tuple(flat.tolist())
    source_of = tuple(source.get(i, i) for i in range(len(every)))
    put = _Put(unravel, numbers, tuple(fitted.index(j) if j in fitted else None for j in source_of), source_of)
    return Layout(tuple(every[i] for i in fitted), np.asarray(flat)[fitted], put)


@dataclass(frozen=True)
class _Put:
    """All parameters from those that are fitted; equal to another that does the same, so that jit knows it again."""

    unravel: Callable[[Array], Any]
    start: tuple[float, ...]
    fitted: tuple[int | None, ...]  # by parameter, which of those that are fitted it takes the value of
    source: tuple[int, ...]  # by parameter, which parameter's start it keeps otherwise

    def __call__(self, values: Array) -> Any:
        numbers = [self.start[j] if k is None else values[k] for k, j in zip(self.fitted, self.source, strict=True)]
        return self.unravel(jnp.stack([jnp.asarray(x, values.dtype) for x in numbers]))


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


def priors_of(names: tuple[str, ...], priors: Mapping[str, Any]) -> dict[int, Prior]:
    """The Gaussian ones; `with_uniform_priors` has taken the others for bounds."""
    _known("prior", names, priors)
    gaussian = {name: prior for name, prior in priors.items() if not isinstance(prior, Uniform)}
    for name, prior in gaussian.items():
        if isinstance(prior, str) or np.shape(prior) != (2,):
            raise InputError(f"prior for {name}: needs (mean, standard deviation), SI, or Uniform, got {prior!r}")
        mean, deviation = prior
        if not (np.isfinite(mean) and np.isfinite(deviation) and deviation > 0):
            raise InputError(f"prior for {name}: needs a mean and a standard deviation > 0, got {mean}, {deviation}")
    found = {names.index(name): Prior(*map(np.float64, prior)) for name, prior in gaussian.items()}
    return dict(sorted(found.items()))  # as JAX orders them


def with_uniform_priors(bounds: Mapping[str, Any], priors: Mapping[str, Any]) -> dict[str, Any]:
    """The bounds, narrowed by the uniform priors."""
    narrowed = dict(bounds)
    for name, prior in priors.items():
        if isinstance(prior, Uniform):
            if not prior.low < prior.high:
                raise InputError(
                    f"prior for {name}: {prior.low:g} to {prior.high:g} is no range; write the lower first"
                )
            low, high = narrowed.get(name, (None, None))
            narrowed[name] = (
                prior.low if low is None else max(prior.low, low),
                prior.high if high is None else min(prior.high, high),
            )
    return narrowed


class Space(eqx.Module):
    """The change of variable from dimensionless, unbounded z to the parameters."""

    start: Float[np.ndarray | Array, " n"]
    lower: Float[np.ndarray | Array, " n"]
    upper: Float[np.ndarray | Array, " n"]
    scale: Float[np.ndarray | Array, " n"]
    least_size: Float[np.ndarray | Array, " n"]
    kinds: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray | None = None):
        """What is positive is seen as its logarithm; `scale` measures what may well be 0, its start or 1 if not given.

        Args:
            start, lower, upper: (n,), infinite where there is no bound.
            scale: (n,), NaN where it is not known.
        """
        self.start, self.lower, self.upper = start, lower, upper
        own = np.where(start == 0, 1.0, np.abs(start))
        given = np.full(np.shape(start), np.nan) if scale is None else scale
        self.scale = np.where(np.isfinite(given), given, own)
        self.least_size = np.where(np.isfinite(given), given, 0.0)
        finite = zip(np.isfinite(lower), np.isfinite(upper), strict=True)
        self.kinds = tuple(("free", "below", "above", "between")[2 * int(a) + int(b)] for a, b in finite)

    @property
    def num_parameters(self) -> int:
        return len(self.kinds)

    def size(self, value: np.ndarray) -> np.ndarray:
        """What to measure each parameter by: its value, or where that is smaller the scale that was given."""
        return np.maximum(np.where(value == 0, np.asarray(self.scale), np.abs(value)), np.asarray(self.least_size))

    def first(self) -> Float[np.ndarray, " n"]:
        return np.array([self.inverse(i, self.start[i]) for i in range(self.num_parameters)])

    def inverse(self, i: int, value: Any) -> Any:
        """The z_i of values of parameter i inside its bounds."""
        start, lower, upper = self.start[i], self.lower[i], self.upper[i]
        match self.kinds[i]:
            case "free":
                return (value - start) / self.scale[i]
            case "above":
                return np.log((value - lower) / (start - lower))
            case "below":
                return np.log((upper - value) / (upper - start))
            case _:
                return np.log((value - lower) / (upper - value))

    def parameters(self, z: Float[Array, " n"]) -> Float[Array, " n"]:
        def one(i, kind):
            if kind == "free":
                return self.start[i] + self.scale[i] * z[i]
            if kind == "above":  # bounded below
                return self.lower[i] + (self.start[i] - self.lower[i]) * jnp.exp(z[i])
            if kind == "below":  # bounded above
                return self.upper[i] - (self.upper[i] - self.start[i]) * jnp.exp(z[i])
            return self.lower[i] + (self.upper[i] - self.lower[i]) * jax.nn.sigmoid(z[i])

        return jnp.stack([one(i, kind) for i, kind in enumerate(self.kinds)])

    @property
    def free(self) -> np.ndarray:
        """Which parameters have no bounds."""
        return np.array([kind == "free" for kind in self.kinds])

    def elsewhere(self, draw: np.ndarray, decades: float) -> "tuple[Space, np.ndarray]":
        """Another start: a space about it, in which a search feels as though it were the given one, and its z.

        What has a bound moves by up to so many powers of ten of its distance from it. Of what has none the size does,
        and in one draw of four the sign changes.

        Args:
            draw: (n,), of the uniform distribution over (0, 1).
            decades: how many powers of ten up and down.
        """
        same = draw >= FLIPPED
        size = np.where(same, (draw - FLIPPED) / (1 - FLIPPED), draw / FLIPPED)
        sign = np.where(same, 1.0, -1.0) * np.where(self.start < 0, -1.0, 1.0)
        start = np.where(
            self.free, sign * self.size(np.asarray(self.start)) * 10 ** (decades * (2 * size - 1)), self.start
        )
        given = np.where(self.least_size > 0, self.least_size, np.nan)
        z = self.first() + np.where(self.free, 0.0, np.log(10) * decades * (2 * draw - 1))
        return Space(start, np.asarray(self.lower), np.asarray(self.upper), given), z

    def seen_from(self, other: "Space", z: np.ndarray) -> np.ndarray:
        """The z here of what is z in a space that differs by the start of what has no bounds."""
        return np.where(self.free, (other.start + other.scale * z - self.start) / self.scale, z)

    def times_the_start(self, value: np.ndarray) -> np.ndarray:
        """How many times its start a parameter has grown to, from its bound on; without bounds, shrunk to as well."""
        size = self.size(np.asarray(self.start))

        def one(i, kind):
            start, lower, upper = self.start[i], self.lower[i], self.upper[i]
            if kind == "free":
                times = np.abs(value[i]) / size[i]
                return times if start == 0 else max(times, 1 / max(times, 1e-300))
            if kind == "between":
                return 1.0
            return (value[i] - lower) / (start - lower) if kind == "above" else (upper - value[i]) / (upper - start)

        return np.array([one(i, kind) for i, kind in enumerate(self.kinds)])

    def at_bound(self, value: np.ndarray) -> np.ndarray:
        """Whether the optimiser pushed a parameter against a bound."""
        start = np.asarray(self.start)
        below = value - self.lower < 1e-5 * (start - self.lower)
        above = self.upper - value < 1e-5 * (self.upper - start)
        return (np.isfinite(self.lower) & below) | (np.isfinite(self.upper) & above)
