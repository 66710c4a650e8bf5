"""`cddf explore`: a page in the browser with sliders, data and a fit."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import in_utf8, needed
from ..progress import stage
from . import options

EXAMPLE = "Example: cddf explore data/smooth_sil_940.toml data/tip_angle_simulated.csv"


def explore(
    robot: Annotated[
        Path | None,
        typer.Argument(help="TOML file of the manipulator; the paper's manipulator unless given."),
    ] = None,
    data: options.Data = None,
    column: options.Column = None,
    kinematics: options.KinematicsOption = None,
    port: Annotated[
        int, typer.Option(help="Port on this machine, such as 5006.", min=0, max=65535, show_default="a free one")
    ] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address and open nothing.")] = False,
) -> None:
    """A page in the browser: sliders for body and load, the data beside the model, a fit.

    It is served on this machine alone and needs no network. Ctrl-C ends it.
    """
    read = None if robot is None else options.read_robot(robot, kinematics)
    from dataclasses import replace

    from .. import application

    application.configure_jax()
    with stage("loading"):
        needed("panel", "explore")
        from ..explorer import server
        from ..files.manipulator_file import RobotFile

    paper = server.papers_manipulator()
    paper = paper if kinematics is None else replace(paper, kinematics=kinematics)
    server.serve(
        RobotFile(paper, {}, False) if read is None else read,
        options.read_data(data, column),
        server.PAPER if robot is None else in_utf8(robot),
        port=port,
        browser=not no_browser,
    )
