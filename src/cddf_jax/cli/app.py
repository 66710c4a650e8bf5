"""The command `cddf`: its subcommands, and the exit code and the line on standard error of every failure.

Each subcommand imports what is heavy when it runs, so that `cddf --help` is quick.
"""

import io
import sys

import typer

from ..errors import InputError, SolveError
from ..progress import show_progress
from . import design, explore, fit, plan, reproduce, solve, sweep, trace
from .options import BAD_INPUT, FAILED, INTERRUPTED, stop

app = typer.Typer(
    help="Friction in tendon-driven continuum manipulators: predict it, find it from measurements, design for it.",
    add_completion=False,
    rich_markup_mode="markdown",  # else brackets such as [mm] would vanish from the help
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line; a failure is one line on standard error and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # what its encoding lacks
    try:
        with show_progress():
            code = app(standalone_mode=False)
    except InputError as error:
        stop(str(error), BAD_INPUT)
    except typer.TyperException as error:  # wrong usage
        stop(f"{error.format_message().rstrip('.')}. Try --help.", BAD_INPUT)
    except OSError as error:
        stop(f"{error.filename or 'standard output'}: {error.strerror}; choose another place", BAD_INPUT)
    except SolveError as error:
        stop(str(error), FAILED)
    if code == INTERRUPTED:  # Typer's code for Ctrl-C
        stop("interrupted; nothing was written", INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


app.command(epilog=solve.EXAMPLE)(solve.solve)
app.command(epilog=trace.EXAMPLE)(trace.trace)
app.command(epilog=sweep.EXAMPLE)(sweep.sweep)
app.command(epilog=design.EXAMPLE)(design.design)
app.command(epilog=fit.EXAMPLE)(fit.fit)
app.command(epilog=plan.EXAMPLE)(plan.plan)
app.command(epilog=reproduce.EXAMPLE)(reproduce.reproduce)
app.command(epilog=explore.EXAMPLE)(explore.explore)
