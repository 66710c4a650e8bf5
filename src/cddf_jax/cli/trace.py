"""`cddf trace`: a tendon that is pulled and released."""

from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError, within
from ..progress import stage
from . import options

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..measurements.path_file import PathFile
    from ..units import Dimension

EXAMPLE = 'Example: cddf trace data/smooth_sil_940.toml --path "0 N, 75 N, 40 N, 60 N, 75 N" --out out/trace'
TABLES = (".csv", ".xlsx")
PathOption = Annotated[
    list[str],
    typer.Option(
        "--path",
        help='Base tensions in their order in time, from rest, such as "0 N, 75 N, 40 N", or displacements of the '
        'tendon, such as "0 mm, 12 mm, 10 mm", or tip angles, such as "60 deg, 30 deg". Or a CSV or .xlsx file with a '
        "column base_tension [N], displacement [mm] or tip_angle [deg]. Between two values the path is "
        'straight. With several tendons, give it once for each; a single value such as "20 N" is kept.',
    ),
]
NoiseOption = Annotated[
    str | None,
    typer.Option(
        "--noise",
        help='Standard deviation of the base tensions in a file, such as "0.1 N": smaller turns count as jitter of the '
        "cell.",
    ),
]
BeforeOption = Annotated[
    str | None,
    typer.Option(
        help='The largest base tension before the path, such as "80 N", from which the tendon is released to the first '
        'step; with several tendons one for each, such as "80 N, 20 N". Displacements before it are its first steps.',
        show_default="rest",
    ),
]


def trace(
    robot: options.Robot,
    path: PathOption,
    column: options.Column = None,
    noise: NoiseOption = None,
    before: BeforeOption = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    point_load: options.PointLoads = None,
    short_steps: options.ShortSteps = 4,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Pull and release: what slides in each step of a path, the state after the step, and the energy lost to friction.

    With friction the way back differs from the way up. The answer is exact for one tendon without loads. Several
    tendons and loads are followed in increments; the loads act before the first step.
    """
    read = options.read_robot(robot, kinematics)
    manipulator = read.manipulator
    with stage("loading"):
        from ..reports.trace_report import trace_report, traced
        from ..units import series

    loads, count = options.loads_of(read, tip_force, tip_moment, gravity, point_load), manipulator.num_tendons
    paths, driven = read_paths(path, noise, count, column)
    largest = None
    if before is not None:
        largest, _ = series(before, ("force",), "--before")
        if len(largest) != count or min(largest) < 0:
            raise InputError(f"--before {before}: give a tension of 0 N or more for each of {count} tendon(s)")
    with within(robot, ValueError):
        found = traced(manipulator, paths, driven, loads, nodes, short_steps, largest)
    options.give(trace_report(found), out, as_json=as_json)


def read_paths(
    texts: "Sequence[str]", noise: str | None, count: int, column: "Sequence[str] | None" = None
) -> "tuple[list[list[float]], list[Dimension]]":
    """Paths of all tendons, of one length, and what they measure."""
    from ..files.actuation import one_for_each_tendon

    columns = options.read_columns(column)
    every = [read_path(text, noise, columns) for text in texts]
    for name in columns:
        if not any(name in one.described for one in every):
            raise InputError(f"--path {', '.join(texts)}: no path takes a column {name!r}; check the name")
    read = one_for_each_tendon("--path", every, count)
    steps = max(len(one.values) for one in read)
    paths = [one.values * steps if len(one.values) == 1 else one.values for one in read]
    if any(len(values) != steps for values in paths):
        lengths = ", ".join(str(len(one.values)) for one in read)
        raise InputError(
            f"--path: the tendons have {lengths} steps; give each the same number, or one value that stays"
        )
    driven: list[Dimension] = [one.dimension for one in read]
    if count > 1 and "angle" in driven:
        raise InputError("--path: a tip angle drives one tendon alone; give tensions or displacements")
    return paths, driven


def read_path(text: str, noise: str | None, columns: "Mapping[str, str]") -> "PathFile":
    """A path as typed or in a file; where a noise is given, turns that are jitter are left out.

    How a file was read is noted on standard error.
    """
    import numpy as np

    from ..measurements.jitter import without_jitter
    from ..measurements.path_file import PathFile, read_path_file
    from ..units import quantity, series

    if not text.strip().lower().endswith(TABLES):
        if noise is not None:
            raise InputError(f"--noise {noise}: is for a file only; leave it out, or give a file with --path")
        values, dimension = series(text, ("force", "length", "angle"), "--path")
        if dimension == "force" and min(values) < 0:
            raise InputError(f"--path {text}: a tendon cannot push; give 0 N or more")
        return PathFile(values, dimension, (), set())
    found = read_path_file(text.strip(), columns)
    options.note(f"{text.strip()}: {line}" for line in found.read_as)
    if noise is None:
        return found
    if found.dimension != "force":
        raise InputError(f"--noise {noise}: is for base tensions, and {text.strip()} has none; leave it out")
    deviation = quantity(noise, "force", "--noise")
    if not deviation > 0:
        raise InputError(f"--noise {noise}: give a standard deviation above 0 N, or leave it out")
    steady = without_jitter(np.array(found.values), deviation)
    options.note([f"{steady.num_ignored} turns of the base tension are taken for jitter and left out"])
    return found._replace(values=np.maximum(steady.tension, 0.0).tolist())
