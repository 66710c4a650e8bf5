"""`solve`: static equilibrium of one manipulator under one load."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from . import mechanics
from .equilibrium import RESULTS, Dense, Equilibrium, Fields, SolveError, fields_at, nan_unless, tendons_first
from .manipulator import Manipulator
from .solver import ACCURACY, FixedPoint, Method, Path, Problem, lay_out, tension_of, truncation_error
from .validation import describe_crossing

PerTendon = Float[Array, " tendons"]


def solve(
    manipulator: Manipulator,
    base_tension: Any,
    *,
    direction: Any = +1,
    method: Method = FixedPoint(),
    nodes: int = 16,
    throw: bool = True,
) -> Equilibrium:
    """Shape, tension and friction of a manipulator whose tendons are pulled at the base.

    Works under jit, vmap, grad, scan and shard_map; batching is the caller's `jax.vmap`.

    Args:
        manipulator: the body and its tendons.
        base_tension: T_base >= 0, N, a number for all tendons or one per tendon.
        direction: +1 for a tendon that slides in at the base (pulled, as in the paper), -1 for one that
            slides out; a number or one per tendon.
        method: `FixedPoint()`, `LiteralIteration()` or `Marching()`.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static. The default is accurate to
            1e-8 of the tip tension and 1e-7 of the length.
        throw: raise where the values are known and the solve failed. Where they are traced, under jit or
            vmap, nothing is raised; look at `result`.

    A lane that fails has NaN for its numbers and 0 for its derivatives, so that it spoils no sum over a batch.
    Two failures keep their numbers: `crossing`, where the model has left its range, and `inaccurate`.
    Of the body only what makes the numbers meaningless is checked here (finite, a stiffness, friction and
    offsets not negative); walls, anchors, knots and jumps are the business of `manipulator.validate()`.

    Raises:
        SolveError: with `throw`, when the result is neither successful nor `direction_contradicted`.
        ValueError: for a wrong number of tensions or directions, or nodes below 4.
        TypeError: for a method that is none.
    """
    check_nodes(nodes)
    if not isinstance(method, Method) or isinstance(method, type):
        raise TypeError(f"solve: method must be one such as FixedPoint() or Marching(), got {method!r}")
    equilibrium = _solve(manipulator, *per_tendon(manipulator, base_tension, direction), method, nodes)
    if throw:
        _raise_if_failed(equilibrium)
    return equilibrium


def check_nodes(nodes: Any) -> None:
    """Refuse a number of nodes that is none.

    Raises:
        ValueError: unless it is a whole number of 4 or more.
    """
    if isinstance(nodes, bool) or not isinstance(nodes, int) or nodes < 4:
        raise ValueError(f"nodes must be a whole number of 4 or more, got {nodes!r}")


def per_tendon(manipulator: Manipulator, base_tension: Any, direction: Any) -> tuple[Any, Any]:
    """Tensions and directions as arrays.

    Raises:
        ValueError: when there is neither one for all nor one per tendon.
    """
    count = manipulator.num_tendons

    def checked(name, value):
        traced = any(isinstance(number, jax.Array) for number in jax.tree.leaves(value))
        value = jnp.asarray(value) if traced else np.asarray(value, dtype=_precision(manipulator))
        if value.shape not in ((), (count,)):
            raise ValueError(f"solve: {name} must be a number or one per tendon ({count}), got shape {value.shape}")
        return value

    return checked("base_tension", base_tension), checked("direction", direction)


def _raise_if_failed(equilibrium: Equilibrium) -> None:
    code = equilibrium.result
    if isinstance(code._value, Tracer) or np.ndim(code._value) > 0:
        return
    if code == RESULTS.crossing:
        raise SolveError(f"{describe_crossing(equilibrium)}. {RESULTS[code]}")
    if not (code == RESULTS.successful) and not (code == RESULTS.direction_contradicted):
        raise SolveError(RESULTS[code])


@eqx.filter_jit
def _solve(manipulator: Manipulator, base_tension: Any, direction: Any, method: Method, nodes: int) -> Equilibrium:
    manipulator, base_tension, direction = one_precision(manipulator, base_tension, direction)
    numbers = jax.tree.leaves(eqx.filter((manipulator, base_tension), eqx.is_inexact_array))
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(number)) for number in numbers]))
    problem = lay_out(*_harmless(manipulator, base_tension, direction), nodes)
    path = method(problem)

    physical = finite & _is_physical(manipulator, base_tension, direction, problem)
    solved = physical & path.converged
    along = _along(problem, path)
    displacement = _tendon_displacement(problem, path)
    travel = jnp.where(problem.base_tension > 0, problem.direction * displacement, 0.0)
    contradicted = solved & (travel < -1e-6 * problem.panels.edges[-1])
    truncation = truncation_error(problem, path)
    crossing = jnp.max(_crossing(problem, along)) >= 1.0
    round_off = 4 * float(jnp.finfo(truncation.dtype).eps)

    return Equilibrium(
        along=nan_unless(solved, along),
        tip_tension=nan_unless(solved, problem.base_tension / path.tip.ratio),
        tension_loss=nan_unless(solved, 1.0 - 1.0 / path.tip.ratio),
        tendon_displacement=nan_unless(solved, displacement),
        direction_contradicted=contradicted,
        error_estimate=nan_unless(solved, truncation + path.residual + round_off),
        num_iterations=path.num_iterations.astype(int),
        result=_first_of(
            (~physical, RESULTS.unphysical),
            (path.locked, RESULTS.locked),
            (~path.converged, RESULTS.not_converged),
            (crossing, RESULTS.crossing),
            (truncation > ACCURACY, RESULTS.inaccurate),
            (jnp.any(contradicted), RESULTS.direction_contradicted),
        ),
        _dense=Dense(
            problem.manipulator,
            problem.base_tension,
            problem.direction,
            problem.panels,
            path.starts,
            path.nodes,
            solved,
        ),
    )


def _first_of(*cases: tuple[Any, RESULTS]) -> RESULTS:
    """The result of the first case that holds."""
    result = RESULTS.successful
    for holds, code in reversed(cases):
        result = RESULTS.where(holds, code, result)
    return result


def _precision(*trees: Any) -> jnp.dtype:
    """The precision of the numbers of a pytree."""
    numbers = [x for x in jax.tree.leaves(trees) if eqx.is_inexact_array(x)]
    return jnp.result_type(jnp.float32, *(jax.dtypes.canonicalize_dtype(x.dtype) for x in numbers))


def one_precision(manipulator: Manipulator, base_tension: Any, direction: Any) -> tuple[Manipulator, Array, Array]:
    """Everything in the precision of the manipulator, or of a tension that is a JAX array if that is higher."""
    dtype = _precision(manipulator, base_tension)
    arrays, rest = eqx.partition(manipulator, eqx.is_inexact_array)
    manipulator = eqx.combine(jax.tree.map(lambda x: jnp.asarray(x, dtype), arrays), rest)

    def one_each(value):
        return jnp.broadcast_to(jnp.asarray(value, dtype), (manipulator.num_tendons,))

    return manipulator, one_each(base_tension), one_each(direction)


def _harmless(manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon):
    """Stand-ins for numbers that would spoil, through 0 * NaN, the derivatives of neighbours in a batch."""
    arrays, rest = eqx.partition(manipulator, eqx.is_inexact_array)
    arrays = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, 1.0), arrays)
    tension = jnp.where(jnp.isfinite(base_tension) & (base_tension >= 0), base_tension, 0.0)
    return eqx.combine(arrays, rest), tension, jnp.where(jnp.abs(direction) == 1, direction, 1.0)


def _is_physical(manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, problem: Problem):
    stiffness = jax.vmap(jax.vmap(problem.manipulator.bending_stiffness))(problem.panels.nodes)
    return (
        jnp.all(stiffness > 0)
        & (problem.panels.edges[-1] > 0)
        & jnp.all(manipulator.tendon_friction >= 0)
        & jnp.all((problem.nodes.offset >= 0) | ~problem.nodes.present)
        & jnp.all(base_tension >= 0)
        & jnp.all(jnp.abs(direction) == 1)
    )


# --- what is reported along the body -------------------------------------------------------------


def _along(problem: Problem, path: Path) -> Fields:
    """The fields at the base, the Gauss nodes and the tip."""

    def line_up(base, nodes, tip):
        return jnp.concatenate([base[None], nodes.reshape(-1, *nodes.shape[2:]), tip[None]])

    def first(tree):
        return jax.tree.map(lambda x: x[0], tree)

    cut = problem.panels
    arc_length = line_up(cut.edges[0], cut.nodes, cut.edges[-1])
    sections = jax.tree.map(line_up, problem.base, problem.nodes, problem.tip)
    states = jax.tree.map(line_up, first(path.starts), path.nodes, path.tip)
    fields = jax.vmap(fields_at, (0, None, None, 0, 0))
    return tendons_first(fields(sections, problem.base_tension, problem.direction, arc_length, states), 1)


def _tendon_displacement(problem: Problem, path: Path) -> PerTendon:
    """Length of each tendon in the straight body less that in the bent one, the integral of |u_c'|, m."""

    def shortening(section, ratio):
        kappa = mechanics.curvature(section, tension_of(section, problem.base_tension, ratio))
        q, slope = mechanics.arm_ratio(section, kappa), section.offset_slope
        # sqrt(1 + d'^2) - sqrt(q^2 + d'^2) without cancellation
        rate = (1.0 - q) * (1.0 + q) / (jnp.sqrt(1.0 + slope**2) + jnp.sqrt(q**2 + slope**2))
        return jnp.where(section.present, rate, 0.0)

    return problem.panels.integrate(jax.vmap(jax.vmap(shortening))(problem.nodes, path.nodes.ratio))[0][-1]


def _crossing(problem: Problem, along: Fields) -> Float[Array, " points"]:
    """The product sigma d kappa at base, nodes and tip, the largest of the tendons that are there."""

    def inside(section, kappa):
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, 0.0), axis=-1)

    at_nodes = inside(problem.nodes, along.curvature[1:-1].reshape(problem.panels.nodes.shape)[..., None])
    ends = inside(problem.base, along.curvature[0]), inside(problem.tip, along.curvature[-1])
    return jnp.concatenate([at_nodes.ravel(), jnp.stack(ends)])
