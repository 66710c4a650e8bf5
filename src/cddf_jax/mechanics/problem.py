"""A body under load, ready to be solved from base to tip, and the equations at each of its cross-sections.

The tensions at the base and the moment of the dead loads there, M_ext(0), determine everything outboard:
r_i = T_base,i / T_i grows with friction, Liu et al. (2020) eq. (8), and M_ext' = -(t x N). A drag w uses up
c_i of the base tension: T_i = (T_base,i - c_i) / r_i with c' = direction w r. This is variation of constants
in T' = -direction (mu theta' T + w). Both r and c stay regular where T is zero.

First the types and how a `Problem` is laid out on panels; then functions of one cross-section, which the methods
integrate.
"""

from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeAlias, TypeVar, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.arrays import cos_sin, zero_as
from ..numerics.implicit import without_derivative
from ..numerics.quadrature import Panels, panels, panels_between
from ..numerics.rotations import IDENTITY, in_own_frame
from ..robot.cross_section import AnySection, SpatialSection, where_present
from ..robot.loads import Loads, force_at_points, force_per_length, planar_cross
from ..robot.manipulator import Manipulator
from . import bending, space
from .friction import PerTendon, Pull, is_proportional, ratio_beyond, spent_rate, unspent

Number = Float[Array, ""]
Moment = Float[Array, "*components"]  # a number in the plane, (3,) in space
Heading = Float[Array, "..."]  # phi, rad, in the plane; a quaternion in space


class Joints(NamedTuple):
    """The cross-sections on both sides of the start of each panel, where two smooth pieces may meet; leading axis P."""

    before: AnySection
    after: AnySection


class Outboard(NamedTuple):
    """The force N of all dead loads outboard of a cross-section, in newtons, and the moment on the tip.

    That is the force on the tip, the weight per length integrated from there to the tip, and the point masses beyond.
    """

    starts: Float[Array, "P components"]
    nodes: Float[Array, "P p components"]
    tip: Float[Array, " components"]
    tip_moment: Moment  # m, N m, on the tip
    # by how much N falls at the start of a panel; None without point masses
    drops: Float[Array, "P components"] | None = None


class Problem(eqx.Module):
    """A body under load, cut into panels, its cross-sections evaluated once."""

    manipulator: Manipulator
    base_tension: PerTendon
    direction: PerTendon
    panels: Panels
    points: AnySection  # at base, nodes and tip, along one axis
    nodes: AnySection  # leading axes: P panels, p nodes
    joints: Joints | None  # None where no tendon can turn by a finite angle
    loads: Loads | None
    outboard: Outboard  # zero without loads
    base_moment: Moment  # M_ext(0), N m; zero without loads
    moment_scale: Number  # E J / L at the base, N m

    @property
    def base(self) -> AnySection:
        """The cross-section at the base."""
        return jax.tree.map(lambda x: x[0], self.points)

    @property
    def tip(self) -> AnySection:
        """The cross-section at the tip."""
        return jax.tree.map(lambda x: x[-1], self.points)

    @property
    def in_space(self) -> bool:
        """Whether the body may leave the plane; static."""
        return self.manipulator.in_space

    @property
    def is_quadrature(self) -> bool:
        """Whether theta' r, and with it r', is the same for every r; static.

        That is so where theta' and friction are proportional to T. For one tendon without loads theta' = d T / (E J):
        in the exact kinematics if the tendon is parallel to the neutral axis, in the published kinematics always,
        where theta' = |kappa / (1 - sigma d kappa)|.
        """
        body = self.manipulator
        if body.in_space:
            return False
        straight = body.kinematics == "published" or not body.slanted
        return body.num_tendons == 1 and straight and self.loads is None and is_proportional(self.points)


class PassState(NamedTuple):
    """The values that a pass integrates along the body; leading axes may be panels and nodes."""

    pull: Pull
    heading: Heading  # the identity where a pass in space without loads does not need it
    moment: Float[Array, "..."]  # M_ext, N m, in the fixed frame
    force: Float[Array, "*points components"] | None  # force N, newtons; None in space without loads
    strain: Float[Array, "*points_and_strains"] | None  # the elastic strain, approximately; see `unstrained`

    @property
    def ratio(self) -> Float[Array, "*points tendons"]:
        """The ratio r."""
        return self.pull.ratio


