"""The command line: `cddf solve`, `sweep`, `fit`, `design` and others; each imports what is heavy when it runs."""

import sys
from collections.abc import Callable, Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from .errors import InputError

if TYPE_CHECKING:
    from .manipulator import Manipulator
    from .measurements import Measurements

app = typer.Typer(
    help="Friction in tendon-driven continuum manipulators: predict it, read it off measurements, design for it.",
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Kinematics(StrEnum):
    """As in the manipulator's file."""

    published = "published"
    exact = "exact"


Robot = Annotated[Path, typer.Argument(help="TOML file of the manipulator.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object, SI units, and nothing else.")]
Out = Annotated[Path | None, typer.Option(help="Folder for figures and results.", show_default=False)]
KinematicsOption = Annotated[Kinematics | None, typer.Option(help="Instead of the file's.", show_default=False)]
Nodes = Annotated[int, typer.Option(help="Gauss nodes in each smooth piece of the body, 4 or more.", min=4)]


def main() -> None:
    """Run the command line: 2 for bad input, 1 for a solve or fit that failed, one line on standard error each."""
    try:
        code = app(standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except InputError as error:
        _stop(str(error), 2)
    except KeyboardInterrupt:
        _stop("interrupted; nothing was written", 130)
    except OSError as error:
        _stop(f"{error.filename or 'file'}: {error.strerror}; choose another place", 2)
    except Exception as error:
        usage = getattr(error, "format_message", None)  # wrong usage, as Typer found it
        if usage is not None:
            _stop(f"{usage().rstrip('.')}. Try --help.", 2)
        if type(error).__name__ == "SolveError":  # its module imports JAX
            _stop(str(error), 1)
        raise


def _stop(message: str, code: int) -> NoReturn:
    typer.echo("error: " + " ".join(message.split()), err=True)
    sys.exit(code)


# --- solve ---------------------------------------------------------------------------------------


Pull = Annotated[
    list[str],
    typer.Option(
        "--base-tension",
        "-t",
        help='"75 N", once for all tendons or once per tendon; in its place may stand what is to be reached: '
        '"tip_angle=45 deg", "displacement=12 mm", "tip_tension=40 N", "curvature=8 1/m at 70 mm", '
        '"total_tension=100 N", "tip_stiffness=350 N/m".',
    ),
]
Direction = Annotated[
    list[int] | None,
    typer.Option(
        help="+1 slides in (pulled), -1 slides out; once, or once per tendon.",
        show_default="found from the travel; +1 for a single tendon",
    ),
]
TipForce = Annotated[str | None, typer.Option(help='Dead load (X, Y) on the tip, "0 N, -5 N".', show_default=False)]
TipMoment = Annotated[str | None, typer.Option(help='On the tip, positive from X to Y, "0.1 N m".', show_default=False)]
Gravity = Annotated[
    str | None,
    typer.Option(help='Acceleration (X, Y), "0, -9.81 m/s^2"; needs a body with a mass.', show_default=False),
]


@app.command()
def solve(
    robot: Robot,
    base_tension: Pull,
    direction: Direction = None,
    tip_force: TipForce = None,
    tip_moment: TipMoment = None,
    gravity: Gravity = None,
    kinematics: KinematicsOption = None,
    nodes: Nodes = 16,
    as_json: AsJson = False,
    out: Out = None,
) -> None:
    """Shape, tension and friction of a manipulator under tension and dead loads.

    X runs along the straight body from its base, Y to the side of a tendon with side = 1.
    """
    manipulator = _read(robot, kinematics, note_columns=False)
    from . import solve_command
    from .cross_sections import in_one_line
    from .equilibrium import RESULTS
    from .manipulator_file import columns_of

    actuation = solve_command.read_actuation(base_tension, manipulator)
    loads = solve_command.read_loads(tip_force, tip_moment, gravity, manipulator.has_mass)
    directions = _directions(direction, manipulator)
    equilibrium = solve_command.solve_or_explain(
        manipulator, actuation, loads, base_tension, direction=directions, nodes=nodes
    )
    answer = solve_command.as_dict(equilibrium, actuation, loads)
    text = solve_command.in_words(equilibrium, actuation, base_tension, loads)
    if columns := columns_of(robot):
        answer["cross_sections"] = {column.name: column.words for column in columns}
        text += f"\n{in_one_line(columns)}"
    if out is not None:
        from .artifacts import as_json as json_text
        from .artifacts import write_all
        from .interchange import fields_csv, fields_on_grid
        from .plotting import render
        from .sections_figure import sections_figure
        from .solve_figure import equilibrium_figure

        figures = render(equilibrium_figure(manipulator, equilibrium, loads), "solve")
        if columns:
            figures |= render(sections_figure(columns), "cross_sections")
        tables = {"solve.json": json_text(answer), "fields.csv": fields_csv(fields_on_grid(equilibrium))}
        write_all(out, figures | tables)
    _say(as_json, answer, text)
    if equilibrium.result == RESULTS.unstable:
        _stop(RESULTS[equilibrium.result], 1)


# --- sweep ---------------------------------------------------------------------------------------


class Sampler(StrEnum):
    """How samples are spread."""

    latin_hypercube = "latin_hypercube"
    sobol = "sobol"


class Precision(StrEnum):
    """Of all numbers of a sweep."""

    float32 = "float32"
    float64 = "float64"


Over = Annotated[
    list[str] | None,
    typer.Option(
        help='What varies: first, last and how many, "base_tension=5N:85N:17", or a list, "kinematics=published,exact" '
        'or "youngs_modulus=1.2 MPa, 1.4 MPa". Repeated: every combination. Any number has a name: outer_radius.tip, '
        "tendons.0.offset, loads.tip_force.1, base_tension_2, of a target base_tension.value. "
        "With the length everything along the body varies in proportion.",
        show_default=False,
    ),
]
Together = Annotated[
    list[str] | None,
    typer.Option(
        help='Names of --over that are one axis, "friction_coefficient,youngs_modulus": their first values together, '
        "their second ones, and so on, in place of every combination.",
        show_default=False,
    ),
]
Sample = Annotated[
    list[str] | None,
    typer.Option(
        help='What varies at random between two values, "youngs_modulus=1.2MPa:1.6MPa". Repeated: all together.',
        show_default=False,
    ),
]
SweptPull = Annotated[
    list[str] | None,
    typer.Option(
        "--base-tension", "-t", help="As for cddf solve, unless --over base_tension is given.", show_default=False
    ),
]
Output = Annotated[
    str, typer.Option(help="Names of outputs; also base_tension, tension_loss, tendon_displacement, curvature, ...")
]
Sensitivity = Annotated[
    list[str] | None,
    typer.Option(help="Derivatives of the outputs by this number, into the store and the files.", show_default=False),
]
SweepOut = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the Zarr store, figures and results; or the store itself, x.zarr, and the others beside it. "
        "A sweep that was stopped goes on.",
        show_default=False,
    ),
]


