"""What a design must keep to."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .errors import InputError
from .profiles import Scalar, as_number
from .quantities import View, check_fits, name_of, quantity_named


def number_of(value: Any, what: str) -> float:
    """A finite number.

    Raises:
        InputError: for anything else; begins with `what`.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{what} must be a number, got {value!r}")
    return number


def _optional(value: Any) -> Any:
    if value is None or isinstance(value, jax.Array):
        return value
    try:
        return as_number(value)
    except (TypeError, ValueError):
        raise InputError(f"design: a limit must be a number, got {value!r}") from None


class Limit(eqx.Module):
    """A quantity that may not leave a range, wherever along the body and for every tendon that it is about.

    Args:
        quantity: a name of `QUANTITIES`, or a function of manipulator and equilibrium.
        least, most: the range, SI; None for no limit on that side.
        equal: instead of them, what the quantity must be; of `tip_position` two numbers.
        scale: of violations, SI; unless given the size of the limit, of a limit of zero the size at the start.
    """

    quantity: Any = eqx.field(static=True)
    least: Scalar | None = eqx.field(default=None, converter=_optional)
    most: Scalar | None = eqx.field(default=None, converter=_optional)
    equal: Any = eqx.field(default=None, converter=_optional)
    scale: Any = eqx.field(default=None, converter=_optional)

    def __check_init__(self):
        name = name_of(self.quantity)
        quantity_named(self.quantity)
        if (self.equal is None) == (self.least is None and self.most is None):
            raise InputError(f"design: a limit of {name} needs least, most or both, or else equal")
        if self.equal is not None and quantity_named(self.quantity).along:
            raise InputError(
                f"design: {name} varies along the body and cannot equal one value; take Near or Even of it"
            )
        for side in ("least", "most", "equal", "scale"):
            number = getattr(self, side)
            if isinstance(number, np.ndarray) and (
                not np.all(np.isfinite(number)) or (number.ndim and side != "equal")
            ):
                raise InputError(f"design: a limit of {name} must be a finite number, got {side}={number.tolist()}")
        if isinstance(self.scale, np.ndarray) and not self.scale > 0:
            raise InputError(f"design: the scale of a limit of {name} must be above 0, got {self.scale:g}")
        low, high = self.least, self.most
        if isinstance(low, np.ndarray) and isinstance(high, np.ndarray) and low > high:
            raise InputError(
                f"design: {name} cannot be at least {self.least:g} and at most {self.most:g}; exchange them"
            )

    @property
    def bent(self) -> bool:
        return quantity_named(self.quantity).bent

    @property
    def along(self) -> bool:
        return quantity_named(self.quantity).along

    def inequalities(self, view: View) -> Array:
        """Scaled margins, (sides, ...), that may not be negative."""
        value = quantity_named(self.quantity).of(view)
        sides = [] if self.least is None else [value - self.least]
        sides += [] if self.most is None else [self.most - value]
        return jnp.stack(sides) / self.scale if sides else jnp.zeros((0, *jnp.shape(value)))

    def equalities(self, view: View) -> Array:
        """Scaled differences that must be zero."""
        if self.equal is None:
            return jnp.zeros(0)
        value = quantity_named(self.quantity).of(view)
        check_fits(name_of(self.quantity), self.equal, value)
        return jnp.ravel((value - self.equal) / self.scale)

    def size(self, at_start: float) -> float:
        """What counts as large: as given, else the size of the limit, of a limit of zero that at the start."""
        if self.scale is not None:
            return float(self.scale)
        stated = [np.max(np.abs(np.asarray(x))) for x in (self.least, self.most, self.equal) if x is not None]
        return float(max(stated)) or at_start or 1.0

    def __str__(self) -> str:
        """As in "0.002 <= wall_thickness", SI."""
        name = name_of(self.quantity)
        if self.equal is not None:
            return f"{name} = {np.array2string(np.asarray(self.equal), precision=6)}"
        low = "" if self.least is None else f"{float(self.least):.6g} <= "
        return f"{low}{name}" + ("" if self.most is None else f" <= {float(self.most):.6g}")
