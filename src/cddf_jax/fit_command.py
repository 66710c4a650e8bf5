"""What `cddf fit` reads from its options, and what it says."""

import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

from .bench import parameter_named
from .bootstrap import Bootstrap
from .errors import InputError
from .fit_figures import moving_names
from .fit_results import Report
from .identification import Fit
from .measured_columns import dimension_of
from .observations import Noise
from .parameter_space import Prior, Uniform
from .report import in_words
from .units import quantity
from .verdict import SHOWN

LEAST_TRIALS = 3  # to draw from with replacement


def read_all(texts: Sequence[str] | None, read: Callable[[str], tuple[str, Any]], option: str) -> dict[str, Any]:
    """One entry for each text.

    Raises:
        InputError: for a name that is given twice.
    """
    found: dict[str, Any] = {}
    for text in texts or ():
        name, value = read(text)
        if name in found:
            raise InputError(f"{option} {name} is given twice; leave one out")
        found[name] = value
    return found


def read_prior(text: str) -> tuple[str, Prior | Uniform]:
    """ "youngs_modulus=1.4 MPa +- 0.1 MPa" is a Gaussian, "friction_coefficient=0.1..0.6" uniform."""
    name, _, numbers = (part.strip() for part in text.partition("="))
    numbers = numbers.replace("±", "+-").removeprefix("uniform")
    kind, mark = (Uniform, "..") if ".." in numbers else (Prior, "+-")
    first, found, second = numbers.partition(mark)
    if not found:
        raise InputError(
            f'--prior {text!r}: write a parameter, mean and deviation as in "youngs_modulus=1.4 MPa +- 0.1 MPa", '
            'or a range as in "friction_coefficient=0.1..0.6"'
        )
    return name, kind(*(_of_parameter(name, part, "--prior") for part in (first, second)))


def read_column(text: str) -> tuple[str, str]:
    """ "Tbase_N=base_tension [N]": the head of a column in a file, and what it is; nothing to leave it out."""
    name, equals, meant = text.rpartition("=")
    if not equals or not name.strip():
        raise InputError(
            f'--column {text!r}: write the head of a column and what it is, as in "Tbase_N=base_tension [N]"'
        )
    return name.strip(), meant.strip()


def read_bound(text: str) -> tuple[str, tuple[float | None, float | None]]:
    """ "pretension=0 N:2 N"; either side may be left empty."""
    name, _, numbers = (part.strip() for part in text.partition("="))
    low, colon, high = (part.strip() for part in numbers.partition(":"))
    if not colon or not (low or high):
        raise InputError(f'--bound {text!r}: write a parameter and its limits as in "pretension=0 N:2 N"')
    lower, upper = (_of_parameter(name, end, "--bound") if end else None for end in (low, high))
    return name, (lower, upper)


def _of_parameter(name: str, text: str, option: str) -> float:
    return quantity(text.strip(), parameter_named(name).dimension, f"{option} {name}")


def read_noise(text: str) -> tuple[str, float | Noise]:
    """ "tip_tension=0.5 N", or with a part that grows with the reading "tip_tension=0.2 N + 1 %"."""
    column, equals, numbers = (part.strip() for part in text.partition("="))
    if not equals:
        raise InputError(
            f'--noise {text!r}: write a column and a standard deviation as in "tip_tension=0.5 N" or '
            '"tip_tension=0.2 N + 1 %"'
        )
    return column, noise_of(column, numbers, f"--noise {column}")


def noise_of(column: str, numbers: str, what: str) -> float | Noise:
    """ "0.5 N", or with a part that grows with the reading "0.2 N + 1 %"."""
    dimension = dimension_of(column) or "dimensionless"
    floor, *shares = re.split(r"\s\+\s*", numbers, maxsplit=1)
    if not shares and not floor.endswith("%"):
        return quantity(floor, dimension, what)
    floor, share = (floor, shares[0]) if shares else ("", floor)
    if not share.endswith("%"):
        raise InputError(f'{what}: the part that grows with the reading is in %, got {share!r}; write "0.2 N + 1 %"')
    fraction = quantity(share[:-1].strip(), "dimensionless", what) / 100
    return Noise(quantity(floor, dimension, what) if floor else 0.0, fraction)


def draw_bootstraps(fit: Fit, replicates: int, seed: int, quiet: bool) -> list[Bootstrap]:
    """Parametric, and of whole trials where there are enough of them; with a bar on a terminal."""
    if not replicates or not fit.success:
        return []
    progress = sys.stderr.isatty() and not quiet
    if progress:
        import rich

        rich.reconfigure(stderr=True)  # results go to standard output
    trials = sum(len(table.trial_labels) for table in fit.tables)
    kinds = ["parametric", "cases"] if trials >= LEAST_TRIALS else ["parametric"]
    return [fit.bootstrap(kind, replicates, seed=seed, progress=progress) for kind in kinds]


def report_in_words(report: Report) -> str:
    """What the terminal shows."""
    fit = report.fit
    lines = list(fit.verdict)
    for bootstrap in report.bootstraps:
        lines += ["", f"bootstrap, {bootstrap.kind}, {len(bootstrap.estimates)} refits:"]
        lines += [f"  {_interval(name, bootstrap)}" for name in moving_names(fit)]
        lines += [f"  too narrow: {bootstrap.remark}"] if bootstrap.remark else []
    if len(fit.tables) > 1:
        lines += ["", "alone, each table would have told:"]
        lines += [f"  {name}: {in_words(told)}" for name, told in fit.alone.items()]
    simulated = [table.name for table in fit.tables if table.simulated]
    lines += [f"simulated data: {', '.join(simulated)}"] if simulated else []
    lines.append(f"kinematics: {fit.manipulator.kinematics}")
    return "\n".join(lines + [f"warning: {warning}" for warning in fit.warnings])


def _interval(name: str, bootstrap: Bootstrap) -> str:
    scale, unit = SHOWN[parameter_named(name).dimension]
    low, high = (scale * end for end in bootstrap.confidence_interval[name])
    return f"{name} +- {scale * bootstrap.standard_error[name]:.2g}{unit} (95 %: {low:.4g} to {high:.4g}{unit})"
