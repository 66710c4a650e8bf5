"""`fit`: friction and modulus from measurements, and what the measurements do not hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .determination import FIXED, IDENTIFIED, NOT_IDENTIFIED, Determination
from .equilibrium import NOTEWORTHY, RESULTS, Equilibrium
from .errors import InputError
from .least_squares import LeastSquaresFit, least_squares_fit
from .manipulator import Manipulator
from .measurements import Measurements
from .pulley import pulling_tension
from .statics import solve

PARAMETERS = ("friction_coefficient", "youngs_modulus", "length")
POSE = ("tip_angle", "tip_x", "tip_y")
POSITIVE = (0.0, None)
# what to multiply SI by, and the unit that then holds
SHOWN = {"youngs_modulus": (1e-6, " MPa"), "length": (1e3, " mm")}


class Prediction(NamedTuple):
    """The fitted model at some base tensions."""

    value: np.ndarray
    half_width: np.ndarray  # of the 95 % band that the uncertainty of the parameters makes
    extrapolated: np.ndarray  # True beyond the base tensions of the data


@dataclass(frozen=True, kw_only=True)
class Fit(LeastSquaresFit):
    """Friction and modulus as the measurements tell them, SI units; parameters that were not free are "fixed"."""

    manipulator: Manipulator  # with the estimates; where a parameter is not identified, one of many that fit
    tables: tuple[Measurements, ...]
    alone: dict[str, Determination]  # what each table by itself, without priors, would have told
    nodes: int
    warnings: tuple[str, ...]

    @property
    def verdict(self) -> tuple[str, ...]:
        """In words: what was determined, what was not, and what measurement would help."""
        return tuple(_verdict(self))

    def predict(self, column: str, base_tension: Any) -> Prediction:
        """An observable with its 95 % band over base tension, every tendon pulled alike.

        Args:
            column: "tip_tension", "tip_angle", "tip_x", ...
            base_tension: N, one-dimensional.
        """
        tension = np.atleast_1d(np.asarray(base_tension, dtype=np.float64))
        count = self.manipulator.num_tendons
        pulled = _Bench(np.repeat(tension[:, None], count, axis=1), np.ones((tension.size, count)))
        value, slope, _ = pulled.evaluate(self.manipulator, self.parameters, self.nodes)
        levels = [table["base_tension"] for table in self.tables if "base_tension" in table] or [tension]
        low, high = np.min(np.concatenate(levels)), np.max(np.concatenate(levels))
        outside = (tension < low * (1 - 1e-9)) | (tension > high * (1 + 1e-9))
        return Prediction(value[column], self.band(slope[column]), outside)


def fit(
    manipulator: Manipulator,
    data: Measurements | Sequence[Measurements],
    free: Sequence[str] = ("friction_coefficient", "youngs_modulus"),
    priors: Mapping[str, tuple[float, float]] | None = None,
    *,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    noise: Mapping[str, float] | None = None,
    nodes: int = 16,
) -> Fit:
    """Fit parameters of a manipulator to one or several tables at once.

    A table with `weight`, `pulling_tension` and `wrap_angle` is a pulley test and speaks of friction alone.
    Any other has `base_tension` (and `base_tension_2`, ... for further tendons) and one or more of
    `tip_tension`, `tip_tension_2`, ..., `tip_angle`, `tip_x`, `tip_y`; `direction` is optional.

    Args:
        manipulator: the body; its numbers are the start.
        data: a table or several.
        free: what is fitted, of `PARAMETERS`; all are taken as positive.
        priors: by parameter, mean and standard deviation of a Gaussian, SI units.
        bounds: by parameter, (lower, upper), SI units; default (0, None).
        noise: by column, known standard deviation, SI units; what is not given is estimated, for each column
            of each table, from the residuals.
        nodes: as in `solve`.

    Raises:
        InputError: for float32, unknown parameters or columns, tables that do not fit the manipulator.
    """
    tables = (data,) if isinstance(data, Measurements) else tuple(data)
    free = (free,) if isinstance(free, str) else tuple(free)
    if not all(isinstance(table, Measurements) for table in tables):
        raise InputError("fit: data must be tables as read_measurements gives them, one or several")
    own = [tendon.friction_coefficient is not None for tendon in manipulator.tendons]
    if "friction_coefficient" in free and all(own):
        raise InputError("fit: every tendon has its own friction coefficient; leave theirs out to fit a common one")
    for name in free:
        if name not in PARAMETERS:
            raise InputError(f"fit: {name!r} is no parameter that can be fitted; there are {', '.join(PARAMETERS)}")
    if not tables or not free:
        raise InputError("fit: needs a table of measurements and a free parameter")
    model = _Model(manipulator, tuple(_experiment(table, manipulator) for table in tables), nodes)
    observed = {group.label: group.observed for group in _groups(tables, model)}
    sigma = {group.label: (noise or {}).get(group.column) for group in _groups(tables, model)}
    columns = {group.column for group in _groups(tables, model)}
    for column in set(noise or {}) - columns:
        raise InputError(
            f"fit: noise is given for {column!r}, which no table holds; they hold {', '.join(sorted(columns))}"
        )
    statistics = least_squares_fit(
        model,
        {name: float(getattr(manipulator, name)) for name in free},
        observed,
        sigma,
        dict.fromkeys(free, POSITIVE) | dict(bounds or {}),
        priors=priors,
    )
    return _conclude(manipulator, statistics, tables, model)


# --- the model of a bench ------------------------------------------------------------------------


class _Pulley(eqx.Module):
    weight: Float[np.ndarray | Array, " rows"]
    wrap_angle: Float[np.ndarray | Array, " rows"]
    name: str = eqx.field(static=True)
    columns: tuple[str, ...] = eqx.field(default=("pulling_tension",), static=True)

    def predict(self, manipulator: Manipulator, nodes: int) -> dict[str, Array]:
        return {"pulling_tension": pulling_tension(self.weight, manipulator.friction_coefficient, self.wrap_angle)}


class _Bench(eqx.Module):
    """Rows of one table of a manipulator, or of levels to predict at."""

    base_tension: Float[np.ndarray | Array, "rows tendons"]
    direction: Float[np.ndarray | Array, "rows tendons"]
    columns: tuple[str, ...] = eqx.field(default=(), static=True)
    name: str = eqx.field(default="", static=True)

    def solve(self, manipulator: Manipulator, nodes: int) -> Equilibrium:
        def one(tension, direction):
            return solve(manipulator, tension, direction=direction, nodes=nodes, throw=False)

        return jax.vmap(one)(jnp.asarray(self.base_tension), jnp.asarray(self.direction))

    def predict(self, manipulator: Manipulator, nodes: int) -> dict[str, Array]:
        equilibrium = self.solve(manipulator, nodes)
        return {column: _observable(equilibrium, column) for column in self.columns}

    def evaluate(self, manipulator: Manipulator, free: Any, nodes: int) -> tuple[Any, Any, RESULTS]:
        """Every observable, its derivatives by the free parameters (last axis), and how the solves went."""
        rows = self.base_tension.shape[0]
        fill = -rows % 128  # few sizes, so that tables and curves share what is compiled
        tension, direction = (np.pad(x, ((0, fill), (0, 0)), mode="edge") for x in (self.base_tension, self.direction))
        answer = _evaluate(_Bench(tension, direction), manipulator, jax.tree.map(jnp.asarray, free), nodes)
        return jax.device_get(jax.tree.map(lambda x: x[:rows], answer))


@eqx.filter_jit
def _evaluate(bench: _Bench, manipulator: Manipulator, free: dict[str, Any], nodes: int):
    def observe(free):
        equilibrium = bench.solve(with_parameters(manipulator, free), nodes)
        tendons = range(2, manipulator.num_tendons + 1)
        columns = ("tip_tension", *(f"tip_tension_{i}" for i in tendons), "tip_angle", "tip_x", "tip_y")
        return {column: _observable(equilibrium, column) for column in columns}, equilibrium.result

    def push(*directions):
        return jax.jvp(observe, (free,), (dict(zip(free, directions, strict=True)),), has_aux=True)

    value, slope, result = jax.vmap(push, out_axes=(None, -1, None))(*jnp.eye(len(free)))
    return value, slope, result


def _observable(equilibrium: Equilibrium, column: str) -> Array:
    if column.startswith("tip_tension"):
        return equilibrium.tip_tension[:, _tendon_number(column) - 1]
    if column == "tip_angle":
        return equilibrium.tip_angle
    return equilibrium.tip_position[:, ("tip_x", "tip_y").index(column)]


def _tendon_number(column: str) -> int:
    """1 for `tip_tension`, 2 for `tip_tension_2`, ..."""
    digits = column.rpartition("_")[2]
    return int(digits) if digits.isdigit() else 1


class _Model(eqx.Module):
    """Every table's predictions from the free parameters."""

    manipulator: Manipulator
    experiments: tuple[_Pulley | _Bench, ...]
    nodes: int = eqx.field(static=True)

    def __call__(self, parameters: dict[str, Array]) -> dict[str, Array]:
        body = with_parameters(self.manipulator, parameters)
        predictions = {}
        for experiment, name in zip(self.experiments, self.names, strict=True):
            for column, values in experiment.predict(body, self.nodes).items():
                predictions[f"{name}: {column}"] = values
        return predictions

    @property
    def names(self) -> list[str]:
        """Of the tables, told apart where two are called the same."""
        names = [experiment.name for experiment in self.experiments]
        return [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]


