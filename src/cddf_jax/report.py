"""A fit as people read it: report.md with its figures, and results.json beside it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from . import plotting as draw
from .artifacts import as_json, write_all
from .bench import TRIALS, parameter_named, unit_of
from .bootstrap import Bootstrap
from .determination import NOT_IDENTIFIED, Determination
from .estimate_figures import bootstrap_figure, correlated_names, correlation_figure
from .fit_figures import moving_names, residuals_figure, table_figures, tables_without_numbers
from .fit_results import Report, as_dict, make_report, trial_rows
from .identification import Fit
from .measured_columns import dimension_of
from .observations import Noise
from .profile_figures import profiles_figure
from .units import preferred
from .verdict import SHOWN, shown


def write_fit(
    fit: Fit,
    folder: str | Path,
    *,
    options: Mapping[str, Any] | None = None,
    bootstraps: Sequence[Bootstrap] = (),
) -> None:
    """Write report.md, results.json and the figures (PDF and PNG) into a folder, all of them or none.

    Args:
        fit: of `fit`.
        folder: made if it is missing.
        options: arguments that were given to `fit` and that the fit does not remember: `noise` of which only one part
            was given. The others need not be named.
        bootstraps: of `fit.bootstrap`, to be reported with it.
    """
    write_report(make_report(fit, options=options, bootstraps=bootstraps), folder)


def write_report(report: Report, folder: str | Path) -> None:
    """Write all of it, or nothing."""
    contents: dict[str, str | bytes] = {}
    figures = report_figures(report)
    for name, figure in figures.items():
        contents |= draw.render(figure, name)
    contents |= {"report.md": as_markdown(report, tuple(figures)), "results.json": as_json(as_dict(report))}
    write_all(folder, contents)


def report_figures(report: Report) -> dict[str, Figure]:
    """The figures by file name; `left_out` says why others are missing."""
    fit, missing = report.fit, left_out(report)
    figures = table_figures(fit)
    if "residuals" not in missing:
        figures["residuals"] = residuals_figure(fit)
    if "profiles" not in missing:
        figures["profiles"] = profiles_figure(fit, report.profiles)
    if "correlation" not in missing:
        figures["correlation"] = correlation_figure(fit)
    for bootstrap in report.bootstraps:
        name = f"bootstrap_{bootstrap.kind}"
        if name not in missing:
            figures[name] = bootstrap_figure(fit, bootstrap)
    return figures


def left_out(report: Report) -> dict[str, str]:
    """By table or figure, why there is none."""
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


def as_markdown(report: Report, figures: Sequence[str] | None = None) -> str:
    """The report: first in words what was determined and what was not, then the numbers.

    Args:
        report: what to say.
        figures: names of the figures beside it; None where no figures are made.
    """
    sections = [
        _in_short(report),
        _goodness(report.fit),
        _profile_section(report),
        _bootstrap_section(report),
        _alone_section(report.fit),
        _trial_section(report.fit),
        _noise_section(report),
        _model_free_section(report),
        _warning_section(report.fit),
        _figure_section(report, figures),
        _reading_section(report.fit),
        _repeat_section(report),
    ]
    return "\n\n".join("\n".join(section) for section in sections if section) + "\n"


def _in_short(report: Report) -> list[str]:
    fit = report.fit
    lines = ["# What the measurements tell", "", *(f"- {line}" for line in fit.verdict)]
    remarks = fit.remarks
    lines += [f"- {warning}" for warning in fit.warnings if warning in remarks]
    if any(table.simulated for table in fit.tables):
        names = ", ".join(table.name for table in fit.tables if table.simulated)
        lines += ["", f"The data are simulated: {names}."]
    return [
        *lines,
        "",
        *_table(["parameter", "value", "standard error", "95 % interval", "status"], parameter_rows(fit)),
    ]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]


def parameter_rows(told: Determination) -> list[list[str]]:
    """Name, value, standard error, interval and status of each parameter and combination."""
    rows = []
    for name, status in told.status.items():
        if status == NOT_IDENTIFIED:
            rows.append([name, "-", "-", "-", status])
            continue
        value, error, low, high, unit = shown(told, name)
        spread = [f"{error:.2g}{unit}", f"{low:.5g} to {high:.5g}{unit}"] if np.isfinite(error) else ["-", "-"]
        rows.append([name, f"{value:.5g}{unit}", *spread, status])
    for name, (value, error) in told.combinations.items():
        unit = unit_of(name)
        rows.append([name, f"{value:.5g} {unit}", f"{error:.2g} {unit}", "-", "identified"])
    return rows


def _goodness(fit: Fit) -> list[str]:
    lines = []
    if np.isfinite(fit.mean_relative_error):
        error = f"{100 * fit.mean_relative_error:.3g} %"
        lines.append(f"Mean relative error of the tip tensions, the measure of Liu et al. (2020): {error}.")
    criteria = ", ".join(f"{name} {value:.5g}" for name, value in fit.information_criteria.items())
    loss = "" if fit.loss == "linear" else f" Loss {fit.loss}."
    return [*lines, f"Reduced chi-square {fit.reduced_chi_square:.3g}; {criteria}.{loss}"]


def _profile_section(report: Report) -> list[str]:
    rows = []
    for name, profile in report.profiles.items():
        scale, unit = SHOWN[parameter_named(name).dimension]
        told = zip(profile.confidence_interval, profile.closed, profile.model_ends, strict=True)
        ends = [_end_in_words(scale * end, unit, closed, model_ends) for end, closed, model_ends in told]
        rows.append([name, *ends])
    head = ["parameter", "from", "to"]
    text = (
        "95 % intervals without trust in linearity: a parameter is held at value after value, the others fitted again."
    )
    return ["## Profiles", "", text, "", *_table(head, rows)] if rows else []


def _end_in_words(end: float, unit: str, closed: bool, model_ends: bool) -> str:
    if model_ends:
        return f"open; no solution beyond {end:.5g}{unit}"
    if not closed:
        return f"{end:.5g}{unit} (bound)" if np.isfinite(end) else "open"
    return f"{end:.5g}{unit}"


def _bootstrap_section(report: Report) -> list[str]:
    lines = []
    for bootstrap in report.bootstraps:
        drawn = "new noise about the model" if bootstrap.kind == "parametric" else "trials drawn anew, elsewhere rows"
        lost = f", {bootstrap.num_failed} of them lost" if bootstrap.num_failed else ""
        count = len(bootstrap.estimates) + bootstrap.num_failed
        lines += ["", f"{bootstrap.kind.capitalize()} ({drawn}): {count} refits{lost}, seed {bootstrap.seed}.", ""]
        lines += _table(["parameter", "standard error", "95 % interval", "bias"], bootstrap_rows(report.fit, bootstrap))
        lines += ["", f"**Too narrow:** {bootstrap.remark}."] if bootstrap.remark else []
    return ["## Bootstrap", *lines] if lines else []


def bootstrap_rows(fit: Fit, bootstrap: Bootstrap) -> list[list[str]]:
    """Name, standard error, interval and bias of each parameter that no bound holds."""
    rows = []
    for name in moving_names(fit):
        scale, unit = SHOWN[parameter_named(name).dimension]
        low, high = (scale * end for end in bootstrap.confidence_interval[name])
        error, bias = scale * bootstrap.standard_error[name], scale * bootstrap.bias[name]
        rows.append([name, f"{error:.2g}{unit}", f"{low:.5g} to {high:.5g}{unit}", f"{bias:.2g}{unit}"])
    return rows


def _alone_section(fit: Fit) -> list[str]:
    if len(fit.tables) < 2 and len(fit.noise) < 2:
        return []
    return [
        "## What each table alone would have told",
        "",
        *(f"- {n}: {in_words(told)}" for n, told in fit.alone.items()),
    ]


def in_words(told: Determination) -> str:
    """One line."""
    parts = [f"{name} {status}" for name, status in told.status.items() if not name.startswith(TRIALS)]
    products = told.combinations.items()
    parts += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g} {unit_of(name)}" for name, e in products]
    return "; ".join(parts)


def _trial_section(fit: Fit) -> list[str]:
    rows = [[name, f"{100 * effect:+.2f} %", f"{100 * error:.2g} %"] for name, effect, error in trial_rows(fit)]
    text = f"Friction of a trial against that of all; standard deviation over trials {100 * fit.trial_spread:.2g} %."
    head = ["trial", "friction", "standard error"]
    return ["## Trials", "", text, "", *_table(head, rows)] if rows else []


def _noise_section(report: Report) -> list[str]:
    fit, rows = report.fit, []
    alike = fit.serial_correlation
    for label, deviation in fit.noise.items():
        scale, unit = preferred(dimension_of(label.rpartition(": ")[2]) or "dimensionless")
        p_value = report.normality[label].p_value
        model = _noise_in_words(fit.noise_model.get(label), scale, unit)
        rows.append(
            [
                label,
                f"{scale * deviation:.3g} {unit}",
                model,
                f"{p_value:.2g}" if np.isfinite(p_value) else "-",
                f"{alike[label].lag_one:.2f}" if np.isfinite(alike[label].lag_one) else "-",
                f"{alike[label].num_effective:.0f} of {alike[label].num_readings}",
            ]
        )
    kind = "estimated from the residuals" if fit.noise_estimated else "as given"
    head = ["data", "standard deviation", "made of", "normal: Shapiro-Wilk p"]
    head += ["correlation from row to row of a hold", "count as independent"]
    text = f"Noise {kind}; {fit.degrees_of_freedom} degrees of freedom; rank {fit.rank}; {fit.result}."
    return ["## Noise", "", *_table(head, rows), "", text]


def _noise_in_words(model: Noise | None, scale: float, unit: str) -> str:
    if model is None:
        return "the same for all"
    floor, fraction = model.floor or 0.0, model.fraction or 0.0
    return f"{scale * floor:.3g} {unit} and {100 * fraction:.3g} % of the value"


def _model_free_section(report: Report) -> list[str]:
    lines = []
    for name, (friction, compared) in report.model_free.items():
        lines += [f"- {name}: {line}" for line in friction.verdict]
        if compared is not None:
            agrees = f"the fit lies {abs(compared.z):.1f} standard errors from it"
            lines.append(f"- {name}: {compared.sentence or agrees}")
    return ["## Model-free friction", "", *lines] if lines else []


def _warning_section(fit: Fit) -> list[str]:
    """What the first lines have not said already."""
    remarks = fit.remarks
    lines = [f"- {warning}" for warning in fit.warnings if warning not in remarks]
    return ["## Warnings", "", *lines] if lines else []


def _figure_section(report: Report, figures: Sequence[str] | None) -> list[str]:
    """The figures, and why others are missing."""
    if figures is None:
        return []
    pictures = [f"![{name.replace('_', ' ')}]({name}.png)" for name in figures]
    missing = [f"- No figure of {name.replace('_', ' ')}: {reason}." for name, reason in left_out(report).items()]
    return ["## Figures", "", *pictures, *[""] * bool(pictures and missing), *missing]


def _reading_section(fit: Fit) -> list[str]:
    lines = [f"- {line}" for table in fit.tables for line in table.read_as]
    return ["## How the files were read", "", *lines] if lines else []


def _repeat_section(report: Report) -> list[str]:
    fit = report.fit
    rows = [[table.name, str(len(table)), f"`{table.checksum[:16]}`"] for table in fit.tables]
    text = "results.json holds what is needed to repeat this fit: manipulator, options, checksums, versions."
    starts, seed, nodes = (report.options[name] for name in ("starts", "seed", "nodes"))
    starts = "as needed" if starts is None else starts
    options = f"Kinematics {fit.manipulator.kinematics}, loss {fit.loss}, starts {starts}, seed {seed}, nodes {nodes}."
    options += " Holds were averaged." if any(table.spread is not None for table in fit.tables) else ""
    return ["## To repeat it", "", *_table(["data", "rows", "SHA-256, first digits"], rows), "", f"{options} {text}"]
