"""Design tasks in TOML files with units; `template.toml` holds every key."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import numpy as np

from ..errors import InputError, within
from ..files.actuation import read_actuation, read_directions, read_loads
from ..files.cross_sections import in_one_line
from ..files.manipulator_file import check_keys, read_robot_file, read_toml
from ..robot.loads import gravity_in_words
from ..robot.manipulator import Manipulator
from ..robot.profiles import Linear, Profile, Spline
from ..units import Dimension, quantity
from .body_quantities import BODY_QUANTITIES, quantity_named
from .design import design
from .free_numbers import dimension_in, numbers_under
from .load_cases import LoadCase, case_numbers, uncertain_cases
from .objectives import Even, Least, Limit, Most, Near, Objective
from .pareto import ParetoFront, pareto_front
from .results import Design

Table = Mapping[str, object]
Item = TypeVar("Item")

TEMPLATE = Path(__file__).with_name("template.toml").read_text(encoding="utf-8")
_AIMS: dict[str, type[Objective]] = {"least": Least, "most": Most, "even": Even, "near": Near}
_OPTIONS = ("starts", "nodes", "worst", "offsets_outside_wall")  # of `design`
_OF_A_CASE = ("name", "direction", "tip_force", "tip_moment", "point_loads", "gravity", "weight", "numbers")
# the keys that each table must have, and those that it may have; "" stands for the keys above the first table
KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "": (("robot", "free", "case", "objective"), ("kinematics", *_OPTIONS, "uncertain", "limit")),
    "free": ((), ("bounds", "taper", "knots")),
    "case": (("base_tension",), _OF_A_CASE),
    "uncertain": (("data",), ("columns", "num")),
    "objective": ((), (*_AIMS, "value", "at", "weight")),
    "limit": (("quantity",), ("least", "most", "equal")),
}


def template() -> str:
    """A task with every key, followed by the quantities that an objective or a limit can name."""
    names = "Quantities of an objective or a limit: " + ", ".join(BODY_QUANTITIES) + "."
    return f"{TEMPLATE}\n{textwrap.fill(names, 110, initial_indent='# ', subsequent_indent='# ')}\n"


class DesignTask(NamedTuple):
    """What a file asks for."""

    path: Path
    arguments: dict[str, Any]  # of `design`
    read_as: tuple[str, ...]  # how robot and data were read
    gravity: tuple[float, ...] | None  # of the robot's file, m/s^2

    def design(self) -> Design:
        """As `design`; errors name the file."""
        with within(self.path):
            return design(**self.arguments)

    def pareto_front(self, num: int) -> ParetoFront:
        """As `pareto_front`, of the two objectives of the task; errors name the file."""
        aims = self.arguments["objective"]
        given = {name: value for name, value in self.arguments.items() if name != "objective"}
        with within(self.path):
            if "starts" in given or any(weight != 1 for weight, _ in aims):
                raise InputError("starts and weights have no place in a trade-off; take them out of the task")
            return pareto_front(objectives=[aim for _, aim in aims], num=num, **given)


def read_task(path: Path) -> DesignTask:
    """The task in a TOML file; `template` shows the keys."""
    with within(path, ValueError):
        return _task(read_toml(path, 'least = "2 mm"'), path)


def _task(table: Table, path: Path) -> DesignTask:
    check_keys(table, *KEYS[""])
    body, columns, outside, gravity = read_robot_file(path.parent / _text(table, "robot"))
    if "kinematics" in table:
        body = replace(body, kinematics=table["kinematics"])
    read = _each(table, "case", lambda case: _case(case, body, gravity))
    cases = tuple(replace(case, name=case.name or f"case {i}") for i, case in enumerate(read, 1))
    free = _entries(table, "free")
    measured, (body, bounds) = body, _free(body, cases[0], free)
    read_as: tuple[str, ...] = (in_one_line(columns),) if columns else ()
    if gravity is not None:
        read_as += (f"{gravity_in_words(gravity)}, of the robot file, in every case without a gravity of its own",)
    if "uncertain" in table:
        cases, notes = _uncertain(cases, measured, _entries(table, "uncertain"), path.parent, gravity)
        read_as += notes
    arguments = {
        "manipulator": body,
        "objective": _each(table, "objective", _objective),
        "free": tuple(free),
        "bounds": bounds,
        "constraints": _each(table, "limit", _limit) if "limit" in table else [],
        "cases": cases,
        "offsets_outside_wall": outside,
    }
    arguments |= {key: table[key] for key in _OPTIONS if key in table}
    return DesignTask(path, arguments, read_as, gravity)


# --- free numbers --------------------------------------------------------------------------------


def _free(body: Manipulator, used: LoadCase, table: Table) -> tuple[Manipulator, dict[str, float | np.ndarray]]:
    """The body with its free profiles as splines or tapers where the task says so, and bounds."""
    bounds = {}
    for name, entry in table.items():
        with within(f"free {name}"):
            if not isinstance(entry, dict):
                raise InputError(f'write {{ bounds = ["8 mm", "25 mm"] }}, got {entry!r}')
            check_keys(entry, *KEYS["free"])
            dimension = dimension_in(used.of(body), numbers_under(used.of(body), name)[0][0])
            if "knots" in entry or "taper" in entry:
                body = _formed(body, name, entry)
            if "bounds" in entry:
                bounds[name] = _nested(entry["bounds"], dimension, "bounds")
    return body, bounds


def _formed(body: Manipulator, name: str, entry: Table) -> Manipulator:
    """The body with a profile as a spline through some points, or as a straight taper."""
    if ("knots" in entry) == ("taper" in entry) or entry.get("taper", True) is not True:
        raise InputError("write knots = 9 for a spline or taper = true for a straight taper")
    length, knots = float(body.length), entry.get("knots", 4)
    if not isinstance(knots, int) or knots < 4:
        raise InputError(f"knots must be a whole number of 4 or more, got {knots!r}; or write taper = true")
    names = [name.replace("*", str(i)) for i in range(body.num_tendons if "*" in name else 1)]
    if not all(own.endswith(("radius", "offset", "angle")) and own in body.profiles for own in names):
        raise InputError("only outer_radius, inner_radius, tendons.0.offset and tendons.0.angle have a form")

    def form(profile: Profile) -> Profile:
        if "taper" in entry:
            return Linear(np.asarray(profile(0.0)), np.asarray(profile(length)), length)
        return Spline.through(profile, np.linspace(0.0, length, knots))

    return eqx.tree_at(lambda body: [body.profiles[own] for own in names], body, replace_fn=form)


# --- cases, objectives, limits -------------------------------------------------------------------


def _case(table: Table, body: Manipulator, gravity: tuple[float, ...] | None) -> LoadCase:
    """A case; `gravity` is that of the robot's file, m/s^2."""
    direction = table.get("direction")
    loads = {key: _text(table, key) if key in table else None for key in ("tip_force", "tip_moment", "gravity")}
    numbers = _entries(table, "numbers") if "numbers" in table else {}
    return LoadCase(
        read_actuation(_texts(table, "base_tension"), body),
        read_loads(**loads, points=_texts(table, "point_loads"), mounted=gravity),
        read_directions(direction if isinstance(direction, list | None) else [direction], body),
        {name: quantity(value, dimension_in(case_numbers(body), name), name) for name, value in numbers.items()},
        quantity(table.get("weight", 1.0), "dimensionless", "weight"),
        str(table.get("name", "")),
    )


