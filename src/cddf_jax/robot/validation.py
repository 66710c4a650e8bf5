"""Checks that the numbers of a manipulator describe a body; their messages name place, value and remedy."""

from collections.abc import Callable
from itertools import combinations

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from ..errors import InputError
from ..numerics.arrays import evaluated
from ..quantities import QUANTITIES
from .loads import Loads
from .manipulator import STIFFNESSES, STRAINS, Manipulator, PointMass, Tendon
from .profiles import Number, Profile, breakpoints

_SLACK = 1e-6  # of the length: finer than any workshop, coarser than the rounding of float32
_POINTS = 1001
_ABOVE_ZERO = (
    *("length", "youngs_modulus", "stiffness_factor", "axial_factor", "shear_factor", "yield_strain"),
    *("arc_length", "axial_stiffness", "end"),
)
_ZERO_OR_MORE = (
    *("friction_coefficient", "drag", "density", "mass", "friction_moment"),
    *("free_length", "outside_compliance", "outside_friction", "outside_drag"),
)
_DEMANDED_ALONG = {**dict.fromkeys(("youngs_modulus", *STIFFNESSES), "above 0"), "mass_per_length": "0 or more"}
_TOUCHING = 1e-2  # of the offset: tendons that are nearer touch
_ARMS_ALONG = jax.vmap(Manipulator.arms, (None, 0))
_LARGEST_RATIO = 5.0  # Poisson's; a material has 0.5 at most, a body that is soft in torsion more: here E / G = 12


def check_manipulator(manipulator: Manipulator, offsets_outside_wall: bool) -> None:
    """Check numbers, wall and tendons, the latter two along the whole length.

    Args:
        manipulator: one manipulator, not a batch.
        offsets_outside_wall: allow tendons in the bore or outside the body.

    Raises:
        InputError: for the first violation from the base; names quantity, arc length, value and remedy.
        TypeError: when a number is traced.
    """
    _check_leaves(manipulator)
    _check_scalars(manipulator)
    with jax.enable_x64(True):  # profiles are checked in float64, in any precision of the caller
        s = _stations(manipulator)
        _check_wall(manipulator, s)
        for name, demand in _DEMANDED_ALONG.items():
            if name in manipulator.profiles:
                _check_sign(name, demand, _values(name, manipulator.profiles[name], s), s)
        for number, tendon in enumerate(manipulator.tendons, 1):
            _check_tendon(f"tendon {number}", manipulator, tendon, s, offsets_outside_wall)
        for strain, part in zip(STRAINS, manipulator.rest_curvature or (), strict=False):
            _values(f"rest_curvature {strain}", part, s)
        _check_apart(manipulator, s)


def refuse_memory(who: str, manipulator: Manipulator) -> None:
    """Refuse friction that acts along a history only.

    Raises:
        InputError: names it and the remedy.
    """
    if manipulator.has_memory:
        what = f"{who}: friction_moment, outside_friction and outside_drag act along a history"
        raise InputError(what, remedy="use trace, or leave them out of the body")


def check_loads(manipulator: Manipulator, loads: Loads | None) -> None:
    """Refuse gravity on a body without mass, and loads beside the body; traced values are not checked.

    Raises:
        InputError: names what is missing and the remedy.
    """
    for number, point in enumerate(() if loads is None else loads.points):
        place, length = point.arc_length, manipulator.length
        known = not isinstance(place, Tracer) and not isinstance(length, Tracer)
        if known and not np.all((np.asarray(place) > 0) & (np.asarray(place) <= np.asarray(length))):
            what = f"loads.points.{number}: arc_length must lie above 0 and up to the tip at {_mm(length)}"
            raise InputError(f"{what}, got {_mm(np.max(np.asarray(place)))}; put the load on the body")
    if loads is None or isinstance(loads.gravity, Tracer) or not np.any(np.asarray(loads.gravity)):
        return
    if not manipulator.has_mass:
        raise InputError(
            "loads.gravity: the body has no weight, since its density is 0; give it density, mass_per_length or "
            "point_masses, or leave gravity out"
        )


# --- single numbers ------------------------------------------------------------------------------


