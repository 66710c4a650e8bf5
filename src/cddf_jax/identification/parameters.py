"""The parameters of a fit: their names and units, where the search starts, and the body with given parameters.

They are the numbers of the manipulator, and the errors of the instruments and dimensions of its bench. Known numbers of
a bench are given by its setting.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..errors import InputError
from ..measurements.markers import Marker
from ..measurements.readings import tendon_number
from ..numerics.given_numbers import check_numbers
from ..quantities import dimension_of
from ..robot.loads import Loads, point_in_words
from ..robot.manipulator import Manipulator, Tendon
from ..robot.profiles import shifted
from ..units import Dimension, shown, si_unit
from .tension_before import PARAMETER, is_past

TRIALS = "trial_deviation"  # ln(mu of a trial / mu), one each
CAMERA = "camera"  # all parameters of the pose of the camera together

Parameters = Mapping[str, ArrayLike]  # numbers by name; TRIALS has one for each trial


class Parameter(NamedTuple):
    """A parameter that can be fitted."""

    name: str
    start: float | None  # usual value, where the search starts; None: the manipulator's own value
    positive: bool
    scale: float  # a size that matters, for a parameter that may be 0; SI

    @property
    def dimension(self) -> Dimension:
        return dimension_of(self.name)


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        Parameter("friction_coefficient", None, True, 1.0),
        Parameter("youngs_modulus", None, True, 1.0),
        Parameter("stiffness_factor", 1.0, True, 1.0),  # of a body without a single modulus
        Parameter("poissons_ratio", None, True, 1.0),  # of a body in space: torsion, and shear, beside bending
        Parameter("axial_factor", 1.0, True, 1.0),  # of a body that stretches
        Parameter("shear_factor", 1.0, True, 1.0),
        Parameter("length", None, True, 1.0),
        Parameter("drag", 1.0, True, 1.0),
        Parameter("outer_radius_error", 0.0, False, 1e-4),  # true less stated radius, the same along the whole body
        Parameter("tendon_offset_error", 0.0, False, 1e-4),
        Parameter("base_gain", 1.0, True, 0.02),
        Parameter("tip_gain", 1.0, True, 0.02),
        Parameter("base_zero", 0.0, False, 0.5),
        Parameter("tip_zero", 0.0, False, 0.5),
        Parameter("pretension", 1.0, True, 0.5),  # of every tendon; the cells read 0 there
        Parameter("slack_offset", 0.0, False, 1e-3),  # the displacement, as read, at which a tendon begins to pull
        Parameter("outside_compliance", 1e-5, True, 1e-5),  # of the tendon and all that it pulls on outside the body
        Parameter("tendon_stretch", 1e-5, True, 1e-5),  # 1 / (E A) of the tendon, on the body and outside
        Parameter("outside_friction", 0.1, True, 0.1),  # there, mu times the angle of a sheath or pulleys
        Parameter("outside_drag", 0.1, True, 0.1),  # there, a force that does not depend on the tension
        Parameter("friction_moment", 1e-3, True, 1e-3),  # of the body
        Parameter("backlash", 1e-4, True, 1e-4),  # way back of the motor before the tendon follows
        Parameter("lag", 0.0, False, 0.1),  # time by which the body comes after the motor
        Parameter("angle_zero", 0.0, False, 0.02),
        Parameter("tendon_angle_error", 0.0, False, 0.02),  # of a body in space
        *(Parameter(f"camera_{axis}", 0.0, False, 1e-3) for axis in "xyz"),  # the origin of measured positions
        *(Parameter(f"camera_turn_{axis}", 0.0, False, 0.02) for axis in "xyz"),  # rotation, see `markers.seen`
        *(Parameter(f"gravity_turn_{axis}", 0.0, False, 0.02) for axis in "xyz"),  # rotation: axis times angle
        Parameter(PARAMETER, 1.0, True, 0.5),  # the largest base tension before the first row, as read
    )
}
OUT_OF_PLANE = tuple(f"{name}_{axis}" for name in ("camera_turn", "gravity_turn") for axis in "xy")
OF_SPACE = ("poissons_ratio", "tendon_angle_error", "camera_z", *OUT_OF_PLANE)
OF_STRETCH = ("axial_factor", "shear_factor")
OUTSIDE = ("outside_compliance", "outside_friction", "outside_drag")  # of a tendon, between body and actuator
NO_STRETCH = 1e-30  # 1/N, of a tendon that does not stretch, so that derivatives there are finite
OF_TENDONS = (  # each tendon may have its own
    *("base_gain", "tip_gain", "base_zero", "tip_zero", "slack_offset", "tendon_angle_error", "tendon_stretch"),
    *OUTSIDE,
)
RUBBING = ("friction_moment", "outside_friction", "outside_drag")  # friction besides that of tendons on the body
MOTORS = ("backlash", "lag")  # between a motor and its tendon
_OF_BODY = {field.name for field in fields(Manipulator)}


def along_a_path(manipulator: Manipulator, parameters: Sequence[str]) -> list[str]:
    """Which parameters, free or given, and numbers of the manipulator have an effect along a history only."""
    own = [
        name
        for name in RUBBING
        if any(getattr(owner, name, None) is not None for owner in (manipulator, *manipulator.tendons))
    ]
    given = [parameter_named(name).name for name in parameters if not name.startswith(TRIALS)]
    given = [name for name in given if name in (*RUBBING, *MOTORS)]
    return [*dict.fromkeys([*own, *given])]


def stiffness_parameter(manipulator: Manipulator) -> str:
    """The name of the parameter of stiffness: the modulus if it is one number, else the factor on the stiffness."""
    modulus = manipulator.youngs_modulus
    return "stiffness_factor" if modulus is None or callable(modulus) else "youngs_modulus"


def camera_parameters(manipulator: Manipulator) -> tuple[str, ...]:
    """The pose of the camera: shift and turn, of six numbers in space and three in the plane."""
    axes, turns = {2: ("xy", "z"), 3: ("xyz", "xyz")}[manipulator.components]
    return (*(f"{CAMERA}_{axis}" for axis in axes), *(f"{CAMERA}_turn_{axis}" for axis in turns))


def free_parameters(manipulator: Manipulator, free: Sequence[str] | str | None) -> tuple[str, ...]:
    """The names of the free parameters; those of friction and stiffness for None, and of its pose for "camera".

    Raises:
        InputError: for an unknown name, or a parameter that this body does not have.
    """
    names = ("friction_coefficient", stiffness_parameter(manipulator)) if free is None else free
    names = (names,) if isinstance(names, str) else names
    pose = camera_parameters(manipulator)
    names = tuple(dict.fromkeys(one for name in names for one in (pose if name == CAMERA else (name,))))
    for name in names:
        parameter_named(name)
    if "youngs_modulus" in names and stiffness_parameter(manipulator) != "youngs_modulus":
        raise InputError("the body has no single youngs_modulus; fit stiffness_factor, which multiplies its stiffness")
    for kinds, has, remedy in (
        (OF_SPACE, manipulator.in_space, "in space; give its tendons an angle"),
        (OF_STRETCH, manipulator.extensible, "that stretches; make it extensible"),
    ):
        if lacking := [name for name in names if parameter_named(name).name in kinds and not has]:
            raise InputError(f"{lacking[0]} has an effect only on a body {remedy}, or do not fit this parameter")
    if "outer_radius_error" in names and not manipulator.stiffened_by_radii:
        raise InputError("outer_radius_error changes nothing where bending_stiffness is given; fit stiffness_factor")
    return names


def check_tendons(names: Iterable[str], num_tendons: int) -> None:
    """Refuse parameters of tendons that a body does not have.

    Raises:
        InputError: names the first one.
    """
    for name in names:
        if name != parameter_named(name).name and not is_past(name) and not 1 <= tendon_number(name) <= num_tendons:
            raise InputError(f"{name}: there is no such tendon, the body has {num_tendons}; they count from 1")


def starting_value(manipulator: Manipulator, name: str, given: Mapping[str, float] | None = None) -> float:
    """Where the search for a parameter starts: at the given value, or else at the manipulator's or the usual one."""
    start = parameter_named(name).start
    if given and name in given:
        return float(given[name])
    own = getattr(manipulator, name, None)
    stem, number = parameter_named(name).name, tendon_number(name) - 1
    if stem == "tendon_stretch":
        own = manipulator.tendon_compliance[number]
    if stem in OUTSIDE:
        compliance = manipulator.tendon_outside_compliance[number]
        own = compliance if stem == "outside_compliance" else getattr(manipulator.tendons[number], stem)
    return float(own) if own is not None and (start is None or own > 0) else float(start or 0.0)