@app.command()
def sweep(
    context: typer.Context,
    robot: Robot,
    over: Over = None,
    together: Together = None,
    sample: Sample = None,
    samples: Annotated[int | None, typer.Option(help="How many, for --sample.", min=1, show_default=False)] = None,
    sampler: Annotated[Sampler, typer.Option(help="How they are spread.")] = Sampler.latin_hypercube,
    seed: Annotated[int, typer.Option(help="Of the samples.", min=0)] = 0,
    base_tension: SweptPull = None,
    direction: Direction = None,
    tip_force: TipForce = None,
    tip_moment: TipMoment = None,
    gravity: Gravity = None,
    kinematics: KinematicsOption = None,
    nodes: Nodes = 16,
    output: Output = "tip_tension,tip_position,tip_angle",
    sensitivity: Sensitivity = None,
    precision: Annotated[Precision, typer.Option(help="Of the numbers.")] = Precision.float64,
    memory: Annotated[str | None, typer.Option(help='"2 GB".', show_default="a quarter of what is free")] = None,
    chunk: Annotated[int | None, typer.Option(help="Solves between two writes.", min=1, show_default="fits")] = None,
    netcdf: Annotated[Path | None, typer.Option(help="Also a NetCDF file.", show_default=False)] = None,
    csv: Annotated[Path | None, typer.Option(help="Also a table, a row for each solve.", show_default=False)] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what it would take; write nothing.")] = False,
    coordinator: Annotated[
        str | None, typer.Option(help="HOST:PORT of process 0, where several share the work.", show_default=False)
    ] = None,
    num_processes: Annotated[int | None, typer.Option(help="How many.", min=1, show_default=False)] = None,
    process_id: Annotated[int | None, typer.Option(help="Which this is, from 0.", min=0, show_default=False)] = None,
    distributed: Annotated[bool, typer.Option("--distributed", help="Several, as Slurm or MPI started them.")] = False,
    as_json: AsJson = False,
    out: SweepOut = None,
) -> None:
    """A solve for every combination of what varies, on all cores, into a store that survives a stop.

    Figures show up to three axes, or outputs over samples, and no derivatives. Solves that fail are counted and marked.
    """
    if kinematics is not None and any(text.partition("=")[0].strip() == "kinematics" for text in over or []):
        raise InputError("kinematics is given by --kinematics and varies too; leave one out")
    processes = (coordinator, num_processes, process_id, distributed)
    manipulator = _read(robot, kinematics, lambda: _configure_for_batches(*processes))
    from . import solve_command, sweep_options, sweep_words
    from . import sweep_command as command

    varied = {text.partition("=")[0].strip() for text in (*(over or []), *(sample or []))}
    has_weight = manipulator.has_mass or "density" in varied
    work = sweep_options.read_sweep(
        manipulator,
        over or [],
        together or [],
        sweep_options.Samples(sample or [], samples, sampler.value, seed),
        base_tension=sweep_options.read_base_tension(base_tension or [], manipulator),
        loads=solve_command.read_loads(tip_force, tip_moment, gravity, has_weight),
        direction=_directions(direction, manipulator),
        outputs=sweep_options.read_outputs(output),
        sensitivities=tuple(sensitivity or ()),
        nodes=nodes,
        precision=precision.value,
        memory=None if memory is None else sweep_options.read_memory(memory),
        chunk_size=chunk,
    )
    if dry_run:
        told = command.rehearse(work, None if out is None else command.read_places(out, netcdf, csv))
        if told is not None:
            _say(as_json, told, sweep_words.rehearsal_in_words(told))
        return
    places = command.read_places(out, netcdf, csv)
    try:
        told = command.carry_out(work, places, context.params, progress=sys.stderr.isatty())
    except KeyboardInterrupt:
        _stop("interrupted; what is in the store stays there, start the same command again and it goes on", 130)
    if told is not None:
        _say(as_json, told, sweep_words.in_words(told))
        if "successful" not in told["results"]:
            _stop("no solve was successful; see the results", 1)


