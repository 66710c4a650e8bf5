"""The search for directions, the moment at the base, and sign changes. With these, one pass solves a body.

The search has no derivatives: `balance` gives them to the result, by the implicit function theorem.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.directions import find_directions, travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.problem import (
    Method,
    Moment,
    Nodal,
    Number,
    Problem,
    at_base,
    cut_into_panels,
    everywhere,
    identity_as,
    lay_out,
    loaded_to,
    pull_at_nodes,
    unloaded,
    unstrained,
)
from ..mechanics.sign_changes import Splits, locate, num_splits, only_if, tied_to, unsplit
from ..numerics.arrays import largest_size, varying_as, zero_as
from ..numerics.quadrature import Panels, apart, of_rows, rows_of
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from .corrector import Flag, LoadedBody, Trial, start_from
from .load_path import LoadPath, follow_loads

MAX_ROUNDS = 6
MAX_MOVES = 12  # moves of the panels from pass to pass; then MAX_ROUNDS more, each from a settled body
ROUGHLY = 1e-2  # relative change in a pass below which panels follow the sign changes at once
NEARLY_SETTLED = 1e-3  # relative change in a pass below which a minimum in space hardly moves any more
FAR = 1e-3  # of the length: where panels move less, the values at their nodes follow to second order
OFF_KINK = 0.1  # a panel that ends at a distance d from a kink, of the length, errs by about OFF_KINK d^2
NEAR_MINIMUM = 0.1  # of the distance of a sharp minimum in space from a kink: panels may end so far from the minimum
SETTLED = 1e-7  # of the length: panels may end so far from a kink, at the cost of an error of 1e-14


class Setup(eqx.Module):
    """A manipulator, its loads, and the settings of the solve."""

    manipulator: Manipulator
    direction: PerTendon  # any number for a tendon whose direction is to be found
    loads: Loads | None
    method: Method
    nodes: int = eqx.field(static=True)
    to_find: tuple[int, ...] = eqx.field(default=(), static=True)  # the tendons whose direction is not stated

    def lay_out(self, base_tension: PerTendon, splits: Splits | None, cut: Panels | None = None) -> Problem:
        """The problem under the full loads, with panels that end at `splits` as well: `cut`, if they are known."""
        at = self.manipulator, base_tension, self.direction, self.nodes, self.loads
        return lay_out(*at, splits.arc_length if splits is not None and splits.arc_length.size else None, cut)

    def sliding(self, direction: PerTendon) -> "Setup":
        """The same with other directions."""
        return eqx.tree_at(lambda setup: setup.direction, self, direction)


class Settled(NamedTuple):
    """What was found for given base tensions."""

    direction: PerTendon
    load_path: LoadPath
    splits: Splits
    trial: Trial | None  # the values at the nodes; None where nothing has to be found
    travel: PerTendon | None  # with which directions are compared, m; None likewise


def needs_search(setup: Setup) -> bool:
    """Whether a moment at the base, sign changes or directions have to be found; static."""
    return setup.loads is not None or num_splits(setup.manipulator, None) > 0 or len(setup.to_find) > 0


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one pass solves. Where the path of the loads ended early, it is under the loads of its end."""
    problem = setup.sliding(settled.direction).lay_out(base_tension, settled.splits)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no sign changes."""
    start = _without_search(setup, base_tension)
    if not needs_search(setup):
        return start
    zero = start.load_path.num_steps
    return start._replace(trial=_first_trial(setup, _cut(setup, start.splits), zero), travel=base_tension + zero)


def _without_search(setup: Setup, base_tension: PerTendon) -> Settled:
    """What is known where nothing has to be found."""
    zero = zero_as(setup, base_tension)
    true = zero == 0
    splits = varying_as(unsplit(setup.manipulator, setup.loads), zero)
    load_path = LoadPath(
        base_moment=zero + jnp.zeros(3) if setup.manipulator.in_space else zero,
        fraction=zero + 1.0 if setup.loads is None else zero,
        num_steps=zero,
        converged=true,
        stable=true,
        resolved=true,
    )
    return Settled(setup.direction + zero, load_path, splits, None, None)


def _first_trial(setup: Setup, cut: Panels, zero: Number) -> Trial:
    """The body without friction and loads."""
    ones = jnp.ones(setup.manipulator.num_tendons, zero.dtype)
    guess = everywhere(cut, unloaded(setup.manipulator, ones, setup.loads))
    return start_from(guess, unstrained(setup.manipulator, setup.loads, guess.ratio), zero)


def first_guess(values: Nodal) -> Nodal:
    """The values at the nodes without friction and loads, in the shape of `values`."""
    moment = None if values.moment is None else jnp.zeros_like(values.moment)
    frame = None if values.frame is None else jnp.zeros_like(values.frame) + identity_as(values.frame)
    return Nodal(jnp.ones_like(values.ratio), moment, frame)


def _cut(setup: Setup, splits: Splits) -> Panels:
    return cut_into_panels(setup.manipulator, setup.nodes, splits.arc_length)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Find the directions that are not stated, the base moment, and the sign changes; without derivatives."""
    if not needs_search(setup):
        return unsettled(setup, base_tension)
    if not setup.to_find:
        return _settle_as_stated(setup, base_tension)
    start = unsettled(setup, base_tension)

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Flag]:
        settled = _settle_as_stated(setup.sliding(direction), base_tension)
        assert settled.travel is not None
        return settled, settled.travel, settled.load_path.converged

    return find_directions(setup.manipulator, base_tension, start.direction, setup.to_find, attempt, start)


