"""Friction from tensions and tip angles, without a model of the body.

A tendon at a constant offset, in a body whose curvature keeps its sign, turns by theta_tip = |phi(L)| between base and
tip (exact kinematics). The capstan law T_tip = T_base exp(-mu theta_tip), Liu et al. (2020), eq. (8), then gives
mu = ln(T_base / T_tip) / theta_tip from every row alone, without modulus, taper or length. This checks a fit of the
full model, and the law itself: mu must not depend on the tension.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from ..errors import InputError
from ..measurements.forces import force_column
from ..measurements.jitter import without_jitter
from ..measurements.readings import set_by
from ..measurements.table import Measurements
from ..measurements.table_warnings import ONE_LEVEL

COLUMNS = ("base_tension", "tip_tension", "tip_angle")
SIGNIFICANT = 0.05  # smaller p-values are reported
SMALLEST_ANGLE = 1e-9  # rad; a smaller angle counts as 0
LEAST_LEFT = 1e-6  # of the determinant of all rows, without one label; with less the noise cannot be estimated
FEWEST_TRIALS = 3  # with fewer, the scatter of trials is not estimated


class Constancy(NamedTuple):
    """How mu changes with base tension, and whether by more than chance; NaN where the rows do not determine it."""

    slope: float  # 1/N
    standard_error: float
    p_value: float  # two-sided

    def __str__(self) -> str:
        if not np.isfinite(self.p_value):
            return "These rows do not show whether it depends on base tension: measure more rows, at several levels."
        numbers = f"slope {self.slope:.2g} +- {self.standard_error:.2g} per N, p = {self.p_value:.2g}"
        if self.p_value >= SIGNIFICANT:
            return f"It does not drift with base tension by more than chance ({numbers})."
        return (
            f"It drifts with base tension by more than chance ({numbers}): check the zeros of load cells "
            "and camera, and whether the tendon runs at a constant offset; one coefficient may not describe these rows."
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFreeFriction:
    """mu of every row and of all together. Arrays have one entry per row of the table."""

    table: Measurements
    estimate: np.ndarray  # NaN where a tension or the angle is 0
    value: float  # pooled
    standard_error: float  # inf where one row alone determines the value, so that the noise cannot be estimated
    confidence_interval: tuple[float, float]  # 95 %, t-statistics; of rows, or trials, less one
    constancy: Constancy

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: the value, and whether one mu describes all rows."""
        rows, used = len(self.estimate), np.count_nonzero(np.isfinite(self.estimate))
        low, high = self.confidence_interval
        lines = [
            f"friction_coefficient = {self.value:.4g} +- {self.standard_error:.2g} (95 %: {low:.4g} to {high:.4g}) "
            f"from tensions and tip angles of {used} of {rows} rows, for any body",
            str(self.constancy),
        ]
        if any(force_column(column) and np.any(values) for column, values in self.table.columns.items()):
            lines.append("A force acts on the body: the value holds only where the curvature keeps one sign.")
        return tuple(lines)

    def __str__(self) -> str:
        return "\n".join(self.verdict)


