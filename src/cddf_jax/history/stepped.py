"""Pull and release with several tendons or with loads: the path is followed in short steps.

Where tendons act on each other, or loads on the shape, a resting tendon does not keep its tension, and there is no
closed form. So each step of the path, which is straight, is divided into short steps, and the slip of each tendon is
followed. The error is estimated by two more passes, one with half as many cells and one with half as many short steps.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.fields import Fields
from ..mechanics.problem import lay_out
from ..numerics.arrays import varying_as, zero_as
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.arguments import harmless, is_physical
from ..statics.equilibrium import nan_unless
from ..statics.status import Status, first_of
from .cells import Cells, cut_into_cells, forces_along
from .differences import with_differences
from .history import Energies, History, States
from .instants import (
    AT_LIMIT,
    Given,
    Instant,
    TipPose,
    at_rest,
    crosses,
    difference,
    fields_of_instant,
    fronts_of,
    moved,
    pushed,
    shape_of,
    stored_in,
    tip_of,
)
from .path import Path
from .short_step import Ends

Number = Float[Array, ""]
Flags = Bool[Array, " steps"]
ACCURACY = 3e-2  # a step with a larger error estimate is called inaccurate
SAFETY = 2.0  # factor on the differences of the passes in the error estimate
LEAST_ERROR = 1e-5  # the error that the softened law and the stretch of stiff tendons may cause
LEAST_SLIP = 1e-6  # of the largest slip of a short step; a tendon that slips less rests


class Following(NamedTuple):
    """How a path is followed; static."""

    driven: tuple[int, ...]  # the tendons whose displacement is given
    num_cells: int
    num_steps: int  # in each step of the path


class SteppedStates(States):
    """The bodies after all steps of a path."""

    manipulator: Manipulator
    passes: Instant  # first axis: the fine pass, that with rough cells, that with rough steps; second axis: steps
    loads: Loads  # after the last step
    num_cells: int = eqx.field(static=True)

    @property
    def cells(self) -> Cells:
        return cut_into_cells(self.manipulator, self.num_cells)

    @property
    def instants(self) -> Instant:
        """Those of the fine pass; the axis of steps comes first."""
        return jax.tree.map(lambda x: x[0], self.passes)

    @property
    def arc_length(self) -> Float[Array, " points"]:
        return self.cells.edges

    def energies(self) -> Energies:
        stored = jax.vmap(partial(stored_in, self.cells))(self.instants)

        # the error of the trapezoidal rule falls with the square of the step; its part of the work counts as lost
        fine, _, rough = self.passes.work
        more = (fine - rough) / 3
        return Energies(fine + more, self.instants.friction_loss + more, stored)

    def fields(self, arc_length: Float[Array, " points"]) -> Fields:
        shapes = jax.vmap(partial(shape_of, self.cells))(self.instants)
        at_points = jax.vmap(partial(fields_of_instant, self.manipulator, self.cells), (None, None, 0))
        return jax.vmap(at_points, (0, 0, None))(self.instants, shapes, arc_length)

    def sliding(self, arc_length: Float[Array, " points"]) -> Float[Array, "steps *tendons points"]:
        slid = self.instants.slid
        moves = jnp.abs(slid) > LEAST_SLIP * jnp.max(jnp.abs(slid), axis=(1, 2), keepdims=True)
        slides = moves & (jnp.abs(self.instants.step.share) > 1 - AT_LIMIT)
        found = jnp.moveaxis(jnp.where(slides, jnp.sign(slid), 0.0)[:, self.cells.at(arc_length)], 1, -1)
        return found[:, 0] if found.shape[1] == 1 else found


class _Rough(NamedTuple):
    """How a pass differs from the fine one. The difference of their results estimates the error."""

    cells: Number  # 1 for half as many, else 0
    steps: Number  # 1 for half as many short steps, else 0


# --- along the path -------------------------------------------------------------------------------


def _followed(
    manipulator: Manipulator, path: Path, kind: Following, start: Instant | None, rough: _Rough
) -> tuple[Instant, TipPose, Float[Array, "steps tendons"], Bool[Array, " steps"]]:
    """The instants after all steps, their tips, fronts, and whether fibres cross.

    Args:
        manipulator, path, kind: as in `stepped_history`.
        start: the instant before the first step; None for rest.
        rough: how the pass differs from the fine one.
    """
    cells = cut_into_cells(manipulator, kind.num_cells, rough.cells)
    zero = zero_as(manipulator, path)  # under shard_map all of them vary over the devices, or none
    path = path.behind(jnp.zeros_like(path.tension[0])) if start is None else path
    given = varying_as(_given(manipulator, cells, path, kind, rough.cells), zero)
    if start is None:
        start = at_rest(manipulator, cells, jax.tree.map(lambda x: x[0], given), path.resting)
        given = jax.tree.map(lambda x: x[1:], given)
    start = varying_as(start, zero)
    counts = jnp.arange(1, kind.num_steps + 1)
    driven = jnp.asarray(kind.driven, int)

    def advance(instant: Instant, to: Given) -> tuple[Instant, Instant]:
        before = instant.given

        def part(instant: Instant, count: Array) -> tuple[Instant, None]:
            here = jax.tree.map(lambda a, b: a + count / kind.num_steps * (b - a), before, to)
            left_out = (rough.steps > 0) & ((kind.num_steps - count) % 2 == 1)
            moves = partial(moved, cells, kind.driven)
            return jax.lax.cond(left_out, lambda instant, _: instant, moves, instant, here), None

        instant = jax.lax.scan(part, instant, counts)[0]
        edges, ends = instant.step.edges, instant.given.ends
        tension = ends.base_tension.at[driven].set(edges.tension[0, driven])  # as it was found
        found = to._replace(ends=ends._replace(base_tension=tension, displacement=cells.pulled_in(edges)))
        return instant._replace(given=to), instant._replace(given=found)

    instants = jax.lax.scan(advance, start, given)[1]
    tip = jax.vmap(partial(tip_of, cells))(instants)
    return instants, tip, fronts_of(cells, instants.step.share), jax.vmap(partial(crosses, cells))(instants)


def _given(manipulator: Manipulator, cells: Cells, path: Path, kind: Following, rough: Number) -> Given:
    count = path.tension.shape[0]
    if path.loads is None:
        outboard = jnp.zeros((count, *cells.sections.stiffness.shape, 2), path.tension.dtype)
        return Given(Ends(path.tension, path.displacement, jnp.zeros(count, path.tension.dtype)), outboard)
    outboard = jax.vmap(partial(forces_along, manipulator, kind.num_cells, rough))(path.loads)
    return Given(Ends(path.tension, path.displacement, jnp.asarray(path.loads.tip_moment)), outboard)


# --- the history of a path ------------------------------------------------------------------------


@partial(jax.jit, static_argnames="kind")
def stepped_history(manipulator: Manipulator, path: Path, start: SteppedStates | None, kind: Following) -> History:
    """The history of a path, with an error estimate from two passes with half the cells and with half the steps.

    Args:
        manipulator: the body.
        path: the given numbers after each step.
        start: the states that the path continues; None for rest.
        kind: how to follow the path; static.
    """
    wanted, ones = path, jnp.ones_like(path.tension[0])
    manipulator, path, physical = _checked(manipulator, path)
    last = None if start is None else jax.tree.map(lambda x: x[:, -1], start.passes)
    follow = partial(_followed, manipulator, path, kind)
    rough = _Rough(cells=jnp.array([0.0, 1.0, 0.0]), steps=jnp.array([0.0, 0.0, 1.0]))
    if last is None:
        passes, tips, fronts, crossing = jax.lax.map(lambda rough: follow(None, rough), rough)
    else:
        passes, tips, fronts, crossing = jax.lax.map(lambda given: follow(*given), (last, rough))
    cells = cut_into_cells(manipulator, kind.num_cells)
    instants, tip = jax.tree.map(lambda x: x[0], (passes, tips))
    others = jax.tree.map(lambda x: x[1:], tips)
    apart = jax.vmap(jax.vmap(partial(difference, cells)), (None, 0))(tip, others)
    error = LEAST_ERROR + SAFETY * jnp.sum(apart, axis=0) + jax.vmap(partial(pushed, cells))(instants, tip)
    step = instants.step
    good = physical & jnp.all(passes.step.converged, axis=0)
    numbers = jax.vmap(nan_unless)(good, (instants.given.ends, tip, error, fronts[0]))
    ends, tip, error, front = numbers
    states = SteppedStates(manipulator, passes, _last(path), kind.num_cells)
    slack = jnp.zeros_like(good)
    if kind.driven:
        short = instants.given.ends.displacement - path.displacement > 1e-9 * cells.scale
        slack = jnp.any(short[:, list(kind.driven)], axis=1)
    return History(
        base_tension=jnp.where(
            jnp.isin(jnp.arange(ones.size), jnp.asarray(kind.driven)), ends.base_tension, wanted.tension
        )
        if kind.driven
        else wanted.tension,
        tip_tension=tip.tension,
        tip_angle=tip.heading,
        tip_position=tip.position,
        tip_frame=None,
        direction=jnp.where(step.share[:, 0] < 0, -1.0, 1.0),
        front=front,
        num_turns=None,
        tendon_displacement=ends.displacement,
        error_estimate=error,
        status=_status(physical, good, crossing[0], error, slack),
        _states=states,
    )


def _checked(manipulator: Manipulator, path: Path) -> tuple[Manipulator, Path, Bool[Array, " steps"]]:
    """Body and path with harmless numbers in place of unphysical ones; whether all steps so far are physical."""
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(manipulator)]))
    usable = jnp.cumprod(_usable(path)) > 0  # up to the first step that is not
    asked, ones = manipulator, jnp.ones_like(path.tension[0])
    manipulator, _, _, (path,) = harmless(manipulator, ones, ones, (path,))
    path = path._replace(tension=jnp.maximum(path.tension, 0.0))
    laid_out = lay_out(manipulator, ones, ones, 4, _first(path.loads))
    return manipulator, path, usable & finite & is_physical(asked, ones, ones, laid_out)


class Tips(NamedTuple):
    """The tip after each step; flags are 1 for yes."""

    tension: Float[Array, "steps tendons"]  # N
    heading: Float[Array, " steps"]  # rad
    position: Float[Array, "steps 2"]  # m
    physical: Float[Array, " steps"]
    good: Float[Array, " steps"]
    crossing: Float[Array, " steps"]


def tips_along(manipulator: Manipulator, path: Path, kind: Following) -> Tips:
    """The tip along a path from rest, by one pass and without an error estimate; NaN where a step failed.

    Derivatives are differences, in forward mode. Those of the equations hold fronts fixed within their cells, and are
    accurate to a few per cent only.

    Args:
        manipulator, path, kind: as in `stepped_history`.
    """

    def tips(given: tuple[Manipulator, Path]) -> Tips:
        manipulator, path, physical = _checked(*given)
        none = jnp.zeros((), path.tension.dtype)
        instants, tip, _, crossing = _followed(manipulator, path, kind, None, _Rough(none, none))
        good = physical & instants.step.converged
        tip = jax.vmap(nan_unless)(good, tip)
        flags = (flag.astype(path.tension.dtype) for flag in (physical, good, crossing))
        return Tips(tip.tension, tip.heading, tip.position, *flags)

    return with_differences(tips, (manipulator, path))


def status_of_tips(tips: Tips) -> Int[Array, " steps"]:
    """How each step ended."""
    physical, good, crossing = (flag > 0 for flag in (tips.physical, tips.good, tips.crossing))
    fine = jnp.zeros_like(tips.heading)
    return _status(physical, good, crossing, fine, fine > 0)


def _status(
    physical: Flags, good: Flags, crossing: Flags, error: Float[Array, " steps"], slack: Flags
) -> Int[Array, " steps"]:
    return first_of(
        (~physical, Status.unphysical),
        (~good, Status.not_converged),
        (crossing, Status.crossing),
        (error > ACCURACY, Status.inaccurate),
        (slack, Status.slack),
    )


def squeezed(history: History) -> History:
    """The history of one tendon whose numbers have no axis of tendons."""

    def per_tendon(history: History):
        return (
            history.base_tension,
            history.tip_tension,
            history.direction,
            history.front,
            history.tendon_displacement,
        )

    return eqx.tree_at(per_tendon, history, [x[:, 0] for x in per_tendon(history)])


def after_first(history: History) -> History:
    """The history without its first step. Where the first step failed, all steps count as failed."""

    def apart(history: History) -> tuple[States, Array]:
        return history._states, history.status

    good, states = jnp.isfinite(history.tip_angle[0]), history._states
    assert isinstance(states, SteppedStates)
    passes = jax.tree.map(lambda x: x[:, 1:], states.passes)
    status = jnp.where(good, history.status[1:], history.status[:1])
    numbers = eqx.tree_at(apart, history, (None, None))
    numbers = nan_unless(good, jax.tree.map(lambda x: x[1:], numbers))
    own = eqx.tree_at(lambda s: s.passes, states, passes), status
    return eqx.tree_at(apart, numbers, own, is_leaf=lambda x: x is None)


def _usable(path: Path) -> Bool[Array, " steps"]:
    """Whether the given numbers of each step are physical."""
    numbers = [x.reshape(x.shape[0], -1) for x in jax.tree.leaves(path._replace(resting=None))]
    finite = jnp.all(jnp.isfinite(jnp.concatenate(numbers, axis=1)), axis=1)
    return finite & jnp.all(path.tension >= 0, axis=1)


def _last(path: Path) -> Loads:
    none = jnp.zeros(2), jnp.zeros(()), jnp.zeros(2)
    return Loads(*none) if path.loads is None else jax.tree.map(lambda x: x[-1], path.loads)


def _first(loads: Loads | None) -> Loads | None:
    return jax.tree.map(lambda x: x[0], loads)
