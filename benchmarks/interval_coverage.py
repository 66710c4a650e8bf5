"""How often a 95 % interval contains the true value: `python benchmarks/interval_coverage.py`.

The experiments are those of data/*_simulated.csv, simulated 1,000 times: a pulley test, then tension pairs of the
paper's body at 17 levels of 5 to 85 N in six trials. Friction coefficient and modulus are fitted to both tables
together. The tip tension is the closed form of one tendon. Where friction differs between trials, the first half is
also fitted with `fit(..., per_trial=True)`. `--experiments 200` takes a fifth of the time.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.estimation.least_squares import LeastSquaresFit, least_squares_fit
from cddf_jax.estimation.observations import Noise
from cddf_jax.measurements.table import Measurements
from cddf_jax.mechanics.capstan import pulling_tension

ROBOT = Path(__file__).parents[1] / "data" / "smooth_sil_940.toml"
EXPERIMENTS = 1000
SEED = 2020
MU, E = "friction_coefficient", "youngs_modulus"
BOUNDS = {MU: (0.0, None), E: (0.0, None)}

TRIALS, LEVELS = np.repeat(np.arange(6), 17), np.tile(np.arange(5.0, 86.0, 5.0), 6)
PULLEY_TRIALS, WRAPS, WEIGHTS = (
    x.ravel() for x in np.meshgrid(np.arange(3), np.deg2rad([90.0, 180.0]), [2.0, 5.0, 10.0, 15.0, 20.0], indexing="ij")
)


@dataclass(frozen=True)
class Scenario:
    """How experiments are simulated, and which noise the fit is given."""

    floor: float
    fraction: float
    sigma: Any
    friction_scatter: float = 0.0  # of mu from trial to trial on the manipulator, relative


SCENARIOS = {
    "one sd for each table, estimated": Scenario(0.3, 0.0, None),
    "floor and fraction, estimated": Scenario(0.1, 0.01, Noise()),
    "floor and fraction, known": Scenario(0.1, 0.01, Noise(0.1, 0.01)),
    "the same, estimated; mu scatters by 1 % between trials": Scenario(0.1, 0.01, Noise(), 0.01),
}

Predict = Callable[[dict[str, Any]], dict[str, Any]]


def paper() -> tuple[dict[str, float], Predict]:
    """The true values, and a function that predicts both tables: T_tip = T / (1 + mu G T / E), and eq. (5)."""
    robot = cddf.read_manipulator(ROBOT)
    truth = {MU: float(robot.friction_coefficient), E: float(robot.youngs_modulus)}
    tip = float(cddf.closed_form_tension(robot, 1.0, robot.length))
    compliance = (1 / tip - 1) * truth[E] / truth[MU]  # G, from the tip tension at 1 N

    def predict(p):
        tip_tension = LEVELS / (1 + p[MU] / p[E] * compliance * LEVELS)
        return {"load_cells": jnp.asarray(tip_tension), "pulley": pulling_tension(WEIGHTS, p[MU], WRAPS)}

    return truth, predict


def draw(rng: np.random.Generator, scenario: Scenario, truth: dict[str, float], predict: Predict) -> dict[str, Any]:
    """Readings of one experiment."""
    scatter = 1 + scenario.friction_scatter * rng.normal(size=6)
    clean = {name: np.array(v) for name, v in predict(truth).items()}
    by_trial = [np.asarray(predict(truth | {MU: truth[MU] * factor})["load_cells"]) for factor in scatter]
    clean["load_cells"] = np.stack(by_trial)[TRIALS, np.arange(TRIALS.size)]
    return {
        name: v + rng.normal(size=v.shape) * np.hypot(scenario.floor, scenario.fraction * v)
        for name, v in clean.items()
    }


def per_trial_intervals(data: dict[str, Any], sigma: Any) -> dict[str, tuple[float, float]] | None:
    """95 % intervals of a fit with its own friction in each trial; None if the fit failed."""
    robot = cddf.read_manipulator(ROBOT)
    tables = [
        Measurements.from_columns("pulley", weight=WEIGHTS, wrap_angle=WRAPS, pulling_tension=data["pulley"]),
        Measurements.from_columns("cells", base_tension=LEVELS, tip_tension=data["load_cells"], trial=TRIALS),
    ]
    noise = {"tip_tension": sigma, "pulling_tension": sigma}
    fit = cddf.fit(robot, tables, (MU, E), noise=noise, per_trial=True)
    return fit.confidence_interval if fit.success else None


def intervals(fit: LeastSquaresFit) -> dict[str, dict[str, tuple[float, float]]]:
    """95 % intervals by method and parameter."""
    profiles = {name: fit.profile(name).confidence_interval for name in fit.names}
    return {"t": fit.confidence_interval, "profile": profiles}


def simulate(scenario: Scenario, experiments: int, by_trials: int = 0, seed: int = SEED) -> list[dict[str, Any]]:
    """Whether the interval contains the true value, by experiment, method and parameter."""
    truth, predict = paper()
    held = []
    for k in range(experiments):
        data = draw(np.random.default_rng((seed, k)), scenario, truth, predict)
        fit = least_squares_fit(predict, truth, data, scenario.sigma, BOUNDS)
        if not fit.success:  # a failed fit has no interval
            print(f"experiment {k}: {fit.result}")
            continue
        found = intervals(fit)
        if scenario.friction_scatter and k < by_trials:
            by_trial = per_trial_intervals(data, scenario.sigma)
            found |= {"per_trial": by_trial} if by_trial else {}
        held.append(
            {how: {n: low <= truth[n] <= high for n, (low, high) in ends.items()} for how, ends in found.items()}
        )
    return held


def coverage(held: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per cent of intervals that contain the true value, with its Monte Carlo error, by method and parameter."""
    result = {}
    for how in held[0]:
        rows = [row[how] for row in held if how in row]
        shares = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        errors = {name: float(np.sqrt(p * (1 - p) / len(rows))) for name, p in shares.items()}
        result[how] = {
            "experiments": len(rows),
            **{name: (100 * shares[name], 100 * errors[name]) for name in (MU, E)},
        }
    return result


def markdown(results: dict[str, dict[str, dict[str, Any]]]) -> str:
    """One row per scenario and method."""
    lines = ["| noise | 95 % interval | experiments | mu, % | E, % |", "| --- | --- | ---: | ---: | ---: |"]
    for scenario, methods in results.items():
        for how, row in methods.items():
            cells = (f"{row[name][0]:.1f} ± {row[name][1]:.1f}" for name in (MU, E))
            lines.append(f"| {scenario} | {how} | {row['experiments']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--experiments", type=int, default=EXPERIMENTS, help="of each kind of noise")
    experiments = parser.parse_args().experiments
    configure_jax()
    results = {}
    for name, scenario in SCENARIOS.items():
        begin = time.perf_counter()
        results[name] = coverage(simulate(scenario, experiments, experiments // 2))
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    text = markdown(results)
    about = {"experiments": experiments, "seed": SEED}
    report("interval_coverage", text, about | {"results": results})


if __name__ == "__main__":
    main()
