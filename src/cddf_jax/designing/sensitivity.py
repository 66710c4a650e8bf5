"""Derivatives of the best objective by numbers that are not free: of the body, of the load cases, of the limits."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..statics.named_numbers import Case, tip_of_winding
from .constrained import LocalMinimum
from .free_numbers import PLACE
from .load_cases import case_numbers
from .problem import DesignProblem, ProgramValues

KINK = 1e-5  # relative: multipliers that differ by less are the same


class FixedNumber(NamedTuple):
    """A number that is not free: what it belongs to, and its name there."""

    owner: Literal["body", "case", "limit"]
    place: int  # of the load case or of the limit, from 0
    name: str

    @property
    def label(self) -> str:
        """As in `Design.sensitivity`: "youngs_modulus", "case 1: base_tension", "limit 2: most"."""
        return self.name if self.owner == "body" else f"{self.owner} {self.place + 1}: {self.name}"

    def in_words(self, problem: DesignProblem) -> str:
        """The number in words: a limit by its quantity, a load case by its name, if there are several."""
        if self.owner == "body":
            return self.name
        if self.owner == "limit":
            return f"limit of {problem.limits[self.place].name}, {self.name}"
        target = "what base_tension is to reach" if self.name.endswith(".value") else self.name
        name = problem.cases[self.place].name or f"case {self.place + 1}"
        return target if len(problem.cases) == 1 else f"{name}: {target}"


def fixed_numbers(problem: DesignProblem) -> dict[FixedNumber, float]:
    """All numbers that are not free, by what they belong to."""
    free = {name for names in problem.free.names for name in names}
    free |= {tip_of_winding(name) for name in free}
    body = problem.manipulator
    set_by_cases = {name for case in problem.cases for name in case.numbers}
    of_body = _numbers(case_numbers(body))
    found = {FixedNumber("body", 0, name): x for name, x in of_body.items() if name not in free | set_by_cases}
    for i, case in enumerate(problem.cases):
        if len(case.numbers) == 0 or len(problem.cases) == 1:
            acting = _numbers(replace(case, direction=None).of(body))
            own = [name for name in acting if name not in {*of_body, *free}]
            found |= {FixedNumber("case", i, name): acting[name] for name in own}
    for i, limit in enumerate(problem.limits):
        sides = {side: getattr(limit, side) for side in ("least", "most", "equal")}
        found |= {
            FixedNumber("limit", i, side): float(value)
            for side, value in sides.items()
            if value is not None and np.ndim(value) == 0
        }
    return found


def _numbers(case: Case) -> dict[str, float]:
    """The numbers of a case by name, without arc lengths."""
    return {name: float(np.asarray(number)) for name, number in case.numbers.items() if not PLACE.search(name)}


def with_fixed(problem: DesignProblem, numbers: Mapping[FixedNumber, Array]) -> DesignProblem:
    """The problem with other fixed numbers; another length stretches everything along the body."""

    def of(owner: str, place: int) -> dict[str, Array]:
        return {fixed.name: x for fixed, x in numbers.items() if (fixed.owner, fixed.place) == (owner, place)}

    body = case_numbers(problem.manipulator).with_numbers(of("body", 0)).manipulator
    cases = [case.with_numbers(body, of("case", i))[1] for i, case in enumerate(problem.cases)]
    limits = [replace(limit, **of("limit", i)) for i, limit in enumerate(problem.limits)]
    return replace(problem, manipulator=body, cases=tuple(cases), limits=tuple(limits))


@eqx.filter_jit
def _slopes(problem: DesignProblem, x: Array, fixed: tuple[FixedNumber, ...], numbers: Array) -> ProgramValues:
    """The derivatives of all values by fixed numbers, on the last axis."""
    return jax.jacfwd(lambda numbers: with_fixed(problem, dict(zip(fixed, numbers, strict=True))).values(x)[0])(numbers)


def sensitivities(problem: DesignProblem, local: LocalMinimum) -> dict[FixedNumber, float]:
    """Derivatives of the optimiser's objective at the optimum, by the envelope theorem: those of the Lagrangian.

    NaN if several sets of multipliers meet the conditions: the objective has a kink there.
    """
    numbers, answer = fixed_numbers(problem), {}
    values = jnp.asarray(list(numbers.values()))
    slopes = jax.tree.map(np.asarray, _slopes(problem, jnp.asarray(local.point.x), tuple(numbers), values))
    for i, name in enumerate(numbers):
        low, high = local.optimality.range_of(slopes.inequality[:, i], slopes.equality[:, i])
        unique = high - low <= KINK * max(1.0, abs(low), abs(high))
        answer[name] = float(slopes.objective[i]) - low if unique else np.nan
    return answer
