"""What `print` shows of an equilibrium and of a manipulator: numbers with units, in a few lines."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .contact import self_contact
from .equilibrium import RESULTS, Equilibrium
from .manipulator import Manipulator
from .profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline, as_profile
from .statics import in_words
from .units import Dimension, shown

_PROFILES: dict[str, Dimension] = {
    "outer_radius": "length",
    "inner_radius": "length",
    "bending_stiffness": "bending stiffness",
    "mass_per_length": "mass per length",
    "youngs_modulus": "pressure",
}
# results whose numbers are there and to be doubted, beside those that `remarks_on` tells
_DOUBTED = (RESULTS.crossing, RESULTS.inaccurate, RESULTS.slack, RESULTS.unreachable, RESULTS.undetermined)


# --- an equilibrium ------------------------------------------------------------------------------


def equilibrium_in_words(equilibrium: Equilibrium) -> str:
    """The answer of one solve; of a batch or under jit the names and shapes of what it holds."""
    if not is_single(equilibrium):
        return eqx.tree_pformat(equilibrium)
    if not np.isfinite(equilibrium.tip_angle):
        return f"no equilibrium: {in_words(equilibrium)}"
    pulled = [f"base tension {tension:.4f} N" for tension in equilibrium.base_tension]
    doubts = [in_words(equilibrium)] if any(equilibrium.result == code for code in _DOUBTED) else []
    lines = [tip_line(equilibrium), *tendon_lines(equilibrium, pulled), strain_line(equilibrium)]
    return "\n".join([*lines, *last_lines(equilibrium, doubts)])


def is_single(equilibrium: Equilibrium) -> bool:
    """Whether it is one solve whose numbers are known."""
    return not isinstance(equilibrium.tip_angle, Tracer) and np.ndim(equilibrium.tip_angle) == 0


def tip_line(equilibrium: Equilibrium) -> str:
    """Position and angle of the tip."""
    x, y = 1e3 * np.asarray(equilibrium.tip_position)
    return f"tip at ({x:.3f}, {y:.3f}) mm, {np.degrees(equilibrium.tip_angle):.3f} deg"


def tendon_lines(equilibrium: Equilibrium, pulled: Sequence[str]) -> list[str]:
    """One line for each tendon.

    Args:
        equilibrium: one solve.
        pulled: what is said first of each tendon, of its base tension; may be empty.
    """
    lines = []
    for i, travel in enumerate(equilibrium.tendon_displacement):
        base, tip, loss = equilibrium.base_tension[i], equilibrium.tip_tension[i], equilibrium.tension_loss[i]
        tension = f"tip tension {tip:.4f} N, loss {100 * loss:.2f} %" if base > 0 else "no tension"
        told = ", ".join([part for part in (pulled[i], tension) if part])
        lines.append(f"tendon {i + 1}: {told}, pulled in {1e3 * travel:.3f} mm")
    return lines


def strain_line(equilibrium: Equilibrium) -> str:
    """The peak strain of the wall with its place, beside what the wall bears where that is known."""
    body = equilibrium._dense.manipulator
    if not equilibrium.has_wall:
        return "peak strain of the wall: not known, the body has no outer_radius"
    bears = "" if body.yield_strain is None else f" (yield_strain {shown(body.yield_strain, 'strain')})"
    return f"peak strain of the wall {_peak(equilibrium)}{bears}"


def _peak(equilibrium: Equilibrium) -> str:
    return f"{100 * float(equilibrium.peak_strain):.4g} % at s = {shown(equilibrium.peak_strain_at, 'length')}"


def last_lines(equilibrium: Equilibrium, doubts: Sequence[str] = ()) -> list[str]:
    """The error estimate, and as warnings `doubts` and what leaves the numbers but has to be known."""
    warned = [*doubts, *remarks_on(equilibrium)]
    error = f"error estimate {float(equilibrium.error_estimate):.1e}{'' if warned else '; successful'}"
    return [error, *(f"warning: {text}" for text in warned)]


def remarks_on(equilibrium: Equilibrium) -> tuple[str, ...]:
    """See `Equilibrium.remarks`."""
    if not is_single(equilibrium):
        raise ValueError("remarks: needs one equilibrium, not a batch and not traced; take one lane out of it")
    if not np.isfinite(equilibrium.tip_angle):
        return ()
    told = [] if equilibrium.stable else [RESULTS[RESULTS.unstable]]
    wrong = [str(i) for i, contradicted in enumerate(equilibrium.direction_contradicted, 1) if contradicted]
    told += [f"tendon {i}: {RESULTS[RESULTS.direction_contradicted]}" for i in wrong]
    return *told, *wall_remarks(equilibrium)


def wall_remarks(equilibrium: Equilibrium) -> list[str]:
    """On a wall that is strained too much or touches itself; none where there is no solution."""
    return [*_on_strain(equilibrium), *_on_contact(equilibrium)]


def _on_strain(equilibrium: Equilibrium) -> list[str]:
    body = equilibrium._dense.manipulator
    if body.yield_strain is None or not equilibrium.has_wall or not equilibrium.peak_strain > body.yield_strain:
        return []
    return [
        f"The wall is strained by {_peak(equilibrium)}, more than its yield_strain of "
        f"{shown(body.yield_strain, 'strain')}: the body does not come back straight. Lower the tension or the loads."
    ]


def _on_contact(equilibrium: Equilibrium) -> list[str]:
    contact = self_contact(equilibrium)
    if contact is None:
        return []
    one, other = shown(contact.arc_length, "length"), shown(contact.other, "length")
    return [
        f"The body touches itself, s = {one} at s = {other}, and the model knows no contact. "
        "Lower the tension or the loads."
    ]


# --- a manipulator -------------------------------------------------------------------------------


def manipulator_in_words(manipulator: Manipulator) -> str:
    """Dimensions, material and tendons; of a batch or under jit the names and shapes of what it holds."""
    leaves = jax.tree.leaves(manipulator)
    if any(isinstance(leaf, Tracer) for leaf in leaves) or np.ndim(manipulator.length) > 0:
        return eqx.tree_pformat(manipulator)
    length = float(manipulator.length)
    numbers: dict[str, Dimension] = {"density": "density", "drag": "force per length", "yield_strain": "strain"}
    plain = [name for name in ("stiffness_factor", "friction_coefficient") if getattr(manipulator, name) is not None]
    modulus = manipulator.youngs_modulus
    material = [] if modulus is None or callable(modulus) else [f"youngs_modulus {shown(modulus, 'pressure')}"]
    material += [f"{name} {float(getattr(manipulator, name)):.5g}" for name in plain]
    for name, dimension in numbers.items():
        if getattr(manipulator, name):
            material.append(f"{name} {shown(getattr(manipulator, name), dimension)}")
    return "\n".join(
        [
            f"Manipulator of {shown(length, 'length')}, {manipulator.kinematics} kinematics",
            *(
                f"{name} {_profile(as_profile(getattr(manipulator, name)), length, kind)}"
                for name, kind in _PROFILES.items()
                if getattr(manipulator, name) is not None and (name != "youngs_modulus" or callable(modulus))
            ),
            ", ".join(material),
            *(
                f"point mass {i}: {shown(point.mass, 'mass')} at s = {shown(point.arc_length, 'length')}"
                for i, point in enumerate(manipulator.point_masses, 1)
            ),
            *(f"tendon {i}: {_tendon(tendon, length)}" for i, tendon in enumerate(manipulator.tendons, 1)),
        ]
    )


def _tendon(tendon: Any, length: float) -> str:
    parts = [f"offset {_profile(tendon.offset, length if tendon.end is None else float(tendon.end))}"]
    parts.append(f"side {tendon.side:+d}")
    numbers: dict[str, Dimension] = {"end": "length", "axial_stiffness": "force", "free_length": "length"}
    numbers |= {"drag": "force per length"}
    if tendon.friction_coefficient is not None:
        parts.append(f"friction_coefficient {float(tendon.friction_coefficient):.5g}")
    for name, dimension in numbers.items():
        if getattr(tendon, name):
            parts.append(f"{name} {shown(getattr(tendon, name), dimension)}")
    return ", ".join(parts)


def _profile(profile: Profile, length: float, kind: Dimension = "length") -> str:
    """A profile by its values at the base and the tip, and what lies between."""
    if isinstance(profile, Constant):
        return shown(profile.value, kind)
    s = np.linspace(0.0, length, 201)
    values = np.asarray(profile(s))
    ends = f"{shown(values[0], kind)} at the base, {shown(values[-1], kind)} at s = {shown(length, 'length')}"
    if isinstance(profile, Linear):
        return ends
    form = f"{type(profile).__name__}, " if isinstance(profile, Piecewise | Polyline | Spline) else ""
    return f"{ends} ({form}from {shown(values.min(), kind)} to {shown(values.max(), kind)})"
