"""Study: nine tendons of a real robot at once, by displacement. Fit a training recording, predict a validation one.

`cddf.fit` of so long a history of nine tendons takes hours. So the fit uses what this body allows. Friction of tendons
on it explains none of its loops (`real_robot_loops.py`). Without it the tension of a tendon is the same all along, and
each segment bends into an arc. Six numbers, the curvatures of three segments, then tell the whole shape. Row by row
they follow from a minimum of energy, with a constant friction moment that holds each segment back.

With `--follow`, `cddf.trace` follows the validation recording on elements with the same numbers, and the report says
how far its tip is from that of the arcs. This takes a quarter of an hour more.

What is compared: no friction, a constant friction moment of the body, a lag of the body behind its motors, and both.
"""

import argparse
import csv
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from real_robot_loops import DATA, DRAWN, ENDS, LENGTH, OFFSET, read as loops_of, robot
from scipy.optimize import least_squares

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.writing import as_json, write_all
from cddf_jax.measurements.markers import seen
from cddf_jax.numerics.rotations import IDENTITY, in_fixed_frame, of_turn, product

OUT = "out/fitting/real_robot_recordings"
FIRST = 3  # rows of a recording that do not count, as in the independent study
LENGTHS = np.diff((0.0, *ENDS))  # m, of the segments
REACHES = np.repeat(np.tri(3), 3, axis=0)  # (tendons, segments), 1 where the tendon passes the segment
MODELS = {
    "no friction": (),
    "friction moment": ("friction_moment",),
    "lag": ("lag",),
    "friction moment and lag": ("friction_moment", "lag"),
}
STARTS = {"friction_moment": 2.0e-3, "lag": 0.05}  # N m, s
SIZES = {"friction_moment": 1e-3, "lag": 0.1, "offset": 1e-3, "outside_compliance": 1e-4}  # that matter, SI units
SIZES |= {"slack_offset": 1e-3, "angle": 0.1, "camera": 1e-2, "camera_turn": 0.1}
SOFT = 1e-3  # 1/m, the bend that a friction moment lets go
SMALL, ROUNDS = 1e-8, 100  # 1/m, of Newton's method, which has mostly settled after ten rounds
PARTS = 2.0 ** np.arange(0, -12, -1)  # of a Newton step, that are tried
PAUSE = 1.5  # s; a longer time between two rows is a pause
SHOWN = {"training": (480.0, 780.0), "validation": (0.0, 400.0)}  # s, in the figure
Parameters = Mapping[str, Array | np.ndarray]


class Recording(NamedTuple):
    """What was read, in the axes of the model."""

    time: np.ndarray  # s
    displacement: np.ndarray  # (rows, tendons), m
    tip: np.ndarray  # (rows, 3), m; the straight body lies along x


