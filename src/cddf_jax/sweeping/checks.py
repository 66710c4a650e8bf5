"""What a sweep refuses before anything is solved: each message names the argument and the remedy.

What `solve` and `trace` refuse themselves is not looked at here.
"""

from difflib import get_close_matches
from typing import TYPE_CHECKING

import jax
import numpy as np

from ..errors import InputError
from ..mechanics.march import FixedPoint
from ..numerics.given_numbers import check_numbers
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.validation import check_loads
from ..statics.arguments import refuse_batch
from ..statics.named_numbers import Case, holds, stem_and_tendon
from ..statics.targets import Target, TipPosition
from .axes import ALONG_A_PATH, OPTIONS, RESERVED
from .one_solve import IN_SPACE, OUTPUTS

if TYPE_CHECKING:
    from .sweep import Sweep


def _check_kinds(work: "Sweep") -> None:
    """Refuse arguments of wrong types."""
    if not isinstance(work.manipulator, Manipulator):
        raise InputError(
            f"sweep: manipulator must be a Manipulator, such as that of read_manipulator, got {work.manipulator!r}"
        )
    if work.loads is not None and not isinstance(work.loads, Loads):
        raise InputError(f"sweep: loads must be Loads, as in Loads(tip_force=(0.0, -1.0)), got {work.loads!r}")
    check_numbers("sweep: base_tension", jax.tree.leaves(work.base_tension))
    if work.memory is not None and not (isinstance(work.memory, int | float) and work.memory > 0):
        raise InputError(f"sweep: memory must be a number of bytes above 0, as in memory=2e9, got {work.memory!r}")
    if work.chunk_size is not None and (not isinstance(work.chunk_size, int) or work.chunk_size < 1):
        raise InputError(f"sweep: chunk must be a whole number of 1 or more, got {work.chunk_size!r}")


def _check_history(work: "Sweep") -> None:
    """Refuse what cannot be traced."""
    among = [dimension.name for dimension in work.pulled]
    if not among:
        raise InputError('sweep: history needs the axis "base_tension", whose values are the path')
    if work.path is None:
        which = ", ".join(map(repr, among))
        raise InputError(
            f"sweep: base tensions vary along {which}; give as history the name of the axis that is the path "
            "(--history-axis)"
        )
    beside = [name for name in (*work.path.numbers, *work.path.options) if not name.startswith(ALONG_A_PATH)]
    if beside:
        raise InputError(f"sweep: only base tensions and loads vary along a path, not {beside[0]}; give it an axis")
    numbers = {name for d in work.dimensions for name in (*d.numbers, *d.options)}
    given = {"direction": work.direction, "observables": work.observables or None}
    others = [name for name, value in given.items() if value is not None]
    others += [name for name in numbers if name.startswith(("direction", "method"))]
    others += [name for name in work.sensitivities if name.startswith(ALONG_A_PATH)]
    if others or not isinstance(work.method, FixedPoint):
        what = others[0] if others else "method"
        raise InputError(f"sweep: with history there is no {what}; leave it out")
    if work.in_increments:
        _check_increments(work)


def _check_increments(work: "Sweep") -> None:
    """Refuse what cannot be followed in increments."""
    entries = jax.tree.leaves(work.case.base_tension, is_leaf=lambda entry: isinstance(entry, Target))
    if any(isinstance(entry, Target | TipPosition) for entry in entries):
        raise InputError("sweep: with history base_tension must hold tensions, N, in place of targets")


def check_sweep(work: "Sweep") -> None:
    """Refuse what cannot be solved or is not known."""
    _check_kinds(work)
    refuse_batch("sweep", work.manipulator)
    if work.history:
        _check_history(work)
    known = {name for dimension in work.dimensions for name in (dimension.name, *dimension.numbers)}
    if work.base_tension is not None and "base_tension" in known:
        raise InputError("sweep: base_tension is given and an axis; leave one out")
    for name in work.outputs:
        if name not in work.known_outputs:
            of = " of a history" if work.history else " in space" if work.case.in_space else ""
            raise InputError(f"sweep: {name!r} is not an output{of}; there are {', '.join(work.known_outputs)}")
    for name in (*work.outputs, *work.observables):
        if name in known:
            raise InputError(f"sweep: {name!r} is an axis and an output; take it out of the outputs")
    for name in work.observables:
        if name in OUTPUTS | IN_SPACE or name in RESERVED or "/" in name:
            raise InputError(f"sweep: no observable can be called {name!r}; give it another name")
        if not callable(work.observables[name]):
            raise InputError(f"sweep: the observable {name!r} must be a function of an Equilibrium")
    if not work.outputs and not work.observables:
        raise InputError("sweep: nothing is asked for; name an output such as 'tip_tension'")
    if not all(np.all(np.abs(stated) == 1) for stated in jax.tree.leaves(work.case.direction)):
        raise InputError(f"sweep: direction is 1 for sliding in and -1 for sliding out, got {work.direction!r}")
    _check_names(work, work.case)


