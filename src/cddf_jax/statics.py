"""`solve`: static equilibrium of one manipulator under one load."""

from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from .balance import Balance, Setup, equilibrate, inside_of_bend
from .directions import is_contradicted, not_stated, stated_directions
from .equilibrium import RESULTS, Dense, Equilibrium, Fields, Result, SolveError, fields_at, nan_unless, tendons_first
from .friction import unspent
from .loads import Loads
from .manipulator import Manipulator
from .problem import Method, Path, Problem, guarded_section, line_up
from .quadrature import panels
from .reductions import largest
from .solver import ACCURACY, FixedPoint, truncation_error
from .targets import CurvatureAt, Displacement, Target, TipAngle, TipStiffness
from .tendon_travel import tendon_displacement
from .tension_search import Found, reach
from .validation import check_weight, describe_crossing

PerTendon = Float[Array, " tendons"]


def solve(
    manipulator: Manipulator,
    base_tension: Any,
    loads: Loads | None = None,
    *,
    direction: Any = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
    throw: bool = True,
) -> Equilibrium:
    """Shape, tension and friction of a manipulator whose tendons are pulled at the base.

    Works under jit, vmap, grad, scan and shard_map; batching is the caller's `jax.vmap`.

    Args:
        manipulator: the body and its tendons.
        base_tension: T_base >= 0, N, a number for all tendons or one per tendon. In place of a number may stand
            what is to be reached, and its tension is found: `Displacement`, `TipAngle`, `TipTension`,
            `CurvatureAt`, `TotalTension`, `TipStiffness`; as many targets as unknown tensions.
        loads: dead loads on the tip and gravity; None for none.
        direction: +1 for a tendon that slides in at the base (pulled, as in the paper), -1 for one that
            slides out; a number, or one per tendon. None, for all or in the place of one tendon, for the direction
            of its travel: the length pulled in since the straight body, under loads the rate of that while all
            tensions rise in proportion. A single tendon has +1. Derivatives hold the directions that were found.
        method: `FixedPoint()`, `Marching()` or, without loads, `LiteralIteration()`.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static. The default is accurate to
            1e-8 of the tip tension and 1e-7 of the length.
        throw: raise where the values are known and the solve failed. Where they are traced, under jit or
            vmap, nothing is raised; look at `result`.

    Where loads leave several equilibria, it is the one on the path along which the tensions act first and then
    all loads grow together from 0 to 1. `num_load_steps` counts the steps, `stable` judges the end, and where the
    path ends early (`load_limit`) `load_fraction` says where.

    A lane that fails has NaN for its numbers and 0 for its derivatives, so that it spoils no sum over a batch.
    Some failures keep their numbers: `crossing`, where the model has left its range, `inaccurate` and `unstable`;
    and `slack`, `unreachable` and `undetermined`, whose numbers are those of the nearest tensions, with the
    `target_miss` that is left, and whose derivatives are taken at these tensions.
    Derivatives are one-sided where the curvature is zero along a stretch of the body (no tension and no load, or
    antagonists that cancel): friction acts on |kappa|, whose slope there is taken as that of kappa > 0. Isolated
    changes of sign are located and are harmless to derivatives of any order.
    A tendon that slides in and whose tension drag has used up is slack from there on: it has no tension and no
    friction, and follows the body. Its tip tension is 0, and so are the derivatives of that.
    Of the body only what makes the numbers meaningless is checked here (finite, a stiffness, friction, drag and
    offsets not negative); walls, anchors, knots and jumps are the business of `manipulator.validate()`.

    Raises:
        SolveError: with `throw`, when the result is neither successful nor `direction_contradicted`.
        ValueError: for a wrong number of tensions, directions or components of a load, nodes below 4, or gravity on
            a body that is known to have no mass.
        TypeError: for a manipulator, tensions, a method or loads that are none.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"solve: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    check_nodes(nodes)
    if not isinstance(method, FixedPoint | Method) or isinstance(method, type):  # the default is told at once
        raise TypeError(f"solve: method must be one such as FixedPoint() or Marching(), got {method!r}")
    given, targets = _split_actuation(manipulator, base_tension)
    given, direction = per_tendon(manipulator, given, direction)
    loads = _checked(loads)
    if loads is None and any(isinstance(target, TipStiffness) for target in targets):
        loads = Loads()
    check_weight(manipulator, loads)
    equilibrium = _solve(manipulator, given, targets, loads, direction, method, nodes)
    if throw:
        _raise_if_failed(equilibrium, targets)
    return equilibrium


def check_nodes(nodes: Any) -> None:
    """Refuse a number of nodes that is none.

    Raises:
        ValueError: unless it is a whole number of 4 or more.
    """
    if isinstance(nodes, bool) or not isinstance(nodes, int) or nodes < 4:
        raise ValueError(f"nodes must be a whole number of 4 or more, got {nodes!r}")


def _split_actuation(manipulator: Manipulator, actuation: Any) -> tuple[Any, tuple[Target | None, ...]]:
    """The tensions that are given, zero in the place of targets, and the targets, None in the place of tensions."""
    count = manipulator.num_tendons
    entries = actuation if isinstance(actuation, tuple | list) else [actuation]
    if texts := [entry for entry in entries if isinstance(entry, str)]:
        raise TypeError(f"solve: base_tension must hold numbers, N, or targets, got the text {texts[0]!r}")
    if not any(_is_target(entry) for entry in entries):
        return actuation, (None,) * count
    if len(entries) != count:
        raise ValueError(
            f"solve: with a target, base_tension must hold one tension or target per tendon ({count}), "
            f"got {len(entries)}"
        )
    return [0.0 if _is_target(x) else x for x in entries], tuple(x if _is_target(x) else None for x in entries)


def _is_target(entry: Any) -> bool:
    if isinstance(entry, float | int | np.ndarray | jax.Array):  # asking a protocol takes 10 us
        return False
    if isinstance(entry, type) and hasattr(entry, "reading"):
        raise TypeError(f"solve: {entry.__name__} needs a value, as in {entry.__name__}(...)")
    return isinstance(entry, Target)


def _checked(loads: Any) -> Loads | None:
    if loads is None:
        return None
    if not isinstance(loads, Loads):
        raise TypeError(f"solve: loads must be a Loads, as in Loads(tip_force=(0.0, -1.0)), got {loads!r}")
    shapes = {"tip_force": (2,), "tip_moment": (), "gravity": (2,)}
    for name, shape in shapes.items():
        found = np.shape(getattr(loads, name))
        if found != shape:
            raise ValueError(f"solve: loads.{name} must have shape {shape}, got {found}; batch with jax.vmap")
    return loads


def per_tendon(manipulator: Manipulator, base_tension: Any, direction: Any) -> tuple[Any, Any]:
    """Tensions and directions as arrays; directions as a tuple, with None in some places, where some are to be found.

    Raises:
        ValueError: when there is neither one for all nor one per tendon.
    """
    count, precision = manipulator.num_tendons, _precision(manipulator)

    def checked(name, value, shapes=((), (count,))):
        traced = any(isinstance(number, jax.Array) for number in jax.tree.leaves(value))
        value = jnp.asarray(value) if traced else np.asarray(value, dtype=precision)
        value = value.astype(value.dtype)  # a weakly typed number would be compiled for anew
        if value.shape not in shapes:
            raise ValueError(f"solve: {name} must be a number or one per tendon ({count}), got shape {value.shape}")
        return value

    try:
        direction = stated_directions(direction, count)
    except ValueError as error:
        raise ValueError(f"solve: {error}") from None
    if not_stated(direction):
        direction = tuple(None if x is None else checked("direction", x, ((),)) for x in direction)
    else:
        direction = checked("direction", direction)
    return checked("base_tension", base_tension), direction


_GOOD = tuple(int(code._value) for code in (RESULTS.successful, RESULTS.direction_contradicted))


def _raise_if_failed(equilibrium: Equilibrium, targets: tuple[Target | None, ...]) -> None:
    code = equilibrium.result
    if isinstance(code._value, Tracer) or np.ndim(code._value) > 0:
        return
    if int(code._value) in _GOOD:
        return
    raise SolveError(in_words(equilibrium) + _units_of(targets, float(equilibrium.arc_length[-1])))


def _units_of(targets: tuple[Target | None, ...], length: float) -> str:
    """The unit of a target whose size looks like another one."""
    for target in targets:
        if isinstance(target, TipAngle) and abs(float(target.value)) > 2 * np.pi:
            return f" TipAngle is in rad; {float(target.value):g} rad are {np.degrees(float(target.value)):.4g} deg."
        if isinstance(target, Displacement) and abs(float(target.value)) > length:
            return f" Displacement is in m; {float(target.value):g} m is longer than the body."
    return ""


def in_words(equilibrium: Equilibrium) -> str:
    """What there is to know of how a single solve ended; empty where all is well."""
    code = equilibrium.result
    message = RESULTS[code]
    if code == RESULTS.crossing:
        message = f"{describe_crossing(equilibrium)}. {message}"
    if code == RESULTS.load_limit:
        message = (
            f"An equilibrium was found up to {100 * float(equilibrium.load_fraction):.3g} % of the loads. {message}"
        )
    if code == RESULTS.slack or code == RESULTS.unreachable:
        missed = ", ".join(f"{miss:.4g}" for miss in np.asarray(equilibrium.target_miss))
        message = f"The nearest that can be reached misses the targets by {missed} (SI). {message}"
    return message


@partial(jax.jit, static_argnames=("method", "nodes"))
def _solve(
    manipulator: Manipulator,
    given: Any,
    targets: tuple[Target | None, ...],
    loads: Loads | None,
    direction: Any,
    method: Method,
    nodes: int,
) -> Equilibrium:
    to_find = not_stated(direction)
    asked = one_precision(manipulator, given, direction, (targets, loads))
    numbers = jax.tree.leaves(eqx.filter(asked, eqx.is_inexact_array))
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]))
    manipulator, given, direction, (targets, loads) = _harmless(*asked)
    setup = Setup(manipulator, direction, loads, method, nodes, to_find)
    balance, found = _equilibrium(setup, given, targets)
    problem, path = balance.problem, balance.path

    physical = finite & _is_physical(asked[0], asked[1], asked[2], problem) & _is_on_the_body(targets, problem)
    solved = physical & balance.load_path.converged
    at_tip = unspent(problem.base_tension, path.tip.pull) / path.tip.ratio
    contradicted = solved & is_contradicted(problem.direction, balance.travel, problem.panels.edges[-1])
    truncation = balance.leverage * truncation_error(problem, path)
    crossing = largest(inside_of_bend(problem, path)) >= 1.0
    round_off = 4 * float(jnp.finfo(truncation.dtype).eps)
    dense = Dense(manipulator, problem.base_tension, problem.direction, problem.panels, path.starts, path.nodes, solved)

    return Equilibrium(
        along=nan_unless(solved, _along(setup, balance, dense)),
        tip_position=nan_unless(solved, path.tip.position),
        tip_angle=nan_unless(solved, path.tip.heading),
        tip_tension=nan_unless(solved, at_tip),
        tension_loss=nan_unless(solved, 1.0 - _fraction_left(problem, path) / path.tip.ratio),
        tendon_displacement=nan_unless(solved, tendon_displacement(problem, path)),
        base_tension=nan_unless(solved, problem.base_tension),
        target_miss=nan_unless(solved, found.miss),
        base_moment=nan_unless(solved, problem.base_moment),
        load_fraction=balance.load_path.fraction,
        num_load_steps=balance.load_path.num_steps.astype(int),
        stable=solved & balance.load_path.stable,
        direction=problem.direction,
        direction_contradicted=contradicted,
        error_estimate=nan_unless(solved, truncation + balance.leverage * (path.residual + round_off)),
        num_iterations=path.num_iterations.astype(int),
        result=_first_of(
            (~physical, RESULTS.unphysical),
            (path.locked, RESULTS.locked),
            (~(path.converged & balance.load_path.resolved), RESULTS.not_converged),
            (~balance.load_path.converged, RESULTS.load_limit),
            (found.slack, RESULTS.slack),
            (~found.reached, RESULTS.unreachable),
            (~found.determined, RESULTS.undetermined),
            (crossing, RESULTS.crossing),
            (~balance.load_path.stable, RESULTS.unstable),
            (truncation > ACCURACY, RESULTS.inaccurate),
            (jnp.any(contradicted), RESULTS.direction_contradicted),
        ),
        _dense=dense,
    )


def _fraction_left(problem: Problem, path: Path) -> PerTendon | float:
    """What drag leaves of the base tension, over it; 1 where there is no base tension."""
    if problem.base.drag is None:
        return 1.0
    pulled = problem.base_tension > 0
    left = unspent(problem.base_tension, path.tip.pull)
    return jnp.where(pulled, left / jnp.where(pulled, problem.base_tension, 1.0), 1.0)


def _equilibrium(setup: Setup, given: PerTendon, targets: tuple[Target | None, ...]) -> tuple[Balance, Found]:
    if any(target is not None for target in targets):
        return reach(setup, given, targets)
    yes = given[0] == given[0]
    return equilibrate(setup, given), Found(jnp.zeros_like(given), yes, ~yes, yes)


def _first_of(*cases: tuple[Any, RESULTS]) -> RESULTS:
    """The result of the first case that holds."""
    result = RESULTS.successful
    for holds, code in reversed(cases):
        result = RESULTS.where(holds, code, result)
    return Result(result._value, RESULTS)  # pyright: ignore[reportCallIssue]


def _precision(*trees: Any) -> jnp.dtype:
    """The precision of the numbers of a pytree."""
    leaves = jax.tree.leaves(trees)
    if functions := [x for x in leaves if callable(x)]:
        raise TypeError(
            f"solve: {functions[0]!r} stands where a body has numbers; give the function to Manipulator, Tendon or "
            "Piecewise, or make it a static field of its profile"
        )
    kinds = {x.dtype for x in leaves if isinstance(x, jax.Array | np.ndarray | np.generic)}
    return _common_precision(frozenset(kinds), jax.dtypes.canonicalize_dtype(np.float64))


@cache
def _common_precision(kinds: frozenset, widest: Any) -> jnp.dtype:
    """Of types of numbers; JAX takes long to tell, and its widest type changes what it says."""
    floating = {jax.dtypes.canonicalize_dtype(kind) for kind in kinds if jnp.issubdtype(kind, jnp.inexact)}
    return jnp.result_type(jnp.float32, *floating)


def one_precision(
    manipulator: Manipulator, base_tension: Any, direction: Any, others: Any = None
) -> tuple[Manipulator, Array, Array, Any]:
    """Everything in the precision of the manipulator, or of a tension or load that is a JAX array if that is higher."""
    dtype = _precision(manipulator, base_tension, others)

    def cast(tree):
        arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
        return eqx.combine(jax.tree.map(lambda x: jnp.asarray(x, dtype), arrays), rest)

    def one_each(value):
        if isinstance(value, tuple):  # directions, of which some are to be found; they get the stand-in +1
            value = jnp.stack([jnp.asarray(1.0 if x is None else x, dtype) for x in value])
        return jnp.broadcast_to(jnp.asarray(value, dtype), (manipulator.num_tendons,))

    return cast(manipulator), one_each(base_tension), one_each(direction), cast(others)


def _harmless(
    manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, others: Any
) -> tuple[Manipulator, Array, Array, Any]:
    """Stand-ins for numbers that would spoil, through 0 * NaN, the derivatives of neighbours in a batch."""

    def finite(tree, stand_in):
        arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
        return eqx.combine(jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, stand_in), arrays), rest)

    tension = jnp.where(jnp.isfinite(base_tension) & (base_tension >= 0), base_tension, 0.0)
    direction = jnp.where(jnp.abs(direction) == 1, direction, 1.0)
    return finite(manipulator, 1.0), tension, direction, finite(others, 0.0)


def _is_physical(manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, problem: Problem):
    stiffness = jax.vmap(jax.vmap(problem.manipulator.stiffness))(problem.panels.nodes)
    return (
        jnp.all(stiffness > 0)
        & (problem.panels.edges[-1] > 0)
        & jnp.all(manipulator.tendon_friction >= 0)
        & (True if manipulator.tendon_drag is None else jnp.all(manipulator.tendon_drag >= 0))
        & _has_physical_masses(manipulator, problem)
        & jnp.all(jnp.isfinite(manipulator.tendon_compliance) & (manipulator.tendon_compliance >= 0))
        & jnp.all(manipulator.tendon_free_length >= 0)
        & jnp.all((problem.nodes.offset >= 0) | ~problem.nodes.present)
        & jnp.all(base_tension >= 0)
        & jnp.all(jnp.abs(direction) == 1)
    )


def _has_physical_masses(manipulator: Manipulator, problem: Problem) -> Bool[Array, ""]:
    density, length = jnp.asarray(manipulator.density), problem.panels.edges[-1]
    good = density >= 0 if manipulator.has_radii else density == 0
    if problem.manipulator.mass_per_length is not None:
        good = good & jnp.all(problem.manipulator.mass_per_length(problem.panels.nodes) >= 0)
    for point in manipulator.point_masses:
        good = good & (point.mass >= 0) & (point.arc_length > 0) & (point.arc_length <= length)
    return good


def _is_on_the_body(targets: tuple[Target | None, ...], problem: Problem) -> Bool[Array, ""]:
    places = [jnp.asarray(target.arc_length) for target in targets if isinstance(target, CurvatureAt)]
    length = problem.panels.edges[-1]
    return jnp.all(jnp.asarray([True, *((place >= 0) & (place <= length) for place in places)]))


# --- what is reported along the body -------------------------------------------------------------


def _along(setup: Setup, balance: Balance, dense: Dense) -> Fields:
    """The fields at the base, the Gauss nodes of the smooth pieces of the body, and the tip."""
    problem, path, body = balance.problem, balance.path, setup.manipulator

    first = jax.tree.map(lambda x: x[0], path.starts)
    cut, sections, nodes = problem.panels, problem.nodes, path.nodes
    pieces = panels(cut.edges[-1], body.breakpoints, setup.nodes)
    if pieces.edges.shape != cut.edges.shape:  # nobody wants to see the panels that end at sign changes
        cut = pieces
        nodes = jax.vmap(jax.vmap(dense.state))(cut.nodes)
        sections = jax.vmap(jax.vmap(lambda s: guarded_section(body, s)))(cut.nodes)
    arc_length = line_up(cut.edges[0], cut.nodes, cut.edges[-1])
    sections = jax.tree.map(line_up, problem.base, sections, problem.tip)
    states = jax.tree.map(line_up, first, nodes, path.tip)
    fields = jax.vmap(fields_at, (0, None, None, 0, 0))
    return tendons_first(fields(sections, problem.base_tension, problem.direction, arc_length, states), 1)
