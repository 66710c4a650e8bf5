"""Objectives and limits of a design."""

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from ..robot.profiles import Scalar, as_number, as_optional_number
from ..units import Dimension
from .body_quantities import BodyQuantity, BodyView, OfQuantity


class Objective(OfQuantity):
    """A number to be made small."""

    @property
    def peak(self) -> bool:
        """Whether the largest of several values along the body counts."""
        return False

    @abstractmethod
    def values(self, view: BodyView) -> Array:
        """The number to be made small, or values along the body, the largest of which is to be made small, SI."""

    squared: ClassVar[bool] = False  # whether the root of the number is displayed

    def displayed(self, value: float) -> float:
        """A value that is made small in the form in which the user reads it, in `dimension`."""
        return float(np.sqrt(max(value, 0.0))) if self.squared else value

    @property
    def dimension(self) -> Dimension:
        """The dimension of displayed values."""
        return self.known.dimension

    def __str__(self) -> str:
        return f"{type(self).__name__.lower()} {self.name}"


class Least(Objective):
    """The least of a quantity: of a quantity along the body its largest value, of several tendons their sum.

    Args:
        quantity: a name of `BODY_QUANTITIES`, or a function of manipulator and equilibrium that gives a number.
    """

    sign: ClassVar[float] = 1.0

    @property
    def peak(self) -> bool:
        return self.known.along

    def values(self, view: BodyView) -> Array:
        """The quantity along the body, or its sum over the tendons, with the sign by which it is made small."""
        known = self.known
        values = self.sign * known.of(view)
        if known.along:
            return values
        if jnp.ndim(values) != (1 if known.per_tendon else 0):
            raise InputError(f"design: {self.name} has shape {jnp.shape(values)}; Least and Most need a number")
        return jnp.sum(values)

    def displayed(self, value: float) -> float:
        return self.sign * value


class Most(Least):
    """The most of a quantity: of a quantity along the body its smallest value, of several tendons their sum."""

    sign = -1.0


class Even(Objective):
    """A quantity as even as possible along the body, or between tendons where each has one number.

    The variance over the squared mean is made small; it is zero for a constant quantity. Its root is displayed, the
    relative standard deviation. Quantities along a tendon count up to its anchor.
    """

    squared = True

    def __check_init__(self):
        if not (self.known.along or self.known.per_tendon):
            remedy = "take Least or Most of it"
            raise InputError(f"design: {self.name} varies neither along the body nor between tendons; {remedy}")

    def values(self, view: BodyView) -> Array:
        if self.known.along:
            values, shares = _on_elements(self.known, view)
        else:
            values = self.known.of(view)
            shares = jnp.full_like(values, 1.0 / values.size)
        mean = jnp.sum(values * shares, axis=-1, keepdims=True)
        return jnp.mean(jnp.sum((values - mean) ** 2 * shares, axis=-1, keepdims=True) / mean**2)

    @property
    def dimension(self) -> Dimension:
        return "dimensionless"


class Near(Objective):
    """A quantity near a wanted value: the mean of squared differences, displayed as its root.

    Args:
        quantity: a name of `BODY_QUANTITIES`, or a function of manipulator and equilibrium.
        value: the wanted value, SI: a number, or an array that fits, such as (points, 2) for "position".
        at: (points,) arc lengths, m, at which a quantity along the body is compared. None for everywhere; quantities
            along a tendon then count up to its anchor.
    """

    squared = True
    value: Float[Array | np.ndarray, "..."] = eqx.field(default=0.0, converter=as_number)
    at: Float[np.ndarray | Array, " points"] | None = eqx.field(default=None, converter=as_optional_number)

    def __check_init__(self):
        if self.at is not None and (np.ndim(self.at) != 1 or not self.known.along):
            raise InputError(
                "design: Near(at=...) takes a list of arc lengths, and a quantity that varies along the body"
            )

    def values(self, view: BodyView) -> Array:
        name, known, value = self.name, self.known, jnp.asarray(self.value)
        if known.along and self.at is None:
            if value.ndim:
                raise InputError(f"design: {name} varies along the body; say where by Near(..., at=...)")
            found, shares = _on_elements(known, view)
            return jnp.mean(jnp.sum((found - value) ** 2 * shares, axis=-1))
        found = known.of(view if self.at is None else replace(view, arc_length=jnp.asarray(self.at)))
        if self.at is not None and value.ndim == 2 and value.shape[::-1] == found.shape:
            value = value.T  # points come last in quantities along the body
        if value.shape not in ((), found.shape):
            raise InputError(f"design: {name} has shape {found.shape}, but the wanted value has {value.shape}")
        return jnp.mean((found - value) ** 2)


def _on_elements(known: BodyQuantity, view: BodyView) -> tuple[Float[Array, "*k points"], Float[Array, "*_ points"]]:
    """A quantity at the Gauss nodes of elements in which it is smooth, and the shares of the nodes in a mean."""
    nodes, shares = view.elements.nodes.ravel(), view.elements.shares.ravel()
    there = replace(view, arc_length=nodes)
    if known.to_anchor:
        shares = jnp.where(there.anchored, shares, 0.0)
        shares /= jnp.sum(shares, axis=-1, keepdims=True)
    return known.of(there), shares


# --- limits --------------------------------------------------------------------------------------


class Limit(OfQuantity):
    """A range for a quantity, everywhere along the body and for every tendon.

    Args:
        quantity: a name of `BODY_QUANTITIES`, or a function of manipulator and equilibrium.
        least, most: the range, SI; None for no limit on that side.
        equal: instead of them, the value that the quantity must have.
    """

    least: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    most: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    equal: Scalar | None = eqx.field(default=None, converter=as_optional_number)

    def __check_init__(self):
        name, known = self.name, self.known
        if (self.equal is None) == (self.least is None and self.most is None):
            raise InputError(f"a limit of {name} needs least, most or both, or else equal")
        if self.equal is not None and known.along:
            raise InputError(f"{name} varies along the body and cannot equal one value; take Near or Even of it")
        for side, bound in self.sides.items():
            if isinstance(bound, np.ndarray) and (bound.ndim > 0 or not np.isfinite(bound)):
                raise InputError(f"a limit of {name} must be a finite number, got {side}={bound.tolist()}")
        low, high = self.least, self.most
        if isinstance(low, np.ndarray) and isinstance(high, np.ndarray) and low > high:
            raise InputError(f"{name} cannot be at least {self.least:g} and at most {self.most:g}; exchange them")

    @property
    def sides(self) -> dict[str, Scalar]:
        """What is given of "least", "most" and "equal"."""
        given = {"least": self.least, "most": self.most, "equal": self.equal}
        return {side: bound for side, bound in given.items() if bound is not None}

    def margins(self, view: BodyView) -> Float[Array, "sides *_"]:
        """How far the quantity is inside each bound, SI; for `equal` the difference, which must be zero."""
        value = self.known.of(view)
        return jnp.stack([bound - value if side == "most" else value - bound for side, bound in self.sides.items()])

    def __str__(self) -> str:
        """As in "0.002 <= wall_thickness", SI."""
        bounds = {side: f"{float(bound):.6g}" for side, bound in self.sides.items()}
        if "equal" in bounds:
            return f"{self.name} = {bounds['equal']}"
        low = f"{bounds['least']} <= " if "least" in bounds else ""
        return f"{low}{self.name}" + (f" <= {bounds['most']}" if "most" in bounds else "")
