"""`design`: the body that does best what is wanted, within what can be made."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np

from .case import Case
from .design_results import Design, answered, told
from .design_search import Search, Watch
from .design_setup import ask, weighted
from .errors import InputError
from .limits import Limit, number_of
from .load_cases import LoadCase
from .loads import Loads
from .manipulator import Manipulator


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
    direction: Any = None,
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
    for name, count in (("starts", starts), ("max_iterations", max_iterations)):
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise InputError(f"design: {name} must be a whole number of 1 or more, got {count!r}")
    aims = weighted(objective)
    found = []
    with progress_shown(progress) as watch:
        for chosen in _combinations(manipulator, choices or {}, free):
            numbers = {name: np.asarray(number) for name, number in chosen.items()}
            body = Case(manipulator, None, None, None).with_numbers(numbers).manipulator
            asked = ask(
                body,
                aims,
                free,
                bounds,
                constraints,
                cases=cases,
                base_tension=base_tension,
                loads=loads,
                direction=direction,
                worst=worst,
                offsets_outside_wall=offsets_outside_wall,
                nodes=nodes,
            )
            if found:  # one scale for all, so that they can be compared
                asked = asked.over_the_sizes_of(found[0][1])
            search = Search(asked.problem, max_iterations, watch)
            found.append((chosen, asked, search.from_starts(starts, seed)))
    chosen, asked, outcome = min(found, key=lambda each: each[2].rank)
    tried = tuple((each, told(asked.problem, outcome.value)) for each, _, outcome in found) if choices else ()
    return answered(asked, outcome, manipulator, tried, chosen)


def _combinations(body: Manipulator, choices: Mapping[str, Sequence[float]], free: Sequence[str]) -> list[dict]:
    case = Case(body, None, None, None)
    for name, values in choices.items():
        case.number(name)
        if name in free:
            raise InputError(f"design: {name!r} is free and has choices; leave one out")
        if not isinstance(values, list | tuple | np.ndarray) or len(values) == 0:
            raise InputError(f"design: the choices of {name!r} must be a list of numbers, got {values!r}")
    lists = [[number_of(value, f"design: a choice of {name!r}") for value in choices[name]] for name in choices]
    return [dict(zip(choices, numbers, strict=True)) for numbers in product(*lists)]


@contextmanager
def progress_shown(shown: bool) -> Iterator[Watch]:
    """A line on standard error; what it yields is told what to say."""
    if not shown:
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status("compiling") as status:
        yield status.update
