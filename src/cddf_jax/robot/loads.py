"""Dead loads on a manipulator: forces and moments that keep their direction in space while the body bends."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..units import shown
from .profiles import Number, as_number


class PointLoad(eqx.Module):
    """A dead force and a dead moment at one place of the body.

    Args:
        arc_length: s, m, from the base; 0 < s <= L.
        force: (X, Y) or (X, Y, Z), N.
        moment: N m: a number, positive from X to Y, or in space (X, Y, Z).

    Raises:
        ValueError: when force has neither two nor three components.
    """

    arc_length: Number = eqx.field(converter=as_number)
    force: Float[Number, " components"] = eqx.field(default=(0.0, 0.0), converter=as_number)
    moment: Float[Number, "..."] = eqx.field(default=0.0, converter=as_number)

    def __check_init__(self):
        _check_components("PointLoad: force", self.force)


class Loads(eqx.Module):
    """Dead loads in the fixed frame at the base, whose X axis the straight body follows: X-Y in the plane, or X-Y-Z.

    Args:
        tip_force: F, a force on the tip (X, Y) or (X, Y, Z), N.
        tip_moment: m, a moment on the tip, N m: a number, positive from X to Y, or in space (X, Y, Z).
        gravity: g, the acceleration of gravity (X, Y) or (X, Y, Z), m/s^2; it acts on density, mass_per_length and
            point masses of the body.
        points: one or several `PointLoad`, forces and moments at other places than the tip.

    If one of them has three components, the body is solved in space; the others may have two.

    Raises:
        ValueError: when tip_force or gravity has neither two nor three components.
        TypeError: when points holds anything else.
    """

    tip_force: Float[Number, " components"] = eqx.field(default=(0.0, 0.0), converter=as_number)
    tip_moment: Float[Number, "..."] = eqx.field(default=0.0, converter=as_number)
    gravity: Float[Number, " components"] = eqx.field(default=(0.0, 0.0), converter=as_number)
    points: tuple[PointLoad, ...] = eqx.field(default=(), converter=tuple)

    def __check_init__(self):
        for name in ("tip_force", "gravity"):
            _check_components(f"Loads: {name}", getattr(self, name))
        if not all(isinstance(point, PointLoad) for point in self.points):
            raise TypeError("Loads: points must hold PointLoad, e.g. Loads(points=[PointLoad(0.06, (0.0, -1.0))])")

    @property
    def components(self) -> int:
        """How many components they have: three where one of them has three, else two; static."""
        vectors = [np.shape(each) for each in (self.tip_force, self.gravity, *(point.force for point in self.points))]
        along_path = any(len(shape) > 1 for shape in vectors)  # then (3,) are the moments of three steps in the plane
        moments = [np.shape(self.tip_moment), *(np.shape(point.moment) for point in self.points)]
        turned = 3 if (3,) in moments and not along_path else 2
        return max(turned, *(shape[-1] for shape in vectors))

    @property
    def in_space(self) -> bool:
        """Whether one of them has three components; static."""
        return self.components == 3

    def with_components(self, count: int) -> "Loads":
        """The same loads with three components each for a count of 3; for 2 they stay as they are."""
        if count < 3:
            return self
        points = [PointLoad(p.arc_length, _vector_in_space(p.force), _moment_in_space(p.moment)) for p in self.points]
        gravity = _vector_in_space(self.gravity)
        return Loads(_vector_in_space(self.tip_force), _moment_in_space(self.tip_moment), gravity, points)


def _vector_in_space(value: Number) -> Number:
    x = jnp.asarray(value)
    return x if x.shape[-1] == 3 else jnp.concatenate([x, jnp.zeros_like(x[..., :1])], axis=-1)


def _moment_in_space(value: Number) -> Number:
    moment = jnp.asarray(value)
    if moment.shape[-1:] == (3,):
        return moment
    return jnp.stack([jnp.zeros_like(moment), jnp.zeros_like(moment), moment], axis=-1)  # about Z


def _check_components(what: str, vector: Number) -> None:
    if np.shape(vector)[-1:] not in ((2,), (3,)):
        raise ValueError(f"{what} must have two or three components (X, Y, Z), got shape {np.shape(vector)}")


def gravity_in_words(gravity: object) -> str:
    """ "gravity (0, -9.81) m/s^2"."""
    return f"gravity ({', '.join(f'{x:.5g}' for x in np.asarray(gravity))}) m/s^2"


def point_in_words(point: PointLoad) -> str:
    """ "load at 60 mm: (0, -1) N and 0.1 N m"."""
    force, moment = (", ".join(f"{x:.5g}" for x in np.atleast_1d(each)) for each in (point.force, point.moment))
    moment = f"({moment})" if np.ndim(point.moment) else moment
    return f"load at {shown(float(np.asarray(point.arc_length)), 'length')}: ({force}) N and {moment} N m"
