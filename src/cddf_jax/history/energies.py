"""The work at the base along a path, and the part of it that is lost to friction.

While the base tension T goes on in one direction, the work of a motion is T x less the integral of x over T. The length
x that is pulled in follows from equilibria. As a function of T it has a kink where the front reaches the tip; on either
side it is smooth, and Gauss rules are exact to rounding errors, but in space nearly a kink too where the turning of the
tendon has a sharp minimum. The work of a step follows from the motions between turns: a step that passes a remembered
turn first closes the loop that began there.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.march import FixedPoint
from ..mechanics.problem import lay_out
from ..numerics.elements import gauss_rule
from ..numerics.fixed_point import newton
from ..robot.manipulator import Manipulator
from ..statics.solve import solve
from .congruent_parts import ends_of_motion
from .fronts import Motion, left_of, motions
from .turns import NO_STEP, Number, Turns

WorkAndLoss = Float[Array, "... 2"]  # J
REFINEMENTS = 5  # of the tension at which a front passes an arc length, by Newton's method


def work_and_loss(body: Manipulator, nodes: int, path: Float[Array, " path"], turns: Turns) -> WorkAndLoss:
    """The work at the base of each step of a path from rest, and the part of it that is lost to friction, J."""
    there = motions(path, turns)
    back = Motion(there.turned_at, -turns.direction, path, there.from_rest & False)
    turned_from = jnp.append(turns.direction[1:] != turns.direction[:-1], False)  # else no step goes back from it
    needed = jnp.concatenate([jnp.ones_like(turned_from), turned_from])

    def gain(given: tuple[Bool[Array, ""], Motion]) -> WorkAndLoss:
        needed, motion = given
        none = jnp.zeros(2) + 0.0 * motion.tension
        return jax.lax.cond(needed, partial(_motion, body, nodes), lambda _: none, motion)

    found = jax.lax.map(gain, (needed, jax.tree.map(lambda *both: jnp.concatenate(both), there, back)))
    return jax.vmap(partial(_of_step, turns, *jnp.split(found, 2)))(jnp.arange(path.size))


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


def _motion(body: Manipulator, nodes: int, motion: Motion) -> WorkAndLoss:
    """Work and loss of a motion since it turned, J."""
    tension, _, turned_at, from_rest = motion

    def since_turn(tension: Number) -> WorkAndLoss:
        """The length pulled in, m, and the energy that the tendon has given to the body or stored itself, J."""
        own, other = ends_of_motion(body, nodes, motion._replace(tension=tension), refined=False)
        before = jnp.where(from_rest, 0.0, jnp.stack([other.added.pulled_in, other.given]))
        return jnp.stack([own.added.pulled_in, own.given]) - before

    cuts = jnp.stack([turned_at, _all_slides_at(body, nodes, motion), tension])
    rule, width = gauss_rule(nodes), jnp.diff(cuts)[:, None]
    weights, places = jnp.asarray(rule.weights, cuts.dtype), jnp.asarray(rule.nodes, cuts.dtype)
    found = jax.vmap(since_turn)(jnp.append(cuts[:-1, None] + width * places, tension))
    pulled_in, given = found[-1]
    work = tension * pulled_in - jnp.sum((width * weights).ravel() * found[:-1, 0])
    return jnp.stack([work, work - given])


def _all_slides_at(body: Manipulator, nodes: int, motion: Motion) -> Number:
    """The base tension, N, at which the front of a motion reaches the tip; where it does not, the last base tension.

    It has no derivative and needs none, because the integral does not depend on where it is divided.
    """
    body, (tension, direction, turned_at, from_rest) = jax.lax.stop_gradient((body, motion))
    before = solve(body, turned_at, direction=-direction, nodes=nodes, throw=False).tip_tension[0]
    there = jnp.where(from_rest, 0.0, before)

    def nearer(tension: Number) -> Number:
        value, slope = jax.jvp(missing, (tension,), (jnp.ones_like(tension),))
        return tension - value / jnp.where(slope > 0, slope, 1.0)

    def missing(tension: Number) -> Number:
        pull = FixedPoint()(lay_out(body, tension[None], direction[None], nodes)).tip.pull
        return (left_of(tension, pull) - there * pull.ratio)[0]

    found = newton(nearer, turned_at, REFINEMENTS)  # exact at once without drag, where r is linear in the tension
    lowest, highest = jnp.minimum(turned_at, tension), jnp.maximum(turned_at, tension)
    return jax.lax.stop_gradient(jnp.where(jnp.isfinite(found), jnp.clip(found, lowest, highest), tension))
