"""Dead loads on a manipulator: forces and moments that keep their direction in space while the body bends."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .profiles import Number, Scalar, as_number


def _as_vector(value: object) -> Number:
    """Two components, which may be traced one by one."""
    parts = jax.tree.leaves(value)
    return jnp.stack(parts) if len(parts) > 1 and any(isinstance(x, jax.Array) for x in parts) else as_number(value)


class Loads(eqx.Module):
    """Dead loads in the fixed frame X-Y at the base, whose X axis the straight body follows.

    Args:
        tip_force: F, a force on the tip (X, Y), N.
        tip_moment: m, a moment on the tip, N m, positive from X to Y.
        gravity: g, the acceleration of gravity (X, Y), m/s^2; density, mass_per_length and point masses of the body
            make weights of it.

    Raises:
        ValueError: when tip_force or gravity has not two components.
    """

    tip_force: Float[Number, "2"] = eqx.field(default=(0.0, 0.0), converter=_as_vector)
    tip_moment: Scalar = eqx.field(default=0.0, converter=as_number)
    gravity: Float[Number, "2"] = eqx.field(default=(0.0, 0.0), converter=_as_vector)

    def __check_init__(self):
        for name in ("tip_force", "gravity"):
            shape = np.shape(getattr(self, name))
            if shape[-1:] != (2,):
                raise ValueError(f"Loads: {name} must have two components (X, Y), got shape {shape}")


def force_per_length(loads: Loads, mass_per_length: Float[Array, "*points"]) -> Float[Array, "*points 2"]:
    """What all distributed dead loads together put on the body, N/m: its weight.

    A further distributed load is a field of `Loads` and a term here; the solver and its energy take it from here.

    Args:
        loads: on the body.
        mass_per_length: at each point, kg/m.
    """
    return mass_per_length[..., None] * jnp.asarray(loads.gravity)


def force_at_points(loads: Loads, mass: Float[Array, " masses"]) -> Float[Array, "masses 2"]:
    """The dead load of each point mass, N: its weight."""
    return mass[:, None] * jnp.asarray(loads.gravity)


def planar_cross(a: Float[Array, "*points 2"], b: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
    """The product a x b of two vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
