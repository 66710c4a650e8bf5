"""All that is found around a fit, and the dictionary of it from which the fit can be repeated."""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .bench import unit_of
from .bootstrap import Bootstrap
from .determination import Determination
from .errors import InputError
from .fit_figures import Normality, normality, own_names
from .identification import Fit
from .manipulator import Manipulator
from .manipulator_file import write_manipulator
from .measurements import Measurements
from .profile_likelihood import Profile

if TYPE_CHECKING:
    from .model_free import Disagreement, ModelFreeFriction

PACKAGES = ("cddf-jax", "jax", "numpy", "scipy", "optimistix", "equinox")
LEAST_ROWS = 3  # for friction without a model


class ModelFree(NamedTuple):
    """Friction without a model of the body, and how far that of the fit lies from it."""

    friction: "ModelFreeFriction"
    disagreement: "Disagreement | None"  # None where the fit has no friction coefficient to compare


class Report(NamedTuple):
    """A fit and what was found around it."""

    fit: Fit
    options: dict[str, Any]  # arguments of `fit`, as JSON holds them
    profiles: dict[str, Profile]  # by fitted parameter; none of a fit that failed
    bootstraps: tuple[Bootstrap, ...]
    normality: dict[str, Normality]
    model_free: dict[str, ModelFree]  # by table


def make_report(
    fit: Fit,
    *,
    options: Mapping[str, Any] | None = None,
    bootstraps: Sequence[Bootstrap] = (),
    with_profiles: bool = True,
) -> Report:
    """Gather all that a report says; profiles take some seconds."""
    profiles = {name: fit.profile(name) for name in own_names(fit)} if fit.success and with_profiles else {}
    every = _options(fit) | {name: _plain_option(value) for name, value in (options or {}).items()}
    return Report(fit, every, profiles, tuple(bootstraps), normality(fit), _model_free(fit))


def _model_free(fit: Fit) -> dict[str, ModelFree]:
    """Of every table with tip tension and tip angle of one tendon that runs parallel to the axis."""
    body = fit.manipulator
    if body.kinematics != "exact" or body.num_tendons != 1 or body.slanted:
        return {}
    from .model_free import COLUMNS, disagreement, model_free_friction

    found = {}
    for name, table in zip(fit.alone, fit.tables, strict=True):
        if len(table) < LEAST_ROWS or not all(column in table for column in COLUMNS):
            continue
        try:
            friction = model_free_friction(table)
        except InputError:  # no row is bent
            continue
        mu = "friction_coefficient"
        told = mu in fit.names and np.isfinite(fit.standard_error[mu])
        compared = disagreement(friction, fit.value[mu], fit.standard_error[mu]) if told else None
        found[name] = ModelFree(friction, compared)
    return found


def trial_rows(fit: Fit) -> list[tuple[str, float, float]]:
    """Table and trial, ln(mu of the trial / mu) and its standard error."""
    return [(name, effect.value, effect.standard_error) for name, effect in fit.trial_effects.items()]


# --- results.json --------------------------------------------------------------------------------


def as_dict(report: Report) -> dict[str, Any]:
    """Everything that was found and that it was found from, SI units, for JSON: what is infinite becomes null there."""
    fit = report.fit
    return {
        **_determination(fit),
        "result": fit.result,
        "success": fit.success,
        "verdict": list(fit.verdict),
        "warnings": list(fit.warnings),
        "alone": {name: _determination(told) for name, told in fit.alone.items()},
        "noise": fit.noise,
        "noise_model": {name: model._asdict() for name, model in fit.noise_model.items()},
        "noise_estimated": fit.noise_estimated,
        "serial_correlation": {name: found._asdict() for name, found in fit.serial_correlation.items()},
        "normality": {name: test._asdict() for name, test in report.normality.items()},
        "trial_effects": {name: {"value": effect, "standard_error": error} for name, effect, error in trial_rows(fit)},
        "trial_spread": fit.trial_spread,
        "mean_relative_error": fit.mean_relative_error,
        "reduced_chi_square": fit.reduced_chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "log_likelihood": fit.log_likelihood,
        "information_criteria": fit.information_criteria,
        "cost_from_each_start": fit.starts,
        "restarted": fit.restarted,
        "num_steps": fit.num_steps,
        "profiles": {name: _profile(profile) for name, profile in report.profiles.items()},
        "bootstraps": [_bootstrap(bootstrap) for bootstrap in report.bootstraps],
        "model_free_friction": {name: _without_model(found) for name, found in report.model_free.items()},
        "data": [_of_table(table) for table in fit.tables],
        "manipulator": _as_toml(fit.model.manipulator),
        "kinematics": fit.manipulator.kinematics,
        "options": report.options,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }


