"""What a design is asked about: quantities of a body and of its equilibria, by name."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .equilibrium import Equilibrium, Fields
from .errors import InputError
from .load_cases import LoadCase
from .loads import Loads
from .manipulator import Manipulator
from .profiles import Profile
from .quadrature import Panels, panels
from .statics import solve
from .units import Dimension

BODY_NODES = 48  # of integrals over a body alone, in each of its smooth pieces
OF_RADII = ("volume", "outer_radius", "inner_radius", "wall_thickness", "clearance", "taper", "slope", "strain")


class View:
    """A body, what acts on it, and where along it one looks.

    Args:
        body: the manipulator, its numbers maybe traced.
        arc_length: (points,), m.
        case: the load case; None where only the body matters.
        equilibrium: of the body in that case.
        nodes: with which it was solved.
    """

    def __init__(
        self,
        body: Manipulator,
        arc_length: Any,
        case: LoadCase | None = None,
        equilibrium: Equilibrium | None = None,
        nodes: int = 16,
    ):
        self.body, self.arc_length, self.case, self._equilibrium, self.nodes = (
            body,
            arc_length,
            case,
            equilibrium,
            nodes,
        )

    @property
    def equilibrium(self) -> Equilibrium:
        assert self._equilibrium is not None
        return self._equilibrium

    @cached_property
    def along(self) -> Fields:
        """The fields of the equilibrium at the arc lengths."""
        return self.equilibrium.at(self.arc_length)

    @cached_property
    def sides(self) -> Float[Array, "tendons 1"]:
        return jnp.asarray([[float(tendon.side)] for tendon in self.body.tendons])

    @cached_property
    def anchored(self) -> Float[Array, "tendons points"]:
        """Whether each tendon is there."""
        ends = [self.body.length if tendon.end is None else tendon.end for tendon in self.body.tendons]
        return self.arc_length <= jnp.stack([jnp.asarray(end) for end in ends])[:, None] * (1 + 1e-12)

    @cached_property
    def panels(self) -> Panels:
        """Panels that end where what is looked at is not smooth: those of the equilibrium, else between the joints."""
        if self._equilibrium is not None:
            return self._equilibrium.panels
        return panels(jnp.asarray(self.body.length), self.body.breakpoints, BODY_NODES)

    def moved(self, arc_length: Any) -> "View":
        """The same at other places."""
        return View(self.body, arc_length, self.case, self._equilibrium, self.nodes)


class Quantity(NamedTuple):
    """Something that can be wanted large, small, even, near a value, or within limits."""

    of: Callable[[View], Any]  # an array of any shape, SI
    dimension: Dimension
    bent: bool = True  # whether an equilibrium is needed for it
    along: bool = False  # whether its last axis runs along the body
    per_tendon: bool = False  # whether it is one number for each tendon
    to_anchor: bool = False  # whether its last axis but one is that of the tendons, each there up to its anchor


def quantity_named(name: Any) -> Quantity:
    """A quantity by its name, or made of a function of manipulator and equilibrium.

    Raises:
        InputError: names the known ones.
    """
    if callable(name):
        return Quantity(lambda view: jnp.asarray(name(view.body, view.equilibrium)), "dimensionless")
    if name not in QUANTITIES:
        raise InputError(f"design: {name!r} is no quantity of a body; there are {', '.join(QUANTITIES)}")
    return QUANTITIES[name]


def name_of(quantity: Any) -> str:
    """What a quantity is called in tables."""
    return quantity if isinstance(quantity, str) else getattr(quantity, "__name__", type(quantity).__name__)


def check_fits(name: str, wanted: Any, value: Any) -> None:
    """Refuse what is wanted of a quantity in another shape.

    Raises:
        InputError: names the quantity and the shapes.
    """
    if jnp.shape(wanted) not in ((), jnp.shape(value)):
        raise InputError(f"design: {name} has shape {jnp.shape(value)}, and {jnp.shape(wanted)} was asked of it")


# --- of the body alone ---------------------------------------------------------------------------


def _slope(profile: Profile, s: Float[Array, " points"]) -> Any:
    return jax.jvp(profile, (s,), (jnp.ones_like(s),))[1]


def _radius(view: View, which: int) -> Array:
    return view.body.radii(view.arc_length)[which]


def _wall(view: View) -> Array:
    outer, inner = view.body.radii(view.arc_length)
    return outer - inner


def _clearance(view: View) -> Array:
    offset, s = view.body.offset(view.arc_length), view.arc_length
    outer, inner = view.body.radii(s)
    return jnp.where(
        view.anchored, jnp.stack([outer - offset, offset - inner]), outer
    )  # beyond its anchor it is in no one's way


def _slopes(view: View) -> Array:
    slopes = jnp.stack(_slope(view.body.radii, view.arc_length))
    return jnp.stack([slopes, -slopes])


def _volume(view: View) -> Array:
    return _integral(view.body, view.body.area)


def _mass(view: View) -> Array:
    points = jnp.asarray([0.0, *(point.mass for point in view.body.point_masses)])
    return _integral(view.body, view.body.distributed_mass) + jnp.sum(points)


def _integral(body: Manipulator, of: Callable[[Array], Array]) -> Array:
    """By Gauss's rule between the places where the body is not smooth."""
    pieces = panels(jnp.asarray(body.length), body.breakpoints, BODY_NODES)
    return jnp.sum(pieces.gain(of(pieces.nodes)))


