"""Quantities that vary along the arc length: constant, linear, piecewise, spline.

A profile is any pytree that is callable on arc lengths s (m), element by element. Its numbers may be traced,
differentiated and vmapped over. A profile with kinks or jumps lists their arc lengths in `breakpoints`, so that the
solver ends its elements there.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics.given_numbers import check_numbers
from ..units import Dimension, shown

Number = Array | np.ndarray
Scalar = Float[Number, ""]
Points = Float[ArrayLike, "*points"]
Profile = Callable[[Points], Array]
ProfileLike = ArrayLike | Callable[[Points], ArrayLike]  # of which a profile is made: a number or a function
FEW = 64  # points among which comparing is faster than searching


def as_number(value: object) -> Number:
    """An array of JAX, or one of such numbers; every other number as a NumPy float64 array.

    Raises:
        InputError: for numbers that are not plain, such as those with a unit.
    """
    check_numbers("", value)
    parts = value if isinstance(value, list | tuple) else [value]
    traced = any(isinstance(part, jax.Array) for part in parts)
    return _real(jnp.asarray(value)) if traced else np.asarray(value, dtype=np.float64)


def _real(value: Array) -> Array:
    """The same numbers; whole ones as floating-point numbers."""
    return value if jnp.issubdtype(value.dtype, jnp.inexact) else value.astype(float)


def as_optional_number(value: object) -> Any:
    """As `as_number`; None stays None."""
    return None if value is None else as_number(value)


def as_profile(value: ProfileLike) -> Profile:
    """A profile from a number or a function; a callable pytree is returned as it is."""
    if not callable(value):
        return Constant(value)
    return Function(value) if jax.tree_util.all_leaves([value]) else cast(Profile, value)


class Function(eqx.Module):
    """A plain function of the arc length as a profile; JAX sees no numbers in it."""

    function: Callable[[Points], ArrayLike] = eqx.field(static=True)

    def __call__(self, arc_length: Points) -> Array:
        return _real(jnp.asarray(self.function(arc_length)))

    @property
    def breakpoints(self) -> Float[Number, " n"]:
        return breakpoints(self.function)


class Constant(eqx.Module):
    """The same value along the whole length."""

    value: Scalar = eqx.field(converter=as_number)

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        return jnp.broadcast_to(jnp.asarray(self.value), jnp.shape(arc_length))


class Linear(eqx.Module):
    """A straight taper from `base` at s = 0 to `tip` at s = `length`."""

    base: Scalar = eqx.field(converter=as_number)
    tip: Scalar = eqx.field(converter=as_number)
    length: Scalar = eqx.field(converter=as_number)

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        return jnp.asarray(self.base) + (self.tip - self.base) * (jnp.asarray(arc_length) / self.length)


class Piecewise(eqx.Module):
    """Profiles joined end to end: `pieces[i]` holds up to `ends[i]`, the last one to the tip.

    Args:
        ends: arc lengths (m) at which one piece gives way to the next, increasing,
            one fewer than there are pieces. At such an arc length the next piece holds.
        pieces: profiles or numbers, each a function of the arc length counted from the base of the body.

    Raises:
        ValueError: when the number of ends does not fit the number of pieces, or they do not increase.
    """

    ends: Float[Number, " joints"] = eqx.field(converter=as_number)
    pieces: tuple[Profile, ...]

    def __init__(self, ends: ArrayLike | Sequence[ArrayLike], pieces: Sequence[ProfileLike]):
        self.ends = as_number(ends)
        self.pieces = tuple(map(as_profile, pieces))
        if np.ndim(self.ends) != 1 or len(self.pieces) != np.shape(self.ends)[0] + 1:
            raise ValueError(
                f"Piecewise: {len(self.pieces)} pieces need {len(self.pieces) - 1} ends in one list, "
                f"got ends of shape {np.shape(self.ends)}"
            )
        _check_increase("Piecewise: ends", self.ends)

    @staticmethod
    def linear(arc_length: ArrayLike | Sequence[ArrayLike], values: ArrayLike | Sequence[ArrayLike]) -> "Polyline":
        """Straight lines through the points (`arc_length`, `values`), the first at s = 0."""
        return Polyline(arc_length, values)

    @property
    def breakpoints(self) -> Float[Array, " n"]:
        return jnp.concatenate([jnp.asarray(self.ends), *(breakpoints(piece) for piece in self.pieces)])

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        index = _count_up_to(jnp.asarray(self.ends), jnp.asarray(arc_length))
        values = jnp.stack([piece(arc_length) for piece in self.pieces], axis=-1)
        return jnp.take_along_axis(values, index[..., None], axis=-1)[..., 0]


def _check_points(name: str, arc_length: Number, values: Number, least: int, remedy: str = "") -> None:
    """Refuse points that are not two lists of the same length, in order."""
    own, other = np.shape(arc_length), np.shape(values)
    if own != other or len(own) != 1 or own[0] < least:
        demand = f"{name}: arc_length and values must be two lists of one length, {least} or more"
        raise ValueError(f"{demand}, got shapes {own} and {other}{remedy}")
    _check_increase(f"{name}: arc_length", arc_length)


def _check_increase(what: str, places: Number) -> None:
    """Refuse arc lengths that are known and do not increase."""
    if isinstance(places, np.ndarray) and not np.all(np.diff(places) > 0):
        raise ValueError(f"{what} must increase, got {places.tolist()} m; sort them")


class Polyline(eqx.Module):
    """Straight lines from point to point, what `Piecewise.linear` makes; the outer ones go on beyond the ends.

    Args:
        arc_length: of the points (m), increasing, two or more.
        values: the profile there.

    Raises:
        ValueError: for fewer than two points, lists of different length, or arc lengths that do not increase.
    """

    arc_length: Float[Number, " knots"] = eqx.field(converter=as_number)
    values: Float[Number, " knots"] = eqx.field(converter=as_number)

    def __check_init__(self):
        _check_points("Piecewise.linear", self.arc_length, self.values, least=2)

    @property
    def breakpoints(self) -> Float[Array, " inner"]:
        return jnp.asarray(self.arc_length)[1:-1]

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        arc_length, knots, values = jnp.asarray(arc_length), jnp.asarray(self.arc_length), jnp.asarray(self.values)
        i = _count_up_to(knots[1:-1], arc_length)
        along = (arc_length - knots[i]) / (knots[i + 1] - knots[i])
        return values[i] + along * (values[i + 1] - values[i])


def _count_up_to(places: Float[Array, " n"], arc_length: Float[Array, "*points"]) -> Array:
    """How many of some increasing places lie at or before each arc length."""
    if places.shape[0] > FEW:
        return jnp.searchsorted(places, arc_length, side="right")
    return jnp.sum(arc_length[..., None] >= places, axis=-1)


class Spline(eqx.Module):
    """The cubic spline through (`arc_length`, `values`), twice continuously differentiable.

    The ends are "not-a-knot": a cubic polynomial is met exactly. Outside the knots the end
    polynomials go on.

    Args:
        arc_length: knots (m), increasing, four or more.
        values: the profile at the knots.

    Raises:
        ValueError: for fewer than four knots, lists of different length, or knots that do not increase.
    """

    arc_length: Float[Number, " knots"] = eqx.field(converter=as_number)
    values: Float[Number, " knots"] = eqx.field(converter=as_number)

    def __check_init__(self):
        remedy = "; for fewer points use Linear or Piecewise.linear"
        _check_points("Spline", self.arc_length, self.values, least=4, remedy=remedy)

    @classmethod
    def through(cls, profile: Profile, arc_length: ArrayLike | Sequence[ArrayLike]) -> "Spline":
        """The spline that meets another profile at some arc lengths, m: the start of a free-form design."""
        knots = as_number(arc_length)
        return cls(knots, as_number(np.asarray(profile(knots))))

    @property
    def breakpoints(self) -> Float[Array, " inner"]:
        """The knots where the third derivative jumps: all but the two at either end."""
        return jnp.asarray(self.arc_length)[2:-2]

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        arc_length, knots, values = jnp.asarray(arc_length), jnp.asarray(self.arc_length), jnp.asarray(self.values)
        bend = _second_derivatives(knots, values)
        i = jnp.clip(jnp.searchsorted(knots, arc_length, side="right") - 1, 0, knots.shape[0] - 2)
        width = knots[i + 1] - knots[i]
        right = (arc_length - knots[i]) / width
        left = 1.0 - right
        chord = left * values[i] + right * values[i + 1]
        return chord + width**2 / 6 * ((left**3 - left) * bend[i] + (right**3 - right) * bend[i + 1])


def _second_derivatives(knots: Float[Array, " n"], values: Float[Array, " n"]) -> Float[Array, " n"]:
    """Second derivatives of the not-a-knot cubic spline at its knots, from the continuity of the first."""
    n = knots.shape[0]
    width, chord = jnp.diff(knots), jnp.diff(values) / jnp.diff(knots)
    inner = jnp.arange(1, n - 1)
    matrix = jnp.zeros((n, n), knots.dtype)
    matrix = matrix.at[inner, inner - 1].set(width[:-1])
    matrix = matrix.at[inner, inner].set(2 * (width[:-1] + width[1:]))
    matrix = matrix.at[inner, inner + 1].set(width[1:])
    # not-a-knot: the third derivative does not jump at the second and the last but one knot
    matrix = matrix.at[0, :3].set(jnp.stack([width[1], -width[0] - width[1], width[0]]))
    matrix = matrix.at[-1, -3:].set(jnp.stack([width[-1], -width[-2] - width[-1], width[-2]]))
    return jnp.linalg.solve(matrix, jnp.zeros_like(values).at[inner].set(6 * jnp.diff(chord)))


class Shifted(eqx.Module):
    """A profile with the same number added everywhere."""

    profile: Profile = eqx.field(converter=as_profile)
    by: Scalar = eqx.field(converter=as_number)

    @property
    def breakpoints(self) -> Float[Number, " n"]:
        return breakpoints(self.profile)

    def __call__(self, arc_length: Points) -> Float[Array, "*points"]:
        return self.profile(arc_length) + self.by


def shifted(profile: Profile, by: ArrayLike) -> Profile:
    """The profile plus a number; a constant profile stays constant."""
    return Constant(profile.value + by) if isinstance(profile, Constant) else Shifted(profile, by)


def breakpoints(profile: ProfileLike) -> Float[Number, " n"]:
    """The arc lengths (m) at which a profile is not smooth; none unless it names some."""
    own = getattr(profile, "breakpoints", None)
    return np.zeros(0) if own is None else jnp.asarray(own)


def profile_in_words(profile: Profile, length: float, kind: Dimension = "length") -> str:
    """What `print` shows of a profile: its values at both ends, its form and its range."""
    if isinstance(profile, Constant):
        return shown(profile.value, kind)
    s = np.linspace(0.0, length, 201)
    values = np.asarray(profile(s))
    ends = f"{shown(values[0], kind)} at the base, {shown(values[-1], kind)} at s = {shown(length, 'length')}"
    if isinstance(profile, Linear):
        return ends
    form = f"{type(profile).__name__}, " if isinstance(profile, Piecewise | Polyline | Spline) else ""
    return f"{ends} ({form}from {shown(values.min(), kind)} to {shown(values.max(), kind)})"
