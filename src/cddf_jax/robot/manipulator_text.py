"""What `print` shows of a manipulator: numbers with units, in a few lines."""

from collections.abc import Sequence

import numpy as np

from ..quantities import dimension_of
from ..units import Dimension, shown
from .manipulator import Manipulator, Tendon
from .profiles import Constant, Linear, Piecewise, Polyline, Profile, Spline, as_profile

_PROFILES = (
    *("outer_radius", "inner_radius", "bending_stiffness", "torsional_stiffness", "axial_stiffness", "shear_stiffness"),
    *("mass_per_length", "youngs_modulus"),
)
_STRAINS = ("twist", "about y", "about z")
_ALSO_ZERO = ("friction_coefficient", "poissons_ratio")
_MATERIAL = ("youngs_modulus", "stiffness_factor", "friction_coefficient", "density", "drag", "yield_strain")
_OF_TENDON = ("friction_coefficient", "end", "axial_stiffness", "free_length", "drag")


def manipulator_in_words(manipulator: Manipulator) -> str:
    """Dimensions, material and tendons of one body whose numbers are known.

    Raises:
        TypeError: for a batch or traced numbers.
    """
    if any(np.ndim(number) for number in (manipulator.length, manipulator.friction_coefficient)):
        raise TypeError("a batch has no words")
    length = float(manipulator.length)
    varies, known, kind = callable(manipulator.youngs_modulus), _MATERIAL, f"{manipulator.kinematics} kinematics"
    if manipulator.in_space:
        known = (*known[:2], "axial_factor", "shear_factor", "poissons_ratio", *known[2:])
        kind = "in space, its axis stretches and shears" if manipulator.extensible else "in space"
    return "\n".join(
        [
            f"Manipulator of {shown(length, 'length')}, {kind}",
            *(
                f"{name} {_profile(as_profile(getattr(manipulator, name)), length, dimension_of(name))}"
                for name in _PROFILES
                if getattr(manipulator, name) is not None and (name != "youngs_modulus" or varies)
            ),
            *(
                f"rest_curvature {name} {_profile(part, length, 'curvature')}"
                for name, part in zip(_STRAINS, manipulator.rest_curvature or (), strict=False)
            ),
            ", ".join(_numbers(manipulator, known[1:] if varies else known)),
            *(
                f"point mass {i}: {shown(point.mass, 'mass')} at s = {shown(point.arc_length, 'length')}"
                for i, point in enumerate(manipulator.point_masses, 1)
            ),
            *(f"tendon {i}: {_tendon(tendon, length)}" for i, tendon in enumerate(manipulator.tendons, 1)),
        ]
    )


def _numbers(owner: Manipulator | Tendon, names: Sequence[str]) -> list[str]:
    """Names and numbers that are given; zero counts as not given, except for `_ALSO_ZERO`."""
    values = {name: getattr(owner, name) for name in names}
    return [
        f"{name} {shown(value, dimension_of(name))}"
        for name, value in values.items()
        if value is not None and (value or name in _ALSO_ZERO)
    ]


def _tendon(tendon: Tendon, length: float) -> str:
    end = length if tendon.end is None else float(tendon.end)
    offset = _profile(tendon.offset, end)
    place = f"side {tendon.side:+d}" if tendon.angle is None else f"angle {_profile(tendon.angle, end, 'angle')}"
    return ", ".join([f"offset {offset}", place, *_numbers(tendon, _OF_TENDON)])


def _profile(profile: Profile, length: float, kind: Dimension = "length") -> str:
    """A profile by its values at both ends, its form and its range."""
    if isinstance(profile, Constant):
        return shown(profile.value, kind)
    s = np.linspace(0.0, length, 201)
    values = np.asarray(profile(s))
    ends = f"{shown(values[0], kind)} at the base, {shown(values[-1], kind)} at s = {shown(length, 'length')}"
    if isinstance(profile, Linear):
        return ends
    form = f"{type(profile).__name__}, " if isinstance(profile, Piecewise | Polyline | Spline) else ""
    return f"{ends} ({form}from {shown(values.min(), kind)} to {shown(values.max(), kind)})"