def with_parameters(manipulator: Manipulator, parameters: Mapping[str, Any]) -> Manipulator:
    """The manipulator with some of its numbers replaced."""
    names = tuple(parameters)

    def where(body):
        return [getattr(body, name) for name in names]

    return eqx.tree_at(where, manipulator, [parameters[name] for name in names])


class _Group(NamedTuple):
    label: str
    column: str
    observed: np.ndarray


def _groups(tables: tuple[Measurements, ...], model: _Model) -> list[_Group]:
    """One for each observed column of each table."""
    return [
        _Group(f"{name}: {column}", column, table[column])
        for table, name, experiment in zip(tables, model.names, model.experiments, strict=True)
        for column in experiment.columns
    ]


def _experiment(table: Measurements, manipulator: Manipulator) -> _Pulley | _Bench:
    if "pulling_tension" in table:
        return _Pulley(table["weight"], table["wrap_angle"], table.name)
    count = manipulator.num_tendons
    pulled = ["base_tension", *(f"base_tension_{i}" for i in range(2, count + 1))]
    for column in pulled:
        if column not in table:
            raise InputError(f"{table.name}: no column {column!r}; a manipulator of {count} tendons needs it")
    columns = [c for c in table.columns if c in ("tip_angle", "tip_x", "tip_y") or c.startswith("tip_tension")]
    if not columns:
        raise InputError(f"{table.name}: nothing observed; add a column tip_tension [N], tip_angle [deg] or tip_x [mm]")
    for column in table.columns:
        if column.startswith("tip_force"):
            remedy = "fit takes no loads yet; leave it out, or use least_squares_fit"
            raise InputError(f"{table.name}: column {column!r}: {remedy}")
        if column.startswith(("tip_tension", "base_tension")) and _tendon_number(column) > count:
            raise InputError(f"{table.name}: column {column!r}, but the manipulator has {count} tendon(s)")
    tension = np.stack([table[column] for column in pulled], axis=1)
    direction = table["direction"][:, None] if "direction" in table else np.ones((len(table), 1))
    return _Bench(tension, np.broadcast_to(direction, tension.shape), tuple(columns), table.name)


