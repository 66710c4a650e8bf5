"""`design`: the body that meets an objective best within its limits."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError, within
from ..numerics.given_numbers import check_whole
from ..quantities import check_range_in_space
from ..robot.manipulator import Manipulator
from ..robot.validation import check_loads
from ..statics.arguments import check_targets, split_actuation
from ..statics.equilibrium import Equilibrium
from ..statics.status import words_of
from ..units import quantity
from .free_numbers import Bounds, FreeNumbers, free_numbers_of
from .load_cases import LoadCase
from .objectives import Least, Limit, Objective
from .problem import USABLE, DesignProblem, Kept, Term
from .results import Design, design_of
from .search import WANDERING, search_designs, search_starts

STATIONS = 33  # evenly spaced places at which limits along the body are evaluated
CROSSING = 0.99  # largest kappa d; at 1 fibres cross
THINNEST = 1e-3  # of the outer radius at the start: the least wall thickness
Part = TypeVar("Part", Term, Kept)
Aim = Objective | Callable[[Manipulator, Equilibrium], ArrayLike]


def design(
    manipulator: Manipulator,
    objective: Aim | Sequence[tuple[float, Aim]],
    free: Sequence[str],
    bounds: Bounds | None = None,
    constraints: Limit | Sequence[Limit] = (),
    *,
    cases: LoadCase | Sequence[LoadCase],
    starts: int = 1,
    nodes: int = 16,
    worst: bool = False,
    offsets_outside_wall: bool = False,
) -> Design:
    """The body that meets an objective best within its limits, with first-order optimality as proof.

    The method is SciPy's SLSQP with exact derivatives of the solver; if it stops short, it starts again from there. The
    answer is the best body nearby; `starts` searches further away.

    Args:
        manipulator: the start, with all numbers that do not change.
        objective: one of `Least`, `Most`, `Even`, `Near`, a function of manipulator and equilibrium to be made small,
            or a list of pairs (weight, objective), each of which counts relative to its size at the start.
        free: what may change: names of numbers, or of profiles for all their values: "outer_radius", "length" (with it
            everything along the body is stretched), "tendons.*.offset" (one value for all tendons), "tendons.0.angle"
            (rad, of a tendon that has one), "tendons.*.angle.winding" (how far all angles grow from base to tip).
        bounds: (lower, upper) by the same names, SI; unless given a tenth of the start value and ten times it, for an
            angle half a turn either way.
        constraints: `Limit`s. These are always kept, unless you limit the same quantity: kappa d <= 0.99 on the inside
            of a bend, a wall of a thousandth of the radius, tendons in the wall.
        cases: how the body is used: one `LoadCase`, or several; see also `uncertain_cases`.
        starts: number of points within the bounds that are tried; searches begin at the best four and at the start.
        nodes: of the solver.
        worst: optimise the worst load case, not the weighted mean of all.
        offsets_outside_wall: allow tendons in the bore or outside the body.

    Returns:
        A `Design`; look at `success`. If no body keeps all limits, `blocking` names those that contradict each other.

    Raises:
        InputError: for unknown names and contradictions, and where the start itself has no equilibrium.
    """
    check_whole("design: starts", starts, 1)
    how = {"nodes": nodes, "worst": worst, "offsets_outside_wall": offsets_outside_wall}
    problem = problem_of(manipulator, weighted(objective), free, bounds or {}, constraints, cases, **how)
    return design_of(search_designs(problem, search_starts(problem, starts)), manipulator)


def weighted(objective: Aim | Sequence[tuple[float, Aim]]) -> list[tuple[float, Objective]]:
    """The argument `objective` of `design` as pairs of weight and objective."""
    found = []
    for pair in objective if isinstance(objective, list | tuple) else [(1.0, objective)]:
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise InputError(f"design: several objectives are a list of pairs (weight, objective), got {pair!r}")
        weight, aim = quantity(pair[0], "dimensionless", "design: a weight"), pair[1]
        if not isinstance(aim, Objective):
            if not callable(aim) or isinstance(aim, type):
                raise InputError(f'design: the objective must be one such as Least("mass") or a function, got {aim!r}')
            aim = Least(aim)  # pyright: ignore[reportArgumentType]  # a callable: a function of body and equilibrium
        if not weight > 0:
            raise InputError(f"design: the weight of {aim} must be above 0, got {weight:g}")
        found.append((weight, aim))
    if not found:
        raise InputError("design: give an objective")
    return found


# --- the problem, checked ----------------------------------------------------------------------------


def problem_of(
    manipulator: Manipulator,
    objectives: Sequence[tuple[float, Objective]],
    free: Sequence[str],
    bounds: Bounds,
    constraints: Limit | Sequence[Limit],
    cases: LoadCase | Sequence[LoadCase],
    *,
    nodes: int,
    worst: bool,
    offsets_outside_wall: bool,
) -> DesignProblem:
    """The problem of `design`, checked, with sizes taken from the start."""
    check_whole("design: nodes", nodes, 4)
    for name, value in (("worst", worst), ("offsets_outside_wall", offsets_outside_wall)):
        if not isinstance(value, bool):
            raise InputError(f"design: {name} must be true or false, got {value!r}")
    if jnp.result_type(float) != jnp.float64:
        raise InputError(
            'design: needs double precision; jax.config.update("jax_enable_x64", True) before anything else'
        )
    constraints = [constraints] if isinstance(constraints, Limit) else constraints
    if not isinstance(constraints, list | tuple) or not all(isinstance(limit, Limit) for limit in constraints):
        raise InputError('design: constraints must be a list of limits, as in [Limit("wall_thickness", least=2e-3)]')
    used = (cases,) if isinstance(cases, LoadCase) else tuple(cases) if isinstance(cases, list | tuple) else ()
    if not used or not all(isinstance(case, LoadCase) for case in used):
        raise InputError("design: cases must be one LoadCase or more, as in cases=LoadCase(50.0)")
    if any(case.of(manipulator).in_space for case in used):
        manipulator = manipulator.with_angles()
    numbers = free_numbers_of(used[0].of(manipulator), free, bounds)
    _check(manipulator, [*constraints, *(aim for _, aim in objectives)], numbers, used)
    limits, one = [*constraints, *_implied(manipulator, constraints, offsets_outside_wall)], jnp.ones(())
    problem = DesignProblem(
        manipulator,
        numbers,
        used,
        terms=tuple(Term(aim, jnp.asarray(weight, float), one) for weight, aim in objectives),
        limits=tuple(Kept(jax.tree.map(jnp.asarray, limit), one) for limit in limits),
        stations=jnp.asarray(_stations(manipulator)),
        worst=worst,
        nodes=nodes,
    )
    return _sized(problem)


def _sized(problem: DesignProblem) -> DesignProblem:
    """The problem with objectives and limits relative to their sizes, at a start which must have an equilibrium.

    The size of a limit is that of its largest bound, or for a limit of zero that of the quantity at the start.
    """
    found = problem.evaluation(problem.free.scaled_start)
    for case, code in zip(problem.cases, np.asarray(found.codes), strict=True):
        if code not in USABLE:
            said = words_of(code)
            raise InputError(f"design: the start has no equilibrium in {case.name or 'its load case'}: {said}")
    parts = [*(term.objective for term in problem.terms), *(kept.limit for kept in problem.limits)]
    for part, values in zip(parts, (*found.aims, *found.margins), strict=True):
        if not np.all(np.isfinite(values)):
            name = str(part)
            raise InputError(f"design: {name!r} has no finite value for the start; look at its places and its formula")

    def sized(part: Part, values: ArrayLike, bounds: Iterable[ArrayLike] = ()) -> Part:
        stated = max((float(np.abs(bound)) for bound in bounds), default=0.0)
        size = stated or float(np.max(np.abs(values))) or 1.0
        return replace(part, size=jnp.asarray(size, float))

    terms = [sized(term, aim) for term, aim in zip(problem.terms, found.aims, strict=True)]
    margins = zip(problem.limits, found.margins, strict=True)
    limits = [sized(kept, margin, kept.limit.sides.values()) for kept, margin in margins]
    return replace(problem, terms=tuple(terms), limits=tuple(limits))


def _implied(body: Manipulator, limits: Sequence[Limit], offsets_outside_wall: bool) -> list[Limit]:
    """The limits that every body must keep, unless the user limits the same quantity."""
    own = {limit.name for limit in limits}
    always = [Limit("crossing", most=CROSSING)]
    if body.outer_radius is not None:
        thinnest = THINNEST * float(np.max(np.asarray(body.outer_radius(jnp.asarray([0.0, float(body.length)])))))
        always.append(Limit("wall_thickness", least=thinnest))
        always += [] if offsets_outside_wall else [Limit("clearance", least=0.0)]
    return [limit for limit in always if limit.name not in own]


def _stations(body: Manipulator) -> np.ndarray:
    """Places over the length: evenly spaced ones, both sides of each joint, and those that a search moves."""
    joints = np.asarray(body.breakpoints, float) / float(body.length)
    joints = joints[(joints > 0) & (joints < 1)]
    wandering = (np.arange(WANDERING) + 0.5) / WANDERING
    return np.concatenate([np.linspace(0.0, 1.0, STATIONS), joints - 1e-9, joints + 1e-9, wandering])


def _check(
    body: Manipulator, parts: Sequence[Limit | Objective], numbers: FreeNumbers, cases: Sequence[LoadCase]
) -> None:
    """Refuse what the body lacks, places that are not on it, and free numbers that a case sets."""
    length, free = float(np.asarray(body.length)), {name for names in numbers.names for name in names}
    for part in parts:
        if why := part.known.unknown.get(body.components):
            raise InputError(f"design: {part.name!r} {why}")
        if part.name == "strain" and body.extensible:
            raise InputError("design: 'strain' is not known along an axis that stretches; take 'bending'")
        if part.name == "mass" and not body.has_mass:
            raise InputError('design: the body has no mass, since its density is 0; give it one, or take "volume"')
        for side in ("value", "least", "most", "equal") if body.in_space else ():
            if getattr(part, side, None) is not None:
                check_range_in_space(f"design: {part}", part.name, getattr(part, side))
        at = getattr(part, "at", None)
        if at is not None and (np.min(at) < 0 or np.max(at) > length * (1 + 1e-9)):
            raise InputError(
                f"design: {part} is compared at {np.max(at):g} m, beyond the tip at {length:g} m; change at"
            )
    for case in cases:
        for name in case.numbers:
            if name in free:
                raise InputError(f"design: {name!r} is free, and {case.name or 'the load case'} sets it; leave one out")
        with within(f"design: {case.name or 'the load case'}", ValueError):
            check_targets(body, split_actuation(body, case.base_tension)[1])
        check_loads(case.body(body), case.loads)