def with_parameters(manipulator: Manipulator, parameters: Parameters) -> Manipulator:
    """The manipulator with these numbers and corrected dimensions; parameters of the bench are ignored."""
    names = tuple(name for name in parameters if hasattr(manipulator, name))
    numbers = [parameters[name] for name in names]
    body = eqx.tree_at(lambda m: [getattr(m, n) for n in names], manipulator, numbers, is_leaf=lambda x: x is None)
    if "outer_radius_error" in parameters:
        radius = shifted(body.outer_radius, parameters["outer_radius_error"])
        body = eqx.tree_at(lambda m: m.outer_radius, body, radius)
    if any(name.startswith("tendon_angle_error") for name in parameters):
        body = body.with_angles()
    given = {parameter_named(name).name for name in parameters if not name.startswith(TRIALS)}
    tendons = [_tendon_with(parameters, given, i, tendon) for i, tendon in enumerate(body.tendons, 1)]
    return eqx.tree_at(lambda m: m.tendons, body, tuple(tendons))


def _tendon_with(parameters: Parameters, given: Collection[str], number: int, tendon: Tendon) -> Tendon:
    """The tendon of this number with its own or the common parameters; `given`: the names without numbers."""

    def own(name: str, otherwise: ArrayLike | None = 0.0) -> Any:
        return own_or_common(parameters, name, number, otherwise)

    changed = {name: own(name, getattr(tendon, name)) for name in OUTSIDE if name in given}
    if "tendon_offset_error" in given:
        changed["offset"] = shifted(tendon.offset, own("tendon_offset_error"))
    if "tendon_angle_error" in given and tendon.angle is not None:
        changed["angle"] = shifted(tendon.angle, own("tendon_angle_error"))
    if "tendon_stretch" in given:
        stiffness = tendon.axial_stiffness
        stretch = own("tendon_stretch", 0.0 if stiffness is None else 1.0 / stiffness)
        changed["axial_stiffness"] = 1.0 / (stretch + NO_STRETCH)
    return replace(tendon, **changed)