# --- the verdict ---------------------------------------------------------------------------------


def _conclude(manipulator: Manipulator, statistics: LeastSquaresFit, tables, model: _Model) -> Fit:
    fixed = {n: float(getattr(manipulator, n)) for n in PARAMETERS[:2] if n not in statistics.names}
    fitted = with_parameters(manipulator, statistics.parameters)
    told = vars(statistics) | {
        "value": statistics.value | fixed,
        "standard_error": statistics.standard_error | dict.fromkeys(fixed, 0.0),
        "confidence_interval": statistics.confidence_interval | {n: (v, v) for n, v in fixed.items()},
        "status": statistics.status | dict.fromkeys(fixed, FIXED),
    }
    labels = {name: [f"{name}: {c}" for c in e.columns] for name, e in zip(model.names, model.experiments, strict=True)}
    return Fit(
        **told,
        manipulator=fitted,
        tables=tables,
        nodes=model.nodes,
        alone={name: statistics.told_by(*labels[name]) for name in model.names},
        warnings=tuple(_warnings(fitted, statistics.parameters, tables, model)),
    )


def _warnings(fitted: Manipulator, parameters: Any, tables, model: _Model) -> list[str]:
    """What the tables and the solver have to say at the estimate."""
    found = [f"{table.name}: {warning}" for table in tables for warning in table.warnings]
    if fitted.kinematics == "published" and any(column in table for table in tables for column in POSE):
        found.append(
            "tip angles or positions are fitted in the published kinematics, which bends 5 to 10 % less at 40 % loss; "
            "use the exact one for a real body"
        )
    for name, experiment in zip(model.names, model.experiments, strict=True):
        if isinstance(experiment, _Bench):
            codes = experiment.evaluate(fitted, parameters, model.nodes)[2]
            for code in NOTEWORTHY:
                rows = int(np.sum(codes == code))
                found += [f"{name}: {rows} of {len(experiment.base_tension)} rows: {RESULTS[code]}"] if rows else []
    return found


