"""A fit as people read it: report.md with its figures, and results.json beside it."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import figures
from ..batch.drafts import check_folder
from ..errors import InputError
from ..estimation.determination import NOT_IDENTIFIED, Determination
from ..estimation.profile_likelihood import Profile
from ..files.manipulator_file import manipulator_text
from ..files.writing import markdown_table, picked
from ..identification.curves import tables_without_numbers
from ..identification.fit import Fit
from ..identification.parameters import TRIALS, unit_of
from ..identification.verdict import parameter_shown, shown_unit
from ..measurements.columns import column_dimension
from ..measurements.table import Measurements
from ..progress import each, stage
from ..robot.manipulator import Manipulator
from ..units import preferred
from .report import Content, Report, versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# of results.json
OF_FIT = (
    *("result", "success", "verdict", "warnings", "noise", "noise_model", "noise_estimated", "input_noise"),
    *("neighbours", "trial_effects", "trial_spread", "moved_by_steps", "reduced_chi_square"),
    *("degrees_of_freedom", "log_likelihood", "information_criteria", "restarted", "num_steps"),
)
OF_DETERMINATION = (
    *("names", "value", "standard_error", "confidence_interval", "status", "combinations", "sums", "correlation"),
    *("rank", "condition_number"),
)


def profiles_of(fit: Fit) -> dict[str, Profile]:
    """The profile of each fitted parameter, which takes some seconds; none of a fit that failed."""
    return {name: fit.profile(name) for name in each("profile", fit.own_names)} if fit.success else {}


# --- results.json --------------------------------------------------------------------------------


def fit_as_dict(fit: Fit, profiles: Mapping[str, Profile]) -> dict[str, Any]:
    """All results and all inputs of a fit, SI units, for JSON, where an infinite number becomes null."""
    return {
        **_determination_as_dict(fit),
        **picked(fit, OF_FIT),
        "alone": {name: _determination_as_dict(determination) for name, determination in fit.alone.items()},
        "without_jitter": fit.without_jitter,
        "cost_from_each_start": fit.starts,
        "profiles": profiles,
        "data": [_table_as_dict(table) for table in fit.tables],
        "manipulator": _as_toml(fit.model.manipulator),
        "kinematics": fit.manipulator.kinematics,
        "options": fit.options,
        "versions": versions(),
    }


def _table_as_dict(table: Measurements) -> dict[str, object]:
    named = {"files": table.files or (table.name,), "rows": len(table), "sha256": table.checksum}
    named |= {"markers": {name: marker._asdict() for name, marker in table.markers.items()}} if table.markers else {}
    return picked(table, ("name", "simulated", "read_as")) | named


def _determination_as_dict(found: Determination) -> dict[str, object]:
    units = {name: unit_of(name) for name in (*found.names, *found.identified_together)}
    return {"unit": units} | picked(found, OF_DETERMINATION)


def _as_toml(manipulator: Manipulator) -> str | None:
    """The text of a file of the manipulator at the start of the search; None for profiles that no file can hold."""
    for outside in (False, True):
        with suppress(InputError):
            return manipulator_text(manipulator, offsets_outside_wall=outside)
    return None


# --- the report -----------------------------------------------------------------------------------


def write_fit(fit: Fit, folder: str | Path) -> None:
    """Write report.md, results.json and the figures (PDF and PNG) into a folder, all of them or none.

    Args:
        fit: of `fit`.
        folder: made if it is missing.

    Raises:
        InputError: if the folder cannot be written, before the profiles are computed.
    """
    check_folder(Path(folder))
    fit_report(fit, profiles_of(fit)).write(folder)


def fit_report(fit: Fit, profiles: Mapping[str, Profile]) -> Report:
    """The answer of `cddf fit`, with those profiles that were computed."""

    def files() -> dict[str, Content]:
        drawn, missing = report_figures(fit, profiles)
        return {"report.md": fit_as_markdown(fit, profiles, (*drawn,), missing), **drawn}

    failure = "" if fit.success else f"the fit failed: {fit.result}"
    return Report("results", fit_in_words(fit), fit_as_dict(fit, profiles), files, failure)


@stage("drawing")
def report_figures(fit: Fit, profiles: Mapping[str, Profile]) -> "tuple[dict[str, Figure], dict[str, str]]":
    """The figures by file name, and the reasons of those that are missing."""
    drawn, missing = figures.table_figures(fit), tables_without_numbers(fit)
    if missing:
        missing["residuals"] = "the model gave no numbers for some rows"
    else:
        drawn["residuals"] = figures.residuals_figure(fit)
    if profiles:
        drawn["profiles"] = figures.profiles_figure(fit, profiles)
    else:
        missing["profiles"] = "none were computed" if fit.success else f"the fit failed: {fit.result}"
    return drawn, missing


# --- words ---------------------------------------------------------------------------------------


def fit_in_words(fit: Fit) -> str:
    """The report for the terminal."""
    lines = list(fit.verdict)
    if alone := _each_alone(fit):
        lines += ["", "each table alone determines:", *(f"  {line}" for line in alone)]
    lines += [f"simulated data: {simulated}"] if (simulated := _simulated_names(fit)) else []
    lines.append(f"kinematics: {fit.manipulator.kinematics}")
    return "\n".join(lines + [f"warning: {warning}" for warning in fit.warnings])


def fit_as_markdown(
    fit: Fit, profiles: Mapping[str, Profile], drawn: Sequence[str] = (), missing: Mapping[str, str] | None = None
) -> str:
    """The report: first in words what was determined and what was not, then the numbers.

    `drawn` are the names of the figures beside it, and `missing` the reasons of those that are not there.
    """
    later = [warning for warning in fit.warnings if warning not in fit.remarks]  # remarks are in the first lines
    sections = [
        ("Profiles", _profiles(profiles)),
        ("Each table alone determines", _bullets(_each_alone(fit))),
        ("Trials", _trials(fit)),
        ("Noise", _noise(fit)),
        ("Warnings", _bullets(later)),
        ("What was stated about the bench", _bullets(_stated(fit))),
        ("Figures", _figures(drawn, missing or {})),
        ("How the files were read", _bullets(line for table in fit.tables for line in table.read_as)),
    ]
    lines = [*_in_short(fit), ""]
    if fit.moved_by_steps:
        most = f"{max(fit.moved_by_steps.values()):.2g} of their standard errors"
        lines.append(f"The increments of the history move the estimates by at most {most}.")
    criteria = ", ".join(f"{name} {value:.5g}" for name, value in fit.information_criteria.items())
    lines += [f"Reduced chi-square {fit.reduced_chi_square:.3g}; {criteria}.", ""]
    for title, own in sections:
        lines += [f"## {title}", "", *own, ""] if own else []
    foot = "results.json holds what is needed to repeat this fit: manipulator, options, checksums, versions.\n"
    return "\n".join([*lines, foot])


def _each_alone(fit: Fit) -> list[str]:
    """What each of several tables determines by itself, one line each."""
    lines = []
    for table, alone in fit.alone.items() if len(fit.tables) > 1 else ():
        parts = [f"{name} {status}" for name, status in alone.status.items() if not name.startswith(TRIALS)]
        together = alone.identified_together.items()
        parts += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g} {unit_of(name)}" for name, e in together]
        lines.append(f"{table}: {'; '.join(parts)}")
    return lines


def _bullets(lines: Iterable[str]) -> list[str]:
    return [f"- {line}" for line in lines]


def _in_short(fit: Fit) -> list[str]:
    lines = _bullets([*fit.verdict, *(text for text in fit.warnings if text in fit.remarks)])
    if simulated := _simulated_names(fit):
        lines += ["", f"The data are simulated: {simulated}."]
    head = ("parameter", "value", "standard error", "95 % interval", "status")
    return ["# What the measurements determine", "", *lines, "", *markdown_table(head, parameter_rows(fit))]


def _simulated_names(fit: Fit) -> str:
    return ", ".join(table.name for table in fit.tables if table.simulated)


def parameter_rows(determination: Determination) -> list[list[str]]:
    """Name, value, standard error, interval and status of each parameter and combination."""
    rows = []
    for name, status in determination.status.items():
        if status == NOT_IDENTIFIED:
            rows.append([name, "-", "-", "-", status])
            continue
        value, error, low, high, unit = parameter_shown(determination, name)
        spread = [f"{error:.2g}{unit}", f"{low:.5g} to {high:.5g}{unit}"] if np.isfinite(error) else ["-", "-"]
        rows.append([name, f"{value:.5g}{unit}", *spread, status])
    for name, (value, error, (low, high)) in determination.identified_together.items():
        unit = unit_of(name)
        numbers = f"{value:.5g} {unit}", f"{error:.2g} {unit}", f"{low:.5g} to {high:.5g} {unit}"
        rows.append([name, *numbers, "identified"])
    return rows


def _profiles(profiles: Mapping[str, Profile]) -> list[str]:
    rows = []
    for name, profile in profiles.items():
        scale, unit = shown_unit(name)
        ends = zip(profile.confidence_interval, profile.closed, profile.model_ends, strict=True)
        rows.append([name, *(_end_in_words(scale * end, unit, closed, gone) for end, closed, gone in ends)])
    text = "95 % intervals without assuming linearity: a parameter is held at one value after another, the others are "
    return [f"{text}fitted again.", "", *markdown_table(("parameter", "from", "to"), rows)] if rows else []


def _end_in_words(end: float, unit: str, closed: bool, model_ends: bool) -> str:
    if model_ends:
        return f"open; no solution beyond {end:.5g}{unit}"
    if not closed:
        return f"{end:.5g}{unit} (bound)" if np.isfinite(end) else "open"
    return f"{end:.5g}{unit}"


def _trials(fit: Fit) -> list[str]:
    effects = fit.trial_effects.items()
    rows = [[name, f"{100 * e.value:+.2f} %", f"{100 * e.standard_error:.2g} %"] for name, e in effects]
    spread = f"standard deviation over trials {100 * fit.trial_spread:.2g} %."
    table = markdown_table(("trial", "friction", "standard error"), rows)
    return [f"Friction of each trial relative to the mean; {spread}", "", *table] if rows else []


def _noise(fit: Fit) -> list[str]:
    rows = []
    for label, deviation in (fit.noise | fit.input_noise).items():
        scale, unit = preferred(column_dimension(label.rpartition(": ")[2]) or "dimensionless")
        kind = "the same for all"
        if label in fit.noise_model:
            floor, fraction = (part or 0.0 for part in fit.noise_model[label])
            kind = f"{scale * floor:.3g} {unit} and {100 * fraction:.3g} % of the value"
        if label in fit.input_noise:
            kind = (
                "estimated" if label in fit.evidence.estimated_inputs else "as given" if deviation else "none is seen"
            )
        rows.append([label, f"{scale * deviation:.3g} {unit}", kind])
    kind = "estimated from the residuals" if fit.noise_estimated else "as given"
    text = f"Noise {kind}; {fit.degrees_of_freedom} degrees of freedom; rank {fit.rank}; {fit.result}."
    return [*markdown_table(("data", "standard deviation", "made of"), rows), "", text]


def _figures(drawn: Sequence[str], missing: Mapping[str, str]) -> list[str]:
    """The figures, and why others are missing."""
    pictures = [f"![{name.replace('_', ' ')}]({name}.png)" for name in drawn]
    reasons = [f"- No figure of {name.replace('_', ' ')}: {reason}." for name, reason in missing.items()]
    return [*pictures, *([""] if pictures and reasons else []), *reasons]


def _stated(fit: Fit) -> list[str]:
    lines = [f"Kinematics {fit.manipulator.kinematics}.", *fit.options["setting"].in_words]
    lines += [f"marker {n} of {t.name}: {m}" for t in fit.tables for n, m in t.markers.items()]
    named = zip(fit.model.names, fit.model.experiments, strict=True)
    courses = {name: one.course for name, one in named if one.course is not None}
    if courses:
        past = [words for course in courses.values() for words in course.past_in_words]
        past = past if len(set(past)) > 1 else past[:1]  # "rest", or where trials differ "rest, 80 N"
        lines.append(f"With history: {', '.join(courses)}. Before the first row: {', '.join(past)}.")
    return lines