def _of_table(table: Measurements) -> dict[str, Any]:
    named = {"name": table.name, "files": list(table.files or (table.name,))}
    named |= {"rows": len(table), "sha256": table.checksum, "simulated": table.simulated}
    return named | {"holds_averaged": table.spread is not None, "read_as": list(table.read_as)}


def _determination(told: Determination) -> dict[str, Any]:
    return {
        "names": told.names,
        "unit": {name: unit_of(name) for name in (*told.names, *told.combinations)},
        "value": told.value,
        "standard_error": told.standard_error,
        "confidence_interval": told.confidence_interval,
        "status": told.status,
        "combinations": {name: estimate._asdict() for name, estimate in told.combinations.items()},
        "correlation": told.correlation,
        "rank": told.rank,
        "condition_number": told.condition_number,
        "sloppy_direction": told.sloppy_direction,
    }


def _profile(profile: Profile) -> dict[str, Any]:
    others = dict(zip(profile.names, profile.others.T, strict=True))
    own = {name: value for name, value in profile._asdict().items() if name not in ("name", "names")}
    return (
        {"unit": unit_of(profile.name)}
        | own
        | {"others": {name: values for name, values in others.items() if name != profile.name}}
    )


def _bootstrap(bootstrap: Bootstrap) -> dict[str, Any]:
    return {
        "kind": bootstrap.kind,
        "seed": bootstrap.seed,
        "replicates": len(bootstrap.estimates) + bootstrap.num_failed,
        "num_failed": bootstrap.num_failed,
        "num_cases": bootstrap.num_cases,
        "coverage": bootstrap.coverage,
        "remark": bootstrap.remark,
        "names": bootstrap.names,
        "unit": {name: unit_of(name) for name in bootstrap.names},
        "standard_error": bootstrap.standard_error,
        "confidence_interval": bootstrap.confidence_interval,
        "bias": bootstrap.bias,
        "correlation": bootstrap.correlation,
        "estimates": bootstrap.estimates,
    }


def _without_model(found: ModelFree) -> dict[str, Any]:
    friction, compared = found
    return {
        "unit": "1",
        "value": friction.value,
        "standard_error": friction.standard_error,
        "confidence_interval": friction.confidence_interval,
        "verdict": list(friction.verdict),
        "disagreement": None if compared is None else compared._asdict(),
    }


def _options(fit: Fit) -> dict[str, Any]:
    """The arguments of `fit` as far as the fit remembers them; uniform priors are among the bounds."""
    names, space, problem = fit.names, fit.search.problem.space, fit.search.problem
    own = [(names.index(name), name) for name in own_names(fit)]
    limits = zip(np.asarray(space.lower).tolist(), np.asarray(space.upper).tolist(), strict=True)
    bounds = [tuple(end if np.isfinite(end) else None for end in pair) for pair in limits]
    priors = {name: _plain_option(problem.prior[i]) for i, name in own if i in problem.prior}
    return {
        "free": [name for _, name in own],
        "priors": priors,
        "bounds": {name: bounds[i] for i, name in own if bounds[i] != (None, None)},
        "noise": _given_noise(fit),
        "per_trial": not np.isnan(fit.trial_spread),
        "loss": fit.loss,
        "starts": len(fit.starts) if len(fit.starts) and not fit.restarted else None,
        "seed": fit.seed,
        "nodes": fit.model.nodes,
    }


def _given_noise(fit: Fit) -> dict[str, Any]:
    """By column, the noise that was given in full."""
    noise = {}
    for label, deviation in zip(fit.evidence.rows, fit.search.noise, strict=True):
        if not fit.evidence.noise_estimated[label]:
            model = fit.noise_model.get(label)
            known = np.ravel(deviation)
            one_for_all = float(known[0]) if np.ptp(known) == 0 else known.tolist()
            noise[label.rpartition(": ")[2]] = _plain_option(model or one_for_all)
    return noise


def _plain_option(value: Any) -> Any:
    """Priors and noise by the names of their parts."""
    if isinstance(value, Mapping):
        return {name: _plain_option(item) for name, item in value.items()}
    return value._asdict() if hasattr(value, "_asdict") else value


def _as_toml(manipulator: Manipulator) -> str | None:
    """The file of the manipulator from which the search started; None for profiles that no file can hold."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "manipulator.toml"
        for outside in (False, True):
            try:
                write_manipulator(manipulator, path, offsets_outside_wall=outside)
            except InputError:
                continue
            return path.read_text(encoding="utf-8")
    return None
