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
from ..measurements.readings import SET, kind_of_set
from ..measurements.table import Measurements
from ..quantities import dimension_of
from ..units import shown
from .bench import BenchModel, benches_of, groups_of
from .course import course_of, is_driven_by_length, paths_of
from .parameters import MOTORS, TRIALS, along_a_path, parameter_named
from .predictions import over_noise

RIVALS = ("slack_offset", "lag", "backlash", "friction_moment", "outside_drag", "outside_friction")
ONE_SIDED = RIVALS[1:]  # the body comes after its motors, and friction takes
FRICTION = "friction_coefficient"
CLEAR = 6.0  # in BIC: a smaller gain is no reason to doubt
WIDER = 3.0  # times the standard error of friction: the data do not tell it from a rival that widens it so much


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
    fit: LeastSquaresFit, tables: Sequence[Measurements], model: BenchModel, options: Mapping[str, Any]
) -> list[Rival]:
    """What else may have made the loops of a fit; [] where friction is not identified or no displacement turns.

    Args:
        fit: its statistics.
        tables, model: its data and its bench.
        options: `noise`, `history` and `short_steps` as they were given to `fit`.
    """
    driven = [own for own in benches_of(tables, model) if is_driven_by_length(own[1])]
    turns = any(one.course is not None and one.course.turns for _, _, one in driven)
    if not fit.success or fit.status.get(FRICTION) != IDENTIFIED or not turns:
        return []
    timed = all(_has_times(table, options) for _, table, _ in driven)
    given = [name for _, _, one in driven for name in one.setting.given]
    own = [parameter_named(name).name for name in (*fit.names, *given) if not name.startswith(TRIALS)]
    known = {*along_a_path(model.manipulator, ()), *own}
    in_all_rows = not any(np.any(~own.rows) for _, table, _ in driven for own in table.set_columns)
    without = [*known, *([] if in_all_rows else MOTORS), *([] if timed else ["lag"])]
    names = [name for name in RIVALS if name not in without]
    parameters = {**jax.tree.map(np.asarray, dict(fit.parameters)), **{name: np.zeros(()) for name in names}}
    slopes = {}
    for name, table, one in driven:
        noise = {column: value for column, value in options["noise"].items() if kind_of_set(column) in SET}
        how = {"short_steps": options["short_steps"], "stepped": True, "timed": timed and in_all_rows}
        course, _ = course_of(table, noise, paths=paths_of(table, options["history"]), **how)
        bench = replace(one, course=course, name=one.name)
        shown = bench.evaluate(model.manipulator, parameters, model.nodes, by_base=False)
        slopes[name] = shown.derivatives
    ends = np.cumsum([np.size(parameters[name]) for name in sorted(parameters)])  # in the flat order
    places = dict(zip(sorted(parameters), (ends - 1).tolist(), strict=True))
    found = []
    for name in names:
        of_groups = {
            group.label: slopes[group.name][group.column][group.there, places[name]]
            for group in groups_of(tables, model)
            if group.name in slopes
        }
        found.append(_rival(fit, name, over_noise(fit, of_groups)))
    return [rival for rival in found if rival is not None]


def _has_times(table: Measurements, options: Mapping[str, Any]) -> bool:
    """Whether the times of each path rise, so that a lag has an effect."""
    paths = paths_of(table, options["history"]) or []
    return "time" in table and all(np.all(np.diff(table["time"][rows]) > 0) for rows in paths)


def _rival(fit: LeastSquaresFit, name: str, column: np.ndarray) -> Rival | None:
    """The best fit with one more column in the Jacobian; None where the data do not know it."""
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
    if name in ONE_SIDED and value <= 0:  # it would stay at 0
        value, step = 0.0, 0.0 * step
    left = residual - both @ step
    gain, ends = -np.log(column.size), np.cumsum([len(rows) for rows in evidence.rows.values()])
    groups = zip(np.split(residual, ends)[:-1], np.split(left, ends)[:-1], strict=True)
    for estimated, (own, rest) in zip(evidence.noise_estimated.values(), groups, strict=True):
        before, after = float(own @ own), float(rest @ rest)
        gain += own.size * np.log(before / after) if estimated else before - after
    place = fit.names.index(FRICTION)
    error = float(np.sqrt(np.linalg.pinv(both.T @ both)[place, place]))
    friction = fit.value[FRICTION] + float(step[place] * evidence.size[place])
    wider = error / float(evidence.spectrum.relative_error[place])
    return Rival(name, value, float(gain), friction, wider * fit.standard_error[FRICTION], wider)
