"""Friction from tensions and tip angles without a model of the body.

Where a tendon runs at a constant offset and the curvature keeps its sign, the exact kinematics turn the tendon by
theta_tip = |phi(L)| between base and tip, so that the capstan law T_tip = T_base exp(-mu theta_tip), Liu et al. (2020),
eq. (8), gives mu = ln(T_base / T_tip) / theta_tip from every row alone: no modulus, taper or length enters. It checks
a fit of the full model, and the law itself: mu must not depend on the tension.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from .errors import InputError
from .measurements import Measurements
from .table_warnings import ONE_LEVEL

COLUMNS = ("base_tension", "tip_tension", "tip_angle")
SIGNIFICANT = 0.05  # p-values below are mentioned as a finding
LARGEST_Z = 3.0  # of a disagreement that needs no word
_SMALLEST_ANGLE = 1e-9  # rad; below it is 0
_LEAST_FREEDOM = 1e-6  # of a row in the fit of all; with less its noise cannot be told
_FEWEST_TRIALS = 3  # whose scatter can be told
_NUM_STEPS = 100  # of the pooled estimate, which needs 3 or 4


class Constancy(NamedTuple):
    """How mu changes with base tension, and whether by more than chance; NaN where that cannot be told."""

    slope: float  # 1/N
    standard_error: float
    t: float
    p_value: float  # two-sided
    degrees_of_freedom: float  # inf where the noise is known


class Homogeneity(NamedTuple):
    """Whether rows scatter about one mu as the known noise says."""

    chi_square: float
    degrees_of_freedom: int
    p_value: float  # of a scatter as large or larger


class Disagreement(NamedTuple):
    """A fitted mu against the one that needs no model."""

    z: float  # their difference over its standard error; positive where the fit is larger
    sentence: str  # empty where |z| is at most 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFreeFriction:
    """mu of every row and of all together. Arrays go by row of the table."""

    table: Measurements
    estimate: np.ndarray  # NaN where a tension or the angle is 0
    row_standard_error: np.ndarray  # inf there
    weight: np.ndarray  # the share of each row in the pooled value; sums to 1
    value: float  # pooled
    standard_error: float  # inf where a single row tells the value and should tell its noise too
    confidence_interval: tuple[float, float]  # 95 %, t-statistics where noise was estimated
    scatter: float | None  # standard deviation of ln(T_base / T_tip) over all rows where it was estimated
    constancy: Constancy
    homogeneity: Homogeneity | None  # None where noise was estimated

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: the value, and what speaks for and against one mu in all rows."""
        return tuple(_verdict(self))

    def __str__(self) -> str:
        return "\n".join(self.verdict)


def model_free_friction(table: Measurements, noise: Mapping[str, Any] | None = None) -> ModelFreeFriction:
    """The friction coefficient of every row and of all, mu = ln(T_base / T_tip) / theta_tip.

    It reads the pair of the first tendon. The pooled value is the maximum-likelihood line through the origin of
    ln(T_base / T_tip) against theta_tip, errors in both (York et al. (2004), American Journal of Physics 72, 367,
    eq. (13b), without an intercept). A row weighs about as its angle squared: one with hardly an angle hardly counts.
    Where `direction` is -1 the tendon slides out and the logarithm changes its sign; beside other tendons it must be
    stated.

    Taken for granted and not checked: exact kinematics, a tendon parallel to the axis, a curvature of one sign, rows
    that err independently. What rows share - the gain of a cell, the zero of the camera - is in no standard error
    here; what the rows of a trial share is, where noise is not given and `trial` names three trials or more.

    Args:
        table: with `base_tension`, `tip_tension` and `tip_angle`.
        noise: standard deviation of each of the three in SI units, a number or one per row, 0 for what is exact.
            Without it the scatter of the rows tells their noise (that of the trials, where there are three or more),
            and rows weigh as the square of their angle.

    Raises:
        InputError: for columns that are missing, several tendons without `direction`, a table without any bent row,
            noise that is incomplete or negative.
    """
    for column in COLUMNS:
        if column not in table:
            remedy = f"friction without a model needs {', '.join(COLUMNS)}; add the column or use fit"
            raise InputError(f"{table.name}: no column {column!r}; {remedy}")
    if "base_tension_2" in table and "direction" not in table:
        remedy = "add it: 1 where tendon 1 slides in, -1 where it slides out"
        raise InputError(f"{table.name}: several tendons and no column 'direction'; {remedy}")
    base, tip, angle = table["base_tension"], table["tip_tension"], np.abs(table["tip_angle"])
    usable = (base > 0) & (tip > 0) & (angle > _SMALLEST_ANGLE)
    if not np.any(usable):
        remedy = "measure at tensions that bend the body"
        raise InputError(f"{table.name}: no row has tensions and a tip angle other than 0; {remedy}")
    direction = table["direction"][usable] if "direction" in table else 1.0
    base, tip, angle = base[usable], tip[usable], angle[usable]
    loss = direction * np.log(base / tip)
    line = _line(angle, loss, np.ones_like(loss), 0.0)
    if noise is not None:
        sigma = _noise(table, noise)[:, usable]
        expected = base * np.exp(-direction * line.slope * angle)  # a reading must not choose its own weight
        relative = np.hypot(sigma[0] / base, sigma[1] / expected)
        line = _line(angle, loss, relative**2, sigma[2] ** 2)
    return _conclude(table, usable, angle, loss, line, _independent(table, usable) if noise is None else None)


