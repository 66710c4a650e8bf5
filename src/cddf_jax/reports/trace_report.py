"""The answer of `cddf trace`, in words, as plain numbers and as files."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from ..errors import SolveError
from ..files.csv_table import table_csv
from ..history.history import History
from ..history.trace import trace
from ..programs.evaluated import evaluated
from ..progress import stage
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import RESULT_NAMES, RESULTS, code_of, result_of
from ..statics.targets import Displacement, TipAngle
from ..units import Dimension, shown
from .export import POINTS, field_columns, history_columns, history_numbers

FINE = 256  # steps, at least, so that loops are smooth, and one program serves most paths
STEPS = 20  # of which words are made, at most
SAME = 1e-9  # of its size, by which the number of two states may differ that are one
SEEN = 1e-5  # of the work, by which it may differ from its parts in silence
# what a path may hold
TARGETS: dict[Dimension, Callable[[np.ndarray], np.ndarray | Displacement | TipAngle]] = {
    "force": lambda values: values,
    "length": Displacement,
    "angle": TipAngle,
}


class TracedPath(NamedTuple):
    """A path that was traced with points between its steps."""

    manipulator: Manipulator
    history: History
    steps: list[int]  # of the history, from 0, that are those of the path
    numbers: dict[str, np.ndarray]  # of the whole history by name, step first

    @property
    def states(self) -> dict[str, np.ndarray]:
        """The numbers after the steps of the path."""
        return {name: values[self.steps] for name, values in self.numbers.items()}


class Cycle(NamedTuple):
    """A part of a path that ends in the state in which it began."""

    first: int  # steps, from 1
    last: int
    loss: float  # J


def traced(
    manipulator: Manipulator,
    path: Sequence[float],
    driven: Dimension,
    nodes: int,
    max_turns: int,
    before: float | None = None,
) -> TracedPath:
    """Trace a path, with so many points between its steps that loops are smooth.

    Args:
        manipulator: the body.
        path: base tensions, N, displacements of the tendon, m, or tip angles, rad, after each step; not all 0.
        driven: what they are, "force", "length" or "angle".
        nodes, max_turns: as `trace` takes them.
        before: the largest base tension before the path, N; None for rest.

    Raises:
        SolveError: names the step that failed.
        ValueError: as `trace`.
    """
    known = 0.0 if before is None else before if driven == "force" else path[0]  # where the path comes from
    ends = [*([] if path[0] == known else [known]), *path]
    legs = np.array_split(np.arange(max(FINE, len(ends)) - 1), len(ends) - 1)
    between = [np.linspace(ends[i], ends[i + 1], len(leg) + 1)[1:] for i, leg in enumerate(legs)]
    values, steps = np.concatenate([ends[:1], *between]), np.cumsum([0, *map(len, legs)])[-len(path) :]
    with stage("tracing"):
        past = "rest" if before is None else before
        history = trace(
            manipulator, TARGETS[driven](values), before=past, nodes=nodes, max_turns=max_turns, throw=False
        )
        codes = np.asarray(code_of(history.result))
        failed = ~np.isin(codes, [code_of(result) for result in (RESULTS.successful, RESULTS.slack)])
        if not np.any(failed):
            return TracedPath(manipulator, history, steps.tolist(), history_numbers(history))
    first = int(np.argmax(failed))
    step = int(np.searchsorted(steps, first))
    to, at = shown(path[step], driven), shown(values[first], driven)
    raise SolveError(f"step {step + 1}, on the way to {to}, at {at}: {RESULTS[result_of(codes[first])]}")


def cycles(states: dict[str, np.ndarray]) -> list[Cycle]:
    """The cycles of a path, each from the nearest earlier step with the same state; none overlaps another in part."""
    found: list[Cycle] = []
    state = np.column_stack([states[name] for name in ("base_tension", "tip_tension", "tip_angle", "stored_energy")])
    near, loss = SAME * np.max(np.abs(state), axis=0), states["friction_loss"]

    def are_one(step: int, other: int) -> bool:
        return bool(np.all(np.abs(state[step] - state[other]) <= near))

    for last in range(1, len(state)):
        earlier = () if are_one(last, last - 1) else reversed(range(last - 1))
        for first in earlier:
            apart = all(cycle.last <= first + 1 or cycle.first >= first + 1 for cycle in found)
            if apart and are_one(last, first):
                found.append(Cycle(first + 1, last + 1, float(loss[last] - loss[first])))
                break
    return found


def trace_as_dict(found: TracedPath) -> dict[str, object]:
    """The states after the steps of a path and its closed cycles, SI units, for JSON."""
    results = [RESULT_NAMES[code] for code in np.asarray(code_of(found.history.result))[found.steps]]
    steps = np.arange(1, len(found.steps) + 1)
    return {"steps": steps, "results": results, **found.states, "cycles": cycles(found.states)}


def trace_in_words(found: TracedPath) -> str:
    """What slid in each step and what it left, the cycles that closed, and where the work went."""
    states = found.states
    directions = np.asarray(found.history.direction)[found.steps]
    lines = [_step_in_words(states, i, directions[i], float(found.manipulator.length)) for i in range(len(found.steps))]
    if len(lines) > STEPS:
        lines = [f"the last {STEPS} of {len(lines):,} steps:", *lines[-STEPS:]]
    for cycle in cycles(states)[-STEPS:]:
        tension, loss = shown(states["base_tension"][cycle.last - 1], "force"), shown(cycle.loss, "energy")
        lines.append(f"cycle from step {cycle.first} to {cycle.last}, closed at {tension}: {loss} lost")
    lines.append(_work_in_words(*(float(states[name][-1]) for name in ("work", "stored_energy", "friction_loss"))))
    return "\n".join([*lines, f"error estimate {np.max(found.numbers['error_estimate']):.1e}; successful"])


def _work_in_words(work: float, stored: float, lost: float) -> str:
    """ "work put in 415.41 mJ: 355.68 mJ stored, 59.726 mJ lost to friction"."""
    parts = [f"{shown(stored, 'energy')} stored", f"{shown(lost, 'energy')} lost to friction"]
    if abs(rest := work - stored - lost) > SEEN * work:
        parts.append(f"{shown(rest, 'energy')} unaccounted for by the published kinematics")
    return f"work put in {shown(work, 'energy')}: {', '.join(parts)}"


def _step_in_words(states: dict[str, np.ndarray], i: int, direction: float, length: float) -> str:
    """ "3: released to 40 N, slides out up to 115.09 mm and rests beyond; tip tension 45.1 N, ..."."""
    tension = states["base_tension"][i]
    if not np.any(states["base_tension"][: i + 1]):
        return f"{i + 1}: {shown(tension, 'force')}, at rest"
    way, slides = ("pulled", "slides in") if direction > 0 else ("released", "slides out")
    front = states["front"][i]
    where = "along the whole body" if front >= length else f"up to {shown(front, 'length')} and rests beyond"
    how = f"{way} to {shown(tension, 'force')}, {slides} {where}"
    if i > 0 and tension == states["base_tension"][i - 1]:
        how = f"stays at {shown(tension, 'force')}"
    force, angle = shown(states["tip_tension"][i], "force"), shown(states["tip_angle"][i], "angle")
    pulled_in = shown(states["tendon_displacement"][i], "length")
    return f"{i + 1}: {how}; tip tension {force}, tip angle {angle}, pulled in {pulled_in}"


def loop_csv(found: TracedPath) -> str:
    """A table with a row for each step of the history; the steps of the path have whole numbers."""
    last = len(found.history.tip_angle)
    number = np.interp(np.arange(last), found.steps, np.arange(1, len(found.steps) + 1))
    if found.steps[0] > 0:  # from rest, which the path does not name
        number[: found.steps[0]] = np.arange(found.steps[0]) / found.steps[0]
    return table_csv({"step": number} | history_columns(found.numbers))


def fields_csv_of_steps(found: TracedPath) -> str:
    """A table of what varies along the body after the steps of the path, the last twenty of them."""
    s = np.linspace(0.0, float(found.manipulator.length), POINTS)
    fields = evaluated(History.at, found.history, s)
    tables = [
        {"step": np.full(POINTS, number)} | field_columns(jax.tree.map(lambda x, step=step: x[step], fields))
        for number, step in list(enumerate(found.steps, 1))[-STEPS:]
    ]
    return table_csv({head: np.concatenate([table[head] for table in tables]) for head in tables[0]})
