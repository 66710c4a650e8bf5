"""What `cddf solve` reads at the command line, and what it says in the end."""

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np

from .contact import self_contact
from .equilibrium import RESULTS, Equilibrium, SolveError
from .errors import InputError
from .loads import Loads
from .manipulator import Manipulator
from .printing import last_lines, strain_line, tendon_lines, tip_line
from .statics import solve
from .targets import CurvatureAt, Displacement, Target, TipAngle, TipStiffness, TipTension, TotalTension
from .units import Dimension, quantity, shown, vector


class _Kind(NamedTuple):
    """A target as it is written at the command line."""

    make: Any
    dimension: Dimension
    example: str


TARGETS = {
    "displacement": _Kind(Displacement, "length", "displacement=12 mm"),
    "tip_angle": _Kind(TipAngle, "angle", "tip_angle=45 deg"),
    "tip_tension": _Kind(TipTension, "force", "tip_tension=40 N"),
    "curvature": _Kind(CurvatureAt, "curvature", "curvature=8 1/m at 70 mm"),
    "total_tension": _Kind(TotalTension, "force", "total_tension=100 N"),
    "tip_stiffness": _Kind(TipStiffness, "stiffness", "tip_stiffness=350 N/m"),
}
_NAME_OF = {kind.make: name for name, kind in TARGETS.items()}


# --- reading -------------------------------------------------------------------------------------


def read_actuation(texts: Sequence[str], manipulator: Manipulator) -> list[Any]:
    """Tensions (N) and targets out of texts such as "75 N" and "tip_angle=45 deg": one for all tendons or one each.

    Raises:
        InputError: names the option, the text and the remedy.
    """
    entries = [_entry(text, manipulator) for text in texts]
    count = manipulator.num_tendons
    if any(isinstance(entry, Target) for entry in entries):
        if len(entries) != count:
            raise InputError(
                f"--base-tension: {len(entries)} given with a target among them; "
                f"give one tension or target for each of {count}"
            )
        return entries
    return per_tendon("--base-tension", entries, count)


def per_tendon(option: str, values: list[Any], count: int) -> list[Any]:
    """The values of an option that may be given once for all tendons."""
    if len(values) not in (1, count):
        raise InputError(f"{option}: {len(values)} given; give one for all, or one for each of {count}")
    return values * count if len(values) == 1 else values


def _entry(text: str, manipulator: Manipulator) -> Any:
    name, equals, value = (part.strip() for part in text.partition("="))
    if equals:
        return _target(text, name, value, manipulator)
    if (first := name.split(" ")[0]) in TARGETS:
        raise InputError(f"--base-tension {text!r}: write a target with = as in {TARGETS[first].example!r}")
    tension = quantity(text, "force", "--base-tension")
    if tension < 0:
        raise InputError(f"--base-tension {text!r}: a tendon cannot push; give 0 N or more")
    return tension


def _target(text: str, name: str, value: str, manipulator: Manipulator) -> Target:
    if name not in TARGETS:
        close = get_close_matches(name, TARGETS, 1)
        remedy = f"did you mean {close[0]}?" if close else f"known are {', '.join(TARGETS)}"
        raise InputError(f"--base-tension {text!r}: unknown target {name!r}; {remedy}")
    kind, what = TARGETS[name], f"--base-tension {name}"
    if name == "curvature":
        return _curvature(text, value, manipulator)
    wanted = quantity(value, kind.dimension, what)
    if name in ("tip_tension", "total_tension") and wanted < 0:
        raise InputError(f"--base-tension {text!r}: a tendon cannot push; give 0 N or more")
    if name == "tip_stiffness" and wanted <= 0:
        raise InputError(f"--base-tension {text!r}: a stiffness is positive; give more than 0 N/m")
    return kind.make(wanted)


def _curvature(text: str, value: str, manipulator: Manipulator) -> CurvatureAt:
    curvature, at, place = value.partition(" at ")
    if not at:
        raise InputError(
            f"--base-tension {text!r}: say where the curvature is wanted as in {TARGETS['curvature'].example!r}"
        )
    arc_length = quantity(place.strip(), "length", "--base-tension curvature at")
    if not 0 <= arc_length <= float(manipulator.length):
        raise InputError(
            f"--base-tension {text!r}: {place.strip()} is not on the body; "
            f"give an arc length from 0 mm to {shown(manipulator.length, 'length')}"
        )
    return CurvatureAt(quantity(curvature.strip(), "curvature", "--base-tension curvature"), arc_length)


def read_loads(tip_force: str | None, tip_moment: str | None, gravity: str | None, has_weight: bool) -> Loads | None:
    """Dead loads out of texts such as "0 N, -5 N", "0.1 N m" and "0, -9.81 m/s^2"; None where no text is given.

    Args:
        tip_force, tip_moment, gravity: as typed.
        has_weight: whether the body has a mass.

    Raises:
        InputError: for text that is none of that, and for gravity on a body without mass.
    """
    given: dict[str, Any] = {}
    if tip_force is not None:
        given["tip_force"] = vector(tip_force, "force", "--tip-force")
    if tip_moment is not None:
        given["tip_moment"] = quantity(tip_moment, "moment", "--tip-moment")
    if gravity is not None:
        given["gravity"] = vector(gravity, "acceleration", "--gravity")
        if any(given["gravity"]) and not has_weight:
            raise InputError(
                f"--gravity {gravity!r}: the body has no weight, since its density is 0; "
                'give in its file density = "1070 kg/m^3", mass_per_length = "0.12 kg/m" or a [[point_mass]]'
            )
    return Loads(**given) if given else None