def with_deviation(manipulator: Manipulator, deviation: Float[Array, ""] | None) -> Manipulator:
    """The manipulator with the friction of one trial; `deviation` is ln(mu of the trial / mu), or None."""
    if deviation is None:
        return manipulator
    mu = jnp.asarray(manipulator.friction_coefficient) * jnp.exp(deviation)
    return eqx.tree_at(lambda m: m.friction_coefficient, manipulator, mu)


def own_or_common(parameters: Parameters, name: str, tendon: int, otherwise: ArrayLike | None) -> Any:
    """A parameter that tendons may have each: `base_gain_2` for tendon 2, or else `base_gain` of all."""
    return parameters.get(f"{name}_{tendon}", parameters.get(name, otherwise))


def of_all_tendons(parameters: Parameters, name: str, tendons: int) -> Float[Array, " tendons"]:
    """As `own_or_common`, for all tendons; where it is no parameter, the usual value."""
    usual = PARAMETERS[name].start
    return jnp.stack([jnp.asarray(own_or_common(parameters, name, i, usual)) for i in range(1, tendons + 1)])


def turn_of(parameters: Parameters, name: str) -> Float[Array, " 3"] | None:
    """The three components of a rotation or shift; None where none of them is a parameter."""
    own = [f"{name}_{axis}" for axis in "xyz"]
    if not any(one in parameters for one in own):
        return None
    return jnp.stack([jnp.asarray(parameters.get(one, 0.0)) for one in own])