def _uncertain(
    cases: Sequence[LoadCase], body: Manipulator, table: Table, folder: Path, gravity: tuple[float, ...] | None
) -> tuple[tuple[LoadCase, ...], tuple[str, ...]]:
    """The cases with bodies drawn from the uncertainty of a fit under this gravity, and how its data were read."""
    from ..identification.fit import fit
    from ..identification.parameters import BenchSetting
    from ..measurements.trials import read_tables

    with within("uncertain"):
        check_keys(table, *KEYS["uncertain"])
        drawn: dict[str, Any] = {"num": table["num"]} if "num" in table else {}
        columns = {name: str(meant) for name, meant in _entries(table, "columns").items()} if "columns" in table else {}
    tables = read_tables([folder / file for file in _texts(table, "data")], columns)
    found = fit(body, tables, setting=BenchSetting(read_loads(None, None, None, mounted=gravity)))
    every = tuple(each for case in cases for each in uncertain_cases(case, found, **drawn))
    return every, tuple(line for table in tables for line in table.read_as)


def _objective(table: Table) -> tuple[float, Objective]:
    kinds = [kind for kind in _AIMS if kind in table]
    if len(kinds) != 1:
        raise InputError(f'write one of {", ".join(_AIMS)}, as in least = "base_tension"')
    kind = kinds[0]
    name = _text(table, kind)
    weight = quantity(table.get("weight", 1.0), "dimensionless", "weight")
    if kind != "near":
        if "value" in table or "at" in table:
            raise InputError("value and at belong to near; take them out")
        return weight, _AIMS[kind](name)
    if "value" not in table:
        raise InputError('near needs a value, as in value = ["110 mm", "50 mm"]')
    places = _nested(table["at"], "length", "at") if "at" in table else None
    return weight, Near(name, _nested(table["value"], quantity_named(name).dimension, "value"), places)


def _limit(table: Table) -> Limit:
    name = _text(table, "quantity")
    dimension = quantity_named(name).dimension
    sides = [side for side in ("least", "most", "equal") if side in table]
    return Limit(name, **{side: _nested(table[side], dimension, side) for side in sides})


# --- small things --------------------------------------------------------------------------------


def _nested(value: object, dimension: Dimension, what: str) -> float | np.ndarray:
    """A quantity, or lists of them."""
    if not isinstance(value, list):
        return quantity(value, dimension, what)
    items = [_nested(item, dimension, what) for item in value]
    if len({np.shape(item) for item in items}) > 1:
        raise InputError(f"{what}: its rows are of different length, got {value!r}")
    return np.array(items)


def _texts(table: Table, key: str) -> list[str]:
    """One text or a list of them; none where the key is missing."""
    given = table.get(key, [])
    return [str(text) for text in given] if isinstance(given, list) else [str(given)]


def _text(table: Table, key: str) -> str:
    value = table[key]
    if not isinstance(value, str):
        raise InputError(f"{key} must be text, got {value!r}")
    return value


def _entries(table: Table, key: str) -> Table:
    value = table[key]
    if not isinstance(value, dict) or not value:
        raise InputError(f"{key} must be a table of one entry or more; see cddf design --template")
    return value


def _each(table: Table, key: str, read: Callable[[Table], Item]) -> list[Item]:
    """The items read from all tables of a kind; errors name the table, such as "case 1"."""
    value = table[key]
    if not isinstance(value, list) or not value or not all(isinstance(each, dict) for each in value):
        raise InputError(f"{key} must be one table or more; write each below a line [[{key}]]")
    found = []
    for i, each in enumerate(value, 1):
        with within(f"{key} {i}"):
            check_keys(each, *KEYS[key])
            found.append(read(each))
    return found