def model_free_friction(table: Measurements) -> ModelFreeFriction:
    """The friction coefficient of every row and of all rows, mu = ln(T_base / T_tip) / theta_tip.

    It uses the tensions of the first tendon. The pooled value is the mean of the rows, weighted by the square of their
    angle, so that a small angle hardly counts. Where `direction` is -1 the tendon slides out and the logarithm changes
    its sign; with several tendons this column is needed. The noise is estimated from the scatter of the rows (or of the
    trials, where there are three or more).

    Not checked: exact kinematics, a tendon parallel to the axis, a curvature of one sign, independent errors of the
    rows. An error that all rows share - the gain of a cell, the zero of the camera - is not in the standard error. An
    error that the rows of a trial share is included, where `trial` names three trials or more.

    Where rows of one tendon have a history, as a column `step` or `time` says, only those are used in which the whole
    tendon slides in: those at the largest base tension so far.

    Args:
        table: with `base_tension`, `tip_tension` and `tip_angle`.

    Raises:
        InputError: for missing columns, several tendons without `direction`, or a table without any bent row.
    """
    for column in COLUMNS:
        if column not in table:
            remedy = f"friction without a model needs {', '.join(COLUMNS)}; add the column or use fit"
            raise InputError(f"{table.name}: no column {column!r}; {remedy}")
    if not np.all(table.has("base_tension")):
        row = table.place(int(np.argmin(table.has("base_tension"))))
        remedy = "friction without a model needs it in all rows; leave the others out, or use fit"
        raise InputError(f"{table.name}: {row} has no base tension; {remedy}")
    if len(set_by(table.columns)) > 1 and "direction" not in table:
        remedy = "add it: 1 where tendon 1 slides in, -1 where it slides out"
        raise InputError(f"{table.name}: several tendons and no column 'direction'; {remedy}")
    base, tip, angle = table["base_tension"], table["tip_tension"], np.abs(table["tip_angle"])
    usable = (base > 0) & (tip > 0) & (angle > SMALLEST_ANGLE)
    followed = table.ordered and len(set_by(table.columns)) == 1
    usable = usable & _pulled(table) if followed else usable
    if not np.any(usable):
        remedy = "measure at tensions that bend the body"
        raise InputError(f"{table.name}: no row has tensions and a tip angle other than 0; {remedy}")
    direction = table["direction"][usable] if "direction" in table and not followed else 1.0
    base, tip, angle = base[usable], tip[usable], angle[usable]
    loss, labels = direction * np.log(base / tip), independent_labels(table, usable)
    value = float(np.sum(angle * loss) / np.sum(angle**2))
    residual = loss - value * angle
    error = float(np.sqrt(jackknife(angle[:, None], residual, labels)[0, 0]))
    freedom = max(int(labels.max()), 1)
    half_width = float(stdtrit(freedom, 0.975)) * error
    estimate = np.full(len(table), np.nan)
    estimate[usable] = loss / angle
    return ModelFreeFriction(
        table=table,
        estimate=estimate,
        value=value,
        standard_error=error,
        confidence_interval=(value - half_width, value + half_width),
        constancy=_constancy(base, angle, residual, labels),
    )


def independent_labels(table: Measurements, usable: np.ndarray) -> np.ndarray:
    """Labels 0, 1, ... of groups with independent errors: the trials if there are enough of them, else the rows."""
    trials = table["trial"][usable] if "trial" in table else np.empty(0)
    if np.unique(trials).size >= FEWEST_TRIALS:
        return np.unique(trials, return_inverse=True)[1]
    return np.arange(np.count_nonzero(usable))


def _constancy(base: np.ndarray, angle: np.ndarray, residual: np.ndarray, labels: np.ndarray) -> Constancy:
    """The slope b of mu = a + b T_base, from the residuals of the pooled value, with its test."""
    freedom = int(min(base.size - 2, labels.max()))
    if freedom <= 0 or np.ptp(base) <= ONE_LEVEL * base.max():
        return Constancy(np.nan, np.nan, np.nan)
    regressor = angle * (base - np.average(base, weights=angle**2))
    slope = float(np.sum(regressor * residual) / np.sum(regressor**2))
    columns = np.stack([angle, regressor], axis=1)
    error = float(np.sqrt(jackknife(columns, residual - slope * regressor, labels)[1, 1]))
    t = slope / error if 0 < error < np.inf else np.nan
    return Constancy(slope, error, float(2 * stdtr(freedom, -abs(t))))


def jackknife(columns: np.ndarray, residual: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The covariance of the coefficients of a linear fit, from their changes when each label is left out.

    For single rows this is HC3, MacKinnon and White (1985), Journal of Econometrics 29, 305; for groups it is CR3, Bell
    and McCaffrey (2002), Survey Methodology 28, 169. Both are valid for few rows, where bootstrap intervals are too
    narrow.

    Args:
        columns: (rows, coefficients).
        residual: (rows,), of the fit.
        labels: (rows,), 0, 1, ... for each row's group.
    """
    count = columns.shape[1]
    squares, pull = np.zeros((labels.max() + 1, count, count)), np.zeros((labels.max() + 1, count))
    np.add.at(squares, labels, columns[:, :, None] * columns[:, None, :])
    np.add.at(pull, labels, columns * residual[:, None])
    left = squares.sum(axis=0) - squares
    if np.any(np.linalg.det(left) < LEAST_LEFT * np.linalg.det(squares.sum(axis=0))):
        return np.full((count, count), np.inf)
    changes = np.linalg.solve(left, pull[..., None])[..., 0]
    return changes.T @ changes


def _pulled(table: Measurements) -> np.ndarray:
    """(rows,), whether the base tension is the largest of its trial so far. Jitter of the cell is ignored."""
    found = np.zeros(len(table), bool)
    for rows in table.trials:
        tension = without_jitter(table["base_tension"][rows]).tension
        found[rows] = tension >= np.maximum.accumulate(tension)
    return found