def _configure_for_batches(*processes: Any) -> None:
    """Set JAX up, alone or as one of several processes."""
    from . import application
    from .sweep_options import read_processes

    given = read_processes(*processes)
    if given is not None:
        _keep_standard_output()
    try:
        application.configure_jax_for_batches(given)
    except (ValueError, RuntimeError) as error:
        if given is None:
            raise
        remedy = "check --coordinator" if given else "give --coordinator, --num-processes and --process-id"
        raise InputError(f"the processes do not find each other ({error}); {remedy}") from None


def _keep_standard_output() -> None:
    """For our own words: what libraries print there when processes meet goes to standard error."""
    import os

    sys.stdout.flush()
    ours = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    sys.stdout = os.fdopen(ours, "w", encoding=sys.stdout.encoding)


# --- fit -----------------------------------------------------------------------------------------


class Loss(StrEnum):
    """How residuals count."""

    linear = "linear"
    soft_l1 = "soft_l1"
    huber = "huber"
    cauchy = "cauchy"


Column = Annotated[
    list[str] | None,
    typer.Option(
        help='What a column of the data is, "Tbase_N=base_tension [N]"; "NAME=" to leave it out.', show_default=False
    ),
]
AverageHolds = Annotated[
    bool,
    typer.Option("--average-holds", help="One reading for each hold: consecutive rows of a trial at one level."),
]
Prior = Annotated[
    list[str] | None,
    typer.Option(
        help='Gaussian, "youngs_modulus=1.4 MPa +- 0.1 MPa", or uniform, "friction_coefficient=0.1..0.6".',
        show_default=False,
    ),
]
Bound = Annotated[
    list[str] | None, typer.Option(help='Of a parameter, "pretension=0 N:2 N".', show_default="above 0 or none")
]
Noise = Annotated[
    list[str] | None,
    typer.Option(help='Known, "tip_tension=0.5 N" or "tip_tension=0.2 N + 1 %"; else estimated.', show_default=False),
]


