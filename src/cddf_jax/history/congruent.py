"""What a single tendon leaves of its history in tension and shape: a play operator with an exact answer.

Without loads the curvature follows from the tension at the same place. So where the tendon rests the body keeps its
curvature, and where it slides the tension is that of `solve` with the direction in which it slides. Between the
fronts of its open turns the body is therefore congruent to a part of one of these equilibria, and the traced body is
put together of such parts: one equilibrium for each step, turned and moved.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.fixed_point import FixedPoint
from ..mechanics.friction import Pull
from ..mechanics.problem import cut_into_panels, displacement_rate, guarded_section, lay_out, tension_of
from ..mechanics.sign_changes import at_starts_and_ends, refined_zero
from ..numerics.arrays import cos_sin, zero_as
from ..numerics.quadrature import Panels
from ..programs.kept import kept_program
from ..robot.manipulator import Manipulator
from ..statics.arguments import one_precision
from ..statics.equilibrium import RESULTS, Dense, Fields, code_of, nan_unless, with_words
from ..statics.solve import solve
from .history import History, States
from .turns import NOBODY, Turns, open_turns

Number = Float[Array, ""]
REFINEMENTS = 3  # of fronts, by Newton's method


class _Branch(NamedTuple):
    """The equilibrium of one step, from the base to its front, as if all of the tendon slid in its direction."""

    dense: Dense
    pulled_in: tuple[Float[Array, " P"], Float[Array, "P p"]]  # m, up to the starts and the nodes of its panels
    error: Number
    result: RESULTS


class _Part(NamedTuple):
    """A part of a traced body, and how the equilibrium that it is part of is turned and moved."""

    start: Number  # s, m
    end: Number
    branch: Int[Array, ""]  # the step whose equilibrium it is part of
    turned: Number  # rad
    moved: Float[Array, "2"]  # m, after it was turned about the base
    wrapped: Float[Array, " tendons"]  # rad, more than in that equilibrium


class CongruentStates(States):
    """Bodies that are put together of parts of equilibria."""

    open_tension: Float[Array, " turns"]  # N, of the turns that are felt at the end, then the last tension
    manipulator: Manipulator
    nodes: int = eqx.field(static=True)
    direction: Float[Array, " steps"]
    front: Float[Array, " steps"]  # m
    branches: _Branch
    parts: _Part

    @property
    def arc_length(self) -> Float[Array, " points"]:
        cut = cut_into_panels(self.manipulator, self.nodes)
        return jnp.concatenate([cut.edges[:1], cut.nodes.ravel(), cut.edges[-1:]])

    def fields(self, arc_length: Float[Array, " points"]) -> Fields:
        at_point = jax.vmap(_fields_at, in_axes=(None, None, 0))
        return jax.vmap(at_point, in_axes=(None, 0, None))(self.branches, self.parts, arc_length)

    def sliding(self, arc_length: Float[Array, " points"]) -> Float[Array, "steps points"]:
        return jnp.where(arc_length <= self.front[:, None], self.direction[:, None], 0.0)


@kept_program
@partial(jax.jit, static_argnames=("nodes", "max_turns"))
def congruent_history(
    manipulator: Manipulator, base_tension: Array, before: Array | None, nodes: int, max_turns: int
) -> History:
    """Trace one tendon without loads.

    Args:
        manipulator: a body with one tendon.
        base_tension: N, after each step.
        before: the tensions of `CongruentStates.open_tension` of a history that goes on; None for rest.
        nodes: Gauss nodes in each smooth piece; static.
        max_turns: how many turns there is room for; static.
    """
    # the masses of a body without loads do nothing, and may lie beyond a front
    body = eqx.tree_at(lambda body: body.point_masses, manipulator, ())
    num_steps = base_tension.shape[0]
    path = base_tension if before is None else jnp.concatenate([before, base_tension])
    body, _, _, tensions = one_precision(body, path[0], jnp.ones_like(path[0]), path)
    turns = open_turns(tensions, max_turns)
    front = _fronts(body, tensions, turns, nodes)

    def branch(tension: Number, direction: Number, front: Number) -> _Branch:
        part = eqx.tree_at(lambda body: body.length, body, front)
        found = solve(part, tension, direction=direction, nodes=nodes, throw=False)
        return _Branch(found._dense, _pulled_in(found._dense), found.error_estimate, found.result)

    if body.tendon_drag is not None or body.slanted:  # else r is a polynomial, and the front right at once
        again = jax.lax.stop_gradient((tensions, turns.direction))

        def nearer(_: Int[Array, ""], front: Float[Array, " steps"]) -> Float[Array, " steps"]:
            branches = jax.lax.stop_gradient(jax.vmap(branch)(*again, front))
            return jax.vmap(partial(_nearer_front, jnp.asarray(body.length), branches, front))(
                jnp.arange(front.size), turns.before
            )

        front = jax.lax.stop_gradient(jax.lax.fori_loop(0, REFINEMENTS, nearer, front))
    branches = jax.vmap(branch)(tensions, turns.direction, front)
    turns, tensions, front = jax.tree.map(lambda x: x[-num_steps:], (turns, tensions, front))
    tip, parts = jax.vmap(partial(_assembled, branches))(turns)
    good = ~turns.too_many & tip.solved
    outside = tensions * body.tendon_compliance * body.tendon_free_length
    still_open = turns.open[-1]
    pulled_in = tip.pulled_in + outside
    numbers = tip.tension[:, 0], tip.heading, tip.position, pulled_in, tip.error
    tension, angle, position, pulled_in, error = jax.vmap(nan_unless)(good, numbers)
    return History(
        base_tension=tensions,
        tip_tension=tension,
        tip_angle=angle,
        tip_position=position,
        direction=turns.direction,
        front=front,
        num_turns=jnp.sum(turns.open != NOBODY, axis=1),
        tendon_displacement=pulled_in,
        error_estimate=error,
        result=tip.result,
        _states=CongruentStates(
            open_tension=nan_unless(good[-1], jnp.where(still_open == NOBODY, path[-1], path[still_open])),
            manipulator=body,
            nodes=nodes,
            direction=turns.direction,
            front=front,
            branches=branches,
            parts=parts,
        ),
    )


def _pulled_in(dense: Dense) -> tuple[Float[Array, " P"], Float[Array, "P p"]]:
    """How much of the tendon is pulled in between the base and the starts and nodes of the panels, m."""
    body, cut = dense.manipulator, dense.panels
    section = jax.vmap(jax.vmap(partial(guarded_section, body)))(cut.nodes)
    tension = tension_of(section, dense.base_tension, dense.nodes.pull)
    edges, nodes = cut.integrate(displacement_rate(body, section, tension, dense.nodes.moment)[..., 0])
    return edges[:-1], nodes


def _fronts(body: Manipulator, tensions: Float[Array, " steps"], turns: Turns, nodes: int) -> Float[Array, " steps"]:
    """Where, in each step, the tension in the direction of the motion meets that at which the motion turned, s in m.

    In T = (T_base - c) / r both r and c are smooth, also beyond the place where a released tendon would lock. With a
    drag the passes do not settle there, and the front is only near.
    """
    constant = jax.lax.stop_gradient((body, tensions))

    def pull(tension: Number, direction: Number) -> tuple[Panels, Pull]:
        problem = lay_out(constant[0], tension[None], direction[None], nodes)
        return problem.panels, FixedPoint()(problem).nodes.pull

    cuts, pulls = jax.vmap(pull)(constant[1], turns.direction)

    def front(step: Int[Array, ""], before: Int[Array, ""], direction: Number) -> Number:
        def left(step):
            tension, pull = constant[1][step], jax.tree.map(lambda x: x[step], pulls)
            spent = 0.0 if pull.spent is None else pull.spent
            return tension - spent, pull.ratio

        cut = jax.tree.map(lambda x: x[step], cuts)
        (here, ratio), (there, other) = left(step), left(before)
        return _first_zero(cut, (direction * (here * other - there * ratio))[..., 0])

    steps = jnp.arange(tensions.shape[0])
    found = jax.vmap(front)(steps, turns.before, turns.direction)
    length = jnp.broadcast_to(constant[0].length, found.shape)
    found = jnp.where((turns.before == NOBODY) | jnp.isnan(found), length, found)
    return jnp.clip(found, 1e-9 * length, length)  # a step of rounding errors moves next to nothing


def _nearer_front(
    length: Number,
    branches: _Branch,
    fronts: Float[Array, " steps"],
    step: Int[Array, ""],
    before: Int[Array, ""],
) -> Number:
    """A step of Newton's method to the place, m, where the tensions of two steps meet."""
    front = fronts[step]
    inside = front * (1 - 64 * jnp.finfo(front.dtype).eps)  # the last panel may have no width, and no slope

    def gap(arc_length: Number) -> Number:
        here, there = (_tension(jax.tree.map(lambda x, i=i: x[i], branches.dense), arc_length) for i in (step, before))
        return (here - there)[0]

    value, slope = jax.jvp(gap, (inside,), (jnp.ones_like(front),))
    found = jnp.clip(inside - value / slope, 1e-9 * length, length)
    return jnp.where((before == NOBODY) | ~jnp.isfinite(found), front, found)