def shown(told: Determination, name: str) -> tuple[float, float, float, float, str]:
    """Value, standard error and interval of a parameter in the unit in which engineers write it, and that unit."""
    scale, unit = SHOWN.get(name, (1.0, ""))
    numbers = told.value[name], told.standard_error[name], *told.confidence_interval[name]
    value, error, low, high = (scale * number for number in numbers)
    return value, error, low, high, unit


def _verdict(fit: Fit) -> list[str]:
    lines = [] if fit.success else [f"The fit failed: {fit.result}."]
    for name, status in fit.status.items():
        value, error, low, high, unit = shown(fit, name)
        if status == IDENTIFIED:
            lines.append(f"{name} = {value:.4g} +- {error:.2g}{unit} (95 %: {low:.4g} to {high:.4g}{unit}): identified")
        elif status != NOT_IDENTIFIED:
            lines.append(f"{name} = {value:.4g}{unit}: {status}")
        else:
            lines.append(f"{name}: not identified")
    for name, (value, error) in fit.combinations.items():
        lines.append(f"{name} = {value:.4g} +- {error:.2g} (SI): identified, though its factors are not")
    lost = {name for name, status in fit.status.items() if status == NOT_IDENTIFIED}
    return lines + [_advice(fit, lost)] * bool(lost)


def _advice(fit: Fit, lost: set[str]) -> str:
    """What would separate the parameters that these data leave together."""
    if lost == {"friction_coefficient", "youngs_modulus"} and fit.combinations:
        return (
            "Tensions of one tendon hold only friction_coefficient / youngs_modulus. To separate the two, add a pulley "
            "test (friction alone), tip angles or tip positions measured with the tensions, or a prior on either."
        )
    if lost == {"youngs_modulus"} and all("pulling_tension" in table for table in fit.tables):
        return (
            "A pulley test holds the friction alone. Add tip tensions, tip angles or tip positions of the manipulator."
        )
    return (
        f"The data do not determine {', '.join(sorted(lost))}. Add tip angles or positions, a pulley test, or a prior."
    )
