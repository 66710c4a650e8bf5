"""The answer of `cddf trace`."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from .. import figures
from ..errors import SolveError
from ..files.csv_table import table_csv
from ..history.history import GOOD, STEPS, History, last_line, steps_in_words
from ..history.stepped import ACCURACY, SteppedStates
from ..history.trace import trace
from ..numerics.arrays import evaluated
from ..progress import stage
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.status import Status, words_of
from ..statics.targets import Displacement, TipAngle
from ..units import Dimension, shown
from .export import POINTS, field_columns, history_columns, history_numbers
from .report import Content, Report

FINE = 256  # steps, at least, so that loops are smooth, and one program serves most paths
FINE_IN_STEPS = 64  # the same in space, and with several tendons or loads
SEEN = 1e-5  # of the work: a larger difference from the sum of its parts is reported
TARGETS = {"length": Displacement, "angle": TipAngle}  # by the dimension of a path, unless it is one of tensions


class TracedPath(NamedTuple):
    """A path that was traced with points between its steps."""

    manipulator: Manipulator
    history: History
    steps: list[int]  # steps of the history, from 0, that belong to the path
    numbers: dict[str, np.ndarray]  # of the whole history by name, step first
    loads: Loads | None

    @property
    def states(self) -> dict[str, np.ndarray]:
        """The numbers after the steps of the path."""
        return {name: values[self.steps] for name, values in self.numbers.items()}


def traced(
    manipulator: Manipulator,
    paths: Sequence[Sequence[float]],
    driven: Sequence[Dimension],
    loads: Loads | None,
    nodes: int,
    short_steps: int,
    before: Sequence[float] | None = None,
) -> TracedPath:
    """Trace the paths of all tendons, with enough points between their steps for smooth loops.

    Several tendons and loads are followed in increments. A `SolveError` names the step that failed.

    Args:
        paths: one for each tendon, all of one length: base tensions, N, displacements of the tendon, m, or of one
            tendon alone tip angles, rad, after each step.
        driven: what each of them is, "force", "length" or "angle".
        loads: that act before the first step, and stay constant.
        nodes: as `trace` takes them.
        short_steps: as `trace` takes them, for each point.
        before: the largest base tension of each tendon before the paths, N; None for rest.
    """
    by_tension = {*driven} == {"force"}
    earlier = np.zeros(len(paths)) if before is None else np.array(before)
    by_steps = by_tension or before is None  # whether what was before is a step of the path
    start, past = (earlier, "rest") if by_steps else (np.array(paths)[:, 0], earlier)  # where the paths come from
    fine = FINE if len(paths) == 1 and loads is None and not manipulator.in_space else FINE_IN_STEPS
    values, steps = _with_points_between(np.array(paths).T, start, fine)
    with stage("tracing"):
        pairs = zip(values.T, driven, strict=True)
        given = values if by_tension else [TARGETS[kind](x) if kind in TARGETS else x for x, kind in pairs]
        follow = partial(trace, nodes=nodes, short_steps=short_steps, throw=False)
        history = follow(manipulator, given, loads, before=past)
        _check(history, steps, values, driven)
        return TracedPath(manipulator, history, steps.tolist(), history_numbers(history), loads)


def _with_points_between(path: np.ndarray, start: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The path from the start with `count` points or more, and the indices of its own steps."""
    ends = path if np.array_equal(path[0], start) else np.vstack([start, path])
    if len(ends) == 1:  # it stands still
        return ends, np.array([0])
    legs = np.array_split(np.arange(max(count, len(ends)) - 1), len(ends) - 1)
    between = [np.linspace(ends[i], ends[i + 1], len(leg) + 1)[1:] for i, leg in enumerate(legs)]
    return np.concatenate([ends[:1], *between]), np.cumsum([0, *map(len, legs)])[-len(path) :]


def _check(history: History, steps: np.ndarray, values: np.ndarray, driven: Sequence[Dimension]) -> None:
    codes = np.asarray(history.status)
    failed = ~np.isin(codes, GOOD)
    if not np.any(failed):
        return
    first = int(np.argmax(failed))
    step = int(np.searchsorted(steps, first))
    pairs = (zip(values[place], driven, strict=True) for place in (steps[step], first))
    to, at = (", ".join(shown(value, kind) for value, kind in pair) for pair in pairs)
    words = words_of(codes[first])
    if isinstance(history._states, SteppedStates) and codes[first] == Status.inaccurate:
        words = f"The error estimate exceeds {ACCURACY:g}: raise --short-steps and --nodes."
    raise SolveError(f"step {step + 1}, on the way to {to}, at {at}: {words}")


def trace_report(found: TracedPath) -> Report:
    """What slid in each step of a path, the states after the steps, and where the work went."""
    answer = trace_as_dict(found)

    def files() -> dict[str, Content]:
        moved = np.ptp(found.states["base_tension"].reshape(len(found.steps), -1), axis=0)  # by each tendon
        figure = figures.history_figure(found.manipulator, found.history, found.steps, tendon=int(np.argmax(moved)))
        return {"loop.csv": loop_csv(found), "fields.csv": fields_csv_of_steps(found), "trace": figure}

    return Report("trace", trace_in_words(found), answer, files)


def trace_as_dict(found: TracedPath) -> dict[str, object]:
    """The states after the steps of a path, and its loads, SI units, for JSON."""
    results = [Status(code).name for code in np.asarray(found.history.status)[found.steps]]
    steps = np.arange(1, len(found.steps) + 1)
    loads = {} if found.loads is None else {"loads": found.loads}
    return {"steps": steps, "results": results, **found.states, **loads}


def trace_in_words(found: TracedPath) -> str:
    """What slid in each step, the state after it, and where the work went."""
    states, lines = found.states, steps_in_words(found.history, found.steps)
    rest = "by the published kinematics" if found.manipulator.kinematics == "published" else "by the increments"
    work, stored, lost = (float(states[name][-1]) for name in ("work", "stored_energy", "friction_loss"))
    parts = [f"{shown(stored, 'energy')} stored", f"{shown(lost, 'energy')} lost to friction"]
    if abs(left := work - stored - lost) > SEEN * abs(work):
        parts.append(f"{shown(left, 'energy')} unaccounted for {rest}")
    lines.append(f"work put in {shown(work, 'energy')}: {', '.join(parts)}")
    return "\n".join([*lines, last_line(found.history)])


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
