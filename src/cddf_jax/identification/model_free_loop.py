"""The gain of the tip cell and the loss of the tendon from a loop of tensions, without a model of the body.

Without loads and with friction proportional to the tension, 1/T at the tip is 1/T_base + g where the whole tendon
slides in, and 1/T_base - g where it slides out, for any body. At equal base tensions the sum of both is 2/T_base, which
gives the gain of the tip cell over that of the base cell. The difference is 2 g; g is mu/E times the integral of offset
over second moment of area.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from ..errors import InputError
from ..measurements.branches import branches
from ..measurements.table import Measurements
from .model_free import SIGNIFICANT, independent_labels, jackknife

COLUMNS = ("base_tension", "tip_tension")
ROUNDS = 20  # at most, to find the rows in which the whole tendon slides out
LEAST_ROWS = 2  # on either branch
LEAST_SLACK = 0.1  # of 1/T_base: the smallest 1/T_tip during the search for gain and loss


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFreeLoop:
    """Gain and loss from both branches of loops."""

    table: Measurements
    branch: np.ndarray  # (rows,), 1 where the whole tendon slides in, -1 where it slides out, 0 where a row is unused
    gain: float  # of the tip cell over that of the base cell
    gain_standard_error: float
    loss: float  # g, 1/N: 1/T_tip - 1/T_base of a pull
    loss_standard_error: float
    zero: float  # N, of the tip cell, if it is fitted too; gain and loss above are those without it
    zero_p_value: float  # two-sided, of the test that the zero is 0; NaN where the rows do not determine it
    degrees_of_freedom: int

    @property
    def gain_interval(self) -> tuple[float, float]:
        """95 %, t-statistics."""
        half = float(stdtrit(max(self.degrees_of_freedom, 1), 0.975)) * self.gain_standard_error
        return self.gain - half, self.gain + half

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: gain and loss, and what contradicts them."""
        low, high = self.gain_interval
        pull, out = (np.count_nonzero(self.branch == way) for way in (1, -1))
        lines = [
            f"the tip cell reads {self.gain:.4g} +- {self.gain_standard_error:.2g} times the base cell (95 %: "
            f"{low:.4g} to {high:.4g}), by the sum of 1/T_tip of {pull} rows pulled and {out} released, for any body",
            f"1/T_tip - 1/T_base of a pull = {self.loss:.4g} +- {self.loss_standard_error:.2g} 1/N, by the difference",
        ]
        if not low <= 1 <= high:
            lines.append("The two cells do not agree: compare them under one weight, or let tip_gain be free.")
        if self.zero_p_value < SIGNIFICANT:
            lines.append(
                f"One gain does not fit all rows (p = {self.zero_p_value:.2g}): a zero of the tip cell of "
                f"{self.zero:.2g} N would; check the zeros of the cells, the pretension, and whether the tendon drags."
            )
        return tuple(lines)

    def __str__(self) -> str:
        return "\n".join(self.verdict)


def model_free_loop(table: Measurements) -> ModelFreeLoop:
    """The gain of the tip cell and the loss of the tendon from a loop of tensions, pulled and released.

    The rows are in the order of the columns `step` or `time`, or of the file; each trial starts from rest. Of the
    release, only the rows are used in which the whole tendon slides. The noise of the tip cell is estimated from the
    scatter.

    Not checked: one tendon, no loads, no drag, a tendon parallel to the axis, cells without zeros and pretension. The
    result reports a zero of the tip cell.

    Args:
        table: with `base_tension` and `tip_tension`.

    Raises:
        InputError: for columns that are missing, forces on the tip, or too few rows on either branch.
    """
    for column in COLUMNS:
        if column not in table:
            raise InputError(f"{table.name}: no column {column!r}; a loop needs {' and '.join(COLUMNS)}")
    if "base_tension_2" in table or any(name.startswith("tip_force") and np.any(table[name]) for name in table.columns):
        raise InputError(f"{table.name}: a loop without a model needs one tendon and no force on the tip; use fit")
    used = branch = np.where((table["base_tension"] > 0) & (table["tip_tension"] > 0), branches(table), 0.0)
    loss = _regression(table, branch > 0, branch)[0][1] if np.count_nonzero(branch > 0) >= LEAST_ROWS else 0.0
    gain, covariance, freedom = 1.0, np.full((3, 3), np.inf), 0
    for _ in range(ROUNDS):
        last, used = used, np.where((branch > 0) | _has_slid_out(table, loss), branch, 0.0)
        counts = [np.count_nonzero(used == way) for way in (1, -1)]
        if min(counts) < LEAST_ROWS:
            raise InputError(
                f"{table.name}: {counts[0]} rows of the pull and {counts[1]} rows in which all of the tendon slides "
                f"out; {LEAST_ROWS} of each are needed: release further, or give the order by a column step"
            )
        (gain, loss, _), covariance, freedom = _regression(table, used != 0, used)
        if np.array_equal(used, last):
            break
    (_, _, zero), with_zero, freedom_left = _regression(table, used != 0, used, with_zero=True)
    t = zero / np.sqrt(with_zero[2, 2]) if 0 < with_zero[2, 2] < np.inf else np.nan
    return ModelFreeLoop(
        table=table,
        branch=used,
        gain=float(gain),
        gain_standard_error=float(np.sqrt(covariance[0, 0])),
        loss=float(loss),
        loss_standard_error=float(np.sqrt(covariance[1, 1])),
        zero=float(zero),
        zero_p_value=float(2 * stdtr(freedom_left, -abs(t))) if freedom_left > 0 else np.nan,
        degrees_of_freedom=freedom,
    )


def _has_slid_out(table: Measurements, loss: float) -> np.ndarray:
    """(rows,), whether the front of the release has reached the tip."""
    largest = np.zeros(table.trial.max() + 1)
    np.maximum.at(largest, table.trial, table["base_tension"])
    return 1 / np.maximum(table["base_tension"], 1e-300) >= 1 / largest[table.trial] + 2 * max(loss, 0.0)


def _regression(
    table: Measurements, rows: np.ndarray, branch: np.ndarray, *, with_zero: bool = False
) -> tuple[np.ndarray, np.ndarray, int]:
    """Gain, loss and zero of T_tip = gain / (1/T_base +- loss) + zero, their covariance, and the degrees of freedom."""
    inverse, tip, way = 1 / table["base_tension"][rows], table["tip_tension"][rows], branch[rows]
    count = 2 + with_zero
    found = np.array([1.0, max(float(np.median(way * (1 / tip - inverse))), 0.0), 0.0])

    def linearised() -> tuple[np.ndarray, np.ndarray]:
        slack = np.maximum(inverse + way * found[1], LEAST_SLACK * inverse)
        columns = np.stack([1 / slack, -found[0] * way / slack**2, np.ones(tip.size)], axis=1)[:, :count]
        return columns, tip - found[0] / slack - found[2]

    for _ in range(ROUNDS):  # the Gauss-Newton method
        found[:count] += np.linalg.lstsq(*linearised())[0]
    columns, residual = linearised()
    covariance, labels = np.full((3, 3), np.inf), independent_labels(table, rows)
    if np.linalg.matrix_rank(columns) == count:
        covariance[:count, :count] = jackknife(columns, residual, labels)
    return found, covariance, int(min(tip.size - count, labels.max()))