def _tension(dense: Dense, arc_length: Number) -> Float[Array, " tendons"]:
    """T, N, at one arc length."""
    section = guarded_section(dense.manipulator, arc_length)
    return tension_of(section, dense.base_tension, dense.state(arc_length).pull)


def _first_zero(cut: Panels, values: Float[Array, "P p"]) -> Number:
    """The first place, m, where polynomials that are positive at the base fall below zero; the tip if none is."""
    starts, ends = at_starts_and_ends(cut, values[..., None])
    points = jnp.concatenate([starts, values, ends], axis=1)
    places = jnp.concatenate([cut.edges[:-1, None], cut.nodes, cut.edges[1:, None]], axis=1)
    below = (points < 0).ravel()
    first = jnp.argmax(below)
    first = first.astype(jnp.uint32)  # not read from the end
    panel, before = first // points.shape[1], jnp.maximum(first, 1) - 1
    bracket = jnp.stack([places.ravel()[before], places.ravel()[first]])
    place = jnp.where(first % points.shape[1] > 0, refined_zero(cut, values[panel], panel, bracket), bracket[1])
    return jnp.where(jnp.any(below), place, cut.edges[-1])


class _Body(NamedTuple):
    """A traced body as far as it is put together."""

    end: Number  # s, m
    heading: Number
    position: Float[Array, "2"]
    wrap_angle: Float[Array, " tendons"]
    tension: Float[Array, " tendons"]
    pulled_in: Number  # m, of the tendon within it
    error: Number
    solved: Bool[Array, ""]
    result: RESULTS


