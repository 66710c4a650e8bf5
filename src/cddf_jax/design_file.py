"""Design tasks in TOML files with units.

robot = "smooth_sil_940.toml"        # the start, beside this file
kinematics = "exact"                 # optional, instead of the robot's
worst = true                         # optional: the worst case counts, not the weighted mean
starts = 64                          # optional, 1 unless given
offsets_outside_wall = true          # optional, what the robot's file says unless given

[free]                               # by name, as in cddf sweep; bounds a tenth to ten times the start unless given
outer_radius = { knots = 9, bounds = ["8 mm", "25 mm"] }     # a spline through so many points
inner_radius = { taper = true, bounds = ["3 mm", "9 mm"] }   # a straight taper; else the robot's own form
"tendons.*.offset" = { bounds = ["6 mm", "12 mm"] }          # one value for all tendons
youngs_modulus = { choices = ["0.7 MPa", "1.4 MPa"] }        # one of a few

[[case]]                             # one or more ways to use the body
name = "bent"
base_tension = "tip_angle=90 deg"    # as in cddf solve; a list for several tendons
direction = 1
tip_force = "0 N, -1 N"
tip_moment = "0.1 N m"
gravity = "0, -9.81 m/s^2"
weight = 2.0
numbers = { youngs_modulus = "1.5 MPa" }                     # of the body, in this case

[uncertain]                          # optional: every case with what a fit of these data leaves uncertain
data = ["load_cells.csv"]
columns = { Tbase_N = "base_tension [N]" }                   # optional, as --column of cddf fit
num = 16

[[objective]]                        # one or more; each counts relative to its size at the start
least = "base_tension"               # or most = ..., even = ..., near = ... with value = ... (and at = [...])
weight = 1.0

[[limit]]
quantity = "wall_thickness"
least = "2 mm"                       # and, or, most = ...; or else equal = ...
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from .case import Case, unit_of_name
from .cross_sections import in_one_line
from .design_space import numbers_under
from .errors import InputError
from .limits import Limit
from .load_cases import LoadCase, uncertain_cases
from .manipulator import KINEMATICS, Manipulator
from .manipulator_file import allows_offsets_outside_wall, check_keys, columns_of, read_manipulator
from .objectives import Even, Least, Most, Near, Objective
from .profiles import Linear, Spline
from .quantities import QUANTITIES
from .solve_command import read_actuation, read_loads
from .statics import check_nodes
from .units import DIMENSION_OF, Dimension, quantity

_OPTIONAL = ("kinematics", "worst", "starts", "seed", "nodes", "offsets_outside_wall", "uncertain", "limit")
_AIMS: dict[str, type[Objective]] = {"least": Least, "most": Most, "even": Even, "near": Near}


@dataclass(frozen=True)
class DesignTask:
    """The arguments of `design`, as a file gives them."""

    path: Path
    manipulator: Manipulator
    objective: list[tuple[float, Objective]]
    free: tuple[str, ...]
    bounds: dict[str, tuple[float, float]]
    constraints: list[Limit]
    choices: dict[str, list[float]]
    cases: tuple[LoadCase, ...]
    worst: bool = False
    starts: int = 1
    seed: int = 0
    nodes: int = 16
    read_as: tuple[str, ...] = ()  # what was done to read the data
    offsets_outside_wall: bool = False

    @contextmanager
    def named(self) -> Iterator[None]:
        """Errors within begin with the name of the file."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def arguments(self) -> dict[str, Any]:
        """Those that `design` and `pareto_front` share, behind manipulator and objectives."""
        names = ("free", "bounds", "constraints", "cases", "worst", "nodes", "offsets_outside_wall")
        return {name: getattr(self, name) for name in names}


