"""What a design is asked, checked and put together as a problem."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .case import Case
from .design_problem import Cap, Evaluation, Problem, Term
from .design_program import USABLE, Program
from .design_search import WANDERING
from .design_space import space_of
from .equilibrium import RESULTS, result_of
from .errors import InputError
from .limits import Limit, number_of
from .load_cases import LoadCase
from .loads import Loads
from .manipulator import Manipulator
from .objectives import Least, Objective
from .quantities import OF_RADII, name_of
from .validation import check_weight

STATIONS = 33  # at which limits along the body are looked at, evenly
CROSSING = 0.99  # kappa d at most, short of 1 where fibres cross
FAR = 1e3  # times the size of an objective, a level that holds nothing back
THINNEST = 1e-3  # of the outer radius at the start, the wall that is always kept

Weighted = Sequence[tuple[float, Objective]]


class Asked(NamedTuple):
    """A problem, and which of its limits nobody asked for."""

    problem: Problem
    implied: tuple[bool, ...]

    def over_the_sizes_of(self, other: "Asked") -> "Asked":
        """The same with every objective over its size at the start of another problem."""
        pairs = zip(self.problem.terms, other.problem.terms, strict=True)
        terms = tuple(replace(own, reference=term.reference) for own, term in pairs)
        return self._replace(problem=replace(self.problem, terms=terms))


def ask(
    manipulator: Manipulator,
    objectives: Weighted,
    free: Sequence[str],
    bounds: Mapping[str, tuple[Any, Any]] | None,
    constraints: Sequence[Limit],
    *,
    cases: LoadCase | Sequence[LoadCase] | None = None,
    base_tension: Any = None,
    loads: Loads | None = None,
    direction: Any = None,
    worst: bool = False,
    offsets_outside_wall: bool = False,
    nodes: int = 16,
    capped: bool = False,
) -> Asked:
    """The problem of `design`, with sizes taken from the start.

    Args:
        objectives: pairs of weight and objective.
        capped: whether every objective also gets a level that it may not exceed, far away at first.

    The others are as in `design`.

    Raises:
        InputError: for what is unknown or contradictory, and for a start without equilibrium.
    """
    constraints = [constraints] if isinstance(constraints, Limit) else constraints
    if not isinstance(constraints, list | tuple) or not all(isinstance(limit, Limit) for limit in constraints):
        raise InputError('design: constraints must be a list of limits, as in [Limit("wall_thickness", least=2e-3)]')
    used = _cases(cases, base_tension, loads, direction)
    start_case = Case(manipulator, used[0].base_tension, used[0].loads, used[0].direction)
    space = space_of(start_case, free, bounds or {})
    _check_body(manipulator, [name_of(part.quantity) for part in (*constraints, *(aim for _, aim in objectives))])
    _check_overlap(space, used)
    for case in used:
        check_weight(case.body(manipulator), case.loads)
    _check_places(manipulator, [aim for _, aim in objectives])
    limits = [*constraints, *_implied(manipulator, constraints, offsets_outside_wall)]
    one = jnp.ones(())
    terms = tuple(Term(aim, jnp.asarray(weight, float), one) for weight, aim in objectives)
    caps = tuple(Cap(aim, one, one) for _, aim in objectives) if capped else ()
    unsized = tuple(jax.tree.map(jnp.asarray, replace(limit, scale=one)) for limit in limits)
    stations = jnp.asarray(_stations(manipulator))
    problem = _sized(Problem(manipulator, space, used, terms, caps, unsized, stations, worst, nodes), limits)
    return Asked(problem, tuple(i >= len(constraints) for i in range(len(limits))))


def _sized(problem: Problem, limits: Sequence[Limit]) -> Problem:
    """The problem with objectives and limits over their sizes at the start, which must have an equilibrium."""
    space = problem.space
    found = Program(problem).evaluation(np.append(space.scaled(space.start), np.zeros(len(problem.peaks))))
    _demand_start(problem, found, limits)
    sizes = [jnp.asarray(float(np.max(np.abs(aim))) or 1.0, float) for aim in found.aims]
    terms = [replace(term, reference=size) for term, size in zip(problem.terms, sizes, strict=True)]
    caps = [replace(cap, most=FAR * size, reference=size) for cap, size in zip(problem.caps, sizes, strict=False)]
    margins = [float(np.max(np.abs(margin), initial=0.0)) for margin in found.margins]
    scales = [jnp.asarray(limit.size(margin), float) for limit, margin in zip(limits, margins, strict=True)]
    scaled = [replace(limit, scale=scale) for limit, scale in zip(problem.limits, scales, strict=True)]
    return replace(problem, terms=tuple(terms), caps=tuple(caps), limits=tuple(scaled))


def weighted(objective: Any) -> list[tuple[float, Objective]]:
    """The argument `objective` of `design` as pairs of weight and objective.

    Raises:
        InputError: for what is none.
    """
    pairs = objective if isinstance(objective, list | tuple) else [(1.0, objective)]
    found = []
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"design: several objectives are a list of pairs (weight, objective), got {pair!r}")
        weight, aim = number_of(pair[0], "design: a weight"), pair[1]
        if not isinstance(aim, Objective):
            if not callable(aim) or isinstance(aim, type):
                raise InputError(f'design: the objective must be one such as Least("mass") or a function, got {aim!r}')
            aim = Least(aim)
        if not weight > 0:
            raise InputError(f"design: the weight of {aim} must be above 0, got {weight:g}")
        found.append((weight, aim))
    if not found:
        raise InputError("design: give an objective")
    return found


def _cases(cases: Any, base_tension: Any, loads: Any, direction: Any) -> tuple[LoadCase, ...]:
    if (cases is None) == (base_tension is None):
        raise InputError("design: give base_tension for one load case, or cases for several")
    if cases is None:
        return (LoadCase(base_tension, loads, direction),)
    found = (cases,) if isinstance(cases, LoadCase) else tuple(cases)
    if not found or not all(isinstance(case, LoadCase) for case in found):
        raise InputError("design: cases must be one LoadCase or more, as in [LoadCase(base_tension=50.0)]")
    return found


def _implied(body: Manipulator, limits: Sequence[Limit], outside: bool) -> list[Limit]:
    """What no body can do without, unless the user has a limit of the same."""
    own = {name_of(limit.quantity) for limit in limits}
    always = [Limit("crossing", most=CROSSING)]
    if body.outer_radius is not None:
        thinnest = THINNEST * float(np.max(np.asarray(body.outer_radius(jnp.asarray([0.0, float(body.length)])))))
        always += [Limit("wall_thickness", least=thinnest), *([] if outside else [Limit("clearance", least=0.0)])]
    return [limit for limit in always if name_of(limit.quantity) not in own]


def _stations(body: Manipulator) -> np.ndarray:
    """Over the length: even ones, both sides of each joint, and those that will wander."""
    joints = np.asarray(body.breakpoints, float) / float(body.length)
    joints = joints[(joints > 0) & (joints < 1)]
    wandering = (np.arange(WANDERING) + 0.5) / WANDERING
    return np.concatenate([np.linspace(0.0, 1.0, STATIONS), joints - 1e-9, joints + 1e-9, wandering])


def _check_body(body: Manipulator, names: Sequence[str]) -> None:
    if "mass" in names and not body.has_mass:
        raise InputError('design: the body has no mass, since its density is 0; give it one, or take "volume"')
    of_radii = [name for name in names if name in OF_RADII]
    if of_radii and not body.has_radii:
        raise InputError(f"design: {of_radii[0]!r} needs radii; give the body outer_radius and inner_radius")


def _check_places(body: Manipulator, aims: Sequence[Objective]) -> None:
    """Places along the body that are compared lie on it."""
    length = float(np.asarray(body.length))
    for aim in aims:
        at = getattr(aim, "at", None)
        if at is not None and (np.min(at) < 0 or np.max(at) > length * (1 + 1e-9)):
            raise InputError(f"design: {aim} is compared at {np.max(at):g} m, off a body of {length:g} m; change at")


def _check_overlap(space: Any, cases: tuple[LoadCase, ...]) -> None:
    free = {name for names in space.names for name in names}
    for case in cases:
        for name in case.numbers:
            if name in free:
                raise InputError(f"design: {name!r} is free, and {case.name or 'the load case'} sets it; leave one out")


def _demand_start(problem: Problem, found: Evaluation, limits: Sequence[Limit]) -> None:
    for case, code in zip(problem.cases, np.asarray(found.codes), strict=False):
        if code not in USABLE:
            said = RESULTS[result_of(code)]
            raise InputError(f"design: the start has no equilibrium in {case.name or 'its load case'}: {said}")
    named = [(str(term.objective), aim) for term, aim in zip(problem.terms, found.aims, strict=True)]
    named += [(str(limit), margin) for limit, margin in zip(limits, found.margins, strict=True)]
    named += [(str(limit), zero) for limit, zero in zip(limits, found.zeros, strict=True)]
    for name, values in named:
        if not np.all(np.isfinite(values)):
            raise InputError(f"design: {name!r} has no finite value for the start; look at its places and its formula")
