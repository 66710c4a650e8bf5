"""The results that a report of a fit contains, and the dictionary from which the fit can be repeated."""

import platform
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from ..estimation.bootstrap import Bootstrap
from ..estimation.determination import Determination
from ..estimation.profile_likelihood import Profile
from ..files.manipulator_file import manipulator_text
from ..files.writing import picked
from ..identification.bench import Bench
from ..identification.fit import Fit
from ..identification.parameters import unit_of
from ..identification.predictions import own_names
from ..measurements.table import Measurements
from ..progress import each
from ..robot.manipulator import Manipulator
from ..statics.solve import solve

if TYPE_CHECKING:
    from ..identification.model_free import ModelFreeFriction, ModelFreeLoop

PACKAGES = ("cddf-jax", "jax", "numpy", "scipy", "optimistix", "equinox")
LEAST_ROWS = 3  # for friction without a model
# of results.json
OF_FIT = (
    *("result", "success", "verdict", "warnings", "noise", "noise_model", "noise_estimated", "input_noise"),
    "serial_correlation",
    *("trial_effects", "trial_spread", "moved_by_steps", "mean_relative_error", "reduced_chi_square"),
    *("degrees_of_freedom", "log_likelihood", "information_criteria", "restarted", "num_steps"),
)
OF_DETERMINATION = (
    *("names", "value", "standard_error", "confidence_interval", "status", "combinations", "sums", "correlation"),
    *("rank", "condition_number", "sloppy_direction"),
)
OF_JITTER = ("noise", "least_turn", "num_ignored")
OF_MODEL_FREE = ("value", "standard_error", "confidence_interval", "verdict")
OF_LOOP = (
    *("gain", "gain_standard_error", "gain_interval", "loss", "loss_standard_error", "zero", "zero_p_value"),
    "verdict",
)
OF_BOOTSTRAP = (
    *("kind", "seed", "num_failed", "num_cases", "coverage", "remark", "names", "standard_error"),
    *("confidence_interval", "bias", "correlation", "estimates"),
)


class ModelFree(NamedTuple):
    """Friction without a model of the body, and how far that of the fit lies from it."""

    friction: "ModelFreeFriction"
    away: float | None  # in standard errors; None where the fit has no friction coefficient to compare


class LoopCompared(NamedTuple):
    """The result of a loop of tensions without a model of the body, and the loss of the fit."""

    model_free: "ModelFreeLoop"
    loss_of_fit: float  # 1/T_tip - 1/T_base of a pull, 1/N


class Report(NamedTuple):
    """A fit and the results that belong to it."""

    fit: Fit
    profiles: dict[str, Profile]  # by fitted parameter; none of a fit that failed
    bootstraps: tuple[Bootstrap, ...]
    model_free: dict[str, ModelFree]  # by table
    loops: dict[str, LoopCompared]  # by table with a history


def make_report(fit: Fit, *, bootstraps: Sequence[Bootstrap] = (), with_profiles: bool = True) -> Report:
    """Compute all that a report contains; profiles take some seconds."""
    profiles = (
        {name: fit.profile(name) for name in each("profile", own_names(fit))} if fit.success and with_profiles else {}
    )
    return Report(fit, profiles, tuple(bootstraps), _model_free(fit), _loops(fit))


def _model_free(fit: Fit) -> dict[str, ModelFree]:
    """Model-free friction of every table with tip tension and tip angle, for one tendon parallel to the axis."""
    body = fit.manipulator
    if body.kinematics != "exact" or body.num_tendons != 1 or body.slanted:
        return {}
    from ..identification.model_free import COLUMNS, model_free_friction

    found, mu = {}, "friction_coefficient"
    for name, table in _from_rest(fit, COLUMNS):
        if len(table) >= LEAST_ROWS:
            with suppress(InputError):  # no row is bent
                friction = model_free_friction(table, in_order=name in fit.without_jitter)
                away = None
                if mu in fit.names and np.isfinite(fit.standard_error[mu]):
                    error = float(np.hypot(friction.standard_error, fit.standard_error[mu]))
                    away = (fit.value[mu] - friction.value) / error if error > 0 else None
                found[name] = ModelFree(friction, away)
    return found