def read_task(path: Path) -> DesignTask:
    """The task in a TOML file; the module's text shows the format.

    Raises:
        InputError: names the file, the key, the value and the remedy.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f'{path}: is no TOML ({error}); quantities are quoted, as in least = "2 mm"') from None
    try:
        return _task(table, path)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def _task(table: Mapping[str, Any], path: Path) -> DesignTask:
    folder = path.parent
    check_keys("", table, ("robot", "free", "case", "objective"), _OPTIONAL)
    robot = folder / _text(table, "robot")
    body = read_manipulator(robot)
    if "kinematics" in table:
        if table["kinematics"] not in KINEMATICS:
            raise InputError(f"kinematics must be one of {KINEMATICS}, got {table['kinematics']!r}")
        body = replace(body, kinematics=table["kinematics"])
    cases = tuple(_case(f"case {i}", each, body) for i, each in enumerate(_list(table, "case"), 1))
    body, bounds, choices = _free(body, cases[0], _entries(table, "free"))
    columns = columns_of(robot)
    read_as: tuple[str, ...] = (in_one_line(columns),) if columns else ()
    if "uncertain" in table:
        cases, notes = _uncertain(cases, body, _entries(table, "uncertain"), folder)
        read_as += notes
    limits = _list(table, "limit") if "limit" in table else []
    options: dict[str, Any] = {"offsets_outside_wall": allows_offsets_outside_wall(robot)}
    options |= {key: table[key] for key in ("worst", "offsets_outside_wall") if key in table}
    for key, value in options.items():
        if not isinstance(value, bool):
            raise InputError(f"{key} must be true or false, got {value!r}")
    for key in ("starts", "seed", "nodes"):
        if key in table:
            options[key] = _whole(key, table[key])
    if "nodes" in table:
        check_nodes(table["nodes"])
    return DesignTask(
        path=path,
        manipulator=body,
        objective=[_objective(f"objective {i}", each) for i, each in enumerate(_list(table, "objective"), 1)],
        free=tuple(name for name in table["free"] if name not in choices),
        bounds=bounds,
        constraints=[_limit(f"limit {i}", each) for i, each in enumerate(limits, 1)],
        choices=choices,
        cases=cases,
        read_as=read_as,
        **options,
    )


# --- free numbers --------------------------------------------------------------------------------


def _free(
    body: Manipulator, used: LoadCase, table: Mapping[str, Any]
) -> tuple[Manipulator, dict[str, Any], dict[str, Any]]:
    """The body with its free profiles in the form that is wanted, bounds and choices."""
    bounds, choices = {}, {}
    for name, entry in table.items():
        where = f"free {name}"
        if not isinstance(entry, dict):
            raise InputError(f'{where}: write {{ bounds = ["8 mm", "25 mm"] }}, got {entry!r}')
        check_keys(f"{where}: ", entry, (), ("bounds", "choices", "knots", "taper"))
        numbers_under(Case(body, used.base_tension, used.loads, used.direction), name)
        dimension = DIMENSION_OF[unit_of_name(name)]
        if "knots" in entry or "taper" in entry:
            body = _formed(body, name, entry, where)
        if "bounds" in entry:
            low, high = _pair(where, entry["bounds"], dimension)
            bounds[name] = (low, high)
        if "choices" in entry:
            given = entry["choices"]
            if not isinstance(given, list) or not given or len(entry) > 1:
                raise InputError(f"{where}: choices must be a list of one value or more, and nothing beside it")
            choices[name] = [quantity(value, dimension, where) for value in given]
    return body, bounds, choices


def _formed(body: Manipulator, name: str, entry: Mapping[str, Any], where: str) -> Manipulator:
    """The body with a profile as a spline through so many points, or as a straight taper."""
    length = float(body.length)
    if ("knots" in entry) == ("taper" in entry) or entry.get("taper", True) is not True:
        raise InputError(f"{where}: write knots = 9 for a spline or taper = true for a straight taper")
    if "knots" in entry:
        knots = _whole(f"{where}: knots", entry["knots"])
        if knots < 4:
            raise InputError(f"{where}: knots must be 4 or more, got {knots}; or write taper = true")

        def formed(profile: Any) -> Any:
            return Spline.through(profile, np.linspace(0.0, length, knots))
    else:

        def formed(profile: Any) -> Any:
            base, tip = np.asarray(profile(np.array([0.0, length])))
            return Linear(base, tip, length)

    if name in ("outer_radius", "inner_radius"):
        return replace(body, **{name: formed(getattr(body, name))})
    which = name.removeprefix("tendons.").removesuffix(".offset")
    if name != f"tendons.{which}.offset" or which not in ("*", *map(str, range(body.num_tendons))):
        raise InputError(f"{where}: only outer_radius, inner_radius and tendons.0.offset have a form")
    tendons = [
        replace(tendon, offset=formed(tendon.offset)) if which in ("*", str(i)) else tendon
        for i, tendon in enumerate(body.tendons)
    ]
    return replace(body, tendons=tuple(tendons))


# --- cases, objectives, limits -------------------------------------------------------------------


def _case(where: str, table: Mapping[str, Any], body: Manipulator) -> LoadCase:
    optional = ("name", "direction", "tip_force", "tip_moment", "gravity", "weight", "numbers")
    check_keys(f"{where}: ", table, ("base_tension",), optional)
    texts = table["base_tension"] if isinstance(table["base_tension"], list) else [table["base_tension"]]
    try:
        actuation = read_actuation([str(text) for text in texts], body)
        force, moment, gravity = (table.get(key) for key in ("tip_force", "tip_moment", "gravity"))
        for key, value in (("tip_force", force), ("tip_moment", moment), ("gravity", gravity)):
            if value is not None and not isinstance(value, str):
                raise InputError(f'{key} must be text such as "0 N, -5 N", got {value!r}')
        loads = read_loads(force, moment, gravity, body.has_mass)
    except InputError as error:
        text = str(error)
        for option in ("base-tension", "tip-force", "tip-moment", "gravity"):
            text = text.replace(f"--{option}", option.replace("-", "_"))
        raise InputError(f"{where}: {text}") from None
    direction = table.get("direction")
    each = direction if isinstance(direction, list) else [] if direction is None else [direction]
    if any(isinstance(value, bool) or value not in (1, -1) for value in each):
        raise InputError(f"{where}: direction must be 1 for sliding in or -1 for sliding out, got {direction!r}")
    if isinstance(direction, list) and len(direction) != body.num_tendons:
        raise InputError(
            f"{where}: direction has {len(direction)} values for {body.num_tendons} tendons; give one each"
        )
    numbers = _case_numbers(where, table.get("numbers", {}), body)
    weight = quantity(table.get("weight", 1.0), "dimensionless", f"{where}: weight")
    if not weight > 0:
        raise InputError(f"{where}: weight must be above 0, got {weight:g}")
    name = str(table.get("name", where))
    return LoadCase(actuation, loads, direction, numbers, weight, name)


def _case_numbers(where: str, table: Any, body: Manipulator) -> dict[str, float]:
    if not isinstance(table, dict):
        raise InputError(f'{where}: numbers must be a table, as in numbers = {{ youngs_modulus = "1.5 MPa" }}')
    for name in table:
        Case(body, None, None, None).number(name)
    return {
        name: quantity(value, DIMENSION_OF[unit_of_name(name)], f"{where}: {name}") for name, value in table.items()
    }


def _uncertain(
    cases: Sequence[LoadCase], body: Manipulator, table: Mapping[str, Any], folder: Path
) -> tuple[tuple[LoadCase, ...], tuple[str, ...]]:
    """The cases with what a fit leaves uncertain, and what was done to read its data."""
    from .identification import fit
    from .trial_files import read_tables

    check_keys("uncertain: ", table, ("data",), ("columns", "num", "seed"))
    files = table["data"] if isinstance(table["data"], list) else [table["data"]]
    columns = {name: str(meant) for name, meant in _entries(table, "columns").items()} if "columns" in table else {}
    tables = read_tables([folder / str(file) for file in files], columns)
    found = fit(body, tables)
    num, seed = (_whole(f"uncertain: {key}", table.get(key, default)) for key, default in (("num", 16), ("seed", 0)))
    every = tuple(each for case in cases for each in uncertain_cases(case, found, num, seed))
    return every, tuple(line for table in tables for line in table.read_as)


def _objective(where: str, table: Mapping[str, Any]) -> tuple[float, Objective]:
    check_keys(f"{where}: ", table, (), (*_AIMS, "weight", "value", "at"))
    kinds = [kind for kind in _AIMS if kind in table]
    if len(kinds) != 1:
        raise InputError(f'{where}: write one of {", ".join(_AIMS)}, as in least = "base_tension"')
    kind, name = kinds[0], table[kinds[0]]
    dimension = _quantity_dimension(where, name)
    weight = quantity(table.get("weight", 1.0), "dimensionless", f"{where}: weight")
    if kind != "near":
        if "value" in table or "at" in table:
            raise InputError(f"{where}: value and at belong to near; take them out")
        return weight, _AIMS[kind](name)
    if "value" not in table:
        raise InputError(f'{where}: near needs a value, as in value = ["110 mm", "50 mm"]')
    at = table.get("at")
    places = None if at is None else np.array([quantity(x, "length", f"{where}: at") for x in at])
    return weight, Near(name, _nested(table["value"], dimension, f"{where}: value"), places)


def _limit(where: str, table: Mapping[str, Any]) -> Limit:
    check_keys(f"{where}: ", table, ("quantity",), ("least", "most", "equal"))
    dimension = _quantity_dimension(where, table["quantity"])
    sides = {
        side: _nested(table[side], dimension, f"{where}: {side}")
        for side in ("least", "most", "equal")
        if side in table
    }
    try:
        return Limit(table["quantity"], **sides)
    except InputError as error:
        raise InputError(f"{where}: {str(error).removeprefix('design: ')}") from None


def _quantity_dimension(where: str, name: Any) -> Dimension:
    if not isinstance(name, str) or name not in QUANTITIES:
        close = get_close_matches(str(name), QUANTITIES, 1)
        remedy = f"did you mean {close[0]}?" if close else f"there are {', '.join(QUANTITIES)}"
        raise InputError(f"{where}: {name!r} is no quantity of a body; {remedy}")
    return QUANTITIES[name].dimension


# --- small things --------------------------------------------------------------------------------


def _nested(value: Any, dimension: Dimension, where: str) -> Any:
    """A quantity, or lists of them."""
    if isinstance(value, list):
        items = [_nested(item, dimension, where) for item in value]
        if len({np.shape(item) for item in items}) > 1:
            raise InputError(f"{where}: its rows are of different length, got {value!r}")
        return np.array(items)
    return quantity(value, dimension, where)


def _pair(where: str, value: Any, dimension: Dimension) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f'{where}: bounds must be two values, as in bounds = ["8 mm", "25 mm"], got {value!r}')
    low, high = (quantity(item, dimension, f"{where}: bounds") for item in value)
    return low, high


def _text(table: Mapping[str, Any], key: str) -> str:
    if not isinstance(table[key], str):
        raise InputError(f"{key} must be text, got {table[key]!r}")
    return table[key]


def _whole(where: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{where} must be a whole number, got {value!r}")
    return value


def _entries(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    if not isinstance(table[key], dict) or not table[key]:
        raise InputError(f"[{key}] must be a table of one entry or more; see cddf design --help")
    return table[key]


def _list(table: Mapping[str, Any], key: str) -> list[Any]:
    if not isinstance(table[key], list) or not table[key] or not all(isinstance(each, dict) for each in table[key]):
        raise InputError(f"{key} must be one table or more; write each below a line [[{key}]]")
    return table[key]