def _assembled(branches: _Branch, turns: Turns) -> tuple[_Body, _Part]:
    """The body after one step, put together from the base on: the newest turn first."""
    zero = zero_as(branches.error)
    result = with_words(RESULTS.where(zero > 1, RESULTS.locked, RESULTS.successful))
    start = _Body(zero, zero, jnp.zeros(2) + zero, zero[None], zero[None], zero, zero, zero == 0, result)

    def add(body: _Body, step: Int[Array, ""]) -> tuple[_Body, _Part]:
        index = jnp.maximum(step, 0)
        of = jax.tree.map(lambda x: x[index], branches)
        end = of.dense.edges[-1]
        covers = (step != NOBODY) & (end > body.end)
        joint = of.dense.state(jnp.minimum(body.end, end))
        turned = body.heading - joint.heading
        moved = body.position - _rotated(joint.position, turned)
        part = _Part(
            body.end, jnp.where(covers, end, body.end), index, turned, moved, body.wrap_angle - joint.wrap_angle
        )
        there = of.dense.state(end)
        meets = jnp.max(jnp.abs(_tension(of.dense, jnp.minimum(body.end, end)) - body.tension) / _scale(body.tension))
        missed = jnp.where(body.end > 0, meets, 0.0)  # the two tensions are the same at a front
        failed = (code_of(of.result) != 0) & (code_of(of.result) != code_of(RESULTS.direction_contradicted))
        failed = failed & (step != NOBODY) & (code_of(body.result) == 0)
        body = body._replace(  # whatever is felt must be known
            solved=body.solved & (of.dense.solved | (step == NOBODY)),
            result=with_words(RESULTS.where(failed, of.result, body.result)),
        )
        further = _Body(
            end,
            turned + there.heading,
            moved + _rotated(there.position, turned),
            part.wrapped + there.wrap_angle,
            _tension(of.dense, end),
            body.pulled_in + _on_panels(of, end) - _on_panels(of, body.end),
            jnp.maximum(jnp.maximum(body.error, of.error), missed),
            body.solved,
            body.result,
        )
        return jax.tree.map(lambda new, old: jnp.where(covers, new, old), further, body), part

    body, parts = jax.lax.scan(add, start, turns.open[::-1])
    result = with_words(RESULTS.where(turns.too_many, RESULTS.too_many_turns, body.result))
    return body._replace(result=result), parts


def _scale(tension: Float[Array, " tendons"]) -> Float[Array, " tendons"]:
    return jnp.where(tension > 0, tension, 1.0)


def _on_panels(branch: _Branch, arc_length: Number) -> Number:
    """How much of the tendon is pulled in between the base and an arc length, m."""
    return branch.dense.panels.interpolate(*branch.pulled_in, arc_length)


def _rotated(vector: Float[Array, "*points 2"], angle: Number) -> Float[Array, "*points 2"]:
    cosine, sine = cos_sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _placed(part: _Part, fields: Fields) -> Fields:
    """What varies along a part, where it lies in the traced body; of its equilibrium."""
    return Fields(
        arc_length=fields.arc_length,
        curvature=fields.curvature,
        heading=fields.heading + part.turned,
        position=part.moved + _rotated(fields.position, part.turned),
        tension=fields.tension,
        wrap_angle=fields.wrap_angle + part.wrapped,
        normal_force=_rotated(fields.normal_force, part.turned),
        friction_force=_rotated(fields.friction_force, part.turned),
    )


def _fields_at(branches: _Branch, parts: _Part, arc_length: Number) -> Fields:
    """The fields at one arc length, tendons last, of a body of several parts; NaN off the body."""
    part = jax.tree.map(lambda x: x[jnp.argmax((parts.end > parts.start) & (arc_length <= parts.end))], parts)
    return _placed(part, jax.tree.map(lambda x: x[part.branch], branches.dense)(arc_length))
