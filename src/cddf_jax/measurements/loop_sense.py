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


def loop_widths(table: Measurements) -> np.ndarray:
    """Bending on the way back less that on the way there, at the displacements of the way back; rad, or m of the tip.

    Trials in which one displacement is pulled in and released; places that the way there did not reach are left out.
    """
    columns = set_by(table.columns)
    if len(columns) != 1 or kind_of_set(columns[0]) != "displacement":
        return np.zeros(0)
    found = [np.zeros(0)]
    for rows in table.trials:
        pulled, bend = table[columns[0]][rows], _bending(table, rows)
        peak = int(np.argmax(pulled))
        there, back = slice(0, peak + 1), slice(peak + 1, None)
        if peak < 2 or np.any(np.diff(pulled[there]) <= 0) or not np.all(np.isfinite(bend)):
            continue
        inside = pulled[back] >= pulled[0]
        found.append((bend[back] - np.interp(pulled[back], pulled[there], bend[there]))[inside])
    return np.concatenate(found)


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
