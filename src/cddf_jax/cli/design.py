"""`cddf design`: the body that meets an objective best, from a task in a file."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from ..progress import stage
from . import options

EXAMPLE = "Example: cddf design fitting/design_least_tension.toml --out out/design"


def design(
    task: Annotated[
        Path | None, typer.Argument(help="TOML file of the task; --template prints one with every key.")
    ] = None,
    template: Annotated[
        bool,
        typer.Option("--template", help="Print a task file with every key and the names of all quantities, and end."),
    ] = False,
    pareto: Annotated[
        int | None,
        typer.Option(help="Number of designs on the trade-off between the two objectives of the task.", min=3),
    ] = None,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """The body that meets an objective best within its limits.

    The task file names the robot at the start, the free numbers, the load cases, the objectives and the limits.
    """
    if template:
        from ..designing import task_file

        typer.echo(task_file.template(), nl=False)
        return
    if task is None:
        raise InputError("give a task file; cddf design --template prints one with every key")
    from .. import application

    with stage("loading"):
        application.configure_jax()
        from ..designing.task_file import read_task
        from ..reports.design_report import design_report

    read = read_task(task)
    options.note(read.read_as)
    found = read.design() if pareto is None else read.pareto_front(pareto)
    options.give(design_report(read, found), out, as_json=as_json)
