"""The work at the base along a path, and the part of it that is lost to friction.

While the base tension goes on in one direction, the tendon slides at a cross-section once the front has passed it. So
the work and the loss of a motion are integrals over the positions of the front and, once the front rests, over the base
tension. Both integrands are smooth, and Gauss rules are exact to rounding errors; not so in space, see
`_motion_in_space`. The work of a step follows from the motions between turns: a step that passes a remembered turn
first closes the loop that began there.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics import bending
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint
from ..mechanics.problem import State, at_nodes, geometry_of, guarded_section, lay_out, tension_of
from ..numerics.elements import Elements, gauss_rule
from ..numerics.fixed_point import newton
from ..robot.cross_section import AnySection, planar
from ..robot.manipulator import Manipulator
from ..statics.solve import solve
from .congruent_parts import ends_of_motion
from .fronts import Motion, cut_at, first_zero, front_of, is_play_of_inverse
from .turns import NO_STEP, Turns

Number = Float[Array, ""]
WorkAndLoss = Float[Array, "... 2"]  # J
REFINEMENTS = 5  # of the tension at which a front passes an arc length, by Newton's method


def work_and_loss(
    body: Manipulator, nodes: int, path: Float[Array, " path"], turns: Turns, front: Float[Array, " path"]
) -> WorkAndLoss:
    """The work at the base of each step of a path from rest, and the part of it that is lost to friction, J."""
    from_rest = turns.before == NO_STEP
    turned_at = jnp.where(from_rest, 0.0, path[turns.before])

    def there_and_back(step: tuple[Number, Number, Number, Number, Bool[Array, ""]]) -> WorkAndLoss:
        tension, turned_at, direction, front, from_rest = step
        starts, ends = jnp.stack([turned_at, tension]), jnp.stack([tension, turned_at])
        directions, rest = jnp.stack([direction, -direction]), jnp.stack([from_rest, from_rest & False])
        return jax.vmap(partial(_motion, body, nodes, front))(starts, ends, directions, rest)

    def there_and_back_in_space(step: tuple[Number, Number, Number, Bool[Array, ""], Bool[Array, ""]]) -> WorkAndLoss:
        tension, turned_at, direction, from_rest, turns = step
        motion = partial(_motion_in_space, body, nodes)
        there = motion(turned_at, tension, direction, from_rest)
        back = jax.lax.cond(turns, motion, lambda *_: 0.0 * there, tension, turned_at, -direction, from_rest & False)
        return jnp.stack([there, back])

    if body.in_space:
        turned_from = jnp.append(turns.direction[1:] != turns.direction[:-1], False)  # else no step goes back from it
        found = jax.lax.map(there_and_back_in_space, (path, turned_at, turns.direction, from_rest, turned_from))
    else:
        found = jax.lax.map(there_and_back, (path, turned_at, turns.direction, front, from_rest))
    there, back = jnp.moveaxis(found, 1, 0)
    return jax.vmap(partial(_of_step, turns, there, back))(jnp.arange(path.size))


def _of_step(turns: Turns, there: WorkAndLoss, back: WorkAndLoss, step: Int[Array, ""]) -> WorkAndLoss:
    """Work and loss of one step, which closes the loops whose turns it passes.

    In each of these loops it goes from where it is in the loop to where the loop began.
    """
    earlier = jnp.where(step > 0, turns.open[jnp.maximum(step - 1, 0)], NO_STEP)
    slots = jnp.arange(earlier.size)
    alike = (slots % 2 == 0) == (turns.direction[step] > 0)
    passed = (earlier != NO_STEP) & (slots >= turns.place[step])
    goes_back = passed & ~alike & (slots > turns.place[step])
    zero = jnp.zeros_like(there)
    been = jnp.where((passed & alike)[:, None], there[earlier], zero[:1])
    closed = jnp.where(goes_back[:, None], back[earlier], zero[:1])
    return there[step] + jnp.sum(closed - been, axis=0)


def _motion(
    body: Manipulator,
    nodes: int,
    front: Number,
    turned_at: Number,
    tension: Number,
    direction: Number,
    from_rest: Bool[Array, ""],
) -> WorkAndLoss:
    """Work and loss of a motion since it turned, J. Its front ends at `front`; at the tip, the whole tendon slides."""
    if body.tendon_drag is not None:  # from rest, the front is where drag has used up the tension
        front = jnp.where(from_rest, jnp.minimum(front, _slack_from(body, nodes, tension, direction)), front)
    part = cut_at(body, jax.lax.stop_gradient(front))
    before = _slide(part, nodes, -direction, jnp.where(from_rest, tension, turned_at))

    def passing(arc_length: Number) -> Number:
        there = jnp.where(from_rest, 0.0, before.tension(part, arc_length))
        return _tension_when_passing(body, nodes, turned_at, direction, arc_length, there)

    edges = before.cut.edges
    passed = jax.vmap(passing)(edges)
    rule = gauss_rule(nodes)
    weights, places = jnp.asarray(rule.weights, edges.dtype), jnp.asarray(rule.nodes, edges.dtype)
    even = jax.lax.stop_gradient(passed[:-1, None] + jnp.diff(passed)[:, None] * places).ravel()
    fronts = jax.vmap(partial(_front_at, part, nodes, turned_at, direction, from_rest))(even)
    moving = jax.vmap(passing)(fronts)  # the same tensions with derivatives; the fronts are constants
    growth = moving.reshape(-1, nodes) @ jnp.asarray(rule.differentiation, edges.dtype).T

    tensions = passed[-1] + (tension - passed[-1]) * places  # the front stays at its end
    rates = jax.vmap(partial(_rates, body, nodes, direction))(
        jnp.concatenate([moving, tensions]), jnp.concatenate([fronts, jnp.broadcast_to(edges[-1], tensions.shape)])
    )
    shares = jnp.concatenate([(growth * weights).ravel(), (tension - passed[-1]) * weights])
    return shares @ rates


def _motion_in_space(
    body: Manipulator, nodes: int, turned_at: Number, tension: Number, direction: Number, from_rest: Bool[Array, ""]
) -> WorkAndLoss:
    """The same for a motion in space: the work is T x less the integral of x over T, the loss is the work not stored.

    The length x that is pulled in follows from equilibria. As a function of T it has a kink where the front reaches the
    tip, and nearly one where the turning of the tendon has a sharp minimum.
    """
    compliance = jnp.sum(body.tendon_outside_compliance)

    def since_turn(tension: Number) -> WorkAndLoss:
        """The length pulled in, m, and the energy stored, J."""
        _, own, other = ends_of_motion(body, nodes, Motion(tension, direction, turned_at, from_rest), refined=False)
        before = jnp.where(from_rest, 0.0, jnp.stack([other.added.pulled_in, other.added.stored]))
        outside = jnp.stack([tension - turned_at, (tension**2 - turned_at**2) / 2]) * compliance
        return jnp.stack([own.added.pulled_in, own.added.stored]) - before + outside

    cuts = jnp.stack([turned_at, _all_slides_at(body, nodes, turned_at, tension, direction, from_rest), tension])
    rule, width = gauss_rule(nodes), jnp.diff(cuts)[:, None]
    weights, places = jnp.asarray(rule.weights, cuts.dtype), jnp.asarray(rule.nodes, cuts.dtype)
    found = jax.vmap(since_turn)(jnp.append(cuts[:-1, None] + width * places, tension))
    pulled_in, stored = found[-1]
    work = tension * pulled_in - jnp.sum((width * weights).ravel() * found[:-1, 0])
    return jnp.stack([work, work - stored])


def _all_slides_at(
    body: Manipulator, nodes: int, turned_at: Number, tension: Number, direction: Number, from_rest: Bool[Array, ""]
) -> Number:
    """The base tension, N, at which the front of a motion reaches the tip; where it does not, the last base tension.

    It has no derivative and needs none, because the integral does not depend on where it is divided.
    """
    body, turned_at, tension = jax.lax.stop_gradient((body, turned_at, tension))
    length = jnp.asarray(body.length)
    there = _slide(body, nodes, -direction, turned_at).tension(body, length)
    found = _tension_when_passing(body, nodes, turned_at, direction, length, jnp.where(from_rest, 0.0, there))
    lowest, highest = jnp.minimum(turned_at, tension), jnp.maximum(turned_at, tension)
    return jax.lax.stop_gradient(jnp.where(jnp.isfinite(found), jnp.clip(found, lowest, highest), tension))


class _Slide(NamedTuple):
    """A tendon that slides one way along a part of the body."""

    base_tension: Float[Array, " tendons"]
    cut: Elements
    starts: State
    nodes: State
    ends: State

    def _state(self, arc_length: Number) -> State:
        return self.cut.interpolate(self.starts, self.nodes, self.ends, arc_length)

    def tension(self, body: Manipulator, arc_length: Number) -> Number:
        """T, N; beyond the anchor of the tendon that at the anchor."""
        section = replace(guarded_section(body, arc_length), present=None)
        return tension_of(section, self.base_tension, self._state(arc_length).pull)[0]

    def at(self, body: Manipulator, arc_length: Number) -> tuple[AnySection, PerTendon, Array]:
        """Cross-section, tension, N, and M_ext, N m."""
        section, state = guarded_section(body, arc_length), self._state(arc_length)
        return section, tension_of(section, self.base_tension, state.pull), state.moment


def _slide(part: Manipulator, nodes: int, direction: Number, tension: Number) -> _Slide:
    if geometry_of(part).reverses(part, loaded=False) or part.tendon_drag is not None:
        dense = solve(part, tension, direction=direction, nodes=nodes, throw=False)._dense
        return _Slide(dense.base_tension, dense.elements, dense.starts, dense.nodes, dense.ends)
    problem = lay_out(part, tension[None], direction[None], nodes)
    found = FixedPoint()(problem)
    return _Slide(problem.base_tension, problem.elements, found.starts, found.nodes, found.ends)


def _front_at(
    part: Manipulator, nodes: int, turned_at: Number, direction: Number, from_rest: Bool[Array, ""], tension: Number
) -> Number:
    front = front_of(part, nodes, Motion(tension, direction, turned_at, from_rest))
    if part.tendon_drag is None:
        return front
    return jax.lax.stop_gradient(jnp.where(from_rest, _slack_from(part, nodes, tension, direction), front))


def _slack_from(body: Manipulator, nodes: int, tension: Number, direction: Number) -> Number:
    """The arc length, m, at which drag has used up a base tension; that of the tip where some is left."""
    problem = lay_out(body, tension[None], direction[None], nodes)
    spent = FixedPoint()(problem).nodes.pull.spent
    assert spent is not None
    return first_zero(problem.elements, (tension - spent)[..., 0])


def _tension_when_passing(
    body: Manipulator, nodes: int, turned_at: Number, direction: Number, arc_length: Number, there: Number
) -> Number:
    """The base tension, N, at which the front of a motion passes an arc length; `there` is the tension before, N."""
    double = 2 * turned_at - there
    # without drag, 1/T differs between base and front by as much as along the motion before, with the other sign
    found = jnp.where(double > 0, turned_at * there / jnp.where(double > 0, double, 1.0), there)
    if is_play_of_inverse(body):
        return found
    part = cut_at(body, arc_length)

    def missing(tension: Number) -> Number:
        pull = FixedPoint()(lay_out(part, tension[None], direction[None], nodes)).tip.pull
        return (tension - (0.0 if pull.spent is None else pull.spent) - there * pull.ratio)[0]

    def nearer(tension: Number) -> Number:
        value, slope = jax.jvp(missing, (tension,), (jnp.ones_like(tension),))
        slope = jax.lax.stop_gradient(slope)
        return tension - value / jnp.where(slope > 0, slope, 1.0)

    # the last step has the derivatives of the root
    return newton(lambda tension: nearer(jax.lax.stop_gradient(tension)), found, REFINEMENTS)


def _rates(body: Manipulator, nodes: int, direction: Number, tension: Number, arc_length: Number) -> WorkAndLoss:
    """Work and loss per base tension, J/N, while the tendon slides up to an arc length.

    The length that a cross-section pulls in does work with the base tension at the base, and with the local tension at
    the cross-section. Friction between the two takes the difference.
    """
    part = cut_at(body, jax.lax.stop_gradient(arc_length))

    slide, by_tension = jax.jvp(partial(_slide, part, nodes, direction), (tension,), (jnp.ones_like(tension),))
    cut = slide.cut  # stays, while the tension changes

    def pulled_in_rate(slide: _Slide) -> tuple[Float[Array, "P p"], Float[Array, "P p"]]:
        section, local, moment = jax.vmap(jax.vmap(partial(slide.at, body)))(cut.nodes)
        kappa = at_nodes(bending.curvature, (0, 0, 0))(planar(section), local, moment)
        slipped = at_nodes(bending.slip_rate, (0, 0, 0, None))
        return slipped(planar(section), kappa, local, body.tendon_compliance)[..., 0], local[..., 0]

    (_, local), (growth, _) = jax.jvp(pulled_in_rate, (slide,), (by_tension,))
    outside = jnp.sum(body.tendon_outside_compliance)
    taken = tension * (jnp.sum(cut.gain(growth)) + outside)
    return jnp.stack([taken, jnp.sum(cut.gain((tension - local) * growth))])
