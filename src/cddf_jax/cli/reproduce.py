"""`cddf reproduce`: the figures and numbers of Liu et al. (2020)."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from ..progress import stage
from . import options

EXAMPLE = "Example: cddf reproduce data/smooth_sil_940.toml data/load_cells_simulated.csv"


def reproduce(
    robot: options.Robot,
    load_cells: Annotated[
        Path, typer.Argument(help="CSV file of the trials with load cells, such as data/load_cells_simulated.csv.")
    ],
    column: options.Column = None,
    as_json: options.AsJson = False,
    out: options.Out = Path("out/reproduce"),
) -> None:
    """The figures of Liu et al. (2020), and a table of its numbers beside ours."""
    read = options.read_robot(robot, None)
    if any(read.gravity or ()):
        raise InputError(f"{robot}: the paper's manipulator bears no loads, this one has gravity; leave it out")
    with stage("loading"):
        from ..reports.reproduction import reproduce

    report = reproduce(read.manipulator, options.read_data([load_cells], column)[0])
    options.give(report, out, as_json=as_json)
