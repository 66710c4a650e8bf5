"""Derivatives of the best objective by numbers that are not free: of the body and of the load cases."""

from collections.abc import Mapping
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..programs.kept import kept_program
from ..robot.named_numbers import Case, tip_of_winding
from .constrained import LocalMinimum
from .free_numbers import PLACE
from .load_cases import case_numbers
from .problem import DesignProblem, ProgramValues

Fixed = tuple[int | None, str]  # a number that is not free: its load case, None for the body; and its name there


def label_of(fixed: Fixed) -> str:
    """As in `Design.sensitivity`: "youngs_modulus", "case 1: base_tension"."""
    case, name = fixed
    return name if case is None else f"case {case + 1}: {name}"


def fixed_numbers(problem: DesignProblem) -> dict[Fixed, float]:
    """All numbers of body and load cases that are not free."""
    free = {name for names in problem.free.names for name in names}
    free |= {tip_of_winding(name) for name in free}
    body = problem.manipulator
    set_by_cases = {name for case in problem.cases for name in case.numbers}
    of_body = _numbers(case_numbers(body))
    found: dict[Fixed, float] = {(None, name): x for name, x in of_body.items() if name not in free | set_by_cases}
    for i, case in enumerate(problem.cases):
        if len(case.numbers) == 0 or len(problem.cases) == 1:
            acting = _numbers(replace(case, direction=None).of(body))
            found |= {(i, name): x for name, x in acting.items() if name not in {*of_body, *free}}
    return found


def _numbers(case: Case) -> dict[str, float]:
    """The numbers of a case by name, without arc lengths."""
    return {name: float(np.asarray(number)) for name, number in case.numbers.items() if not PLACE.search(name)}


def with_fixed(problem: DesignProblem, numbers: Mapping[Fixed, Array]) -> DesignProblem:
    """The problem with other fixed numbers; another length stretches everything along the body."""

    def of(place: int | None) -> dict[str, Array]:
        return {name: x for (case, name), x in numbers.items() if case == place}

    body = case_numbers(problem.manipulator).with_numbers(of(None)).manipulator
    cases = [case.with_numbers(body, of(i))[1] for i, case in enumerate(problem.cases)]
    return replace(problem, manipulator=body, cases=tuple(cases))


@kept_program
@eqx.filter_jit
def _slopes(problem: DesignProblem, x: Array, fixed: tuple[Fixed, ...], numbers: Array) -> ProgramValues:
    """The derivatives of all values by fixed numbers, on the last axis."""
    return jax.jacfwd(lambda numbers: with_fixed(problem, dict(zip(fixed, numbers, strict=True))).values(x)[0])(numbers)


def sensitivities(problem: DesignProblem, local: LocalMinimum) -> dict[Fixed, float]:
    """Derivatives of the optimiser's objective at the optimum, by the envelope theorem: those of the Lagrangian.

    NaN if several sets of multipliers meet the conditions: the objective has a kink there.
    """
    numbers = fixed_numbers(problem)
    values = jnp.asarray(list(numbers.values()))
    slopes = jax.tree.map(np.asarray, _slopes(problem, jnp.asarray(local.point.x), tuple(numbers), values))
    columns = zip(slopes.objective, slopes.inequality.T, slopes.equality.T, strict=True)
    answers = [float(own) - local.optimality.price(*limits) for own, *limits in columns]
    return dict(zip(numbers, answers, strict=True))
