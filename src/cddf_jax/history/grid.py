"""A body on a grid of nodes: equilibrium at the nodes, friction between them.

Tensions and strains belong to the nodes, slips to the elements between them. With the weights of the trapezoidal rule
the jump of a tension across an element and the slip of the tendon there are work-conjugate. A joint is an element
without length, across which a tendon may turn. One more element without length follows the tip, and where tendons
have friction outside the body, one comes before the base: tensions there are those at the actuators.

A body with friction of its own keeps its strain until that without this friction differs by more than a limit from it,
and follows at this distance (a play operator in the curvature, in space in both its components at once).
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.friction import PerTendon
from ..mechanics.geometry import Geometry
from ..mechanics.problem import breakpoints_under, geometry_of, guarded_section, load_rate, loads_at_points
from ..numerics import tolerances as tol
from ..numerics.elements import smooth_pieces
from ..robot.cross_section import AnySection, where_present
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator

Number = Float[Array, ""]
STIFFEST = 1e-7  # the least strain of a tendon per tension, over d^2 / (E J), its slip per tension by bending


class Goal(NamedTuple):
    """What is given of a driven tendon in place of its tension; static."""

    tendon: int  # its index, from 0
    quantity: str  # displacement, tip_angle, tip_tension or total_tension


class Node(NamedTuple):
    """The unknowns at a node. Those of all nodes have a leading axis K + 1; the last node is beyond the tip."""

    tension: PerTendon  # T, N
    heading: Array | None  # phi, rad, or a quaternion; None without loads, where nothing depends on it
    slip: PerTendon  # w, m, of the element before: how far the tendon has moved through the body towards the base
    moment: Array | None  # M_ext, N m; None without loads


class Outside(NamedTuple):
    """The friction of the tendons before the base, by elements; zero in all others."""

    here: Float[Array, " K"]  # 1 in the element before the base
    friction: PerTendon  # (K, tendons), mu times wrap angle
    drag: PerTendon  # (K, tendons), N


class Given(NamedTuple):
    """What acts on the body at one instant."""

    base_tension: PerTendon  # N
    goal: PerTendon  # of a driven tendon: what is given in place of its tension, m, rad or N
    by_goal: PerTendon  # of a driven tendon: 1 where the goal sets it, 0 where its base tension does
    force: Float[Array, "K components"] | None  # N of the loads beyond the middle of each element, N; None without
    moment: Float[Array, "K *components"] | None  # of the loads at points, by the element across which they act, N m
    tip_moment: Array | None  # N m


class Grid(eqx.Module):
    """The K nodes of a body, and the elements behind them, the last of which has no length."""

    manipulator: Manipulator
    places: Float[Array, " K"]  # s, m
    sections: AnySection  # leading axis K
    weights: Float[Array, " K"]  # of the trapezoidal rule, m
    widths: Float[Array, " K"]  # of the element after each node, m
    stretch: PerTendon  # strain of each tendon per tension, 1/N
    free_stretch: PerTendon  # elongation per tension of the tendon outside the body, m/N
    outside: Outside | None  # None where no tendon has friction before the base

    @property
    def geometry(self) -> Geometry:
        return geometry_of(self.manipulator)

    @property
    def scale(self) -> Number:
        """The length to which slips are compared: the largest offset, m."""
        return jnp.max(jnp.abs(self.sections.offset))

    @property
    def softness(self) -> Number:
        """The length per tension, m/N, by which tensions are compared with displacements."""
        return self.places[-1] * self.scale**2 / self.geometry.bending_stiffness(self.sections)[0]

    def pulled_in(self, nodes: Node) -> PerTendon:
        """The displacement of each tendon at its actuator, m."""
        return nodes.slip[0] + self.free_stretch * nodes.tension[0]

    def reading(self, nodes: Node, goal: Goal) -> Number:
        """What is given of a driven tendon; the tip angle needs the headings of a body under loads."""
        if goal.quantity == "tip_angle":
            assert nodes.heading is not None
            return self.geometry.tip_angle(nodes.heading[-1])
        if goal.quantity == "total_tension":
            return jnp.sum(nodes.tension[0])
        return (nodes.tension[-1] if goal.quantity == "tip_tension" else self.pulled_in(nodes))[goal.tendon]

    def as_length(self, goal: Goal) -> Number | float:
        """The length, m, that stands for one unit of a goal."""
        return {"displacement": 1.0, "tip_angle": self.scale}.get(goal.quantity, self.softness)

    def free_strain(self, node: Node, section: AnySection, force: Array | None) -> Array:
        """The strain of a cross-section in equilibrium, without friction of the body."""
        tension = where_present(section, node.tension)
        moment = jnp.asarray(self.geometry.no_moment, tension.dtype) if node.moment is None else node.moment
        return self.geometry.strain(section, tension, node.heading, moment, force, None)

    def at(self, node: Node, section: AnySection, force: Array | None, held: Array | None) -> tuple[Array, PerTendon]:
        """The strain of a cross-section in equilibrium, and the slip per arc length of its tendons.

        `held`: the strain before, or this strain itself; None without friction of the body.
        """
        strain = self._held_back(section, self.free_strain(node, section, force), held)
        return strain, self.geometry.slip_rate(section, strain, where_present(section, node.tension), self.stretch)

    def _held_back(self, section: AnySection, free: Array, held: Array | None) -> Array:
        """The strain that friction of the body leaves behind that without it."""
        if held is None:
            return free
        limit = jnp.asarray(self.manipulator.friction_moment) / self.geometry.bending_stiffness(section)
        apart = self.geometry.bending_part(free - held)
        size = jnp.sum(apart**2)
        follows = size > (limit + tol.HELD * (limit + jnp.max(jnp.abs(free)))) ** 2
        share = limit / jnp.sqrt(jnp.where(follows, size, 1.0))
        return jnp.where(follows, free - share * apart, held + (free - held - apart))

    def at_all(self, nodes: Node, force: Array | None, held: Array | None) -> tuple[Array, Array]:
        """As `at`, for all K nodes."""
        return jax.vmap(self.at)(jax.tree.map(lambda x: x[:-1], nodes), self.sections, force, held)

    def moment_of_friction(self, nodes: Node, force: Array | None, held: Array) -> Float[Array, "K *strains"]:
        """By which friction of the body holds against the bending moment, N m, in the frame of each cross-section."""
        free = jax.vmap(self.free_strain)(jax.tree.map(lambda x: x[:-1], nodes), self.sections, force)
        return self.sections.stiffness * self.geometry.bending_part(free - held)

    def elements(self, given: Given, held: Array | None) -> "Element":
        def pairs(values: Array) -> Array:
            return jnp.stack([values, jnp.concatenate([values[1:], values[-1:]])], axis=1)

        sections, held = jax.tree.map(pairs, (self.sections, held))
        return Element(sections, held, self.weights, self.widths, given.force, given.moment, self.outside)


def cut_into_elements(
    manipulator: Manipulator, count: int, loads: Loads | None = None, merged: Number | float = 0.0
) -> Grid:
    """`count` elements in each smooth piece of the body, and one between two pieces.

    Args:
        manipulator: the body.
        count: number of elements; static.
        loads: pieces end where they act at points.
        merged: 1 to give every second element no length, so that the others are twice as long; else 0.
    """
    ends = smooth_pieces(jnp.asarray(manipulator.length), breakpoints_under(manipulator, loads))
    numbers = jnp.arange(count + 1)
    fractions = (numbers - merged * (numbers % 2)) / count
    starts, lengths = ends[:-1, None], jnp.diff(ends)[:, None]
    places = jnp.where(fractions == 1, ends[1:, None], starts + lengths * fractions)  # exactly, for loads there
    inside = starts + lengths * jnp.clip(fractions, 1e-9, 1 - 1e-9)  # a joint has a cross-section on either side
    widths = jnp.diff(places, axis=1)
    none = jnp.zeros_like(starts)
    behind, ahead = jnp.concatenate([none, widths], axis=1), jnp.concatenate([widths, none], axis=1)
    sections = jax.vmap(partial(guarded_section, manipulator))(inside.ravel())
    compliance, free = manipulator.tendon_compliance, manipulator.tendon_outside_compliance
    outside, places, weights, widths = None, places.ravel(), ((behind + ahead) / 2).ravel(), ahead.ravel()
    if manipulator.rubs_outside:
        places, sections = jax.tree.map(lambda x: jnp.concatenate([x[:1], x]), (places, sections))
        weights, widths = (jnp.concatenate([jnp.zeros_like(x[:1]), x]) for x in (weights, widths))
        outside = _outside(manipulator, places.size)
    grid = Grid(manipulator, places, sections, weights, widths, compliance, free, outside)
    # where tendons that do not stretch rest together, their tensions are those of equal, very stiff tendons
    stiffest = STIFFEST * grid.softness / grid.places[-1]
    return eqx.tree_at(lambda grid: grid.stretch, grid, jnp.maximum(compliance, stiffest))


def _outside(manipulator: Manipulator, count: int) -> Outside:
    """The friction before the base, for `count` elements of which it is the first."""
    here = jnp.zeros_like(jnp.asarray(manipulator.length), shape=count).at[0].set(1.0)

    def of_tendons(name: str) -> PerTendon:
        own = (getattr(tendon, name) for tendon in manipulator.tendons)
        return here[:, None] * jnp.stack([jnp.asarray(0.0 if number is None else number) for number in own])

    return Outside(here, of_tendons("outside_friction"), of_tendons("outside_drag"))


def loads_on(grid: Grid, loads: Loads) -> tuple[Float[Array, "K components"], Float[Array, "K *components"]]:
    """The force N of the dead loads beyond the middle of each element, N, and the moments across it, N m."""
    body, places = grid.manipulator, grid.places
    rate, tip = load_rate(body, places, loads), jnp.asarray(loads.tip_force)
    gains = grid.widths[:, None] * (rate + jnp.concatenate([rate[1:], rate[-1:]])) / 2
    force = tip + jnp.cumsum(gains[::-1], axis=0)[::-1] - gains / 2
    points = loads_at_points(loads, body.point_masses)
    if points is None:
        return force, jnp.multiply.outer(0.0 * places, jnp.asarray(loads.tip_moment))
    outboard = jnp.where((places + grid.widths / 2)[:, None] < points.arc_length.astype(places.dtype), 1.0, 0.0)
    beyond = outboard @ points.moment
    return force + outboard @ points.force, jnp.concatenate([beyond[:1], beyond[:-1]]) - beyond


class Element(NamedTuple):
    """The known numbers of an element."""

    sections: AnySection  # at its ends; leading axis 2
    held: Array | None  # the strains there before; None without friction of the body
    weight: Number  # of the node before it, m
    width: Number  # m
    force: Array | None  # of the loads beyond its middle, N
    moment: Array | None  # of the loads at a point, between its ends, N m
    outside: Outside | None


class Missing(NamedTuple):
    """What is missing in the equations of an element, and the numbers that its friction depends on."""

    slip: PerTendon  # m
    heading: Array | None
    moment: Array | None  # N m
    limit: PerTendon  # C, the largest |T_k - T_k+1|, N


class Along(NamedTuple):
    """Values along an element."""

    strain: Array  # its mean
    slip_rate: PerTendon  # at its start
    turn: PerTendon  # by which the tendons turn, rad
    step: Array | None  # the change of the position along it, m; None without loads


def along(grid: Grid, element: Element, start: Node, end: Node) -> Along:
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), start, end)
    strains, slips = jax.vmap(grid.at, (0, 0, None, 0))(both, element.sections, element.force, element.held)
    mean, turn = jnp.mean(strains, axis=0), grid.geometry.turned(element.width, element.sections, strains)
    step = None
    if start.heading is not None:
        middle = grid.geometry.turned_on(start.heading, element.width / 2 * mean)
        step = element.width * grid.geometry.axis(middle, mean)
    return Along(mean, slips[0], turn, step)


def missing(grid: Grid, element: Element, start: Node, end: Node) -> Missing:
    """The residuals of an element: of the sum of the slips, of heading and moment.

    The limit of friction is that at which T falls by the factor exp(mu turn), Liu et al. (2020) eq. (8), and by the
    drag.
    """
    there, geometry = along(grid, element, start, end), grid.geometry
    before, beyond = jax.tree.map(lambda x: x[0], element.sections), jax.tree.map(lambda x: x[1], element.sections)
    exponent, constant = before.friction_coefficient * there.turn, 0.0
    if before.drag is not None:
        constant = element.width * before.drag
    if element.outside is not None:
        exponent = (1.0 - element.outside.here) * exponent + element.outside.friction
        constant = constant + element.outside.drag
    limit = jnp.tanh(exponent / 2) * (start.tension + end.tension) + constant
    limit = where_present(before, where_present(beyond, limit))
    heading = moment = None
    if there.step is not None and element.force is not None:  # under loads
        assert start.heading is not None
        assert end.heading is not None
        assert start.moment is not None
        assert end.moment is not None
        assert element.moment is not None
        heading = end.heading - geometry.turned_on(start.heading, element.width * there.strain)
        moment = end.moment - start.moment - geometry.moment_rate(there.step, element.force) + element.moment
    slip = start.slip - end.slip - element.weight * there.slip_rate
    return Missing(slip, heading, moment, limit)