def _from_rest(fit: Fit, columns: Collection[str]) -> Iterator[tuple[str, Measurements]]:
    """The tables that have these columns, and whose trials begin at rest if their rows have a history."""
    named = zip(fit.model.names, fit.model.experiments, strict=True)
    rest = {name for name, one in named if not isinstance(one, Bench) or one.course is None or one.course.past is None}
    for name, table in zip(fit.model.names, fit.tables, strict=True):
        if name in rest and all(column in table for column in columns):
            yield name, table


def _loops(fit: Fit) -> dict[str, LoopCompared]:
    """The loops in tables with a history and tip tensions, of a tendon parallel to the axis without drag or loads."""
    body = fit.manipulator
    if not fit.success or body.tendon_drag is not None or body.slanted or fit.setting.loads is not None:
        return {}
    from ..identification.model_free import model_free_loop

    found = {}
    for name, table in _from_rest(fit, ("tip_tension",)):
        if name in fit.without_jitter:
            with suppress(InputError):  # not released far enough
                loop, tension = model_free_loop(table), float(table["base_tension"].max())
                found[name] = LoopCompared(loop, float(1 / solve(body, tension).tip_tension[0]) - 1 / tension)
    return found


# --- results.json --------------------------------------------------------------------------------


def fit_as_dict(report: Report) -> dict[str, object]:
    """All results and all inputs of a fit, SI units, for JSON, where an infinite number becomes null."""
    fit = report.fit
    return {
        **_determination_as_dict(fit),
        **picked(fit, OF_FIT),
        "alone": {name: _determination_as_dict(determination) for name, determination in fit.alone.items()},
        "pull_alone": None if fit.pull_alone is None else _determination_as_dict(fit.pull_alone),
        "without_jitter": {
            name: {"unit": "N"} | picked(steady, OF_JITTER) for name, steady in fit.without_jitter.items()
        },
        "cost_from_each_start": fit.starts,
        "profiles": {name: _profile_as_dict(profile) for name, profile in report.profiles.items()},
        "bootstraps": [_bootstrap_as_dict(bootstrap) for bootstrap in report.bootstraps],
        "model_free_friction": {
            name: {"unit": "1"} | picked(found.friction, OF_MODEL_FREE) | {"standard_errors_away": found.away}
            for name, found in report.model_free.items()
        },
        "model_free_loop": {
            name: picked(found.model_free, OF_LOOP) | {"loss_of_fit": found.loss_of_fit, "unit_of_loss": "1/N"}
            for name, found in report.loops.items()
        },
        "data": [_table_as_dict(table) for table in fit.tables],
        "manipulator": _as_toml(fit.model.manipulator),
        "kinematics": fit.manipulator.kinematics,
        "options": fit.options,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }


def _table_as_dict(table: Measurements) -> dict[str, object]:
    named = {"files": table.files or (table.name,), "rows": len(table), "sha256": table.checksum}
    named |= {"markers": {name: marker._asdict() for name, marker in table.markers.items()}} if table.markers else {}
    return picked(table, ("name", "simulated", "read_as")) | named | {"holds_averaged": table.holds_averaged}


def _determination_as_dict(found: Determination) -> dict[str, object]:
    units = {name: unit_of(name) for name in (*found.names, *found.identified_together)}
    return {"unit": units} | picked(found, OF_DETERMINATION)


def _profile_as_dict(profile: Profile) -> dict[str, object]:
    answer: dict[str, object] = {"unit": unit_of(profile.name)}
    answer |= {field: value for field, value in profile._asdict().items() if field not in ("name", "names")}
    columns = zip(profile.names, profile.others.T, strict=True)
    return answer | {"others": {name: values for name, values in columns if name != profile.name}}


def _bootstrap_as_dict(bootstrap: Bootstrap) -> dict[str, object]:
    replicates = len(bootstrap.estimates) + bootstrap.num_failed
    units = {name: unit_of(name) for name in bootstrap.names}
    return picked(bootstrap, OF_BOOTSTRAP) | {"replicates": replicates, "unit": units}


def _as_toml(manipulator: Manipulator) -> str | None:
    """The text of a file of the manipulator at the start of the search; None for profiles that no file can hold."""
    for outside in (False, True):
        with suppress(InputError):
            return manipulator_text(manipulator, offsets_outside_wall=outside)
    return None
