"""Every function of `cddf_jax.figures` that draws into axes, drawn once: `python docs/make_gallery.py FOLDER`."""

import sys
from pathlib import Path
from typing import Any, NamedTuple

# what the pictures are made from: a few solves, one fit, one sweep, two designs
SETUP = """
import jax
import numpy as np
import cddf_jax as cddf
from cddf_jax import figures

jax.config.update("jax_enable_x64", True)

body = dict(length=0.140, outer_radius=(0.020, 0.013), inner_radius=0.007, tendon_offset=0.010,
            youngs_modulus=1.4e6, friction_coefficient=0.42, density=1070.0)
robot, pair = cddf.conical(**body), cddf.conical(**body, num_tendons=2)
loads = cddf.Loads(tip_force=(0.0, -2.0), gravity=(0.0, -9.81))
path = np.concatenate([np.linspace(*leg, 40) for leg in ((0.0, 75.0), (75.0, 40.0), (40.0, 60.0), (60.0, 0.0))])
history = cddf.trace(robot, path)
bent, loaded = cddf.solve(robot, 75.0), cddf.solve(pair, [60.0, 10.0], loads)
around = [cddf.Tendon(0.010, angle=i * 2 * np.pi / 3) for i in range(3)]
section = dict(outer_radius=robot.outer_radius, inner_radius=0.007, youngs_modulus=1.4e6, friction_coefficient=0.42)
three = cddf.Manipulator(length=0.140, tendons=around, **section)
in_space = cddf.solve(three, [60.0, 35.0, 5.0])

table = cddf.read_measurements("data/tip_angle_simulated.csv")
names = "friction_coefficient", "youngs_modulus", "tip_gain"
fit = cddf.fit(robot, table, names, {"tip_gain": (1.0, 0.01)})

axes = {"base_tension": np.linspace(5.0, 145.0, 15), "friction_coefficient": np.linspace(0.1, 0.6, 6)}
grid = cddf.sweep(robot, axes, outputs=("tip_tension", "tension_loss"))

pulls = {f"base_tension_{i}": np.linspace(0.0, 60.0, 9) for i in (1, 2, 3)}
reach = cddf.sweep(three, pulls, outputs=("tip_position", "tip_tension"))

task = dict(free=("outer_radius",), bounds={"outer_radius": (8e-3, 25e-3)}, cases=cddf.LoadCase(50.0))
angle, strain = cddf.Limit("tip_angle", most=np.pi / 4), cddf.Limit("strain", most=0.105)
design = cddf.design(robot, cddf.Least("volume"), constraints=[angle, strain], **task)
both = cddf.Least("volume"), cddf.Least("strain")
front = cddf.pareto_front(robot, both, constraints=[angle], num=5, **task)
"""


class Picture(NamedTuple):
    """One drawing: its files are `name`.png and `name`.pdf."""

    name: str
    title: str
    caption: str
    code: str


PICTURES = (
    Picture(
        "shape",
        "Shape",
        "The bent body to scale under two tendons, a force on the tip and gravity; the rest shape is dotted.",
        "figures.draw_shape(pair, loaded, loads)",
    ),
    Picture(
        "space",
        "Shape in space",
        "Three tendons, tensions as colours, shadows on the walls. Tendons are dashed where the body hides them.",
        "figures.draw_shape(three, in_space)",
    ),
    Picture(
        "along_curvature",
        "Curvature in space",
        "Twist, and bending about both axes of the cross-section.",
        'figures.draw_along(three, in_space, "curvature")',
    ),
    Picture(
        "force_arrows",
        "Forces of the tendon",
        "Normal and friction force per length that the tendon puts on the paper's manipulator at 75 N.",
        "figures.draw_force_arrows(robot, bent)",
    ),
    Picture(
        "along_tension",
        "Tension along the body",
        "One line for each tendon, with its own dashes and its number.",
        'figures.draw_along(pair, loaded, "tension")',
    ),
    Picture(
        "along_strain",
        "Strain along the body",
        "So are curvature, heading, normal and friction force drawn.",
        'figures.draw_along(robot, bent, "strain")',
    ),
    Picture(
        "loop",
        "A loop",
        "Tip angle while the tendon is pulled to 75 N, released to 40 N, pulled to 60 N and let go.",
        'figures.draw_loop(history, "tip_angle")',
    ),
    Picture(
        "history_along",
        "Fronts along the body",
        "Tension at the turns of that path. Beyond its front a released tendon rests, with the tension of the pull.",
        'figures.draw_along(robot, history, "tension")',
    ),
    Picture(
        "energy",
        "Where the work goes",
        "Work put in, stored and lost to friction along that path.",
        "figures.draw_energy(history)",
    ),
    Picture(
        "fit",
        "Data and model",
        "Simulated tip angles, and the fitted model with its 95 % band.",
        'figures.draw_fit(fit, column="tip_angle")',
    ),
    Picture(
        "residuals",
        "Residuals",
        "What the model leaves of the tip tensions, reading by reading.",
        'figures.draw_residuals(fit, column="tip_tension")',
    ),
    Picture(
        "profile",
        "Profile likelihood",
        "How fast the fit gets worse away from the best friction coefficient, with all else fitted again.",
        'figures.draw_profile(fit, fit.profile("friction_coefficient"))',
    ),
    Picture(
        "lines",
        "A sweep as lines",
        "One line for each friction coefficient; doubtful and failed solves would be marked, and the legend say why.",
        'figures.draw_lines(grid, "tip_tension", "base_tension")',
    ),
    Picture(
        "map",
        "A sweep as a map",
        "Contours over two numbers; where solves are doubtful or failed the map would be blank and hatched.",
        'figures.draw_map(grid, "tension_loss", "base_tension", "friction_coefficient")',
    ),
    Picture(
        "workspace",
        "Workspace",
        "Where the tip of three tendons goes. Hollow: part of a tendon sticks, and its direction cannot be told.",
        "figures.draw_workspace(reach)",
    ),
    Picture(
        "design",
        "A design",
        "The bent body before and after, to scale: least volume within limits of strain and angle.",
        "figures.draw_design(design)",
    ),
    Picture(
        "trade_off",
        "A trade-off",
        "Every point is a design; none is better than another in both volume and strain.",
        "figures.draw_trade_off(front)",
    ),
)


def make_gallery(folder: str | Path) -> list[Picture]:
    """Draw every picture into a folder, as PNG and PDF; call it beside the folder `data`.

    Args:
        folder: made if it is missing.

    Returns:
        (name, title, caption, code) of each picture; `SETUP` is what its code needs.
    """
    made: dict[str, Any] = {}
    Path(folder).mkdir(parents=True, exist_ok=True)
    exec(SETUP, made)
    for picture in PICTURES:
        axes = eval(picture.code, made)
        for suffix in ("png", "pdf"):
            axes.figure.savefig(Path(folder) / f"{picture.name}.{suffix}")
    return list(PICTURES)


if __name__ == "__main__":
    from cddf_jax.application import configure_jax

    configure_jax()
    for picture in make_gallery(sys.argv[1]):
        print(picture.name)
