"""`design`: the body that does best what is wanted, within what can be made."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from . import design_results as results
from .case import Case
from .design_problem import Problem, Term
from .design_program import USABLE
from .design_results import Design
from .design_search import WANDERING, Outcome, Search, Watch
from .design_space import space_of
from .equilibrium import RESULTS
from .errors import InputError
from .limits import Limit
from .load_cases import LoadCase
from .loads import Loads
from .manipulator import Manipulator
from .objectives import Least, Objective
from .quantities import View, name_of

STATIONS = 33  # at which limits along the body are looked at, evenly
CROSSING = 0.99  # kappa d at most, short of 1 where fibres cross
THINNEST = 1e-3  # of the outer radius at the start, the wall that is always kept


def design(
    manipulator: Manipulator,
    objective: Any,
    free: Sequence[str],
    bounds: Mapping[str, tuple[Any, Any]] | None = None,
    constraints: Sequence[Limit] = (),
    *,
    cases: LoadCase | Sequence[LoadCase] | None = None,
    base_tension: Any = None,
    loads: Loads | None = None,
    direction: Any = +1,
    worst: bool = False,
    choices: Mapping[str, Sequence[float]] | None = None,
    offsets_outside_wall: bool = False,
    starts: int = 1,
    seed: int = 0,
    nodes: int = 16,
    max_iterations: int = 300,
    progress: bool = False,
) -> Design:
    """The body that does best what is wanted, within what can be made, with proof.

    SciPy's SLSQP with exact derivatives of the solver, carried on by its trust region with Hessian products where it
    stops short. The answer is the best one nearby; `starts` looks further away.

    Args:
        manipulator: the start, with all that stays as it is.
        objective: one of `Least`, `Most`, `Even`, `Near`, a function of manipulator and equilibrium that is to be made
            small, or a list of pairs (weight, objective): each counts relative to its size at the start.
        free: what may change: names of numbers, or of profiles for all their values: "outer_radius", "length" (what
            runs along the body is stretched with it), "tendons.*.offset" (one value for all tendons).
        bounds: (lower, upper) by the same names, SI; a tenth and ten times the start unless given.
        constraints: `Limit`s. Always kept, unless they say otherwise: kappa d <= 0.99 on the inside of a bend, a
            wall of a thousandth of the radius, tendons in the wall (unless `offsets_outside_wall`).
        cases: how the body is used, if in several ways or with uncertain numbers, see `LoadCase`, `uncertain_cases`.
        base_tension, loads, direction: the same for one case, as in `solve`.
        worst: make the worst case good, and not the weighted mean of all.
        choices: numbers that can have a few values only, by name: every combination is designed.
        offsets_outside_wall: allow tendons in the bore or outside the body.
        starts: how many points within the bounds are tried; from the best four, and from the start, is searched.
        seed: of these points.
        nodes: of the solver.
        max_iterations: of each search.
        progress: show it on standard error.

    Returns:
        A `Design`; look at `success`. Where no body keeps to all limits it says so, with those that are `blocking`.

    Raises:
        InputError: for what is unknown or contradictory, by name; also where the start itself has no equilibrium.
    """
    used = _cases(cases, base_tension, loads, direction)
    terms = _terms(objective)
    combinations = _combinations(manipulator, choices or {}, free)
    with _progress(progress) as watch:
        found = []
        for chosen in combinations:
            body = Case(manipulator, None, None, None).with_numbers(chosen).manipulator
            case = Case(body, used[0].base_tension, used[0].loads, used[0].direction)
            problem, implied = _problem(
                body, space_of(case, free, bounds or {}), used, terms, constraints, offsets_outside_wall, worst, nodes
            )
            search = Search(problem, max_iterations, watch)
            found.append((chosen, implied, search, search.from_starts(starts, seed)))
        outcomes = [outcome for *_, outcome in found]
        best = min(range(len(found)), key=lambda i: outcomes[i].rank)
        chosen, implied, search, outcome = found[best]
        tried = tuple((each, outcome.value) for (each, *_), outcome in zip(found, outcomes, strict=True))
        return _answer(manipulator, search, outcome, implied, tried if choices else (), chosen)


# --- what is asked -------------------------------------------------------------------------------


def _cases(cases: Any, base_tension: Any, loads: Any, direction: Any) -> tuple[LoadCase, ...]:
    if (cases is None) == (base_tension is None):
        raise InputError("design: give base_tension for one load case, or cases for several")
    if cases is None:
        return (LoadCase(base_tension, loads, direction),)
    found = (cases,) if isinstance(cases, LoadCase) else tuple(cases)
    if not found or not all(isinstance(case, LoadCase) for case in found):
        raise InputError("design: cases must be one LoadCase or more, as in [LoadCase(base_tension=50.0)]")
    return found


def _terms(objective: Any) -> list[tuple[float, Objective]]:
    pairs = objective if isinstance(objective, list | tuple) else [(1.0, objective)]
    found = []
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"design: several objectives are a list of pairs (weight, objective), got {pair!r}")
        weight, aim = pair
        if not isinstance(aim, Objective):
            if not callable(aim) or isinstance(aim, type):
                raise InputError(f'design: the objective must be one such as Least("mass") or a function, got {aim!r}')
            aim = Least(aim)
        if not (np.isfinite(float(weight)) and float(weight) > 0):
            raise InputError(f"design: the weight of {aim} must be above 0, got {weight!r}")
        found.append((float(weight), aim))
    if not found:
        raise InputError("design: give an objective")
    return found


def _combinations(body: Manipulator, choices: Mapping[str, Sequence[float]], free: Sequence[str]) -> list[dict]:
    case = Case(body, None, None, None)
    for name, values in choices.items():
        case.number(name)
        if name in free:
            raise InputError(f"design: {name!r} is free and has choices; leave one out")
        if np.ndim(values) != 1 or len(values) == 0:
            raise InputError(f"design: the choices of {name!r} must be a list of numbers, got {values!r}")
    return [
        dict(zip(choices, map(float, numbers), strict=True))
        for numbers in product(*(choices[name] for name in choices))
    ]


def _problem(
    body: Manipulator,
    space: Any,
    cases: tuple[LoadCase, ...],
    terms: list[tuple[float, Objective]],
    limits: Sequence[Limit],
    outside: bool,
    worst: bool,
    nodes: int,
) -> tuple[Problem, tuple[bool, ...]]:
    """The problem with sizes taken from the start, and which limits are implied."""
    if not all(isinstance(limit, Limit) for limit in limits):
        raise InputError('design: constraints must be a list of limits, as in [Limit("wall_thickness", least=2e-3)]')
    _check_weight(body, [name_of(part.quantity) for part in (*limits, *(aim for _, aim in terms))])
    _check_overlap(space, cases)
    everything = [*limits, *_implied(body, limits, outside)]
    stations = _stations(body)
    start = Problem(body, space, cases, (), (), jnp.asarray(stations), worst, nodes)
    alone = View(body, jnp.asarray(stations) * float(body.length))
    views = [start.view(space.scaled(space.start), case) for case in cases]
    for case, view in zip(cases, views, strict=True):
        _demand_start(view, case)
    sized = tuple(
        limit if limit.scale is not None else replace(limit, scale=limit.size(views[0] if limit.bent else alone))
        for limit in everything
    )
    weighed = []
    for weight, aim in terms:
        sizes = [np.max(np.abs(np.asarray(aim.values(view)))) for view in (views if aim.bent else [alone])]
        weighed.append(Term(aim, jnp.asarray(weight), jnp.asarray(float(np.max(sizes)) or 1.0)))
    problem = replace(start, terms=tuple(weighed), limits=jax.tree.map(jnp.asarray, sized))
    return problem, tuple(i >= len(limits) for i in range(len(everything)))


def _implied(body: Manipulator, limits: Sequence[Limit], outside: bool) -> list[Limit]:
    """What no body can do without, unless the user has a limit of the same."""
    thinnest = THINNEST * float(np.max(np.asarray(body.outer_radius(jnp.asarray([0.0, float(body.length)])))))
    own = {name_of(limit.quantity) for limit in limits}
    always = [Limit("crossing", most=CROSSING), Limit("wall_thickness", least=thinnest)]
    always += [] if outside else [Limit("clearance", least=0.0)]
    return [limit for limit in always if name_of(limit.quantity) not in own]


def _stations(body: Manipulator) -> np.ndarray:
    """Over the length: even ones, both sides of each joint, and those that will wander."""
    joints = np.asarray(body.breakpoints, float) / float(body.length)
    joints = joints[(joints > 0) & (joints < 1)]
    wandering = (np.arange(WANDERING) + 0.5) / WANDERING
    return np.concatenate([np.linspace(0.0, 1.0, STATIONS), joints - 1e-9, joints + 1e-9, wandering])


def _check_weight(body: Manipulator, names: Sequence[str]) -> None:
    if "mass" in names and not float(np.asarray(body.density)) > 0:
        raise InputError('design: the body has no mass, since its density is 0; give it one, or take "volume"')


def _check_overlap(space: Any, cases: tuple[LoadCase, ...]) -> None:
    free = {name for names in space.names for name in names}
    for case in cases:
        for name in case.numbers:
            if name in free:
                raise InputError(f"design: {name!r} is free, and load case {case.name or '1'} sets it; leave one out")


def _demand_start(view: View, case: LoadCase) -> None:
    if int(view.equilibrium.result._value) not in USABLE:
        said = RESULTS[view.equilibrium.result]
        raise InputError(f"design: the start has no equilibrium in {case.name or 'its load case'}: {said}")


# --- the answer ----------------------------------------------------------------------------------


def _answer(
    start: Manipulator, search: Search, outcome: Outcome, implied: tuple[bool, ...], tried: tuple, chosen: dict
) -> Design:
    problem, local = outcome.program.problem, outcome.local
    z_start = problem.space.scaled(problem.space.start)
    z = local.point.x[: len(problem.space.names)]
    unit = results.unit_of_objective(problem)
    objectives = results.achieved(problem, search.program.evaluation(search.with_heights(z_start)), outcome.evaluation)
    reports = results.limit_reports(problem, local, implied, unit)
    equilibria = tuple(jax.tree.map(lambda x: x, problem.view(z, case).equilibrium) for case in problem.cases)
    names = [case.name for case in problem.cases]
    result = results.words(local, outcome.violation)
    body = problem.body(z)
    return Design(
        manipulator=jax.tree.map(np.asarray, body),
        start=start,
        success=result == "successful",
        feasible=outcome.feasible,
        result=result,
        objective=objectives[0].end if len(objectives) == 1 else local.point.objective,
        objectives=objectives,
        free=results.free_numbers(problem, local, unit),
        limits=reports,
        blocking=outcome.blocking,
        optimality=local.optimality.residual,
        violation=outcome.violation,
        sensitivity=results.sensitivities(problem, local, unit) if outcome.feasible else {},
        history=tuple(outcome.history),
        evaluations=outcome.evaluations,
        starts=outcome.starts,
        choices=tried,
        chosen=chosen,
        cases=problem.cases,
        equilibria=equilibria,
        equilibria_at_start=tuple(problem.view(z_start, case).equilibrium for case in problem.cases),
        remarks=tuple(results.remarks_on(equilibria, names)),
    )


@contextmanager
def _progress(shown: bool) -> Iterator[Watch]:
    """A line on standard error; what it yields is told what to say."""
    if not shown:
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status("compiling") as status:
        yield status.update
