"""What else makes loops: friction on the body beside lag, backlash, and friction elsewhere.

A bench driven by displacement shows friction by the width of its loops only, and all of these widen loops. One step of
the linearised fit, from the estimate, tells by how much each of them would improve the fit, and what friction would be
beside it. It takes no other fit, and is as good as the linearisation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from ..estimation.determination import IDENTIFIED
from ..estimation.evidence import without_nan
from ..estimation.least_squares import LeastSquaresFit
from ..measurements.table import Measurements
from ..quantities import dimension_of
from ..units import shown
from .bench import Bench, BenchModel, groups_of
from .course import course_of, paths_of
from .parameters import PARAMETERS
from .predictions import noise_of_readings

RIVALS = ("lag", "backlash", "friction_moment", "outside_drag")
FRICTION = "friction_coefficient"
CLEAR = 6.0  # in BIC: a smaller gain is no reason to doubt
WIDER = (
    3.0  # times the standard error of friction: beside a rival that widens it so much the data do not tell them apart
)


class Rival(NamedTuple):
    """What a fit with one more parameter would find."""

    name: str
    value: float  # SI
    gain: float  # the decrease of BIC
    friction: float  # the friction coefficient beside it
    standard_error: float  # of this coefficient
    wider: float  # the same over that of the fit without the rival

    @property
    def in_words(self) -> str:
        """Why friction is in doubt; "" where it is not."""
        size = shown(self.value, dimension_of(self.name))
        beside = f"friction_coefficient would be {self.friction:.2g} +- {self.standard_error:.2g}"
        if self.gain > CLEAR:
            return (
                f"loops by displacement: {self.name} = {size} explains what friction on the body does not (BIC falls "
                f"by about {self.gain:.0f}), and {beside}; fit {self.name} as well, and compare"
            )
        if self.wider > WIDER:
            return (
                f"loops by displacement: these data do not tell friction on the body from {self.name}, beside which "
                f"{beside}; measure loops of other amplitudes and speeds, or give the {self.name} that is known"
            )
        return ""


def rivals_of(
    fit: LeastSquaresFit, tables: Sequence[Measurements], model: BenchModel, history: Any, short_steps: int
) -> list[Rival]:
    """What else may have made the loops of a fit; [] where friction is not identified or no displacement turns.

    Args:
        fit: its statistics.
        tables, model: its data and its bench.
        history, short_steps: as they were given to `fit`.
    """
    if not fit.success or fit.status.get(FRICTION) != IDENTIFIED:
        return []
    courses = [one.course for one in model.experiments if isinstance(one, Bench) and one.course is not None]
    if not any(any(course.by_length) and course.turns for course in courses):
        return []
    columns = _columns(fit, tables, model, history, short_steps)
    return [rival for name in columns if (rival := _rival(fit, name, columns[name])) is not None]


def _columns(
    fit: LeastSquaresFit, tables: Sequence[Measurements], model: BenchModel, history: Any, short_steps: int
) -> dict[str, np.ndarray]:
    """By rival, the derivatives of all readings over their noise, whitened; in the order of the fit's rows."""
    timed = all("time" in table for table in tables)
    names = [name for name in RIVALS if name not in fit.names and (timed or name != "lag")]
    parameters = {**jax.tree.map(np.asarray, dict(fit.parameters)), **{name: np.zeros(()) for name in names}}
    ends = np.cumsum([np.size(parameters[name]) for name in sorted(parameters)])  # in the flat order
    places = dict(zip(sorted(parameters), (ends - 1).tolist(), strict=True))
    found: dict[str, dict[str, np.ndarray]] = {name: {} for name in names}
    for label, table, one in zip(model.names, tables, model.experiments, strict=True):
        slopes: Mapping[str, np.ndarray] = {}
        if isinstance(one, Bench) and one.course is not None and any(one.course.by_length):
            paths = paths_of(table, history)
            course, _ = course_of(table, paths=paths, short_steps=short_steps, stepped=True, timed=timed)
            bench = replace(one, course=course, name=one.name)
            slopes = bench.evaluate(model.manipulator, parameters, model.nodes).derivatives
        for group in (group for group in groups_of(tables, model) if group.name == label):
            own = slopes[group.column] if slopes else np.zeros((len(table), ends[-1]))
            for name in names:
                found[name][group.label] = own[group.there, places[name]] / noise_of_readings(fit, group)
    problem = fit.minimum.problem
    return {
        name: np.asarray(problem.shared.whitened(np.concatenate([own[label] for label in problem.groups])))
        for name, own in found.items()
    }


def _rival(fit: LeastSquaresFit, name: str, column: np.ndarray) -> Rival | None:
    """The best fit with one more column in the Jacobian; None where it would be below its bound."""
    evidence, known = fit.evidence, fit.evidence.jacobian
    residual, more = np.zeros(len(known)), np.zeros(len(known))
    residual[: column.size] = np.concatenate([fit.standardised_residuals[label] for label in evidence.rows])
    more[: column.size] = without_nan(column)
    size = float(np.linalg.norm(more))
    if not size > 0:
        return None
    both = np.column_stack([known, more / size])
    step, *_ = np.linalg.lstsq(both, residual, rcond=1e-9)
    value = float(step[-1]) / size
    if PARAMETERS[name].positive and value <= 0:
        return None
    left = residual - both @ step
    gain, ends = -np.log(column.size), np.cumsum([len(rows) for rows in evidence.rows.values()])
    groups = zip(np.split(residual, ends)[:-1], np.split(left, ends)[:-1], strict=True)
    for estimated, (own, rest) in zip(evidence.noise_estimated.values(), groups, strict=True):
        before, after = float(own @ own), float(rest @ rest)
        gain += own.size * np.log(before / after) if estimated else before - after
    place = fit.names.index(FRICTION)
    unit, error = float(evidence.size[place]), float(np.sqrt(np.linalg.pinv(both.T @ both)[place, place]))
    friction = fit.value[FRICTION] + float(step[place]) * unit
    return Rival(
        name, value, float(gain), friction, error * unit, error / float(evidence.spectrum.relative_error[place])
    )
