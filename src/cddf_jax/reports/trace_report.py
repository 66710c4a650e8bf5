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
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import RESULT_NAMES, RESULTS, code_of, result_of
from ..statics.targets import Displacement, TipAngle
from ..units import Dimension, shown
from .export import POINTS, field_columns, history_columns, history_numbers

FINE = 256  # steps, at least, so that loops are smooth, and one program serves most paths
FINE_IN_STEPS = 64  # the same in space, and with several tendons or loads
SHORT_STEPS = 4  # in each of these steps, with several tendons or loads
STEPS = 20  # described in words, at most
SAME = 1e-9  # relative difference up to which two states count as the same
SEEN = 1e-5  # of the work: a larger difference from the sum of its parts is reported
# by the dimension of a path, what `trace` takes
TARGETS: dict[Dimension, Callable[[np.ndarray], np.ndarray | Displacement | TipAngle]] = {
    "force": lambda values: values,
    "length": Displacement,
    "angle": TipAngle,
}


class TracedPath(NamedTuple):
    """A path that was traced with points between its steps."""

    manipulator: Manipulator
    history: History
    steps: list[int]  # steps of the history, from 0, that belong to the path
    numbers: dict[str, np.ndarray]  # of the whole history by name, step first

    @property
    def states(self) -> dict[str, np.ndarray]:
        """The numbers after the steps of the path."""
        return {name: values[self.steps] for name, values in self.numbers.items()}

    @property
    def is_exact(self) -> bool:
        """Whether the answer is exact: one tendon without loads."""
        return self.history.num_turns is not None


class Cycle(NamedTuple):
    """A part of a path that ends in the state in which it began."""

    first: int  # steps, from 1
    last: int
    loss: float  # J


def traced(
    manipulator: Manipulator,
    paths: Sequence[Sequence[float]],
    driven: Sequence[Dimension],
    loads: Loads | None,
    nodes: int,
    max_turns: int,
    before: Sequence[float] | None = None,
) -> TracedPath:
    """Trace the paths of all tendons, with enough points between their steps for smooth loops.

    Several tendons and loads are followed in short steps. A `SolveError` names the step that failed.

    Args:
        paths: one for each tendon, all of one length: base tensions, N, displacements of the tendon, m, or of one
            tendon alone tip angles, rad, after each step; not all 0.
        driven: what each of them is, "force", "length" or "angle".
        loads: that act before the first step, and stay constant.
        nodes, max_turns: as `trace` takes them.
        before: the largest base tension of each tendon before the paths, N; None for rest.
    """
    is_exact = len(paths) == 1 and loads is None
    start = np.zeros(len(paths)) if before is None else np.array(before)  # where the paths come from
    if is_exact and before is not None and driven[0] != "force":
        start = np.array(paths)[:, 0]
    fine = FINE if is_exact and not manipulator.in_space else FINE_IN_STEPS
    values, steps = _with_points_between(np.array(paths).T, start, fine)
    with stage("tracing"):
        if is_exact:
            options = {"before": "rest" if before is None else before[0], "max_turns": max_turns}
            history = trace(manipulator, TARGETS[driven[0]](values[:, 0]), nodes=nodes, throw=False, **options)
        else:
            columns = [Displacement(x) if kind == "length" else x for x, kind in zip(values.T, driven, strict=True)]
            given = columns if "length" in driven else values
            history = trace(manipulator, given, loads, nodes=nodes, short_steps=SHORT_STEPS, throw=False)
        _check(history, steps, values, driven)
        return TracedPath(manipulator, history, steps.tolist(), history_numbers(history))


