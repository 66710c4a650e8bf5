"""The two outer branches of a loop: the pull from rest to the largest base tension, and the release from it."""

import numpy as np

from .jitter import without_jitter
from .table import Measurements


def branches(table: Measurements) -> np.ndarray:
    """(rows,), 1 where the base tension is the largest of its trial so far, -1 where it is the smallest since the turn.

    0 where it is neither: within a smaller loop, or pulled again. Jitter of the cell is ignored.
    """
    found = np.zeros(len(table))
    for rows in table.trials:
        tension = without_jitter(table["base_tension"][rows]).tension
        behind = np.arange(rows.size) > np.flatnonzero(tension == np.max(tension))[-1]
        up = ~behind & (tension >= np.maximum.accumulate(tension))
        back = behind & (tension <= np.minimum.accumulate(np.where(behind, tension, np.inf)))
        found[rows] = np.where(up, 1.0, np.where(back, -1.0, 0.0))
    return found
