"""Friction from tensions and tip angles without a model of the body.

A tendon at a constant offset, in a body whose curvature keeps its sign, turns by theta_tip = |phi(L)| between base and
tip (exact kinematics). The capstan law T_tip = T_base exp(-mu theta_tip), Liu et al. (2020), eq. (8), then gives
mu = ln(T_base / T_tip) / theta_tip from every row alone: no modulus, taper or length enters. It checks a fit of the
full model, and the law itself: mu must not depend on the tension.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from scipy import stats

from ..errors import InputError
from ..measurements.table import Measurements
from ..measurements.table_warnings import ONE_LEVEL

COLUMNS = ("base_tension", "tip_tension", "tip_angle")
SIGNIFICANT = 0.05  # p-values below are mentioned as a finding
LARGEST_Z = 3.0  # of a disagreement that is not mentioned
SMALLEST_ANGLE = 1e-9  # rad; below it is 0
LEAST_LEFT = 1e-6  # of the determinant of all rows, without a label; with less its noise cannot be estimated
FEWEST_TRIALS = 3  # whose scatter can be estimated
NUM_STEPS = 100  # of the pooled estimate, which needs 3 or 4
SETTLED = 1e-14  # relative change at which it ends


class Constancy(NamedTuple):
    """How mu changes with base tension, and whether by more than chance; NaN where the rows do not tell."""

    slope: float  # 1/N
    standard_error: float
    t: float
    p_value: float  # two-sided
    degrees_of_freedom: float  # inf where the noise is known

    def __str__(self) -> str:
        if not np.isfinite(self.p_value):
            return "These rows do not tell whether it depends on base tension: measure more rows, at several levels."
        numbers = f"slope {self.slope:.2g} +- {self.standard_error:.2g} per N, p = {self.p_value:.2g}"
        if self.p_value >= SIGNIFICANT:
            return f"It does not drift with base tension by more than chance ({numbers})."
        return (
            f"It drifts with base tension by more than chance ({numbers}): check the zeros of load cells "
            "and camera, and whether the tendon runs at a constant offset; one coefficient may not describe these rows."
        )


class Homogeneity(NamedTuple):
    """Whether rows scatter about one mu as the known noise says."""

    chi_square: float
    degrees_of_freedom: int
    p_value: float  # of a scatter as large or larger

    def __str__(self) -> str:
        freedom = self.degrees_of_freedom
        numbers = f"chi-square {self.chi_square:.4g} on {freedom} degrees of freedom, p = {self.p_value:.2g}"
        if self.p_value < SIGNIFICANT:
            return f"Rows scatter more than the given noise ({numbers}): the standard error is too small."
        if self.p_value > 1 - SIGNIFICANT:
            return f"Rows scatter less than the given noise ({numbers}): is it stated too large?"
        return f"Rows scatter as the given noise predicts ({numbers})."


class Disagreement(NamedTuple):
    """A fitted mu against the one without a model."""

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
    standard_error: float  # inf where a single row determines the value, so that its noise cannot be estimated
    confidence_interval: tuple[float, float]  # 95 %, t-statistics where noise was estimated
    scatter: float | None  # standard deviation of ln(T_base / T_tip) over all rows where it was estimated
    constancy: Constancy
    homogeneity: Homogeneity | None  # None where noise was estimated

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: the value, and what speaks for and against one mu in all rows."""
        rows, used = len(self.estimate), int(np.count_nonzero(self.weight))
        low, high = self.confidence_interval
        angle, columns = self.table["tip_angle"], self.table.columns.items()
        lines = [
            f"friction_coefficient = {self.value:.4g} +- {self.standard_error:.2g} (95 %: {low:.4g} to {high:.4g}) "
            f"from tensions and tip angles of {used} of {rows} rows, for any body",
            str(self.constancy),
        ]
        if self.homogeneity is not None and self.homogeneity.degrees_of_freedom:
            lines.append(str(self.homogeneity))
        if np.any(angle > 0) and np.any(angle < 0):
            lines.append(
                "Tip angles have both signs: check the zero of the angle; within a row the curvature must keep one."
            )
        if any(column.startswith("tip_force") and np.any(values) for column, values in columns):
            lines.append("A force acts on the tip: the value holds only where the curvature keeps one sign.")
        if not np.isfinite(self.standard_error):
            lines.append(
                "A single row determines it, without its noise: measure more, or give the noise of the instruments."
            )
        return tuple(lines)

    def __str__(self) -> str:
        return "\n".join(self.verdict)


