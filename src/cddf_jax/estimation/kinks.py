"""Minima at a kink: there the sum of squares rises on both sides of a parameter, although its slope is not zero.

A model whose derivative jumps has them. Searches end beside such a place and look as if they had stopped short.
"""

import numpy as np

from .determination import Evidence
from .levenberg_marquardt import Minimum, Outcome, evaluate, hold_one
from .parameter_space import TINY

STEEPEST = 1e-4  # slope of the cost at a minimum, over what residuals and derivatives could make it
STEEPEST_UNSOLVED = 1e-6  # the same where the optimiser ran out of steps
EXACT = 1e-3  # root mean square residual, over the noise, below which the slope is rounding
BESIDE = 0.1  # standard errors, how far on both sides of a kink the sum of squares has to rise


def slopes(minimum: Minimum, outcome: Outcome) -> np.ndarray:
    """(parameters,), of the cost, over what residuals and derivatives could make them."""
    column, total = np.linalg.norm(outcome.jacobian, axis=0), np.linalg.norm(outcome.residual)
    slope = np.abs(outcome.jacobian.T @ minimum.problem.influence(outcome.residual))
    return slope / np.maximum(column * total, TINY)


def is_steep(minimum: Minimum, evidence: Evidence) -> bool:
    """Whether the cost slopes where the search ended; at a bound it may well do so."""
    outcome = minimum.outcome
    exact = np.linalg.norm(outcome.residual) <= EXACT * np.sqrt(outcome.residual.size)
    steepest = STEEPEST if outcome.solved else STEEPEST_UNSOLVED
    return not exact and bool(np.any(slopes(minimum, outcome)[~evidence.at_bound] > steepest))


def kink_of(minimum: Minimum, evidence: Evidence) -> tuple[int, Minimum] | None:
    """The parameter with the kink, and the minimum there; None where the end of a search is none.

    The steepest parameter is held, and the others are fitted again. With that parameter a little to either side, the
    sum of squares has to be larger, however the others are fitted.
    """
    value, free = minimum.outcome.parameters, ~evidence.at_bound
    i = int(np.argmax(np.where(free, slopes(minimum, minimum.outcome), -1.0)))
    held = hold_one(len(value), i, value[i])
    z = np.where(np.isnan(held), minimum.refit(held)[0].z, minimum.outcome.z)
    there = minimum._replace(outcome=evaluate(minimum.problem, z))
    others = free & np.isnan(held)
    if not np.all(slopes(there, there.outcome)[others] <= STEEPEST):
        return None
    away = BESIDE * evidence.spectrum.relative_error[i] * evidence.size[i]
    space = minimum.problem.space
    for place in (value[i] - away, value[i] + away):
        inside = space.lower[i] < place < space.upper[i]
        if not inside or not there.refit(hold_one(len(value), i, place))[1] > 0:
            return None
    steps = minimum.outcome.num_steps
    return i, there._replace(outcome=there.outcome._replace(num_steps=steps))
