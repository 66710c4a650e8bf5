"""A fit as people read it: report.md with its figures, and results.json beside it."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import figures
from ..batch.drafts import check_folder
from ..errors import InputError
from ..estimation.determination import NOT_IDENTIFIED, Determination
from ..estimation.profile_likelihood import Profile
from ..files.manipulator_file import manipulator_text
from ..files.writing import markdown_table, picked
from ..identification.bench import Bench
from ..identification.curves import tables_without_numbers
from ..identification.fit import Fit
from ..identification.parameters import TRIALS, unit_of
from ..identification.predictions import correlated_names, own_names
from ..identification.verdict import parameter_shown, shown_unit
from ..measurements.columns import column_dimension
from ..measurements.table import Measurements
from ..progress import each, stage
from ..robot.manipulator import Manipulator
from ..units import preferred, shown
from .report import Content, Report, versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..identification.model_free import ModelFreeFriction


LEAST_ROWS = 3  # for friction without a model
LARGEST_AWAY = 3.0  # standard errors of a fit from friction without a model: beyond, the report says what to check
# of results.json
OF_FIT = (
    *("result", "success", "verdict", "warnings", "noise", "noise_model", "noise_estimated", "input_noise"),
    *("serial_correlation", "neighbours", "tip_misfits"),
    *("trial_effects", "trial_spread", "moved_by_steps", "mean_relative_error", "reduced_chi_square"),
    *("degrees_of_freedom", "log_likelihood", "information_criteria", "restarted", "num_steps"),
)
OF_DETERMINATION = (
    *("names", "value", "standard_error", "confidence_interval", "status", "combinations", "sums", "correlation"),
    *("rank", "condition_number", "sloppy_direction"),
)
OF_FRICTION = ("value", "standard_error", "confidence_interval", "verdict")


class WithoutModel(NamedTuple):
    """Friction from a table without a model of the body, and how far the fit lies from it."""

    found: "ModelFreeFriction"
    away: float | None  # standard errors; None where the fit does not tell the friction

    @property
    def said(self) -> str:
        """In words."""
        if self.away is None:
            return ""
        check = "; check kinematics, the offset of the tendon, and the zeros of the cells and the camera"
        return f"the fit lies {abs(self.away):.1f} standard errors from it" + check * (abs(self.away) > LARGEST_AWAY)


class FitResults(NamedTuple):
    """A fit and the results that belong to it."""

    fit: Fit
    profiles: dict[str, Profile]  # by fitted parameter; none of a fit that failed
    model_free: dict[str, WithoutModel]  # by table


def make_report(fit: Fit, *, with_profiles: bool = True) -> FitResults:
    """Compute all that a report contains; profiles take some seconds."""
    profiles = (
        {name: fit.profile(name) for name in each("profile", own_names(fit))} if fit.success and with_profiles else {}
    )
    return FitResults(fit, profiles, _without_model(fit))


def _without_model(fit: Fit) -> dict[str, WithoutModel]:
    """Friction without a model of the body from each table whose trials begin at rest, where it can be told."""
    from ..identification.model_free import model_free_friction

    body, mu, found = fit.manipulator, "friction_coefficient", {}
    if body.kinematics != "exact" or body.num_tendons > 1 or body.slanted:
        return {}
    for name, table, one in zip(fit.model.names, fit.tables, fit.model.experiments, strict=True):
        bench = one if isinstance(one, Bench) else None
        at_rest = bench is None or bench.course is None or bench.course.past is None
        if at_rest and len(table) >= LEAST_ROWS:
            with suppress(InputError):  # a column is missing, or no row is bent
                free = model_free_friction(table, in_order=bench is not None and bool(bench.in_order))
                error = float(np.hypot(free.standard_error, fit.standard_error.get(mu, np.inf)))
                away = (fit.value[mu] - free.value) / error if 0 < error < np.inf else None
                found[name] = WithoutModel(free, away)
    return found


# --- results.json --------------------------------------------------------------------------------


def fit_as_dict(results: FitResults) -> dict[str, Any]:
    """All results and all inputs of a fit, SI units, for JSON, where an infinite number becomes null."""
    fit = results.fit
    return {
        **_determination_as_dict(fit),
        **picked(fit, OF_FIT),
        "alone": {name: _determination_as_dict(determination) for name, determination in fit.alone.items()},
        "without_jitter": fit.without_jitter,
        "cost_from_each_start": fit.starts,
        "profiles": results.profiles,
        "model_free_friction": {
            name: picked(one.found, OF_FRICTION) | {"standard_errors_away": one.away, "unit": "1"}
            for name, one in results.model_free.items()
        },
        "data": [_table_as_dict(table) for table in fit.tables],
        "manipulator": _as_toml(fit.model.manipulator),
        "kinematics": fit.manipulator.kinematics,
        "options": fit.options,
        "versions": versions(),
    }


def _table_as_dict(table: Measurements) -> dict[str, object]:
    named = {"files": table.files or (table.name,), "rows": len(table), "sha256": table.checksum}
    named |= {"markers": {name: marker._asdict() for name, marker in table.markers.items()}} if table.markers else {}
    return picked(table, ("name", "simulated", "read_as")) | named | {"holds_averaged": table.holds_averaged}


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
    fit_report(make_report(fit)).write(folder)


def fit_report(results: FitResults) -> Report:
    """The answer of `cddf fit`."""
    fit = results.fit

    def files() -> dict[str, Content]:
        drawn = report_figures(results)
        return {"report.md": fit_as_markdown(results, tuple(drawn)), **drawn}

    failure = "" if fit.success else f"the fit failed: {fit.result}"
    return Report("results", fit_in_words(results), fit_as_dict(results), files, failure)


@stage("drawing")
def report_figures(results: FitResults) -> "dict[str, Figure]":
    """The figures by file name; `left_out` says why others are missing."""
    fit, missing = results.fit, left_out(results)
    drawn = figures.table_figures(fit)
    if "residuals" not in missing:
        drawn["residuals"] = figures.residuals_figure(fit)
    if "profiles" not in missing:
        drawn["profiles"] = figures.profiles_figure(fit, results.profiles)
    return drawn


def left_out(results: FitResults) -> dict[str, str]:
    """The reasons for missing figures, by name."""
    fit = results.fit
    reasons = tables_without_numbers(fit)
    if not all(np.all(np.isfinite(residual)) for residual in fit.residuals.values()):
        reasons["residuals"] = "the model gave no numbers for some rows"
    if not results.profiles:
        reasons["profiles"] = "none were asked for" if fit.success else f"the fit failed: {fit.result}"
    return reasons


# --- words ---------------------------------------------------------------------------------------


def fit_in_words(results: FitResults) -> str:
    """The report for the terminal."""
    fit = results.fit
    lines = list(fit.verdict)
    for title, entries in _also_said(results).items():
        lines += ["", f"{title}:", *(f"  {entry}" for entry in entries)]
    lines += [short_steps_in_words(fit)] if fit.moved_by_steps else []
    lines += [f"simulated data: {simulated}"] if (simulated := _simulated_names(fit)) else []
    lines.append(f"kinematics: {fit.manipulator.kinematics}")
    return "\n".join(lines + [f"warning: {warning}" for warning in fit.warnings])


def fit_as_markdown(results: FitResults, drawn: Sequence[str] | None = None) -> str:
    """The report: first in words what was determined and what was not, then the numbers.

    `drawn` are the names of the figures beside it; None if no figures are made.
    """
    fit = results.fit
    later = [warning for warning in fit.warnings if warning not in fit.remarks]  # remarks are in the first lines
    also = [(title[0].upper() + title[1:], _bullets(entries)) for title, entries in _also_said(results).items()]
    sections = [
        ("Correlation", _correlation(fit)),
        ("Profiles", _profiles(results)),
        *also,
        ("Trials", _trials(fit)),
        ("Noise", _noise(fit)),
        ("Without a model of the body", _bullets(_model_free_in_words(results))),
        ("Warnings", _bullets(later)),
        ("What was stated about the bench", _bullets(_stated(fit))),
        ("Figures", [] if drawn is None else _figures(results, drawn)),
        ("How the files were read", _bullets(line for table in fit.tables for line in table.read_as)),
    ]
    lines = [*_in_short(results), "", *_goodness(fit), ""]
    for title, own in sections:
        lines += [f"## {title}", "", *own, ""] if own else []
    foot = "results.json holds what is needed to repeat this fit: manipulator, options, checksums, versions.\n"
    return "\n".join([*lines, foot])


def _also_said(results: FitResults) -> dict[str, list[str]]:
    """What the terminal and the report say beside the verdict, by title."""
    fit, said = results.fit, {}
    if len(fit.tables) > 1:
        alone = fit.alone.items()
        said["each table alone determines"] = [f"{name}: {determination_in_words(found)}" for name, found in alone]
    return said


def _bullets(lines: Iterable[str]) -> list[str]:
    return [f"- {line}" for line in lines]


def _in_short(results: FitResults) -> list[str]:
    fit, remarks = results.fit, results.fit.remarks
    lines = [f"- {line}" for line in (*fit.verdict, *(text for text in fit.warnings if text in remarks))]
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


def _goodness(fit: Fit) -> list[str]:
    lines = []
    if np.isfinite(fit.mean_relative_error):
        error = f"{100 * fit.mean_relative_error:.3g} %"
        lines.append(f"Mean relative error of the tip tensions, the measure of Liu et al. (2020): {error}.")
    criteria = ", ".join(f"{name} {value:.5g}" for name, value in fit.information_criteria.items())
    if fit.moved_by_steps:
        lines.append(short_steps_in_words(fit))
    return [*lines, f"Reduced chi-square {fit.reduced_chi_square:.3g}; {criteria}."]


def short_steps_in_words(fit: Fit) -> str:
    """The error that the increments of a history leave."""
    most = max(fit.moved_by_steps.values())
    return f"The increments of the history move the estimates by at most {most:.2g} of their standard errors."


def _correlation(fit: Fit) -> list[str]:
    names = correlated_names(fit)
    places = [fit.names.index(name) for name in names]
    rows = [[name, *(f"{fit.correlation[i, k]:.4f}" for k in places)] for name, i in zip(names, places, strict=True)]
    return markdown_table(("parameter", *names), rows) if len(names) > 1 else []


def _profiles(results: FitResults) -> list[str]:
    rows = []
    for name, profile in results.profiles.items():
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


def determination_in_words(determination: Determination) -> str:
    """One line."""
    parts = [f"{name} {status}" for name, status in determination.status.items() if not name.startswith(TRIALS)]
    together = determination.identified_together.items()
    parts += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g} {unit_of(name)}" for name, e in together]
    return "; ".join(parts)


def _trials(fit: Fit) -> list[str]:
    effects = fit.trial_effects.items()
    rows = [[name, f"{100 * e.value:+.2f} %", f"{100 * e.standard_error:.2g} %"] for name, e in effects]
    spread = f"standard deviation over trials {100 * fit.trial_spread:.2g} %."
    table = markdown_table(("trial", "friction", "standard error"), rows)
    return [f"Friction of each trial relative to the mean; {spread}", "", *table] if rows else []


def _noise(fit: Fit) -> list[str]:
    head = ("data", "standard deviation", "made of", "correlation from row to row of a hold", "count as independent")
    rows = []
    for label, deviation in fit.noise.items():
        scale, unit = preferred(column_dimension(label.rpartition(": ")[2]) or "dimensionless")
        alike, made_of = fit.serial_correlation[label], "the same for all"
        if label in fit.noise_model:
            floor, fraction = (part or 0.0 for part in fit.noise_model[label])
            made_of = f"{scale * floor:.3g} {unit} and {100 * fraction:.3g} % of the value"
        independent = f"{alike.num_effective:.0f} of {alike.num_readings}"
        size = f"{scale * deviation:.3g} {unit}"
        rows.append([label, size, made_of, f"{alike.lag_one:.2f}".replace("nan", "-"), independent])
    for label, deviation in fit.input_noise.items():
        kind = "estimated" if label in fit.evidence.estimated_inputs else "as given" if deviation else "none is seen"
        scale, unit = preferred(column_dimension(label.rpartition(": ")[2]) or "dimensionless")
        rows.append([label, f"{scale * deviation:.3g} {unit}", kind, "-", "-"])
    kind = "estimated from the residuals" if fit.noise_estimated else "as given"
    text = f"Noise {kind}; {fit.degrees_of_freedom} degrees of freedom; rank {fit.rank}; {fit.result}."
    tips = [
        f"{name}: the tip is off by {shown(one.in_plane, 'length')} in the plane of bending and by "
        f"{shown(one.across, 'length')} across it (root mean squares)."
        for name, one in fit.tip_misfits.items()
    ]
    return [*markdown_table(head, rows), "", text, *(["", *_bullets(tips)] if tips else [])]


def _model_free_in_words(results: FitResults) -> list[str]:
    every = results.model_free.items()
    return [f"{name}: {line}" for name, one in every for line in (*one.found.verdict, one.said) if line]


def _figures(results: FitResults, drawn: Sequence[str]) -> list[str]:
    """The figures, and why others are missing."""
    pictures = [f"![{name.replace('_', ' ')}]({name}.png)" for name in drawn]
    missing = [f"- No figure of {name.replace('_', ' ')}: {reason}." for name, reason in left_out(results).items()]
    return [*pictures, *([""] if pictures and missing else []), *missing]


def _stated(fit: Fit) -> list[str]:
    lines = [f"Kinematics {fit.manipulator.kinematics}.", *fit.setting.in_words]
    lines += [f"marker {n} of {t.name}: {m}" for t in fit.tables for n, m in t.markers.items()]
    named = zip(fit.model.names, fit.model.experiments, strict=True)
    courses = {name: one.course for name, one in named if isinstance(one, Bench) and one.course is not None}
    if courses:
        past = [words for course in courses.values() for words in course.past_in_words]
        past = past if len(set(past)) > 1 else past[:1]  # "rest", or where trials differ "rest, 80 N"
        lines.append(f"With history: {', '.join(courses)}. Before the first row: {', '.join(past)}.")
    return lines + (["Holds were averaged."] if any(table.holds_averaged for table in fit.tables) else [])
