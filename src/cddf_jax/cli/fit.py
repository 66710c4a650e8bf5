"""`cddf fit`: friction and modulus from measurements."""

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..progress import stage
from . import options

if TYPE_CHECKING:
    from ..estimation.bootstrap import Bootstrap
    from ..identification.fit import Fit

EXAMPLE = "Example: cddf fit data/smooth_sil_940.toml data/pulley_simulated.csv --out out/fit"
LEAST_TRIALS = 3  # to draw from with replacement


LossName = Literal["linear", "huber", "cauchy"]
PriorOption = Annotated[
    list[str] | None,
    typer.Option(help='A Gaussian prior such as "youngs_modulus=1.4 MPa +- 0.1 MPa".'),
]
Bound = Annotated[
    list[str] | None,
    typer.Option(
        help='Lowest and highest value of a parameter, such as "pretension=0 N:2 N". Either may be left out.',
        show_default="above 0 or none",
    ),
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
        'such as "rest, 75 N"; with several tendons "60 N / 20 N". To fit it: --free before.',
        show_default="rest",
    ),
]


def fit(
    robot: options.Robot,
    data: options.Data,
    column: options.Column = None,
    free: options.Free = None,
    prior: PriorOption = None,
    bound: Bound = None,
    noise: NoiseOption = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    marker: options.Marker = None,
    given: options.Given = None,
    history: options.HistoryOption = None,
    before: BeforeOption = None,
    short_steps: Annotated[
        int,
        typer.Option(help="Short steps for each row of a history, with several tendons or loads.", min=2),
    ] = 4,
    leave_out: options.LeaveOutOption = None,
    loss: Annotated[LossName, typer.Option(help="With a loss other than linear, outliers count less.")] = "linear",
    starts: Annotated[
        int | None,
        typer.Option(help="Number of points from which to search.", min=1, show_default="one, more where it fails"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of further starts and of the bootstrap.", min=0)] = 0,
    per_trial: Annotated[bool, typer.Option("--per-trial", help="Let friction differ from trial to trial.")] = False,
    average_holds: options.AverageHolds = False,
    bootstrap: Annotated[
        int, typer.Option(help="Number of refits to newly drawn data, such as 200; 0 for none.", min=0)
    ] = 0,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    as_json: options.AsJson = False,
    out: options.Out = None,
) -> None:
    """Friction and modulus from measurements, and what the measurements do not determine."""
    from .. import application

    # code that is compiled quickly makes refits slow
    read = options.read_robot(robot, kinematics, lambda: application.configure_jax(quick_compilation=not bootstrap))
    with stage("loading"):
        from ..estimation.whole_search import INTERRUPTED
        from ..identification.fit import fit
        from ..reports.fit_report import fit_in_words, write_report
        from ..reports.fit_results import fit_as_dict, make_report
        from .fit_options import read_before, read_bounds, read_leave_out, read_noise, read_priors, read_setting

    found = fit(
        read.manipulator,
        options.read_data(data, column, holds_averaged=average_holds),
        free or None,
        read_priors(prior),
        bounds=read_bounds(bound),
        noise=read_noise(noise),
        setting=read_setting(options.loads_of(read, tip_force, tip_moment, gravity), marker, given),
        history=history,
        before=read_before(before),
        short_steps=short_steps,
        leave_out=read_leave_out(leave_out),
        per_trial=per_trial,
        loss=loss,
        starts=starts,
        seed=seed,
        nodes=nodes,
    )
    interrupted = found.result == INTERRUPTED
    try:
        bootstraps = _bootstraps(found, bootstrap, seed)
        report = make_report(found, bootstraps=bootstraps, with_profiles=out is not None)
    except KeyboardInterrupt:
        interrupted, report = True, make_report(found, with_profiles=False)
    with options.printed(lambda: fit_in_words(report), fit_as_dict(report), as_json=as_json):
        if out is not None:
            write_report(report, out)
    if not found.success:
        options.stop(f"the fit failed: {found.result}", options.INTERRUPTED if interrupted else options.FAILED)
    if interrupted:
        options.stop("interrupted; the fit is complete, but without profiles and bootstrap", options.INTERRUPTED)


def _bootstraps(found: "Fit", replicates: int, seed: int) -> "list[Bootstrap]":
    """A parametric bootstrap, and one over whole trials where there are enough of them; none of a fit that failed."""
    if not replicates or not found.success:
        return []
    trials = sum(len(table.trial_labels) for table in found.tables)
    kinds = ["parametric", "cases"] if trials >= LEAST_TRIALS else ["parametric"]
    return [found.bootstrap(kind, replicates, seed=seed) for kind in kinds]
