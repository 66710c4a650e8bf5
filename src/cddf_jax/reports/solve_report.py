"""The answer of `cddf solve`."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike

from .. import figures
from ..files.manipulator_file import RobotFile
from ..files.writing import picked
from ..quantities import dimension_of
from ..robot.loads import Loads, gravity_in_words, point_in_words
from ..statics.contact import self_contact
from ..statics.equilibrium import Equilibrium
from ..statics.equilibrium_text import last_lines, strain_line, tendon_lines, tip_line
from ..statics.status import Status, in_words, words_of
from ..statics.targets import CurvatureAt, Target, TipPosition
from ..sweeping.one_solve import OUTPUTS_OF
from ..units import shown
from .export import fields_csv, fields_on_grid
from .report import Content, Report

Entries = Sequence[float | Target] | TipPosition  # the tension (N) or target of each tendon, or the place of the tip


def solve_report(
    robot: RobotFile, equilibrium: Equilibrium, actuation: Entries, texts: Sequence[str], loads: Loads | None
) -> Report:
    """The equilibrium of a robot; `texts` are the tensions and targets as they were typed."""
    answer = solve_as_dict(equilibrium, actuation, loads)
    if robot.columns:
        answer["cross_sections"] = robot.columns

    def files() -> dict[str, Content]:
        figure = figures.equilibrium_figure(robot.manipulator, equilibrium, loads)
        return {"fields.csv": fields_csv(fields_on_grid(equilibrium)), "solve": figure}

    failure = words_of(equilibrium.status) if equilibrium.status == Status.unstable else ""
    return Report("solve", solve_in_words(equilibrium, actuation, texts, loads), answer, files, failure)


def solve_as_dict(equilibrium: Equilibrium, actuation: Entries, loads: Loads | None) -> dict[str, object]:
    """Everything about an equilibrium, SI units, for JSON, with loads and targets if there are any."""
    answer: dict[str, object] = {"result": in_words(equilibrium.status), "remarks": equilibrium.remarks}
    if isinstance(actuation, TipPosition):
        answer["targets"] = [picked(actuation, ("value", "minimum_tension", "maximum_tension"))]
        answer["target_rank"] = equilibrium.target_rank
    elif any(isinstance(entry, Target) for entry in actuation):
        answer["targets"] = [_target_as_dict(entry) if isinstance(entry, Target) else None for entry in actuation]
    if loads is not None:
        answer["loads"] = loads
    answer["self_contact"] = self_contact(equilibrium)
    every = OUTPUTS_OF[len(equilibrium.tip_position)]
    known = [name for name in every if equilibrium.has_wall or not name.startswith("peak_strain")]
    return answer | dict.fromkeys(every) | picked(equilibrium, known)


def _target_as_dict(target: Target) -> dict[str, object]:
    answer: dict[str, object] = {target.quantity: target.value}
    return answer | {"arc_length": target.arc_length} if isinstance(target, CurvatureAt) else answer


def solve_in_words(equilibrium: Equilibrium, actuation: Entries, texts: Sequence[str], loads: Loads | None) -> str:
    """The answer for people; `texts` are the tensions and targets as they were typed."""
    if isinstance(actuation, TipPosition):
        found = [f"base tension {tension:.4f} N" for tension in equilibrium.base_tension]
    else:
        found = [
            f"base tension {tension:.4f} N gives {texts[i].strip()}" if isinstance(actuation[i], Target) else ""
            for i, tension in enumerate(equilibrium.base_tension)
        ]
    lines = [tip_line(equilibrium), *tendon_lines(equilibrium, found), strain_line(equilibrium)]
    if isinstance(actuation, TipPosition):
        total, rank = float(np.sum(equilibrium.base_tension)), f"{equilibrium.target_rank} of {len(actuation.value)}"
        lines.append(f"total base tension {total:.4f} N, the least found; tensions move the tip in {rank} directions")
    lines += _loads_in_words(loads, equilibrium) if loads is not None else []
    return "\n".join([*lines, *last_lines(equilibrium)])


def _loads_in_words(loads: Loads, equilibrium: Equilibrium) -> list[str]:
    loads = loads.with_components(len(equilibrium.tip_position))
    force, moment, at_base = map(_components, (loads.tip_force, loads.tip_moment, equilibrium.base_moment))
    return [
        f"loads: tip force {force} N, tip moment {moment} N m, {gravity_in_words(loads.gravity)}",
        *map(point_in_words, loads.points),
        f"moment of the loads at the base: {at_base} N m",
    ]


def _components(load: ArrayLike) -> str:
    """ "(0, -1)"; a moment in the plane has one and no brackets."""
    numbers = ", ".join(f"{x:.5g}" for x in np.atleast_1d(load))
    return f"({numbers})" if np.ndim(load) else numbers


def missed_targets_in_words(equilibrium: Equilibrium, actuation: Entries, texts: Sequence[str]) -> str:
    """The values nearest to the targets of a solve, and their tensions, in words."""
    if isinstance(actuation, TipPosition):
        near, far = equilibrium.tip_position, shown(np.linalg.norm(equilibrium.target_miss), "length")
        place = ", ".join(shown(x, "length") for x in near)
        tensions = ", ".join(shown(tension, "force") for tension in equilibrium.base_tension)
        nearest = f"the nearest found is ({place}), {far} away, at {tensions}"
        return f"--base-tension {texts[0]!r}: no allowed tensions bring the tip there, {nearest}; change the target"
    slack = equilibrium.status == Status.slack
    why = "the tendon would have to push" if slack else "no tension between slack and crossing fibres gives it"
    missed = []
    numbers = zip(actuation, texts, equilibrium.target_miss, equilibrium.base_tension, strict=True)
    for target, text, miss, tension in numbers:
        if isinstance(target, Target):
            value = shown(target.value + miss, dimension_of(target.quantity))
            missed.append(f"--base-tension {text!r}: {why}, the nearest is {value} at {shown(tension, 'force')}")
    return f"{'; '.join(missed)}; change the target"
