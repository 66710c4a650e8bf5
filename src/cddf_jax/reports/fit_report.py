"""A fit as people read it: report.md with its figures, and results.json beside it."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..batch.drafts import check_folder
from ..estimation.bootstrap import Bootstrap
from ..estimation.determination import NOT_IDENTIFIED, Determination
from ..files.writing import as_json, markdown_table, write_all
from ..identification.bench import Bench
from ..identification.fit import Fit
from ..identification.parameters import TRIALS, unit_of
from ..identification.predictions import correlated_names, moving_names, own_names, tables_without_numbers
from ..identification.verdict import error_in_words, parameter_shown, shown_unit
from ..measurements.columns import column_dimension
from ..progress import each, stage
from ..units import preferred
from .fit_results import Report, fit_as_dict, make_report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST_AWAY = 3.0  # standard errors of a fit from friction without a model: beyond, the report says what to check


def write_fit(fit: Fit, folder: str | Path, *, bootstraps: Sequence[Bootstrap] = ()) -> None:
    """Write report.md, results.json and the figures (PDF and PNG) into a folder, all of them or none.

    Args:
        fit: of `fit`.
        folder: made if it is missing.
        bootstraps: of `fit.bootstrap`, to be reported with it.

    Raises:
        InputError: if the folder cannot be written, before the profiles are computed.
    """
    check_folder(Path(folder))
    write_report(make_report(fit, bootstraps=bootstraps), folder)


def write_report(report: Report, folder: str | Path) -> None:
    """Write all of it, or nothing."""
    from ..figures.style import render

    contents: dict[str, str | bytes] = {}
    figures = report_figures(report)
    for name in each("figure", list(figures)):
        contents |= render(figures[name], name)
    contents |= {"report.md": fit_as_markdown(report, tuple(figures)), "results.json": as_json(fit_as_dict(report))}
    write_all(folder, contents)


@stage("drawing")
def report_figures(report: Report) -> "dict[str, Figure]":
    """The figures by file name; `left_out` says why others are missing."""
    from ..figures.estimates import bootstrap_figure, draw_correlation, profiles_figure
    from ..figures.fit import residuals_figure, table_figures
    from ..figures.style import figure_of

    fit, missing = report.fit, left_out(report)
    makers: dict[str, Callable[[], Figure]] = {
        "residuals": partial(residuals_figure, fit),
        "profiles": partial(profiles_figure, fit, report.profiles),
        "correlation": lambda: figure_of(draw_correlation(fit)),
    }
    makers |= {f"bootstrap_{found.kind}": partial(bootstrap_figure, fit, found) for found in report.bootstraps}
    return table_figures(fit) | {name: make() for name, make in makers.items() if name not in missing}


def left_out(report: Report) -> dict[str, str]:
    """The reasons for missing figures and tables, by name."""
    fit, failed = report.fit, f"the fit failed: {report.fit.result}"
    reasons = tables_without_numbers(fit)
    if not all(np.all(np.isfinite(residual)) for residual in fit.residuals.values()):
        reasons["residuals"] = "the model gave no numbers for some rows"
    if not report.profiles:
        reasons["profiles"] = "none were asked for" if fit.success else failed
    if not fit.success:
        reasons["correlation"] = failed
    elif len(correlated_names(fit)) < 2:
        reasons["correlation"] = "the data determine fewer than two parameters, and a correlation needs two"
    for bootstrap in report.bootstraps:
        if not moving_names(fit):
            reasons[f"bootstrap_{bootstrap.kind}"] = "every parameter lies at a bound"
        elif len(bootstrap.estimates) < 2:
            reasons[f"bootstrap_{bootstrap.kind}"] = "fewer than two refits succeeded"
    return reasons


# --- report.md -----------------------------------------------------------------------------------


def fit_as_markdown(report: Report, figures: Sequence[str] | None = None) -> str:
    """The report: first in words what was determined and what was not, then the numbers.

    `figures` are the names of the figures beside it; None if no figures are made.
    """
    fit = report.fit
    several = len(fit.tables) > 1 or len(fit.noise) > 1
    alone = [f"{name}: {determination_in_words(found)}" for name, found in fit.alone.items()] if several else []
    later = [warning for warning in fit.warnings if warning not in fit.remarks]  # remarks are in the first lines
    sections = [
        _in_short(report),
        _goodness(fit),
        _profile_section(report),
        _bootstrap_section(report),
        _bullets("What each table alone determines", alone),
        _way_back_section(fit),
        _trial_section(fit),
        _noise_section(fit),
        _bullets("Without a model of the body", _model_free_in_words(report)),
        _bullets("Warnings", later),
        _bullets("What was stated about the bench", _stated(fit)),
        _figure_section(report, figures),
        _bullets("How the files were read", [line for table in fit.tables for line in table.read_as]),
        _repeat_section(report),
    ]
    return "\n\n".join("\n".join(section) for section in sections if section) + "\n"


def _section(title: str, lines: Sequence[str]) -> list[str]:
    """A section with its title; none where there is nothing to say."""
    return [f"## {title}", "", *lines] if lines else []


def _bullets(title: str, lines: Sequence[str]) -> list[str]:
    return _section(title, [f"- {line}" for line in lines])


def _in_short(report: Report) -> list[str]:
    fit, remarks = report.fit, report.fit.remarks
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
    loss = "" if fit.loss == "linear" else f" Loss {fit.loss}."
    if fit.moved_by_steps:
        lines.append(short_steps_in_words(fit))
    return [*lines, f"Reduced chi-square {fit.reduced_chi_square:.3g}; {criteria}.{loss}"]


def short_steps_in_words(fit: Fit) -> str:
    """The error that the short steps of a history leave."""
    most = max(fit.moved_by_steps.values())
    return f"The short steps of the history move the estimates by at most {most:.2g} of their standard errors."


def _profile_section(report: Report) -> list[str]:
    if not report.profiles:
        return []
    rows = []
    for name, profile in report.profiles.items():
        scale, unit = shown_unit(name)
        ends = zip(profile.confidence_interval, profile.closed, profile.model_ends, strict=True)
        rows.append([name, *(_end_in_words(scale * end, unit, closed, gone) for end, closed, gone in ends)])
    text = "95 % intervals without assuming linearity: a parameter is held at one value after another, the others are "
    text += "fitted again."
    return _section("Profiles", [text, "", *markdown_table(("parameter", "from", "to"), rows)])


def _end_in_words(end: float, unit: str, closed: bool, model_ends: bool) -> str:
    if model_ends:
        return f"open; no solution beyond {end:.5g}{unit}"
    if not closed:
        return f"{end:.5g}{unit} (bound)" if np.isfinite(end) else "open"
    return f"{end:.5g}{unit}"


def _bootstrap_section(report: Report) -> list[str]:
    lines = []
    head = ("parameter", "standard error", "95 % interval", "bias")
    for bootstrap in report.bootstraps:
        drawn = (
            "new noise about the model"
            if bootstrap.kind == "parametric"
            else "trials, or else rows, drawn with replacement"
        )
        lost = f", {bootstrap.num_failed} of them failed" if bootstrap.num_failed else ""
        count = len(bootstrap.estimates) + bootstrap.num_failed
        lines += [f"{bootstrap.kind.capitalize()} ({drawn}): {count} refits{lost}, seed {bootstrap.seed}.", ""]
        rows = []
        for name in moving_names(report.fit):
            error, low, high, bias, unit = _shown_bootstrap(bootstrap, name)
            rows.append([name, f"{error:.2g}{unit}", f"{low:.5g} to {high:.5g}{unit}", f"{bias:.2g}{unit}"])
        lines += [*markdown_table(head, rows), ""]
        lines += [f"**Too narrow:** {bootstrap.remark}.", ""] if bootstrap.remark else []
    return _section("Bootstrap", lines[:-1])


def _shown_bootstrap(bootstrap: Bootstrap, name: str) -> tuple[float, float, float, float, str]:
    """Standard error, interval and bias of a parameter in the unit that engineers use, and that unit."""
    scale, unit = shown_unit(name)
    low, high = bootstrap.confidence_interval[name]
    return scale * bootstrap.standard_error[name], scale * low, scale * high, scale * bootstrap.bias[name], unit


def determination_in_words(determination: Determination) -> str:
    """One line."""
    parts = [f"{name} {status}" for name, status in determination.status.items() if not name.startswith(TRIALS)]
    together = determination.identified_together.items()
    parts += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g} {unit_of(name)}" for name, e in together]
    return "; ".join(parts)


def way_back_rows(fit: Fit) -> list[list[str]]:
    """For each parameter and combination the standard errors of the pull alone and of all rows; [] without a turn."""
    pull = fit.pull_alone
    if pull is None or not fit.success:
        return []
    rows = [[name, error_in_words(pull, name), error_in_words(fit, name)] for name in own_names(fit)]
    for name in fit.combinations:
        both = (found.combinations.get(name) for found in (pull, fit))
        rows.append([name, *(f"{100 * e.standard_error / e.value:.2g} %" if e else "-" for e in both)])
    return rows


def _way_back_section(fit: Fit) -> list[str]:
    text = "Standard errors of the rows before the first turn of each trial, and of all rows:"
    table = markdown_table(("parameter", "pull alone", "with the way back"), way_back_rows(fit))
    return _section("What the way back adds", [text, "", *table] if way_back_rows(fit) else [])


def _trial_section(fit: Fit) -> list[str]:
    effects = fit.trial_effects.items()
    rows = [[name, f"{100 * e.value:+.2f} %", f"{100 * e.standard_error:.2g} %"] for name, e in effects]
    text = (
        f"Friction of each trial relative to the mean; standard deviation over trials {100 * fit.trial_spread:.2g} %."
    )
    table = markdown_table(("trial", "friction", "standard error"), rows)
    return _section("Trials", [text, "", *table] if rows else [])


def _noise_section(fit: Fit) -> list[str]:
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
        rows.append([label, size, made_of, _or_dash(alike.lag_one, ".2f"), independent])
    for label, deviation in fit.input_noise.items():
        kind = "estimated" if label in fit.evidence.estimated_inputs else "as given" if deviation else "none is seen"
        rows.append([label, f"{deviation:.3g} N", kind, "-", "-"])
    kind = "estimated from the residuals" if fit.noise_estimated else "as given"
    text = f"Noise {kind}; {fit.degrees_of_freedom} degrees of freedom; rank {fit.rank}; {fit.result}."
    return _section("Noise", [*markdown_table(head, rows), "", text])


def _or_dash(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _model_free_in_words(report: Report) -> list[str]:
    lines = []
    for name, (friction, away) in report.model_free.items():
        lines += [f"{name}: {line}" for line in friction.verdict]
        if away is not None:
            check = "; check kinematics, the offset of the tendon, and the zeros of the cells and the camera"
            told = f"{name}: the fit lies {abs(away):.1f} standard errors from it"
            lines.append(told + check * (abs(away) > LARGEST_AWAY))
    for name, (loop, loss) in report.loops.items():
        lines += [f"{name}: {line}" for line in loop.verdict]
        lines.append(f"{name}: the fit has {loss:.4g} 1/N")
    return lines


def _figure_section(report: Report, figures: Sequence[str] | None) -> list[str]:
    """The figures, and why others are missing."""
    if figures is None:
        return []
    pictures = [f"![{name.replace('_', ' ')}]({name}.png)" for name in figures]
    missing = [f"- No figure of {name.replace('_', ' ')}: {reason}." for name, reason in left_out(report).items()]
    between = [""] if pictures and missing else []
    return ["## Figures", "", *pictures, *between, *missing]


def _stated(fit: Fit) -> list[str]:
    places = [f"marker {n} of {t.name}: {m}" for t in fit.tables for n, m in t.markers.items()]
    return [*fit.setting.in_words, *places]


def _repeat_section(report: Report) -> list[str]:
    fit = report.fit
    rows = [[table.name, str(len(table)), f"`{table.checksum[:16]}`"] for table in fit.tables]
    starts, seed, nodes = (fit.options[name] for name in ("starts", "seed", "nodes"))
    starts = "as needed" if starts is None else starts
    text = f"Kinematics {fit.manipulator.kinematics}, loss {fit.loss}, starts {starts}, seed {seed}, nodes {nodes}."
    text += f" With history: {', '.join(fit.without_jitter)}." if fit.without_jitter else ""
    courses = [one.course for one in fit.model.experiments if isinstance(one, Bench) and one.course is not None]
    past = [words for course in courses for words in course.past_in_words]
    past = past if len(set(past)) > 1 else past[:1]  # "rest", or where trials differ "rest, 80 N"
    text += f" Before the first row: {', '.join(past)}." if fit.without_jitter else ""
    text += " Holds were averaged." if any(table.holds_averaged for table in fit.tables) else ""
    text += " results.json holds what is needed to repeat this fit: manipulator, options, checksums, versions."
    return _section("To repeat it", [*markdown_table(("data", "rows", "SHA-256, first digits"), rows), "", text])


def fit_in_words(report: Report) -> str:
    """The report for the terminal."""
    fit = report.fit
    lines = list(fit.verdict)
    for bootstrap in report.bootstraps:
        lines += ["", f"bootstrap, {bootstrap.kind}, {len(bootstrap.estimates)} refits:"]
        for name in moving_names(fit):
            error, low, high, _, unit = _shown_bootstrap(bootstrap, name)
            lines.append(f"  {name} +- {error:.2g}{unit} (95 %: {low:.4g} to {high:.4g}{unit})")
        lines += [f"  too narrow: {bootstrap.remark}"] if bootstrap.remark else []
    if len(fit.tables) > 1:
        lines += ["", "each table alone determines:"]
        lines += [f"  {name}: {determination_in_words(determination)}" for name, determination in fit.alone.items()]
    if rows := way_back_rows(fit):
        lines += ["", "standard errors of the pull alone, and with the way back:"]
        lines += [f"  {name}: {pull}, {loop}" for name, pull, loop in rows]
    lines += [short_steps_in_words(fit)] if fit.moved_by_steps else []
    lines += [f"simulated data: {simulated}"] if (simulated := _simulated_names(fit)) else []
    lines.append(f"kinematics: {fit.manipulator.kinematics}")
    return "\n".join(lines + [f"warning: {warning}" for warning in fit.warnings])
