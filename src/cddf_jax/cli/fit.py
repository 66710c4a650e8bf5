"""`cddf fit`: friction and modulus from measurements."""

from typing import Annotated

import typer

from ..progress import stage
from . import options

EXAMPLE = "Example: cddf fit data/smooth_sil_940.toml data/pulley_simulated.csv --out out/fit"
PriorOption = Annotated[
    list[str] | None,
    typer.Option(help='A Gaussian prior such as "youngs_modulus=1.4 MPa +- 0.1 MPa".'),
]
NoiseOption = Annotated[
    list[str] | None,
    typer.Option(
        help='Standard deviation of a column, such as "tip_tension=0.5 N", or with a part that grows with the '
        'reading, such as "tip_tension=0.2 N + 1 %".',
        show_default="estimated from the residuals",
    ),
]
BeforeOption = Annotated[
    str | None,
    typer.Option(
        help='With a history, the largest base tension before the first row, such as "75 N", or one for each trial, '
        'such as "rest, 75 N". To fit it: --free before.',
        show_default="rest",
    ),
]


def fit(
    robot: options.Robot,
    data: options.Data,
    column: options.Column = None,
    free: options.Free = None,
    prior: PriorOption = None,
    noise: NoiseOption = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    point_load: options.PointLoads = None,
    marker: options.Marker = None,
    given: options.Given = None,
    history: options.HistoryOption = None,
    each_from_rest: options.EachFromRest = False,
    before: BeforeOption = None,
    short_steps: options.ShortSteps = 4,
    leave_out: options.LeaveOutOption = None,
    per_trial: Annotated[bool, typer.Option("--per-trial", help="Let friction differ from trial to trial.")] = False,
    average_holds: options.AverageHolds = False,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Friction and modulus from measurements, and what the measurements do not determine."""
    read = options.read_robot(robot, kinematics)
    with stage("loading"):
        from ..estimation.whole_search import INTERRUPTED
        from ..identification.fit import fit
        from ..reports.fit_report import fit_report, profiles_of
        from .fit_options import read_before, read_leave_out, read_noise, read_priors, read_setting

    found = fit(
        read.manipulator,
        options.read_data(data, column, holds_averaged=average_holds),
        free or None,
        read_priors(prior),
        noise=read_noise(noise),
        setting=read_setting(options.loads_of(read, tip_force, tip_moment, gravity, point_load), marker, given),
        history="each" if each_from_rest else history,
        before=read_before(before),
        short_steps=short_steps,
        leave_out=read_leave_out(leave_out),
        per_trial=per_trial,
        nodes=nodes,
    )
    interrupted = found.result == INTERRUPTED
    try:
        report = fit_report(found, {} if out is None else profiles_of(found))
    except KeyboardInterrupt:
        interrupted, report = True, fit_report(found, {})
    options.give(report, out, as_json=as_json, code=options.INTERRUPTED if interrupted else options.FAILED)
    if interrupted:
        options.stop("interrupted; the fit is complete, but without profiles", options.INTERRUPTED)