def disagreement(
    model_free: ModelFreeFriction, fit_value: float, fit_standard_error: float, *, name: str = "the fit"
) -> Disagreement:
    """How far a fitted mu lies from the one without a model, in standard errors of their difference.

    The two count as independent, as they are for a pulley test. From the same rows they err alike, and z is then
    smaller than it should be: what it finds is all the more certain.

    Args:
        model_free: of `model_free_friction`.
        fit_value: the friction coefficient of a fit.
        fit_standard_error: of it; inf where it is not identified, which disagrees with nothing.
        name: of the fit, for the sentence.
    """
    difference = fit_value - model_free.value
    error = float(np.hypot(model_free.standard_error, fit_standard_error))
    z = difference / error if error > 0 else float(np.copysign(np.inf, difference)) if difference else 0.0
    if not abs(z) > LARGEST_Z:
        return Disagreement(z, "")
    return Disagreement(
        z,
        f"{name} says friction_coefficient = {fit_value:.4g} +- {fit_standard_error:.2g}, tensions and tip angles "
        f"alone {model_free.value:.4g} +- {model_free.standard_error:.2g}: {abs(z):.1f} standard errors apart; check "
        "kinematics (exact for a real body), the offset of the tendon, and the zeros of load cells and camera",
    )


def _independent(table: Measurements, usable: np.ndarray) -> np.ndarray:
    """Labels of what errs independently: trials where there are enough, rows elsewhere."""
    trials = table["trial"][usable] if "trial" in table else np.empty(0)
    if np.unique(trials).size >= _FEWEST_TRIALS:
        return np.unique(trials, return_inverse=True)[1]
    return np.arange(np.count_nonzero(usable))


def _noise(table: Measurements, noise: Mapping[str, Any]) -> np.ndarray:
    """The standard deviation of each column (first axis) in each row."""
    if set(noise) != set(COLUMNS):
        raise InputError(f"noise: needs {', '.join(COLUMNS)}, got {', '.join(noise)}; give 0 for what is exact")
    rows = []
    for column in COLUMNS:
        sigma = np.asarray(noise[column], dtype=np.float64)
        if sigma.shape not in ((), (len(table),)) or not np.all(np.isfinite(sigma) & (sigma >= 0)):
            raise InputError(f"noise: {column} needs a number of 0 or more, or one for each of {len(table)} rows")
        rows.append(np.broadcast_to(sigma, len(table)))
    if np.any(rows[0] + rows[1] == 0):
        raise InputError("noise: not both tensions can be exact; give the standard deviation of one of them")
    return np.stack(rows)


# --- the statistics of a line through the origin -------------------------------------------------


class _Line(NamedTuple):
    slope: float
    weight: np.ndarray  # 1 / variance of y - slope x
    adjusted: np.ndarray  # x moved onto the line as far as its error allows
    residual: np.ndarray  # y - slope x


def _line(x: np.ndarray, y: np.ndarray, variance_y: Any, variance_x: Any) -> _Line:
    """The line y = slope x, errors in both: York et al. (2004), eq. (13b), without an intercept."""
    slope, previous = float(np.sum(x * y) / np.sum(x * x)), np.inf
    weight, adjusted = np.ones_like(x), x
    for _ in range(_NUM_STEPS):
        if abs(slope - previous) <= 1e-14 * abs(slope):
            break
        weight = 1.0 / (variance_y + slope**2 * variance_x)
        adjusted = weight * (variance_y * x + slope * variance_x * y)
        previous, slope = slope, float(np.sum(weight * adjusted * y) / np.sum(weight * adjusted * x))
    return _Line(slope, weight, adjusted, y - slope * x)


def _conclude(
    table: Measurements, usable: np.ndarray, angle: np.ndarray, loss: np.ndarray, line: _Line, labels: np.ndarray | None
) -> ModelFreeFriction:
    """Labels of what errs independently, None where the noise is known."""
    freedom, estimated = angle.size - 1, labels is not None
    chi_square = float(np.sum(line.weight * line.residual**2))
    scatter = 1.0 if not estimated else float(np.sqrt(chi_square / freedom)) if freedom else np.inf
    information = line.weight * line.adjusted**2
    if labels is None:
        error, quantile = 1 / float(np.sqrt(information.sum())), float(stats.norm.ppf(0.975))
    else:
        error = _jackknife(line.adjusted[:, None], line.residual, labels)[0]
        quantile = float(stats.t.ppf(0.975, max(labels.max(), 1)))
    share = line.weight * line.adjusted * angle
    homogeneous = Homogeneity(chi_square, freedom, float(stats.chi2.sf(chi_square, freedom)) if freedom else np.nan)

    def by_row(values: np.ndarray, other: float) -> np.ndarray:
        rows = np.full(len(table), other)
        rows[usable] = values
        return rows

    return ModelFreeFriction(
        table=table,
        estimate=by_row(loss / angle, np.nan),
        row_standard_error=by_row(scatter / np.sqrt(line.weight) / angle, np.inf),
        weight=by_row(share / np.sum(share), 0.0),
        value=line.slope,
        standard_error=error,
        confidence_interval=(line.slope - quantile * error, line.slope + quantile * error),
        scatter=scatter if estimated else None,
        constancy=_constancy(table["base_tension"][usable], line, labels),
        homogeneity=None if estimated else homogeneous,
    )