def model_free_friction(table: Measurements, noise: Mapping[str, ArrayLike] | None = None) -> ModelFreeFriction:
    """The friction coefficient of every row and of all, mu = ln(T_base / T_tip) / theta_tip.

    It reads the tensions of the first tendon. The pooled value is the weighted mean of the rows. A row weighs about as
    its angle squared, so that a small angle hardly counts; with `noise` the weights are those of the most likely line
    through the origin of ln(T_base / T_tip) against theta_tip, errors in both: York et al. (2004), American Journal of
    Physics 72, 367, eq. (13b), without an intercept. Where `direction` is -1 the tendon slides out and the logarithm
    changes its sign; beside other tendons it must be stated.

    Not checked: exact kinematics, a tendon parallel to the axis, a curvature of one sign, independent errors of the
    rows. An error that all rows share - the gain of a cell, the zero of the camera - is not in the standard error. An
    error that the rows of a trial share is, where noise is not given and `trial` names three trials or more.

    Args:
        table: with `base_tension`, `tip_tension` and `tip_angle`.
        noise: standard deviation of each of the three in SI units, a number or one per row, 0 for what is exact.
            Without it the noise is estimated from the scatter of the rows (of the trials, where there are three or
            more), and rows weigh as the square of their angle.

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
    usable = (base > 0) & (tip > 0) & (angle > SMALLEST_ANGLE)
    if not np.any(usable):
        remedy = "measure at tensions that bend the body"
        raise InputError(f"{table.name}: no row has tensions and a tip angle other than 0; {remedy}")
    direction = table["direction"][usable] if "direction" in table else 1.0
    base, tip, angle = base[usable], tip[usable], angle[usable]
    loss = direction * np.log(base / tip)
    line = _pool(base, angle, loss, 1.0, 0.0)
    labels = None if noise is not None else _independent(table, usable)
    if noise is not None:
        sigma = _noise(table, noise)[:, usable]
        expected = base * np.exp(-direction * line.value * angle)  # a reading must not choose its own weight
        line = _pool(base, angle, loss, (sigma[0] / base) ** 2 + (sigma[1] / expected) ** 2, sigma[2] ** 2)
    freedom, chi_square = angle.size - 1, float(np.sum(line.weight * line.residual**2))
    scatter, homogeneity, quantile = None, None, float(stats.norm.ppf(0.975))
    if labels is None:
        tail = float(stats.chi2.sf(chi_square, freedom)) if freedom else np.nan
        homogeneity = Homogeneity(chi_square, freedom, tail)
    else:
        scatter = float(np.sqrt(chi_square / freedom)) if freedom else np.inf
        quantile = float(stats.t.ppf(0.975, max(labels.max(), 1)))
    error = line.standard_errors(line.adjusted[:, None], line.residual, labels)[0]
    share = line.weight * line.adjusted * angle

    def by_row(values: np.ndarray, other: float) -> np.ndarray:
        rows = np.full(len(table), other)
        rows[usable] = values
        return rows

    return ModelFreeFriction(
        table=table,
        estimate=by_row(loss / angle, np.nan),
        row_standard_error=by_row((1.0 if scatter is None else scatter) / np.sqrt(line.weight) / angle, np.inf),
        weight=by_row(share / np.sum(share), 0.0),
        value=line.value,
        standard_error=error,
        confidence_interval=(line.value - quantile * error, line.value + quantile * error),
        scatter=scatter,
        constancy=_constancy(line, labels),
        homogeneity=homogeneity,
    )


def disagreement(
    model_free: ModelFreeFriction, fit_value: float, fit_standard_error: float, *, name: str = "the fit"
) -> Disagreement:
    """How far a fitted mu lies from the one without a model, in standard errors of their difference.

    The two count as independent, as they are for a pulley test. From the same rows they err alike, and z is then too
    small: a disagreement that is found is certain all the more.

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
    """Labels 0, 1, ... of what errs independently: trials where there are enough, rows elsewhere."""
    trials = table["trial"][usable] if "trial" in table else np.empty(0)
    if np.unique(trials).size >= FEWEST_TRIALS:
        return np.unique(trials, return_inverse=True)[1]
    return np.arange(np.count_nonzero(usable))


