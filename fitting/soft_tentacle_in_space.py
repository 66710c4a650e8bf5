"""Study: the measured tentacle of `soft_tentacle` in space, with all 22 poses (../shared/data/soft_tentacle).

Fourteen poses have one tendon pulled. Eight have two pulled, and leave every plane. Each fit has one modulus for all
264 marker coordinates. The frame is that of the library: x along the straight body, which hangs along gravity.

A pose counts as one reading, as in the plane: the errors are those of the model, and common to a pose. What is fitted
beside the modulus is "not identified" where the data, with errors of this size, do not tell it.

Each fit takes minutes. Without arguments the study fits the modulus without and with stretch, and says by derivatives
near that fit what else the data tell. Names of `FITS` as arguments fit the rest in full.
"""

import sys
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from soft_tentacle import (
    AHEAD,
    ANCHOR,
    ASIDE,
    DENSITY,
    GRAVITY,
    LENGTH,
    MARKER,
    TABLE,
    body as in_plane,
    described,
    rms,
)

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.artifacts import as_json, write_all

OUT = "out/fitting/soft_tentacle_in_space"
ANGLES = np.radians([30.0, 150.0])  # of the tendons, from y to z of the body
TO_BODY = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # from the base frame, z up
POSE_ERROR = 0.008 * 12**0.5  # the twelve coordinates of a pose, each 8 mm off, count as one reading
NODES = 12
START = {
    "youngs_modulus": 3.3e5,
    "friction_coefficient": 0.1,
    "axial_factor": 1.0,  # axial stiffness over E A
    "poissons_ratio": 0.5,
    "gravity_y": 0.0,  # direction of gravity off the straight body, rad
    "gravity_z": 0.0,
}
BOUNDS = {
    "youngs_modulus": (1e5, 8e5),
    "friction_coefficient": (0.0, None),
    "axial_factor": (0.05, 20.0),
    "poissons_ratio": (0.0, None),
}
FITS = {  # whether the body stretches and shears, and what is fitted
    "no stretch": (False, ("youngs_modulus",)),
    "stretch": (True, ("youngs_modulus",)),
    "stretch, friction": (True, ("youngs_modulus", "friction_coefficient")),
    "stretch apart from bending": (True, ("youngs_modulus", "axial_factor")),
    "stretch, Poisson's ratio": (True, ("youngs_modulus", "poissons_ratio")),
    "stretch, direction of gravity": (True, ("youngs_modulus", "gravity_y", "gravity_z")),
}


class Poses(NamedTuple):
    """The poses in the frame at the base, x along the straight body; m and N."""

    name: np.ndarray
    tension: np.ndarray  # (poses, 2)
    markers: np.ndarray  # (poses, markers, 3)

    @property
    def with_two(self) -> np.ndarray:
        """Whether both tendons are pulled."""
        return np.all(self.tension > 0.0, axis=1)


def read_poses() -> Poses:
    """The whole table."""
    table: Any = np.genfromtxt(TABLE, delimiter=",", names=True, dtype=None, encoding="utf-8")
    tension = np.stack([table["tendon1_tension_N"], table["tendon2_tension_N"]], axis=1)
    places = np.array([[table[f"m{i}_{axis}_m"] for axis in "xyz"] for i in (1, 2, 3, 4)])
    return Poses(table["run"], tension, np.moveaxis(places, -1, 0) @ TO_BODY.T)


def body(numbers: dict[str, Any], extensible: bool) -> cddf.Manipulator:
    """The tentacle with both of its tendons."""
    plain = in_plane(1.0, 0.0, "exact")
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=plain.outer_radius,
        inner_radius=0.0,
        tendons=tuple(cddf.Tendon(plain.tendons[0].offset, end=ANCHOR, angle=angle) for angle in ANGLES),
        youngs_modulus=numbers["youngs_modulus"],
        friction_coefficient=numbers.get("friction_coefficient", 0.0),
        poissons_ratio=numbers.get("poissons_ratio", 0.5),
        density=DENSITY,
        extensible=extensible,
        axial_factor=numbers.get("axial_factor"),
    )


class Prediction(eqx.Module):
    """Predicts the markers of all poses from parameters, one pose after the other: at once takes twice the time."""

    tension: Any
    extensible: bool = eqx.field(static=True)

    def __call__(self, numbers: dict[str, Any]) -> jax.Array:
        across = [jnp.asarray(numbers.get(f"gravity_{axis}", 0.0)) for axis in "yz"]
        along = jnp.sqrt(1.0 - across[0] ** 2 - across[1] ** 2)
        loads = cddf.Loads(gravity=GRAVITY * jnp.stack([along, *across]))

        def markers(tension: jax.Array) -> jax.Array:
            found = cddf.solve(body(numbers, self.extensible), tension, loads, direction=1.0, nodes=NODES, throw=False)
            at = found.at(MARKER)
            assert isinstance(at, cddf.SpatialFields)
            place = at.position + AHEAD[:, None] * at.frame[..., 0] + ASIDE[:, None] * at.frame[..., 2]
            solved = (found.result == cddf.RESULTS.successful) | (found.result == cddf.RESULTS.inaccurate)
            return jnp.where(solved, place, jnp.nan)

        return jax.lax.map(markers, jnp.asarray(self.tension))


def fit(poses: Poses, extensible: bool, free: tuple[str, ...]) -> cddf.LeastSquaresFit:
    """Fit the free parameters to all poses."""
    start = {name: START[name] for name in free}
    bounds = {name: BOUNDS[name] for name in free if name in BOUNDS}
    sigma = np.full(poses.markers.shape, POSE_ERROR)
    predict = Prediction(poses.tension, extensible)
    return cddf.least_squares_fit(predict, start, poses.markers, sigma, bounds, max_steps=15, starts=1)


