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
    point_load: options.PointLoads = None,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Shape, tension and friction of a manipulator under tensions and dead loads.

    X runs along the straight body from its base, Y to the side of a tendon with side = 1.
    """
    read = options.read_robot(robot, kinematics)
    manipulator = read.manipulator
    with stage("loading"):
        from ..files.actuation import read_actuation, read_directions
        from ..reports.solve_report import missed_targets_in_words, solve_report
        from ..statics.equilibrium import ended_as, on_host
        from ..statics.equilibrium_text import result_in_words
        from ..statics.solve import solve
        from ..statics.status import Status

    actuation = read_actuation(base_tension, manipulator)
    loads = options.loads_of(read, tip_force, tip_moment, gravity, point_load)
    directions = read_directions(direction, manipulator)
    with stage("solving"), within(robot, ValueError):
        equilibrium = on_host(solve(manipulator, actuation, loads, direction=directions, nodes=nodes, throw=False))
    if ended_as(equilibrium, Status.slack, Status.unreachable):
        raise SolveError(missed_targets_in_words(equilibrium, actuation, base_tension))
    if not ended_as(equilibrium, Status.successful, Status.direction_contradicted, Status.unstable):
        raise SolveError(result_in_words(equilibrium))
    options.give(solve_report(read, equilibrium, actuation, base_tension, loads), out, as_json=as_json)
