"""The course of a table: what was set in the order in which it was measured, as one path for each trial.

Each trial starts from rest, a straight body whose tendon never had a tension, unless its `Past` says otherwise.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..errors import InputError
from ..history.history import History
from ..history.path import given_path
from ..history.stepped import Following, stepped_history
from ..history.trace import trace
from ..measurements.forces import forces_of
from ..measurements.holds import NO_STEP
from ..measurements.jitter import Steady, without_jitter
from ..measurements.readings import SetColumn, kind_of_set, set_by
from ..measurements.table import Measurements
from ..quantities import dimension_of
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.targets import Displacement
from ..units import shown
from .parameters import RUBBING, along_a_path, with_deviation
from .tension_before import REST, Past

STEPS = 16  # paths are traced in multiples of this number, so that tables share compiled programs
FEW_STEPS = 4  # the same for paths that are followed in increments
ELEMENTS_IN_FITS = 2  # times the nodes, half as many as `trace` takes: their error is told beside the estimates
SHORT_STEPS = 4  # in each step of a path without an exact answer
EACH = "each"  # of a history: every row is pulled from rest, its tensions and forces in proportion
CLOSE = 0.1  # standard errors: sums of squares have kinks where fronts pass nodes, about which searches would wander
MOST_REMEMBERED = 60  # turns whose effect on later rows counts in the errors of base tensions
WITHOUT = "give history=False (--no-history), which lets each tendon slide one way in each row"


LoadsWith = Callable[[Float[Array, "*steps places components"] | None], Loads | None]
MarkersOn = Callable[[History], Float[Array, "steps markers components"] | None]


class Shown(NamedTuple):
    """What instruments without errors show of bodies; the axis of rows comes first."""

    tendon_displacement: Float[Array, "rows tendons"]
    tip_tension: Float[Array, "rows tendons"]
    tip_angle: Float[Array, " rows"]
    tip_position: Float[Array, "rows components"]
    tip_axis: Float[Array, "rows components"]
    status: Int[Array, " rows"]
    direction_contradicted: Bool[Array, "rows tendons"]  # along a path nothing is
    markers: Float[Array, "rows markers components"] | None = None


class Course(eqx.Module):
    """Paths of base tensions or displacements, and which step of which path each row of a table is.

    One tendon without loads has an exact answer. Others are followed in increments.
    """

    readings: Float[np.ndarray | Array, "trials steps tendons"]  # N or m, as read, without jitter; the last is repeated
    trial: Int[np.ndarray | Array, " rows"]  # 0, 1, ... in the order of the paths
    step: Int[np.ndarray | Array, " rows"]
    first_row: Int[np.ndarray | Array, " trials"]  # a row of each trial
    max_turns: int = eqx.field(static=True)
    past: Past | None = None  # None: all trials start from rest
    forces: Float[np.ndarray | Array, "trials steps places components"] | None = None  # N, those on the tip first
    stays: tuple[bool, ...] = eqx.field(default=(), static=True)  # of each place, whether its force is the same in all
    # rows of every path, and of more than one; then it acts before the first step
    short_steps: int | None = eqx.field(default=None, static=True)  # of each step; None where the answer is exact
    by_length: tuple[bool, ...] = eqx.field(default=(False,), static=True)  # whether displacements set a tendon at all
    by_tension: Bool[np.ndarray | Array, "trials steps tendons"] | None = None  # where tensions set it; None: see above
    time: Float[np.ndarray | Array, "trials steps"] | None = None  # s, where the body comes after the motors

    @property
    def turns(self) -> bool:
        """Whether any of the paths turns, or began with a release."""
        return self.past is not None or bool(np.any(np.diff(np.asarray(self.readings), axis=1) < 0))

    @property
    def turn_steps(self) -> list[np.ndarray]:
        """By trial, the steps that later ones may remember: where a tension turned, and the first one after a past.

        At most `MOST_REMEMBERED`, those next to the largest moves.
        """
        found = []
        for path, by_length in zip(np.asarray(self.readings), self.set_by_length, strict=True):
            other_kind = np.diff(by_length, axis=0, prepend=by_length[:1])
            move = np.diff(path, axis=0, prepend=path[:1] if self.past is not None else 0 * path[:1]) * ~other_kind
            turns = np.append(np.any(other_kind[1:], axis=1), False)
            turns[0] |= self.past is not None
            for own in move.T:
                (there,) = np.nonzero(own)
                turned = np.sign(own[there[1:]]) != np.sign(own[there[:-1]])
                turns[there[1:][turned] - 1] = True
            (steps,) = np.nonzero(turns)
            size = np.max(np.abs(np.append(move[1:], move[:1] * 0, axis=0)), axis=1)[steps]
            found.append(np.sort(steps[np.argsort(-size, kind="stable")[:MOST_REMEMBERED]]))
        return found

    @property
    def along(self) -> np.ndarray:
        """(directions, trials, steps, tendons), changes of the readings: by each column that sets a tendon, as in
        `Measurements.set_columns`, of all steps but the turns, then of the first turn of each trial, and so on.
        """
        turns, shape = self.turn_steps, np.shape(self.readings)
        most = max(map(len, turns))
        most += -most % FEW_STEPS
        by_length = self.set_by_length
        columns = [(tendon, kind) for tendon in range(shape[2]) for kind in np.unique(by_length[..., tendon])]
        found = np.zeros((1 + most, len(columns), *shape))
        for column, (tendon, kind) in enumerate(columns):
            sets = by_length[..., tendon] == kind
            found[0, column, :, :, tendon] = sets
            for trial, steps in enumerate(turns):
                found[0, column, trial, steps, tendon] = 0.0
                found[1 + np.arange(len(steps)), column, trial, steps, tendon] = sets[trial, steps]
        return found.reshape(-1, *shape)

    @property
    def set_by_length(self) -> np.ndarray | Array:
        """(trials, steps, tendons), whether a displacement sets the tendon."""
        flags = np.broadcast_to(np.array(self.by_length), np.shape(self.readings))
        return flags if self.by_tension is None else flags & ~self.by_tension

    def path(self, parameters: Mapping[str, ArrayLike]) -> Float[Array, "trials path tendons"]:
        """The readings, N or m; with a past, its tensions come first."""
        readings = jnp.asarray(self.readings)
        if self.past is None:
            return readings
        return jnp.concatenate([self.past.tension(parameters)[:, None], readings], axis=1)

    def true_displacement(self, parameters: Mapping[str, ArrayLike], readings: Array, offset: Array) -> Array:
        """(trials, steps, tendons), how far each tendon is pulled in, m, from what the encoders read.

        `offset`: the slack offset of each tendon, m.
        """
        pulled = readings - offset
        if "backlash" in parameters:
            pulled = jax.vmap(partial(_with_backlash, parameters["backlash"]))(pulled)
        if self.time is not None:
            time = jnp.asarray(self.time)
            late = time - parameters.get("lag", 0.0)
            pulled = jax.vmap(jax.vmap(jnp.interp, (None, None, 1), 1))(late, time, pulled)
        return pulled

    @property
    def pulled(self) -> np.ndarray:
        """(rows,), whether the tension of tendon 1 rose towards the row."""
        readings = np.asarray(self.readings)[..., 0]
        stated = np.zeros(len(readings)) if self.past is None else np.asarray(self.past.stated)
        released = [bool(name) for name in self.past.parameters] if self.past is not None else False
        first = (readings[:, 0] >= stated) & ~np.array(released)
        return np.column_stack([first, np.diff(readings, axis=1) > 0])[self.trial, self.step]

    @property
    def each_from_rest(self) -> bool:
        """Whether each row is a path of its own, from rest."""
        return np.shape(self.readings)[1] == 1 and self.past is None

    @property
    def past_in_words(self) -> list[str]:
        """The past of each trial, as in `Past.in_words`."""
        return [REST] * len(self.first_row) if self.past is None else self.past.in_words

    def trace(
        self,
        body: Manipulator,
        tension: Array,
        loads_with: LoadsWith,
        markers_on: MarkersOn,
        deviation: Array | None,
        nodes: int,
    ) -> Shown:
        """What the instruments show of the rows, each with the history before it.

        Args:
            body: whose tendons are pulled.
            tension: (trials, path, tendons), what was truly set along `path`: base tensions, N, or displacements, m.
            loads_with: gives all loads for the forces of one row or of all steps of a path.
            markers_on: gives the markers after each step.
            deviation: (trials,), ln(mu of a trial / mu), or None.
            nodes: as in `trace`; in increments there are twice as many elements as nodes.
        """

        def one(tension: Array, forces: Array | None, deviation: Array | None, by_tension: Array | None):
            here = with_deviation(body, deviation)
            if self.short_steps is None:
                (path,) = self._driven(tension)
                found = trace(here, path, nodes=nodes, max_turns=self.max_turns, throw=False)
            else:
                found = self._in_increments(here, tension, by_tension, forces, loads_with, nodes)
            pulled, tips = (x.reshape(tension.shape) for x in (found.tendon_displacement, found.tip_tension))
            tip = found.tip_angle, found.tip_position, found.tip_axis
            return Shown(pulled, tips, *tip, found.status, jnp.zeros(tips.shape, bool), markers_on(found))

        forces = None if self.forces is None else jnp.asarray(self.forces)
        by_tension = None if self.by_tension is None else jnp.asarray(self.by_tension)
        trials = tension, forces, deviation, by_tension
        if len(tension) == 1:  # a batch would be traced and compiled for nothing
            every = jax.tree.map(lambda x: x[None], one(*jax.tree.map(lambda x: x[0], trials)))
        elif self.short_steps is None:
            every = jax.vmap(one)(*trials)
        else:  # increments that need not be cut cost nothing one by one; in a batch they would
            every = jax.lax.map(lambda each: one(*each), trials)
        step = self.step + (self.past is not None)
        return jax.tree.map(lambda x: x[self.trial, step], every)

    def _driven(self, path: Array) -> list[Array | Displacement]:
        """The path of each tendon as `trace` takes it."""
        lengths = zip(self.by_length, path.T, strict=True)
        return [Displacement(own) if by_length else own for by_length, own in lengths]

    def _in_increments(
        self,
        body: Manipulator,
        tension: Array,
        by_tension: Array | None,
        forces: Array | None,
        loads_with: LoadsWith,
        nodes: int,
    ) -> History:
        """One path."""
        assert self.short_steps is not None
        num_before = 0 if self.past is None else 1
        given = self._driven(tension[num_before:]) if any(self.by_length) else tension[num_before:]
        path, driven = given_path(body, given, loads_with(forces))
        path = path if by_tension is None else path.partly_by_tension(by_tension)
        staying = np.array(self.stays)[:, None]
        resting = loads_with(forces[0] * staying if forces is not None and np.any(staying) else None)
        path = path._replace(resting=jax.tree.map(lambda x: jnp.asarray(x, float), resting))
        path = path.behind(tension[0]) if num_before else path
        return stepped_history(
            body, path, None, Following(driven, ELEMENTS_IN_FITS * nodes, self.short_steps, estimated=False)
        )


def _with_backlash(play: ArrayLike, path: Float[Array, "steps tendons"]) -> Float[Array, "steps tendons"]:
    """How far tendons follow motors that must come back by `play` before they let go; each starts pulled taut."""

    def follow(behind: Array, ahead: Array) -> tuple[Array, Array]:
        behind = jnp.clip(behind, ahead, ahead + play)
        return behind, behind

    return jax.lax.scan(follow, path[0] + 0.0 * jnp.asarray(play), path)[1]


def is_driven_by_length(table: Measurements) -> bool:
    """Whether displacements set any tendon, which may then be slack."""
    return any(own.by_length for own in table.set_columns)


def paths_of(table: Measurements, history: bool | str | None) -> list[np.ndarray] | None:
    """The rows of each path that is followed, in order; None where each row slides as its direction says.

    Args:
        table: any.
        history: as in `fit`; None: the order that a column gives. Displacements without an order are each pulled from
            rest.

    Raises:
        InputError: where rows between others are missing.
    """
    ordered = table.ordered if history is None else history
    if "pulling_tension" in table:
        return None
    if history == EACH or (is_driven_by_length(table) and not ordered):
        return [np.array([row]) for row in range(len(table))]
    if not ordered:
        return None
    if table.left_out and not table.ordered:
        raise InputError(
            f"{table.name}: {table.left_out} rows without a reading are left out, but the path from row to row needs "
            "them; add a column step, and these rows are kept"
        )
    return table.trials


def how_followed(manipulator: Manipulator, parameters: Sequence[str], loads: Loads | None) -> dict[str, Any]:
    """Whether paths need increments, and whether the times of rows count: `stepped` and `timed` of `course_of`.

    Args:
        manipulator: the body.
        parameters: free or given ones.
        loads: those of all rows.
    """
    along = along_a_path(manipulator, parameters)
    return {"stepped": loads is not None or bool({*along} & {*RUBBING}), "timed": "lag" in along}


def course_of(
    table: Measurements,
    noise: Mapping[str, float] | None = None,
    past: Past | None = None,
    short_steps: int = SHORT_STEPS,
    *,
    paths: Sequence[np.ndarray] | None = None,
    stepped: bool = False,
    timed: bool = False,
) -> tuple[Course, dict[str, Steady]]:
    """The rows of a table as steps of paths, and by column what was set without the jitter of its readings.

    Args:
        table: of a body with any number of tendons.
        noise: by column, the standard deviation of a reading of what was set, N or m, as in `without_jitter`; that of
            `base_tension` or `displacement` holds for all columns without one.
        past: how each trial begins; None: at rest.
        short_steps: into how many increments each step is divided where the answer is not exact.
        paths: the rows of each path; None: those of each trial.
        stepped: whether loads of all rows, or friction besides that on the body, rule out an exact answer.
        timed: whether the body may come after motors, so that the times of the rows count.

    Raises:
        InputError: for a column `direction` of a single tendon that contradicts the order of the rows, a largest
            tension before a trial that is below that of its first row, or a past of several tendons.
    """
    force, tendons = forces_of(table.columns, len(table))[1], len(set_by(table.columns))
    rows_of_paths = table.trials if paths is None else paths
    by_length = tuple(np.any(table.by_length, axis=0).tolist())
    by_both = len(table.set_columns) > tendons
    timed &= any(by_length) and max(map(len, rows_of_paths)) > 1
    past = _checked(table, past)
    steady = {own.column: _steady(table, own, noise or {}, rows_of_paths) for own in table.set_columns}
    given = np.zeros((len(table), tendons))
    for own in table.set_columns:
        given[own.rows, own.tendon] = steady[own.column].tension[own.rows]
    alone = tendons == 1 and not np.any(force) and not by_both
    for k, own in enumerate(rows_of_paths if alone else ()):
        _check_directions(table, own, next(iter(steady.values())), past, k)
    every = np.concatenate([given, force.reshape(len(table), -1), table.by_length], axis=1)
    trial, step, kept = np.zeros(len(table), int), np.zeros(len(table), int), []
    for k, own in enumerate(rows_of_paths):
        moved = np.append(True, np.any(np.diff(every[own], axis=0) != 0, axis=1) | timed)
        trial[own], step[own] = k, np.cumsum(moved) - 1
        kept.append(own[moved])
    short = None if alone and not stepped else short_steps
    readings, acting, flags = (_stacked([own[rows] for rows in kept], short) for own in (given, force, table.by_length))
    first = np.array([rows[0] for rows in kept])
    if past is not None:
        past.check(readings[:, 0, 0], [f"{table.name}: {table.place(int(row))}" for row in first])
    stays = ()
    if np.any(acting):  # that of a single row grows with the pull
        stays = tuple(((readings.shape[1] > 1) & np.all(acting == acting[:, :1], axis=(0, 1, 3))).tolist())
    course = Course(
        readings,
        trial,
        step,
        first,
        max_turns=0 if short is not None else _most_turns(readings, past, any(by_length)) * (2 if timed else 1),
        past=past,
        forces=acting if np.any(acting) else None,
        stays=stays,
        short_steps=short,
        by_length=by_length,
        by_tension=~flags if by_both else None,
        time=_times(table, rows_of_paths, readings.shape[1]) if timed else None,
    )
    return course, steady


def _checked(table: Measurements, past: Past | None) -> Past | None:
    """The past of a table, None for rest."""
    if past is None or past.at_rest:
        return None
    if is_driven_by_length(table) or len(set_by(table.columns)) > 1:
        raise InputError(
            f"{table.name}: before is the base tension of an only tendon; begin each trial with a row of the "
            "displacements or tensions before it, whose readings may be empty"
        )
    return past


def _stacked(paths: Sequence[np.ndarray], short_steps: int | None) -> np.ndarray:
    """(trials, steps, ...), from (steps, ...) of each path; the last step is repeated, up to a usual number."""
    longest = max(map(len, paths))
    if longest > 1:
        longest += -longest % (STEPS if short_steps is None else FEW_STEPS)
    added = [((0, longest - len(one)), *[(0, 0)] * (one.ndim - 1)) for one in paths]
    return np.stack([np.pad(one, more, mode="edge") for one, more in zip(paths, added, strict=True)])


def _steady(table: Measurements, own: SetColumn, noise: Mapping[str, float], paths: Sequence[np.ndarray]) -> Steady:
    """A column without the jitter of its readings, path by path; 0 in rows in which it sets nothing.

    Displacements may be below 0. The noise is that of the noisiest path.
    """
    scatter, level = noise.get(own.column, noise.get(kind_of_set(own.column))), np.zeros(len(table))
    found = []
    for rows in (path[own.rows[path]] for path in paths):
        least = float(np.min(table[own.column][rows], initial=0.0))
        found.append(without_jitter(table[own.column][rows] - least, scatter))
        level[rows] = found[-1].tension + least
    noisiest = max(found, key=lambda steady: steady.noise)
    return noisiest._replace(tension=level, num_ignored=sum(steady.num_ignored for steady in found))


def _times(table: Measurements, paths: Sequence[np.ndarray], steps: int) -> np.ndarray:
    """(trials, steps), the times of all paths, s, at which displacements can be looked up; they go on to the end."""
    if "time" not in table:
        raise InputError(f"{table.name}: lag needs the column time; add it, or do not fit lag")
    found = []
    for rows in paths:
        time, moved = table["time"][rows], np.zeros(len(rows), bool)
        for column in set_by(table.columns):
            moved[1:] |= np.diff(table[column][rows]) != 0
        bad = np.flatnonzero((np.diff(time, prepend=-np.inf) < 0) | (moved & (np.diff(time, prepend=-np.inf) == 0)))
        if bad.size:
            raise InputError(
                f"{table.name}: {table.place(int(rows[bad[0]]))}, column time: lag needs times that rise with the "
                "rows; give times with more digits, in the order of the rows"
            )
        found.append(np.append(time, time[-1] + 1.0 + np.arange(steps - time.size)))
    return np.stack(found)


def _check_directions(table: Measurements, rows: np.ndarray, steady: Steady, past: Past | None, trial: int) -> None:
    """Compare the column `direction` with the path: the tension must rise to a row with 1, and fall to one with -1."""
    if "direction" not in table:
        return
    (column,) = set_by(table.columns)
    dimension, by_length = dimension_of(column), is_driven_by_length(table)
    tension = steady.tension[rows]
    before = np.append(0.0 if past is None else past.stated[trial], tension[:-1])
    moved = tension - before
    sure = np.abs(moved) > max(steady.least_turn, NO_STEP * np.max(tension))
    sure[0] &= past is None or not past.parameters[trial]  # a fitted tension decides the way to the first row
    sure[0] &= not by_length  # where a tendon begins to pull is not known
    wrong = np.flatnonzero(sure & (moved * table["direction"][rows] < 0))
    if wrong.size:
        i = int(wrong[0])
        way, label = ("rises", -1) if moved[i] > 0 else ("falls", 1)
        raise InputError(
            f"{table.name}: {table.place(int(rows[i]))}, column direction: is {label}, but {column} {way} there from "
            f"{shown(before[i], dimension)} to {shown(tension[i], dimension)}; correct the label or "
            f"the order of the rows, or {'leave the column direction out' if by_length else WITHOUT}"
        )


def _most_turns(readings: np.ndarray, past: Past | None, driven: bool) -> int:
    """The largest number of turns that are remembered at once along any of the paths of one tendon."""
    above = [] if past is None else [2 * max(np.max(readings), np.max(np.asarray(past.stated)), 1.0)]
    above = [np.max(readings) + 1, np.min(readings) - 1] if driven else above  # it may be pulled from slack
    return max(_most_open(np.append(above, path)) for path in readings)


def _most_open(path: np.ndarray) -> int:
    """The largest number of turns that are remembered at once along a path, rounded up to 4, 8, 16, ..."""
    still_open: list[float] = []
    most = 0
    for tension in path.tolist():
        pulled = tension >= (still_open[-1] if still_open else 0.0)
        passed = [
            place
            for place, extreme in enumerate(still_open)
            if (place % 2 == 0) == pulled and (tension >= extreme if pulled else tension <= extreme)
        ]
        still_open = [*still_open[: passed[0] if passed else None], tension]
        most = max(most, len(still_open))
    return max(4, 1 << (most - 1).bit_length())
