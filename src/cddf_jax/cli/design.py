"""`cddf design`: the body that meets an objective best, from a task in a file."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from ..progress import stage
from . import options

if TYPE_CHECKING:
    from ..designing.results import Design
    from ..designing.task_file import DesignTask

EXAMPLE = "Example: cddf design fitting/design_least_tension.toml --out out/design"
Files = dict[str, str | bytes]  # content by name
Answer = tuple[dict[str, object], str, bool, Callable[[], Files]]  # for JSON, in words, whether it succeeded, its files


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

    read = read_task(task)
    options.note(read.read_as)
    answer, text, success, files = designed(read) if pareto is None else trade_off(read, pareto)
    with options.printed(lambda: text, answer, as_json=as_json):
        if out is not None:
            from ..files.writing import write_all

            write_all(out, files())
    if not success:
        options.stop(f"the design is not done: {answer['result']}", options.FAILED)


def designed(task: "DesignTask") -> Answer:
    """Design; the files hold the new manipulator only where it keeps to all limits."""
    from ..designing import report

    found = task.design()
    answer, text = report.design_as_dict(found), report.design_in_words(found)

    def files() -> Files:
        from ..figures import design_figure, render
        from ..files.cross_sections import cross_sections_csv
        from ..files.writing import as_json

        made: Files = {"design.md": text + "\n", "design.json": as_json(answer)}
        if found.feasible:
            made["design.toml"] = _manipulator_file(found, task)
            if found.manipulator.has_radii:
                made["profile.csv"] = cross_sections_csv(found.manipulator)
            made |= render(design_figure(found), "design")
        return made

    return answer, text, found.success, files


def trade_off(task: "DesignTask", num: int) -> Answer:
    """As `designed`, for the trade-off between the two objectives."""
    from ..designing import report

    front = task.pareto_front(num)
    answer, text = report.front_as_dict(front), report.front_in_words(front)

    def files() -> Files:
        from ..figures import draw_trade_off, render
        from ..figures.style import figure_of
        from ..files.writing import as_json

        made: Files = {"pareto.md": text + "\n", "pareto.json": as_json(answer)}
        feasible = {i: found for i, found in enumerate(front.designs, 1) if found.feasible}
        made |= {f"design_{i}.toml": _manipulator_file(found, task) for i, found in feasible.items()}
        return made | render(figure_of(draw_trade_off(front)), "pareto")

    return answer, text, front.success, files


def _manipulator_file(found: "Design", task: "DesignTask") -> str:
    from ..files.manipulator_file import manipulator_text

    outside = task.arguments["options"].offsets_outside_wall
    return manipulator_text(found.manipulator, offsets_outside_wall=outside, gravity=task.gravity)
