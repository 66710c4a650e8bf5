"""Quantities of a body and of its equilibria, by name: what a design can improve or limit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..errors import InputError, known_names
from ..mechanics.fields import AnyFields
from ..numerics.elements import Elements, elements_between, smooth_pieces
from ..quantities import dimension_of
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..statics.solve import solve
from ..units import Dimension
from .load_cases import LoadCase

BODY_NODES = 48  # in each smooth piece, for integrals over a body without an equilibrium
FLAT = "is zero of a body in the plane; give a tendon an angle, or a load three components"
SEVERAL_ACROSS = "has two directions across the tip in space; take 'tip_stiffness_x', 'tip_stiffness_y' or one of z"


@dataclass
class BodyView:
    """A body, what acts on it, and the arc lengths at which it is evaluated."""

    body: Manipulator
    arc_length: Float[Array | np.ndarray, " points"]  # m
    # None where only the body matters; `Any` in place of None, as most quantities need both
    case: LoadCase | Any = None
    equilibrium: Equilibrium | Any = None  # of the body in that case
    nodes: int = 16  # of the solver

    @cached_property
    def along(self) -> AnyFields:
        """The fields of the equilibrium at the arc lengths."""
        return self.equilibrium.at(self.arc_length)

    @cached_property
    def anchored(self) -> Bool[Array, "tendons points"]:
        """Whether each tendon reaches the arc length: up to its anchor."""
        ends = [self.body.length if tendon.end is None else tendon.end for tendon in self.body.tendons]
        return jnp.asarray(self.arc_length) <= jnp.stack([jnp.asarray(end) for end in ends])[:, None] * (1 + 1e-12)

    @cached_property
    def elements(self) -> Elements:
        """Elements that end where quantities are not smooth: those of the equilibrium, else between the joints."""
        if self.equilibrium is not None:
            return self.equilibrium.elements
        return elements_between(smooth_pieces(jnp.asarray(self.body.length), self.body.breakpoints), BODY_NODES)


class BodyQuantity(NamedTuple):
    """Something that a design can make large, small, even, near a value, or keep within limits."""

    name: str  # in the registry of quantities; "" for a user's function
    of: Callable[[BodyView], Array]  # an array of any shape, SI
    bent: bool = True  # whether it needs an equilibrium
    along: bool = False  # whether its last axis runs along the body
    per_tendon: bool = False  # whether it is one number for each tendon
    to_anchor: bool = False  # whether its last axis but one is the tendons, each of which ends at its anchor
    unknown: Mapping[int, str] = {}  # why it is not known, and the remedy, by the number of components of positions

    @property
    def dimension(self) -> Dimension:
        return dimension_of(self.name) if self.name else "dimensionless"


QuantityName = str | Callable[[Manipulator, Equilibrium], ArrayLike]  # a name of `BODY_QUANTITIES`, or a function


def quantity_named(name: QuantityName) -> BodyQuantity:
    """A quantity by its name, or from a function of manipulator and equilibrium."""
    if callable(name):
        return BodyQuantity("", lambda view: jnp.asarray(name(view.body, view.equilibrium)))
    if name not in BODY_QUANTITIES:
        remedy = known_names(name, BODY_QUANTITIES)
        raise InputError(f"design: {name!r} is not a quantity of a body", remedy=remedy)
    return BODY_QUANTITIES[name]


class OfQuantity(eqx.Module):
    """An objective or a limit."""

    quantity: QuantityName = eqx.field(static=True)

    def __check_init__(self):
        quantity_named(self.quantity)

    @property
    def known(self) -> BodyQuantity:
        return quantity_named(self.quantity)

    @property
    def name(self) -> str:
        """The name of its quantity in tables."""
        own = self.quantity
        return own if isinstance(own, str) else getattr(own, "__name__", type(own).__name__)


# --- of the body alone ---------------------------------------------------------------------------


def _clearance(view: BodyView) -> Array:
    offset, s = view.body.offset(view.arc_length), view.arc_length
    outer, inner = view.body.radii(s)
    sides = jnp.stack([outer - offset, offset - inner])
    return jnp.where(view.anchored, sides, outer)  # beyond its anchor a tendon needs no clearance


def _slopes(view: BodyView) -> Array:
    s = jnp.asarray(view.arc_length)
    slopes = jnp.stack(jax.jvp(view.body.radii, (s,), (jnp.ones_like(s),))[1])
    return jnp.stack([slopes, -slopes])


def _mass(view: BodyView) -> Array:
    points = jnp.asarray([0.0, *(point.mass for point in view.body.point_masses)])
    return _integral(view, view.body.distributed_mass) + jnp.sum(points)


def _integral(view: BodyView, of: Callable[[Array], Array]) -> Array:
    return jnp.sum(view.elements.gain(of(view.elements.nodes)))


# --- of an equilibrium ---------------------------------------------------------------------------


def _strain(view: BodyView) -> Array:
    strain = view.body.radii(view.arc_length)[0] * view.along.bend()
    return jnp.stack([strain, -strain])


def _crossing(view: BodyView) -> Array:
    return jnp.where(view.anchored, view.equilibrium._dense.inside_of_bend(view.arc_length), 0.0)


def _tension(view: BodyView) -> Array:
    """The tension; beyond the anchor the tension at the anchor, which changes neither minimum nor maximum."""
    return jnp.where(view.anchored, view.along.tension, view.equilibrium.tip_tension[:, None])


def _stiffness(direction: Callable[[Equilibrium], Array]) -> Callable[[BodyView], Array]:
    def stiffness(view: BodyView) -> Array:
        found = view.equilibrium
        loads = Loads() if view.case.loads is None else view.case.loads
        loads = loads.with_components(found.tip_position.shape[-1])

        def tip(force: Array) -> Array:  # at constant base tensions, as in `tip_compliance`
            given = view.body, found.base_tension, replace(loads, tip_force=force)
            return solve(*given, direction=found.direction, nodes=view.nodes, throw=False).tip_position

        way = direction(found)
        return 1.0 / (way @ jax.jacfwd(tip)(jnp.asarray(loads.tip_force)) @ way)

    return stiffness


def _across(found: Equilibrium) -> Array:
    return jnp.stack([-jnp.sin(found.tip_angle), jnp.cos(found.tip_angle)])


def _towards(axis: int) -> Callable[[Equilibrium], Array]:
    return lambda found: jnp.eye(found.tip_position.shape[-1])[axis]


BODY_QUANTITIES: dict[str, BodyQuantity] = {
    quantity.name: quantity
    for quantity in (
        BodyQuantity("length", lambda v: jnp.asarray(v.body.length), bent=False),
        BodyQuantity("volume", lambda v: _integral(v, v.body.area), bent=False),
        BodyQuantity("mass", _mass, bent=False),
        BodyQuantity("outer_radius", lambda v: v.body.radii(v.arc_length)[0], bent=False, along=True),
        BodyQuantity("inner_radius", lambda v: v.body.radii(v.arc_length)[1], bent=False, along=True),
        BodyQuantity("wall_thickness", lambda v: jnp.subtract(*v.body.radii(v.arc_length)), bent=False, along=True),
        BodyQuantity("clearance", _clearance, bent=False, along=True, to_anchor=True),
        BodyQuantity("taper", lambda v: -_slopes(v)[0, 0], bent=False, along=True),
        BodyQuantity("slope", _slopes, bent=False, along=True),
        BodyQuantity(
            "curvature",
            lambda v: v.along.curvature,
            along=True,
            unknown={3: "has three components in space; take 'bending' or 'twist'"},
        ),
        BodyQuantity("bending", lambda v: jnp.abs(v.along.bend()), along=True),
        BodyQuantity("twist", lambda v: v.along.curvature[..., 0], along=True, unknown={2: FLAT}),
        BodyQuantity("heading", lambda v: v.along.tilt(), along=True),
        BodyQuantity("position", lambda v: v.along.position.T, along=True),
        BodyQuantity("strain", _strain, along=True),
        BodyQuantity("crossing", _crossing, along=True, to_anchor=True),
        BodyQuantity("tension", _tension, along=True, to_anchor=True),
        BodyQuantity("base_tension", lambda v: v.equilibrium.base_tension, per_tendon=True),
        BodyQuantity("tip_tension", lambda v: v.equilibrium.tip_tension, per_tendon=True),
        BodyQuantity("tension_loss", lambda v: v.equilibrium.tension_loss, per_tendon=True),
        BodyQuantity("tendon_displacement", lambda v: v.equilibrium.tendon_displacement, per_tendon=True),
        BodyQuantity("tip_angle", lambda v: v.equilibrium.tip_angle),
        BodyQuantity("tip_twist", lambda v: v.equilibrium.twist[-1], unknown={2: FLAT}),
        BodyQuantity("tip_position", lambda v: v.equilibrium.tip_position),
        BodyQuantity("tip_x", lambda v: v.equilibrium.tip_position[0]),
        BodyQuantity("tip_y", lambda v: v.equilibrium.tip_position[1]),
        BodyQuantity("tip_z", lambda v: v.equilibrium.tip_position[2], unknown={2: FLAT}),
        BodyQuantity("tip_stiffness", _stiffness(_across), unknown={3: SEVERAL_ACROSS}),
        BodyQuantity("tip_stiffness_x", _stiffness(_towards(0))),
        BodyQuantity("tip_stiffness_y", _stiffness(_towards(1))),
        BodyQuantity("tip_stiffness_z", _stiffness(_towards(2)), unknown={2: FLAT}),
    )
}
