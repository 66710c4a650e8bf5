"""In which sense the loops of a table by displacement run: without any model.

All friction, backlash and lag leave the body behind: at equal displacement it is bent more on the way back than on the
way there. A loop the other way contradicts every model of this package.
"""

import numpy as np

from .readings import kind_of_set, set_by
from .table import Measurements

LEAST_PAIRS = 5  # of places on the way back, to be told from noise
SURE = 5.0  # standard errors of the mean by which loops run backwards
MOST_OTHERS = 0.1  # of the places may lie on the other side
LEAST_WIDTH = 1e-3  # of the whole motion: a narrower loop is none


def loop_widths(table: Measurements) -> np.ndarray:
    """Bending on the way back less that on the way there, at the displacements of the way back; rad, or m of the tip.

    Of trials in which one displacement is pulled in and released, where the way there has readings on both sides. What
    straight lines between these readings may miss is taken off.
    """
    columns = set_by(table.columns)
    if len(columns) != 1 or kind_of_set(columns[0]) != "displacement":
        return np.zeros(0)
    found = [np.zeros(0)]
    for rows in table.trials:
        pulled, bend = table[columns[0]][rows], _bending(table, rows)
        peak = int(np.argmax(pulled))
        there, back = slice(0, peak + 1), slice(peak + 1, None)
        if peak < 3 or np.any(np.diff(pulled[there]) <= 0) or not np.all(np.isfinite(bend)):
            continue
        inside = pulled[back] >= pulled[0]
        widths = (bend[back] - np.interp(pulled[back], pulled[there], bend[there]))[inside]
        doubtful = max(_missed_between(pulled[there], bend[there]), LEAST_WIDTH * float(np.ptp(bend)))
        found.append(np.sign(widths) * np.maximum(np.abs(widths) - doubtful, 0.0))
    return np.concatenate(found)


def _missed_between(pulled: np.ndarray, bend: np.ndarray) -> float:
    """The error of straight lines between the readings of a curve: at each reading, of a line between its neighbours.

    Such a line is twice as long as those between the readings, so that its error is about four times theirs.
    """
    part = (pulled[1:-1] - pulled[:-2]) / (pulled[2:] - pulled[:-2])
    return float(np.mean(np.abs(bend[:-2] + part * (bend[2:] - bend[:-2]) - bend[1:-1])))


def runs_backwards(table: Measurements) -> str:
    """In words, that the loops of a table run the wrong way; "" where they do not."""
    widths = loop_widths(table)
    if widths.size < LEAST_PAIRS:
        return ""
    mean, error = float(np.mean(widths)), float(np.std(widths, ddof=1) / np.sqrt(widths.size))
    if mean > -SURE * error or np.mean(widths >= 0) > MOST_OTHERS:
        return ""
    return (
        f"the loops of {table.name} run backwards: at equal displacement the body is bent less on the way back, and no "
        "friction, backlash or lag does that; check the sign and the zero of the displacement, whether the tendon "
        "creeps or slips on its spool, and the clocks of motor and camera"
    )


def _bending(table: Measurements, rows: np.ndarray) -> np.ndarray:
    """The tip angle, or else the place of the tip along the direction in which it moves most; NaN without either."""
    if "tip_angle" in table:
        return table["tip_angle"][rows]
    tip = [table[column][rows] for column in ("tip_x", "tip_y", "tip_z") if column in table]
    if not tip or not np.all(np.isfinite(tip)):
        return np.full(len(rows), np.nan)
    place = np.stack(tip, axis=1) - np.mean(tip, axis=1)
    along = place @ np.linalg.svd(place, full_matrices=False)[2][0]
    pulled = table[set_by(table.columns)[0]][rows]
    return along * np.sign(along @ (pulled - pulled.mean()))
