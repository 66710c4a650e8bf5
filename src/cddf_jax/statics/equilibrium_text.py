"""The text that `print` shows for an equilibrium: numbers with units, in a few lines."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jax.core import Tracer

from ..units import shown
from .contact import self_contact
from .equilibrium import Dense, Equilibrium, ended_as, on_host
from .status import Status, words_of

_FAR_TOO_MUCH = 10.0  # offset * curvature; a larger value is probably due to a wrong unit
_ROUNDING = 1e-9  # places whose numbers differ by less are equally bad
_RATIO_OF_MATERIALS = 0.5  # the largest Poisson's ratio of an isotropic material
# statuses of solves whose numbers are kept and may be wrong; `remarks_on` adds further warnings
_DOUBTED = (Status.crossing, Status.inaccurate, Status.slack, Status.unreachable, Status.undetermined)


def equilibrium_in_words(equilibrium: Equilibrium) -> str:
    """The results of one solve; for a batch or under jit the names and shapes of the fields."""
    if not is_single(equilibrium):
        return eqx.tree_pformat(equilibrium)
    equilibrium = on_host(equilibrium)
    if not np.isfinite(equilibrium.tip_angle):
        return f"no equilibrium: {result_in_words(equilibrium)}"
    pulled = [f"base tension {tension:.4f} N" for tension in equilibrium.base_tension]
    doubts = [result_in_words(equilibrium)] if ended_as(equilibrium, *_DOUBTED) else []
    lines = [tip_line(equilibrium), *tendon_lines(equilibrium, pulled), strain_line(equilibrium)]
    return "\n".join([*lines, *last_lines(equilibrium, doubts)])


def is_single(equilibrium: Equilibrium) -> bool:
    """Whether it is one solve whose numbers are known."""
    return not isinstance(equilibrium.tip_angle, Tracer) and np.ndim(equilibrium.tip_angle) == 0


def tip_line(equilibrium: Equilibrium) -> str:
    """Position and angle of the tip."""
    place = ", ".join(f"{x:.3f}" for x in 1e3 * np.asarray(equilibrium.tip_position))
    against = " from the axis of the base" if equilibrium.in_space else ""
    return f"tip at ({place}) mm, {np.degrees(equilibrium.tip_angle):.3f} deg{against}"


def tendon_lines(equilibrium: Equilibrium, pulled: Sequence[str]) -> list[str]:
    """One line for each tendon.

    Args:
        equilibrium: one solve.
        pulled: the first words about each tendon, for its base tension; may be empty.
    """
    lines = []
    for i, travel in enumerate(equilibrium.tendon_displacement):
        base, tip, loss = equilibrium.base_tension[i], equilibrium.tip_tension[i], equilibrium.tension_loss[i]
        tension = f"tip tension {tip:.4f} N, loss {100 * loss:.2f} %" if base > 0 else "no tension"
        words = ", ".join([part for part in (pulled[i], tension) if part])
        lines.append(f"tendon {i + 1}: {words}, pulled in {1e3 * travel:.3f} mm")
    return lines


def strain_line(equilibrium: Equilibrium) -> str:
    """The peak strain of the wall and its arc length, beside the yield strain where that is known."""
    body = equilibrium._dense.manipulator
    if not equilibrium.has_wall:
        return "peak strain of the wall: not known, the body has no outer_radius"
    bears = "" if body.yield_strain is None else f" (yield_strain {shown(body.yield_strain, 'strain')})"
    return f"peak strain of the wall {_peak(equilibrium)}{bears}"


def _peak(equilibrium: Equilibrium) -> str:
    return f"{100 * float(equilibrium.peak_strain):.4g} % at s = {shown(equilibrium.peak_strain_at, 'length')}"


def last_lines(equilibrium: Equilibrium, doubts: Sequence[str] = ()) -> list[str]:
    """The error estimate, and as warnings the `doubts` and the remarks."""
    warned = [*doubts, *remarks_on(equilibrium)]
    error = f"error estimate {float(equilibrium.error_estimate):.1e}{'' if warned else '; successful'}"
    return [error, *(f"warning: {text}" for text in warned)]


def remarks_on(equilibrium: Equilibrium) -> tuple[str, ...]:
    """See `Equilibrium.remarks`."""
    if not is_single(equilibrium):
        raise ValueError("remarks: needs one equilibrium, not a batch and not traced; take one lane out of it")
    if not np.isfinite(equilibrium.tip_angle):
        return ()
    equilibrium = on_host(equilibrium)
    found = [] if equilibrium.stable else [words_of(Status.unstable)]
    wrong = [str(i) for i, contradicted in enumerate(equilibrium.direction_contradicted, 1) if contradicted]
    found += [f"tendon {i}: {words_of(Status.direction_contradicted)}" for i in wrong]
    return *found, *_on_material(equilibrium), *wall_remarks(equilibrium)


def wall_remarks(equilibrium: Equilibrium) -> list[str]:
    """Remarks on a wall that is strained too much or touches itself; none where there is no solution."""
    return [*_on_strain(equilibrium), *_on_contact(equilibrium)]


def _on_material(equilibrium: Equilibrium) -> list[str]:
    ratio = equilibrium._dense.manipulator.poissons_ratio
    if not equilibrium.in_space or not ratio > _RATIO_OF_MATERIALS:
        return []
    return [
        f"poissons_ratio = {float(ratio):.3g} is above {_RATIO_OF_MATERIALS}, the most that a material can have: it "
        "stands for a body that is soft in torsion or shear. Correct it if it was meant for the material."
    ]


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


def result_in_words(equilibrium: Equilibrium) -> str:
    """How a single solve ended, in words; empty if it was successful."""
    message = words_of(equilibrium.status)
    if ended_as(equilibrium, Status.crossing):
        message = f"{describe_crossing(equilibrium)}. {message}"
    if ended_as(equilibrium, Status.load_limit):
        message = (
            f"An equilibrium was found up to {100 * float(equilibrium.load_fraction):.3g} % of the loads. {message}"
        )
    if ended_as(equilibrium, Status.slack, Status.unreachable):
        missed = ", ".join(f"{miss:.4g}" for miss in np.asarray(equilibrium.target_miss))
        message = f"The nearest that can be reached misses the targets by {missed} (SI). {message}"
    return message


def describe_crossing(equilibrium: Equilibrium) -> str:
    """Where offset * curvature is largest on the inside of a bend, as "tendon 1: offset * curvature is 1.08 at ..."."""
    body, cut = equilibrium._dense.manipulator, equilibrium.elements
    ends = cut.edges[:-1] + cut.nudge, cut.edges[1:] - cut.nudge  # of the elements, where a joint may be
    s = np.concatenate([np.asarray(equilibrium.arc_length), *map(np.asarray, ends)])
    inside = np.asarray(_inside_of_bend(equilibrium._dense, s))
    reach = np.asarray([body.length if tendon.end is None else tendon.end for tendon in body.tendons])[:, None]
    crossing = np.where(s <= reach, inside, 0.0)
    most = np.max(crossing)
    tendon, point = np.argwhere(crossing >= (1 - _ROUNDING) * most)[0]
    hint = "; is the modulus in Pa, are lengths in m?" if most > _FAR_TOO_MUCH else ""
    what = "offset * curvature less stretch" if body.extensible else "offset * curvature"
    return f"tendon {tendon + 1}: {what} is {most:.3g} at s = {shown(s[point], 'length')}{hint}"


_inside_of_bend = eqx.filter_jit(Dense.inside_of_bend)
