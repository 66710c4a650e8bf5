"""What a bench shows: a pulley test, and a manipulator whose cells, angle and dimensions are not quite what they read.

The parameters of a bench are those of the manipulator and the errors of its instruments and dimensions. A cell
reads gain * tension + zero; what it reads is counted from a tendon that is already under `pretension`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from ..errors import InputError, within
from ..measurements.markers import Marker, marker_column, marker_positions, markers_of, seen
from ..measurements.readings import NAMED, READINGS, columns_of, kind_of, of_tendons, tendon_number
from ..measurements.table import Measurements
from ..mechanics.capstan import pulling_tension
from ..programs.kept import kept_program
from ..progress import stage
from ..quantities import dimension_of
from ..robot.loads import Loads, loads_in_space
from ..robot.manipulator import Manipulator, in_space as body_in_space
from ..robot.profiles import shifted
from ..statics.equilibrium import RESULTS, Equilibrium
from ..statics.solve import solve
from ..units import Dimension, si_unit
from .course import WITHOUT, Course, Shown
from .past import PARAMETER, is_past

TRIALS = "trial_deviation"  # ln(mu of a trial / mu), one each
LANES = 128  # rows are solved in multiples of these: few sizes, so that tables and curves share compiled programs

Parameters = Mapping[str, ArrayLike]  # numbers by name; that of TRIALS is one for each trial


class Parameter(NamedTuple):
    """What may be fitted."""

    name: str
    start: float | None  # None: the manipulator's own
    positive: bool
    scale: float  # a size that matters, where the parameter may be 0; SI

    @property
    def dimension(self) -> Dimension:
        return dimension_of(self.name)


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        Parameter("friction_coefficient", None, True, 1.0),
        Parameter("youngs_modulus", None, True, 1.0),
        Parameter("stiffness_factor", 1.0, True, 1.0),  # of a body without a single modulus
        Parameter("length", None, True, 1.0),
        Parameter("drag", 1.0, True, 1.0),
        Parameter("outer_radius_error", 0.0, False, 1e-4),  # true less stated, all along the body
        Parameter("tendon_offset_error", 0.0, False, 1e-4),
        Parameter("base_gain", 1.0, True, 0.02),
        Parameter("tip_gain", 1.0, True, 0.02),
        Parameter("base_zero", 0.0, False, 0.5),
        Parameter("tip_zero", 0.0, False, 0.5),
        Parameter("pretension", 1.0, True, 0.5),  # of every tendon, not read by the cells
        Parameter("angle_zero", 0.0, False, 0.02),
        Parameter("tendon_angle_error", 0.0, False, 0.02),  # of a body in space, all tendons alike
        *(Parameter(f"camera_{axis}", 0.0, False, 1e-3) for axis in "xyz"),  # where positions are counted from
        *(Parameter(f"camera_turn_{axis}", 0.0, False, 0.02) for axis in "xyz"),  # as `markers.seen` takes it
        *(Parameter(f"gravity_turn_{axis}", 0.0, False, 0.02) for axis in "xyz"),  # axis times angle
        Parameter(PARAMETER, 1.0, True, 0.5),  # the largest base tension before the first row, as read
    )
}
TURNS_OUT = tuple(f"{name}_{axis}" for name in ("camera_turn", "gravity_turn") for axis in "xy")
OF_SPACE = ("tendon_angle_error", "camera_z", *TURNS_OUT)


def stiffness_parameter(manipulator: Manipulator) -> str:
    """The parameter of stiffness: the modulus where that is one number, else the factor on the stiffness."""
    modulus = manipulator.youngs_modulus
    return "stiffness_factor" if modulus is None or callable(modulus) else "youngs_modulus"


def free_parameters(manipulator: Manipulator, free: Sequence[str] | str | None) -> tuple[str, ...]:
    """The names that were asked for, or else those of friction and stiffness.

    Raises:
        InputError: for an unknown name, or a parameter that this body does not have.
    """
    names = ("friction_coefficient", stiffness_parameter(manipulator)) if free is None else free
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        parameter_named(name)
    if "youngs_modulus" in names and stiffness_parameter(manipulator) != "youngs_modulus":
        raise InputError("the body has no single youngs_modulus; fit stiffness_factor, which multiplies its stiffness")
    turns = [name for name in names if name in OF_SPACE]
    if turns and not manipulator.in_space:
        raise InputError(f"{turns[0]} turns a body out of its plane; give its tendons an angle, or do not fit it")
    if "outer_radius_error" in names and not manipulator.stiffened_by_radii:
        raise InputError("outer_radius_error changes nothing where bending_stiffness is given; fit stiffness_factor")
    return names


def starting_value(manipulator: Manipulator, name: str, given: Mapping[str, float] | None = None) -> float:
    """Where the search for a parameter starts: as given, or else at the manipulator's own or its usual value."""
    start = parameter_named(name).start
    if given and name in given:
        return float(given[name])
    own = getattr(manipulator, name, None)
    return float(own) if own is not None and (start is None or own > 0) else float(start or 0.0)


