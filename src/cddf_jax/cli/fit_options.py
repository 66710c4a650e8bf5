"""The texts that `cddf fit` and `cddf plan` read: priors, noise, and the bench."""

import re
from collections.abc import Sequence

from ..errors import InputError
from ..estimation.observations import Noise
from ..estimation.parameter_space import Prior
from ..identification.parameters import BenchSetting, parameter_named
from ..identification.tension_before import REST, Before, One
from ..measurements.columns import column_dimension
from ..measurements.markers import Marker
from ..robot.loads import Loads
from ..units import quantity, vector
from .options import read_all

PRIOR = '"youngs_modulus=1.4 MPa +- 0.1 MPa"'
GIVEN = '"tip_gain=1.03" or "camera_turn_z=3 deg"'
LEAVE_OUT = '"run_2.csv=8, 14"'
MARKER = '"head=0, 11, 0 mm at 80 mm"'
NOISE = '"tip_tension=0.5 N" or "tip_tension=0.2 N + 1 %"'


def read_priors(texts: Sequence[str] | None) -> dict[str, Prior]:
    """ "youngs_modulus=1.4 MPa +- 0.1 MPa"."""
    return read_all(texts, "--prior", PRIOR, _prior)


def _prior(name: str, text: str) -> Prior:
    first, found, second = text.replace("±", "+-").partition("+-")
    if not found:
        raise InputError(f"--prior {name}: write for example {PRIOR}, got {text!r}")
    return Prior(*(_of_parameter(name, part, "--prior") for part in (first, second)))


def _of_parameter(name: str, text: str, option: str) -> float:
    return quantity(text.strip(), parameter_named(name).dimension, f"{option} {name}")


def read_before(text: str | None) -> Before:
    """ "75 N" for all trials, or one for each: "rest, 75 N"."""
    parts = [part.strip() for part in (text or REST).split(",")]
    entries: list[One] = [REST if part == REST else quantity(part, "force", "--before") for part in parts]
    return entries if len(entries) > 1 else entries[0]


def read_leave_out(texts: Sequence[str] | None) -> str | dict[str, str]:
    """ "8, 14, 20-23"; of several files "run_2.csv=8, 14"."""
    if any("=" in text for text in texts or ()):
        return read_all(texts, "--leave-out", LEAVE_OUT, lambda _, rows: rows)
    return ", ".join(texts or ())


def read_setting(loads: Loads | None, marker: Sequence[str] | None, given: Sequence[str] | None) -> BenchSetting:
    """What all rows have in common: loads, places of markers, known numbers."""
    numbers = read_all(given, "--given", GIVEN, lambda name, text: _of_parameter(name, text, "--given"))
    return BenchSetting(loads, read_all(marker, "--marker", MARKER, _marker), numbers)


def _marker(name: str, text: str) -> Marker:
    offset, at, place = (part.strip() for part in text.partition(" at "))
    if not at:
        raise InputError(f"--marker {name}: write for example {MARKER}, got {text!r}")
    return Marker(quantity(place, "length", f"--marker {name}"), vector(offset, "length", f"--marker {name}"))


def read_noise(texts: Sequence[str] | None) -> dict[str, float | Noise]:
    """ "tip_tension=0.5 N", or with a part that grows with the reading "tip_tension=0.2 N + 1 %"."""
    return read_all(texts, "--noise", NOISE, _noise)


def _noise(column: str, numbers: str) -> float | Noise:
    what = f"--noise {column}"
    dimension = column_dimension(column) or "dimensionless"
    floor, *shares = re.split(r"\s\+\s*", numbers, maxsplit=1)
    if not shares and not floor.endswith("%"):
        return quantity(floor, dimension, what)
    floor, share = (floor, shares[0]) if shares else ("", floor)
    if not share.endswith("%"):
        raise InputError(f'{what}: the part that grows with the reading is in %, got {share!r}; write "0.2 N + 1 %"')
    fraction = quantity(share[:-1].strip(), "dimensionless", what) / 100
    return Noise(quantity(floor, dimension, what) if floor else 0.0, fraction)
