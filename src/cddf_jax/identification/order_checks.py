"""Whether readings with a history agree with the stated order of the rows.

Residuals drift from the first row to the last if the body creeps. Rows that were mixed up fit better in another order.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..estimation.remarks import chance_of_more
from ..measurements.table import Measurements
from ..robot.manipulator import Manipulator
from .bench import Bench, Group
from .course import Course
from .parameters import Parameters
from .predictions import noise_of_readings

if TYPE_CHECKING:
    from .fit import Fit

CHANCE = 1e-3  # smaller p-values of a drift are reported
MOST_STEPS = 512  # of paths; for more steps other orders are not tried
LANES = 32  # other orders, at most, that are tried
HELPS, LEAST_GAIN = 1.0, 14.0  # least decrease of the sum of squares over the noise: by one exchange, by all of them
MANY_TURNS = 0.3  # of the steps; with more turns the order is compared with random orders
AS_BAD = 0.3  # of the sum of squares of random orders: above it the order of the rows is doubtful
MAX_TURNS = 16  # that can be remembered along another order
SEED = 0


def order_remarks(fit: "Fit") -> list[str]:
    """In words, what contradicts the order of the rows of each table with a history."""
    found = []
    for name, table, experiment in zip(fit.model.names, fit.tables, fit.model.experiments, strict=True):
        if isinstance(experiment, Bench) and experiment.course is not None:
            own = [group for group in fit.groups if group.name == name]
            found += [text for group in own if (text := _drift(fit, group, experiment.course))]
            found += _mixed_up(fit, table, experiment, own)
    return found


# --- drift -------------------------------------------------------------------------------------------


def _drift(fit: "Fit", group: Group, course: Course) -> str:
    """Whether the residuals of a group drift from the first step to the last, in words; "" if they do not.

    Two more parameters of the linearised model are tested: an error that grows with the step, and one that grows with
    step times reading.
    """
    last = np.bincount(course.trial, minlength=len(course.first_row)) * 0.0
    np.maximum.at(last, course.trial, course.step)
    time = (course.step / np.maximum(last[course.trial], 1.0) - 0.5)[group.there]
    size = np.max(np.abs(group.observed), initial=1e-300)
    columns = np.stack([time, time * group.observed / size], axis=1) / noise_of_readings(fit, group)[:, None]
    chance = chance_of_more(fit.evidence, fit.standardised_residuals, group.label, columns)
    if chance >= CHANCE:
        return ""
    return (
        f"{group.label}: residuals drift from the first row to the last (p = {chance:.1g}); does the body creep, or "
        "the zero of an instrument? Measure faster, or wait at each level"
    )


# --- another order -------------------------------------------------------------------------------------


class _Orders(NamedTuple):
    """Paths and steps for other orders of the same levels."""

    readings: np.ndarray  # (orders, trials, steps), N
    step: np.ndarray  # (orders, rows)


def _mixed_up(fit: "Fit", table: Measurements, bench: Bench, groups: list[Group]) -> list[str]:
    """Whether some neighbouring levels fit better when they are exchanged, or random orders fit as well; in words."""
    course = bench.course
    assert course is not None
    squares = np.zeros(len(table))
    for group in groups:
        squares[group.there] += (fit.residuals[group.label] / _noise_with_base(fit, group)) ** 2
    if (
        not np.all(np.isfinite(squares))
        or not np.any(squares)
        or course.readings.size > MOST_STEPS
        or course.short_steps is not None
    ):
        return []
    found, now = [], float(np.sum(squares))
    pairs = _suspects(course, squares)
    gain = now - _sums_of_squares(fit, bench, groups, _exchanged(course, [[pair] for pair in pairs]))[: len(pairs)]
    together = _apart([pairs[i] for i in np.argsort(-gain) if gain[i] > HELPS])
    left = float(_sums_of_squares(fit, bench, groups, _exchanged(course, [together]))[0]) if together else now
    estimated = any(fit.evidence.noise_estimated.values()) or fit.evidence.estimated_inputs
    noise = left / now if estimated else 1.0  # as it would be after the exchange
    if now - left > LEAST_GAIN * noise:
        trial, step = together[0]
        rows = [np.flatnonzero((course.trial == trial) & (course.step == step + k))[0] for k in (0, 1)]
        more = f" (and {len(together) - 1} more pairs)" if len(together) > 1 else ""
        first, second = map(table.place, rows)
        found.append(
            f"{table.name}: {first} and {second} fit better the other way round{more}; was the order of the rows "
            "mixed up?"
        )
    moves = np.sign(np.diff(course.readings, axis=1))
    turns = np.sum(moves[:, 1:] * moves[:, :-1] < 0)
    if turns > MANY_TURNS * np.sum(moves != 0):
        random = _sums_of_squares(fit, bench, groups, _random_orders(course))
        if now > AS_BAD * np.nanmedian(random):
            found = [
                f"{table.name}: the rows fit hardly better in their order than in a random order; check the columns "
                "step and time"
            ]
    return found


def _noise_with_base(fit: "Fit", group: Group) -> np.ndarray:
    """(readings,), the standard deviations of the readings, with what the noise of base tensions adds."""
    problem = fit.minimum.problem
    more = sum(
        (np.sum(np.asarray(own) ** 2, axis=1) for own in problem.shared.columns.values()), np.zeros(problem.num_data)
    )
    return noise_of_readings(fit, group) * np.sqrt(1 + problem.by_group(more)[problem.groups.index(group.label)])


def _apart(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The pairs without those that share a level with an earlier pair."""
    kept: list[tuple[int, int]] = []
    for trial, step in pairs:
        if not any(trial == other and abs(step - first) < 2 for other, first in kept):
            kept.append((trial, step))
    return kept


