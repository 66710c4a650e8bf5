"""Study: a measured body, a conical silicone tentacle that hangs from its base (data/soft_tentacle).

The data are 22 poses under gravity, with four markers each. Fourteen have one tendon pulled. Eight have two pulled,
and leave every plane. Each fit has one modulus for all its poses. Nobody measured a tension at the tip. Errors below
are root mean squares per coordinate, of a body of 360 mm.

One modulus, without friction:
- In the plane the 14 poses with one tendon leave 8.9 mm (published kinematics, 302 kPa), or 9.8 mm (exact, 336 kPa).
- In space without stretch all poses together leave 9.4 mm with one tendon and 11.3 mm with two (318 kPa).
- With stretch and shear they leave 7.6 and 8.1 mm (349 kPa), 7.77 mm in all, the least of all 264 coordinates together.
  The two kinds of poses ask for different moduli: those with one tendon alone for 356 kPa (7.49 mm), those with two for
  337 kPa (7.65 mm). At 340 kPa, which another analysis gave, they leave 8.2 and 7.7 mm, and 8.00 mm in all.

So it is the model that errs, in a way that is common to a pose. A pose counts as one reading, and what is fitted beside
the modulus has a large standard error. Several things lower the error about as much, and most change the modulus:
- friction of 0.11 +- 0.06: 7.10 mm in all, 290 kPa. It is 0.07 for the poses with one tendon and 0.17 with two;
- tensions, which are torques of motors over a radius, that are larger by a fifth than read: 6.76 mm, 447 kPa;
- tendons that run 1.8 mm farther out than stated: 6.73 mm, 538 kPa;
- a frame of the markers that is turned by 3.6 degrees: 6.93 mm, 350 kPa; gravity turned by 1.4 degrees: 7.55 mm.
The data do not tell these from one another. So friction is not identified, and the modulus is known only if all else
is as stated. An axial stiffness of its own, 0.96 +- 0.29 times E A, changes nothing: the body does stretch, as much as
its modulus tells. Of Poisson's ratio and of shear the data tell nothing.

Each fit takes minutes. Without arguments the study fits the modulus; names of `cases` as arguments fit the rest.
"""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.figures import looks, style as draw
from cddf_jax.files.writing import as_json, write_all
from cddf_jax.measurements.readings import kind_of

TABLE = Path(__file__).resolve().parents[1] / "data/soft_tentacle/tension_markers.csv"
ROBOT = Path(__file__).with_suffix(".toml")
OUT = "out/fitting/soft_tentacle"
COLUMNS = {
    **{"run": "trial", "tendon1_tension_N": "base_tension [N]", "tendon2_tension_N": "base_tension_2 [N]"},
    **{f"m{i}_{axis}_m": f"{axis}@m{i} [m]" for i in (1, 2, 3, 4) for axis in "xyz"},
}
MARKERS = {  # ahead of the cross-section, and beside the axis
    "m1": cddf.Marker(0.1291, (0.0, 0.0, 0.025)),
    "m2": cddf.Marker(0.2195, (0.0, 0.0, -0.021)),
    "m3": cddf.Marker(0.280, (0.0, 0.0, 0.020)),
    "m4": cddf.Marker(0.360, (0.008, 0.0, 0.0)),
}
CAMERA = {"camera_turn_y": np.pi / 2}  # the frame of the markers has z up, and its x is the body's z
ERROR, ERROR_IN_PLANE = 0.008, 0.009  # m, of the model, in each coordinate; those of a pose count as one reading
BOUNDS = {"youngs_modulus": (1e5, 8e5), "axial_factor": (0.05, 20.0)}
NODES = 12
BESIDE = {  # what may be fitted beside the modulus, all poses, with stretch
    "friction": ("friction_coefficient",),
    "axial stiffness": ("axial_factor",),
    "Poisson's ratio": ("poissons_ratio",),
    "direction of gravity": ("gravity_turn_y", "gravity_turn_z"),
    "offset of the tendons": ("tendon_offset_error",),
    "gain of the tensions": ("base_gain",),
    "pose of the camera": tuple(f"camera{turn}_{axis}" for turn in ("", "_turn") for axis in "xyz"),
}
AT_ONCE = ("no stretch", "stretch", "in the plane, published", "in the plane, exact")


class Case(NamedTuple):
    """What is fitted to what."""

    body: cddf.Manipulator
    table: cddf.Measurements
    setting: cddf.BenchSetting
    beside: tuple[str, ...] = ()  # the modulus
    error: float = ERROR


