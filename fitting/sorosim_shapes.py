"""Study: 500 shapes of a steel rod under gravity and two wrenches, beside those of another toolbox (SoRoSim).

The rod has no tendon. Here a body has one or more, so it gets one that is not pulled: its tension is zero along the
whole body, and neither its offset nor friction matters.

The positions at 14 places of each rod are compared. All 500 are solved, and 499 lie within 0.1 % of the length; half of
them within 0.19 mm, all within 0.61 mm. The table prints loads and positions with four decimals. Half a unit of the
last one of a moment, 0.05 N mm, moves the tip of the straight rod by 0.14 mm. To first order, rounding of the printed
numbers can cause the difference at the tip of every shape. Inside each half 0.1 mm remain that it cannot cause, and
that vanish at the ends of the halves.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.writing import as_json, write_all

TABLE = Path(__file__).resolve().parents[1] / "data/sorosim_statics/spring_steel.csv"
OUT = "out/fitting/sorosim_shapes"
LENGTH = 0.6  # m
ALLOWED = 1e-3 * LENGTH  # m
HALF_A_UNIT = 5e-5  # of the last decimal of the table, in its units: SI
AT_ONCE = 50
SHOWN = 9


class Shapes(NamedTuple):
    """What acts on each rod, and where it is; the axis of shapes comes first."""

    loads: np.ndarray  # (shapes, 15): gravity, m/s^2; moment and force at the middle, then at the tip, N m and N
    arc_length: np.ndarray  # (places,), m
    position: np.ndarray  # (shapes, places, 3), m


class Compared(NamedTuple):
    """Our own rods beside those of the table."""

    position: np.ndarray  # (shapes, places, 3), m
    status: np.ndarray
    apart: np.ndarray  # (shapes, places), m
    by_rounding: np.ndarray  # (shapes, places), m: the most that rounding of the table can cause, to first order


def rod() -> cddf.Manipulator:
    """The rod, with a tendon that is not pulled."""
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=0.0008,
        inner_radius=0.0,
        youngs_modulus=200e9,
        poissons_ratio=0.33,
        density=7870.0,
        extensible=True,
        friction_coefficient=0.0,
        tendons=[cddf.Tendon(offset=0.0004, angle=0.0)],
    )


def read(path: Path = TABLE) -> Shapes:
    """The table."""
    with path.open(encoding="utf-8", newline="") as file:
        _, places, *rows = csv.reader(file)
    numbers = np.array([row[1:] for row in rows], float).reshape(-1, 6, len(places) - 1)
    loads = np.concatenate([numbers[:, 3:, 0], numbers[:, :, 1], numbers[:, :, 2]], axis=1)
    half = np.array(places[4:], float).reshape(2, -1) * LENGTH / 2
    arc_length = np.concatenate([half[0], half[1] + LENGTH / 2])
    return Shapes(loads, arc_length, np.swapaxes(numbers[:, 3:, 3:], 1, 2))


def positions(loads: jax.Array, arc_length: np.ndarray) -> tuple[jax.Array, jax.Array]:
    """The positions of one rod, (places, 3), m, and its status."""
    gravity, middle, tip = jnp.split(loads, [3, 9])
    at_middle = cddf.PointLoad(LENGTH / 2, middle[3:], middle[:3])
    found = cddf.solve(rod(), 0.0, cddf.Loads(tip[3:], tip[:3], gravity, [at_middle]), direction=1, throw=False)
    return found.at(arc_length).position, found.status


def compared(shapes: Shapes) -> Compared:
    """All rods, some at a time."""

    def one(loads):
        (place, status), push = jax.linearize(lambda loads: positions(loads, shapes.arc_length), loads)
        moved = jax.vmap(push)(jnp.eye(loads.size))[0]
        return place, status, HALF_A_UNIT * jnp.linalg.norm(jnp.sum(jnp.abs(moved), axis=0), axis=-1)

    solve = jax.jit(jax.vmap(one))
    parts = [solve(shapes.loads[i : i + AT_ONCE]) for i in range(0, len(shapes.loads), AT_ONCE)]
    position, status, by_loads = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    apart = np.linalg.norm(position - shapes.position, axis=2)
    return Compared(position, status, apart, by_loads + np.sqrt(3) * HALF_A_UNIT)


def table(found: Compared) -> dict[str, float]:
    """Numbers for the report; m."""
    largest = np.max(found.apart, axis=1)
    return {
        "shapes": largest.size,
        "solved": int(np.sum(found.status == cddf.Status.successful)),
        "within_0.1_percent_of_length": int(np.sum(largest <= ALLOWED)),
        "tip_within_what_rounding_can_cause": int(np.sum(found.apart[:, -1] <= found.by_rounding[:, -1])),
        "median_difference": float(np.median(largest)),
        "largest_difference": float(np.max(largest)),
        "median_at_tip": float(np.median(found.apart[:, -1])),
        "median_that_rounding_can_cause_at_tip": float(np.median(found.by_rounding[:, -1])),
    }


def figure(shapes: Shapes, found: Compared) -> Figure:
    """Some rods beside those of the table, from the lowest tip to the highest, and the differences of all."""
    largest, fine = np.max(found.apart, axis=1), np.linspace(0.0, LENGTH, 121)
    order = np.argsort(shapes.position[:, -1, 2])
    shown = order[np.linspace(0, order.size - 1, SHOWN).astype(int)]
    own, _ = jax.jit(jax.vmap(lambda loads: positions(loads, fine)))(shapes.loads[shown])
    with draw.house_style():
        drawn = draw.new_figure(draw.DOUBLE_COLUMN, 2.9)
        rods, differences = drawn.subplots(1, 2)
        for place, theirs in zip(1e3 * np.asarray(own), 1e3 * shapes.position[shown], strict=True):
            rods.plot(place[:, 0], place[:, 2], color=looks.BLUE, label="cddf_jax", zorder=1)
            look = {"linestyle": "none", "marker": "o", "markersize": 2.5, "color": looks.VERMILION}
            rods.plot(theirs[:, 0], theirs[:, 2], label="SoRoSim", **look)
        rods.set(xlabel="$X$ (mm)", ylabel="$Z$ (mm)")
        draw.to_scale(rods)
        draw.legend_above(rods)
        differences.hist(1e3 * largest, bins=40, color=looks.BLUE)
        differences.axvline(1e3 * ALLOWED, color=looks.BLACK, linewidth=0.8, linestyle="--")
        where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "rotation": 90}
        at = (1e3 * ALLOWED, 0.97)
        differences.annotate("0.1 % of the length", at, (-3, 0), ha="right", va="top", fontsize=7.5, **where)
        differences.set(xlabel="largest difference of a shape (mm)", ylabel="number of shapes")
    return drawn


if __name__ == "__main__":
    configure_jax()
    given = read()
    result = compared(given)
    numbers = table(result)
    print(*(f"{name}: {value:.4g}" for name, value in numbers.items()), sep="\n")
    write_all(OUT, draw.render(figure(given, result), "sorosim_shapes") | {"sorosim_shapes.json": as_json(numbers)})
