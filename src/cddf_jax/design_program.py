"""A design problem compiled: values, derivatives and Hessian products for an optimiser, responses to fixed numbers."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .case import Case, of_tendon
from .constrained import Point, Weights
from .design_problem import Evaluation, Problem, Values
from .equilibrium import RESULTS
from .load_cases import LoadCase
from .manipulator import Manipulator

USABLE = tuple(  # results whose numbers lead somewhere
    int(code._value)
    for code in (
        *(RESULTS.successful, RESULTS.direction_contradicted, RESULTS.crossing),
        *(RESULTS.inaccurate, RESULTS.unstable),
    )
)


class Program:
    """The problem as a function of the unknowns, one program for every problem of one structure."""

    def __init__(self, problem: Problem):
        self.problem = problem

    def __call__(self, x: np.ndarray) -> Point:
        values, slopes, found = _tell(self.problem, jnp.asarray(x))
        value, slope = jax.tree.map(np.asarray, (values, slopes))
        finite = all(np.all(np.isfinite(part)) for part in (*value, *slope))
        usable = finite and bool(np.all(np.isin(np.asarray(found.codes), USABLE)))
        return Point(
            np.array(x),
            float(value.objective),
            slope.objective,
            value.inequality,
            slope.inequality,
            value.equality,
            slope.equality,
            usable,
        )

    def curvature(self, x: np.ndarray, weights: Weights, along: np.ndarray) -> np.ndarray:
        """Hessian product of the weighted sum."""
        return np.asarray(_curvature(self.problem, _array(x), _array(weights), _array(along)))

    def evaluation(self, x: Any) -> Evaluation:
        """What the values are made of."""
        return jax.tree.map(np.asarray, _tell(self.problem, jnp.asarray(x))[2])

    def response(self, x: np.ndarray, numbers: Mapping[str, Any]) -> dict[str, Values]:
        """Derivatives of all values by numbers that are not free, in turn; see `with_fixed`."""
        base = {name: jnp.asarray(value, jnp.float64) for name, value in numbers.items()}
        answer = {}
        for name in base:
            towards = {other: jnp.ones(()) if other == name else jnp.zeros(()) for other in base}
            answer[name] = jax.tree.map(np.asarray, _response(self.problem, _array(x), base, towards))
        return answer

    def at_stations(self, stations: np.ndarray) -> "Program":
        """The same with limits looked at elsewhere."""
        return Program(replace(self.problem, stations=jnp.asarray(stations)))


def _array(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), tree)


@eqx.filter_jit
def _tell(problem: Problem, x: Any) -> tuple[Values, Values, Evaluation]:
    def told(x: Any) -> tuple[Values, tuple[Values, Evaluation]]:
        values, found = problem.values(x)
        return values, (values, found)

    slopes, (values, found) = jax.jacfwd(told, has_aux=True)(x)
    return values, slopes, found


def _weighted(problem: Problem, x: Any, weights: Any) -> Any:
    values, _ = problem.values(x)
    return weights[0] * values.objective + weights[1] @ values.inequality + weights[2] @ values.equality


@eqx.filter_jit
def _curvature(problem: Problem, x: Any, weights: Any, along: Any) -> Any:
    gradient = jax.jacfwd(lambda x: _weighted(problem, x, weights))
    return jax.jvp(gradient, (x,), (along,))[1]


@eqx.filter_jit
def _response(problem: Problem, x: Any, numbers: Any, towards: Any) -> Values:
    return jax.jvp(lambda there: with_fixed(problem, there).values(x)[0], (numbers,), (towards,))[1]


# --- numbers that are not free -------------------------------------------------------------------


def fixed_numbers(problem: Problem) -> dict[str, float]:
    """Those that a designer may ask about: of the body, of every load case ("case 1: base_tension"), of the limits."""
    free = {name for names in problem.space.names for name in names}
    body = problem.manipulator
    names = ["length", "youngs_modulus", "friction_coefficient", *(["density"] if np.any(body.density) else [])]
    names += [name for name in ("drag", "stiffness_factor") if getattr(body, name) is not None]
    names += [f"point_masses.{i}.{part}" for i in range(len(body.point_masses)) for part in ("mass", "arc_length")]
    profiles = list(body.profiles)
    case = Case(body, None, None, None)
    own = {name for used in problem.cases for name in used.numbers}
    found = {}
    for name in [*names, *(f"{profile}{end}" for profile in profiles for end in ("", ".base", ".tip"))]:
        if name not in free | own and (value := _number(case, name)) is not None:
            found[name] = value
    for i, used in enumerate(problem.cases):
        if len(used.numbers) == 0 or len(problem.cases) == 1:
            found |= {f"case {i + 1}: {name}": x for name, x in _acting(body, used).items() if name not in free}
    for i, limit in enumerate(problem.limits):
        sides = {side: getattr(limit, side) for side in ("least", "most", "equal")}
        found |= {f"limit {i + 1}: {side}": float(x) for side, x in sides.items() if x is not None and np.ndim(x) == 0}
    return found


def _acting(body: Manipulator, used: LoadCase) -> dict[str, float]:
    case = Case(body, used.base_tension, used.loads, used.direction)
    actuated = ["base_tension", *(of_tendon("base_tension", i) for i in range(body.num_tendons))]
    names = [name + part for name in actuated for part in ("", ".value")]
    names += ["loads.tip_force.0", "loads.tip_force.1", "loads.tip_moment"] if used.loads is not None else []
    return {name: value for name in names if (value := _number(case, name)) is not None}


def _number(case: Case, name: str) -> float | None:
    try:
        number = case.number(name)
    except ValueError:
        return None
    single = isinstance(number, float | np.ndarray | jax.Array) and np.ndim(number) == 0
    return float(np.asarray(number)) if single else None


def with_fixed(problem: Problem, numbers: Mapping[str, Any]) -> Problem:
    """The problem with other fixed numbers; another length stretches what runs along the body."""
    own = {name: x for name, x in numbers.items() if ": " not in name}
    body = Case(problem.manipulator, None, None, None).with_numbers(own).manipulator
    cases, limits = list(problem.cases), list(problem.limits)
    for label, x in numbers.items():
        kind, _, name = label.partition(": ")
        if kind.startswith("case "):
            i = int(kind.removeprefix("case ")) - 1
            there = Case(body, cases[i].base_tension, cases[i].loads, cases[i].direction).with_numbers({name: x})
            cases[i] = replace(cases[i], base_tension=there.base_tension, loads=there.loads)
        elif kind.startswith("limit "):
            i = int(kind.removeprefix("limit ")) - 1
            limits[i] = replace(limits[i], **{name: x})
    return replace(problem, manipulator=body, cases=tuple(cases), limits=tuple(limits))
