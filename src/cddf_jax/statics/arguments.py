"""The arguments of `solve`: checked on the host, and converted to arrays of one precision.

Wrong types and shapes raise an error here. Numbers without a physical meaning do not, because they may be traced:
`harmless` replaces them, and `is_physical` decides whether the status reports them.
"""

from functools import cache
from typing import TypeGuard, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from ..errors import InputError
from ..mechanics.directions import Directions, not_stated, stated_directions
from ..mechanics.march import FixedPoint
from ..mechanics.problem import Method, Problem
from ..numerics.given_numbers import check_numbers
from ..quantities import check_range_in_space
from ..robot.cross_section import where_present
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.profiles import Constant, Linear, Number
from .targets import Actuation, CurvatureAt, Target, TipPosition
from .tension_search import Targets

PerTendon = Float[Array, " tendons"]
Tree = TypeVar("Tree")
DOUBLE = np.dtype(np.float64)  # of directions, which are exact in any precision
GivenDirections = Number | tuple[Number | None, ...]


def split_actuation(manipulator: Manipulator, actuation: Actuation) -> tuple[PyTree, Targets]:
    """The given tensions, with zero in place of targets; and the targets, with None in place of tensions."""
    count = manipulator.num_tendons
    if isinstance(actuation, TipPosition):
        return 0.0, (actuation,)
    entries = actuation if isinstance(actuation, tuple | list) else [actuation]
    if any(isinstance(entry, TipPosition) for entry in entries):
        raise ValueError("solve: a TipPosition stands for all base tensions; give it alone, without a list")
    if not any(_is_target(entry) for entry in entries):
        return actuation, (None,) * count
    if len(entries) != count:
        raise ValueError(
            f"solve: with a target, base_tension must hold one tension or target per tendon ({count}), "
            f"got {len(entries)}; give a list such as [Displacement(0.002), 5.0]"
        )
    return [0.0 if _is_target(x) else x for x in entries], tuple(x if _is_target(x) else None for x in entries)


def _is_target(entry: object) -> TypeGuard[Target]:
    if isinstance(entry, float | int | np.ndarray | jax.Array):  # asking a protocol takes 10 us
        return False
    if isinstance(entry, type) and hasattr(entry, "quantity"):
        raise TypeError(f"solve: {entry.__name__} needs a value, as in {entry.__name__}(...)")
    return isinstance(entry, Target)


def checked_loads(loads: Loads | None) -> Loads | None:
    """The loads, after a check of their type and shapes."""
    if loads is None:
        return None
    if not isinstance(loads, Loads):
        raise TypeError(f"solve: loads must be a Loads, as in Loads(tip_force=(0.0, -1.0)), got {loads!r}")
    vector, turn = ((2,), (3,)), ((), (3,))
    shapes = {"arc_length": ((),), "moment": turn, "tip_moment": turn}
    for path, value in jax.tree_util.tree_leaves_with_path(loads):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        allowed, found = shapes.get(name.split(".")[-1], vector), np.shape(value)
        if found not in allowed:
            known = " or ".join(map(str, allowed))
            raise ValueError(f"solve: loads.{name} must have shape {known}, got {found}; batch with jax.vmap")
    return loads