def with_parameters(manipulator: Manipulator, parameters: Parameters) -> Manipulator:
    """The manipulator with its numbers replaced and its dimensions corrected; other parameters are not its own."""
    names = tuple(name for name in parameters if hasattr(manipulator, name))
    numbers = [parameters[name] for name in names]
    body = eqx.tree_at(lambda m: [getattr(m, n) for n in names], manipulator, numbers, is_leaf=lambda x: x is None)
    if "outer_radius_error" in parameters:
        radius = shifted(body.outer_radius, parameters["outer_radius_error"])
        body = eqx.tree_at(lambda m: m.outer_radius, body, radius)
    if "tendon_offset_error" in parameters:
        offsets = [shifted(tendon.offset, parameters["tendon_offset_error"]) for tendon in body.tendons]
        body = eqx.tree_at(lambda m: [tendon.offset for tendon in m.tendons], body, offsets)
    if "tendon_angle_error" in parameters:
        body = body_in_space(body)
        error = parameters["tendon_angle_error"]
        angles = [shifted(tendon.angle, error) for tendon in body.tendons if tendon.angle is not None]
        body = eqx.tree_at(lambda m: [tendon.angle for tendon in m.tendons], body, angles)
    return body


def _turn(parameters: Parameters, name: str) -> Float[Array, " 3"] | None:
    """The three numbers of a turn or shift; None where none of them is known to differ from 0."""
    own = [f"{name}_{axis}" for axis in "xyz"]
    if not any(one in parameters for one in own):
        return None
    return jnp.stack([jnp.asarray(parameters.get(one, 0.0)) for one in own])


class Evaluation(NamedTuple):
    """What a bench shows, one row each."""

    readings: dict[str, np.ndarray]  # by column, (rows,), SI
    derivatives: dict[str, np.ndarray]  # by column, (rows, parameters), in the flat order of the parameters
    results: RESULTS  # how the solves went
    against: np.ndarray  # (rows, tendons), whether a tendon travels against its direction


