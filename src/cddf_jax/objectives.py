"""What a design strives for."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .errors import InputError
from .profiles import as_number
from .quantities import View, check_fits, name_of, quantity_named
from .units import Dimension


class Objective(eqx.Module):
    """Something to be made small."""

    quantity: Any = eqx.field(static=True)

    def __check_init__(self):
        quantity_named(self.quantity)

    @property
    def peak(self) -> bool:
        """Whether the largest of the values counts, and not their sum."""
        return False

    @property
    def bent(self) -> bool:
        return quantity_named(self.quantity).bent

    @abstractmethod
    def values(self, view: View) -> Array:
        """What is to be made small, SI."""

    def told(self, value: float) -> float:
        """The value as people read it, in `dimension`."""
        return value

    @property
    def dimension(self) -> Dimension:
        """Of what is told."""
        return quantity_named(self.quantity).dimension

    def __str__(self) -> str:
        return f"{type(self).__name__.lower()} {name_of(self.quantity)}"


class Least(Objective):
    """The least of a quantity: of what varies along the body its largest value, of several tendons their sum.

    Args:
        quantity: a name of `QUANTITIES`, or a function of manipulator and equilibrium that gives a number.
    """

    @property
    def peak(self) -> bool:
        return quantity_named(self.quantity).along

    def values(self, view: View) -> Array:
        return _reduced(self.quantity, quantity_named(self.quantity).of(view), self.peak)


class Most(Objective):
    """The most of a quantity: of what varies along the body its smallest value, of several tendons their sum."""

    @property
    def peak(self) -> bool:
        return quantity_named(self.quantity).along

    def values(self, view: View) -> Array:
        return -_reduced(self.quantity, quantity_named(self.quantity).of(view), self.peak)

    def told(self, value: float) -> float:
        return -value


class Even(Objective):
    """A quantity as even along the body as can be: its variance over its squared mean, zero where it is constant.

    Told as the relative standard deviation, the root of that. What tendons have counts up to their anchors.
    """

    def __check_init__(self):
        if not quantity_named(self.quantity).along:
            raise InputError(f"design: {name_of(self.quantity)} does not vary along the body; take Least or Most of it")

    def values(self, view: View) -> Array:
        values, shares = _on_panels(self.quantity, view)
        mean = jnp.sum(values * shares, axis=-1, keepdims=True)
        return jnp.mean(jnp.sum((values - mean) ** 2 * shares, axis=-1, keepdims=True) / mean**2)

    def told(self, value: float) -> float:
        return float(np.sqrt(max(value, 0.0)))

    @property
    def dimension(self) -> Dimension:
        return "dimensionless"


class Near(Objective):
    """A quantity near what is wanted: the mean of squared differences, told as its root.

    What tendons have counts up to their anchors where it is compared all along.

    Args:
        quantity: a name of `QUANTITIES`, or a function of manipulator and equilibrium.
        value: what is wanted: one for all, or an array that fits, (points, 2) for a shape given by "position".
        at: (points,) arc lengths, m, at which what varies along the body is compared; None for all along.
    """

    value: Any = eqx.field(default=0.0, converter=as_number)
    at: Float[np.ndarray | Array, " points"] | None = eqx.field(
        default=None, converter=lambda at: None if at is None else as_number(at)
    )

    def __check_init__(self):
        if self.at is not None and (np.ndim(self.at) != 1 or not quantity_named(self.quantity).along):
            raise InputError(
                "design: Near(at=...) takes a list of arc lengths, and a quantity that varies along the body"
            )

    def values(self, view: View) -> Array:
        value = jnp.asarray(self.value)
        if self.at is not None:
            found = quantity_named(self.quantity).of(view.moved(jnp.asarray(self.at)))
            value = _points_last(value, found)
            check_fits(name_of(self.quantity), value, found)
            return jnp.mean((found - value) ** 2)
        if quantity_named(self.quantity).along:
            if value.ndim:
                raise InputError(
                    f"design: {name_of(self.quantity)} varies along the body; say where by Near(..., at=...)"
                )
            values, shares = _on_panels(self.quantity, view)
            return jnp.mean(jnp.sum((values - value) ** 2 * shares, axis=-1))
        found = quantity_named(self.quantity).of(view)
        check_fits(name_of(self.quantity), value, found)
        return jnp.mean((found - value) ** 2)

    def told(self, value: float) -> float:
        return float(np.sqrt(max(value, 0.0)))


def _points_last(value: Array, found: Array) -> Array:
    return value.T if value.ndim == 2 and value.shape[::-1] == found.shape else value


def _on_panels(quantity: Any, view: View) -> tuple[Float[Array, "*k points"], Float[Array, "*_ points"]]:
    """A quantity at Gauss nodes between the places where it is not smooth, and their shares in a mean."""
    nodes, shares = view.panels.nodes.ravel(), view.panels.shares.ravel()
    there, known = view.moved(nodes), quantity_named(quantity)
    if known.to_anchor:
        shares = jnp.where(there.anchored, shares, 0.0)
        shares /= jnp.sum(shares, axis=-1, keepdims=True)
    return known.of(there), shares


def _reduced(quantity: Any, values: Array, peak: bool) -> Array:
    one_each = quantity_named(quantity).per_tendon
    if not peak and jnp.ndim(values) != (1 if one_each else 0):
        raise InputError(
            f"design: {name_of(quantity)} has shape {jnp.shape(values)}; a number is wanted for Least or Most"
        )
    return values if peak else jnp.sum(values)