def setting_of(gravity: tuple[float, ...]) -> cddf.BenchSetting:
    """What all poses share, with the gravity of the robot file, m/s^2."""
    return cddf.BenchSetting(cddf.Loads(gravity=gravity), MARKERS, CAMERA)


def read_poses() -> cddf.Measurements:
    """All 22 poses; both tendons slide in."""
    table = cddf.read_measurements(TABLE, COLUMNS)
    pulled = np.ones(len(table))
    return replace(table, columns={**table.columns, "direction": pulled, "direction_2": pulled})


def some(table: cddf.Measurements, which: np.ndarray) -> cddf.Measurements:
    """The poses where `which` is true."""
    return replace(table, columns={name: one[which] for name, one in table.columns.items()}, rows=table.rows[which])


def with_two(table: cddf.Measurements) -> np.ndarray:
    """(poses,): whether both tendons are pulled."""
    return (table["base_tension"] > 0) & (table["base_tension_2"] > 0)


def fit(case: Case) -> cddf.Fit:
    """The modulus, and what is named beside it, from the markers of a table."""
    columns = [column for column in case.table.columns if kind_of(column)]
    noise, free = {column: case.error * len(columns) ** 0.5 for column in columns}, ("youngs_modulus", *case.beside)
    bounds = {name: BOUNDS[name] for name in free if name in BOUNDS}
    options: Any = {"bounds": bounds, "noise": noise, "setting": case.setting, "starts": 1, "nodes": NODES}
    return cddf.fit(case.body, case.table, free, **options)


def left(found: cddf.Fit) -> np.ndarray:
    """(poses, coordinates): measured less predicted, m."""
    return np.stack(list(found.residuals.values()), axis=1)


def rms(residuals: Any, axis: Any = None) -> Any:
    """Root mean square per coordinate, m."""
    return np.sqrt(np.mean(np.asarray(residuals) ** 2, axis=axis))


def in_plane(table: cddf.Measurements) -> cddf.Measurements:
    """The poses with one tendon pulled, in the plane of that tendon and the straight body: x down, y to the tendon."""
    alone = some(table, ~with_two(table))
    angle = np.where(alone["base_tension"] > 0, *np.radians([60.0, -60.0]))  # from the frame's x to the tendon
    columns = {"base_tension": alone["base_tension"] + alone["base_tension_2"], "trial": alone["trial"]}
    for name in MARKERS:
        x, y, z = (alone[f"{axis}@{name}"] for axis in "xyz")
        columns |= {f"x@{name}": -z, f"y@{name}": np.cos(angle) * x + np.sin(angle) * y}
    return replace(alone, columns=columns)


def body_in_plane(robot: cddf.Manipulator, kinematics: str) -> cddf.Manipulator:
    """The body with one of its tendons."""
    tendon = replace(robot.tendons[0], angle=None)
    return replace(robot, tendons=(tendon,), extensible=False, kinematics=kinematics)


def setting_in_plane(gravity: tuple[float, ...]) -> cddf.BenchSetting:
    """Markers lie aside by half of their offset, since the tendon is at 60 degrees from it; gravity is along x."""
    aside = {name: one._replace(offset=(one.offset[0], 0.5 * one.offset[2])) for name, one in MARKERS.items()}
    return cddf.BenchSetting(cddf.Loads(gravity=gravity[:2]), aside)


def cases() -> dict[str, Case]:
    """Every fit of the study by its name."""
    poses, file = read_poses(), cddf.read_robot_file(ROBOT)
    robot, gravity = file.manipulator, file.gravity or (0.0, 0.0, 0.0)
    setting, planar = setting_of(gravity), setting_in_plane(gravity)
    rubbed, two = replace(robot, friction_coefficient=0.1), with_two(poses)
    found = {"no stretch": Case(replace(robot, extensible=False), poses, setting)}
    for name, table in (("", poses), (", one", some(poses, ~two)), (", two", some(poses, two))):
        found[f"stretch{name}"] = Case(robot, table, setting)
    for name, beside in BESIDE.items():
        found[name] = Case(rubbed if name == "friction" else robot, poses, setting, beside)
    table, pull, first = in_plane(poses), in_plane(poses)["base_tension"], poses["base_tension"][~two] > 0
    parts = {"all": pull > 0, "below 7 N": pull < 7, "tendon 1": first, "tendon 2": ~first}
    for kinematics in ("published", "exact"):
        body = body_in_plane(robot, kinematics)
        found[f"in the plane, {kinematics}"] = Case(body, table, planar, error=ERROR_IN_PLANE)
        for name, part in parts.items():
            sliding = replace(body, friction_coefficient=0.1), some(table, part), planar, BESIDE["friction"]
            found[f"in the plane, {kinematics}, friction, {name}"] = Case(*sliding, ERROR_IN_PLANE)
    return found


