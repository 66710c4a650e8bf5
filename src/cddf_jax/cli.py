"""The command line: `cddf solve | fit | reproduce`. Nothing heavy is imported before a command runs."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from .errors import InputError

if TYPE_CHECKING:
    from .manipulator import Manipulator

app = typer.Typer(
    help="Friction in tendon-driven continuum manipulators: predict it, and read it off measurements.",
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
    typer.Option(help="+1 slides in (pulled), -1 slides out; once, or once per tendon.", show_default="+1"),
]
TipForce = Annotated[str | None, typer.Option(help='Dead load (X, Y) on the tip, "0 N, -5 N".', show_default=False)]
TipMoment = Annotated[str | None, typer.Option(help='On the tip, positive from X to Y, "0.1 N m".', show_default=False)]
Gravity = Annotated[
    str | None, typer.Option(help='Acceleration (X, Y), "0, -9.81 m/s^2"; needs a density.', show_default=False)
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
    manipulator = _read(robot, kinematics)
    from . import solve_command
    from .equilibrium import RESULTS

    actuation = solve_command.read_actuation(base_tension, manipulator)
    loads = solve_command.read_loads(tip_force, tip_moment, gravity, manipulator)
    for value in direction or []:
        if value not in (+1, -1):
            raise InputError(f"--direction {value}: give +1 for a tendon that slides in, -1 for one that slides out")
    directions = solve_command.per_tendon("--direction", list(direction or [1]), manipulator.num_tendons)
    equilibrium = solve_command.solve_or_explain(
        manipulator, actuation, loads, base_tension, direction=directions, nodes=nodes
    )
    answer = solve_command.as_dict(equilibrium, actuation, loads)
    if out is not None:
        from .artifacts import as_json as json_text
        from .artifacts import write_all
        from .plotting import render
        from .solve_figure import equilibrium_figure

        figure = equilibrium_figure(manipulator, equilibrium, loads)
        write_all(out, render(figure, "solve") | {"solve.json": json_text(answer)})
    _say(as_json, answer, solve_command.in_words(equilibrium, actuation, base_tension, loads))
    if equilibrium.result == RESULTS.unstable:
        _stop(RESULTS[equilibrium.result], 1)


# --- fit -----------------------------------------------------------------------------------------


class Loss(StrEnum):
    """How residuals count."""

    linear = "linear"
    soft_l1 = "soft_l1"
    huber = "huber"
    cauchy = "cauchy"


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
    data: Annotated[list[Path], typer.Argument(help="CSV files with the unit in the header.", show_default=False)],
    free: Annotated[list[str] | None, typer.Option(help="What is fitted.", show_default="friction and modulus")] = None,
    prior: Prior = None,
    bound: Bound = None,
    noise: Noise = None,
    loss: Annotated[Loss, typer.Option(help="Other than linear: outliers count less.")] = Loss.linear,
    starts: Annotated[int, typer.Option(help="From how many points to search.", min=1)] = 1,
    seed: Annotated[int, typer.Option(help="Of further starts and of the bootstrap.", min=0)] = 0,
    per_trial: Annotated[bool, typer.Option("--per-trial", help="Let friction differ from trial to trial.")] = False,
    bootstrap: Annotated[int, typer.Option(help="Refits to data drawn anew; 0 for none.", min=0)] = 0,
    kinematics: KinematicsOption = None,
    nodes: Nodes = 16,
    as_json: AsJson = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the report with profiles and figures.", show_default=False)
    ] = None,
) -> None:
    """Friction and modulus from measurements, and what the measurements cannot tell."""
    manipulator = _read(robot, kinematics)
    from . import fit_command as command
    from .fit_results import as_dict, make_report
    from .identification import fit
    from .measurements import read_measurements
    from .report import write_report

    known = command.read_all(noise, command.read_noise, "--noise")
    found = fit(
        manipulator,
        [read_measurements(path) for path in data],
        free or ("friction_coefficient", "youngs_modulus"),
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


# --- reproduce -----------------------------------------------------------------------------------


@app.command()
def reproduce(
    robot: Robot,
    load_cells: Annotated[Path, typer.Argument(help="CSV of the load-cell trials.", show_default=False)],
    as_json: AsJson = False,
    out: Annotated[Path, typer.Option(help="Folder for figures and table.")] = Path("out/reproduce"),
) -> None:
    """The figures of Liu et al. (2020), and a table of its numbers beside ours."""
    manipulator = _read(robot, None)
    from .measurements import read_measurements
    from .reproduction import reproduce

    answer = reproduce(manipulator, read_measurements(load_cells), out)
    _say(as_json, answer, (out / "reproduction.md").read_text(encoding="utf-8"))


# --- plan ----------------------------------------------------------------------------------------


@app.command()
def plan(
    robot: Robot,
    data: Annotated[
        list[Path] | None, typer.Argument(help="CSV files of what was measured already.", show_default=False)
    ] = None,
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
    from .measurements import read_measurements
    from .next_measurement import plan, standard_candidates
    from .units import quantity

    names = tuple(free or ("friction_coefficient", "youngs_modulus"))
    largest = quantity(tension, "force", "--tension")
    if not largest > 0:
        raise InputError(f"--tension {tension}: give a tension above 0 N")
    choices = (
        standard_candidates(manipulator, largest) if candidates is None else plan_command.read_candidates(candidates)
    )
    known = fit_tables(manipulator, [read_measurements(path) for path in data], names) if data else manipulator
    answer = plan(known, choices, names, criterion=criterion, num=num)
    if out is not None:
        from .artifacts import as_json as json_text
        from .artifacts import write_all
        from .plan_figure import plan_figure
        from .plotting import render

        files = {"plan.md": plan_command.as_markdown(answer), "plan.json": json_text(plan_command.as_dict(answer))}
        write_all(out, files | render(plan_figure(answer), "plan"))
    _say(as_json, plan_command.as_dict(answer), plan_command.as_markdown(answer))


# --- common --------------------------------------------------------------------------------------


def _read(robot: Path, kinematics: Kinematics | None) -> "Manipulator":
    """Set JAX up and read the manipulator."""
    from dataclasses import replace

    from .application import configure_jax

    configure_jax()
    from .manipulator_file import read_manipulator

    manipulator = read_manipulator(robot)
    return manipulator if kinematics is None else replace(manipulator, kinematics=kinematics.value)


def _say(as_json: bool, answer: dict[str, Any], text: str) -> None:
    if as_json:
        from .artifacts import as_json as json_text

        text = json_text(answer).rstrip()
    typer.echo(text)