# --- of an equilibrium ---------------------------------------------------------------------------


def _strain(view: View) -> Array:
    strain = view.body.outer_strain(view.arc_length, view.along.curvature)
    return jnp.stack([strain, -strain])


def _crossing(view: View) -> Array:
    return jnp.where(view.anchored, view.sides * view.body.offset(view.arc_length) * view.along.curvature, 0.0)


def _tension(view: View) -> Array:
    """Beyond its anchor that at the anchor: what is least or largest along a tendon stays so."""
    return jnp.where(view.anchored, view.along.tension, view.equilibrium.tip_tension[:, None])


def _stiffness(direction: Callable[[Equilibrium], Any]) -> Callable[[View], Any]:
    def stiffness(view: View) -> Array:
        assert view.case is not None
        case, found = view.case, view.equilibrium
        loads = Loads() if case.loads is None else case.loads

        def tip(force: Array) -> Array:  # at constant base tensions, as in `tip_compliance`
            pushed = replace(loads, tip_force=force)
            there = solve(
                view.body, found.base_tension, pushed, direction=found.direction, nodes=view.nodes, throw=False
            )
            return there.tip_position

        way = direction(found)
        return 1.0 / (way @ jax.jacfwd(tip)(jnp.asarray(loads.tip_force)) @ way)

    return stiffness


def _across(found: Equilibrium) -> Array:
    return jnp.stack([-jnp.sin(found.tip_angle), jnp.cos(found.tip_angle)])


def _fixed(x: float, y: float) -> Callable[[Equilibrium], Any]:
    return lambda found: np.array([x, y])


QUANTITIES: dict[str, Quantity] = {
    "length": Quantity(lambda v: jnp.asarray(v.body.length), "length", bent=False),
    "volume": Quantity(_volume, "volume", bent=False),
    "mass": Quantity(_mass, "mass", bent=False),
    "outer_radius": Quantity(lambda v: _radius(v, 0), "length", False, True),
    "inner_radius": Quantity(lambda v: _radius(v, 1), "length", False, True),
    "wall_thickness": Quantity(_wall, "length", False, True),
    "clearance": Quantity(_clearance, "length", False, True, to_anchor=True),
    "taper": Quantity(lambda v: -_slope(v.body.radii, v.arc_length)[0], "dimensionless", False, True),
    "slope": Quantity(_slopes, "dimensionless", False, True),
    "curvature": Quantity(lambda v: v.along.curvature, "curvature", along=True),
    "heading": Quantity(lambda v: v.along.heading, "angle", along=True),
    "position": Quantity(lambda v: v.along.position.T, "length", along=True),
    "strain": Quantity(_strain, "dimensionless", along=True),
    "crossing": Quantity(_crossing, "dimensionless", along=True, to_anchor=True),
    "tension": Quantity(_tension, "force", along=True, to_anchor=True),
    "base_tension": Quantity(lambda v: v.equilibrium.base_tension, "force", per_tendon=True),
    "tip_tension": Quantity(lambda v: v.equilibrium.tip_tension, "force", per_tendon=True),
    "tension_loss": Quantity(lambda v: v.equilibrium.tension_loss, "dimensionless", per_tendon=True),
    "tendon_displacement": Quantity(lambda v: v.equilibrium.tendon_displacement, "length", per_tendon=True),
    "tip_angle": Quantity(lambda v: v.equilibrium.tip_angle, "angle"),
    "tip_position": Quantity(lambda v: v.equilibrium.tip_position, "length"),
    "tip_x": Quantity(lambda v: v.equilibrium.tip_position[0], "length"),
    "tip_y": Quantity(lambda v: v.equilibrium.tip_position[1], "length"),
    "tip_stiffness": Quantity(_stiffness(_across), "stiffness"),
    "tip_stiffness_x": Quantity(_stiffness(_fixed(1.0, 0.0)), "stiffness"),
    "tip_stiffness_y": Quantity(_stiffness(_fixed(0.0, 1.0)), "stiffness"),
}
