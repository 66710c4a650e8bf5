"""Study: what makes the loops of a real robot that is driven by displacement? Nine tendons, pulled and released.

All nine loops are fitted at once, in space. The bench has one compliance outside the body, one camera, and for each
tendon its slack offset and its angle around the axis, which the data themselves suggest. The tendons that are not
pulled hang slack. There is no load cell, so that modulus and compliance are known as a product only; the modulus is
that assumed by the origin of the data.

Each loop begins with the straight body. With `--one-history` it begins in the shape in which the loop before left the
body; then all nine tendons are followed at once, and a model takes half an hour.

What is compared: no friction, the friction of tendons on the body, a lag of the body behind its motors, a constant
friction of the tendon outside the body, and a constant friction moment of the body.

A second robot (`data/opencr_v6`) has loops that run backwards. No model explains them, and the fit says so.
"""

import argparse
import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.writing import as_json, write_all

DATA = Path(__file__).resolve().parents[1] / "data"
OUT = "out/fitting/real_robot_loops"
FIRST = 2  # rows of a trial that come before, in which other tendons still move
SLACK, PAUSE = -0.010, 10.0  # m, of a tendon that is not pulled; s, between loops
TIP = ("tip_x", "tip_y", "tip_z")
ENDS = (0.060, 0.1225, 0.1865)  # m, of the segments
LENGTH = 0.18825  # m, up to the marker
RADIUS, MODULUS = 0.0005, 50e9  # m, Pa, of the rod; the modulus was assumed by the origin of the data
OFFSET = 0.0045  # m
USUAL, FEW = (16, 4), (8, 2)  # nodes and short steps; the error of few is told with the results
EXACT = {"displacement": 0.0}
MODELS = {
    "no friction": (),
    "friction on the body": ("friction_coefficient",),
    "lag": ("lag",),
    "constant friction outside": ("outside_drag",),
    "friction moment": ("friction_moment",),
}
DRAWN = {"no friction": looks.SKY, "friction moment": looks.VERMILION}


