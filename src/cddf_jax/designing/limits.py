"""Limits that a design must keep."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from ..robot.profiles import Scalar, as_number
from .body_quantities import BodyView, OfQuantity, check_fits


def _optional(value: object) -> Array | np.ndarray | None:
    return None if value is None else as_number(value)


class Limit(OfQuantity):
    """A range for a quantity, everywhere along the body and for every tendon.

    Args:
        quantity: a name of `BODY_QUANTITIES`, or a function of manipulator and equilibrium.
        least, most: the range, SI; None for no limit on that side.
        equal: instead of them, the value that the quantity must have; of `tip_position` two numbers.
        scale: violations count relative to it, SI; unless given the size of the limit, or for a limit of zero the size
            of the quantity at the start.
    """

    least: Scalar | None = eqx.field(default=None, converter=_optional)
    most: Scalar | None = eqx.field(default=None, converter=_optional)
    equal: Float[Array | np.ndarray, "..."] | None = eqx.field(default=None, converter=_optional)
    scale: Scalar | None = eqx.field(default=None, converter=_optional)

    def __check_init__(self):
        name, known = self.name, self.known
        if (self.equal is None) == (self.least is None and self.most is None):
            raise InputError(f"a limit of {name} needs least, most or both, or else equal")
        if self.equal is not None and known.along:
            raise InputError(f"{name} varies along the body and cannot equal one value; take Near or Even of it")
        for side in ("least", "most", "equal", "scale"):
            number = getattr(self, side)
            shaped = np.ndim(number) > 0 and side != "equal"
            if isinstance(number, np.ndarray) and (shaped or not np.all(np.isfinite(number))):
                raise InputError(f"a limit of {name} must be a finite number, got {side}={number.tolist()}")
        if isinstance(self.scale, np.ndarray) and not self.scale > 0:
            raise InputError(f"the scale of a limit of {name} must be above 0, got {self.scale:g}")
        low, high = self.least, self.most
        if isinstance(low, np.ndarray) and isinstance(high, np.ndarray) and low > high:
            raise InputError(f"{name} cannot be at least {self.least:g} and at most {self.most:g}; exchange them")

    def inequalities(self, view: BodyView) -> Array:
        """Scaled margins, (sides, ...), which must not be negative."""
        value = self.known.of(view)
        sides = [] if self.least is None else [value - self.least]
        sides += [] if self.most is None else [self.most - value]
        return jnp.stack(sides) / jnp.asarray(self.scale) if sides else jnp.zeros((0, *jnp.shape(value)))

    def equalities(self, view: BodyView) -> Array:
        """Scaled differences, which must be zero."""
        if self.equal is None:
            return jnp.zeros(0)
        value = self.known.of(view)
        check_fits(self.name, self.equal, value)
        return jnp.ravel((value - self.equal) / jnp.asarray(self.scale))

    def size(self, at_start: float) -> float:
        """The scale: as given, else the size of the limit, or for a limit of zero the size at the start."""
        if self.scale is not None:
            return float(self.scale)
        stated = [np.max(np.abs(np.asarray(x))) for x in (self.least, self.most, self.equal) if x is not None]
        return float(max(stated)) or at_start or 1.0

    def __str__(self) -> str:
        """As in "0.002 <= wall_thickness", SI."""
        name = self.name
        if self.equal is not None:
            return f"{name} = {np.array2string(np.asarray(self.equal), precision=6)}"
        low = "" if self.least is None else f"{float(self.least):.6g} <= "
        return f"{low}{name}" + ("" if self.most is None else f" <= {float(self.most):.6g}")
