"""Results for other tools: xarray for labelled arrays, pandas for tables and CSV.

A sweep's answer is an `xarray.Dataset` already.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError, needed
from ..estimation.determination import IDENTIFIED, NOT_IDENTIFIED, Determination
from ..files.csv_table import table_csv
from ..files.writing import picked
from ..history.history import ENERGIES, History
from ..identification.parameters import unit_of
from ..mechanics.fields import AnyFields
from ..numerics.arrays import evaluated
from ..numerics.given_numbers import check_numbers
from ..quantities import QUANTITIES
from ..statics.equilibrium import Equilibrium
from ..statics.equilibrium_text import result_in_words
from ..sweeping.one_solve import AXES, OUTPUTS_OF, attributes, coordinates

if TYPE_CHECKING:
    import pandas
    import xarray

POINTS = 201  # along the body, where none are given
OF_STEPS = (  # columns of a history
    *("base_tension", "tip_tension", "tip_angle", "tip_position", "tendon_displacement", "direction", "front"),
    *("num_turns", "error_estimate"),
)
# columns of tables: a body in the plane has a heading, one in space has frame, twist and path
ALONG = ("heading", "frame", "curvature", "twist", "tension", "normal_force", "friction_force", "path")


def as_dataset(equilibrium: Equilibrium, arc_length: ArrayLike | Sequence[float] | None = None) -> "xarray.Dataset":
    """An equilibrium with labels and units: fields over arc_length (m), tendon (0, 1, ...) and component (X, Y).

    In space there is a third component, Z, and "axis" (x, y, z) of the cross-section. Write the dataset by its methods
    `to_netcdf`, `to_dataframe` and `to_zarr`.

    Args:
        equilibrium: a single one, also of a solve that failed. Its `result` is an attribute of the dataset, in words.
        arc_length: s, m, of the fields, within 0 to L; 201 points from base to tip unless given.

    Raises:
        InputError: for a batch of equilibria, arc lengths outside the body, or where xarray is not installed.
    """
    xarray = needed("xarray")
    s = _stations(equilibrium, arc_length)
    fields = evaluated(Equilibrium.at, equilibrium, s)
    data, known = {}, OUTPUTS_OF[len(equilibrium.tip_position)]
    for name, own in known.items():
        if name == "arc_length" or (name.startswith("peak_strain") and not equilibrium.has_wall):
            continue
        values = getattr(fields, name) if "point" in own else getattr(equilibrium, name)
        dims = tuple("arc_length" if dim == "point" else dim for dim in own)
        data[name] = (dims, np.asarray(values), attributes(name))
    words = {"result": result_in_words(equilibrium) or "successful"}
    dataset = xarray.Dataset(data, {"arc_length": ("arc_length", s, attributes("arc_length"))}, words)
    return dataset.assign_coords(coordinates((), {}, dataset.sizes))


def as_frame(what: Equilibrium | History | Determination) -> "pandas.DataFrame":
    """A table in SI units of an equilibrium, a history or a fit.

    - Equilibrium: its fields, a row for each of 201 arc lengths. Columns have their units, and tendons count from 1. In
      space "curvature_x" is the twist, and "frame_x_y" the first component of the axis y.
    - History: a row for each step. Several tendons count from 1.
    - Fit (or any `Determination`): a row for each parameter, and for each combination that is identified in place of
      its parts, with value, standard_error, lower, upper (95 %), unit and status. A parameter that is not identified
      has the value NaN and an infinite standard error.

    Raises:
        InputError: for a batch of equilibria, or where pandas is not installed.
        TypeError: for anything else.
    """
    pandas = needed("pandas")
    match what:
        case Equilibrium():
            return pandas.DataFrame(field_columns(fields_on_grid(what)))
        case History():
            return pandas.DataFrame(history_columns(history_numbers(what)))
        case Determination():
            return pandas.DataFrame(_parameters(what)).set_index("parameter")
    raise TypeError(f"as_frame takes an Equilibrium, a History or a Fit, got {type(what).__name__}")


def fields_csv(fields: AnyFields) -> str:
    """The fields along the body as the text of a CSV file."""
    return table_csv(field_columns(fields))


def fields_on_grid(equilibrium: Equilibrium) -> AnyFields:
    """The fields at 201 arc lengths from base to tip."""
    return evaluated(Equilibrium.at, equilibrium, _stations(equilibrium, None))


def field_columns(fields: AnyFields) -> dict[str, np.ndarray]:
    """The columns of a table of fields, one number for each arc length.

    Tendons count from 1. In space curvature_x is the twist, and frame_x_y the first component of the axis y.
    """
    known = OUTPUTS_OF[fields.position.shape[-1]]
    columns = {"arc_length [m]": np.asarray(fields.arc_length)}
    columns |= {f"{axis} [m]": own for axis, own in zip(AXES, np.asarray(fields.position).T, strict=False)}
    for name in filter(known.__contains__, ALONG):
        own, values = [dim for dim in known[name] if dim != "point"], np.asarray(getattr(fields, name))
        values = np.moveaxis(values, known[name].index("point"), -1)
        for place in np.ndindex(values.shape[:-1]):
            ends = [f"_{i + 1 if dim == 'tendon' else AXES[i]}" for dim, i in zip(own, place, strict=True)]
            columns[_head(name + "".join(ends), name)] = values[place]
    return columns


def _head(text: str, name: str) -> str:
    """The head of a column with the unit of a quantity."""
    unit = QUANTITIES[name].unit
    return text if unit == "1" else f"{text} [{unit}]"


def history_numbers(history: History) -> dict[str, np.ndarray]:
    """The numbers of a history by name, step first."""
    known = picked(history, OF_STEPS) | picked(history.energies, ENERGIES)
    return {name: np.asarray(values) for name, values in known.items() if values is not None}


def history_columns(numbers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns of a table of a history, from its numbers."""
    columns: dict[str, np.ndarray] = {}
    for name, values in numbers.items():
        parts = values.reshape(len(values), -1).T
        several = AXES if name == "tip_position" else [f"{name}_{i + 1}" for i in range(len(parts))]
        heads = several if len(parts) > 1 else [name]
        columns |= {_head(head, name): part for head, part in zip(heads, parts, strict=False)}
    return columns


def _stations(equilibrium: Equilibrium, arc_length: ArrayLike | Sequence[float] | None) -> np.ndarray:
    shape = np.shape(equilibrium.tip_angle)
    if shape:
        raise InputError(f"needs a single equilibrium, got a batch of shape {shape}; `cddf.sweep` labels batches")
    length = float(equilibrium.arc_length[-1])
    if arc_length is None:
        return np.linspace(0.0, length, POINTS)
    check_numbers("arc_length", arc_length)
    s = np.atleast_1d(np.asarray(arc_length, float))
    if s.ndim != 1 or not np.all((s >= 0) & (s <= length)):
        raise InputError(f"arc_length must be one list within 0 to {length:g} m, the length of the body")
    return s


def _parameters(found: Determination) -> list[dict[str, str | float]]:
    rows = []
    for name, status in found.status.items():
        value = np.nan if status == NOT_IDENTIFIED else found.value[name]
        lower, upper = found.confidence_interval[name]
        rows.append((name, value, found.standard_error[name], lower, upper, unit_of(name), status))
    for name, (value, error, (low, high)) in found.identified_together.items():
        rows.append((name, value, error, low, high, unit_of(name), IDENTIFIED))
    heads = ("parameter", "value", "standard_error", "lower", "upper", "unit", "status")
    return [dict(zip(heads, row, strict=True)) for row in rows]