def read(robot: str = "v4") -> list[cddf.Measurements]:
    """The loop of each tendon; the straight body lies along x, as in the model."""
    with (DATA / f"opencr_{robot}/single_pulls.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = []
    for name in dict.fromkeys(row["trial"] for row in rows):
        own = [row for row in rows if row["trial"] == name][FIRST:]
        heads = ("displacement [mm]", "tip_z [mm]", "tip_x [mm]", "tip_y [mm]")
        pulled, *tip = (1e-3 * np.array([float(row[head]) for row in own]) for head in heads)
        number = int(own[0]["tendon"])
        columns = {"displacement" if number == 1 else f"displacement_{number}": pulled}
        columns |= {"time": np.array([float(row["time [s]"]) for row in own])}
        columns |= dict(zip(TIP, tip, strict=True))
        found.append(cddf.Measurements.from_columns(f"{robot} {name}", **columns))
    return found


def one_history(loops: list[cddf.Measurements]) -> cddf.Measurements:
    """All loops in one table, one after the other."""
    pulled = [pulled_by(table) for table in loops]
    columns = {own: np.concatenate([t.columns.get(own, np.full(len(t), SLACK)) for t in loops]) for own in pulled}
    columns |= {column: np.concatenate([table[column] for table in loops]) for column in TIP}
    ends = np.cumsum([0.0, *(table["time"][-1] + PAUSE for table in loops)])
    columns["time"] = np.concatenate([start + table["time"] for start, table in zip(ends, loops, strict=False)])
    return cddf.Measurements.from_columns("v4", **columns)


def pulled_by(table: cddf.Measurements) -> str:
    """The column of the tendon that is pulled."""
    return next(column for column in table.columns if column.startswith("displacement"))


def robot(loops: list[cddf.Measurements], friction: float = 0.0) -> cddf.Manipulator:
    """The body of v4; each tendon lies where the tip goes when it is pulled."""
    tendons = []
    for number, table in enumerate(loops):
        peak = int(np.argmax(table[pulled_by(table)]))
        way = [table[column][peak] - table[column][0] for column in ("tip_z", "tip_y")]
        tendons.append(
            cddf.Tendon(OFFSET, end=ENDS[number // 3], angle=float(np.arctan2(*way)), outside_compliance=1.5e-4)
        )
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=RADIUS,
        inner_radius=0.0,
        youngs_modulus=MODULUS,
        friction_coefficient=friction,
        tendons=tendons,
    )


def fit(loops: list[cddf.Measurements], model: str, *, chained: bool = False) -> cddf.Fit:
    """All loops by one model, each for itself or as one history.

    The turn of the camera about the axis is that of all tendons, so it is not fitted.
    """
    own = [f"{name}_{i}" for name in ("slack_offset", "tendon_angle_error") for i in range(1, len(loops) + 1)]
    bench = ["outside_compliance", *(f"camera_{axis}" for axis in "xyz"), "camera_turn_y", "camera_turn_z", *own]
    friction = 0.1 if "friction_coefficient" in MODELS[model] else 0.0
    free = [*bench, *MODELS[model]]
    tables, (nodes, steps) = ([one_history(loops)], FEW) if chained else (loops, USUAL)
    body = robot(loops, friction)
    return cddf.fit(body, tables, free, noise=EXACT, nodes=nodes, short_steps=steps, starts=1)


def misfits(found: cddf.Fit, loops: list[cddf.Measurements]) -> list[np.ndarray]:
    """By loop, (rows, 3), measured less predicted places of the tip, m."""
    columns = [np.concatenate([found.residuals[f"{table.name}: {c}"] for table in found.tables]) for c in TIP]
    return np.split(np.stack(columns, axis=1), np.cumsum([len(table) for table in loops])[:-1])


def misfit(found: cddf.Fit) -> float:
    """The root mean square of the distance between measured and predicted tip, m."""
    rows = sum(len(table) for table in found.tables)
    return float(np.sqrt(sum(np.sum(residual**2) for residual in found.residuals.values()) / rows))


def numbers(model: str, found: cddf.Fit) -> dict[str, float | str]:
    """A line of the report, SI."""
    line: dict[str, float | str] = {"model": model, "result": found.result}
    line |= {"misfit": misfit(found), "BIC": found.information_criteria["BIC"]}
    for own in (*MODELS[model], "outside_compliance"):
        line |= {own: found.value[own], f"{own}_error": found.standard_error[own], f"{own}_is": found.status[own]}
        line |= {f"{own}_moved_by_steps": found.moved_by_steps.get(own, 0.0)}
    return line


def ways(tip: np.ndarray, read: np.ndarray) -> np.ndarray:
    """(2, rows), how far the tip is from where the camera saw it first, m: in the plane of bending, and across it.

    Both are at right angles to the straight body. The plane is that of the body and the largest way seen.
    """
    off, seen = (place[:, 1:] - read[0, 1:] for place in (tip, read))
    along = seen[np.argmax(np.linalg.norm(seen, axis=1))]
    along = along / np.linalg.norm(along)
    return np.stack([off @ along, off @ [-along[1], along[0]]])


def figure(loops: list[cddf.Measurements], found: dict[str, cddf.Fit], *, across: bool) -> Figure:
    """The way of the tip in the plane of bending, or across it, over the displacement; a tendon in each panel."""
    with draw.house_style():
        drawn = draw.new_figure(draw.DOUBLE_COLUMN, 5.2)
        panels = drawn.subplots(3, 3).ravel().tolist()
        for number, (axes, table) in enumerate(zip(panels, loops, strict=True), 1):
            read = np.stack([table[column] for column in TIP], axis=1)
            x = 1e3 * table[pulled_by(table)]
            axes.plot(x, 1e3 * ways(read, read)[int(across)], "o", color=looks.BLACK, label="measured")
            for model, colour in DRAWN.items():
                tip = read - misfits(found[model], loops)[number - 1]
                axes.plot(x, 1e3 * ways(tip, read)[int(across)], color=colour, label=model)
            axes.set_title(f"tendon {number}")
        for axes in panels[6:]:
            axes.set(xlabel="Displacement (mm)")
        drawn.supylabel(f"Way of the tip {'across' if across else 'in'} the plane of bending (mm)", fontsize="medium")
        draw.common_legend(drawn, panels)
    return drawn


def refusal() -> str:
    """What a fit says of the other robot, whose loops run backwards."""
    (loop, *_) = read("v6")
    body = cddf.Manipulator(
        length=0.234,
        outer_radius=RADIUS,
        inner_radius=0.0,
        youngs_modulus=10e9,  # assumed by the origin
        friction_coefficient=0.1,
        tendons=[cddf.Tendon(OFFSET, end=0.2, outside_compliance=1e-4)],
    )
    columns = {column: values for column, values in loop.columns.items() if not column.startswith("displacement")}
    across = np.stack([columns.pop("tip_y"), columns.pop("tip_z")], axis=1)
    across = across - across[0]
    way = across[np.argmax(np.linalg.norm(across, axis=1))]
    columns |= {"displacement": loop[pulled_by(loop)], "tip_y": across @ (way / np.linalg.norm(way))}
    table = cddf.Measurements.from_columns(loop.name, **columns)
    free = ["friction_coefficient", "outside_compliance", "slack_offset", "camera"]
    return cddf.fit(body, table, free, noise=EXACT).result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one-history", action="store_true", help="follow all loops one after the other")
    chained = parser.parse_args().one_history
    configure_jax()
    loops = read()
    found = {}
    for model in MODELS:
        found[model] = fit(loops, model, chained=chained)
        line = numbers(model, found[model])
        print(
            ", ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value}" for key, value in line.items())
        )
        print("\n".join(rival.in_words for rival in found[model].rivals))
    print(f"v6: {refusal()}")
    lines = [numbers(model, own) for model, own in found.items()]
    drawn = draw.render(figure(loops, found, across=False), "loops_in_plane")
    drawn |= draw.render(figure(loops, found, across=True), "loops_across")
    write_all(OUT, drawn | {"loops.json": as_json({"models": lines})})