def _noise(table: Measurements, noise: Mapping[str, ArrayLike]) -> np.ndarray:
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


# --- statistics ----------------------------------------------------------------------------------


class _Line(NamedTuple):
    """Through the origin of loss against angle: their weighted mean quotient. Arrays go by usable row."""

    base: np.ndarray
    value: float
    residual: np.ndarray
    weight: np.ndarray  # 1 / variance of the residual
    adjusted: np.ndarray  # the angle, moved onto the line as far as its error allows

    def standard_errors(self, columns: np.ndarray, residual: np.ndarray, labels: np.ndarray | None) -> np.ndarray:
        """Of the coefficients of orthogonal columns, by the known noise; with labels by the jackknife."""
        if labels is not None:
            return _jackknife(columns, residual, labels)
        return 1 / np.sqrt(np.sum(self.weight[:, None] * columns**2, axis=0))


def _pool(
    base: np.ndarray,
    angle: np.ndarray,
    loss: np.ndarray,
    variance_loss: np.ndarray | float,
    variance_angle: np.ndarray | float,
) -> _Line:
    """Weights from the value and the value from weights, until they agree: York et al. (2004), eq. (13b)."""
    weight, adjusted = np.ones_like(angle), angle
    value, previous = float(np.average(loss / angle, weights=angle**2)), np.inf
    for _ in range(NUM_STEPS):
        if abs(value - previous) <= SETTLED * abs(value):
            break
        weight = 1.0 / (variance_loss + value**2 * variance_angle) * np.ones_like(angle)
        adjusted = weight * (variance_loss * angle + value * variance_angle * loss)
        previous, value = value, float(np.average(loss / angle, weights=weight * adjusted * angle))
    return _Line(base, value, loss - value * angle, weight, adjusted)


def _constancy(line: _Line, labels: np.ndarray | None) -> Constancy:
    """The slope b of mu = a + b T_base, about the pooled line to first order."""
    base, _, residual, weight, adjusted = line
    freedom = np.inf if labels is None else float(min(base.size - 2, labels.max()))
    if freedom <= 0 or np.ptp(base) <= ONE_LEVEL * base.max():
        return Constancy(np.nan, np.nan, np.nan, np.nan, freedom)
    regressor = adjusted * (base - np.average(base, weights=weight * adjusted**2))
    slope = float(np.sum(weight * regressor * residual) / np.sum(weight * regressor**2))
    columns = np.stack([adjusted, regressor], axis=1)
    error = float(line.standard_errors(columns, residual - slope * regressor, labels)[1])
    t = slope / error if 0 < error < np.inf else np.nan
    return Constancy(slope, error, t, float(2 * stats.t.sf(abs(t), freedom)), freedom)


def _jackknife(columns: np.ndarray, residual: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Standard errors of the coefficients of a linear fit, from the changes as each label is left out.

    Of single rows HC3, MacKinnon and White (1985), Journal of Econometrics 29, 305; of groups CR3, Bell and McCaffrey
    (2002), Survey Methodology 28, 169. They hold with few rows, where a bootstrap is too narrow.

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
        return np.full(count, np.inf)
    return np.sqrt(np.sum(np.linalg.solve(left, pull[..., None])[..., 0] ** 2, axis=0))
