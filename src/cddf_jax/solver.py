"""The tensions along a body, resolved together with its shape by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext that they put on a cross-section,
M_ext' = -(t x N). With one unloaded tendon in the published kinematics theta' r does not depend
on r, and one sweep of the fixed point is exact.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import mechanics
from .fixed_point import fixed_point, round_off
from .loads import Loads, planar_cross
from .manipulator import CrossSection, Manipulator
from .quadrature import Panels, panels

PerTendon = Float[Array, " tendons"]
Number = Float[Array, ""]
ACCURACY = 1e-5  # a larger error of truncation is not called successful, nor a larger residual of Marching
SAFETY = 5.0  # by which the difference of two quadratures is taken larger than it is


class Joints(NamedTuple):
    """Where two smooth pieces of the body may meet: both sides of the start of every panel, leading axis P."""

    before: CrossSection
    after: CrossSection


class Outboard(NamedTuple):
    """N = F + integral of rho A g from s to the tip, N: the sum of the dead loads outboard of a cross-section."""

    starts: Float[Array, "P 2"]
    nodes: Float[Array, "P p 2"]
    tip: Float[Array, "2"]


class Problem(eqx.Module):
    """A body under load, cut into panels, its cross-sections evaluated once."""

    manipulator: Manipulator
    base_tension: PerTendon
    direction: PerTendon
    panels: Panels
    base: CrossSection
    nodes: CrossSection  # leading axes: P panels, p nodes
    tip: CrossSection
    joints: Joints | None  # None where no tendon can turn by a finite angle
    loads: Loads | None
    outboard: Outboard  # zero without loads
    base_moment: Number  # M_ext(0), N m; zero without loads

    @property
    def moment_scale(self) -> Number:
        """E J / L at the base, N m."""
        return self.base.stiffness / self.panels.edges[-1]


class State(NamedTuple):
    """What is integrated along the body; leading axes may be panels and nodes."""

    ratio: Float[Array, "*points tendons"]  # r = T_base / T
    wrap_angle: Float[Array, "*points tendons"]  # theta, rad
    heading: Float[Array, "*points"]  # phi, rad
    position: Float[Array, "*points 2"]  # u, m
    moment: Float[Array, "*points"]  # M_ext, N m
    force: Float[Array, "*points 2"]  # N, N


class Path(NamedTuple):
    """A method's answer."""

    starts: State  # at the start of every panel
    nodes: State  # at every Gauss node
    tip: State
    num_iterations: Number
    residual: Number  # what the method itself left open, relative
    converged: Bool[Array, ""]
    locked: Bool[Array, ""]  # the tension of a tendon sliding out grows without bound


@runtime_checkable
class Method(Protocol):
    """A way to resolve shape and tension from the base to the tip. Its settings are static."""

    def __call__(self, problem: Problem) -> Path: ...


def lay_out(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    nodes: int,
    loads: Loads | None = None,
    splits: Float[Array, " splits"] | None = None,
) -> Problem:
    """Cut the body into panels, at `splits` as well, and evaluate its cross-sections."""
    breaks = manipulator.breakpoints
    cut = panels(jnp.asarray(manipulator.length), breaks if splits is None else jnp.append(breaks, splits), nodes)
    nudge = edge_nudge(cut)
    section = jax.vmap(lambda s: guarded_section(manipulator, s))
    along = section(jnp.concatenate([nudge[None], cut.nodes.ravel(), cut.edges[-1:] - nudge]))
    turns = manipulator.kinematics == "exact" and manipulator.slanted and breaks.shape[0] > 0
    starts = cut.edges[:-1]
    return Problem(
        manipulator,
        base_tension,
        direction,
        cut,
        base=jax.tree.map(lambda x: x[0], along),
        nodes=jax.tree.map(lambda x: x[1:-1].reshape(*cut.nodes.shape, *x.shape[1:]), along),
        tip=jax.tree.map(lambda x: x[-1], along),
        joints=Joints(section(jnp.maximum(starts - nudge, 0.0)), section(starts + nudge)) if turns else None,
        loads=loads,
        outboard=_outboard(manipulator, cut, loads),
        base_moment=0.0 * cut.edges[-1],
    )