@app.command()
def fit(
    robot: Robot,
    data: Annotated[
        list[Path],
        typer.Argument(
            help="CSV or .xlsx files with the unit in the header; files of the same columns are trials.",
            show_default=False,
        ),
    ],
    column: Column = None,
    free: Annotated[list[str] | None, typer.Option(help="What is fitted.", show_default="friction and modulus")] = None,
    prior: Prior = None,
    bound: Bound = None,
    noise: Noise = None,
    loss: Annotated[Loss, typer.Option(help="Other than linear: outliers count less.")] = Loss.linear,
    starts: Annotated[
        int | None,
        typer.Option(help="From how many points to search.", min=1, show_default="one, more where it fails"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of further starts and of the bootstrap.", min=0)] = 0,
    per_trial: Annotated[bool, typer.Option("--per-trial", help="Let friction differ from trial to trial.")] = False,
    average_holds: AverageHolds = False,
    bootstrap: Annotated[int, typer.Option(help="Refits to data drawn anew; 0 for none.", min=0)] = 0,
    kinematics: KinematicsOption = None,
    nodes: Nodes = 16,
    as_json: AsJson = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the report with profiles and figures.", show_default=False)
    ] = None,
) -> None:
    """Friction and modulus from measurements, and what the measurements cannot tell."""
    from . import application

    # code that is compiled quickly makes refits slow
    manipulator = _read(robot, kinematics, lambda: application.configure_jax(quick_compilation=not bootstrap))
    from . import fit_command as command
    from .fit_results import as_dict, make_report
    from .identification import fit
    from .report import write_report

    known = command.read_all(noise, command.read_noise, "--noise")
    found = fit(
        manipulator,
        _tables(data, column, average_holds),
        free or None,
        command.read_all(prior, command.read_prior, "--prior"),
        bounds=command.read_all(bound, command.read_bound, "--bound"),
        noise=known,
        per_trial=per_trial,
        loss=loss.value,
        starts=starts,
        seed=seed,
        nodes=nodes,
    )
    bootstraps = command.draw_bootstraps(found, bootstrap, seed, as_json)
    options = {"noise": known}
    report = make_report(found, options=options, bootstraps=bootstraps, with_profiles=out is not None)
    if out is not None:
        write_report(report, out)
    _say(as_json, as_dict(report), command.report_in_words(report))
    if not found.success:
        _stop(f"the fit failed: {found.result}", 1)


# --- design --------------------------------------------------------------------------------------


@app.command()
def design(
    task: Annotated[
        Path, typer.Argument(help="TOML file: robot, free numbers, load cases, objectives, limits.", show_default=False)
    ],
    pareto: Annotated[
        int | None, typer.Option(help="Two objectives against each other: so many designs.", min=3, show_default=False)
    ] = None,
    as_json: AsJson = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the new manipulator, its profile for CAD, figures and report.", show_default=False
        ),
    ] = None,
) -> None:
    """The body that does best what is wanted, within what can be made.

    The task file is explained in the README; fitting/ has three.
    """
    from . import application

    application.configure_jax()
    from .design_file import read_task

    read = read_task(task)
    _note(read.read_as)
    watched = sys.stderr.isatty()
    if pareto is not None:
        from .design_command import trade_off

        answer, text, success = trade_off(read, pareto, out, watched)
    else:
        from .design_command import carry_out

        answer, text, success = carry_out(read, out, watched)
    _say(as_json, answer, text)
    if not success:
        _stop(f"the design is not done: {answer['result']}", 1)


# --- reproduce -----------------------------------------------------------------------------------


@app.command()
def reproduce(
    robot: Robot,
    load_cells: Annotated[Path, typer.Argument(help="CSV of the load-cell trials.", show_default=False)],
    column: Column = None,
    as_json: AsJson = False,
    out: Annotated[Path, typer.Option(help="Folder for figures and table.")] = Path("out/reproduce"),
) -> None:
    """The figures of Liu et al. (2020), and a table of its numbers beside ours."""
    manipulator = _read(robot, None)
    from .reproduction import reproduce

    answer = reproduce(manipulator, _tables([load_cells], column)[0], out)
    _say(as_json, answer, (out / "reproduction.md").read_text(encoding="utf-8"))


# --- plan ----------------------------------------------------------------------------------------


@app.command()
def plan(
    robot: Robot,
    data: Annotated[
        list[Path] | None, typer.Argument(help="CSV or .xlsx files of what was measured already.", show_default=False)
    ] = None,
    column: Column = None,
    average_holds: AverageHolds = False,
    candidates: Annotated[
        Path | None, typer.Option(help="TOML file of what could be measured; else the usual.", show_default=False)
    ] = None,
    tension: Annotated[str, typer.Option(help="The largest base tension of the usual candidates.")] = "85 N",
    free: Annotated[
        list[str] | None, typer.Option(help="What is to be told.", show_default="friction and modulus")
    ] = None,
    criterion: Annotated[
        str, typer.Option(help="D for all together, or the parameter that is to be known best.")
    ] = "D",
    num: Annotated[int, typer.Option(help="How many measurements to choose in turn.", min=1)] = 3,
    kinematics: KinematicsOption = None,
    as_json: AsJson = False,
    out: Out = None,
) -> None:
    """Which measurement next: what candidates would add to what is known."""
    manipulator = _read(robot, kinematics)
    from . import plan_command
    from .identification import fit as fit_tables
    from .next_measurement import plan, standard_candidates
    from .units import quantity

    names = tuple(free) if free else None
    largest = quantity(tension, "force", "--tension")
    if not largest > 0:
        raise InputError(f"--tension {tension}: give a tension above 0 N")
    choices = (
        standard_candidates(manipulator, largest) if candidates is None else plan_command.read_candidates(candidates)
    )
    known = fit_tables(manipulator, _tables(data, column, average_holds), names) if data else manipulator
    answer = plan(known, choices, names, criterion=criterion, num=num)
    if out is not None:
        from .artifacts import as_json as json_text
        from .artifacts import write_all
        from .plan_figure import plan_figure
        from .plotting import render

        files = {"plan.md": plan_command.as_markdown(answer), "plan.json": json_text(plan_command.as_dict(answer))}
        write_all(out, files | render(plan_figure(answer), "plan"))
    _say(as_json, plan_command.as_dict(answer), plan_command.as_markdown(answer))