def _check_names(work: "Sweep", case: Case) -> None:
    """Refuse names that are not numbers of the case, and numbers that have no effect."""
    swept = {name for dimension in work.dimensions for name in dimension.numbers}
    for name in swept:
        case.number(name)
    # an output such as the strain of the wall depends on the outer radius itself
    wall_is_seen = bool(work.observables) or not {"peak_strain", "peak_strain_at"}.isdisjoint(work.outputs)
    for name, remedy in _idle(swept, case, wall_is_seen).items():
        raise InputError(f"sweep: {name!r} has no effect here; {remedy}")
    if case.base_tension is None and "base_tension" not in swept:
        raise InputError("sweep: base_tension is neither given nor an axis; give one of the two")
    for name in work.sensitivities:
        if name in OPTIONS or stem_and_tendon(name)[0] == "direction":
            raise InputError(f"sweep: nothing can be differentiated by {name!r}; take it out of the sensitivities")
        if case.number(name) is None and name not in swept:
            raise InputError(f"sweep: the case has no {name!r} to differentiate by; give it a value")
        wider = [other for other in swept if holds(other, name) or holds(name, other)]
        if wider:
            close = get_close_matches(name, wider, 1) or wider
            raise InputError(f"sweep: {name!r} and the axis {close[0]!r} overlap; differentiate by {close[0]!r} itself")


def _idle(swept: set[str], case: Case, wall_is_seen: bool) -> dict[str, str]:
    """Numbers that have no effect on the answer, each with the remedy."""
    found: dict[str, str] = {}
    if "yield_strain" in swept:
        found["yield_strain"] = "it only says when a solve warns; ask for the output peak_strain"
    for i, tendon in enumerate(case.manipulator.tendons):
        stiff = tendon.axial_stiffness is None and f"tendons.{i}.axial_stiffness" not in swept
        if f"tendons.{i}.free_length" in swept and stiff:
            found[f"tendons.{i}.free_length"] = "the tendon does not stretch; give it an axial_stiffness"
    body, loads = case.manipulator, case.loads
    for name in ("friction_coefficient", "drag"):
        if name in swept and all(getattr(tendon, name) is not None for tendon in body.tendons):
            found[name] = f"every tendon has its own; let 'tendons.0.{name}' vary"
    gravity = {name for name in swept if name.startswith("loads.gravity.")}
    weightless = loads is None or not np.any(np.asarray(loads.gravity))
    masses = {name for name in swept if name.split(".")[0] in ("density", "mass_per_length", "point_masses")}
    if masses and not gravity and weightless:
        found[min(masses)] = "there is no gravity; give loads=Loads(gravity=(0.0, -9.81))"
    if gravity and not masses and not body.has_mass:
        found[min(gravity)] = "the body has no weight; give it density, mass_per_length or point_masses"
    if not masses and not gravity:
        check_loads(body, loads)
    if "poissons_ratio" in swept and not case.in_space:
        found["poissons_ratio"] = "it matters in space; give the tendons an angle"
    for name in sorted(swept & {"axial_factor", "shear_factor"}):
        if not body.extensible:
            found[name] = "the axis does not stretch; make the body extensible"
    dense = "density" in swept or np.any(np.asarray(body.density))
    if not body.stiffened_by_radii and not (dense and (gravity or not weightless)):
        for name in sorted(swept):
            if name.startswith("inner_radius") or (name.startswith("outer_radius") and not wall_is_seen):
                found[name] = "the bending_stiffness of this body is given beside it; let that vary"
    return found