class State(NamedTuple):
    """All values that are integrated along the body: those of a pass, and at the end wrap angle and position."""

    pull: Pull
    heading: Heading
    moment: Float[Array, "..."]  # M_ext, N m, in the fixed frame
    force: Float[Array, "*points components"] | None  # force N, newtons; None in space without loads
    strain: Float[Array, "*points_and_strains"] | None  # as in a pass
    wrap_angle: Float[Array, "*points tendons"]  # theta, rad
    position: Float[Array, "*points components"]  # u, m

    @property
    def ratio(self) -> Float[Array, "*points tendons"]:
        """The ratio r."""
        return self.pull.ratio


AnyState: TypeAlias = PassState | State
Kind = TypeVar("Kind", bound=AnyState, covariant=True)


class Solution(eqx.Module, Generic[Kind]):
    """The answer of a method: the state along the body, and how the iteration ended."""

    starts: Kind  # at the start of every panel
    nodes: Kind  # at every Gauss node
    tip: Kind
    num_iterations: Number
    residual: Number  # of the method itself, relative: the last change of the fixed point
    converged: Bool[Array, ""]
    locked: Bool[Array, ""]  # the tension of a tendon sliding out grows without bound


class Nodal(NamedTuple):
    """The unknowns at the nodes, which each pass improves; everything else follows from them."""

    ratio: Float[Array, "P p tendons"]  # r
    moment: Float[Array, "P p *components"] | None  # M_ext over its scale; None without loads
    frame: Float[Array, "P p 4"] | None = None  # the rotation of a body in space under loads


@runtime_checkable
class Method(Protocol):
    """A method that solves for shape and tension, from the base to the tip. Its settings are static.

    Its states hold the elastic strain of `starts_of_newton`; each pass takes the strain of the pass before.
    """

    max_passes: int  # calls of `improve` in one try

    def __call__(self, problem: Problem) -> Solution[State]:
        """Solve to the end."""
        ...

    def improve(
        self, problem: Problem, guess: Nodal, strain: Array | None = None, before: Number | float = 0.0
    ) -> Solution[AnyState]:
        """One pass from a guess; `converged` if its result is the solution. Without passes it solves to the end.

        `before` is the relative change in the pass before, 0 if there was none. It shows how fast passes converge.
        """
        ...

    def finish(self, problem: Problem, guess: Nodal, strain: Array | None = None) -> Solution[State]:
        """As `improve`, with wrap angle and position."""
        ...


def lay_out(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    nodes: int,
    loads: Loads | None = None,
    splits: Float[Array, " splits"] | None = None,
    cut: Panels | None = None,
) -> Problem:
    """Cut the body into panels, at `splits` as well, unless `cut` holds them, and evaluate its cross-sections."""
    cut = cut_into_panels(manipulator, nodes, splits) if cut is None else cut
    nudge = edge_nudge(cut)
    section = jax.vmap(lambda s: guarded_section(manipulator, s))
    along = section(jnp.concatenate([nudge[None], cut.nodes.ravel(), cut.edges[-1:] - nudge]))
    turns = _may_turn_at_joints(manipulator, loads) and manipulator.breakpoints.shape[0] > 0
    starts = cut.edges[:-1]
    inside = jnp.minimum(starts + nudge, cut.edges[-1] - nudge)  # a tendon that ends at the tip causes no turn there
    return Problem(
        manipulator,
        base_tension,
        direction,
        cut,
        points=along,
        nodes=jax.tree.map(lambda x: x[1:-1].reshape(*cut.nodes.shape, *x.shape[1:]), along),
        joints=Joints(section(jnp.maximum(starts - nudge, 0.0)), section(inside)) if turns else None,
        loads=loads,
        outboard=_outboard(manipulator, cut, loads, splits),
        base_moment=jnp.zeros((3,) if manipulator.in_space else (), cut.edges.dtype),
        moment_scale=bending_stiffness(along)[0] / cut.edges[-1],
    )


def _may_turn_at_joints(manipulator: Manipulator, loads: Loads | None) -> bool:
    """Whether a tendon may turn by a finite angle where the body is not smooth; static.

    A slanted tendon does so in the exact kinematics, and in space every tendon of a body that twists.
    """
    twisted = manipulator.in_space and (loads is not None or manipulator.rest_curvature is not None)
    return manipulator.kinematics == "exact" and (manipulator.slanted or twisted)