def _constancy(base: np.ndarray, line: _Line, labels: np.ndarray | None) -> Constancy:
    """The slope b of mu = a + b T_base, about the pooled line to first order."""
    freedom = np.inf if labels is None else float(min(base.size - 2, labels.max()))
    if freedom <= 0 or np.ptp(base) <= ONE_LEVEL * base.max():
        return Constancy(np.nan, np.nan, np.nan, np.nan, freedom)
    information = line.weight * line.adjusted**2
    regressor = line.adjusted * (base - np.sum(information * base) / np.sum(information))
    steepness = line.weight * regressor**2
    slope = float(np.sum(line.weight * regressor * line.residual) / steepness.sum())
    error = 1 / float(np.sqrt(steepness.sum()))
    if labels is not None:
        columns = np.stack([line.adjusted, regressor], axis=1)
        error = _jackknife(columns, line.residual - slope * regressor, labels)[1]
    t = slope / error if 0 < error < np.inf else np.nan
    return Constancy(slope, error, t, float(2 * stats.t.sf(abs(t), freedom)), freedom)


def _jackknife(columns: np.ndarray, residual: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Standard errors of the coefficients of a linear fit from what leaving out each label would change.

    Of single rows HC3, MacKinnon and White (1985), Journal of Econometrics 29, 305; of groups CR3, Bell and McCaffrey
    (2002), Survey Methodology 28, 169.

    Args:
        columns: (rows, coefficients).
        residual: (rows,), of the fit.
        labels: (rows,), 0, 1, ... for each row's group.
    """
    order = np.argsort(labels, kind="stable")
    first = np.flatnonzero(np.diff(labels[order], prepend=-1))
    squares = np.add.reduceat(columns[order, :, None] * columns[order, None, :], first)
    pull = np.add.reduceat(columns[order] * residual[order, None], first)
    whole = squares.sum(axis=0)
    left = whole - squares
    if np.any(np.linalg.det(left) < _LEAST_FREEDOM * np.linalg.det(whole)):
        return np.full(columns.shape[1], np.inf)
    change = np.linalg.solve(left, pull[..., None])[..., 0]
    return np.sqrt(np.sum(change**2, axis=0))


# --- the verdict ---------------------------------------------------------------------------------


def _verdict(found: ModelFreeFriction) -> list[str]:
    rows, used = len(found.estimate), int(np.count_nonzero(found.weight))
    low, high = found.confidence_interval
    lines = [
        f"friction_coefficient = {found.value:.4g} +- {found.standard_error:.2g} (95 %: {low:.4g} to {high:.4g}) from "
        f"tensions and tip angles of {used} of {rows} rows, whatever the body"
    ]
    lines.append(_on_constancy(found.constancy))
    if found.homogeneity is not None and found.homogeneity.degrees_of_freedom:
        lines.append(_on_homogeneity(found.homogeneity))
    angle = found.table["tip_angle"]
    if np.any(angle > 0) and np.any(angle < 0):
        lines.append(
            "Tip angles have both signs: check the zero of the angle; within a row the curvature must keep one."
        )
    if any(column.startswith("tip_force") and np.any(values) for column, values in found.table.columns.items()):
        lines.append("A force acts on the tip: the value holds only where it leaves the curvature of one sign.")
    if not np.isfinite(found.standard_error):
        lines.append(
            "A single row carries it and cannot tell its own noise: measure more, or give the noise of the instruments."
        )
    return lines


def _on_constancy(test: Constancy) -> str:
    if not np.isfinite(test.p_value):
        return "Whether it depends on base tension cannot be told: measure more rows, at several levels."
    numbers = f"slope {test.slope:.2g} +- {test.standard_error:.2g} per N, p = {test.p_value:.2g}"
    if test.p_value >= SIGNIFICANT:
        return f"It does not drift with base tension by more than chance ({numbers})."
    return (
        f"It drifts with base tension by more than chance usually makes it ({numbers}): check the zeros of load cells "
        "and camera, and whether the tendon runs at a constant offset; one coefficient may not do for these rows."
    )


def _on_homogeneity(test: Homogeneity) -> str:
    numbers = (
        f"chi-square {test.chi_square:.4g} on {test.degrees_of_freedom} degrees of freedom, p = {test.p_value:.2g}"
    )
    if test.p_value < SIGNIFICANT:
        return f"Rows scatter more than the given noise ({numbers}): the standard error is too small."
    if test.p_value > 1 - SIGNIFICANT:
        return f"Rows scatter less than the given noise ({numbers}): is it stated too large?"
    return f"Rows scatter as the given noise lets them ({numbers})."
