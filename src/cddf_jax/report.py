"""A fit as people read it: figures, a report, and a dictionary for JSON."""

import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from . import plotting as draw
from .artifacts import as_json, write_all
from .determination import NOT_IDENTIFIED, Determination
from .identification import Fit, shown
from .measurements import Measurements
from .pulley import pulling_tension

DEGREE = np.degrees(1.0)
COLUMNS = {
    "tip_angle": (DEGREE, "Tip angle", "deg"),
    "tip_x": (1e3, "Tip position X", "mm"),
    "tip_y": (1e3, "Tip position Y", "mm"),
}


def write_fit(fit: Fit, folder: str | Path) -> None:
    """Write fit.md, fit.json and the figures (PDF and PNG) into a folder, all of them or none."""
    contents: dict[str, str | bytes] = {}
    for name, figure in fit_figures(fit).items():
        contents |= draw.render(figure, name)
    write_all(folder, contents | {"fit.md": as_markdown(fit), "fit.json": as_json(as_dict(fit))})


def as_dict(fit: Fit) -> dict[str, Any]:
    """Everything that the fit found, SI units, for JSON: what is infinite becomes null there."""
    return {
        **_determination(fit),
        "result": fit.result,
        "success": fit.success,
        "verdict": list(fit.verdict),
        "alone": {name: _determination(told) for name, told in fit.alone.items()},
        "noise": fit.noise,
        "noise_estimated": fit.noise_estimated,
        "reduced_chi_square": fit.reduced_chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "num_steps": fit.num_steps,
        "warnings": list(fit.warnings),
        "data": [{"name": t.name, "rows": len(t), "simulated": t.simulated} for t in fit.tables],
        "kinematics": fit.manipulator.kinematics,
        "nodes": fit.model.nodes,
        "version": version("cddf_jax"),
    }


def _determination(told: Determination) -> dict[str, Any]:
    return {
        "value": told.value,
        "standard_error": told.standard_error,
        "confidence_interval": told.confidence_interval,
        "status": told.status,
        "combinations": {name: estimate._asdict() for name, estimate in told.combinations.items()},
        "correlation": told.correlation,
        "rank": told.rank,
        "condition_number": told.condition_number,
        "sloppy_direction": told.sloppy_direction,
    }


def as_markdown(fit: Fit) -> str:
    """The report: first in words what was determined and what was not, then the numbers."""
    lines = ["# What the measurements tell", "", *(f"- {line}" for line in fit.verdict), ""]
    if any(table.simulated for table in fit.tables):
        names = ", ".join(table.name for table in fit.tables if table.simulated)
        lines += [f"The data are simulated: {names}.", ""]
    lines += ["| parameter | value | standard error | 95 % interval | status |", "| --- | --- | --- | --- | --- |"]
    lines += ["| " + " | ".join(row) + " |" for row in parameter_rows(fit)]
    if len(fit.tables) > 1 or len(fit.noise) > 1:
        lines += ["", "## What each table alone would have told", ""]
        lines += [f"- {name}: {in_words(told)}" for name, told in fit.alone.items()]
    lines += ["", "## Noise", "", "| data | standard deviation (SI) |", "| --- | --- |"]
    lines += [f"| {name} | {value:.3g} |" for name, value in fit.noise.items()]
    kind = "estimated from the residuals" if fit.noise_estimated else "as given"
    lines += ["", f"Noise {kind}; {fit.degrees_of_freedom} degrees of freedom; rank {fit.rank}; {fit.result}."]
    if fit.warnings:
        lines += ["", "## Warnings", "", *(f"- {warning}" for warning in fit.warnings)]
    return "\n".join(lines) + "\n"


def parameter_rows(told: Determination) -> list[list[str]]:
    """Name, value, standard error, interval and status of each parameter and combination."""
    rows = []
    for name, status in told.status.items():
        if status == NOT_IDENTIFIED:
            rows.append([name, "-", "-", "-", status])
            continue
        value, error, low, high, unit = shown(told, name)
        rows.append([name, f"{value:.5g}{unit}", f"{error:.2g}", f"{low:.5g} to {high:.5g}", status])
    for name, (value, error) in told.combinations.items():
        rows.append([name, f"{value:.5g} (SI)", f"{error:.2g}", "-", "identified"])
    return rows


def in_words(told: Determination) -> str:
    """One line."""
    shown = [f"{name} {status}" for name, status in told.status.items()]
    shown += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g} (SI)" for name, e in told.combinations.items()]
    return "; ".join(shown)


def fit_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table: data, model with its 95 % band, residuals.

    There is none for tables of several tendons, and none where the model gave no numbers.
    """
    figures = {}
    for name, table in zip(fit.alone, fit.tables, strict=True):
        if "pulling_tension" in table:
            panels = [_pulley_panel(fit, name, table)]
        elif fit.manipulator.num_tendons == 1:
            columns = [c for c in ("tip_tension", *COLUMNS) if c in table]
            panels = [_bench_panel(fit, name, table, column) for column in columns]
        else:
            continue
        if all(np.all(np.isfinite(panel.predicted)) and np.all(np.isfinite(panel.residual)) for panel in panels):
            figures["fit_" + re.sub(r"\W+", "_", name.replace(".csv", "")).strip("_")] = draw.fit_figure(panels)
    return figures


def _data_label(table: Measurements) -> str:
    return "simulated data, mean ± sd" if table.simulated else "data, mean ± sd"


def _bench_panel(fit: Fit, name: str, table: Measurements, column: str) -> draw.FitPanel:
    scale, quantity, unit = COLUMNS.get(column, (1.0, "Tip tension", "N"))
    tension = table["base_tension"]
    grid = np.linspace(tension.min(), tension.max(), 100)
    value, half_width, _ = fit.predict(column, grid)
    return draw.FitPanel(
        x=tension,
        observed=scale * table[column],
        residual=scale * fit.residuals[f"{name}: {column}"],
        grid=grid,
        predicted=scale * value,
        lower=scale * (value - half_width),
        upper=scale * (value + half_width),
        x_label="Base tension (N)",
        y_label=f"{quantity} ({unit})",
        residual_label=f"Residual ({unit})",
        data_label=_data_label(table),
    )


def _pulley_panel(fit: Fit, name: str, table: Measurements) -> draw.FitPanel:
    """Pulling tension per weight over wrap angle, so that one curve holds every weight."""
    grid = np.linspace(0.0, table["wrap_angle"].max(), 100)
    ratio = np.asarray(pulling_tension(1.0, fit.value["friction_coefficient"], grid))
    slope = np.zeros((grid.size, len(fit.names)))
    if "friction_coefficient" in fit.names:
        slope[:, fit.names.index("friction_coefficient")] = grid * ratio
    half_width = fit.band(slope)
    return draw.FitPanel(
        x=DEGREE * table["wrap_angle"],
        observed=table["pulling_tension"] / table["weight"],
        residual=fit.residuals[f"{name}: pulling_tension"] / table["weight"],
        grid=DEGREE * grid,
        predicted=ratio,
        lower=ratio - half_width,
        upper=ratio + half_width,
        x_label="Wrap angle (deg)",
        y_label="Pulling tension / weight",
        residual_label="Residual",
        data_label=_data_label(table),
    )
