"""`cddf solve`: the equilibrium under tensions, targets and dead loads."""

from typing import Annotated

import typer

from ..errors import SolveError, within
from ..progress import stage
from . import options

EXAMPLE = 'Example: cddf solve data/smooth_sil_940.toml -t "75 N" --tip-force "0 N, -5 N"'
BaseTension = Annotated[
    list[str],
    typer.Option(
        "--base-tension",
        "-t",
        help='Tension at the base, such as "75 N", once for all tendons or once for each. Or a target in its place: '
        '"tip_angle=45 deg", "displacement=12 mm", "tip_tension=40 N", "curvature=8 1/m at 70 mm", '
        '"total_tension=100 N", "tip_stiffness=350 N/m". For all tendons together "tip_position=120, 50 mm from 1 N to '
        '90 N": a place of the tip, reached with the least total tension, and the limits of each tension.',
    ),
]


def solve(
    robot: options.Robot,
    base_tension: BaseTension,
    direction: options.Direction = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Shape, tension and friction of a manipulator under tensions and dead loads.

    X runs along the straight body from its base, Y to the side of a tendon with side = 1.
    """
    read = options.read_robot(robot, kinematics)
    manipulator, columns = read.manipulator, read.columns
    with stage("loading"):
        from ..files.actuation import read_actuation, read_directions
        from ..reports.solve_report import missed_targets_in_words, solve_as_dict, solve_in_words
        from ..statics.equilibrium import ended_as, on_host
        from ..statics.equilibrium_text import result_in_words
        from ..statics.solve import solve
        from ..statics.status import Status, words_of

    actuation = read_actuation(base_tension, manipulator)
    loads = options.loads_of(read, tip_force, tip_moment, gravity)
    directions = read_directions(direction, manipulator)
    with stage("solving"), within(robot, ValueError):
        equilibrium = on_host(solve(manipulator, actuation, loads, direction=directions, nodes=nodes, throw=False))
    if ended_as(equilibrium, Status.slack, Status.unreachable):
        raise SolveError(missed_targets_in_words(equilibrium, actuation, base_tension))
    if not ended_as(equilibrium, Status.successful, Status.direction_contradicted, Status.unstable):
        raise SolveError(result_in_words(equilibrium))
    answer = solve_as_dict(equilibrium, actuation, loads)
    text = solve_in_words(equilibrium, actuation, base_tension, loads)
    if columns:
        answer["cross_sections"] = {column.name: column.words for column in columns}
    with options.printed(lambda: text, answer, as_json=as_json):
        if out is not None:
            from ..figures.along import sections_figure
            from ..figures.body import equilibrium_figure
            from ..figures.style import render
            from ..files.writing import as_json as json_text, write_all
            from ..reports.export import fields_csv, fields_on_grid

            figures = render(equilibrium_figure(manipulator, equilibrium, loads), "solve")
            if columns:
                figures |= render(sections_figure(columns), "cross_sections")
            tables = {"solve.json": json_text(answer), "fields.csv": fields_csv(fields_on_grid(equilibrium))}
            write_all(out, figures | tables)
    if ended_as(equilibrium, Status.unstable):
        options.stop(words_of(equilibrium.status), options.FAILED)
