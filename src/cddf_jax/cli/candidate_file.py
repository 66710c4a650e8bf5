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
        entries, found = content.get("candidate"), []
        if not isinstance(entries, list) or not entries or set(content) != {"candidate"}:
            raise InputError("holds no candidates; write one [[candidate]] table for each, and nothing else")
        for i, entry in enumerate(entries, 1):
            with within(f"candidate {i}"):
                found.append(_candidate({"name": f"{path}, candidate {i}"} | entry))
        return found


def _candidate(entry: dict[str, object]) -> Candidate:
    name, noise = str(entry.pop("name")), entry.pop("noise", None)
    repeats, cost = entry.pop("repeats", 1), quantity(entry.pop("cost", 1.0), "dimensionless", "cost")
    if not isinstance(noise, dict):
        raise InputError('needs what is read, as in noise = { tip_tension = "0.5 N" }')
    if isinstance(repeats, bool) or not isinstance(repeats, int):
        raise InputError(f"repeats must be a whole number, got {repeats!r}")
    conditions = {column: _numbers(column, value) for column, value in entry.items()}
    deviations = {column: noise_from_text(column, str(value), column) for column, value in noise.items()}
    return Candidate(name, conditions, deviations, repeats, cost)


def _numbers(column: str, value: object) -> np.ndarray:
    values = value if isinstance(value, list) else [value]
    if not values:
        raise InputError(f"{column} is empty; give a value with its unit")
    dimension = column_dimension(column) or "dimensionless"
    return np.array([quantity(each, dimension, column) for each in values])