def bending_stiffness(section: AnySection) -> Float[Array, "*points"]:
    """E J, N m^2."""
    return section.stiffness[..., 1] if isinstance(section, SpatialSection) else section.stiffness


def cut_into_panels(manipulator: Manipulator, nodes: int, splits: Float[Array, " splits"] | None = None) -> Panels:
    """Panels that end where the body or a tendon is not smooth, and at `splits` as well."""
    if manipulator.point_masses:
        return panels_between(jnp.sort(_joints(manipulator, splits)), nodes)
    breaks = manipulator.breakpoints
    return panels(jnp.asarray(manipulator.length), breaks if splits is None else jnp.append(breaks, splits), nodes)


def _joints(manipulator: Manipulator, splits: Float[Array, " splits"] | None) -> Float[Array, " joints"]:
    """Base, breakpoints, splits and tip, unsorted; a breakpoint at an end keeps its own derivative."""
    length = jnp.asarray(manipulator.length)
    points = [manipulator.breakpoints.astype(length.dtype), *([] if splits is None else [splits])]
    points = jnp.concatenate(points)
    points = jnp.where(points > length, length, jnp.where(points < 0, 0.0, points))
    return jnp.concatenate([jnp.zeros_like(length)[None], points, length[None]])


def _outboard(manipulator: Manipulator, cut: Panels, loads: Loads | None, splits: Array | None) -> Outboard:
    if loads is None:
        zero = jnp.zeros((*cut.nodes.shape, 3 if manipulator.in_space else 2), cut.edges.dtype)
        return Outboard(zero[:, 0], zero, zero[0, 0], zero[0, 0] if manipulator.in_space else zero[0, 0, 0])
    edges, nodes = cut.integrate(load_rate(manipulator, cut.nodes, loads))
    force = jnp.asarray(loads.tip_force)
    beyond = force + edges[-1]
    along = Outboard(beyond - edges[:-1], beyond - nodes, force, jnp.asarray(loads.tip_moment))
    return _with_point_masses(along, manipulator, cut, loads, splits) if manipulator.point_masses else along