# --- explore -------------------------------------------------------------------------------------


@app.command()
def explore(
    robot: Annotated[
        Path | None, typer.Argument(help="TOML file of the manipulator; else the paper's.", show_default=False)
    ] = None,
    data: Annotated[
        list[Path] | None, typer.Argument(help="CSV or .xlsx files with the unit in the header.", show_default=False)
    ] = None,
    column: Column = None,
    kinematics: KinematicsOption = None,
    port: Annotated[int, typer.Option(help="On this machine.", min=0, max=65535, show_default="a free one")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address, open nothing.")] = False,
) -> None:
    """A page in the browser: sliders for body and load, the data beside the model, a fit, what another taper would do.

    It is served on this machine alone and needs no network. Ctrl-C ends it.
    """
    manipulator = None if robot is None else _read(robot, kinematics)
    from dataclasses import replace

    from . import application
    from .manipulator_file import columns_of

    application.configure_jax()
    try:
        from . import explorer
    except ModuleNotFoundError as error:
        if error.name not in ("panel", "bokeh"):
            raise
        raise InputError("explore needs the package panel; install it with pip install 'cddf-jax[explore]'") from None

    if manipulator is None:
        manipulator, source = explorer.papers_manipulator(), explorer.PAPER
        manipulator = manipulator if kinematics is None else replace(manipulator, kinematics=kinematics.value)
    else:
        source = str(robot)
    tables = _tables(data or [], column)
    options = {"port": port, "browser": not no_browser, "say": typer.echo}
    explorer.serve(manipulator, tables, source, () if robot is None else columns_of(robot), **options)


# --- common --------------------------------------------------------------------------------------


def _read(
    robot: Path,
    kinematics: Kinematics | None,
    configure: Callable[[], None] | None = None,
    note_columns: bool = True,
) -> "Manipulator":
    """Set JAX up, by `configure_jax` where nothing else is given, and read the manipulator.

    How a table of cross-sections was read is noted on standard error, unless the command says so itself.
    """
    from dataclasses import replace

    from . import application

    (configure or application.configure_jax)()
    from .cross_sections import in_one_line
    from .manipulator_file import columns_of, read_manipulator

    manipulator = read_manipulator(robot)
    if note_columns and (columns := columns_of(robot)):
        typer.echo(f"note: {in_one_line(columns)}", err=True)
    return manipulator if kinematics is None else replace(manipulator, kinematics=kinematics.value)


def _tables(
    paths: list[Path], column: list[str] | None, one_reading_a_hold: bool = False
) -> "tuple[Measurements, ...]":
    """The measurements in files; what was done to read them is said on standard error."""
    from .fit_command import read_all, read_column
    from .holds import average_holds
    from .trial_files import read_tables

    tables = read_tables(paths, read_all(column, read_column, "--column"))
    _note(line for table in tables for line in table.read_as)
    return tuple(map(average_holds, tables)) if one_reading_a_hold else tables


def _note(lines: Iterable[str]) -> None:
    for line in lines:
        typer.echo(f"note: {line}", err=True)


def _directions(direction: list[int] | None, manipulator: "Manipulator") -> list[int] | None:
    from .solve_command import per_tendon

    for value in direction or []:
        if value not in (+1, -1):
            raise InputError(f"--direction {value}: give +1 for a tendon that slides in, -1 for one that slides out")
    return per_tendon("--direction", list(direction), manipulator.num_tendons) if direction else None


def _say(as_json: bool, answer: dict[str, Any], text: str) -> None:
    if as_json:
        from .artifacts import as_json as json_text

        text = json_text(answer).rstrip()
    typer.echo(text)
