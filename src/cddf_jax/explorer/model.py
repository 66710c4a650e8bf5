"""What the explorer shows: a body with the numbers of the sliders, solved by a program that is compiled once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from ..errors import InputError, within
from ..figures.geometry import lines_along, stations
from ..files.manipulator_file import manipulator_text
from ..identification.bench import Bench, experiment_of
from ..identification.course import course_of, how_followed, is_driven_by_length, paths_of
from ..identification.parameters import BenchSetting
from ..measurements.readings import set_by
from ..measurements.table import Measurements
from ..mechanics.directions import as_directions
from ..mechanics.fields import AnyFields
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.reshape import tapered
from ..robot.validation import check_loads
from ..statics.equilibrium import Equilibrium, ended_as
from ..statics.equilibrium_text import result_in_words, wall_remarks
from ..statics.named_numbers import Case, of_tendon
from ..statics.solve import solve
from ..statics.status import Status
from .controls import FITTED, RADII, Control, controls_of, in_si, loads_by_name

if TYPE_CHECKING:
    from ..identification.fit import Fit

NUM_PULLS = 17  # on the curve over the base tension
NODES = 16  # of the solves in the rows of tables, as `fit` has them
GOOD = (Status.successful, Status.direction_contradicted)


class Settings(NamedTuple):
    """The positions of the controls: numbers in shown units by name of the control, and directions."""

    numbers: Mapping[str, float]
    direction: tuple[int | None, ...]  # None where it is found from the travel of the tendon


class Picture(NamedTuple):
    """An equilibrium and its fields along a grid of arc lengths; NumPy, SI."""

    case: Case
    equilibrium: Equilibrium
    along: AnyFields
    peak_strain: np.ndarray  # of the wall, a fraction

    @property
    def good(self) -> bool:
        """Whether there is something to show; other solves have no numbers, or doubtful ones."""
        return ended_as(self.equilibrium, *GOOD)

    @property
    def message(self) -> str:
        """The message of the result, as `solve` gives it, and remarks; empty if it is successful."""
        return " ".join([text for text in (result_in_words(self.equilibrium), *wall_remarks(self.equilibrium)) if text])

    @property
    def peak_curvature(self) -> float:
        """The largest |kappa|, 1/m; in space of bending alone, without twist."""
        return float(np.max(lines_along(self.case.manipulator, self.along, "bending")))


class Curve(NamedTuple):
    """The answer over the base tension of one tendon, with everything else as set; NaN where no solve is good. SI."""

    tendon: int  # from 0
    base_tension: np.ndarray
    tip_tension: np.ndarray
    tip_angle: np.ndarray
    tendon_displacement: np.ndarray


@dataclass(frozen=True)
class Exploration:
    """A manipulator, the tables measured on it, and the results for the settings of the controls.

    `gravity` is that of the robot's file, m/s^2. The tables were measured under it. `offsets_outside_wall` says whether
    tendons may run in the bore or outside the body, as in the file.

    Raises:
        InputError: for a table that does not fit the manipulator, or a gravity that does not.
    """

    manipulator: Manipulator
    tables: tuple[Measurements, ...] = ()
    gravity: tuple[float, ...] | None = None
    offsets_outside_wall: bool = False

    def __post_init__(self):
        with within("gravity of the robot file"):
            check_loads(self.manipulator, self.setting.loads)
            if len(self.gravity or ()) > self.manipulator.components:
                raise InputError(
                    "it has three components, but the body is in the plane; give two, or angles of tendons"
                )
        for table in self.tables:
            experiment_of(table, self.manipulator, setting=self.setting)

    @cached_property
    def setting(self) -> BenchSetting:
        """What all rows of the tables share."""
        return BenchSetting(Loads(gravity=self.gravity) if any(self.gravity or ()) else None)

    # --- settings --------------------------------------------------------------------------------

    @cached_property
    def controls(self) -> tuple[Control, ...]:
        """Everything that can be changed, with ranges about the numbers of the manipulator."""
        return controls_of(self.manipulator, self.tables, self.arc_length, self.gravity or ())

    @property
    def start(self) -> Settings:
        """The manipulator as it is, tendon 1 pulled."""
        numbers = {control.name: control.value for control in self.controls}
        count = self.manipulator.num_tendons
        return Settings(numbers, (1,) if count == 1 else (None,) * count)

    def case(self, settings: Settings) -> Case:
        """The case to solve for the settings. Its structure is the same for all numbers, unless loads begin or end.

        Raises:
            InputError: for a body that cannot be, such as one with a tendon outside its wall.
        """
        number = {c.name: in_si(settings.numbers[c.name], c.quantity) for c in self.controls}
        body = replace(self.manipulator, **{name: number[name] for name in FITTED if name in number})
        if body.outer_radius is not None and RADII[0] in number:
            base, tip = (number[name] for name in RADII)
            wall = tapered(body.outer_radius, base, tip, body.length)
            body = replace(body, outer_radius=wall).validate(offsets_outside_wall=self.offsets_outside_wall)
        pulls = np.array([number[of_tendon("base_tension", i)] for i in range(body.num_tendons)])
        return Case(body, pulls, loads_by_name(body, number), as_directions(settings.direction))

    # --- answers ---------------------------------------------------------------------------------

    @cached_property
    def arc_length(self) -> np.ndarray:
        """The arc lengths of pictures, m."""
        return stations(self.manipulator)

    def picture(self, case: Case) -> Picture:
        """The equilibrium of a case; look at `good` before it is shown."""
        return Picture(case, *jax.tree.map(np.asarray, _solved(case, self.arc_length)))

    def curve(self, case: Case, tendon: int = 0) -> Curve:
        """Tip tension and tip angle over the whole range of the tension of a tendon, which counts from 0."""
        pulls = np.linspace(0.0, self.controls[tendon].high, NUM_PULLS)
        return Curve(tendon, pulls, *map(np.asarray, _over_tension(case, np.asarray(tendon), pulls)))

    def in_rows(self, body: Manipulator) -> list[tuple[Measurements, dict[str, np.ndarray]]]:
        """Tables for which no single curve holds, and by column the readings of a body in their rows.

        They have several tendons, forces, tendons that slide out, loops in a known order, or displacements. A reading
        is NaN without a good solve.
        """
        found, how = [], how_followed(body, (), self.setting.loads)
        for table in self.tables:
            paths = paths_of(table, None)
            course = course_of(table, paths=paths, **how)[0] if paths else None
            rows = experiment_of(table, body, course=course, setting=self.setting)
            if isinstance(rows, Bench) and not rows.on_one_curve:
                found.append((table, jax.tree.map(np.asarray, _in_rows(rows, body))))
        return found

    @property
    def over(self) -> str:
        """What readings of the tip are drawn over: displacements if these alone set tendons, else base tensions."""
        pulled = [is_driven_by_length(table) for table in self.tables if set_by(table.columns)]
        return "displacement" if pulled and all(pulled) else "base_tension"

    @property
    def notes(self) -> list[str]:
        """Notes on the tables."""
        read_as = [line for table in self.tables for line in table.read_as]
        beside = "driven by displacement, and the tip is drawn over base tensions; explore it alone to see it"
        driven = self.tables if self.over == "base_tension" else ()
        return read_as + [f"{table.name}: {beside}" for table in driven if is_driven_by_length(table)]

    def fit(self) -> "Fit":
        """Friction and modulus from the tables, with the manipulator of the file, on which they were measured.

        Raises:
            InputError: without a table, and as `identification.fit`.
        """
        if not self.tables:
            raise InputError("there is nothing to fit; give a table of measurements")
        from ..identification.fit import fit

        own = [control.name for control in self.controls if control.name in FITTED]
        return fit(self.manipulator, self.tables, own, setting=self.setting)

    def toml(self, case: Case) -> str:
        """The body of a case as a file, with the gravity that acts on it."""
        gravity = () if case.loads is None else np.asarray(case.loads.gravity).tolist()
        given = gravity if any(gravity) else None
        return manipulator_text(case.manipulator, offsets_outside_wall=self.offsets_outside_wall, gravity=given)


# --- compiled once for each structure of a case ---------------------------------------------------


@eqx.filter_jit
def _solved(case: Case, arc_length: Float[ArrayLike, " points"]) -> tuple[Equilibrium, AnyFields, Array]:
    equilibrium = _solve(case)
    peak_strain = equilibrium.peak_strain if equilibrium.has_wall else jnp.full((), jnp.nan)
    return equilibrium, equilibrium.at(arc_length), peak_strain


def _solve(case: Case) -> Equilibrium:
    return solve(case.manipulator, case.base_tension, case.loads, direction=case.direction, throw=False)


@eqx.filter_jit
def _over_tension(case: Case, tendon: Int[ArrayLike, ""], pulls: Float[ArrayLike, " pulls"]) -> tuple[Array, ...]:
    def at(pull):
        pulled = eqx.tree_at(lambda c: c.base_tension, case, jnp.asarray(case.base_tension).at[tendon].set(pull))
        equilibrium = _solve(pulled)
        own = equilibrium.tip_tension, equilibrium.tendon_displacement
        tip, pulled_in = (each[jnp.asarray(tendon)] for each in own)
        return where_good(equilibrium.status, (tip, equilibrium.tip_angle, pulled_in))

    return jax.vmap(at)(pulls)


@eqx.filter_jit
def _in_rows(rows: Bench, body: Manipulator) -> dict[str, Array]:
    shown = rows.shown(body, {}, NODES)
    readings = rows.readings(shown, rows.columns, {})
    return dict(zip(readings, where_good(shown.status, tuple(readings.values()), (*GOOD, Status.slack)), strict=True))


def where_good(status: Int[Array, "*lanes"], numbers: tuple, good_ones: Sequence[Status] = GOOD) -> tuple:
    """The numbers of a solve; NaN without a good status."""
    good = jnp.isin(status, jnp.array(good_ones))
    return tuple(jnp.where(good, number, jnp.nan) for number in numbers)