def _with_point_masses(
    along: Outboard, manipulator: Manipulator, cut: Panels, loads: Loads, splits: Array | None
) -> Outboard:
    """The same with the weights of the point masses, each of which lies where a panel starts.

    The panel follows from the rank of the mass among the joints, also where joints coincide, so that derivatives by its
    arc length hold there. At the tip itself N is that just before it.
    """
    masses = manipulator.point_masses
    weight = force_at_points(loads, jnp.stack([jnp.asarray(point.mass) for point in masses]))
    joints = _joints(manipulator, splits)
    last = manipulator.breakpoints.shape[0] + 1
    rank = jnp.argsort(jnp.argsort(joints))[last - len(masses) : last]
    panel, start = jnp.arange(cut.edges.shape[0] - 1)[:, None], rank * ((cut.edges.shape[0] - 1) // (joints.size - 1))
    beyond = jnp.where(panel < start, 1.0, 0.0) @ weight
    at_tip = jnp.where(joints[last - len(masses) : last] == cut.edges[-1], 1.0, 0.0) @ weight
    drops = jnp.where(panel == start, 1.0, 0.0) @ weight
    return Outboard(along.starts + beyond, along.nodes + beyond[:, None], along.tip + at_tip, along.tip_moment, drops)


def load_rate(manipulator: Manipulator, arc_length: Array, loads: Loads) -> Float[Array, "*points components"]:
    """The distributed dead loads per length, N/m."""
    return force_per_length(loads, manipulator.distributed_mass(arc_length))


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


def edge_nudge(cut: Panels) -> Number:
    """A step away from an edge, m, just large enough that rounding does not confuse the two sides of the edge."""
    return 8 * float(jnp.finfo(cut.edges.dtype).eps) * cut.edges[-1]


# --- one cross-section ---------------------------------------------------------------------------


def tension_of(section: AnySection, base_tension: PerTendon, pull: Pull) -> PerTendon:
    """T, N, zero beyond the anchor. Beyond the point where a tendon locks r is negative; |r| takes its place."""
    size = jnp.maximum(jnp.abs(pull.ratio), jnp.finfo(pull.ratio.dtype).eps)
    return where_present(section, unspent(base_tension, pull) / size)


def strain_of(section: AnySection, base_tension: PerTendon, state: AnyState) -> Array:
    """The curvature kappa, 1/m, at one cross-section; of a body in space its strain, (strains,)."""
    tension = tension_of(section, base_tension, state.pull)
    if isinstance(section, SpatialSection):
        wrench = wrench_of(section, state.heading, state.moment, state.force)
        return space.strain(section, tension, wrench, state.strain)
    return bending.curvature(section, tension, state.moment, state.strain)


def wrench_of(
    section: SpatialSection, frame: Heading | None, moment: Array, force: Array | None
) -> space.Wrench | None:
    """Moment and force of the loads on a cross-section in space, in its own frame; None without loads."""
    if frame is None or force is None:
        return None
    return space.Wrench(in_own_frame(frame, moment), in_own_frame(frame, force) if section.extensible else None)


def moment_rate_of(
    heading: Float[Array, "*points"], force: Float[Array, "*points 2"] | None
) -> Float[Array, "*points"]:
    """M_ext' = -(t x N), N, in the plane."""
    assert force is not None
    return -planar_cross(axis_of(heading), force)


def axis_of(heading: Float[Array, "*points"]) -> Float[Array, "*points 2"]:
    """The unit vector t along the neutral axis."""
    return jnp.stack(cos_sin(heading), axis=-1)


def spent_scale(problem: Problem, tip: Pull) -> PerTendon | None:
    """The scale of c, N: base tension plus c at the tip, or 1 where both are zero; None without drag."""
    if tip.spent is None:
        return None
    scale = problem.base_tension + jnp.abs(tip.spent)
    return jnp.where(scale > 0, scale, 1.0)


def turn_at_joint(
    problem: Problem, joint: Joints | None, pull: Pull, moment: Array, frame: Array | None, force: Array
) -> tuple[PerTendon, PerTendon]:
    """The finite angle by which a tendon turns where two pieces meet (exact kinematics), and r beyond it."""
    ratio = pull.ratio
    if joint is None:
        return jnp.zeros_like(ratio), ratio
    before, after = joint
    wrench = wrench_of(before, frame, moment, force) if isinstance(before, SpatialSection) else None

    def pointing(section, ratio):
        tension = tension_of(section, problem.base_tension, pull._replace(ratio=ratio))
        if isinstance(section, SpatialSection):
            return space.tangents(section, space.strain(section, tension, wrench))
        return bending.tangent_angle(section, bending.curvature(section, tension, moment))

    between = space.turn_between if problem.in_space else lambda one, other: jnp.abs(other - one)
    arriving = pointing(before, ratio)

    def improve(_, guess):  # r beyond changes the angle there by mu d d' kappa only, so this converges fast
        turn = where_present(after, between(arriving, pointing(after, guess[1])))
        return turn, ratio_beyond(problem.direction, before, turn, ratio)

    return jax.lax.fori_loop(0, 6, improve, (jnp.zeros_like(ratio), ratio + zero_as(arriving)))


def ones_at_base(problem: Problem) -> PerTendon:
    """Ones: r at the base. Under shard_map it varies over the same devices as r further outboard."""
    there = problem.points, problem.base_tension, problem.direction, problem.base_moment, problem.outboard.tip
    return jnp.ones_like(problem.base_tension) + zero_as(there)


def at_base(problem: Problem) -> Nodal:
    """The unknowns at the base."""
    ones = ones_at_base(problem)
    moment = problem.base_moment / problem.moment_scale + zero_as(ones)
    if problem.loads is None:
        return Nodal(ones, None)
    return Nodal(ones, moment, identity_as(ones) if problem.in_space else None)


def unloaded(manipulator: Manipulator, ones: PerTendon, loads: Loads | None) -> Nodal:
    """The unknowns at any point of a body without friction, on which the loads do not act yet.

    Args:
        manipulator: the body.
        ones: r.
        loads: that will act; None for none.
    """
    zero = zero_as(ones)
    if loads is None:
        return Nodal(ones, None)
    return Nodal(ones, zero + jnp.zeros(3), identity_as(ones)) if manipulator.in_space else Nodal(ones, zero)


def identity_as(numbers: Array) -> Float[Array, "4"]:
    """The identity rotation. Under shard_map it varies over the same devices as the numbers."""
    return jnp.asarray(IDENTITY, numbers.dtype) + zero_as(numbers)


def everywhere(cut: Panels, values: Nodal) -> Nodal:
    """The same values at all nodes."""
    shape = cut.nodes.shape
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (*shape, *x.shape)), values)


