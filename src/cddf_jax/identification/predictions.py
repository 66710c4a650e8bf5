"""Predictions of a fitted model at given base tensions and tip forces: their rows, and which lie beyond the data.

And how far finer steps along a history would move them, and the estimates with them.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from ..errors import InputError, within
from ..programs.kept import kept_program
from ..robot.manipulator import Manipulator
from .bench import TRIALS, Bench, BenchModel, Group, Parameters
from .course import SHORT_STEPS, course_along
from .past import REST, Before

if TYPE_CHECKING:
    from .fit import Fit

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
    short_steps: int = SHORT_STEPS,
) -> Bench:
    """The rows to predict at; arguments as of `Fit.predict`.

    Raises:
        InputError: for numbers that are not finite, tensions below 0, shapes that do not fit, a history with stated
            directions.
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
        components = 3 if np.shape(tip_force)[-1:] == (3,) else 2
        force = np.broadcast_to(np.asarray(tip_force, np.float64), (rows, components))
    except ValueError:
        got = ", ".join(str(np.shape(given)) for given in (base_tension, tip_force, *stated.values()))
        raise InputError(
            f"predict: needs base_tension (rows,) or (rows, {tendons}), tip_force (2,) or (rows, 2), in space of three "
            f"components, and direction that fits; got {got}"
        ) from None
    if before != REST and not history:
        raise InputError("predict: before is used with a history only; give history=True")
    if not history:
        return Bench(pulled, tuple(way), force if np.any(force) else None)
    if stated:
        raise InputError("predict: with a history directions follow from it; leave direction out")
    with within("predict"):
        course = course_along(pulled, force, before, short_steps)
    return Bench(pulled, tuple(way), force if np.any(force) else None, course=course)


def beyond_the_data(wanted: Bench, model: BenchModel) -> np.ndarray:
    """Which rows lie outside what the data span, of any tendon's base tension or any component of the tip force."""

    def conditions(bench: Bench) -> np.ndarray:
        force = np.zeros((len(bench.base_tension), 3))
        if bench.tip_force is not None:
            force[:, : np.shape(bench.tip_force)[1]] = bench.tip_force
        return np.concatenate([bench.base_tension, force], axis=1)

    measured = [conditions(e) for e in model.experiments if isinstance(e, Bench)]
    there = conditions(wanted)
    if not measured:
        return np.ones(len(there), bool)
    rows = np.concatenate(measured)
    low, high = rows.min(axis=0), rows.max(axis=0)
    slack = SPANNED * np.maximum(np.abs(low), np.abs(high))
    return np.any((there < low - slack) | (there > high + slack), axis=1)


def moved_by_finer_steps(fit: "Fit") -> dict[str, float]:
    """By parameter, how far short steps and cells move its estimate, over its standard error.

    By the linearised fit to the difference that half the steps and half the cells make, twice: the error falls in
    proportion. Empty where every answer is exact; NaN where the finer one has no solution.
    """
    body, nodes, spectrum = fit.model.manipulator, fit.model.nodes, fit.evidence.spectrum
    parameters, moved = jax.tree.map(np.asarray, fit.parameters), np.zeros(len(fit.names))
    found = False
    for name, one in zip(fit.model.names, fit.model.experiments, strict=True):
        if not isinstance(one, Bench) or one.course is None or one.course.short_steps is None:
            continue
        found = True
        finer = replace(one, course=replace(one.course, short_steps=2 * one.course.short_steps), name="")
        read = _read(finer, body, parameters, 2 * nodes)
        for group in (group for group in fit.groups if group.name == name):
            apart = np.asarray(read[group.column]) - (group.observed - fit.residuals[group.label])
            noise = noise_of_readings(fit, group)
            moved += spectrum.covariance @ (fit.evidence.rows[group.label].T @ (2 * apart / noise))
    with np.errstate(invalid="ignore"):
        over = np.abs(moved) / spectrum.relative_error
    own = zip(fit.names, over.tolist(), strict=True)
    return {name: value for name, value in own if not name.startswith(TRIALS)} if found else {}


def noise_of_readings(fit: "Fit", group: Group) -> np.ndarray:
    """(readings,), standard deviations."""
    problem = fit.minimum.problem
    return np.ravel(problem.data.noise[problem.groups.index(group.label)])


@kept_program
@eqx.filter_jit
def _read(bench: Bench, manipulator: Manipulator, parameters: Parameters, nodes: int) -> dict[str, Array]:
    return bench.predict(manipulator, parameters, nodes)
