"""The model of a bench: what its instruments read in a pulley test, and on a manipulator.

The parameters of a bench are the numbers of the manipulator, and the errors of its instruments and dimensions. A load
cell reads gain * (tension - pretension) + zero: `pretension` is the tension that a tendon has when its cell is set to
zero.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..errors import InputError, within
from ..history.history import History
from ..measurements.columns import is_reading
from ..measurements.forces import check_on_body, forces_of
from ..measurements.left_out import numbered
from ..measurements.markers import Marker, marker_column, marker_positions, markers_of, seen
from ..measurements.readings import NAMED, READINGS, columns_of, kind_of, kind_of_set, of_tendons, set_by, tendon_number
from ..measurements.table import Measurements
from ..mechanics.capstan import pulling_tension
from ..numerics.arrays import evaluated
from ..progress import stage
from ..quantities import TAKE_THE_PLANE
from ..robot.loads import Loads, PointLoad
from ..robot.manipulator import Manipulator, in_space
from ..robot.validation import check_loads
from ..statics.equilibrium import Equilibrium
from ..statics.solve import solve
from ..statics.status import Status
from ..units import shown
from .course import Course, Shown
from .parameters import (
    PLAIN,
    TRIALS,
    BenchSetting,
    Parameters,
    of_all_tendons,
    turn_of,
    with_deviation,
    with_parameters,
)

LANES = 128  # rows are solved in multiples of this number, so that tables and curves share compiled programs
FEW = 16  # the same where rows are solved one by one
ANGLE_NOISE = np.radians(3.0)  # by which a tip angle in space may read below 0, at most
ANGLE_SHARE = 0.1  # of the largest one: the same


class Evaluation(NamedTuple):
    """The readings of a bench and their derivatives, row by row."""

    readings: dict[str, np.ndarray]  # by column, (rows,), SI
    derivatives: dict[str, np.ndarray]  # by column, (rows, parameters), in the flat order of the parameters
    status: Int[Array, " rows"]  # how the solves ended
    direction_contradicted: np.ndarray  # (rows, tendons), whether a tendon travels against its direction
    by_base: dict[str, np.ndarray]  # by column, (rows, directions), by the readings of base tension; `Bench.along`


class Pulley(eqx.Module):
    """A pulley test."""

    weight: Float[np.ndarray | Array, " rows"]
    wrap_angle: Float[np.ndarray | Array, " rows"]
    name: str = eqx.field(default="", static=True)
    columns: tuple[str, ...] = eqx.field(default=("pulling_tension",), static=True)
    course: None = None  # its rows have no history
    in_order: bool = eqx.field(default=False, static=True)

    def predict(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> dict[str, Array]:
        mu = with_parameters(manipulator, parameters).friction_coefficient
        return {"pulling_tension": pulling_tension(self.weight, mu, self.wrap_angle)}

    def evaluate(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> Evaluation:
        """As `Bench.evaluate`."""
        flat, unravel = jax.flatten_util.ravel_pytree(jax.tree.map(jnp.asarray, dict(parameters)))
        slopes, values = jax.jacfwd(lambda x: (self.predict(manipulator, unravel(x), nodes),) * 2, has_aux=True)(flat)
        of_values, of_slopes = jax.tree.map(np.asarray, (values, slopes))
        rows = len(self.wrap_angle)
        return Evaluation(of_values, of_slopes, jnp.full(rows, Status.successful), np.zeros((rows, 0), bool), {})


class AllRows(eqx.Module):
    """A `BenchSetting` as arrays, with the markers of one table."""

    loads: Loads | None = None  # in addition to those of the rows
    given: Mapping[str, Float[np.ndarray | Array, ""]] = eqx.field(default_factory=dict)  # parameters by name
    marker_names: tuple[str, ...] = eqx.field(default=(), static=True)
    arc_length: Float[np.ndarray | Array, " markers"] = eqx.field(default_factory=lambda: np.zeros(0))  # m
    offset: Float[np.ndarray | Array, "markers 3"] = eqx.field(default_factory=lambda: np.zeros((0, 3)))  # m
    force_at: tuple[float, ...] = eqx.field(default=(), static=True)  # m, of the forces in the rows besides the tip's

    @classmethod
    def of(cls, setting: BenchSetting, markers: Mapping[str, Marker], force_at: Iterable[float] = ()) -> "AllRows":
        """The setting with these markers, by their names, and places of forces, m."""
        places = np.array([float(marker.arc_length) for marker in markers.values()])
        offset = np.array([(*marker.offset, 0.0)[:3] for marker in markers.values()], float).reshape(-1, 3)
        numbers = {name: np.asarray(value, float) for name, value in setting.given.items()}
        return cls(setting.loads, numbers, tuple(markers), places, offset, tuple(force_at))

    def loads_with(
        self, forces: Float[Array, "*steps places axes"] | None, parameters: Parameters, components: int = 2
    ) -> Loads | None:
        """All loads of a row or of the steps of a path, with gravity turned by the parameters; the tip comes first."""
        if forces is None and self.loads is None:
            return None
        own = jnp.zeros((1 + len(self.force_at), 2)) if forces is None else forces
        points = [PointLoad(place, own[..., i, :]) for i, place in enumerate(self.force_at, 1)]
        of_rows = Loads(own[..., 0, :], points=points).with_components(components)
        if self.loads is None:
            return of_rows
        loads, turn = self.loads.with_components(components), turn_of(parameters, "gravity_turn")
        if turn is not None:
            loads = replace(loads, gravity=seen(jnp.asarray(loads.gravity), jnp.zeros(3), turn))
        tip_force = jnp.asarray(loads.tip_force) + jnp.asarray(of_rows.tip_force)
        return replace(loads, tip_force=tip_force, points=(*loads.points, *of_rows.points))

    def markers_on(self, found: Equilibrium | History) -> Float[Array, "*steps markers components"] | None:
        """The positions of the markers, m, those of a history after each step; None without markers."""
        if not self.marker_names:
            return None
        fields, offset = found.at(self.arc_length), jnp.asarray(self.offset)
        if isinstance(found, History):
            return jax.vmap(marker_positions, (0, None))(fields, offset)
        return marker_positions(fields, offset)


class Bench(eqx.Module):
    """Rows of one table of a manipulator, or of levels to predict at."""

    actuation: Float[np.ndarray | Array, "rows tendons"]  # as read: base tensions, N, or displacements, m
    direction: tuple[Float[np.ndarray | Array, " rows"] | None, ...]  # one per tendon, None where it is to be found
    forces: Float[np.ndarray | Array, "rows places components"] | None = None  # N: on the tip, and as in `AllRows`
    trial: Int[np.ndarray | Array, " rows"] | None = None  # the index of the trial, for its deviation of friction
    columns: tuple[str, ...] = eqx.field(default=(), static=True)
    name: str = eqx.field(default="", static=True)
    read_in: Mapping[str, Int[np.ndarray | Array, " readings"]] = eqx.field(default_factory=dict)
    # the rows in which a column was read; a column that is not listed here was read in all rows
    course: Course | None = None  # the paths of rows with a history; None where each row slides as its direction says
    setting: AllRows = eqx.field(default_factory=AllRows)
    # those that are set, from 0; the others hang slack. A tuple is static, for tendons that are not alike
    tendons: Int[np.ndarray | Array, " tendons"] | tuple[int, ...] | None = None

    @property
    def on_one_curve(self) -> bool:
        """Whether the rows lie on one curve: that of a body without loads whose only tendon is pulled in."""
        free = self.forces is None and self.setting.loads is None
        if not free or self.actuation.shape[1] > 1:
            return False
        if self.course is not None:
            return not (self.course.turns or any(self.course.by_length) or self.course.short_steps)
        return not any(np.any(np.asarray(stated) < 0) for stated in self.direction if stated is not None)

    @property
    def in_order(self) -> bool | None:
        """Whether the rows are followed in their order; None: each from rest."""
        if self.course is None:
            return False
        return None if self.course.each_from_rest else True

    def components(self, manipulator: Manipulator) -> int:
        """How many components positions have in the rows; static."""
        loads, forces = self.setting.loads, self.forces
        least = 2 if loads is None else loads.components, 2 if forces is None else forces.shape[-1]
        return max(manipulator.components, *least)

    def one_by_one(self, manipulator: Manipulator) -> bool:
        """Whether rows are solved one after the other; static.

        Under loads in space all rows of a batch would wait for the slowest one.
        """
        loaded = self.forces is not None or self.setting.loads is not None
        return loaded and self.components(manipulator) == 3

    def shown(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> Shown:
        """What instruments without errors show of the rows, each in equilibrium."""
        parameters = {**self.setting.given, **parameters}
        body, components = with_parameters(manipulator, parameters), self.components(manipulator)
        own_tendons = None if self.tendons is None else jnp.asarray(self.tendons)
        set_ones = slice(None) if own_tendons is None else own_tendons

        def of_set_ones(name: str) -> Array:
            return of_all_tendons(parameters, name, manipulator.num_tendons)[set_ones]

        by_trial = self.trial is not None and TRIALS in parameters
        deviation = jnp.asarray(parameters[TRIALS])[self.trial] if by_trial else None
        if self.course is not None:
            course, readings = self.course, self.course.path(parameters)
            tension = _true_tension(parameters, readings, of_set_ones)
            if any(course.by_length):
                displacement = course.true_displacement(parameters, readings, of_set_ones("slack_offset"))
                tension = jnp.where(course.set_by_length, displacement, tension)
            of_trial = None if deviation is None else deviation[self.course.first_row]
            loads_with = partial(self.setting.loads_with, parameters=parameters, components=components)
            body = in_space(body) if components == 3 else body
            own = body if self.tendons is None else body.with_tendons(self.tendons)
            found = course.trace(own, tension, loads_with, self.setting.markers_on, of_trial, nodes)
            return found if own_tendons is None else _with_slack_ones(found, own_tendons, body.num_tendons)
        tension = _true_tension(parameters, jnp.asarray(self.actuation), of_set_ones)

        def one(tension, direction, forces, deviation):
            loads = self.setting.loads_with(forces, parameters, components)
            here = with_deviation(body, deviation)
            found = solve(here, tension, loads, direction=direction, nodes=nodes, throw=False)
            return Shown(
                found.tendon_displacement,
                found.tip_tension,
                found.tip_angle,
                found.tip_position,
                found.tip_axis,
                found.status,
                found.direction_contradicted,
                self.setting.markers_on(found),
            )

        forces = None if self.forces is None else jnp.asarray(self.forces)
        rows = tension, jax.tree.map(jnp.asarray, self.direction), forces, deviation
        return jax.lax.map(lambda row: one(*row), rows) if self.one_by_one(body) else jax.vmap(one)(*rows)

    def readings(self, shown: Shown, columns: Sequence[str], parameters: Parameters) -> dict[str, Array]:
        """What the instruments read: for each column one number per row."""
        parameters = {**self.setting.given, **parameters}
        shift, turn = turn_of(parameters, "camera"), turn_of(parameters, "camera_turn")
        if shift is not None or turn is not None:
            none = jnp.zeros(3)
            look = partial(seen, shift=none if shift is None else shift, turn=none if turn is None else turn)
            markers = None if shown.markers is None else look(shown.markers)
            axis = look(shown.tip_axis, shift=none)  # a direction turns, but does not move
            shown = shown._replace(tip_position=look(shown.tip_position), tip_axis=axis, markers=markers)
        return {column: self._reading(shown, column, parameters) for column in columns}

    def _reading(self, shown: Shown, column: str, parameters: Parameters) -> Array:
        kind = READINGS[kind_of(column)]
        values = kind.of(shown)
        if kind.by_cell:
            gain, zero = (of_all_tendons(parameters, name, values.shape[-1]) for name in ("tip_gain", "tip_zero"))
            values = gain * (values - parameters.get("pretension", 0.0)) + zero
        if kind.zero:
            if kind.per_tendon:
                values = values + of_all_tendons(parameters, kind.zero, values.shape[-1])
            else:
                values = values + parameters.get(kind.zero, 0.0)
        if marker := marker_column(column):
            return values[..., self.setting.marker_names.index(marker[1])]
        return values[..., tendon_number(column) - 1] if kind.per_tendon else values

    def predict(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> dict[str, Array]:
        """What the instruments read, each column in the rows in which it was read."""
        found = self.readings(self.shown(manipulator, parameters, nodes), self.columns, parameters)
        return found | {column: found[column][rows] for column, rows in self.read_in.items()}

    @property
    def along(self) -> np.ndarray:
        """(directions, ...), the changes of the base readings by which `evaluate` takes derivatives.

        One for each tendon, of all rows. With a history it is that of all steps but the turns, as what lies between two
        turns is forgotten; others follow for each turn, see `Course.along`.
        """
        if self.course is not None:
            return self.course.along
        return np.eye(self.actuation.shape[1])[:, None]

    def _shifted(self, shift: Array, along: np.ndarray | Array) -> "Bench":
        """With base readings that are larger by `shift` along each direction."""
        more = jnp.tensordot(shift, along, 1)
        if self.course is None:
            return replace(self, actuation=self.actuation + more, name=self.name)
        return replace(self, course=replace(self.course, readings=self.course.readings + more))

    def evaluate(
        self, manipulator: Manipulator, parameters: Parameters, nodes: int, *, by_base: bool = True
    ) -> Evaluation:
        """Every reading of every row with its derivatives, whether it was read or not.

        `by_base`: also by the base readings.
        """
        bare = self._bare(manipulator)
        along = bare.along if by_base else bare.along[:0]
        with stage(f"solving {len(self.actuation)} rows"):
            answer = _evaluate(bare, manipulator, jax.tree.map(np.asarray, parameters), along, nodes)
        return jax.tree.map(lambda x: np.asarray(x)[: len(self.actuation)], answer)

    def solved(self, manipulator: Manipulator, parameters: Parameters, nodes: int) -> Shown:
        """As `shown`, in a compiled program; without derivatives, of which a history has many."""
        bare = self._bare(manipulator)
        with stage(f"solving {len(self.actuation)} rows"):
            shown = evaluated(Bench.shown, bare, manipulator, jax.tree.map(np.asarray, parameters), nodes)
        return jax.tree.map(lambda x: x[: len(self.actuation)], shown)

    def _bare(self, manipulator: Manipulator) -> "Bench":
        """The same rows without names and columns, padded, so that tables share compiled programs."""
        rows = self.actuation.shape[0]
        fill = -rows % (FEW if self.one_by_one(manipulator) else LANES)

        def padded(arrays):
            return jax.tree.map(lambda x: np.pad(x, ((0, fill), *[(0, 0)] * (np.ndim(x) - 1)), mode="edge"), arrays)

        own = padded((self.actuation, self.direction, self.forces, self.trial))
        course = self.course
        if course is not None:
            trial, step = padded((course.trial, course.step))
            course = replace(course, trial=trial, step=step)
        return Bench(*own, course=course, setting=self.setting, tendons=self.tendons)


def _with_slack_ones(shown: Shown, tendons: Int[np.ndarray | Array, " set"], count: int) -> Shown:
    """The same with all tendons: those that hang slack have no tension and no displacement that is known."""

    def spread(values: Array, otherwise: float | bool) -> Array:
        return jnp.full_like(values, otherwise, shape=(*values.shape[:-1], count)).at[..., tendons].set(values)

    return shown._replace(
        tendon_displacement=spread(shown.tendon_displacement, jnp.nan),
        tip_tension=spread(shown.tip_tension, 0.0),
        direction_contradicted=spread(shown.direction_contradicted, False),
    )


def _true_tension(parameters: Parameters, readings: Array, of_tendons: Callable[[str], Array]) -> Array:
    """Base tensions, N, from what the cells read; tendons last."""
    gain, zero = map(of_tendons, ("base_gain", "base_zero"))
    return jnp.maximum((readings - zero) / gain + parameters.get("pretension", 0.0), 0.0)


@eqx.filter_jit
def _evaluate(
    bench: Bench, manipulator: Manipulator, parameters: dict[str, Array], along: np.ndarray | Array, nodes: int
) -> Evaluation:
    flat, unravel = jax.flatten_util.ravel_pytree((parameters, jnp.zeros(len(along))))

    every = columns_of(manipulator.num_tendons, bench.setting.marker_names, bench.components(manipulator))

    def observe(flat):
        parameters, shift = unravel(flat)
        shown = bench._shifted(shift, along).shown(manipulator, parameters, nodes)
        readings = bench.readings(shown, every, parameters)
        return readings, (readings, shown.status, shown.direction_contradicted)

    derivatives, (readings, status, against) = jax.jacfwd(observe, has_aux=True)(flat)
    by_parameter, by_base = (
        {column: slope[:, part] for column, slope in derivatives.items()}
        for part in (slice(flat.size - len(along)), slice(flat.size - len(along), None))
    )
    return Evaluation(readings, by_parameter, status, against, by_base)


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
        """The names of the tables, with a number where two have the same name."""
        return numbered([experiment.name for experiment in self.experiments])


class Group(NamedTuple):
    """One measured column of one table: a group of data with its own noise."""

    name: str  # of the table, as in `BenchModel.names`
    column: str
    table: Measurements
    experiment: Pulley | Bench

    @property
    def label(self) -> str:
        return f"{self.name}: {self.column}"

    @property
    def there(self) -> np.ndarray:
        """(rows,), whether the column was read in a row of the table."""
        return self.table.has(self.column)

    @property
    def observed(self) -> np.ndarray:
        """The readings, SI."""
        return self.table[self.column][self.there]


def groups_of(tables: Sequence[Measurements], model: BenchModel) -> list[Group]:
    """One for each observed column of each table."""
    return [
        Group(name, column, table, experiment)
        for name, table, experiment in zip(model.names, tables, model.experiments, strict=True)
        for column in experiment.columns
    ]


def benches_of(tables: Sequence[Measurements], model: BenchModel) -> list[tuple[str, Measurements, Bench]]:
    """The tables of the manipulator: name, table, and its rows as the model takes them."""
    named = zip(model.names, tables, model.experiments, strict=True)
    return [(name, table, one) for name, table, one in named if isinstance(one, Bench)]


def experiment_of(
    table: Measurements,
    manipulator: Manipulator,
    first_trial: int = 0,
    course: Course | None = None,
    setting: BenchSetting = PLAIN,
    *,
    free: Collection[str] = (),
) -> Pulley | Bench:
    """A table as the model takes it.

    Args:
        table: a pulley test or rows of the manipulator.
        manipulator: whose tendons the columns must fit.
        first_trial: the number of trials in the tables before.
        course: the paths of the rows, where they have a history.
        setting: what all rows share.
        free: the parameters that are fitted.

    Raises:
        InputError: for columns that are missing, too many, or observe nothing, and readings that the body cannot have.
    """
    if "pulling_tension" in table:
        there = table.has("pulling_tension")
        return Pulley(table["weight"][there], table["wrap_angle"][there], table.name)
    with within(table.name):
        columns = _observed(table, manipulator.num_tendons)
        if twice := [name for name in setting.markers if name in table.markers]:
            raise InputError(
                f"the table gives the position of the marker {twice[0]!r} already; leave it out of the setting"
            )
        found = markers_of(columns, {**setting.markers, **table.markers}, float(np.asarray(manipulator.length)))
        force_at, forces = forces_of(table.columns, len(table))
        check_on_body(force_at, float(np.asarray(manipulator.length)))
        forced = bool(np.any(forces))
        tendons = tuple(tendon_number(column) - 1 for column in set_by(table.columns))
        alike = manipulator.has_tendons_alike
        bench = Bench(
            table.actuation,
            tuple(map(table.columns.get, of_tendons("direction", manipulator.num_tendons))),
            forces if forced else None,
            first_trial + table.trial if "trial" in table else None,
            tuple(columns),
            table.name,
            {column: np.flatnonzero(table.has(column)) for column in columns if not np.all(table.has(column))},
            course,
            AllRows.of(setting, found, force_at.values() if forced else ()),
            None if len(tendons) == manipulator.num_tendons else np.array(tendons) if alike else tendons,
        )
        _check_body(table, bench, manipulator, zero_is_free="angle_zero" in free)
    return bench


def _check_body(table: Measurements, bench: Bench, manipulator: Manipulator, *, zero_is_free: bool) -> None:
    """Refuse a body without weight under gravity, and columns or loads that do not fit the plane or space."""
    check_loads(manipulator, bench.setting.loads)
    if bench.components(manipulator) == 3:
        with within("loads of three components", ValueError):
            manipulator.with_angles()
        if "tip_angle" in bench.columns:
            _check_tip_angles(table, bench, zero_is_free=zero_is_free)
        return
    for column in bench.columns:
        if READINGS[kind_of(column)].in_space:
            raise InputError(
                f"column {column!r}, but the body is in the plane; give its tendons an angle, or leave it out"
            )


def _check_tip_angles(table: Measurements, bench: Bench, *, zero_is_free: bool) -> None:
    """Refuse readings that no body in space can have: its tip angle lies between two axes, from 0 to 180 deg.

    Readings below 0 by no more than noise may stay. As the residual of a small angle they are not biased.
    """
    angle = np.asarray(table["tip_angle"]) - float(bench.setting.given.get("angle_zero", 0.0))
    noise, zero = min(ANGLE_NOISE, ANGLE_SHARE * np.nanmax(np.abs(angle))), 0.0
    if zero_is_free:  # the reading nearest to rest shows it
        zero = min(np.nan_to_num(angle[np.argmin(np.sum(np.abs(bench.actuation), axis=1))]), 0.0)
    bad = np.flatnonzero((angle > np.pi) | (angle < zero - noise))
    if bad.size:
        got, more = shown(table["tip_angle"][bad[0]], "angle"), f" (and {bad.size - 1} more)" if bad.size > 1 else ""
        remedy = (
            f"leave it out (leave_out, --leave-out), or {TAKE_THE_PLANE}"
            if angle[bad[0]] > 0
            else f"subtract the reading at rest, fit angle_zero, or {TAKE_THE_PLANE}"
        )
        raise InputError(
            f"{table.place(bad[0])}, column tip_angle: {got}{more}, but the tip angle of a body in space lies between "
            "the axes of base and tip, from 0 to 180 deg",
            remedy=remedy,
        )


def _observed(table: Measurements, num_tendons: int) -> list[str]:
    """The columns that a fit explains."""
    given = set_by(table.columns)
    lacking = sorted({*range(1, num_tendons + 1)} - {*map(tendon_number, given)})
    if lacking and (not given or any(kind_of_set(column) == "base_tension" for column in given)):
        column = of_tendons("base_tension", num_tendons)[lacking[0] - 1]
        remedy = f"add it, or {column.replace('base_tension', 'displacement')}"
        raise InputError(f"no column {column!r}; a manipulator of {num_tendons} tendons needs it; {remedy}")
    columns = [column for column in table.columns if kind_of(column) and is_reading(column, table.columns)]
    columns = [column for column in columns if np.any(table.has(column))]
    if not columns:
        raise InputError("nothing observed; add a column tip_tension [N], tip_angle [deg] or tip_x [mm]")
    for column in table.columns:
        numbered = column not in NAMED and column != "trial" and not marker_column(column)
        if numbered and tendon_number(column) > num_tendons:
            raise InputError(f"column {column!r}, but the manipulator has {num_tendons} tendon(s)")
    return columns