def _outboard(manipulator: Manipulator, cut: Panels, loads: Loads | None) -> Outboard:
    if loads is None:
        zero = jnp.zeros((*cut.nodes.shape, 2), cut.edges.dtype)
        return Outboard(zero[:, 0], zero, zero[0, 0])
    edges, nodes = cut.integrate(weight_rate(manipulator, cut.nodes, loads))
    force = jnp.asarray(loads.tip_force)
    return Outboard(force + edges[-1] - edges[:-1], force + edges[-1] - nodes, force)


def weight_rate(manipulator: Manipulator, arc_length: Array, loads: Loads) -> Float[Array, "*points 2"]:
    """The weight rho A g per length, N/m."""
    return (manipulator.density * manipulator.area(arc_length))[..., None] * jnp.asarray(loads.gravity)


def loaded_to(problem: Problem, fraction: Number, base_moment: Number) -> Problem:
    """The problem with all dead loads scaled, and what is taken for M_ext(0)."""
    outboard, loads = jax.tree.map(lambda x: fraction * x, (problem.outboard, problem.loads))
    return eqx.tree_at(
        lambda problem: (problem.outboard, problem.loads, problem.base_moment), problem, (outboard, loads, base_moment)
    )


def with_tip_force(problem: Problem, tip_force: Float[Array, "2"]) -> Problem:
    """The problem with another force on its tip."""
    more = tip_force - problem.outboard.tip
    return eqx.tree_at(lambda problem: problem.outboard, problem, jax.tree.map(lambda x: x + more, problem.outboard))


def guarded_section(manipulator: Manipulator, arc_length: Number) -> CrossSection:
    """The cross-section, with a stand-in where a body that is none has no stiffness; `solve` reports that."""
    section = manipulator.cross_section(arc_length)
    stiffness = jnp.where(section.stiffness > 0, section.stiffness, 1.0)
    return eqx.tree_at(lambda section: section.stiffness, section, stiffness)


def edge_nudge(cut: Panels) -> Number:
    """The least step off an edge, m, that surely tells its two sides apart."""
    return 8 * float(jnp.finfo(cut.edges.dtype).eps) * cut.edges[-1]


# --- one cross-section ---------------------------------------------------------------------------


def tension_of(section: CrossSection, base_tension: PerTendon, ratio: PerTendon) -> PerTendon:
    """T = T_base / r, zero beyond the anchor. Where a tendon locks, r goes on below zero, and its size stands in."""
    size = jnp.maximum(jnp.abs(ratio), jnp.finfo(ratio.dtype).eps)
    return jnp.where(section.present, base_tension / size, 0.0)


def curvature_of(problem: Problem, section: CrossSection, ratio: PerTendon, moment: Number) -> Number:
    """The curvature kappa, 1/m, from the tensions and the dead loads at one cross-section."""
    return mechanics.curvature(section, tension_of(section, problem.base_tension, ratio), moment)


def rates_of(
    problem: Problem, section: CrossSection, curvature: Number, ratio: PerTendon, moment_rate: Number
) -> mechanics.Rates:
    """The rates kappa' and psi' at one cross-section; psi' is zero beyond the anchor."""
    tension = tension_of(section, problem.base_tension, ratio)
    rate = mechanics.rates(section, curvature, tension, problem.direction, moment_rate)
    return rate._replace(turning=jnp.where(section.present, rate.turning, 0.0))


def moment_rate_of(heading: Float[Array, "*points"], force: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
    """M_ext' = -(t x N), N."""
    return -planar_cross(axis_of(heading), force)


def axis_of(heading: Float[Array, "*points"]) -> Float[Array, "*points 2"]:
    """The unit vector t along the neutral axis."""
    return jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1)


def ratio_rate(problem: Problem, section: CrossSection, turning: PerTendon, ratio: PerTendon) -> PerTendon:
    """The growth r' = direction mu theta' r."""
    return problem.direction * section.friction_coefficient * jnp.abs(turning) * jnp.abs(ratio)


