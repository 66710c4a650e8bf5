"""`solve`: static equilibrium of one manipulator under one load."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..errors import SolveError
from ..mechanics.directions import Directions, is_contradicted, not_stated, travel_under_tension
from ..mechanics.fields import AnyFields, fields_at, planar_fields, tendons_first
from ..mechanics.friction import Pull, unspent
from ..mechanics.march import FixedPoint
from ..mechanics.problem import Method, Problem, Solution, all_points, fibres_cross, line_up
from ..mechanics.tendon_displacement import tendon_displacement
from ..mechanics.truncation_error import truncation_error
from ..numerics import tolerances as tol
from ..numerics.arrays import zero_as
from ..numerics.fixed_point import without_derivative
from ..numerics.given_numbers import check_whole
from ..robot.cross_section import planar
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator, in_space
from ..robot.profiles import Number
from ..robot.validation import check_loads, refuse_memory
from .arguments import (
    GivenDirections,
    are_possible,
    check_method,
    check_targets,
    checked_loads,
    harmless,
    is_physical,
    one_precision,
    per_tendon,
    refuse_batch,
    split_actuation,
)
from .balance import Balance, equilibrate
from .equilibrium import Dense, Equilibrium, nan_unless
from .equilibrium_text import result_in_words
from .settle import Setup, set_up
from .status import Status, first_of
from .targets import Actuation, Displacement, TipAngle, TipStiffness
from .tension_search import Found, Targets, reach

PerTendon = Float[Array, " tendons"]
SOLVED = (Status.successful, Status.direction_contradicted)


def solve(
    manipulator: Manipulator,
    base_tension: Actuation,
    loads: Loads | None = None,
    *,
    direction: Directions = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
    space: bool = False,
    throw: bool = True,
) -> Equilibrium:
    """Shape, tension and friction of a manipulator whose tendons are pulled at the base.

    Works under jit, vmap, grad, scan and shard_map; batching is the caller's `jax.vmap`.

    Args:
        manipulator: the body and its tendons.
        base_tension: T_base >= 0, N, a number for all tendons or one per tendon. A target may take the place of a
            number; the tension is then found: `Displacement`, `TipAngle`, `TipTension`, `CurvatureAt`, `TotalTension`,
            `TipStiffness`; as many targets as unknown tensions. A `TipPosition` takes the place of all base tensions.
        loads: dead loads on the tip and at points, and gravity; None for none.
        direction: +1 for a tendon that slides in at the base (pulled, as in the paper), -1 for one that
            slides out; a number, or one per tendon. None, for all tendons or for one, means the direction of its
            travel: of the length pulled in since the straight body, under loads of its rate while all tensions rise
            in proportion. A single tendon then has +1. Derivatives keep the directions that were found.
        method: `FixedPoint()` or, without loads, `LiteralIteration()`.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static. Where a tendon may turn over or become
            slack by drag, each piece has four elements of half as many, in space of three quarters. The default is
            accurate to 1e-12 for smooth bodies, and where a tendon turns over mostly to 1e-8 of the tip tension and
            1e-7 of the length; `error_estimate` says more.
        space: solve a body of the plane in space. Bodies are always solved in space where a tendon has an angle, where
            loads have three components, and where the body is extensible or has a curvature at rest.
        throw: raise where the values are known and the solve failed. Where they are traced, under jit or
            vmap, nothing is raised; look at `status`.

    Where there are several equilibria under the loads, the result is the one on the path along which the tensions act
    first and then all loads grow together from 0 to 1. `num_load_steps` counts the steps, `stable` is that of the end,
    and where the path ends early (`load_limit`) `load_fraction` says where.

    A lane that fails has NaN for its numbers and 0 for its derivatives: the derivative of a sum over a batch stays
    finite.
    Some failures keep their numbers: `crossing`, where the model has left its range, `inaccurate` and `unstable`;
    and `slack`, `unreachable` and `undetermined`, whose numbers are those of the nearest tensions, with the
    `target_miss` that is left, and whose derivatives are taken at these tensions.
    Derivatives are one-sided where the curvature is zero along a stretch of the body (no tension and no load, or
    antagonists that cancel): friction acts on |kappa|, whose slope there is taken as that of kappa > 0. Across
    isolated changes of sign first derivatives are right to 1e-6 or better, and second ones
    to 1e-4.
    Where drag has used up the tension of a tendon that slides in, the tendon is slack: it has no tension and no
    friction, and follows the body. Its tip tension is 0, and so are the derivatives of the tip tension.
    Of the body only numbers that would make the results meaningless are checked here (finite; stiffness above 0;
    friction, drag and offsets not negative); walls, anchors, knots and jumps are checked by `manipulator.validate()`.

    Raises:
        SolveError: with `throw`, when the status is neither successful nor `direction_contradicted`.
        InputError: for a body whose friction needs a history (`friction_moment`, `outside_friction`, `outside_drag`).
        ValueError: for a wrong number of tensions, directions or components of a load, nodes below 4, gravity on
            a body that is known to have no mass, numbers that are not plain (with a unit, masked, text, ...), a batch
            of bodies, or in space a target angle beyond 0 to pi.
        TypeError: if an argument has the wrong type.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"solve: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    refuse_memory("solve", manipulator)
    check_whole("nodes", nodes, 4)
    given, targets = split_actuation(manipulator, base_tension)
    given, direction = per_tendon(manipulator, given, direction)
    loads = checked_loads(loads)
    if loads is None and any(isinstance(target, TipStiffness) for target in targets):
        loads = Loads()
    if space or manipulator.in_space or (loads is not None and loads.in_space):
        manipulator = in_space(manipulator)
    check_method(method, in_space=manipulator.in_space, loaded=loads is not None)
    check_targets(manipulator, targets)
    check_loads(manipulator, loads)
    try:
        equilibrium = _solve(manipulator, given, targets, loads, direction, method, nodes)
    except (TypeError, ValueError):
        refuse_batch("solve", manipulator)
        raise
    if throw:
        _raise_if_failed(equilibrium, targets)
    return equilibrium


