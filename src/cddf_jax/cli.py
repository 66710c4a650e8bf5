"""The command line: `cddf solve | fit | reproduce`. Nothing heavy is imported before a command runs."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from .errors import InputError

if TYPE_CHECKING:
    from .identification import Fit
    from .manipulator import Manipulator
    from .units import Dimension

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


@app.command()
def fit(
    robot: Robot,
    data: Annotated[list[Path], typer.Argument(help="CSV files with the unit in the header.", show_default=False)],
    free: Annotated[list[str] | None, typer.Option(help="What is fitted.", show_default="friction and modulus")] = None,
    prior: Annotated[
        list[str] | None, typer.Option(help='Gaussian, "youngs_modulus=1.4 MPa +- 0.1 MPa".', show_default=False)
    ] = None,
    noise: Annotated[
        list[str] | None, typer.Option(help='Known, "tip_tension=0.5 N"; else estimated.', show_default=False)
    ] = None,
    kinematics: KinematicsOption = None,
    nodes: Nodes = 16,
    as_json: AsJson = False,
    out: Out = None,
) -> None:
    """Friction and modulus from measurements, and what the measurements cannot tell."""
    manipulator = _read(robot, kinematics)
    from .identification import fit
    from .measurements import read_measurements

    tables = [read_measurements(path) for path in data]
    found = fit(
        manipulator,
        tables,
        free or ("friction_coefficient", "youngs_modulus"),
        dict(_prior(text) for text in prior or []),
        noise=dict(_noise(text) for text in noise or []),
        nodes=nodes,
    )
    from .report import as_dict, write_fit

    if out is not None:
        write_fit(found, out)
    _say(as_json, as_dict(found), _fit_text(found))
    if not found.success:
        _stop(f"the fit failed: {found.result}", 1)


_DIMENSION: "dict[str, Dimension]" = {
    "friction_coefficient": "dimensionless",
    "youngs_modulus": "pressure",
    "length": "length",
    "tip_angle": "angle",
    "tip_x": "length",
    "tip_y": "length",
}


def _prior(text: str) -> tuple[str, tuple[float, float]]:
    from .units import quantity

    name, _, numbers = (part.strip() for part in text.partition("="))
    mean, plus_minus, deviation = numbers.replace("±", "+-").partition("+-")
    if not plus_minus or name not in ("friction_coefficient", "youngs_modulus", "length"):
        raise InputError(
            f'--prior {text!r}: write a parameter, mean and deviation as in "youngs_modulus=1.4 MPa +- 0.1 MPa"'
        )
    what = f"--prior {name}"
    return name, (quantity(mean.strip(), _DIMENSION[name], what), quantity(deviation.strip(), _DIMENSION[name], what))


def _noise(text: str) -> tuple[str, float]:
    from .units import quantity

    column, equals, number = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(f'--noise {text!r}: write a column and a standard deviation as in "tip_tension=0.5 N"')
    return column, quantity(number, _DIMENSION.get(column, "force"), f"--noise {column}")


def _fit_text(found: "Fit") -> str:
    from .report import in_words

    lines = list(found.verdict)
    if len(found.tables) > 1:
        lines += ["", "alone, each table would have told:"]
        lines += [f"  {name}: {in_words(told)}" for name, told in found.alone.items()]
    simulated = [table.name for table in found.tables if table.simulated]
    lines += [f"simulated data: {', '.join(simulated)}"] if simulated else []
    lines.append(f"kinematics: {found.manipulator.kinematics}")
    return "\n".join(lines + [f"warning: {warning}" for warning in found.warnings])


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
