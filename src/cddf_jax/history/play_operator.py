"""The history of a single tendon without loads, in tension and shape: a play operator with an exact answer.

Without loads the curvature follows from the tension at the same cross-section. So where the tendon rests the body keeps
its curvature. Where it slides, the tension is that of `solve` with the direction in which it slides. Between the fronts
of its remembered turns the body is therefore congruent to a part of one of these equilibria, see `congruent_parts`.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.fields import AnyFields, SpatialFields
from ..mechanics.problem import State, elements_of
from ..numerics.arrays import zero_as
from ..numerics.rotations import as_matrix
from ..robot.manipulator import Manipulator
from ..statics.arguments import one_precision
from ..statics.equilibrium import Dense, nan_unless
from ..statics.solve import solve
from ..statics.status import Status, first_of
from .congruent_parts import (
    Composed,
    Heading,
    Slid,
    at_place,
    composed,
    ends_of_motion,
    pose_of_base,
    put,
    rotated,
    tilt_of,
    turned_back,
    turned_on,
    unknown,
)
from .driven import driven
from .energies import work_and_loss
from .fronts import Motion, cut_at, motions, moving_front
from .history import Energies, History, States
from .turns import NO_STEP, Number, Turns, open_turns

BLOCK = 64  # steps that are computed at a time, so that memory stays small in a batch of bodies


class CongruentStates(States):
    """Bodies that are composed of parts of equilibria, see `congruent_parts`."""

    manipulator: Manipulator
    nodes: int = eqx.field(static=True)
    num_steps: int = eqx.field(static=True)  # the last ones of the path; those before come from an earlier history
    open_tension: Float[Array, " turns"]  # at the turns that are remembered at the end, then the last tension, N
    path: Float[Array, " path"]  # base tensions, N
    turns: Turns  # of the path
    front: Float[Array, " path"]  # m
    stored_energy: Float[Array, " steps"]  # J
    earlier: Float[Array, "2"] | None  # work and loss before the steps, J; None for those of the path

    @property
    def arc_length(self) -> Float[Array, " points"]:
        cut = elements_of(self.manipulator, self.nodes, None)
        return jnp.concatenate([cut.edges[:1], cut.nodes.ravel(), cut.edges[-1:]])

    def fields(self, arc_length: Float[Array, " points"]) -> AnyFields:
        def branch(tension: Number, direction: Number, front: Number) -> Dense:
            part = cut_at(self.manipulator, front)
            return solve(part, tension, direction=direction, nodes=self.nodes, throw=False)._dense

        branches = jax.vmap(branch)(self.path, self.turns.direction, self.front)

        def step(open_steps: Int[Array, " turns"]) -> AnyFields:
            return jax.vmap(partial(_fields_at, branches, _parts(branches, open_steps)))(arc_length)

        return jax.vmap(step)(self.turns.open[-self.num_steps :])

    def sliding(self, arc_length: Float[Array, " points"]) -> Float[Array, "steps points"]:
        front, direction = (x[-self.num_steps :, None] for x in (self.front, self.turns.direction))
        return jnp.where(arc_length <= front, direction, 0.0)

    def energies(self) -> Energies:
        gains = work_and_loss(self.manipulator, self.nodes, self.path, self.turns)
        if self.earlier is not None:
            own = jnp.arange(self.path.size) >= self.path.size - self.num_steps
            gains = jnp.where(own[:, None], gains, 0.0)
        sums = jnp.cumsum(gains, axis=0)[-self.num_steps :] + (0.0 if self.earlier is None else self.earlier)
        return Energies(sums[:, 0], sums[:, 1], self.stored_energy)


@partial(jax.jit, static_argnames=("nodes", "max_turns", "quantity"))
def congruent_history(
    manipulator: Manipulator,
    wanted: Float[Array, " steps"],
    known: Float[Array, " turns"],
    earlier: Float[Array, "2"] | None,
    nodes: int,
    max_turns: int,
    quantity: str = "base_tension",
) -> History:
    """Trace one tendon without loads.

    Args:
        manipulator: a body with one tendon.
        wanted: values of the given quantity after each step.
        known: base tensions before the first step, N: a path that leaves the same remembered turns.
        earlier: work and loss before the first step, J; None for those of that path.
        nodes: Gauss nodes in each smooth piece; static.
        max_turns: how many turns can be remembered; static.
        quantity: "base_tension", N, "displacement", m, or "tip_angle", rad; static.
    """
    # point masses have no effect without loads, and may lie beyond a front
    body = eqx.tree_at(lambda body: body.point_masses, manipulator, ())
    num_steps = wanted.shape[0]
    given = wanted, known, earlier
    body, _, _, (wanted, known, earlier) = one_precision(body, wanted[0], jnp.ones_like(wanted[0]), given)
    path, all_turns, reached = _path(body, nodes, quantity, known, wanted, max_turns)
    fronts, bodies = follow(body, nodes, path, all_turns)[:2]

    turns, front, bodies, tension = jax.tree.map(lambda x: x[-num_steps:], (all_turns, fronts, bodies, path))
    usable, added = jnp.isfinite(wanted), jax.vmap(lambda one: one.whole)(bodies)
    good = added.solved & usable & ~turns.too_many
    numbers = bodies.tip_tension, added.heading, added.position, front, added.pulled_in, added.error
    tip_tension, heading, position, front, pulled_in, error = jax.vmap(nan_unless)(good, numbers)
    still_open = turns.open[-1]
    states = CongruentStates(
        manipulator=body,
        nodes=nodes,
        num_steps=num_steps,
        open_tension=nan_unless(good[-1], jnp.where(still_open == NO_STEP, path[-1], path[still_open])),
        path=path,
        turns=all_turns,
        front=jax.lax.stop_gradient(fronts),
        stored_energy=added.stored,
        earlier=earlier,
    )
    return History(
        base_tension=tension,
        tip_tension=tip_tension,
        tip_angle=jax.vmap(tilt_of)(heading),
        tip_position=position,
        tip_frame=heading if body.in_space else None,
        direction=turns.direction,
        front=front,
        num_turns=jnp.sum(turns.open != NO_STEP, axis=1),
        tendon_displacement=pulled_in,
        error_estimate=error,
        status=first_of(
            (~usable, Status.unphysical),
            (~reached & ((tension > 0) | (quantity == "tip_angle")), Status.unreachable),
            (turns.too_many, Status.too_many_turns),
            (added.status != Status.successful, added.status),
            (~reached, Status.slack),
        ),
        _states=states if known.size else _with_rest_before(states),
    )


def _with_rest_before(states: CongruentStates) -> CongruentStates:
    """The states from rest behind as many steps of 0 N as a continued history has, so that `lax.scan` carries both."""
    turns, zero = states.turns, 0.0 * states.path[:1]
    count = turns.open.shape[1]
    resting = open_turns(jnp.zeros(count), count)[1]

    def later(step: Array) -> Array:
        return jnp.where(step == NO_STEP, NO_STEP, step + count)

    turns = turns._replace(before=later(turns.before), open=later(turns.open))
    behind = jax.tree.map(lambda a, b: jnp.concatenate([a.astype(b.dtype), b]), resting, turns)
    zeros = jnp.zeros(count) + zero
    path, front = jnp.concatenate([zeros, states.path]), jnp.concatenate([zeros, states.front])
    return replace(states, path=path, turns=behind, front=front, earlier=jnp.zeros(2) + zero)


def _path(
    body: Manipulator, nodes: int, quantity: str, known: Array, wanted: Array, max_turns: int
) -> tuple[Float[Array, " path"], Turns, Bool[Array, " steps"]]:
    """The known base tensions and those of the wanted values, N; the turns of the whole path; what is reached."""
    if quantity == "base_tension":
        path = jnp.concatenate([known, wanted])
        return path, open_turns(path, max_turns)[1], jnp.ones_like(wanted, bool)
    stack, turns = open_turns(known, max_turns)
    bodies = unknown(body, 0.0 * wanted[0], max_turns)
    bodies = follow(body, nodes, known, turns)[2] if known.size > 0 else bodies
    found = driven(body, nodes, quantity, wanted, stack, bodies, known.size)
    path = jnp.concatenate([known, found.tension])
    if quantity == "tip_angle" and body.in_space:  # it need not turn where the tension turns
        return path, open_turns(path, max_turns)[1], found.reached
    return path, jax.tree.map(lambda a, b: jnp.concatenate([a, b]), turns, found.turns), found.reached


def follow(
    body: Manipulator, nodes: int, path: Float[Array, " path"], turns: Turns
) -> tuple[Float[Array, " path"], Composed, Composed]:
    """Front and body after each step of a path that started at rest; the bodies at the turns remembered at its end."""
    all_motions, each = motions(path, turns), partial(ends_of_motion, body, nodes)
    own, other = jax.lax.map(each, all_motions, batch_size=BLOCK)
    moving = jax.vmap(partial(moving_front, body))(own.end, own.tension, other.tension, turns.direction)
    front = jnp.where(all_motions.from_rest, own.end, moving)

    def add(bodies: Composed, given: tuple[Motion, Slid, Slid, Int[Array, ""]]) -> tuple[Composed, Composed]:
        motion, own, other, place = given
        new = composed(body, at_place(bodies, place - 1), motion, own, other)
        return put(bodies, place, new), new

    nothing = unknown(body, zero_as((own, body.length)), turns.open.shape[1])
    remembered, bodies = jax.lax.scan(add, nothing, (all_motions, own, other, turns.place))
    return front, bodies, remembered


# --- along the body ------------------------------------------------------------------------------


class _Part(NamedTuple):
    """A part of a traced body, and the rigid motion of the equilibrium to which it belongs."""

    start: Number  # s, m
    end: Number
    branch: Int[Array, ""]  # the step to whose equilibrium it belongs
    turned: Heading  # the rotation about the base
    moved: Float[Array, " components"]  # the displacement after that rotation, m
    wrapped: Float[Array, " tendons"]  # the wrap angle less that of the equilibrium, rad


class _Body(NamedTuple):
    """The end of a traced body, as far as it is composed."""

    end: Number  # s, m
    heading: Heading
    position: Float[Array, " components"]
    wrap_angle: Float[Array, " tendons"]


def _parts(branches: Dense, open_steps: Int[Array, " turns"]) -> _Part:
    """The parts of the body after one step, from the base on: the newest turn first."""
    zero = zero_as(branches.edges)
    start = _Body(zero, *pose_of_base(branches.manipulator, zero), zero[None])

    def add(body: _Body, step: Int[Array, ""]) -> tuple[_Body, _Part]:
        index = jnp.maximum(step, 0)
        of = jax.tree.map(lambda x: x[index], branches)
        end = of.edges[-1]
        covers = (step != NO_STEP) & (end > body.end)
        joint, there = of.state(jnp.minimum(body.end, end)), of.state(end)
        turned = turned_on(body.heading, turned_back(_heading(joint)))
        moved = body.position - rotated(joint.position, turned)
        wrapped = body.wrap_angle - joint.wrap_angle
        part = _Part(body.end, jnp.where(covers, end, body.end), index, turned, moved, wrapped)
        further = _Body(
            end, turned_on(turned, _heading(there)), moved + rotated(there.position, turned), wrapped + there.wrap_angle
        )
        return jax.tree.map(lambda new, old: jnp.where(covers, new, old), further, body), part

    return jax.lax.scan(add, start, open_steps[::-1])[1]


def _heading(state: State) -> Heading:
    return state.heading if state.heading.ndim == 0 else as_matrix(state.heading)


def _fields_at(branches: Dense, parts: _Part, arc_length: Number) -> AnyFields:
    """The fields at one arc length, tendons last, of a body of several parts; NaN off the body."""
    part = jax.tree.map(lambda x: x[jnp.argmax((parts.end > parts.start) & (arc_length <= parts.end))], parts)
    fields = jax.tree.map(lambda x: x[part.branch], branches)(arc_length)
    placed = {  # moved to where the part lies in the traced body
        "position": part.moved + rotated(fields.position, part.turned),
        "wrap_angle": fields.wrap_angle + part.wrapped,
        "normal_force": rotated(fields.normal_force, part.turned),
        "friction_force": rotated(fields.friction_force, part.turned),
    }
    if isinstance(fields, SpatialFields):
        path = part.moved + rotated(fields.path, part.turned)
        return replace(fields, frame=turned_on(part.turned, fields.frame), path=path, **placed)
    return replace(fields, heading=turned_on(part.turned, fields.heading), **placed)
