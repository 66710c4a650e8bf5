"""What the options of `cddf fit` and `cddf plan` say of parameters and noise: priors, bounds, standard deviations."""

import re

from ..errors import InputError
from ..estimation.observations import Noise
from ..estimation.parameter_space import Prior, Uniform
from ..identification.bench import parameter_named
from ..measurements.columns import column_dimension
from ..units import quantity


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
    return column, noise_from_text(column, numbers, f"--noise {column}")


def noise_from_text(column: str, numbers: str, what: str) -> float | Noise:
    """ "0.5 N", or with a part that grows with the reading "0.2 N + 1 %"."""
    dimension = column_dimension(column) or "dimensionless"
    floor, *shares = re.split(r"\s\+\s*", numbers, maxsplit=1)
    if not shares and not floor.endswith("%"):
        return quantity(floor, dimension, what)
    floor, share = (floor, shares[0]) if shares else ("", floor)
    if not share.endswith("%"):
        raise InputError(f'{what}: the part that grows with the reading is in %, got {share!r}; write "0.2 N + 1 %"')
    fraction = quantity(share[:-1].strip(), "dimensionless", what) / 100
    return Noise(quantity(floor, dimension, what) if floor else 0.0, fraction)
