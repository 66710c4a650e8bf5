"""Predictions of a fitted model at given base tensions and tip forces: their rows, and which lie beyond the data."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError, within
from .bench import Bench, BenchModel
from .course import course_along
from .past import REST, Before

SPANNED = 1e-9  # of a largest condition: rows this close to the data count as inside

Numbers = ArrayLike | Sequence[float] | Sequence[Sequence[float]]


class Prediction(NamedTuple):
    """The fitted model at some base tensions."""

    value: np.ndarray
    half_width: np.ndarray  # of the 95 % band that the uncertainty of the parameters makes
    extrapolated: np.ndarray  # True beyond the base tensions or tip forces of the data


def predicted_rows(
    base_tension: Numbers,
    tip_force: Numbers,
    direction: Numbers | None,
    tendons: int,
    *,
    history: bool = False,
    before: Before = REST,
) -> Bench:
    """The rows to predict at; arguments as of `Fit.predict`.

    Raises:
        InputError: for numbers that are not finite, tensions below 0, shapes that do not fit, a history of several
            tendons, of a body under a tip force or with stated directions.
    """
    tension = np.atleast_1d(np.asarray(base_tension, dtype=np.float64))
    stated = {} if direction is None else {"direction": direction}
    for name, numbers in {"base_tension": tension, "tip_force": tip_force, **stated}.items():
        if not np.all(np.isfinite(np.asarray(numbers, np.float64))):
            raise InputError(f"predict: {name} must hold finite numbers")
    if np.any(tension < 0):
        raise InputError(f"predict: base_tension must be 0 N or more, got {np.min(tension):g}; a tendon only pulls")
    tension = tension[:, None] if tension.ndim == 1 else tension
    rows = len(tension)
    try:
        pulled = np.broadcast_to(tension, (rows, tendons))
        way = np.broadcast_to(np.asarray(direction, np.float64), (rows, tendons)).T if stated else (None,) * tendons
        force = np.broadcast_to(np.asarray(tip_force, np.float64), (rows, 2))
    except ValueError:
        raise InputError(
            f"predict: needs base_tension (rows,) or (rows, {tendons}), tip_force (2,) or (rows, 2), and direction "
            f"that fits; got {', '.join(str(np.shape(given)) for given in (base_tension, tip_force, *stated.values()))}"
        ) from None
    if before != REST and not history:
        raise InputError("predict: before is used with a history only; give history=True")
    if not history:
        return Bench(pulled, tuple(way), force if np.any(force) else None)
    if tendons > 1 or np.any(force) or stated:
        raise InputError("predict: a history is that of one tendon without tip force, and directions follow from it")
    with within("predict"):
        return Bench(pulled, tuple(way), course=course_along(pulled[:, 0], before))


def beyond_the_data(wanted: Bench, model: BenchModel) -> np.ndarray:
    """Which rows lie outside what the data span, of any tendon's base tension or any component of the tip force."""

    def conditions(bench: Bench) -> np.ndarray:
        force = np.zeros((len(bench.base_tension), 2)) if bench.tip_force is None else bench.tip_force
        return np.concatenate([bench.base_tension, force], axis=1)

    measured = [conditions(e) for e in model.experiments if isinstance(e, Bench)]
    there = conditions(wanted)
    if not measured:
        return np.ones(len(there), bool)
    rows = np.concatenate(measured)
    low, high = rows.min(axis=0), rows.max(axis=0)
    slack = SPANNED * np.maximum(np.abs(low), np.abs(high))
    return np.any((there < low - slack) | (there > high + slack), axis=1)