def refuse_batch(what: str, manipulator: Manipulator) -> None:
    """Refuse a body that holds the numbers of several; called where a calculation with it failed, as it takes long.

    Raises:
        InputError: names the first such number and the remedy.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(manipulator):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        own = [profile for part, profile in manipulator.profiles.items() if name.startswith(f"{part}.")]
        if np.ndim(leaf) > 0 and all(isinstance(profile, Constant | Linear) for profile in own):
            got = f"{what}: {name} of the body has the shape {np.shape(leaf)}, as in a batch of bodies"
            raise InputError(got, remedy=f"use jax.vmap(lambda body: {what}(body, ...))(bodies)")


def check_targets(manipulator: Manipulator, targets: Targets) -> None:
    """Refuse targets whose value has a wrong shape, or lies outside of what any body can have.

    Raises:
        ValueError: says what is given and what is needed.
    """
    for target in targets:
        if target is None:
            continue
        if not isinstance(target, TipPosition):
            _check_number(target, in_space=manipulator.in_space)
            continue
        components, count = (3 if manipulator.in_space else 2), manipulator.num_tendons
        if np.shape(target.value) != (components,):
            where = "in space" if manipulator.in_space else "in the plane (space=True makes it three)"
            what = f"{components} components, m, {where}, got shape {np.shape(target.value)}"
            raise ValueError(f"solve: TipPosition must have {what}; batch with jax.vmap")
        for name in ("minimum_tension", "maximum_tension"):
            limit = getattr(target, name)
            if limit is not None and np.shape(limit) not in ((), (count,)):
                what = f"a number or one per tendon ({count}), N, got shape {np.shape(limit)}"
                raise ValueError(f"solve: TipPosition's {name} must be {what}")


def _check_number(target: Target, *, in_space: bool) -> None:
    """Refuse a target that is not one number, and a known one that no body in space can have."""
    name = type(target).__name__
    for field, value in vars(target).items():
        if np.ndim(value) > 0:
            shape = f"got {field} of the shape {np.shape(value)}"
            raise ValueError(f"solve: {name} must hold one number for its tendon, {shape}; batch with jax.vmap")
    if in_space and isinstance(target.value, np.ndarray):
        check_range_in_space("solve", target.quantity, target.value)


def check_method(method: object, *, in_space: bool, loaded: bool) -> None:
    """Refuse what is no method, and for a body in space or under loads every other than `FixedPoint`.

    Raises:
        TypeError: for what is no method.
        ValueError: names the method, and what to use.
    """
    if isinstance(method, FixedPoint):
        return
    if not (isinstance(method, eqx.Module) and isinstance(method, Method)):
        raise TypeError(f"solve: method must be one such as FixedPoint(), got {method!r}")
    if in_space or loaded:
        known, where = ("for the plane", "in space") if in_space else ("without loads", "under loads")
        raise ValueError(f"solve: {type(method).__name__} is a method {known}; use FixedPoint() {where}")


def per_tendon(manipulator: Manipulator, base_tension: PyTree, direction: Directions) -> tuple[PyTree, PyTree]:
    """Tensions and directions as arrays; directions as a tuple with None in it, if some are to be found.

    Raises:
        ValueError: when there is neither one for all nor one per tendon.
    """
    count = manipulator.num_tendons

    def checked(name: str, value: PyTree, precision: np.dtype | None = None, shapes=((), (count,))):
        check_numbers(f"solve: {name}", value)
        if not isinstance(value, jax.Array):
            traced = any(isinstance(number, jax.Array) for number in jax.tree.leaves(value))
            try:
                value = jnp.asarray(value) if traced else np.asarray(value, dtype=precision or _precision(manipulator))
            except ValueError:  # rows of different lengths
                raise ValueError(f"solve: {name} must be a number or one per tendon ({count}), got {value!r}") from None
        if isinstance(value, jax.Array) and value.weak_type:  # a weakly typed number would be compiled for again
            value = value.astype(value.dtype)
        if value.shape not in shapes:
            raise ValueError(f"solve: {name} must be a number or one per tendon ({count}), got shape {value.shape}")
        return value

    try:
        direction = stated_directions(direction, count)
    except ValueError as error:
        raise ValueError(f"solve: {error}") from None
    if not_stated(direction):
        assert isinstance(direction, tuple)
        direction = tuple(None if x is None else checked("direction", x, DOUBLE, ((),)) for x in direction)
    else:
        direction = checked("direction", direction, DOUBLE)
    return checked("base_tension", base_tension), direction


def _precision(*trees: PyTree) -> jnp.dtype:
    """The highest precision of the numbers of some pytrees."""
    leaves = jax.tree.leaves(trees)
    if functions := [x for x in leaves if callable(x)]:
        raise TypeError(
            f"solve: {functions[0]!r} stands where a body has numbers; give the function to Manipulator, Tendon or "
            "Piecewise, or make it a static field of its profile"
        )
    kinds = {x.dtype for x in leaves if isinstance(x, jax.Array | np.ndarray | np.generic)}
    return _common_precision(frozenset(kinds), jax.dtypes.canonicalize_dtype(np.float64))


@cache
def _common_precision(kinds: frozenset[np.dtype], widest: np.dtype) -> jnp.dtype:
    """The highest of some types of numbers; cached, as JAX takes long. The widest type matters, as x64 may be off."""
    floating = {jax.dtypes.canonicalize_dtype(kind) for kind in kinds if jnp.issubdtype(kind, jnp.inexact)}
    return jnp.result_type(jnp.float32, *floating)


def one_precision(
    manipulator: Manipulator, base_tension: Number, direction: GivenDirections, others: Tree = None
) -> tuple[Manipulator, PerTendon, PerTendon, Tree]:
    """All numbers in one precision: that of the manipulator, or a higher one of a JAX array among the other numbers."""
    dtype = _precision(manipulator, base_tension, others)

    def cast(tree):
        arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
        return eqx.combine(jax.tree.map(lambda x: jnp.asarray(x, dtype), arrays), rest)

    def one_each(value):
        if isinstance(value, tuple):  # directions, of which some are to be found; they get the stand-in +1
            value = jnp.stack([jnp.asarray(1.0 if x is None else x, dtype) for x in value])
        return jnp.broadcast_to(jnp.asarray(value, dtype), (manipulator.num_tendons,))

    return cast(manipulator), one_each(base_tension), one_each(direction), cast(others)


def harmless(
    manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, others: Tree
) -> tuple[Manipulator, PerTendon, PerTendon, Tree]:
    """Replace numbers that would make derivatives of other lanes of a batch NaN, by 0 * NaN."""

    def finite(tree, stand_in):
        arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
        return eqx.combine(jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, stand_in), arrays), rest)

    tension = jnp.where(jnp.isfinite(base_tension) & (base_tension >= 0), base_tension, 0.0)
    direction = jnp.where(jnp.abs(direction) == 1, direction, 1.0)
    body = finite(manipulator, 1.0)
    for i, tendon in enumerate(body.tendons):  # 1 / (E A)
        if tendon.axial_stiffness is not None:
            stiffness = jnp.where(tendon.axial_stiffness == 0, 1.0, tendon.axial_stiffness)
            body = eqx.tree_at(lambda body, i=i: body.tendons[i].axial_stiffness, body, stiffness)
    return body, tension, direction, finite(others, 0.0)


def is_physical(
    manipulator: Manipulator, base_tension: PerTendon, direction: PerTendon, problem: Problem
) -> Bool[Array, ""]:
    """Whether the numbers, as they were before `harmless`, have a physical meaning."""
    body = problem.manipulator
    stiffness = jax.vmap(jax.vmap(body.strain_stiffness if body.in_space else body.stiffness))(problem.elements.nodes)
    stiff = stiffness[..., None] if stiffness.ndim == 2 else jnp.min(stiffness, axis=-1, keepdims=True)
    sections = (stiff > 0) & (where_present(problem.nodes, problem.nodes.offset) >= 0)
    return (
        jnp.all(sections)  # as one: XLA takes seconds to fold the offsets of a large batch if they are constants
        & (problem.elements.edges[-1] > 0)
        & jnp.all(manipulator.tendon_friction >= 0)
        & (True if manipulator.tendon_drag is None else jnp.all(manipulator.tendon_drag >= 0))
        & _has_physical_points(manipulator, problem)
        & jnp.all(jnp.isfinite(manipulator.tendon_compliance) & (manipulator.tendon_compliance >= 0))
        & jnp.all(manipulator.tendon_outside_compliance >= 0)
        & _has_physical_memory(manipulator)
        & jnp.all(base_tension >= 0)
        & jnp.all(jnp.abs(direction) == 1)
    )


def _has_physical_memory(manipulator: Manipulator) -> Bool[Array, ""]:
    """Whether friction besides that of tendons on the body is 0 or more."""
    own = [number for t in manipulator.tendons for number in (t.outside_friction, t.outside_drag)]
    given = [jnp.asarray(number) >= 0 for number in (manipulator.friction_moment, *own) if number is not None]
    return jnp.all(jnp.stack([jnp.asarray(True), *given]))


def _has_physical_points(manipulator: Manipulator, problem: Problem) -> Bool[Array, ""]:
    density, length = jnp.asarray(manipulator.density), problem.elements.edges[-1]
    good = density >= 0 if manipulator.has_radii else density == 0
    if problem.manipulator.mass_per_length is not None:
        good = good & jnp.all(problem.manipulator.mass_per_length(problem.elements.nodes) >= 0)
    loaded = () if problem.loads is None else problem.loads.points
    for point in (*manipulator.point_masses, *loaded):
        good = good & (point.arc_length > 0) & (point.arc_length <= length)
    for point in manipulator.point_masses:
        good = good & (point.mass >= 0)
    return good


def are_possible(targets: Targets, problem: Problem) -> Bool[Array, ""]:
    """Whether arc lengths of targets lie between base and tip, and limits of tensions are in order."""
    places = [jnp.asarray(target.arc_length) for target in targets if isinstance(target, CurvatureAt)]
    length = problem.elements.edges[-1]
    good = [(place >= 0) & (place <= length) for place in places]
    for target in targets:
        if isinstance(target, TipPosition):
            least = jnp.asarray(target.minimum_tension)
            most = jnp.inf if target.maximum_tension is None else jnp.asarray(target.maximum_tension)
            good.append(jnp.all((least >= 0) & (least <= most)))
    return jnp.all(jnp.asarray([True, *good]))
