"""Dead loads on a manipulator: forces and moments that keep their direction in space while the body bends."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .profiles import Number, as_number


def _as_moment(value: object) -> Number:
    return _as_vector(value) if isinstance(value, tuple | list) else as_number(value)


def _as_vector(value: object) -> Number:
    """Components, which may be traced one by one."""
    parts = jax.tree.leaves(value)
    return jnp.stack(parts) if len(parts) > 1 and any(isinstance(x, jax.Array) for x in parts) else as_number(value)


class Loads(eqx.Module):
    """Dead loads in the fixed frame at the base, whose X axis the straight body follows: X-Y in the plane, or X-Y-Z.

    Args:
        tip_force: F, a force on the tip (X, Y) or (X, Y, Z), N.
        tip_moment: m, a moment on the tip, N m: a number, positive from X to Y, or in space (X, Y, Z).
        gravity: g, the acceleration of gravity (X, Y) or (X, Y, Z), m/s^2; it acts on density, mass_per_length and
            point masses of the body.

    If one of them has three components, the body is solved in space; the others may have two.

    Raises:
        ValueError: when tip_force or gravity has neither two nor three components.
    """

    tip_force: Float[Number, " components"] = eqx.field(default=(0.0, 0.0), converter=_as_vector)
    tip_moment: Float[Number, "..."] = eqx.field(default=0.0, converter=_as_moment)
    gravity: Float[Number, " components"] = eqx.field(default=(0.0, 0.0), converter=_as_vector)

    def __check_init__(self):
        for name in ("tip_force", "gravity"):
            shape = np.shape(getattr(self, name))
            if shape[-1:] not in ((2,), (3,)):
                raise ValueError(f"Loads: {name} must have two or three components (X, Y, Z), got shape {shape}")

    @property
    def components(self) -> int:
        """How many components they have: three where one of them has three, else two; static."""
        vectors = [np.shape(self.tip_force), np.shape(self.gravity)]
        along_path = any(len(shape) > 1 for shape in vectors)  # then (3,) are the moments of three steps in the plane
        turned = 3 if np.shape(self.tip_moment) == (3,) and not along_path else 2
        return max(turned, *(shape[-1] for shape in vectors))

    @property
    def in_space(self) -> bool:
        """Whether one of them has three components; static."""
        return self.components == 3

    def with_components(self, count: int) -> "Loads":
        """The same loads with three components each for a count of 3; for 2 they stay as they are."""
        return loads_in_space(self) if count == 3 else self


def loads_as_dict(loads: Loads) -> dict[str, object]:
    """For JSON; SI units."""
    return {name: np.asarray(value) for name, value in vars(loads).items()}


def gravity_in_words(gravity: object) -> str:
    """ "gravity (0, -9.81) m/s^2"."""
    return f"gravity ({', '.join(f'{x:.5g}' for x in np.asarray(gravity))}) m/s^2"


def loads_in_space(loads: Loads) -> Loads:
    """The same loads with three components each."""

    def vector(value: Number) -> Number:
        x = jnp.asarray(value)
        return x if x.shape[-1] == 3 else jnp.concatenate([x, jnp.zeros_like(x[..., :1])], axis=-1)

    moment = jnp.asarray(loads.tip_moment)
    if moment.shape[-1:] != (3,):  # about Z, perhaps along a path
        moment = jnp.stack([jnp.zeros_like(moment), jnp.zeros_like(moment), moment], axis=-1)
    return Loads(vector(loads.tip_force), moment, vector(loads.gravity))


def force_per_length(loads: Loads, mass_per_length: Float[Array, "*points"]) -> Float[Array, "*points components"]:
    """The sum of all distributed dead loads, N/m: the weight of the body.

    To add a distributed load, add a field to `Loads` and a term here; the solver and the energy use this function.

    Args:
        loads: on the body.
        mass_per_length: at each point, kg/m.
    """
    return mass_per_length[..., None] * jnp.asarray(loads.gravity)


def force_at_points(loads: Loads, mass: Float[Array, " masses"]) -> Float[Array, "masses components"]:
    """The dead load of each point mass, N: its weight."""
    return mass[:, None] * jnp.asarray(loads.gravity)


def planar_cross(a: Float[Array, "*points 2"], b: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
    """The product a x b of two vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
