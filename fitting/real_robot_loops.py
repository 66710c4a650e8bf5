"""Study: what makes the loops of a real robot that is driven by displacement? Nine tendons, pulled and released.

Each tendon is fitted alone, in the plane in which it bends the body, with history. The bench has no load cell. So
modulus and compliance outside the body are known as a product only: the modulus is that assumed by the origin of the
data. Slack offset, compliance, and the pose of the camera are fitted, without friction, with the paper's friction of
tendon on body, and with a lag of the body behind its motor.

A parameter explains the loops only if it lowers BIC clearly, in most tendons alike, and has the same value in them.
Friction on the body does not: it is identified in two of nine, with 0.51 and 2.2, and is zero or not identified in the
others. A lag of 0.05 to 0.10 s lowers BIC by 21 to 42 in six of the seven tendons whose fits succeed, and the misfit
from 1.2-3.2 mm to 0.8-2.3 mm. All loops were made at one speed, at which a constant friction of the body or of the
transmission looks like a lag.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.writing import as_json, write_all

TABLE = Path(__file__).resolve().parents[1] / "data/opencr_v4/single_pulls.csv"
OUT = "out/fitting/real_robot_loops"
ENDS = (0.060, 0.1225, 0.1865)  # m, of the segments
LENGTH = 0.18825  # m, up to the marker
RADIUS, MODULUS = 0.0005, 50e9  # m, Pa, of the rod; the modulus was assumed by the origin of the data
OFFSET = 0.0045  # m
FIRST = 2  # rows of a trial that come before, in which other tendons still move
BENCH = ("slack_offset", "outside_compliance", "camera_x", "camera_y", "camera_turn_z")
MODELS = {"no friction": (), "friction on the body": ("friction_coefficient",), "lag": ("lag",)}


class Loop(NamedTuple):
    """A tendon, pulled and released."""

    table: cddf.Measurements  # in the plane in which most of the motion lies
    aside: np.ndarray  # (rows,), m, out of this plane


def read(path: Path = TABLE) -> list[Loop]:
    """The loop of each tendon."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = []
    for name in dict.fromkeys(row["trial"] for row in rows):
        own = [row for row in rows if row["trial"] == name][FIRST:]
        pulled, time, *tip = (
            np.array([float(row[head]) for row in own])
            for head in ("displacement [mm]", "time [s]", "tip_x [mm]", "tip_y [mm]", "tip_z [mm]")
        )
        across = np.stack(tip[:2], axis=1) - np.mean(tip[:2], axis=1)
        way = np.linalg.svd(across)[2][0]
        way = way if (across @ way) @ (pulled - pulled.mean()) > 0 else -way
        aside = 1e-3 * across @ np.array([-way[1], way[0]])
        columns = {"displacement": 1e-3 * pulled, "time": time, "tip_x": 1e-3 * tip[2], "tip_y": 1e-3 * (across @ way)}
        found.append(Loop(cddf.Measurements.from_columns(name, **columns), aside))
    return found


def robot(tendon: int, friction: float) -> cddf.Manipulator:
    """The body with one of its tendons, from 0."""
    own = cddf.Tendon(OFFSET, end=ENDS[tendon // 3], outside_compliance=1.5e-4)
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=RADIUS,
        inner_radius=0.0,
        youngs_modulus=MODULUS,
        friction_coefficient=friction,
        tendons=[own],
    )


def fits(tendon: int, loop: Loop) -> dict[str, cddf.Fit]:
    """The fit of one tendon by each model."""
    noise = {"displacement": 0.0}
    return {
        name: cddf.fit(
            robot(tendon, 0.1 if "friction_coefficient" in more else 0.0), loop.table, BENCH + more, noise=noise
        )
        for name, more in MODELS.items()
    }


def misfit(fit: cddf.Fit) -> float:
    """The root mean square of the distance between measured and predicted tip, m."""
    return float(np.sqrt(np.sum([np.mean(residual**2) for residual in fit.residuals.values()])))


def numbers(loop: Loop, found: dict[str, cddf.Fit]) -> list[dict[str, float | str]]:
    """A line of the report for each model of one tendon, SI."""
    lines = []
    for name, fit in found.items():
        line: dict[str, float | str] = {"tendon": loop.table.name, "out_of_plane": float(np.ptp(loop.aside))}
        line |= {"model": name, "misfit": misfit(fit), "BIC": fit.information_criteria["BIC"]}
        for own in (*MODELS[name], "outside_compliance"):
            line |= {own: fit.value[own], f"{own}_error": fit.standard_error[own], f"{own}_is": fit.status[own]}
        lines.append(line)
    return lines


def figure(loops: list[Loop], every: list[dict[str, cddf.Fit]]) -> Figure:
    """The tip across the body less the fit without friction, over the displacement; a tendon in each panel."""
    colours = {"friction on the body": looks.VERMILION, "lag": looks.BLUE}
    with draw.house_style():
        drawn = draw.new_figure(draw.DOUBLE_COLUMN, 5.2)
        panels = drawn.subplots(3, 3, squeeze=False).ravel().tolist()
        for axes, loop, found in zip(panels, loops, every, strict=False):
            label = f"{loop.table.name}: tip_y"
            x, left = 1e3 * loop.table["displacement"], found["no friction"].residuals[label]
            axes.axhline(0.0, color=looks.BLACK, linewidth=0.5)
            axes.plot(x, 1e3 * left, "o-", markersize=2.5, linewidth=0.5, color=looks.BLACK, label="measured")
            for name, colour in colours.items():
                if found[name].success:
                    axes.plot(x, 1e3 * (left - found[name].residuals[label]), color=colour, label=name)
            axes.set_title(loop.table.name)
        for axes in panels[6:]:
            axes.set(xlabel="Displacement (mm)")
        panels[3].set(ylabel="Tip across, less the fit without friction (mm)")
        draw.common_legend(drawn, panels)
    return drawn


if __name__ == "__main__":
    configure_jax()
    loops = read()
    every = [fits(k, loop) for k, loop in enumerate(loops)]
    lines = [line for loop, found in zip(loops, every, strict=True) for line in numbers(loop, found)]
    for line in lines:
        print(
            ", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value}" for key, value in line.items())
        )
    write_all(OUT, draw.render(figure(loops, every), "loops") | {"loops.json": as_json({"loops": lines})})
