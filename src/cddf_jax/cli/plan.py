"""`cddf plan`: which measurement to take next."""

from typing import Annotated

import typer

from ..errors import InputError
from ..progress import stage
from . import options

EXAMPLE = "Example: cddf plan data/smooth_sil_940.toml data/load_cells_simulated.csv --num 1"


def plan(
    robot: options.Robot,
    data: options.Data = None,
    column: options.Column = None,
    average_holds: options.AverageHolds = False,
    tension: Annotated[str, typer.Option(help="Largest base tension of the candidates, with its unit.")] = "85 N",
    free: options.Free = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    point_load: options.PointLoads = None,
    marker: options.Marker = None,
    given: options.Given = None,
    history: options.HistoryOption = None,
    each_from_rest: options.EachFromRest = False,
    criterion: Annotated[
        str,
        typer.Option(help="D for all parameters together, or the parameter to determine best, such as youngs_modulus."),
    ] = "D",
    num: Annotated[int, typer.Option(help="How many measurements to choose, one after the other.", min=1)] = 3,
    leave_out: options.LeaveOutOption = None,
    kinematics: options.KinematicsOption = None,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Which measurement to take next: what each candidate would add to what is known.

    Candidates are the usual measurements, such as a pulley test, tip tensions and tip angles. They are driven by
    displacement, up to the largest of the data, if the data are. For candidates of your own use cddf_jax.plan in
    Python.
    """
    read = options.read_robot(robot, kinematics)
    manipulator = read.manipulator
    with stage("loading"):
        from ..identification.experiment_design import plan, standard_candidates
        from ..identification.fit import fit
        from ..reports.plan_report import plan_report
        from ..units import quantity
        from .fit_options import read_leave_out, read_setting

    names = tuple(free) if free else None
    largest = quantity(tension, "force", "--tension")
    if not largest > 0:
        raise InputError(f"--tension {tension}: give a tension above 0 N")
    setting = read_setting(options.loads_of(read, tip_force, tip_moment, gravity, point_load), marker, given)
    tables = options.read_data(data, column, holds_averaged=average_holds)
    known = manipulator
    if tables:
        rows, followed = read_leave_out(leave_out), "each" if each_from_rest else history
        known = fit(manipulator, tables, names, setting=setting, history=followed, leave_out=rows)
    driven = [table[own.column][own.rows] for table in tables for own in table.set_columns if own.by_length]
    furthest = max((float(max(values)) for values in driven), default=0.0)
    candidates = standard_candidates(manipulator, largest, setting, furthest if furthest > 0 else None)
    found = plan(known, candidates, names, setting=setting, criterion=criterion, num=num)
    options.give(plan_report(found), out, as_json=as_json)