def _with_points_between(path: np.ndarray, start: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The path from the start with `count` points or more, and the indices of its own steps."""
    ends = path if np.array_equal(path[0], start) else np.vstack([start, path])
    legs = np.array_split(np.arange(max(count, len(ends)) - 1), len(ends) - 1)
    between = [np.linspace(ends[i], ends[i + 1], len(leg) + 1)[1:] for i, leg in enumerate(legs)]
    return np.concatenate([ends[:1], *between]), np.cumsum([0, *map(len, legs)])[-len(path) :]


def _check(history: History, steps: np.ndarray, values: np.ndarray, driven: Sequence[Dimension]) -> None:
    codes = np.asarray(code_of(history.result))
    failed = ~np.isin(codes, [code_of(result) for result in (RESULTS.successful, RESULTS.slack)])
    if not np.any(failed):
        return
    first = int(np.argmax(failed))
    step = int(np.searchsorted(steps, first))
    pairs = (zip(values[place], driven, strict=True) for place in (steps[step], first))
    to, at = (", ".join(shown(value, kind) for value, kind in pair) for pair in pairs)
    raise SolveError(f"step {step + 1}, on the way to {to}, at {at}: {RESULTS[result_of(codes[first])]}")


def cycles(states: dict[str, np.ndarray]) -> list[Cycle]:
    """The cycles of a path, each from the nearest earlier step with the same state. No two cycles overlap in part."""
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
    """What slid in each step, the state after it, the cycles that closed, and where the work went."""
    states = found.states
    directions, length = np.asarray(found.history.direction)[found.steps], float(found.manipulator.length)
    in_words = _step_in_words if found.is_exact else _step_of_tendons
    lines = [in_words(states, i, directions[i], length) for i in range(len(found.steps))]
    if len(lines) > STEPS:
        lines = [f"the last {STEPS} of {len(lines):,} steps:", *lines[-STEPS:]]
    for cycle in cycles(states)[-STEPS:]:
        tension, loss = _listed(states["base_tension"][cycle.last - 1], "force"), shown(cycle.loss, "energy")
        lines.append(f"cycle from step {cycle.first} to {cycle.last}, closed at {tension}: {loss} lost")
    rest = "by the published kinematics" if found.manipulator.kinematics == "published" else "by the short steps"
    work, stored, lost = (float(states[name][-1]) for name in ("work", "stored_energy", "friction_loss"))
    parts = [f"{shown(stored, 'energy')} stored", f"{shown(lost, 'energy')} lost to friction"]
    if abs(left := work - stored - lost) > SEEN * abs(work):
        parts.append(f"{shown(left, 'energy')} unaccounted for {rest}")
    lines.append(f"work put in {shown(work, 'energy')}: {', '.join(parts)}")
    return "\n".join([*lines, f"error estimate {np.max(found.numbers['error_estimate']):.1e}; successful"])


def _listed(values: np.ndarray, dimension: Dimension) -> str:
    """ "60 N, 20 N"."""
    return ", ".join(shown(float(value), dimension) for value in np.ravel(values))


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


def _step_of_tendons(states: dict[str, np.ndarray], i: int, directions: np.ndarray, length: float) -> str:
    """ "2: tendon 1 at 60 N slides out up to 52.7 mm, ...; tip tensions 50.3 N, 23.9 N, tip angle 44.1 deg, ..."."""
    tensions, fronts = np.ravel(states["base_tension"][i]), np.ravel(states["front"][i])
    parts = []
    for number, (tension, front, direction) in enumerate(zip(tensions, fronts, np.ravel(directions), strict=True), 1):
        way = "slides in" if direction > 0 else "slides out"
        where = "along the whole body" if front >= length else f"up to {shown(float(front), 'length')}"
        moves = f"{way} {where}" if front > 0 else "rests at the base"
        name = f"tendon {number}" if tensions.size > 1 else "the tendon"
        parts.append(f"{name} at {shown(float(tension), 'force')} {moves}")
    tips, pulled_in = _listed(states["tip_tension"][i], "force"), _listed(states["tendon_displacement"][i], "length")
    angle = shown(float(states["tip_angle"][i]), "angle")
    return f"{i + 1}: {', '.join(parts)}; tip tension {tips}, tip angle {angle}, pulled in {pulled_in}"


def loop_csv(found: TracedPath) -> str:
    """A table with a row for each step of the history; the steps of the path have whole numbers."""
    last = len(found.history.tip_angle)
    number = np.interp(np.arange(last), found.steps, np.arange(1, len(found.steps) + 1))
    if found.steps[0] > 0:  # the way from rest to the first step of the path
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