def _check_leaves(manipulator: Manipulator) -> None:
    """Refuse traced numbers, and numbers that are not finite."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(manipulator):
        name = jax.tree_util.keystr(path).removeprefix(".")
        if isinstance(leaf, Tracer):
            raise TypeError(f"validate: {name} is traced; call validate() before jit, grad or vmap")
        values = np.ravel(leaf) if isinstance(leaf, jax.Array | np.ndarray) else np.zeros(0)
        if not np.all(np.isfinite(values)):
            raise InputError(f"{name} must be finite, got {values[~np.isfinite(values)][0]}; correct its value")


def _check_scalars(manipulator: Manipulator) -> None:
    length = manipulator.length
    _check_numbers("", manipulator)
    ratio = manipulator.poissons_ratio
    if not -1 < ratio <= _LARGEST_RATIO:
        raise InputError(
            f"poissons_ratio must be above -1 and at most {_LARGEST_RATIO:g}, got {float(ratio):.6g}; correct its "
            "value, or give torsional_stiffness (and shear_stiffness where the axis is extensible) in its place"
        )
    for number, point in enumerate(manipulator.point_masses, 1):
        _check_numbers(f"point mass {number}: ", point)
        if point.arc_length > length:
            what = f"arc_length {_mm(point.arc_length)} lies beyond the tip at {_mm(length)}; put it on the body"
            raise InputError(what, where=f"point mass {number}")
    for number, tendon in enumerate(manipulator.tendons, 1):
        _check_numbers(f"tendon {number}: ", tendon)
        if tendon.end is not None and tendon.end > length:
            what = f"end at s = {_mm(tendon.end)} lies beyond the tip at {_mm(length)}"
            remedy = "anchor it on the body, or leave end out for the tip"
            raise InputError(what, where=f"tendon {number}", remedy=remedy)


def _check_numbers(prefix: str, owner: Manipulator | PointMass | Tendon) -> None:
    """Refuse numbers of an owner that are arrays or too small; profiles are checked elsewhere."""
    for name in (*_ABOVE_ZERO, *_ZERO_OR_MORE):
        value = getattr(owner, name, None)
        if value is None or callable(value):
            continue
        if np.ndim(value) != 0:
            what = f"{prefix}{name} must be one number, got shape {np.shape(value)}"
            raise InputError(what, remedy="validate one manipulator at a time")
        demand, good = ("above 0", value > 0) if name in _ABOVE_ZERO else ("0 or more", value >= 0)
        if not good:
            unit = QUANTITIES[name].unit.removeprefix("1")
            number = f"{float(value):.6g} {unit}".strip()
            raise InputError(f"{prefix}{name} must be {demand}, got {number}; correct its value")


# --- along the length ----------------------------------------------------------------------------


def _stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths at which to look: a dense grid and both sides of every breakpoint."""
    length = float(manipulator.length)
    return np.sort(np.concatenate([np.linspace(0.0, length, _POINTS), *_sides(evaluated(joints, manipulator), length)]))


def joints(manipulator: Manipulator) -> Array:
    """`Manipulator.breakpoints`, as a function that has a name."""
    return manipulator.breakpoints