def told_near(poses: Poses) -> list[str]:
    """What the poses tell beside the modulus, linearised near the fit: one step from there, with standard errors."""
    near = START | {"youngs_modulus": 3.49e5, "friction_coefficient": 0.02}  # friction has no derivative at 0
    names, place = list(near), jnp.asarray(list(near.values()))
    predict = Prediction(poses.tension, extensible=True)

    def twice(numbers: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = predict(dict(zip(names, numbers, strict=True)))
        return found, found

    slopes, found = jax.jit(jax.jacfwd(twice, has_aux=True))(place)
    slopes = np.asarray(slopes).reshape(-1, len(names))
    left, lines = (poses.markers - np.asarray(found)).ravel(), []
    for beside in (["friction_coefficient"], ["axial_factor"], ["poissons_ratio"], ["gravity_y", "gravity_z"]):
        free = [names.index(name) for name in ("youngs_modulus", *beside)]
        covariance = np.linalg.inv(slopes[:, free].T @ slopes[:, free]) * POSE_ERROR**2
        step = covariance @ slopes[:, free].T @ left / POSE_ERROR**2
        error = np.sqrt(np.diag(covariance))
        for name, value, deviation in zip(beside, np.asarray(place)[free[1:]] + step[1:], error[1:], strict=True):
            # each of them is of order one: a standard error above one tells nothing
            told = f"{value:.2g} +- {deviation:.2g}" if deviation < 1.0 else f"not identified (+- {deviation:.2g})"
            lines.append(f"linearised: {name} {told}")
    return lines


def results_of(poses: Poses, found: cddf.LeastSquaresFit) -> dict[str, Any]:
    """A fit with its errors: of the poses with one tendon, with two, and of each pose, m."""
    two, left = poses.with_two, np.asarray(found.residuals)
    of_each = dict(zip(poses.name.tolist(), rms(left, (1, 2)).tolist(), strict=True))
    errors = {"rms_one_tendon": rms(left[~two]), "rms_two_tendons": rms(left[two]), "rms_of_pose": of_each}
    return described(found) | errors | {"residuals": left}


def figure_of(poses: Poses, results: dict[str, Any]) -> Figure:
    """The error of each pose without and with stretch, and the tips seen from below, measured and predicted."""
    pulled, two = poses.tension.sum(axis=1), poses.with_two
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 2.8)
        left, right = figure.subplots(1, 2)
        for name, color, markers in (("no stretch", looks.VERMILION, "x+"), ("stretch", looks.BLUE, "os")):
            errors = 1e3 * np.array(list(results[name]["rms_of_pose"].values()))
            for some, marker, note in zip((~two, two), markers, ("one tendon", "two tendons"), strict=True):
                look = {"color": color, "markerfacecolor": "none", "label": f"{name}, {note}"}
                left.plot(pulled[some], errors[some], marker, **look)
        left.set(xlabel="Sum of base tensions (N)", ylabel="Error, rms per coordinate (mm)", ylim=(0.0, 32.0))
        left.legend()
        tips, error = 1e3 * poses.markers[:, -1], 1e3 * results["stretch"]["residuals"][:, -1]
        for tip, off in zip(tips, error, strict=True):
            right.plot(*np.stack([tip, tip - off])[:, 1:].T, color=looks.GREY, linewidth=0.6)
        right.plot(*tips[:, 1:].T, "o", color=looks.BLACK, markerfacecolor="none", label="measured")
        right.plot(*(tips - error)[:, 1:].T, "+", color=looks.BLACK, label="predicted, stretch")
        right.set(xlabel="$y$ of the last marker (mm)", ylabel="$z$ (mm)", aspect="equal", ylim=(0.0, 240.0))
        right.legend()
    return figure


def line(name: str, one: dict[str, Any]) -> str:
    """One fit in words."""
    errors = f"{1e3 * one['rms_one_tendon']:.2f} mm, {1e3 * one['rms_two_tendons']:.2f} mm"
    told = []
    for parameter, value in one["value"].items():
        size, unit = (1e3, " kPa") if parameter == "youngs_modulus" else (1.0, "")
        error = one["standard_error"][parameter]
        doubt = f"+- {error / size:.2g}{unit}" if one["status"][parameter] == "identified" else one["status"][parameter]
        told.append(f"{parameter} {value / size:.3g}{unit} ({doubt})")
    return f"{name:<30} {errors}   {', '.join(told)}"


def main() -> None:
    """Run the study and write its files, if the data are there."""
    if not TABLE.exists():
        print(f"soft_tentacle_in_space: nothing done, the measured data are not here: {TABLE}")
        return
    poses, results = read_poses(), {}
    print("error per coordinate, root mean square: 14 poses with one tendon, 8 with two", flush=True)
    for name in sys.argv[1:] or ("no stretch", "stretch"):
        results[name] = results_of(poses, fit(poses, *FITS[name]))
        print(line(name, results[name]), flush=True)
    print(*told_near(poses), sep="\n")
    files: dict[str, str | bytes] = {"soft_tentacle_in_space.json": as_json(results)}
    if {"stretch", "no stretch"} <= set(results):
        files |= draw.render(figure_of(poses, results), "errors")
    write_all(OUT, files)


if __name__ == "__main__":
    configure_jax(quick_compilation=False)
    main()