def _raise_if_failed(equilibrium: Equilibrium, targets: Targets) -> None:
    code = equilibrium.status
    if isinstance(code, Tracer) or np.ndim(code) > 0 or int(code) in SOLVED:
        return
    raise SolveError(result_in_words(equilibrium) + _units_of(targets, float(equilibrium.arc_length[-1])))


def _units_of(targets: Targets, length: float) -> str:
    """A hint at the unit of a target, if its value looks like another unit."""
    for target in targets:
        if isinstance(target, TipAngle) and abs(float(target.value)) > 2 * np.pi:
            return f" TipAngle is in rad; {float(target.value):g} rad are {np.degrees(float(target.value)):.4g} deg."
        if isinstance(target, Displacement) and abs(float(target.value)) > length:
            return f" Displacement is in m; {float(target.value):g} m is longer than the body."
    return ""


@partial(jax.jit, static_argnames=("method", "nodes"))
def _solve(
    manipulator: Manipulator,
    given: Number,
    targets: Targets,
    loads: Loads | None,
    direction: GivenDirections,
    method: Method,
    nodes: int,
) -> Equilibrium:
    to_find = not_stated(direction)
    if loads is not None:
        loads = loads.with_components(manipulator.components)
    asked = one_precision(manipulator, given, direction, (targets, loads))
    numbers = jax.tree.leaves(eqx.filter(asked, eqx.is_inexact_array))
    finite = jnp.all(jnp.isfinite(jnp.concatenate([x.ravel() for x in numbers])))
    manipulator, given, direction, (targets, loads) = harmless(*asked)
    setup = set_up(manipulator, given, direction, loads, method, nodes, to_find)
    balance, found = _equilibrium(setup, targets)
    physical = finite & is_physical(asked[0], asked[1], asked[2], balance.problem)
    return _outputs(balance, found, physical & are_possible(targets, balance.problem))