@dataclass(frozen=True)
class BenchSetting:
    """What all rows of a bench share.

    Args:
        loads: constant ones, such as gravity, in the fixed frame at the base; forces of the rows are added.
        markers: by the name after the @ in the columns: `x@head` is the first coordinate of markers["head"]. A column
            such as `x@120mm` needs no entry here.
        given: known numbers of the bench by the names of their parameters, SI units: for instance `tip_gain`, or the
            pose of the camera. If such a parameter is fitted, its search starts there.
    """

    loads: Loads | None = None
    markers: Mapping[str, Marker] = field(default_factory=dict)
    given: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        for name, value in self.given.items():
            if parameter_named(name).name in _OF_BODY or is_past(name):
                raise InputError(
                    f"given: {name} does not belong to the bench; give it with the manipulator or the trials"
                )
            check_numbers(f"given: {name}", value)
            if not np.isfinite(value):
                raise InputError(f"given: {name} must be finite, got {value!r}")
        for name, marker in self.markers.items():
            check_numbers(f"markers: {name}", marker)
            if not 2 <= len(marker.offset) <= 3 or not np.all(np.isfinite([marker.arc_length, *marker.offset])):
                raise InputError(f"markers: {name} needs an arc length and an offset (x, y) or (x, y, z), got {marker}")

    @property
    def in_words(self) -> list[str]:
        """The setting in words, one line for each entry."""
        lines = [f"{name} = {shown(value, parameter_named(name).dimension)}" for name, value in self.given.items()]
        if self.loads is not None:
            own = self.loads.tip_force, self.loads.tip_moment, self.loads.gravity
            force, moment, gravity = (", ".join(f"{x:.5g}" for x in np.atleast_1d(value)) for value in own)
            lines.append(f"loads in all rows: tip force {force} N, tip moment {moment} N m, gravity {gravity} m/s^2")
            lines += [f"in all rows a {point_in_words(point)}" for point in self.loads.points]
        return lines + [f"marker {name}: {marker}" for name, marker in self.markers.items()]


PLAIN = BenchSetting()


def unit_of(name: str) -> str:
    """The SI unit of a parameter, of a product of powers of parameters, or of a sum of two; for instance "1/Pa".

    It is "1" for a plain number, and "" for an unknown name.
    """
    name = re.split(" [+-] ", name)[0]
    above, below = [], []
    for slash, stem, power in re.findall(r"(/ )?([^\s*/^]+)(?:\^(\S+))?", name):
        try:
            unit = "1" if stem == "1" or stem.startswith(TRIALS) else si_unit(parameter_named(stem).dimension)
        except InputError:
            return ""
        if unit != "1":
            whole = f"({unit})" if "/" in unit or " " in unit else unit
            (below if slash else above).append(f"{whole}^{power}" if power else whole if slash else unit)
    return "".join([" ".join(above) or "1", *(f"/{unit}" for unit in below)])


def parameter_named(name: str) -> Parameter:
    """The parameter of this name.

    `tip_gain_2` is `tip_gain` of tendon 2, and `before_2` is `before` of trial 2.

    Raises:
        InputError: for an unknown name.
    """
    stem, _, tendon = name.rpartition("_")
    if tendon.isdigit() and stem in OF_TENDONS:
        name = stem
    name = PARAMETER if is_past(name) else name
    if name not in PARAMETERS:
        raise InputError(
            f"{name!r} is not a parameter that can be fitted; there are {', '.join((*PARAMETERS, CAMERA))}"
        )
    return PARAMETERS[name]
