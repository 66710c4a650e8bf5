"""A body under load, ready to be solved from base to tip, and the values that are integrated along it.

The tensions at the base and the moment of the dead loads there, M_ext(0), determine everything outboard:
r_i = T_base,i / T_i grows with friction, Liu et al. (2020) eq. (8), and M_ext' = -(t x N). A drag w uses up
c_i of the base tension: T_i = (T_base,i - c_i) / r_i with c' = direction w r. This is variation of constants
in T' = -direction (mu theta' T + w). Both r and c stay regular where T is zero.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.arrays import zero_as
from ..numerics.elements import LARGEST_ORDER, Elements, elements_between, smooth_pieces
from ..numerics.fixed_point import without_derivative
from ..robot.cross_section import AnySection, SpatialSection, where_present
from ..robot.loads import Loads, PointLoad
from ..robot.manipulator import Manipulator, PointMass
from .friction import PerTendon, Pull, is_proportional, spent_rate, unspent
from .geometry import PLANE, SPACE, Geometry

APART = 64  # rounding errors of the length, between places that coincide
Number = Float[Array, ""]
Moment = Float[Array, "*components"]  # a number in the plane, (3,) in space
Heading = Float[Array, "..."]  # phi, rad, in the plane; a quaternion in space


class Joints(NamedTuple):
    """The cross-sections on both sides of the start of each element, where smooth pieces may meet; leading axis P."""

    before: AnySection
    after: AnySection
    turns: Bool[Array, " P"]  # of several joints at one place the last one, which an element with a length follows


class Outboard(NamedTuple):
    """The force N of all dead loads outboard of a cross-section, in newtons, and the moment on the tip.

    That is the force on the tip, the weight per length integrated from there to the tip, and the loads at points
    beyond.
    """

    starts: Float[Array, "P components"]
    nodes: Float[Array, "P p components"]
    tip: Float[Array, " components"]
    tip_moment: Moment  # m, N m, on the tip
    drops: "Drops | None" = None  # None without loads at points

    @property
    def ends(self) -> Float[Array, "P components"]:
        """N just before the end of each element."""
        following = self.starts[1:] if self.drops is None else self.starts[1:] + self.drops.force[1:]
        return jnp.concatenate([following, self.tip[None]])


class Drops(NamedTuple):
    """By how much N and M_ext fall at the start of an element: the loads at points that act there."""

    force: Float[Array, "P components"]  # N
    moment: Float[Array, "P *components"]  # N m


class Problem(eqx.Module):
    """A body under load, cut into elements, its cross-sections evaluated once."""

    manipulator: Manipulator
    base_tension: PerTendon
    direction: PerTendon
    elements: Elements
    points: AnySection  # at base, nodes and tip, along one axis
    nodes: AnySection  # leading axes: P elements, p nodes
    joints: Joints | None  # None where no tendon can turn by a finite angle
    loads: Loads | None
    outboard: Outboard  # zero without loads
    base_moment: Moment  # M_ext(0), N m; zero without loads
    moment_scale: Number  # E J / L at the base, N m
    rough: bool = eqx.field(default=False, static=True)  # whether kinks are passed over, for a first guess

    @property
    def geometry(self) -> Geometry:
        """The mechanics in the plane or in space; static."""
        return geometry_of(self.manipulator)

    @property
    def reverses(self) -> bool:
        """Whether the integrals allow for a tendon that turns to both sides along the body; static."""
        return not self.rough and self.geometry.reverses(self.manipulator, self.loads is not None)

    @property
    def has_kinks(self) -> bool:
        """Whether a tension may have a kink, where a tendon turns over or becomes slack; static."""
        return self.reverses or (self.manipulator.tendon_drag is not None and not self.rough)

    @property
    def is_quadrature(self) -> bool:
        """Whether theta' r, and with it r', is the same for every r; static.

        That is so where theta' and friction are proportional to T. For one tendon without loads theta' = d T / (E J):
        in the exact kinematics if the tendon is parallel to the neutral axis, in the published kinematics always,
        where theta' = |kappa / (1 - sigma d kappa)|.
        """
        alone = self.manipulator.num_tendons == 1 and self.loads is None and is_proportional(self.points)
        planar = not self.geometry.has_frames
        return alone and planar and self.geometry.has_closed_strain(self.manipulator, loaded=False)


class State(NamedTuple):
    """All values that are integrated along the body; leading axes may be elements and nodes."""

    pull: Pull
    heading: Any  # a `Heading`; during the march None in space without loads
    moment: Any  # M_ext, N m, in the fixed frame
    force: Any  # N, newtons, (*points, components); None in space without loads
    strain: Float[Array, "*points_and_strains"] | None  # the elastic strain, see `starts_of_newton`
    wrap_angle: Any = None  # theta, rad, (*points, tendons); None before all is `finished`
    position: Any = None  # u, m, (*points, components); likewise
    growth: Any = None  # the integral of theta' r, by which r grows over direction mu; None after all is `finished`

    @property
    def ratio(self) -> Float[Array, "*points tendons"]:
        """The ratio r."""
        return self.pull.ratio


class BodyStates(NamedTuple):
    """The states along the body."""

    starts: State  # at the start of every element
    nodes: State  # at every Gauss node
    ends: State  # at the end of every element


class Solution(eqx.Module):
    """The answer of a method: the states along the body, and how the iteration ended."""

    states: BodyStates
    num_iterations: Number
    residual: Number  # of the method itself, relative: the last change of the fixed point
    converged: Bool[Array, ""]
    locked: Bool[Array, ""]  # the tension of a tendon sliding out grows without bound
    missed: Number | float = 0.0  # by the nodes of all elements, see `truncation_error`; 0 for a rough problem

    @property
    def nodes(self) -> State:
        return self.states.nodes

    @property
    def tip(self) -> State:
        return jax.tree.map(lambda x: x[-1], self.states.ends)


class Nodal(NamedTuple):
    """The unknowns at the nodes, which each iteration improves; everything else follows from them."""

    ratio: Float[Array, "P p tendons"]  # r
    moment: Float[Array, "P p *components"] | None  # M_ext over its scale; None without loads
    frame: Float[Array, "P p 4"] | None = None  # the rotation of a body in space under loads


@runtime_checkable
class Method(Protocol):
    """A method that solves for shape and tension, from the base to the tip. Its settings are static.

    Its states hold the elastic strain of `starts_of_newton`.
    """

    def __call__(self, problem: Problem) -> Solution:
        """Solve to the end, for a given M_ext(0)."""
        ...


# --- a body, laid out ------------------------------------------------------------------------------


def geometry_of(manipulator: Manipulator) -> Geometry:
    """The mechanics in the plane or in space; static."""
    return SPACE if manipulator.in_space else PLANE


def lay_out(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    nodes: int,
    loads: Loads | None = None,
    rough: bool = False,
) -> Problem:
    """Cut the body into elements and evaluate its cross-sections.

    A rough problem passes over kinks: each smooth piece is one element.
    """
    geometry = geometry_of(manipulator)
    cut, apart = elements_of(manipulator, nodes, loads, rough), with_places_apart(manipulator, loads)
    there = cut if apart[0] is manipulator else elements_of(apart[0], nodes, apart[1], rough)
    nudge, last = cut.nudge, cut.edges[-1] - cut.nudge
    along = _sections(apart[0], jnp.concatenate([nudge[None], there.nodes.ravel(), last[None]]))
    joints = breakpoints_under(manipulator, loads).shape[0] > 0
    turns = joints and not geometry.has_closed_strain(manipulator, loads is not None)  # by a finite angle
    loaded = (cut, manipulator, loads) if turns else (there, *apart)  # all loads at one place turn a tendon at once
    return Problem(
        manipulator,
        base_tension,
        direction,
        cut,
        points=along,
        nodes=jax.tree.map(lambda x: x[1:-1].reshape(*cut.nodes.shape, *x.shape[1:]), along),
        joints=_joints(manipulator, cut) if turns else None,
        loads=loads,
        outboard=_outboard(cut, *loaded),
        base_moment=jnp.asarray(geometry.no_moment, cut.edges.dtype),
        moment_scale=geometry.bending_stiffness(along)[0] / cut.edges[-1],
        rough=rough,
    )


def _sections(manipulator: Manipulator, arc_length: Float[Array, " points"]) -> AnySection:
    return jax.vmap(lambda s: guarded_section(manipulator, s))(arc_length)


def _joints(manipulator: Manipulator, cut: Elements) -> Joints:
    starts, last = cut.edges[:-1], cut.edges[-1] - cut.nudge
    before = _sections(manipulator, jnp.maximum(starts - cut.nudge, 0.0))
    after = _sections(manipulator, jnp.minimum(starts + cut.nudge, last))
    return Joints(before, after, cut.width > cut.nudge)


def breakpoints_under(manipulator: Manipulator, loads: Loads | None) -> Float[Array, " n"]:
    """Arc lengths (m), unsorted, at which the body or a tendon is not smooth, or a load acts."""
    places = [] if loads is None else [jnp.asarray(point.arc_length)[None] for point in loads.points]
    return jnp.concatenate([manipulator.breakpoints, *places])


def with_places_apart(manipulator: Manipulator, loads: Loads | None) -> tuple[Manipulator, Loads | None]:
    """Body and loads, in which places that coincide are moved apart by little more than rounding errors.

    So each element lies between two places that follow one another, also where it has no width, and what changes at
    one place does not change at the next one. Derivatives by each of the places need that.
    """
    numbers, rest = eqx.partition((manipulator, loads), eqx.is_inexact_array)
    places, to_numbers = jax.vjp(lambda numbers: breakpoints_under(*eqx.combine(numbers, rest)), numbers)
    if places.size < 2:
        return manipulator, loads
    behind = jnp.sum(jnp.triu(places[:, None] == places, 1), axis=1)  # how many follow at the same place
    step = APART * float(jnp.finfo(places.dtype).eps) * jnp.asarray(manipulator.length)
    (moved,) = to_numbers((-step * behind).astype(places.dtype))
    moved = jax.tree.map(lambda x, change: x + jax.lax.stop_gradient(change), numbers, moved)
    return eqx.combine(moved, rest)


def elements_of(manipulator: Manipulator, nodes: int, loads: Loads | None, rough: bool = False) -> Elements:
    """Elements that end where the body or a tendon is not smooth, or a load acts.

    A smooth piece whose tendons always turn to one side is one element. Otherwise it has several with fewer nodes each,
    so that a kink disturbs one of them only. For a rough problem each piece is one element.
    """
    ends = smooth_pieces(jnp.asarray(manipulator.length), breakpoints_under(manipulator, loads))
    geometry = geometry_of(manipulator)
    kinks = geometry.reverses(manipulator, loads is not None) or manipulator.tendon_drag is not None
    if rough:
        return elements_between(ends, min(nodes, LARGEST_ORDER))
    if not kinks:
        return elements_between(ends, nodes)
    count, share = geometry.elements
    return elements_between(ends, count * round(share * nodes), count)


def _outboard(cut: Elements, there: Elements, manipulator: Manipulator, loads: Loads | None) -> Outboard:
    """The loads outboard of all elements.

    Args:
        cut: the elements.
        there: the same, where the places of body and loads lie apart.
        manipulator, loads: the body and its loads there.
    """
    geometry = geometry_of(manipulator)
    if loads is None:
        zero = jnp.zeros((*cut.nodes.shape, geometry.components), cut.edges.dtype)
        return Outboard(zero[:, 0], zero, zero[0, 0], jnp.asarray(geometry.no_moment, zero.dtype))
    edges, nodes = cut.integrate(load_rate(manipulator, there.nodes, loads))
    force = jnp.asarray(loads.tip_force)
    beyond = force + edges[-1]
    along = Outboard(beyond - edges[:-1], beyond - nodes, force, jnp.asarray(loads.tip_moment))
    points = loads_at_points(loads, manipulator.point_masses)
    return along if points is None else _with_points(along, there, points)


def _with_points(along: Outboard, cut: Elements, points: "AtPoints") -> Outboard:
    """The same with the loads at points, each of which lies where an element starts.

    At the tip itself N is that just before it.
    """
    places = points.arc_length.astype(cut.edges.dtype)
    starts, ends, tip = cut.edges[:-1, None], cut.edges[1:, None], cut.edges[-1]
    last = jnp.arange(starts.size)[:, None] == starts.size - 1
    at_start = jnp.where((starts == places) & ((ends > places) | last), 1.0, 0.0)
    beyond = jnp.where(starts < places, 1.0, 0.0) @ points.force
    at_tip = jnp.where(places == tip, 1.0, 0.0) @ points.force
    drops = Drops(at_start @ points.force, at_start @ points.moment)
    return Outboard(along.starts + beyond, along.nodes + beyond[:, None], along.tip + at_tip, along.tip_moment, drops)


class AtPoints(NamedTuple):
    """Dead loads at single places of the body."""

    arc_length: Float[Array, " points"]  # m
    force: Float[Array, "points components"]  # N
    moment: Float[Array, "points *components"]  # N m


def loads_at_points(loads: Loads, masses: Iterable[PointMass]) -> AtPoints | None:
    """The weights of point masses and the point loads; None where there are none."""
    gravity, none = jnp.asarray(loads.gravity), 0.0 * jnp.asarray(loads.tip_moment)
    weights = [PointLoad(mass.arc_length, jnp.asarray(mass.mass) * gravity, none) for mass in masses]
    if not (every := [*weights, *loads.points]):
        return None
    place, force, moment = zip(*((each.arc_length, each.force, each.moment) for each in every), strict=True)
    return AtPoints(*(jnp.stack([jnp.asarray(x) for x in values]) for values in (place, force, moment)))


def load_rate(manipulator: Manipulator, arc_length: Array, loads: Loads) -> Float[Array, "*points components"]:
    """The sum of all distributed dead loads, N/m: the weight of the body."""
    return manipulator.distributed_mass(arc_length)[..., None] * jnp.asarray(loads.gravity)


def loaded_to(problem: Problem, fraction: Number, base_moment: Moment) -> Problem:
    """The problem under a fraction of all dead loads, with a value of M_ext(0), N m."""
    outboard = jax.tree.map(lambda x: fraction * x, problem.outboard)
    return eqx.tree_at(lambda problem: (problem.outboard, problem.base_moment), problem, (outboard, base_moment))


def with_tip_force(problem: Problem, tip_force: Float[Array, " components"]) -> Problem:
    """The problem with another force on its tip."""
    more = tip_force - problem.outboard.tip
    old = problem.outboard
    new = old._replace(starts=old.starts + more, nodes=old.nodes + more, tip=old.tip + more)
    return eqx.tree_at(lambda problem: problem.outboard, problem, new)


def guarded_section(manipulator: Manipulator, arc_length: Number) -> AnySection:
    """The cross-section. EJ is replaced by 1 where it is not positive, so that all numbers are finite."""
    at = manipulator.cross_section_in_space if manipulator.in_space else manipulator.cross_section
    section = at(arc_length)
    stiffness = jnp.where(section.stiffness > 0, section.stiffness, 1.0)
    return eqx.tree_at(lambda section: section.stiffness, section, stiffness)


# --- values along the body -------------------------------------------------------------------------


def geometry_at(section: AnySection) -> Geometry:
    """The mechanics of a cross-section; static."""
    return SPACE if isinstance(section, SpatialSection) else PLANE


def tension_of(section: AnySection, base_tension: PerTendon, pull: Pull) -> PerTendon:
    """T, N, zero beyond the anchor. Beyond the point where a tendon locks r is negative; |r| takes its place."""
    size = jnp.maximum(jnp.abs(pull.ratio), jnp.finfo(pull.ratio.dtype).eps)
    return where_present(section, unspent(base_tension, pull) / size)


def strain_of(section: AnySection, base_tension: PerTendon, state: State) -> Array:
    """The curvature kappa, 1/m, at one cross-section; of a body in space its strain, (strains,)."""
    tension = tension_of(section, base_tension, state.pull)
    return geometry_at(section).strain(section, tension, state.heading, state.moment, state.force, state.strain)


def ones_at_base(problem: Problem) -> PerTendon:
    """Ones: r at the base. Under shard_map it varies over the same devices as r further outboard."""
    there = problem.points, problem.base_tension, problem.direction, problem.base_moment, problem.outboard.tip
    return jnp.ones_like(problem.base_tension) + zero_as(there)


def nodal(problem: Problem, state: State) -> Nodal:
    """The unknowns of a state; those at the nodes are where the next iteration starts."""
    if problem.loads is None:
        return Nodal(state.ratio, None)
    return Nodal(
        state.ratio, state.moment / problem.moment_scale, state.heading if problem.geometry.has_frames else None
    )


def starts_of_newton(problem: Problem, elastic: Array) -> tuple[Array | None, Array | None, Array | None]:
    """The elastic strain as states hold it: at the starts, the nodes and the ends of the elements, without derivatives.

    It is approximate, and one step of Newton's method improves it. None where the strain has a closed form, which is
    static.

    Args:
        problem: the body.
        elastic: the strain at the nodes, less that at rest.
    """
    if problem.geometry.has_closed_strain(problem.manipulator, problem.loads is not None):
        return None, None, None
    nodes = without_derivative(elastic)
    starts, ends = problem.elements.at_starts_and_ends(nodes)
    return starts, nodes, ends


def line_up(base: Array, nodes: Array, tip: Array) -> Array:
    """Base, Gauss nodes and tip in one row of points."""
    return jnp.concatenate([base[None], nodes.reshape(-1, *base.shape), tip[None]])


def all_points(problem: Problem, states: BodyStates) -> tuple[AnySection, State]:
    """The cross-sections and states at base, Gauss nodes and tip."""
    base, tip = (jax.tree.map(lambda x, at=at: x[at], ends) for ends, at in ((states.starts, 0), (states.ends, -1)))
    return problem.points, jax.tree.map(line_up, base, states.nodes, tip)


def fibres_cross(problem: Problem, states: BodyStates) -> Bool[Array, ""]:
    """Whether sigma d kappa of a tendon that is present reaches 1 at a node or at an end of an element.

    In space it is by how much the fibre at the tendon is shorter than the axis at rest.
    """
    strain = strain_along(problem.nodes, problem.base_tension, states.nodes)
    inside = where_present(problem.nodes, at_nodes(problem.geometry.inside, (0, 0))(problem.nodes, strain))
    return jnp.any(inside >= 1.0) | jnp.any(problem.elements.at_starts_and_ends(inside) >= 1.0)


def at_nodes(function: Callable[..., Array], in_axes: tuple[int | None, ...]) -> Callable[..., Array]:
    """A function of one cross-section, mapped over elements and nodes."""
    return jax.vmap(jax.vmap(function, in_axes), in_axes)


strain_along = at_nodes(strain_of, (0, None, 0))


def state_at_nodes(problem: Problem, values: Nodal, strain: Array | None) -> State:
    """The state at the nodes of a loaded body that follows from the unknowns alone, with a given elastic strain."""
    spending = spent_rate(problem.direction, problem.nodes, values.ratio)
    pull = Pull(values.ratio, None if spending is None else problem.elements.integrate(spending)[1])
    assert values.moment is not None
    heading = jnp.zeros_like(values.ratio[..., 0]) if values.frame is None else values.frame
    return State(pull, heading, problem.moment_scale * values.moment, problem.outboard.nodes, strain)