def turn_at_joint(
    problem: Problem, joint: Joints | None, ratio: PerTendon, moment: Number
) -> tuple[PerTendon, PerTendon]:
    """The finite angle by which a tendon turns where two pieces meet (exact kinematics), and r beyond it."""
    if joint is None:
        return jnp.zeros_like(ratio), ratio
    before, after = joint

    def angle(section, ratio):
        return mechanics.tangent_angle(section, curvature_of(problem, section, ratio, moment))

    arriving, gain = angle(before, ratio), problem.direction * before.friction_coefficient
    turn, beyond = jnp.zeros_like(ratio), ratio
    for _ in range(6):  # the angle beyond depends on r there only by mu d d' kappa, so this contracts fast
        turn = jnp.where(after.present, jnp.abs(angle(after, beyond) - arriving), 0.0)
        beyond = ratio * jnp.exp(gain * turn)
    return turn, beyond


# --- the whole body ------------------------------------------------------------------------------

_at_nodes = (None, 0, 0, 0)
_curvatures = jax.vmap(curvature_of, _at_nodes)  # over the nodes of a panel
_rates = jax.vmap(rates_of, (*_at_nodes, 0))
_ratio_rates = jax.vmap(ratio_rate, _at_nodes)
curvature_along = jax.vmap(_curvatures, _at_nodes)  # over panels and nodes
rates_along = jax.vmap(_rates, (*_at_nodes, 0))


def integrate_shape(cut: Panels, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    return heading, cut.integrate(axis_of(heading[1]))


def truncation_error(problem: Problem, path: Path) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    The rates along the polynomials of the solution are integrated once more with a few more nodes in
    each panel; what differs is summed over the panels.
    """
    coarse, fine = problem.panels, problem.panels.finer()
    sections = jax.vmap(jax.vmap(lambda s: guarded_section(problem.manipulator, s)))(fine.nodes)
    finer = jax.tree.map(lambda a, b: coarse.resample(a, b, fine.rule.nodes), path.starts, path.nodes)

    def gains(cut, sections, state):
        kappa = curvature_along(problem, sections, state.ratio, state.moment)
        moment_rate = moment_rate_of(state.heading, state.force)
        turning = rates_along(problem, sections, kappa, state.ratio, moment_rate).turning
        growth = sections.friction_coefficient * jnp.abs(turning) * state.ratio / path.tip.ratio
        shape = axis_of(state.heading) / cut.edges[-1]
        bending = (moment_rate / problem.moment_scale)[..., None]
        return cut.gain(jnp.concatenate([growth, shape, kappa[..., None], bending], axis=-1))

    differences = jnp.abs(gains(fine, sections, finer) - gains(coarse, problem.nodes, path.nodes))
    return jnp.maximum(SAFETY * jnp.max(jnp.sum(differences, axis=0)), _unseen_turning(problem))


def _unseen_turning(problem: Problem) -> Number:
    """What the nodes miss of the bend under constant moments, T_base d and M_ext(0) over E J, rad: a notch."""
    body, coarse = problem.manipulator, problem.panels
    dense = coarse.densely(times=32, order=4)

    def bend(arc_length):
        stiffness = body.bending_stiffness(arc_length)
        moments = jnp.append(problem.base_tension * body.offset(arc_length), problem.base_moment)
        return moments / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = coarse.gain(jax.vmap(jax.vmap(bend))(coarse.nodes))
    there = dense.gain(jax.vmap(jax.vmap(bend))(dense.nodes)).reshape(seen.shape[0], -1, seen.shape[1]).sum(axis=1)
    return jnp.max(jnp.sum(jnp.abs(there - seen), axis=0))


class FixedPoint(eqx.Module):
    """The default: in each panel sweep r = r_start + integral of direction mu theta' r; `lax.scan` over the panels.

    Under dead loads M_ext = M_start - integral of t x N is swept with it. A sweep solves the equilibrium
    of every cross-section with the tensions and the moment at hand (the semi-implicit map). Both enter
    through Volterra integrals, so the errors of the sweeps fall like c^n / n! for any load.
    Derivatives are implicit, see `fixed_point`.

    Args:
        tolerance: relative change of r at which the sweeps stop; None for 1e-12 (float32: 4e-6).
        max_sweeps: in one panel.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_sweeps: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem) -> Path:
        cut, count = problem.panels, problem.base_tension.shape[0]
        loaded = problem.loads is not None
        tolerance = max(1e-12, round_off(cut.edges.dtype)) if self.tolerance is None else self.tolerance
        integration, weights = cut.constant("integration"), cut.constant("weights")

        def unpack(values):  # r, and M_ext over its scale where there are loads
            return values[..., :count], problem.moment_scale * jnp.sum(values[..., count:], axis=-1)

        def rates(inputs, heading, values):
            section, force, width = inputs
            ratio, moment = unpack(values)
            kappa = _curvatures(problem, section, ratio, moment)
            moment_rate = moment_rate_of(heading + width * integration @ kappa, force)
            turning = _rates(problem, section, kappa, ratio, moment_rate).turning
            growth = _ratio_rates(problem, section, turning, ratio)
            if loaded:
                growth = jnp.concatenate([growth, moment_rate[:, None] / problem.moment_scale], axis=1)
            return growth, kappa

        def panel(carry, inputs):
            (values, heading), (joint, *inputs) = carry, inputs
            ratio, moment = unpack(values)
            turn, ratio = turn_at_joint(problem, joint, ratio, moment)
            start = jnp.concatenate([ratio, values[count:]])
            answer = fixed_point(
                lambda y: start + inputs[-1] * integration @ rates(inputs, heading, y)[0],
                jnp.broadcast_to(start, (cut.order, *start.shape)),
                tolerance=tolerance,
                max_sweeps=self.max_sweeps,
                acceptable=lambda y: jnp.all(y[:, :count] > 0) & jnp.all(jnp.isfinite(y)),
            )
            growth, kappa = rates(inputs, heading, answer.value)
            end = start + inputs[-1] * weights @ growth
            positive = jnp.all(end[:count] > 0)
            end = jnp.where(positive, end, 1.0)
            return (end, heading + inputs[-1] * weights @ kappa), (start, answer, turn, positive)

        base = jnp.append(ones_at_base(problem), problem.base_moment / problem.moment_scale)
        base = base if loaded else base[:count]
        inputs = problem.joints, problem.nodes, problem.outboard.nodes, cut.width
        (tip, _), (starts, answer, turns, positive) = jax.lax.scan(panel, (base, 0.0 * base[0]), inputs)
        settled = answer.change <= tolerance
        return _follow(
            problem, *map(unpack, (starts, answer.value, tip)), turns,
            num_iterations=jnp.max(answer.num_sweeps),
            residual=jnp.max(answer.change),
            converged=jnp.all(answer.converged & positive),
            locked=jnp.any(settled & ~(answer.converged & positive)),
        )  # fmt: skip