def _outputs(balance: Balance, found: Found, physical: Bool[Array, ""]) -> Equilibrium:
    """What `solve` returns."""
    problem, solution, path = balance.problem, balance.solution, balance.load_path
    tip = solution.tip
    solved = physical & path.converged
    truncation = balance.error_amplification * truncation_error(*without_derivative((problem, solution)))
    round_off = 4 * float(jnp.finfo(truncation.dtype).eps)
    travel = travel_under_tension(problem, solution.nodes.pull, balance.travel)
    contradicted = solved & is_contradicted(problem.direction, travel, problem.elements.edges[-1])
    tensions, cut = (problem.base_tension, problem.direction), problem.elements
    dense = Dense(problem.manipulator, *tensions, cut.edges, cut.order, solution.states, solved)
    return Equilibrium(
        along=nan_unless(solved, _along(problem, solution, dense)),
        tip_position=nan_unless(solved, tip.position),
        tip_angle=nan_unless(solved, problem.geometry.tip_angle(tip.heading)),
        tip_frame=nan_unless(solved, problem.geometry.tip_frame(tip.heading)),
        tip_tension=nan_unless(solved, unspent(problem.base_tension, tip.pull) / tip.ratio),
        tension_loss=nan_unless(solved, 1.0 - _fraction_left(problem, tip.pull) / tip.ratio),
        tendon_displacement=nan_unless(solved, tendon_displacement(problem, solution.nodes)),
        base_tension=nan_unless(solved, problem.base_tension),
        target_miss=nan_unless(solved, found.miss),
        target_rank=found.rank,
        base_moment=nan_unless(solved, problem.base_moment),
        load_fraction=path.fraction,
        num_load_steps=path.num_steps.astype(int),
        stable=solved & path.stable,
        direction=problem.direction,
        direction_contradicted=contradicted,
        error_estimate=nan_unless(solved, truncation + balance.error_amplification * (solution.residual + round_off)),
        num_iterations=solution.num_iterations.astype(int),
        status=_status(balance, found, physical, truncation, jnp.any(contradicted)),
        _dense=dense,
    )


def _status(
    balance: Balance, found: Found, physical: Bool[Array, ""], truncation: Number, contradicted: Bool[Array, ""]
) -> Int[Array, ""]:
    solution, path = balance.solution, balance.load_path
    return first_of(
        (~physical, Status.unphysical),
        (solution.locked, Status.locked),
        (~(solution.converged & path.resolved), Status.not_converged),
        (~path.converged, Status.load_limit),
        (found.slack, Status.slack),
        (~found.reached, Status.unreachable),
        (~found.determined, Status.undetermined),
        (fibres_cross(balance.problem, solution.states), Status.crossing),
        (~path.stable, Status.unstable),
        (jnp.asarray(truncation > tol.ACCURACY), Status.inaccurate),
        (contradicted, Status.direction_contradicted),
    )


def _fraction_left(problem: Problem, tip: Pull) -> PerTendon | float:
    """The part of the base tension that drag leaves, as a fraction; 1 where there is no base tension."""
    if problem.nodes.drag is None:
        return 1.0
    pulled = problem.base_tension > 0
    return jnp.where(pulled, unspent(problem.base_tension, tip) / jnp.where(pulled, problem.base_tension, 1.0), 1.0)


def _equilibrium(setup: Setup, targets: Targets) -> tuple[Balance, Found]:
    if any(target is not None for target in targets):
        return reach(setup, targets)
    missed = jnp.zeros_like(setup.problem.base_tension)
    true = zero_as(missed) == 0
    return equilibrate(setup), Found(missed, reached=true, slack=~true, determined=true)


# --- fields along the body -----------------------------------------------------------------------


def _along(problem: Problem, solution: Solution, dense: Dense) -> AnyFields:
    """The fields at the base, the Gauss nodes and the tip."""
    cut = problem.elements
    arc_length = line_up(cut.edges[0], cut.nodes, cut.edges[-1])
    if problem.geometry.has_frames:  # whose forces need derivatives along the polynomials
        return tendons_first(jax.vmap(partial(_fields_within, dense))(arc_length), 1)
    sections, states = all_points(problem, solution.states)
    fields = jax.vmap(planar_fields, (0, None, None, 0, 0))
    return tendons_first(fields(planar(sections), problem.base_tension, problem.direction, arc_length, states), 1)


def _fields_within(dense: Dense, arc_length: Float[Array, ""]) -> AnyFields:
    return fields_at(dense.manipulator, dense.base_tension, dense.direction, arc_length, dense.state)
