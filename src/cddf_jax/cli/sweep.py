"""`cddf sweep`: a solve for every combination of what varies."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError, within
from ..progress import SHOWN, stage
from . import options

EXAMPLE = (
    "Example: cddf sweep data/smooth_sil_940.toml --over base_tension=5N:85N:17 "
    "--over friction_coefficient=0.1:0.6:50 --out out/sweep"
)


def read_sweep_task(context: typer.Context, path: Path | None) -> Path | None:
    """Take the options that a TOML file gives, where the command line does not give them."""
    if path is None:
        return None
    from ..files.manipulator_file import read_toml

    with within(path):
        task = read_toml(path, 'out = "out/sweep"')
    known = [str(option.name) for option in context.command.params if option.name not in ("task", "help")]
    repeated = [str(option.name) for option in context.command.params if getattr(option, "multiple", False)]
    for name, value in task.items():
        if name not in known:
            raise InputError(f"{path}: there is no option {name!r}; there are {', '.join(known)}")
        if name in ("over", "sample") and isinstance(value, dict):
            lists = {key: each if isinstance(each, list) else [each] for key, each in value.items()}
            task[name] = [f"{key}={','.join(map(str, each))}" for key, each in lists.items()]
        elif name in repeated and isinstance(value, str):
            task[name] = [value]
    context.default_map = task
    return path


Task = Annotated[
    Path | None,
    typer.Option(
        help="TOML file of options under their long names, with _ in place of -: over, sample, base_tension, output, "
        "out and all others, and robot. [over] and [sample] may be tables of names and values. The command line "
        "overrides it.",
        callback=read_sweep_task,
        is_eager=True,
    ),
]
Over = Annotated[
    list[str] | None,
    typer.Option(
        help='What varies: first, last and number of values, as in "base_tension=5N:85N:17", or a list of values or '
        'ranges, as in "youngs_modulus=1.2 MPa, 1.4 MPa". Repeated: every combination. '
        "Any number has a name: outer_radius.tip, tendons.0.offset, loads.tip_force.1, base_tension_2, of a target "
        "base_tension.value. "
        "With the length everything along the body varies in proportion."
    ),
]
Together = Annotated[
    list[str] | None,
    typer.Option(
        help='Names of --over that form one axis, such as "friction_coefficient,youngs_modulus": their first values '
        "together, their second values together, and so on, in place of every combination."
    ),
]
Sample = Annotated[
    list[str] | None,
    typer.Option(
        help='What varies at random between two values, such as "youngs_modulus=1.2MPa:1.6MPa". Repeated: all together.'
    ),
]
History = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS",
        help='The axis of base tensions that is a path in time, from rest, such as "base_tension": tendons are pulled '
        "and released in its order, for each combination of the others. Smooth loops: "
        '"base_tension=0N:75N:31,75N:20N:23". An axis made by --together has a name such as '
        '"base_tension_1_and_base_tension_2".',
    ),
]
BaseTension = Annotated[
    list[str] | None,
    typer.Option("--base-tension", "-t", help="As for cddf solve, unless --over base_tension is given."),
]
Output = Annotated[
    list[str],
    typer.Option(help="Names of outputs, with commas or repeated; without --history also tension_loss, curvature, ..."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the Zarr store, figures and results; or the store itself, x.zarr, and the others beside it. "
        "A sweep that was stopped goes on."
    ),
]


def sweep(
    context: typer.Context,
    robot: options.Robot,
    task: Task = None,
    over: Over = None,
    together: Together = None,
    sample: Sample = None,
    samples: Annotated[int, typer.Option(help="Number of samples, for --sample.", min=0)] = 0,
    history: History = None,
    short_steps: options.ShortSteps = 16,
    base_tension: BaseTension = None,
    tip_force: options.TipForce = None,
    tip_moment: options.TipMoment = None,
    gravity: options.Gravity = None,
    point_load: options.PointLoads = None,
    kinematics: options.KinematicsOption = None,
    nodes: options.Nodes = 16,
    output: Output = ["tip_tension,tip_position,tip_angle"],  # noqa: B006  # it is only read
    csv: Annotated[
        Path | None, typer.Option(help="Write a table too, such as sweep.csv, with a row for each solve.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the number of solves, disk and memory; solve and write nothing.")
    ] = False,
    distributed: Annotated[
        bool, typer.Option("--distributed", help="Several processes, as Slurm or MPI started them.")
    ] = False,
    as_json: options.AsJson = False,
    out: Out = None,
) -> None:
    """A solve for every combination of what varies, on all cores, into a store that survives a stop.

    The figure shows outputs over one axis, with a line for each value of the others, or over two. Solves that fail are
    counted and marked.
    """
    with stage("loading"):
        _configure(distributed=distributed)
        from ..reports import sweep_report
        from . import sweep_options

    read = options.read_robot(robot, kinematics)
    if not sweep_report.is_first_process():
        SHOWN.set(None)  # only the first process shows progress

    work = sweep_options.read_sweep(
        read.manipulator,
        over or [],
        together or [],
        sample or [],
        samples,
        base_tension or [],
        loads=options.loads_of(read, tip_force, tip_moment, gravity, point_load),
        history=False if history is None else history,
        short_steps=short_steps,
        outputs=tuple(dict.fromkeys(name.strip() for text in output for name in text.split(","))),
        nodes=nodes,
    )
    if dry_run:
        if sweep_report.is_first_process():
            options.give(sweep_report.rehearse(work), None, as_json=as_json)
        return
    store = sweep_report.checked_store(work, out, csv)
    try:
        found = sweep_report.run_sweep(work, store, context.params)
        if found is None:
            return
        report = sweep_report.sweep_report(work, *found, store.stem, csv)
        options.give(report, store.parent, as_json=as_json)
    except KeyboardInterrupt:
        remedy = "what is in the store stays there, start the same command again and it goes on"
        options.stop(f"interrupted; {remedy}", options.INTERRUPTED)


def _configure(*, distributed: bool) -> None:
    """Set JAX up on all cores, perhaps as one of several processes."""
    from .. import application

    if not distributed:
        application.configure_jax(all_cores=True)
        return
    # what libraries print when processes meet goes to standard error, the answer does not
    sys.stdout.flush()
    ours = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    sys.stdout = os.fdopen(ours, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
    try:
        application.configure_jax(all_cores=True, distributed=True)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"the processes do not find each other ({error}); start them by Slurm or MPI") from None