def ones_at_base(problem: Problem) -> PerTendon:
    """Ones, r at the base, made so that under shard_map it varies over the same devices as r further on."""
    kappa = curvature_of(problem, problem.base, problem.base_tension, problem.base_moment)
    turning = rates_of(problem, problem.base, kappa, problem.base_tension, 0.0 * kappa).turning
    rate = ratio_rate(problem, problem.base, turning, problem.base_tension) + jnp.sum(problem.outboard.tip)
    return jnp.where(rate == rate, jnp.ones_like(rate), 1.0)


def _follow(problem: Problem, starts, nodes, tip, turns: Array, **outcome) -> Path:
    """Integrate the turning that goes with (r, M_ext) at starts, nodes and tip into wrap angle, heading, position."""
    outboard = problem.outboard
    kappa = curvature_along(problem, problem.nodes, *nodes)
    (heading_edges, heading), (position_edges, position) = integrate_shape(problem.panels, kappa)
    turning = rates_along(problem, problem.nodes, kappa, nodes[0], moment_rate_of(heading, outboard.nodes)).turning
    wrap_edges, wrap = problem.panels.integrate(jnp.abs(turning))
    turned = jnp.cumsum(turns, axis=0)
    return Path(
        State(starts[0], wrap_edges[:-1] + turned, heading_edges[:-1], position_edges[:-1], starts[1], outboard.starts),
        State(nodes[0], wrap + turned[:, None], heading, position, nodes[1], outboard.nodes),
        State(tip[0], wrap_edges[-1] + turned[-1], heading_edges[-1], position_edges[-1], tip[1], outboard.tip),
        **outcome,
    )
