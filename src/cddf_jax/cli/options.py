"""What several commands share: their options, reading the manipulator and the data, and printing the answer."""

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn, TypeVar

import typer

from ..batch.drafts import check_folder
from ..errors import InputError, in_utf8, within
from ..progress import stage

if TYPE_CHECKING:
    from ..files.manipulator_file import RobotFile
    from ..measurements.table import Measurements
    from ..reports.report import Report
    from ..robot.loads import Loads

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130  # exit codes
T = TypeVar("T")


def writable(folder: Path | None) -> Path | None:
    """Refuse `--out` before the work begins, if nothing can be written there."""
    if folder is not None:
        with within("--out"):
            check_folder(folder)
    return folder


Kinematics = Literal["published", "exact"]
Robot = Annotated[Path, typer.Argument(help="TOML file of the manipulator, such as data/smooth_sil_940.toml.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object in SI units and nothing else.")]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for report, figures and files, such as out/run_1. It is made if it is missing.", callback=writable
    ),
]
KinematicsOption = Annotated[
    Kinematics | None, typer.Option(help="Kinematics of the tendons, in place of those in the file.")
]
Nodes = Annotated[int, typer.Option(help="Gauss nodes in each smooth piece of the body, 4 or more.", min=4)]
Direction = Annotated[
    list[int] | None,
    typer.Option(
        help="1: the tendon slides in at the base (it is pulled); -1: it slides out. Give it once for all tendons, or "
        "once for each.",
        show_default="found from the travel; 1 for a single tendon",
    ),
]
TipForce = Annotated[
    str | None, typer.Option(help='Dead load on the tip: (X, Y), in space (X, Y, Z), such as "0 N, -5 N".')
]
TipMoment = Annotated[
    str | None,
    typer.Option(
        help='Moment on the tip, such as "0.1 N m", positive from X to Y; in space (X, Y, Z), such as "0, 0, 0.1 N m".'
    ),
]
PointLoads = Annotated[
    list[str] | None,
    typer.Option(
        help='Dead load at a place of the body, and perhaps a moment, such as "60 mm: 0, -1 N" or '
        '"60 mm: 0, -1 N and 0.1 N m"; give it once for each.',
    ),
]
Gravity = Annotated[
    str | None,
    typer.Option(
        help='Acceleration of gravity: (X, Y), in space (X, Y, Z), such as "0, -9.81 m/s^2". The body needs a mass. '
        "Zeros switch off that of the robot file.",
        show_default="that of the robot file",
    ),
]
Given = Annotated[
    list[str] | None,
    typer.Option(
        help='A known number of the bench, such as "tip_gain=1.03" or "camera_turn_z=3 deg". If it is fitted as well, '
        "the search starts there.",
    ),
]
Marker = Annotated[
    list[str] | None,
    typer.Option(
        help="Place of the marker of the columns x@NAME: offset from the axis (x along the body, y, z) and arc length, "
        'such as "head=0, 11, 0 mm at 80 mm".',
    ),
]
Data = Annotated[
    list[Path] | None,
    typer.Argument(
        help="CSV or .xlsx files with the units in the header, such as bench.csv. Files with the same columns are the "
        "trials of one experiment. Name a table of markers after the file that it belongs to."
    ),
]
Free = Annotated[
    list[str] | None,
    typer.Option(
        help='A parameter to fit, such as "friction_coefficient". Repeat the option for more parameters. "camera" is '
        "the whole pose of the frame of measured positions.",
        show_default="friction and modulus",
    ),
]
Column = Annotated[
    list[str] | None,
    typer.Option(
        help='What a column of the data is, with its unit, such as "Tbase_N=base_tension [N]". "NAME=" leaves it out.'
    ),
]
ShortSteps = Annotated[
    int, typer.Option(help="With several tendons or loads: increments for each long step of a history.", min=2)
]
AverageHolds = Annotated[
    bool,
    typer.Option("--average-holds", help="One reading for each hold: consecutive rows of a trial at one level."),
]
LeaveOutOption = Annotated[
    list[str] | None,
    typer.Option(
        help='Rows whose readings do not count, by their numbers in the file: "8, 14, 20-23", of several files '
        '"run_2.csv=8, 14". With a history they stay as steps of the path.',
        show_default="none",
    ),
]
EachFromRest = Annotated[
    bool,
    typer.Option(
        "--each-from-rest",
        help="Follow each row from rest, its tensions and forces in proportion. Loads of all rows act before.",
        show_default="where rows without history are contradicted",
    ),
]
HistoryOption = Annotated[
    bool | None,
    typer.Option(
        "--history/--no-history",
        help="Follow the rows of a trial as a path, on which tendons are pulled and released.",
        show_default="where a column step or time gives the order",
    ),
]