class _Following(NamedTuple):
    """Passes over panels that follow the sign changes."""

    trial: Trial
    travel: PerTendon
    ends: Splits  # where the panels end
    cut: Panels
    enough: Number  # relative change in a pass above which the next pass follows, with the panels where they are
    num_moves: Number  # -1 at the end of a path of loads, where the panels move before the first pass
    over: Flag


def _settle_as_stated(setup: Setup, base_tension: PerTendon) -> Settled:
    """Find the rest for the directions of the setup: along the path of the loads, then with panels at sign changes.

    Along the path the panels end only where the body is not smooth.
    """
    blank = _without_search(setup, base_tension)
    found, zero, cut = blank.load_path, blank.load_path.num_steps, _cut(setup, blank.splits)
    if setup.loads is None:
        trial, num_moves = _first_trial(setup, cut, zero), zero
    else:
        problem = setup.lay_out(base_tension, None)
        guess = everywhere(problem.panels, at_base(problem))
        found, near = follow_loads(LoadedBody(problem, setup.method), guess, zero)
        here, unstacked = _stacked(near)
        count = cut.nodes.shape[0] - guess.ratio.shape[0]
        trial, num_moves = unstacked(jax.vmap(partial(problem.panels.with_empty, count=count))(here)), zero - 1.0

    follow = partial(_follow_sign_changes, setup, base_tension, found.fraction)
    over = ~found.converged | trial.lost
    start = _Following(trial, base_tension + zero, blank.splits, cut, zero + jnp.inf, num_moves, over)
    end = jax.lax.while_loop(lambda state: ~state.over, follow, start)
    trial = end.trial
    found = found._replace(
        base_moment=found.base_moment if trial.moment is None else trial.moment,
        converged=found.converged & trial.settled,
        stable=jnp.where(trial.num_passes > 0, trial.stable, found.stable),
        resolved=found.resolved & trial.sane & (trial.settled | ~found.converged),
    )
    return Settled(blank.direction, found, end.ends, trial, end.travel)


