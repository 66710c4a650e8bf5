"""Pull and release with several tendons or with loads: the path is followed in increments.

Where tendons act on each other, or loads on the shape, a resting tendon does not keep its tension, and there is no
closed form. So each step of the path, which is straight, is divided into increments, and the slip of each tendon is
followed. Two more passes, with half as many elements and with half as many increments, estimate the error.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.fields import AnyFields
from ..mechanics.friction import PerTendon
from ..mechanics.problem import lay_out
from ..numerics import tolerances as tol
from ..numerics.arrays import largest_size, varying_as, zero_as
from ..numerics.fixed_point import without_derivative
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.arguments import harmless, is_physical
from ..statics.equilibrium import nan_unless
from ..statics.status import Status, first_of
from .grid import Given, Goal, Grid, Node, Number, cut_into_elements, loads_on
from .history import Energies, History, States
from .increment import FOUND, tendons_of
from .instants import (
    AT_LIMIT,
    Instant,
    TipPose,
    at_rest,
    base_direction,
    crosses,
    difference,
    fields_of_instant,
    fronts_of,
    moved,
    shape_of,
    stored_in,
    tip_of,
    under_no_loads,
    without_friction,
)
from .path import Path

ELEMENTS = 3  # times the nodes in each smooth piece of the body, one more where that is odd
ACCURACY = 1e-2  # a step with a larger error estimate is called inaccurate
FULL_TURN = 0.5  # rad, by which a step of tensions turns the body without friction: smaller ones have fewer increments
TRIED = 3  # times the increments that are wanted: so many are tried, where some have to be cut
LEAST_WIDTH = 1e-4  # part of a step, the least increment
SAFETY = 2.0  # factor on the differences of the passes in the error estimate
LEAST_ERROR = 2e-5  # the error that the stretch of stiff tendons may cause, and the law with the least elastic slip
LEAST_SLACK = 1e-9  # of an offset; a tendon that is so much longer than wanted is slack
LEAST_SLIP = 1e-2  # of the largest slip of an increment; a tendon that slips less rests


class Following(NamedTuple):
    """How a path is followed; static."""

    driven: tuple[Goal, ...]
    num_elements: int  # in each smooth piece of the body
    num_increments: int  # in each step of the path
    estimated: bool = True  # whether two more passes estimate the error


class SteppedStates(States):
    """The bodies after all steps of a path."""

    manipulator: Manipulator
    passes: Instant  # first axis: fine, and to estimate its error rough elements, rough increments; second axis: steps
    loads: Loads  # after the last step
    num_elements: int = eqx.field(static=True)

    @property
    def grid(self) -> Grid:
        return cut_into_elements(self.manipulator, self.num_elements, self.loads)

    @property
    def instants(self) -> Instant:
        """Those of the fine pass; the axis of steps comes first."""
        return jax.tree.map(lambda x: x[0], self.passes)

    @property
    def arc_length(self) -> Float[Array, " points"]:
        return self.grid.places

    def energies(self) -> Energies:
        stored = jax.vmap(partial(stored_in, self.grid))(self.instants)
        # the error of the trapezoidal rule falls with the square of the increment; its part of the work counts as lost
        fine, rough = self.passes.work[0], self.passes.work[-1]
        more = (fine - rough) / 3
        return Energies(fine + more, self.instants.friction_loss + more, stored)

    def fields(self, arc_length: Float[Array, " points"]) -> AnyFields:
        grid, instants = self.grid, self.instants
        shapes = jax.vmap(partial(shape_of, grid))(instants)
        at_points = jax.vmap(partial(fields_of_instant, grid), (None, None, 0))
        return jax.vmap(at_points, (0, 0, None))(instants, shapes, arc_length)

    def sliding(self, arc_length: Float[Array, " points"]) -> Float[Array, "steps *tendons points"]:
        slid, places = self.instants.slid, self.grid.places
        moves = jnp.abs(slid) > LEAST_SLIP * jnp.max(jnp.abs(slid), axis=(1, 2), keepdims=True)
        slides = moves & (jnp.abs(self.instants.body.share) > 1 - AT_LIMIT)
        element = jnp.clip(jnp.sum(places <= arc_length[:, None], axis=1) - 1, 0, places.size - 2)
        found = jnp.moveaxis(jnp.where(slides, jnp.sign(slid), 0.0)[:, element], 1, -1)
        return found[:, 0] if found.shape[1] == 1 else found


class _SoFar(NamedTuple):
    """How far a step has come."""

    instant: Instant
    done: Number  # part of the step
    width: Number  # of the next increment, as a part of the step


# --- along the path -------------------------------------------------------------------------------


def _followed(
    manipulator: Manipulator, path: Path, kind: Following, start: Instant | None, halved: tuple[Number, Number]
) -> tuple[Instant, TipPose]:
    """The instants after all steps, and their tips.

    Args:
        manipulator, path, kind: as in `stepped_history`.
        start: the instant before the first step; None for rest.
        halved: 1 for half as many elements, and for half as many increments; else 0.
    """
    zero = zero_as(manipulator, path, halved)  # under shard_map all numbers vary over the devices, or none
    grid = varying_as(cut_into_elements(manipulator, kind.num_elements, _last(path.loads), halved[0]), zero)
    given = varying_as(jax.vmap(partial(_given, grid))(path.given, path.by_goal, path.loads), zero)
    advance = partial(_advanced, grid, kind.num_increments, halved[1] + zero)
    start = _before_first(grid, path, start, advance, zero)
    start = start._replace(given=_as_read(grid, kind.driven, start.body.nodes, start.given, 0.0))
    instants = jax.lax.scan(partial(advance, kind.driven), start, given)[1]
    return instants, jax.vmap(partial(tip_of, grid))(instants)


def _before_first(grid: Grid, path: Path, start: Instant | None, advance: Callable, zero: Number) -> Instant:
    """The instant before the first step: `start`, or rest, where loads may act already."""
    resting = path.resting if start is None else None
    start = at_rest(grid) if start is None else start
    if path.loads is not None and start.given.force is None:
        start = under_no_loads(grid, start)
    start = varying_as(start, zero)
    if resting is None:
        return start
    none = jnp.zeros_like(path.given[0])
    first = varying_as(_given(grid, none, none, resting), zero)
    free = start._replace(body=start.body._replace(held=None))
    return without_friction(grid, advance((), free, first)[0])


def _advanced(
    grid: Grid, most: int, halved: Number, goals: tuple[Goal, ...], instant: Instant, to: Given
) -> tuple[Instant, Instant]:
    """The instant after a step, twice; an increment that does not settle is cut."""
    before = instant.given._replace(by_goal=to.by_goal)
    widest = (1.0 + halved) / (most if goals else _num_increments(grid, most, before, to))

    def part(so_far: _SoFar, _: None) -> tuple[_SoFar, None]:
        onto = jnp.minimum(so_far.done + so_far.width, 1.0)
        here = jax.tree.map(lambda a, b: a + onto * (b - a), before, to)
        over = (so_far.done >= 1.0) | (so_far.width < LEAST_WIDTH) | ~so_far.instant.body.converged

        def onwards(so_far: _SoFar) -> _SoFar:
            new = moved(grid, goals, so_far.instant, here)
            cut = _SoFar(so_far.instant, so_far.done, so_far.width / 4)
            went = _SoFar(new, onto, jnp.minimum(2 * so_far.width, widest))
            return jax.tree.map(partial(jnp.where, new.body.converged), went, cut)

        return jax.lax.cond(over, lambda so_far: so_far, onwards, so_far), None

    none = 0.0 * instant.work
    # in reverse mode all but the unknowns is computed again: a twentieth of the memory, and less to compile
    increment = jax.checkpoint(part, prevent_cse=False, policy=jax.checkpoint_policies.save_only_these_names(FOUND))
    end = jax.lax.scan(increment, _SoFar(instant, none, none + widest), None, TRIED * most)[0]
    body = end.instant.body._replace(converged=end.instant.body.converged & (end.done >= 1.0))
    instant = end.instant._replace(body=body, given=_as_read(grid, goals, body.nodes, to, to.by_goal))
    return instant, instant


def _as_read(grid: Grid, goals: tuple[Goal, ...], nodes: Node, given: Given, by_goal: PerTendon | float) -> Given:
    """The given numbers, with the base tensions of driven tendons as they were found, and their goals where not set."""
    tension, goal = given.base_tension, given.goal
    for each in goals:
        tension = tension.at[each.tendon].set(nodes.tension[0, each.tendon])
        goal = goal.at[each.tendon].set(grid.reading(nodes, each))
    return given._replace(base_tension=tension, goal=jnp.where(by_goal > 0, given.goal, goal))


def _num_increments(grid: Grid, most: int, before: Given, to: Given) -> Number:
    """Into how many increments a step of given tensions is divided: into fewer where they change little.

    All that happens in the body is then at most in proportion to it. A small displacement may change tensions much.
    """
    change = without_derivative(jax.tree.map(jnp.subtract, to, before))
    loads = [x for x in (change.force, change.moment, change.tip_moment) if x is not None]
    arm = grid.scale * jnp.sum(grid.weights / grid.geometry.bending_stiffness(grid.sections))
    few = jnp.clip(jnp.ceil(most * arm * largest_size(change.base_tension) / FULL_TURN), 2, most)
    return jnp.where(largest_size(loads) > 0, most, few) if loads else few


def _given(grid: Grid, given: PerTendon, by_goal: PerTendon, loads: Loads | None) -> Given:
    tension, goal = (jnp.where(which, given, 0.0) for which in (by_goal == 0, by_goal > 0))
    if loads is None:
        return Given(tension, goal, by_goal, None, None, None)
    return Given(tension, goal, by_goal, *loads_on(grid, loads), jnp.asarray(loads.tip_moment))


# --- the history of a path ------------------------------------------------------------------------


@partial(jax.jit, static_argnames="kind")
def stepped_history(manipulator: Manipulator, path: Path, start: SteppedStates | None, kind: Following) -> History:
    """The history of a path; its error is NaN where it is not estimated.

    Args:
        manipulator: the body.
        path: the given numbers after each step.
        start: the states that the path continues; None for rest.
        kind: how to follow the path; static.
    """
    wanted = path
    manipulator, path, physical = _checked(manipulator, path)
    count = 3 if kind.estimated else 1
    last = None if start is None else jax.tree.map(lambda x: x[:count, -1], start.passes)
    halved = jnp.array([0.0, 1.0, 0.0])[:count], jnp.array([0.0, 0.0, 1.0])[:count]
    follow = partial(_followed, manipulator, path, kind)
    passes, tips = jax.lax.map(lambda given: follow(*given), (last, halved))
    grid = cut_into_elements(manipulator, kind.num_elements, _last(path.loads))
    instants, tip = jax.tree.map(lambda x: x[0], (passes, tips))
    apart = jax.vmap(jax.vmap(partial(difference, grid)), (None, 0))(tip, jax.tree.map(lambda x: x[1:], tips))
    least = LEAST_ERROR if kind.estimated else jnp.nan
    least = least * jnp.maximum(1.0, instants.body.elastic / (tol.ELASTIC * grid.scale))
    error = least + SAFETY * jnp.sum(apart, axis=0)
    good = physical & jnp.all(passes.body.converged, axis=0)
    loads = _last(path.loads) or jax.tree.map(jnp.asarray, Loads().with_components(manipulator.components))
    states = SteppedStates(manipulator, passes, loads, kind.num_elements)
    pulled_in, pull = jax.vmap(grid.pulled_in)(instants.body.nodes), instants.given.base_tension
    geometry, share, slid = grid.geometry, instants.body.share, instants.slid
    numbers = pull, pulled_in, tip, error, fronts_of(grid, share, slid)
    pull, pulled_in, tip, error, front = jax.vmap(nan_unless)(good, numbers)
    driven = tendons_of(kind.driven)
    by_length = np.array([goal.quantity == "displacement" for goal in kind.driven], bool)
    missed = jnp.where(path.by_goal > 0, pulled_in - path.given, 0.0)[:, driven]
    slack = jnp.any(by_length & (missed > LEAST_SLACK * grid.scale), axis=1)
    least = LEAST_SLACK * grid.scale / grid.softness  # N, to which a tension of zero is found
    pushes = jnp.any(~by_length & (pull[:, driven] < -least), axis=1)
    return History(
        base_tension=wanted.given.at[:, driven].set(pull[:, driven]),
        tip_tension=tip.tension,
        tip_angle=jax.vmap(geometry.tip_angle)(tip.heading),
        tip_position=tip.position,
        tip_frame=jax.vmap(geometry.tip_frame)(tip.heading),
        direction=base_direction(share, slid),
        front=front,
        num_turns=None,
        tendon_displacement=pulled_in,
        error_estimate=error,
        status=first_of(
            (~physical, Status.unphysical),
            (~good, Status.not_converged),
            (jax.vmap(partial(crosses, grid))(instants), Status.crossing),
            (pushes, Status.unreachable),
            (error > ACCURACY, Status.inaccurate),
            (slack, Status.slack),
        ),
        _states=states,
    )


def _checked(manipulator: Manipulator, path: Path) -> tuple[Manipulator, Path, Bool[Array, " steps"]]:
    """Body and path with harmless numbers in place of unphysical ones; whether all steps so far are physical."""
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(manipulator)]))
    numbers = [x.reshape(x.shape[0], -1) for x in jax.tree.leaves(path._replace(resting=None))]
    possible = (path.given >= 0) | (path.by_goal > 0)
    usable = jnp.all(jnp.isfinite(jnp.concatenate(numbers, axis=1)), axis=1) & jnp.all(possible, axis=1)
    usable = jnp.cumprod(usable) > 0  # up to the first step that is not
    asked, ones = manipulator, jnp.ones_like(path.given[0])
    manipulator, _, _, (path,) = harmless(manipulator, ones, ones, (path,))
    path = path._replace(given=jnp.where(possible, path.given, 0.0))
    laid_out = lay_out(manipulator, ones, ones, 4, jax.tree.map(lambda x: x[0], path.loads))
    return manipulator, path, usable & finite & is_physical(asked, ones, ones, laid_out)


def squeezed(history: History) -> History:
    """The history of one tendon whose numbers have no axis of tendons."""
    per_tendon = "base_tension", "tip_tension", "direction", "front", "tendon_displacement"
    return replace(history, **{name: getattr(history, name)[:, 0] for name in per_tendon})


def after_first(history: History) -> History:
    """The history without its first step."""
    states, numbers = history._states, eqx.tree_at(lambda history: history._states, history, None)
    assert isinstance(states, SteppedStates)
    passes = jax.tree.map(lambda x: x[:, 1:], states.passes)
    later = replace(jax.tree.map(lambda x: x[1:], numbers), _states=replace(states, passes=passes))
    return after_step(history.tip_angle[0], history.status[0], later)


def after_step(tip_angle: Number, status: Int[Array, ""], later: History) -> History:
    """The history after a step; where that step failed, all later ones failed as it did."""
    good = jnp.isfinite(tip_angle)
    return replace(nan_unless(good, later), status=jnp.where(good, later.status, status), _states=later._states)


def _last(loads: Loads | None) -> Loads | None:
    return jax.tree.map(lambda x: x[-1], loads)