def _sides(breakpoints: Number, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Just before and just behind each breakpoint; for one that is not between base and `end` both are equal."""
    joints, nudge = np.sort(np.asarray(breakpoints, float)), 1e-9 * end
    return np.clip(joints - nudge, 0.0, end - nudge), np.clip(joints + nudge, 0.0, end - nudge)


def _check_sign(name: str, demand: str, values: np.ndarray, s: np.ndarray) -> None:
    unit, good = QUANTITIES[name].unit, values > 0 if demand == "above 0" else values >= 0
    _demand(good, s, f"{name} must be {demand}", lambda i: f"it is {values[i]:.6g} {unit}", "correct it there")


def _check_wall(manipulator: Manipulator, s: np.ndarray) -> None:
    if manipulator.outer_radius is None or manipulator.inner_radius is None:
        return
    outer = _values("outer_radius", manipulator.outer_radius, s)
    inner = _values("inner_radius", manipulator.inner_radius, s)
    _demand(inner >= 0, s, "inner_radius must be 0 or more", lambda i: f"it is {_mm(inner[i])}", "enlarge it there")
    rule, remedy = "outer_radius must exceed inner_radius", "make the wall thicker there or shorten the body"
    _demand(outer > inner, s, rule, lambda i: f"they are {_mm(outer[i])} and {_mm(inner[i])}", remedy)


def _check_tendon(name: str, manipulator: Manipulator, tendon: Tendon, s: np.ndarray, outside_wall: bool) -> None:
    reach = float(manipulator.length if tendon.end is None else tendon.end)
    beyond = s > reach
    offset = _values(f"{name}: offset", tendon.offset, s, beyond)
    rule = f"{name}: offset must be 0 or more"
    by = "side=-1" if tendon.angle is None else "its angle"
    remedy = f"give the distance from the neutral axis, and the side by {by}"
    _demand((offset >= 0) | beyond, s, rule, lambda i: f"it is {_mm(offset[i])}", remedy)
    _check_jumps(f"{name}: offset", tendon.offset, reach, _mm, turns=False)
    if tendon.angle is not None:
        _values(f"{name}: angle", tendon.angle, s, beyond)
        _check_jumps(f"{name}: angle", tendon.angle, reach, _deg, turns=True)
    if outside_wall or not manipulator.has_radii:
        return
    outer, inner = evaluated(Manipulator.radii, manipulator, s)
    slack = _SLACK * float(manipulator.length)
    inside = (offset >= inner - slack) & (offset <= outer + slack)
    rule, remedy = f"{name}: offset must lie inside the wall", "move the tendon, or allow it with offsets_outside_wall"

    def found(i: int) -> str:
        return f"it is {_mm(offset[i])} and the wall runs from {_mm(inner[i])} to {_mm(outer[i])}"

    _demand(inside | beyond, s, rule, found, remedy)


def _check_jumps(name: str, profile: Profile, reach: float, shown: Callable[[float], str], *, turns: bool) -> None:
    """Refuse a jump, except by whole turns where `turns` says that it is an angle."""
    sides = _sides(breakpoints(profile), reach)
    before, after = (evaluated(profile, side) for side in sides)
    jump = _least_turn(after - before) if turns else after - before
    slack = _SLACK * np.maximum(1.0 if turns else reach, np.abs(before))  # a steep profile moves between the sides

    def found(i: int) -> str:
        return f"it goes from {shown(before[i])} to {shown(after[i])}"

    _demand(np.abs(jump) <= slack, sides[0], f"{name} must not jump", found, "make the pieces meet")


def _check_apart(manipulator: Manipulator, s: np.ndarray) -> None:
    """Refuse two tendons at one place of a cross-section, where at least one tendon has an angle."""
    if all(tendon.angle is None for tendon in manipulator.tendons):
        return
    places = evaluated(_ARMS_ALONG, manipulator, s)
    ends = [float(manipulator.length if tendon.end is None else tendon.end) for tendon in manipulator.tendons]
    for i, j in combinations(range(manipulator.num_tendons), 2):
        apart = np.linalg.norm(places[:, i] - places[:, j], axis=-1)
        good = (apart > _TOUCHING * np.linalg.norm(places[:, i], axis=-1)) | (s > min(ends[i], ends[j]))
        rule, remedy = f"tendons {i + 1} and {j + 1} must not touch or cross", "change an offset or an angle"
        _demand(good, s, rule, lambda k, apart=apart: f"they are {_mm(np.round(apart[k], 6))} apart", remedy)


def _least_turn(angle: np.ndarray) -> np.ndarray:
    """The angle less whole turns, from -pi to pi."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def _values(name: str, profile: Profile, s: np.ndarray, unused: np.ndarray | bool = False) -> np.ndarray:
    values = evaluated(profile, s)
    if values.shape != s.shape:
        raise InputError(
            f"{name} must give one value per arc length, got shape {values.shape} for {s.shape}; "
            "work element by element, and validate one manipulator at a time"
        )
    finite = np.isfinite(values) | unused
    _demand(finite, s, f"{name} must be finite", lambda i: f"it is {values[i]}", "correct the profile there")
    return values


def _demand(good: np.ndarray, s: np.ndarray, rule: str, found: Callable[[int], str], remedy: str) -> None:
    """Raise for the first arc length at which a rule is broken; `found` says what is there."""
    for i in np.flatnonzero(~good)[:1].tolist():
        raise InputError(f"{rule}: at s = {_mm(s[i])} {found(i)}; {remedy}")


def _mm(value: Number | float) -> str:
    return f"{1e3 * float(value):.6g} mm"


def _deg(value: Number | float) -> str:
    return f"{np.degrees(float(value)):.6g} deg"