def _follow_sign_changes(setup: Setup, base_tension: PerTendon, fraction: Number, state: _Following) -> _Following:
    """Make a pass unless the body has settled, locate the sign changes, and decide whether to move the panels there.

    At the end of a path of loads the panels move before the first pass, which would be wasted on other panels.
    Panels move at once where a pass changes little. Where sign changes appear and disappear, the panels move only after
    the body has settled. Passes follow each other until one changes less than the error that the distance from a kink
    may cause; where panels end near enough to a sharp minimum in space, until the body has settled.
    """
    ends, num_moves = state.ends, state.num_moves
    problem = setup.lay_out(base_tension, ends, state.cut)
    body = LoadedBody(problem, setup.method)

    def one_more(passes: tuple[Flag, Trial]) -> tuple[Flag, Trial]:
        _, start = passes
        trial = body.correct(start, fraction, fraction < 0)
        kept = jax.tree.map(lambda before, after: jnp.where(trial.lost, before, after), _kept(start), _kept(trial))
        trial = trial._replace(**kept)
        return (trial.change > state.enough) & ~(trial.settled | trial.lost), trial

    passes = ~state.trial.settled & (num_moves >= 0), state.trial
    trial = jax.lax.while_loop(lambda at: at[0], one_more, passes)[1]
    splits = locate(problem, body.state(trial, fraction), ends)
    moves = splits.arc_length - ends.arc_length
    distance = (largest_size(moves) if moves.size else jnp.zeros_like(fraction)) / problem.panels.edges[-1]
    calm = (num_moves < MAX_MOVES) & (trial.change <= ROUGHLY)
    in_place = max(SETTLED, 16 * float(jnp.finfo(distance.dtype).eps))
    away, enough = distance > in_place, OFF_KINK * distance**2
    if problem.in_space and moves.size:
        away = jnp.any(jnp.abs(moves) > _near_minimum(problem, splits, in_place))
        enough = jnp.where(away | (trial.change > NEARLY_SETTLED), jnp.inf, 0.0)
    move = away & (num_moves < MAX_MOVES + MAX_ROUNDS) & (trial.settled | calm)
    settled = trial.settled & ~move
    over = trial.lost | settled

    def travelled(before: PerTendon) -> PerTendon:
        nodal = trial.nodal._replace(ratio=trial.nodal.ratio + tied_to(before))
        here = body.travel(trial._replace(nodal=nodal), fraction)
        return travel_under_tension(problem, pull_at_nodes(problem, nodal), here)

    ends = jax.tree.map(lambda new, old: jnp.where(move, new, old), splits, ends) if moves.size else ends
    new = _cut(setup, ends)

    def moved(trial: Trial) -> Trial:
        here, unstacked = _stacked(trial, headings=False)
        near = jax.vmap(problem.panels.shifted, (0, None))(here, new)

        def far(near: Array) -> Array:
            weights = problem.panels.weights_on(Panels.between(new.edges + tied_to(near), new.order))
            return (here.reshape(here.shape[0], -1) @ weights.T).reshape(here.shape)

        return unstacked(only_if(distance > FAR, far, near))

    travel = only_if(over, travelled, state.travel)
    trial = only_if(move, moved, trial)
    num_passes, change = (jnp.where(move, 0.0, number) for number in (trial.num_passes, trial.change))
    return _Following(
        trial=trial._replace(settled=settled, num_passes=num_passes, change=change),
        travel=travel,
        ends=ends,
        cut=new,
        enough=enough,
        num_moves=jnp.maximum(num_moves, 0.0) + jnp.where(move, 1.0, 0.0),
        over=over,
    )


def _near_minimum(problem: Problem, splits: Splits, in_place: float) -> Float[Array, "3"]:
    """How far from a sharp minimum in space, and from the places beside it, the panels may end, m.

    Args:
        problem: the body.
        splits: the minimum and the places beside it.
        in_place: how far the panels may end from an exact kink, of the length.
    """
    length, beside = problem.panels.edges[-1], jnp.max(jnp.diff(splits.arc_length))
    from_kink = beside**2 / length  # as `locate` chose the places beside the minimum
    at_minimum = jnp.maximum(NEAR_MINIMUM * from_kink, in_place * length)
    return jnp.stack([NEAR_MINIMUM * beside, at_minimum, NEAR_MINIMUM * beside])


def _kept(trial: Trial) -> dict[str, Nodal | Moment | Array | None]:
    """What the result takes from the trial before a pass that fails."""
    names = "nodal", "moment", "strain", "settled", "sane", "num_passes"
    return {name: getattr(trial, name) for name in names}


def _stacked(trial: Trial, headings: bool = True) -> tuple[Float[Array, "numbers P p"], Callable[[Array], Trial]]:
    """All values and slopes at the nodes in one array, and the trial with such an array in their place.

    Args:
        trial: at the nodes.
        headings: whether headings are part of it. The next pass computes them anew.
    """
    values = trial.nodal, trial.strain, trial.heading.nodes if headings and trial.heading is not None else None
    slopes = None if trial.slopes is None else (trial.slopes.nodal, trial.slopes.heading.nodes if headings else None)
    arrays, structure = jax.tree.flatten((values, slopes))
    leading = [0] * len(jax.tree.leaves(values)) + [1] * len(jax.tree.leaves(slopes))  # axes before panels and nodes
    rows = [rows_of(*each) for each in zip(arrays, leading, strict=True)]

    def unstacked(stack: Array) -> Trial:
        parts = zip(apart(stack, rows), arrays, leading, strict=True)
        (nodal, strain, heading), slopes = structure.unflatten([of_rows(*each) for each in parts])
        moved = trial._replace(nodal=nodal, strain=strain)
        if trial.heading is None or trial.slopes is None:
            return moved
        by_nodal, by_heading = slopes
        slopes = trial.slopes._replace(nodal=by_nodal)
        if headings:
            slopes = slopes._replace(heading=slopes.heading._replace(nodes=by_heading))
            moved = moved._replace(heading=trial.heading._replace(nodes=heading))
        return moved._replace(slopes=slopes)

    return jnp.concatenate(rows), unstacked