def nodal(problem: Problem, state: AnyState) -> Nodal:
    """The unknowns of a state; those at the nodes are where the next pass starts."""
    if problem.loads is None:
        return Nodal(state.ratio, None)
    return Nodal(state.ratio, state.moment / problem.moment_scale, state.heading if problem.in_space else None)


def moments_of(problem: Problem, values: Nodal) -> Float[Array, "*points_and_components"]:
    """M_ext, N m."""
    if values.moment is not None:
        return problem.moment_scale * values.moment
    zero = jnp.zeros_like(values.ratio[..., 0])
    return jnp.broadcast_to(zero[..., None], (*zero.shape, 3)) if problem.in_space else zero


def unstrained(manipulator: Manipulator, loads: Loads | None, points: Float[Array, "P p tendons"]) -> Array | None:
    """The elastic strain of a body without tensions and loads, which is 0; None where the strain has a closed form.

    Without a closed form a state holds the elastic strain approximately, and one step of Newton's method improves it.
    Whether there is a closed form is static.

    Args:
        manipulator, loads: of the problem.
        points: numbers at its nodes, one for each tendon.
    """
    slanted = manipulator.kinematics == "exact" and manipulator.slanted
    if not (manipulator.in_space or slanted) or (manipulator.in_space and loads is None and manipulator.parallel):
        return None
    zero = jnp.zeros_like(points[..., 0])
    if not manipulator.in_space:
        return zero
    return jnp.zeros((*zero.shape, 6 if manipulator.extensible else 3), zero.dtype) + zero[..., None]


def starts_of_newton(problem: Problem, elastic: Array) -> tuple[Array | None, Array | None, Array | None]:
    """The elastic strain as states hold it: at the starts of the panels, the nodes and the tip, without derivatives.

    Args:
        problem: the body.
        elastic: the strain at the nodes, less that at rest.
    """
    if unstrained(problem.manipulator, problem.loads, problem.nodes.offset) is None:
        return None, None, None
    nodes = without_derivative(elastic)
    starts, ends = problem.panels.at_starts_and_ends(nodes)
    return starts, nodes, ends[-1]


def pull_at_nodes(problem: Problem, values: Nodal) -> Pull:
    """The integrated friction: r, and c, the integral of c'."""
    spending = spent_rate(problem.direction, problem.nodes, values.ratio)
    return Pull(values.ratio, None if spending is None else problem.panels.integrate(spending)[1])


def state_at_nodes(problem: Problem, values: Nodal, strain: Array | None) -> PassState:
    """The state at the nodes that follows from the unknowns alone, with a given elastic strain."""
    moment = moments_of(problem, values)
    heading = jnp.zeros_like(values.ratio[..., 0]) if values.frame is None else values.frame
    if problem.in_space and values.frame is None:
        heading = jnp.broadcast_to(jnp.asarray(IDENTITY, moment.dtype), (*moment.shape[:-1], 4))
    return PassState(pull_at_nodes(problem, values), heading, moment, acting(problem, problem.outboard.nodes), strain)


def acting(problem: Problem, force: Array) -> Array | None:
    """The force N as a state holds it: None for a body in space without loads."""
    return None if problem.in_space and problem.loads is None else force


def line_up(base: Array, nodes: Array, tip: Array) -> Array:
    """Base, Gauss nodes and tip in one row of points."""
    return jnp.concatenate([base[None], nodes.reshape(-1, *base.shape), tip[None]])


def all_points(problem: Problem, solution: Solution[Kind]) -> tuple[AnySection, Kind]:
    """The cross-sections and states at base, Gauss nodes and tip."""
    base = jax.tree.map(lambda x: x[0], solution.starts)
    return problem.points, jax.tree.map(line_up, base, solution.nodes, solution.tip)


def at_nodes(function: Callable[..., Array], in_axes: tuple[int | None, ...]) -> Callable[..., Array]:
    """A function of one cross-section, mapped over panels and nodes."""
    return jax.vmap(jax.vmap(function, in_axes), in_axes)


strain_along = at_nodes(strain_of, (0, None, 0))
curvature_along = at_nodes(bending.curvature, (0, 0, 0, 0))
turning_along = at_nodes(bending.turning, (0, 0, 0, None, 0))