class Pulley(eqx.Module):
    """A pulley test."""

    weight: Float[np.ndarray | Array, " rows"]
    wrap_angle: Float[np.ndarray | Array, " rows"]
    name: str = eqx.field(default="", static=True)
    columns: tuple[str, ...] = eqx.field(default=("pulling_tension",), static=True)

    def predict(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> dict[str, Array]:
        mu = with_parameters(manipulator, parameters).friction_coefficient
        return {"pulling_tension": pulling_tension(self.weight, mu, self.wrap_angle)}


@dataclass(frozen=True)
class BenchSetting:
    """What all rows of a bench share.

    Args:
        loads: constant ones, such as gravity, in the fixed frame at the base; tip forces of the rows are added.
        markers: by the name that columns have behind the @: `x@head` is the first coordinate of markers["head"]. A
            column such as `x@120mm` needs none here.
        given: numbers of the bench by the names of their parameters, SI units, where they differ from their usual
            values: a known `tip_gain`, or the pose of the camera. Where one of them is fitted, its search starts there.
    """

    loads: Loads | None = None
    markers: Mapping[str, Marker] = field(default_factory=dict)
    given: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        for name, value in self.given.items():
            if parameter_named(name).start is None or name == "stiffness_factor" or is_past(name):
                raise InputError(f"given: {name} is no number of the bench; give it with the manipulator or the trials")
            if not np.isfinite(value):
                raise InputError(f"given: {name} must be finite, got {value!r}")
        for name, marker in self.markers.items():
            if not 2 <= len(marker.offset) <= 3 or not np.all(np.isfinite([marker.arc_length, *marker.offset])):
                raise InputError(f"markers: {name} needs an arc length and an offset (x, y) or (x, y, z), got {marker}")

    def as_dict(self) -> dict[str, object]:
        """For `json`; loads in SI units."""
        loads = None if self.loads is None else {name: np.asarray(value) for name, value in vars(self.loads).items()}
        markers = {name: marker._asdict() for name, marker in self.markers.items()}
        return {"loads": loads, "markers": markers, "given": dict(self.given)}


PLAIN = BenchSetting()


class AllRows(eqx.Module):
    """A `BenchSetting` as arrays, with the markers of one table."""

    loads: Loads | None = None  # behind those of the rows
    given: Mapping[str, Float[np.ndarray | Array, ""]] = eqx.field(default_factory=dict)  # parameters by name
    marker_names: tuple[str, ...] = eqx.field(default=(), static=True)
    arc_length: Float[np.ndarray | Array, " markers"] = eqx.field(default_factory=lambda: np.zeros(0))  # m
    offset: Float[np.ndarray | Array, "markers 3"] = eqx.field(default_factory=lambda: np.zeros((0, 3)))  # m

    @classmethod
    def of(cls, setting: BenchSetting, markers: Mapping[str, Marker]) -> "AllRows":
        """With markers by their names."""
        places = np.array([float(marker.arc_length) for marker in markers.values()])
        offset = np.array([(*marker.offset, 0.0)[:3] for marker in markers.values()], float).reshape(-1, 3)
        numbers = {name: np.asarray(value, float) for name, value in setting.given.items()}
        return cls(setting.loads, numbers, tuple(markers), places, offset)

    def loads_with(self, tip_force: Array | None, parameters: Parameters, *, in_space: bool) -> Loads | None:
        """The loads of a row, with gravity where it is turned to."""
        if self.loads is None:
            return None if tip_force is None else Loads(tip_force=tip_force)
        loads, turn = loads_in_space(self.loads) if in_space else self.loads, _turn(parameters, "gravity_turn")
        if turn is not None:
            loads = replace(loads, gravity=seen(jnp.asarray(loads.gravity), jnp.zeros(3), turn))
        if tip_force is None:
            return loads
        own = Loads(tip_force=tip_force)
        more = loads_in_space(own).tip_force if in_space else own.tip_force
        return replace(loads, tip_force=jnp.asarray(loads.tip_force) + jnp.asarray(more))

    def markers_on(self, found: Equilibrium) -> Float[Array, "markers components"] | None:
        """Where the markers are, m; None without markers."""
        if not self.marker_names:
            return None
        return marker_positions(found.at(self.arc_length), jnp.asarray(self.offset))


class Bench(eqx.Module):
    """Rows of one table of a manipulator, or of levels to predict at."""

    base_tension: Float[np.ndarray | Array, "rows tendons"]  # as read
    direction: tuple[Float[np.ndarray | Array, " rows"] | None, ...]  # one per tendon, None where it is to be found
    tip_force: Float[np.ndarray | Array, "rows components"] | None = None
    trial: Int[np.ndarray | Array, " rows"] | None = None  # which of the trial deviations holds
    columns: tuple[str, ...] = eqx.field(default=(), static=True)
    name: str = eqx.field(default="", static=True)
    read_in: Mapping[str, Int[np.ndarray | Array, " readings"]] = eqx.field(default_factory=dict)
    # the rows in which a column was read; a column that is not here was read in all
    course: Course | None = None  # of rows that know what came before; None where each slides as its direction says
    setting: AllRows = eqx.field(default_factory=AllRows)

    @property
    def on_one_curve(self) -> bool:
        """Whether the rows lie on the curve of a free body of one tendon that is pulled in."""
        if self.course is not None:
            return not self.course.turns
        slides_out = any(np.any(np.asarray(stated) < 0) for stated in self.direction if stated is not None)
        free = self.tip_force is None and self.setting.loads is None
        return self.base_tension.shape[1] == 1 and free and not slides_out

    def in_space(self, manipulator: Manipulator) -> bool:
        """Whether the rows are solved in space; static."""
        loads, force = self.setting.loads, self.tip_force
        pushed = force is not None and force.shape[-1] == 3
        return manipulator.in_space or pushed or (loads is not None and loads.in_space)

    def shown(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> Shown:
        """The rows in equilibrium: what instruments without errors show of them."""
        parameters = {**self.setting.given, **parameters}
        body = with_parameters(manipulator, parameters)
        by_trial = self.trial is not None and TRIALS in parameters
        deviation = jnp.asarray(parameters[TRIALS])[self.trial] if by_trial else None
        if self.course is not None:
            tension = _true_tension(parameters, self.course.path(parameters))
            of_trial = None if deviation is None else deviation[self.course.first_row]
            return self.course.trace(body, tension, of_trial, nodes)
        tension, in_space = _true_tension(parameters, jnp.asarray(self.base_tension)), self.in_space(body)

        def one(tension, direction, force, deviation):
            there = body
            if deviation is not None:
                mu = jnp.asarray(body.friction_coefficient) * jnp.exp(deviation)
                there = eqx.tree_at(lambda m: m.friction_coefficient, body, mu)
            loads = self.setting.loads_with(force, parameters, in_space=in_space)
            found = solve(there, tension, loads, direction=direction, nodes=nodes, throw=False)
            return Shown(
                found.tip_tension,
                found.tip_angle,
                found.tip_position,
                found.result,
                found.direction_contradicted,
                self.setting.markers_on(found),
            )

        force = None if self.tip_force is None else jnp.asarray(self.tip_force)
        return jax.vmap(one)(tension, jax.tree.map(jnp.asarray, self.direction), force, deviation)

    def readings(self, shown: Shown, columns: Sequence[str], parameters: Parameters) -> dict[str, Array]:
        """What the instruments of columns read, one per row."""
        parameters = {**self.setting.given, **parameters}
        shift, turn = _turn(parameters, "camera"), _turn(parameters, "camera_turn")
        if shift is not None or turn is not None:
            none = jnp.zeros(3)
            look = partial(seen, shift=none if shift is None else shift, turn=none if turn is None else turn)
            markers = None if shown.markers is None else look(shown.markers)
            shown = shown._replace(tip_position=look(shown.tip_position), markers=markers)
        return {column: self._reading(shown, column, parameters) for column in columns}

    def _reading(self, shown: Shown, column: str, parameters: Parameters) -> Array:
        kind = READINGS[kind_of(column)]
        values = kind.of(shown)
        if kind.by_cell:
            gain, zero = (_of_cells(parameters, name, values) for name in ("tip_gain", "tip_zero"))
            values = gain * (values - parameters.get("pretension", 0.0)) + zero
        if kind.zero:
            values = values + parameters.get(kind.zero, 0.0)
        if marker := marker_column(column):
            return values[..., self.setting.marker_names.index(marker[1])]
        return values[..., tendon_number(column) - 1] if kind.per_tendon else values

    def predict(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> dict[str, Array]:
        """What the instruments read, each column in the rows in which it was read."""
        found = self.readings(self.shown(manipulator, parameters, nodes), self.columns, parameters)
        return found | {column: found[column][rows] for column, rows in self.read_in.items()}

    def evaluate(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> Evaluation:
        """Every reading of every row with its derivatives, whether it was read or not."""
        rows = self.base_tension.shape[0]
        fill = -rows % LANES

        def padded(arrays):
            return jax.tree.map(lambda x: np.pad(x, ((0, fill), *[(0, 0)] * (np.ndim(x) - 1)), mode="edge"), arrays)

        own = padded((self.base_tension, self.direction, self.tip_force, self.trial))
        course = self.course
        if course is not None:
            trial, step = padded((course.trial, course.step))
            course = replace(course, trial=trial, step=step)
        with stage(f"solving {rows} rows"):
            bare = Bench(*own, course=course, setting=self.setting)
            answer = _evaluate(bare, manipulator, jax.tree.map(np.asarray, parameters), nodes)
        return jax.tree.map(lambda x: np.asarray(x)[:rows], answer)


def _true_tension(parameters: Parameters, readings: Array) -> Array:
    """Base tensions, N, from what the cells read; tendons last."""
    gain, zero = (_of_cells(parameters, name, readings) for name in ("base_gain", "base_zero"))
    return jnp.maximum((readings - zero) / gain + parameters.get("pretension", 0.0), 0.0)


def _of_cells(parameters: Parameters, name: str, readings: Array) -> Array:
    """A parameter of the cells, one per tendon: `base_gain` for all of them, or `base_gain_2` for that of tendon 2."""
    common = parameters.get(name, PARAMETERS[name].start)
    tendons = range(1, readings.shape[-1] + 1)
    return jnp.stack([jnp.asarray(parameters.get(f"{name}_{i}", common)) for i in tendons])


@kept_program
@eqx.filter_jit
def _evaluate(bench: Bench, manipulator: Manipulator, parameters: dict[str, Array], nodes: int) -> Evaluation:
    flat, unravel = jax.flatten_util.ravel_pytree(parameters)

    every = columns_of(manipulator.num_tendons, bench.setting.marker_names, in_space=bench.in_space(manipulator))

    def observe(flat):
        parameters = unravel(flat)
        shown = bench.shown(manipulator, parameters, nodes)
        readings = bench.readings(shown, every, parameters)
        return readings, (readings, shown.result, shown.direction_contradicted)

    derivatives, (readings, results, against) = jax.jacfwd(observe, has_aux=True)(flat)
    return Evaluation(readings, derivatives, results, against)


def unit_of(name: str) -> str:
    """The SI unit of a parameter, of a product of powers of some, such as "1/Pa", or of a sum of two.

    "1" for a plain number, such as the friction of a trial over that of all; "" for an unknown name.
    """
    name = re.split(" [+-] ", name)[0]
    above, below = [], []
    for slash, stem, power in re.findall(r"(/ )?([^\s*/^]+)(?:\^(\S+))?", name):
        try:
            unit = "1" if stem == "1" or stem.startswith(TRIALS) else si_unit(parameter_named(stem).dimension)
        except InputError:
            return ""
        if unit != "1":
            whole = f"({unit})" if "/" in unit or " " in unit else unit
            (below if slash else above).append(f"{whole}^{power}" if power else whole if slash else unit)
    return "".join([" ".join(above) or "1", *(f"/{unit}" for unit in below)])


def parameter_named(name: str) -> Parameter:
    """What a parameter is; `tip_gain_2` is that of the cell of tendon 2, `before_2` that of trial 2.

    Raises:
        InputError: for an unknown name.
    """
    stem, _, tendon = name.rpartition("_")
    if tendon.isdigit() and stem.endswith(("_gain", "_zero")) and stem != "angle_zero":
        name = stem
    name = PARAMETER if is_past(name) else name
    if name not in PARAMETERS:
        raise InputError(f"{name!r} is no parameter that can be fitted; there are {', '.join(PARAMETERS)}")
    return PARAMETERS[name]


class BenchModel(eqx.Module):
    """Every table's readings from the parameters."""

    manipulator: Manipulator
    experiments: tuple[Pulley | Bench, ...]
    nodes: int = eqx.field(static=True)

    def __call__(self, parameters: dict[str, Array]) -> dict[str, Array]:
        predictions = {}
        for experiment, name in zip(self.experiments, self.names, strict=True):
            for column, values in experiment.predict(self.manipulator, parameters, self.nodes).items():
                predictions[f"{name}: {column}"] = values
        return predictions

    @property
    def names(self) -> list[str]:
        """Of the tables, with a number where two have the same name."""
        names = [experiment.name for experiment in self.experiments]
        return [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]


class Group(NamedTuple):
    """One column that was read in one table: a group of data with its own noise."""

    name: str  # of the table, as in `BenchModel.names`
    column: str
    table: Measurements
    experiment: Pulley | Bench

    @property
    def label(self) -> str:
        return f"{self.name}: {self.column}"

    @property
    def there(self) -> np.ndarray:
        """(rows,), in which rows of the table the column was read."""
        return self.table.has(self.column)

    @property
    def observed(self) -> np.ndarray:
        """The readings, SI."""
        return self.table.read(self.column)


def groups_of(tables: Sequence[Measurements], model: BenchModel) -> list[Group]:
    """One for each observed column of each table."""
    return [
        Group(name, column, table, experiment)
        for name, table, experiment in zip(model.names, tables, model.experiments, strict=True)
        for column in experiment.columns
    ]


def experiment_of(
    table: Measurements,
    manipulator: Manipulator,
    first_trial: int = 0,
    course: Course | None = None,
    setting: BenchSetting = PLAIN,
) -> Pulley | Bench:
    """A table as the model takes it.

    Args:
        table: a pulley test or rows of the manipulator.
        manipulator: whose tendons the columns must fit.
        first_trial: the number of trials in the tables before.
        course: of the rows, where they know what came before.
        setting: what all rows share.

    Raises:
        InputError: for columns that are missing, too many, or observe nothing.
    """
    if "pulling_tension" in table:
        return Pulley(table["weight"], table["wrap_angle"], table.name)
    with within(table.name):
        columns = _observed(table, manipulator.num_tendons)
        found = markers_of(columns, setting.markers, float(np.asarray(manipulator.length)))
        force = _tip_force(table)
        bench = Bench(
            np.stack([table[column] for column in of_tendons("base_tension", manipulator.num_tendons)], axis=1),
            tuple(map(table.columns.get, of_tendons("direction", manipulator.num_tendons))),
            force if np.any(force) else None,
            first_trial + table["trial"].astype(int) if "trial" in table else None,
            tuple(columns),
            table.name,
            {column: np.flatnonzero(table.has(column)) for column in columns if not np.all(table.has(column))},
            course,
            AllRows.of(setting, found),
        )
        if not bench.in_space(manipulator):
            for column in columns:
                if READINGS[kind_of(column)].in_space:
                    raise InputError(
                        f"column {column!r}, but the body is in the plane; give its tendons an angle, or leave it out"
                    )
        if course is not None and (found or setting.loads is not None or bench.in_space(manipulator)):
            raise InputError(f"a history with {_not_followed(found, setting)} is not known yet; {WITHOUT}")
    return bench


def _not_followed(markers: Mapping[str, Marker], setting: BenchSetting) -> str:
    return "markers" if markers else "loads of all rows" if setting.loads is not None else "a body in space"


def _observed(table: Measurements, num_tendons: int) -> list[str]:
    """The columns that a fit explains."""
    for column in of_tendons("base_tension", num_tendons):
        if column not in table:
            raise InputError(f"no column {column!r}; a manipulator of {num_tendons} tendons needs it")
    columns = [column for column in table.columns if kind_of(column)]
    if not columns:
        raise InputError("nothing observed; add a column tip_tension [N], tip_angle [deg] or tip_x [mm]")
    for column in table.columns:
        numbered = column not in NAMED and column != "trial" and not marker_column(column)
        if numbered and tendon_number(column) > num_tendons:
            raise InputError(f"column {column!r}, but the manipulator has {num_tendons} tendon(s)")
    return columns


def _tip_force(table: Measurements) -> Float[np.ndarray, "rows components"]:
    """N; of three components where a column tells the third."""
    none = np.zeros(len(table))
    axes = "xyz" if "tip_force_z" in table else "xy"
    return np.stack([table.columns.get(f"tip_force_{axis}", none) for axis in axes], axis=1)
