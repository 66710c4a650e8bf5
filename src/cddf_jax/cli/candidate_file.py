"""The file of `cddf plan --candidates`: experiments that could be done next."""

from pathlib import Path

import numpy as np

from ..errors import InputError, within
from ..files.manipulator_file import read_toml
from ..identification.experiment_design import Candidate
from ..measurements.columns import column_dimension
from ..units import quantity
from .fit_texts import noise_from_text


def read_candidates(path: Path) -> list[Candidate]:
    """Candidates from a TOML file.

        [[candidate]]
        name = "tip angles"
        base_tension = ["20 N", "40 N", "60 N"]
        noise = { tip_angle = "1 deg", tip_tension = "0.5 N" }
        repeats = 3
        cost = 2.0

    Raises:
        InputError: names the file, the candidate and the remedy.
    """
    with within(path):
        content = read_toml(path, 'base_tension = "20 N"')
    entries = content.get("candidate")
    if not isinstance(entries, list) or not entries or set(content) != {"candidate"}:
        raise InputError(f"{path}: holds no candidates; write one [[candidate]] table for each, and nothing else")
    return [_candidate(f"{path}, candidate {i}", entry) for i, entry in enumerate(entries, 1)]


def _candidate(where: str, entry: dict[str, object]) -> Candidate:
    entry = dict(entry)
    name, noise = entry.pop("name", where), entry.pop("noise", None)
    repeats, cost = entry.pop("repeats", 1), entry.pop("cost", 1.0)
    if not isinstance(noise, dict):
        raise InputError(f'{where}: needs what is read, as in noise = {{ tip_tension = "0.5 N" }}')
    if isinstance(repeats, bool) or not isinstance(repeats, int):
        raise InputError(f"{where}: repeats must be a whole number, got {repeats!r}")
    if isinstance(cost, bool) or not isinstance(cost, int | float):
        raise InputError(f"{where}: cost must be a number, got {cost!r}")
    conditions = {column: _numbers(where, column, value) for column, value in entry.items()}
    deviations = {column: noise_from_text(column, str(value), f"{where}: {column}") for column, value in noise.items()}
    with within(where):
        return Candidate(str(name), conditions, deviations, repeats, float(cost))


def _numbers(where: str, column: str, value: object) -> np.ndarray:
    values = value if isinstance(value, list) else [value]
    if not values:
        raise InputError(f"{where}: {column} is empty; give a value with its unit")
    dimension = column_dimension(column) or "dimensionless"
    return np.array([quantity(each, dimension, f"{where}: {column}") for each in values])