def results_of(found: cddf.Fit) -> dict[str, Any]:
    """A fit with its errors: of all its poses, of those with one tendon, with two, and of each pose, m."""
    (table,), errors = found.tables, left(found)
    two = with_two(table) if "base_tension_2" in table else np.zeros(len(table), bool)
    parts = {"rms": slice(None), "rms_one_tendon": ~two, "rms_two_tendons": two}
    names = [table.trial_labels[int(i)] for i in table["trial"]]
    told = {name: getattr(found, name) for name in ("value", "standard_error", "confidence_interval", "status")}
    told |= {name: rms(errors[which]) for name, which in parts.items() if errors[which].size}
    return told | {"rms_of_pose": dict(zip(names, rms(errors, 1).tolist(), strict=True))}


def line(name: str, one: Mapping[str, Any]) -> str:
    """One fit in words."""
    errors = [f"{1e3 * one[key]:.2f}" if key in one else "-" for key in ("rms", "rms_one_tendon", "rms_two_tendons")]
    told = []
    for parameter, value in one["value"].items():
        size, unit = (1e3, " kPa") if parameter == "youngs_modulus" else (1.0, "")
        status, error = one["status"][parameter], one["standard_error"][parameter]
        if status != "fixed":
            doubt = f"+- {error / size:.2g}{unit}" if status == "identified" else status
            told.append(f"{parameter} {value / size:.3g}{unit} ({doubt})")
    return f"{name:<42} {'  '.join(f'{error:>5}' for error in errors)}   {', '.join(told)}"


def figure_of(fits: Mapping[str, cddf.Fit]) -> Figure:
    """The error of each pose without and with stretch, and the tips seen from below, measured and predicted."""
    (poses,) = fits["stretch"].tables
    pulled, two = poses["base_tension"] + poses["base_tension_2"], with_two(poses)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 2.8)
        errors, below = figure.subplots(1, 2)
        for name, color, markers in (("no stretch", looks.VERMILION, "x+"), ("stretch", looks.BLUE, "os")):
            of_each = 1e3 * rms(left(fits[name]), 1)
            for some, marker, note in zip((~two, two), markers, ("one tendon", "two tendons"), strict=True):
                look = {"color": color, "markerfacecolor": "none", "label": f"{name}, {note}"}
                errors.plot(pulled[some], of_each[some], marker, **look)
        errors.set(xlabel="Sum of base tensions (N)", ylabel="Error, rms per coordinate (mm)", ylim=(0.0, 32.0))
        errors.legend()
        tips, off = 1e3 * np.stack([poses["y@m4"], poses["x@m4"]], axis=1), 1e3 * left(fits["stretch"])[:, [-2, -3]]
        for tip, miss in zip(tips, off, strict=True):
            below.plot(*np.stack([tip, tip - miss]).T, color=looks.GREY, linewidth=0.6)
        below.plot(*tips.T, "o", color=looks.BLACK, markerfacecolor="none", label="measured")
        below.plot(*(tips - off).T, "+", color=looks.BLACK, label="predicted, stretch")
        below.set(xlabel="$y$ of the last marker (mm)", ylabel="$z$ (mm)", aspect="equal", ylim=(0.0, 240.0))
        below.legend()
    return figure


def main() -> None:
    """Run the study and write its files, if the data are there."""
    if not TABLE.exists():
        print(f"soft_tentacle: nothing done, the measured data are not here: {TABLE}")
        return
    every = cases()
    print("error per coordinate, mm, root mean square: all, 14 poses with one tendon, 8 with two", flush=True)
    fits, results = {}, {}
    for name in sys.argv[1:] or AT_ONCE:
        fits[name] = fit(every[name])
        results[name] = results_of(fits[name])
        print(line(name, results[name]), flush=True)
    files: dict[str, str | bytes] = {"soft_tentacle.json": as_json(results)}
    if {"no stretch", "stretch"} <= set(fits):
        files |= draw.render(figure_of(fits), "errors")
    write_all(OUT, files)


if __name__ == "__main__":
    configure_jax()
    main()