def read(name: str) -> Recording:
    """The recording "training" or "validation"."""
    with (DATA / f"opencr_v4/recording_{name}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    heads = ["time [s]", "displacement [mm]", *(f"displacement_{k} [mm]" for k in range(2, 10))]
    heads += [f"tip_{axis} [mm]" for axis in "zxy"]
    numbers = np.array([[float(row[head]) for head in heads] for row in rows])
    return Recording(numbers[:, 0], 1e-3 * numbers[:, 1:10], 1e-3 * numbers[:, 10:])


# --- the bench, and the body as three arcs --------------------------------------------------------


def start_of(body: cddf.Manipulator, model: str) -> dict[str, np.ndarray]:
    """Of all that is fitted, SI units."""
    bench = {"offset": OFFSET, "outside_compliance": 1.5e-4, "slack_offset": np.full(9, -4e-4)}
    bench |= {"angle": np.array([float(tendon.angle(0.0)) for tendon in body.tendons if tendon.angle])}
    bench |= {"camera": np.zeros(3), "camera_turn": np.zeros(2), **{name: STARTS[name] for name in MODELS[model]}}
    return {name: np.asarray(value, float) for name, value in bench.items()}


def pulled_in(recording: Recording, parameters: Parameters) -> Array:
    """(rows, tendons), how far each tendon is pulled in, m, from what its servo reads."""
    late = jnp.asarray(recording.time) - parameters.get("lag", 0.0)
    read = jnp.asarray(recording.displacement)
    moved = jax.vmap(jnp.interp, (None, None, 1), 1)(late, recording.time, read)
    return (moved if "lag" in parameters else read) - jnp.asarray(parameters["slack_offset"])


def on_camera(place: Float[Array, "rows 3"], parameters: Parameters) -> Float[Array, "rows 3"]:
    """Places as the camera sees them."""
    turn = jnp.concatenate([jnp.zeros(1), parameters["camera_turn"]])
    return seen(place, jnp.asarray(parameters["camera"]), turn)


def curvatures(stiffness: float, pulled: Array, parameters: Parameters) -> Float[Array, "rows segments 2"]:
    """Of each segment, 1/m, in the two directions across it, after each row.

    In each row they minimise the energy of bending and of the springs outside the body, which cannot push, and the work
    of the friction moment since the row before. It is convex, so there is one minimum.
    """
    direction = parameters["offset"] * jnp.stack([jnp.cos(parameters["angle"]), jnp.sin(parameters["angle"])], axis=1)
    arm = REACHES[:, :, None] * direction[:, None]  # (tendons, segments, 2), m

    def energy(curvature: Array, held: Array, here: Array) -> Array:
        way = jnp.sqrt(jnp.sum((curvature - held) ** 2, axis=1) + SOFT**2)
        bending = stiffness * jnp.sum(curvature**2, axis=1) / 2 + parameters.get("friction_moment", 0.0) * way
        pull = jnp.maximum(here - jnp.einsum("tsi,si,s->t", arm, curvature, LENGTHS), 0.0)
        return jnp.asarray(LENGTHS) @ bending + jnp.sum(pull**2) / (2 * parameters["outside_compliance"])

    def step(held: Array, here: Array) -> tuple[Array, Array]:
        def newton(curvature: Array) -> Array:
            slope, bend = jax.grad(energy)(curvature, held, here), jax.hessian(energy)(curvature, held, here)
            return -jnp.linalg.solve(bend.reshape(6, 6), slope.ravel()).reshape(3, 2)

        def onwards(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            curvature, change = state[0], newton(state[0])
            tried = curvature + PARTS[:, None, None] * change
            best = jnp.argmin(jax.vmap(energy, (0, None, None))(tried, held, here))
            return tried[best], jnp.max(jnp.abs(change)), state[2] + 1

        def goes_on(state: tuple[Array, Array, Array]) -> Array:
            return (state[1] > SMALL) & (state[2] < ROUNDS)

        found = jax.lax.while_loop(goes_on, onwards, (held, jnp.asarray(1.0), jnp.asarray(0)))[0]
        found = found + newton(found)  # with the derivatives of the minimum
        return found, found

    return jax.lax.scan(step, jnp.zeros((3, 2)), pulled)[1]


def tip_of_arcs(curvature: Float[Array, "segments 2"]) -> Float[Array, "3"]:
    """The place of the tip, m; beyond the last tendon the body is straight."""
    place, frame = jnp.zeros(3), jnp.asarray(IDENTITY)
    for length, own in zip(LENGTHS, curvature, strict=True):
        across = jnp.sqrt(jnp.sum(own**2) + 1e-24)
        angle = length * across
        way = (1.0 - jnp.cos(angle)) / across**2
        place = place + in_fixed_frame(frame, jnp.stack([jnp.sin(angle) / across, way * own[0], way * own[1]]))
        frame = product(frame, of_turn(length * jnp.stack([0.0 * across, -own[1], own[0]])))
    return place + in_fixed_frame(frame, jnp.array([LENGTH - ENDS[-1], 0.0, 0.0]))


def by_arcs(recording: Recording, stiffness: float, parameters: Parameters) -> Float[Array, "rows 3"]:
    """The predicted place of the tip after each row, m, as the camera sees it."""
    bent = curvatures(stiffness, pulled_in(recording, parameters), parameters)
    return on_camera(jax.vmap(tip_of_arcs)(bent), parameters)


def fit(recording: Recording, body: cddf.Manipulator, model: str) -> dict[str, np.ndarray]:
    """The bench and the numbers of a model that bring the tip nearest, in the sense of least squares."""
    start, stiffness = start_of(body, model), float(body.stiffness(0.0))
    first, parameters_of = ravel_pytree(start)
    sizes = np.asarray(ravel_pytree({name: np.full(value.shape, SIZES[name]) for name, value in start.items()})[0])

    @jax.jit
    def missed(numbers: Array) -> Array:
        return jnp.ravel(by_arcs(recording, stiffness, parameters_of(numbers * sizes)) - recording.tip)[3 * FIRST :]

    slopes = jax.jit(jax.jacfwd(missed))
    found = least_squares(missed, np.asarray(first) / sizes, slopes, ftol=1e-5, xtol=1e-5)  # pyright: ignore[reportArgumentType]
    return jax.tree.map(np.asarray, parameters_of(found.x * sizes))


# --- the same by the library ----------------------------------------------------------------------


def with_numbers(body: cddf.Manipulator, parameters: Parameters) -> cddf.Manipulator:
    """The body with the estimates."""
    known = {name: float(parameters[name]) for name in ("offset", "outside_compliance")}
    tendons = [
        replace(tendon, **known, angle=float(angle))
        for tendon, angle in zip(body.tendons, parameters["angle"], strict=True)
    ]
    moment = parameters.get("friction_moment")
    return replace(body, tendons=tendons, friction_moment=None if moment is None else float(moment))


def followed(body: cddf.Manipulator, recording: Recording, parameters: Parameters) -> np.ndarray:
    """(rows, 3), the predicted places of the tip, m, as `cddf.trace` follows them; NaN where it has no solution."""
    path = [cddf.Displacement(own) for own in pulled_in(recording, parameters).T]
    history = cddf.trace(
        with_numbers(body, parameters), path, nodes=4, short_steps=2, estimate_error=False, throw=False
    )
    return np.asarray(on_camera(history.tip_position, parameters))


# --- the report -----------------------------------------------------------------------------------


def off(place: np.ndarray, recording: Recording, parameters: Parameters) -> np.ndarray:
    """(rows, 3), measured less predicted tip, m: along the straight body, away from it, and across the plane of both.

    The plane is that of the straight body and the measured tip.
    """
    straight = np.asarray(on_camera(jnp.array([[LENGTH, 0.0, 0.0]]), parameters))
    way = (recording.tip - straight)[:, 1:]
    away = way / np.linalg.norm(way, axis=1, keepdims=True)
    x, y, z = (recording.tip - place).T
    return np.stack([x, y * away[:, 0] + z * away[:, 1], z * away[:, 0] - y * away[:, 1]], axis=1)


def misfits(place: np.ndarray, recording: Recording, parameters: Parameters) -> dict[str, float]:
    """Root mean squares, m: of the distance between measured and predicted tip, and of its parts as in `off`."""
    missed = off(place, recording, parameters)[FIRST:]
    in_plane, across = (float(np.sqrt(np.mean(np.sum(own**2, axis=1)))) for own in (missed[:, :2], missed[:, 2:]))
    return {"misfit": float(np.hypot(in_plane, across)), "in_plane": in_plane, "across": across}


def over_time(axes: Axes, recording: Recording, values: np.ndarray, **look: looks.LookValue) -> None:
    """Draw values of all rows, mm; lines are broken in the pauses."""
    pauses = np.flatnonzero(np.diff(recording.time) > PAUSE) + 1
    x, y = (np.insert(own, pauses, np.nan) for own in (recording.time, 1e3 * values))
    axes.plot(x, y, markersize=2, linewidth=0.8, **look)


def figure(recordings: Mapping[str, Recording], predicted: Mapping, found: Mapping[str, Parameters]) -> Figure:
    """The way of the tip, measured and predicted, and what is missed in and across the plane, over time."""
    with draw.house_style():
        drawn = draw.new_figure(draw.DOUBLE_COLUMN, 5.0)
        panels = drawn.subplots(3, 2, sharex="col", sharey="row")
        for (name, recording), (top, middle, bottom) in zip(recordings.items(), panels.T, strict=True):
            read, rest = recording.tip, recording.tip[0]
            way = np.linalg.norm(read - rest, axis=1)
            over_time(top, recording, way, marker=".", linestyle="", color=looks.BLACK, label="measured")
            for model, colour in DRAWN.items():
                place, look = predicted[model, name], {"color": colour, "label": model}
                _, away, across = off(place, recording, found[model]).T
                over_time(top, recording, np.linalg.norm(place - rest, axis=1), **look)
                over_time(middle, recording, away, **look)
                over_time(bottom, recording, across, **look)
            top.set(title=name, xlim=SHOWN[name])
            bottom.set(xlabel="Time (s)")
        for axes, words in zip(panels[:, 0], ("Way of the tip", "Missed in plane", "Missed across"), strict=True):
            axes.set(ylabel=f"{words} (mm)")
        draw.common_legend(drawn, [panels[0, 0]])
    return drawn


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--follow", action="store_true", help="follow the validation recording by cddf.trace as well")
    follow = parser.parse_args().follow
    configure_jax()
    body, recordings = robot(loops_of()), {name: read(name) for name in SHOWN}
    stiffness, found, predicted, lines = float(body.stiffness(0.0)), {}, {}, []
    for model in MODELS:
        found[model] = fit(recordings["training"], body, model)
        for name, recording in recordings.items():
            predicted[model, name] = place = np.asarray(by_arcs(recording, stiffness, found[model]))
            lines.append({"model": model, "recording": name, **misfits(place, recording, found[model])})
            if follow and name == "validation":
                other = followed(body, recording, found[model])
                lines[-1]["misfit_followed"] = misfits(other, recording, found[model])["misfit"]
                lines[-1]["largest_difference"] = float(np.max(np.linalg.norm(other - place, axis=1)))
            print(lines[-1])
        print({name: value.tolist() for name, value in found[model].items()})
    report = {"misfits": lines, "parameters": found}
    files = draw.render(figure(recordings, predicted, found), "recordings") | {"recordings.json": as_json(report)}
    write_all(OUT, files)