# --- solving -------------------------------------------------------------------------------------


def solve_or_explain(
    manipulator: Manipulator, actuation: list[Any], loads: Loads | None, texts: Sequence[str], **options: Any
) -> Equilibrium:
    """As `solve`; an unstable equilibrium comes back, and of a target that is missed the nearest value is told.

    Args:
        manipulator: the body and its tendons.
        actuation: what `read_actuation` makes of `texts`.
        loads: dead loads, or None.
        texts: what was given for --base-tension.
        options: of `solve`.

    Raises:
        SolveError: where there is no answer.
    """
    try:
        return solve(manipulator, actuation, loads, **options)
    except SolveError:
        equilibrium = solve(manipulator, actuation, loads, throw=False, **options)
        if equilibrium.result == RESULTS.unstable:
            return equilibrium
        if equilibrium.result in (RESULTS.slack, RESULTS.unreachable):
            raise SolveError(_nearest(actuation, equilibrium, texts)) from None
        raise


def _nearest(actuation: list[Any], equilibrium: Equilibrium, texts: Sequence[str]) -> str:
    """How near to its targets a solve came, and at which tensions."""
    slack = equilibrium.result == RESULTS.slack
    why = "the tendon would have to push" if slack else "no tension between slack and crossing fibres gives it"
    missed = []
    numbers = zip(actuation, texts, equilibrium.target_miss, equilibrium.base_tension, strict=True)
    for target, text, miss, tension in numbers:
        if isinstance(target, Target):
            value = shown(target.value + miss, TARGETS[_NAME_OF[type(target)]].dimension)
            missed.append(f"--base-tension {text!r}: {why}, the nearest is {value} at {shown(tension, 'force')}")
    return f"{'; '.join(missed)}; change the target"


# --- saying --------------------------------------------------------------------------------------


def as_dict(equilibrium: Equilibrium, actuation: list[Any], loads: Loads | None) -> dict[str, Any]:
    """Everything about an equilibrium, SI units, for JSON; loads and targets where there are any."""
    names = (
        *("tip_tension", "tension_loss", "tip_position", "tip_angle", "tendon_displacement", "base_tension"),
        *("target_miss", "base_moment", "load_fraction", "num_load_steps", "stable", "error_estimate"),
        *("num_iterations", "direction", "direction_contradicted", "arc_length", "curvature", "heading", "position"),
        *("tension", "wrap_angle", "normal_force", "friction_force"),
    )
    asked: dict[str, Any] = {"result": RESULTS[equilibrium.result] or "successful", "remarks": equilibrium.remarks}
    if any(isinstance(entry, Target) for entry in actuation):
        asked["targets"] = [_target_dict(entry) if isinstance(entry, Target) else None for entry in actuation]
    if loads is not None:
        asked["loads"] = {name: getattr(loads, name) for name in ("tip_force", "tip_moment", "gravity")}
    contact = self_contact(equilibrium)
    asked["self_contact"] = None if contact is None else contact._asdict()
    strain = ("peak_strain", "peak_strain_at")
    asked |= {name: getattr(equilibrium, name) if equilibrium.has_wall else None for name in strain}
    return asked | {name: getattr(equilibrium, name) for name in names}


def _target_dict(target: Target) -> dict[str, Any]:
    place = {"arc_length": target.arc_length} if isinstance(target, CurvatureAt) else {}
    return {_NAME_OF[type(target)]: target.value} | place


def in_words(equilibrium: Equilibrium, actuation: list[Any], texts: Sequence[str], loads: Loads | None) -> str:
    """The answer for people."""
    found = [
        f"base tension {tension:.4f} N gives {texts[i].strip()}" if isinstance(actuation[i], Target) else ""
        for i, tension in enumerate(equilibrium.base_tension)
    ]
    lines = [tip_line(equilibrium), *tendon_lines(equilibrium, found), strain_line(equilibrium)]
    lines += _loads_in_words(loads, equilibrium) if loads is not None else []
    return "\n".join([*lines, *last_lines(equilibrium)])


def _loads_in_words(loads: Loads, equilibrium: Equilibrium) -> list[str]:
    force, gravity = ("({:.5g}, {:.5g})".format(*np.asarray(pair)) for pair in (loads.tip_force, loads.gravity))
    steps = int(equilibrium.num_load_steps)
    return [
        f"loads: tip force {force} N, tip moment {shown(loads.tip_moment, 'moment')}, gravity {gravity} m/s^2; "
        f"put on in {steps} step{'s' if steps > 1 else ''}",
        f"moment of the loads at the base: {shown(equilibrium.base_moment, 'moment')}",
    ]