def stop(message: str, code: int) -> NoReturn:
    """End the command with one line on standard error."""
    typer.echo("error: " + in_utf8(" ".join(message.split())), err=True)
    sys.exit(code)


def note(lines: Iterable[str]) -> None:
    """Lines on standard error: how files were read."""
    for line in lines:
        typer.echo(in_utf8(f"note: {line}"), err=True)


def print_answer(text: str, answer: object, *, as_json: bool) -> None:
    """The answer on standard output, in words or as one JSON object, whose other characters are escaped."""
    if as_json:
        import json

        from ..files.writing import plain

        text = json.dumps(plain(answer), indent=2)
    typer.echo(in_utf8(text))


def give(report: "Report", out: Path | None, *, as_json: bool, code: int = FAILED) -> None:
    """Write a report to the folder of `--out`, print it, and end the command with an exit code if it failed.

    What cannot be written is said; the answer is printed all the same.
    """
    try:
        with within("not written"):
            if out is not None:
                report.write(out)
    finally:
        print_answer(report.text, report.answer, as_json=as_json)
    if report.failure:
        stop(report.failure, code)


def read_robot(robot: Path, kinematics: Kinematics | None) -> "RobotFile":
    """Set JAX up and read the manipulator's file; how a table of cross-sections was read is noted on standard error.

    `kinematics` stand in place of those of the file.
    """
    from dataclasses import replace

    from .. import application

    with stage("loading"):
        application.configure_jax()
        from ..files.cross_sections import in_one_line
        from ..files.manipulator_file import read_robot_file

    read = read_robot_file(robot)
    if read.columns:
        note([in_one_line(read.columns)])
    if kinematics is None:
        return read
    with within(f"--kinematics {kinematics}", ValueError):
        return read._replace(manipulator=replace(read.manipulator, kinematics=kinematics))


def loads_of(
    robot: "RobotFile",
    tip_force: str | None,
    tip_moment: str | None,
    gravity: str | None,
    point_load: Sequence[str] | None,
) -> "Loads | None":
    """The loads of the options; without `--gravity` that of the robot's file, which is noted on standard error."""
    from ..files.actuation import read_loads
    from ..robot.loads import gravity_in_words

    if robot.gravity is not None and gravity is None:
        note([f"{gravity_in_words(robot.gravity)}, of the robot file"])
    return read_loads(tip_force, tip_moment, gravity, point_load, robot.gravity)


def read_data(
    paths: Sequence[Path] | None, column: Sequence[str] | None, *, holds_averaged: bool = False
) -> "tuple[Measurements, ...]":
    """The measurements in files; what was done to read them is noted on standard error."""
    from ..measurements.holds import average_holds
    from ..measurements.trials import read_tables

    tables = read_tables(paths or (), read_columns(column))
    note(line for table in tables for line in table.read_as)
    return tuple(map(average_holds, tables)) if holds_averaged else tables


def read_columns(column: Sequence[str] | None) -> dict[str, str]:
    """What columns are, by their names in the files."""
    return read_all(column, "--column", '"Tbase_N=base_tension [N]"', lambda name, meant: meant)


def read_all(texts: Sequence[str] | None, option: str, example: str, read: Callable[[str, str], T]) -> dict[str, T]:
    """The values of an option that may be repeated, by name; `read` makes a value of name and text behind "="."""
    found: dict[str, T] = {}
    for text in texts or ():
        name, equals, value = (part.strip() for part in text.rpartition("="))
        if not name or not equals:
            raise InputError(f"{option} {text!r}: write for example {example}")
        if name in found:
            raise InputError(f"{option} {name} is given twice; leave one out")
        found[name] = read(name, value)
    return found