def _suspects(course: Course, squares: np.ndarray) -> list[tuple[int, int]]:
    """Trial and first step of pairs of neighbouring levels, those with the largest residuals first."""
    trials, steps = course.readings.shape
    by_step = np.zeros((trials, steps))
    np.add.at(by_step, (course.trial, course.step), squares)
    there = np.zeros((trials, steps), bool)
    there[course.trial, course.step] = True
    pair = np.where(there[:, :-1] & there[:, 1:], by_step[:, :-1] + by_step[:, 1:], 0.0)
    largest = np.argsort(pair.ravel())[::-1][:LANES]
    return [divmod(int(at), steps - 1) for at in largest if pair.ravel()[at] > 0]


def _exchanged(course: Course, every: list[list[tuple[int, int]]]) -> _Orders:
    """For each list of pairs, the paths with the two levels of each pair exchanged; unused lanes are as measured."""
    readings, step = (np.repeat(np.asarray(x)[None], LANES, axis=0) for x in (course.readings, course.step))
    for lane, pairs in enumerate(every):
        for trial, first in pairs:
            own = course.trial == trial
            readings[lane, trial, [first, first + 1]] = readings[lane, trial, [first + 1, first]]
            if first + 1 == np.max(course.step[own]):  # the last one is repeated
                readings[lane, trial, first + 2 :] = readings[lane, trial, first + 1]
            step[lane, own & (course.step == first)] = first + 1
            step[lane, own & (course.step == first + 1)] = first
    return _Orders(readings, step)


def _random_orders(course: Course) -> _Orders:
    """All levels of each trial in random orders."""
    rng = np.random.default_rng(SEED)
    readings, step = (np.repeat(np.asarray(x)[None], LANES, axis=0) for x in (course.readings, course.step))
    for lane in range(LANES):
        for trial in range(len(course.readings)):
            own = course.trial == trial
            count = int(course.step[own].max()) + 1
            order = rng.permutation(count)
            readings[lane, trial, :count] = course.readings[trial, order]
            readings[lane, trial, count:] = readings[lane, trial, count - 1]
            step[lane, own] = np.argsort(order)[course.step[own]]
    return _Orders(readings, step)


def _sums_of_squares(fit: "Fit", bench: Bench, groups: list[Group], orders: _Orders) -> np.ndarray:
    """(orders,), sums of squares of the residuals over the noise, at the estimate; NaN where there is no solution."""
    plain = replace(bench, name="", read_in={})
    body, parameters = fit.model.manipulator, jax.tree.map(np.asarray, fit.parameters)
    read = _read_in_orders(plain, body, parameters, orders.readings, orders.step, fit.model.nodes)
    total = np.zeros(LANES)
    for group in groups:
        noise = _noise_with_base(fit, group)
        total += np.sum(((np.asarray(read[group.column])[:, group.there] - group.observed) / noise) ** 2, axis=1)
    return total


@eqx.filter_jit
def _read_in_orders(
    bench: Bench,
    manipulator: Manipulator,
    parameters: Parameters,
    readings: Float[np.ndarray | Array, "orders trials steps"],
    step: Int[np.ndarray | Array, "orders rows"],
    nodes: int,
) -> dict[str, Array]:
    """What the instruments would read in other orders, (orders, rows), by column."""
    course = bench.course
    assert course is not None

    def one(readings: np.ndarray | Array, step: np.ndarray | Array) -> dict[str, Array]:
        other = replace(course, readings=readings, step=step, max_turns=MAX_TURNS)
        own = eqx.tree_at(lambda b: b.course, bench, other, is_leaf=lambda x: isinstance(x, Course))
        return own.predict(manipulator, parameters, nodes)

    return jax.vmap(one)(readings, step)
