"""How often 95 % intervals from loops contain the true value: `python benchmarks/loop_coverage.py [scenario ...]`.

Loops of the paper's body are simulated, with 0.1 N and 0.5 degrees of noise. Each is fitted as a user would: `fit` with
history, friction coefficient and modulus free, the noise of each column estimated. The intervals are those of
t-statistics. The seed is fixed beforehand, 21; loop k of each scenario is drawn from (21, k).

- One tendon, base tensions of 5 to 85 N in steps of 5 N and back, 33 readings; also the tip angle alone.
- One tendon that was released from 60 N to the first row, 40 N, then pulled to 85 N and released to 5 N, 26 readings;
  what it had before is fitted too.
- A stepped finger, base tensions of 1 to 12 N in steps of 1 N and back from 11.5 to 0.5 N, 24 readings, with 0.05 N of
  noise; the base cell is exact or has 0.03 or 0.1 N of noise, which is given to the fit or not.
- A pair of tendons, the second at 20 N: 8 readings from 10 to 70 N and back to 16 N. They are simulated with 16 short
  steps and fitted with the 4 of `fit`.

The 6,000 loops of one tendon take about 10 minutes, the 40 of pairs half an hour: a fit of a pair takes 25
to 40 seconds. One in forty fails; it searches from many starts first, which takes minutes. 40 loops tell a coverage to
some per cent only; `--loops 400` tells more. `--linear` takes the loops of pairs with readings that are linear in the
parameters, about the true values; 1,000 of them take one minute. They have the same noise, loop by loop, and
show what the statistics of few readings do alone.
"""

import argparse
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.estimation.least_squares import least_squares_fit

SEED = 21
UP = np.arange(5.0, 86.0, 5.0)
PATH = np.concatenate([UP, UP[-2::-1]])  # N
RELEASED = np.concatenate([np.arange(40.0, 86.0, 5.0), np.arange(80.0, 4.0, -5.0)])
AGAINST = 20.0  # N, of the second tendon
PAIR = np.array([[pull, AGAINST] for pull in (10.0, 30.0, 50.0, 70.0, 58.0, 46.0, 30.0, 16.0)])
NOISE = {"tip_tension": 0.1, "tip_tension_2": 0.1, "tip_angle": float(np.radians(0.5))}  # N, rad
TRUTH = {"friction_coefficient": 0.42, "youngs_modulus": 1.4e6}


class Scenario(NamedTuple):
    """What is simulated and fitted."""

    loops: int
    path: np.ndarray  # (rows, tendons), N
    columns: tuple[str, ...]
    before: float | None = None  # N, which is fitted
    base_noise: float | None = None  # of the finger, N; None: the paper's body with an exact base cell
    stated: bool = False  # whether the fit is given the noise of the base cell


UP_FINGER = np.arange(1.0, 12.1)
FINGER = np.concatenate([UP_FINGER, UP_FINGER[::-1] - 0.5])[:, None]
FINGER_TRUTH = {"friction_coefficient": 0.31, "youngs_modulus": 4e6}
TIP, TIPS = ("tip_tension", "tip_angle"), ("tip_tension", "tip_tension_2", "tip_angle")
SCENARIOS = {
    "tensions and angle": Scenario(2000, PATH[:, None], TIP),
    "angle alone": Scenario(2000, PATH[:, None], ("tip_angle",)),
    "tensions and angle, `before` free": Scenario(2000, RELEASED[:, None], TIP, 60.0),
    "a pair, tensions and angle": Scenario(40, PAIR, TIPS),
}
SCENARIOS |= {
    f"finger, base cell {noise:g} N{', stated' if stated else ''}": Scenario(500, FINGER, TIP, None, noise, stated)
    for noise, stated in ((0.0, False), (0.03, False), (0.03, True), (0.1, False), (0.1, True))
}


def truth_of(scenario: Scenario) -> dict[str, float]:
    """Friction coefficient and modulus."""
    return TRUTH if scenario.base_noise is None else FINGER_TRUTH


def body_of(scenario: Scenario, **truth: float) -> cddf.Manipulator:
    """The paper's body, or a finger that is thicker up to 40 of its 100 mm."""
    if scenario.base_noise is None:
        return paper_body(**truth, num_tendons=scenario.path.shape[1])
    mu, modulus = truth["friction_coefficient"], truth["youngs_modulus"]
    finger = cddf.conical(
        length=0.1,
        outer_radius=0.004,
        inner_radius=0.001,
        tendon_offset=0.003,
        youngs_modulus=modulus,
        friction_coefficient=mu,
    )
    return replace(finger, outer_radius=cddf.Piecewise(ends=[0.04], pieces=[0.005, 0.004]))


def simulated(scenario: Scenario, factors: Any = (1.0, 1.0, 1.0), **options: Any) -> dict[str, np.ndarray]:
    """All columns without noise; `factors` on friction coefficient, modulus and what was before."""
    path, tendons = scenario.path, scenario.path.shape[1]
    own = truth_of(scenario).items()
    truth = {name: value * factor for (name, value), factor in zip(own, factors, strict=False)}
    body, pulled = body_of(scenario, **truth), path if tendons > 1 else path[:, 0]
    before = "rest" if scenario.before is None else scenario.before * factors[2]
    history = cddf.trace(body, pulled, before=before, **options)
    tips = np.asarray(history.tip_tension).reshape(path.shape)
    own = {f"tip_tension{f'_{i + 1}' if i else ''}": tips[:, i] for i in range(tendons)}
    return own | {"tip_angle": np.asarray(history.tip_angle)}


def table(scenario: Scenario, read: dict[str, np.ndarray], rng: np.random.Generator) -> cddf.Measurements:
    """One simulated loop."""
    cell = 1.0 if scenario.base_noise is None else 0.5  # the cells of the finger are better
    noise = {name: own * (cell if name != "tip_angle" else 1.0) for name, own in NOISE.items()}
    noisy = {name: values + noise[name] * rng.normal(size=values.size) for name, values in read.items()}
    errors = (scenario.base_noise or 0.0) * rng.normal(size=scenario.path.T.shape)
    pulls = scenario.path.T + errors
    path = {f"base_tension{f'_{i + 1}' if i else ''}": pulled for i, pulled in enumerate(pulls)}
    own = path | {"step": np.arange(len(scenario.path))} | {name: noisy[name] for name in scenario.columns}
    return cddf.Measurements.from_columns("loop", ("simulated",), **own)


def coverage(scenario: Scenario, loops: int) -> dict[str, Any]:
    """Per cent of the intervals that hold the truth, and the mean error in standard errors."""
    own = truth_of(scenario)
    truth = own | ({"before": scenario.before} if scenario.before else {})
    noise = {"base_tension": scenario.base_noise} if scenario.stated and scenario.base_noise else {}
    body, held, errors, lost = body_of(scenario, **own), [], [], 0
    read = simulated(scenario)
    for k in range(loops):
        fit = cddf.fit(body, table(scenario, read, np.random.default_rng((SEED, k))), tuple(truth), noise=noise)
        if not fit.success:
            lost += 1
            continue
        ends = [fit.confidence_interval[name] for name in truth]
        held.append([low <= true <= high for (low, high), true in zip(ends, truth.values(), strict=True)])
        errors.append([(fit.value[name] - true) / fit.standard_error[name] for name, true in truth.items()])
    return summary(truth, held, errors, lost)


def linear_coverage(scenario: Scenario, loops: int) -> dict[str, Any]:
    """The same, for readings that are linear in the parameters about the true values."""
    names = tuple(TRUTH | ({"before": scenario.before} if scenario.before else {}))
    few = {"nodes": 8, "short_steps": 4}  # half the elements and as many increments as in a fit
    at, step = np.ones(3), 1e-3
    clean = simulated(scenario, **few)
    ends = [
        [simulated(scenario, at + sign * step * unit, **few) for sign in (-1, 1)] for unit in np.eye(3)[: len(names)]
    ]
    slopes = {
        column: np.stack([(up[column] - down[column]) / (2 * step) for down, up in ends], axis=1) for column in clean
    }

    def predict(parameters):
        moved = jnp.stack([parameters[name] for name in names]) - 1
        return {column: clean[column] + slopes[column] @ moved for column in scenario.columns}

    start, held, errors = dict.fromkeys(names, 1.0), [], []
    for k in range(loops):
        rng = np.random.default_rng((SEED, k))
        noisy = {column: values + NOISE[column] * rng.normal(size=values.size) for column, values in clean.items()}
        found = least_squares_fit(predict, start, {column: noisy[column] for column in scenario.columns}, scales=start)
        held.append([low <= 1 <= high for low, high in found.confidence_interval.values()])
        errors.append([(found.value[name] - 1) / found.standard_error[name] for name in names])
    return summary(names, held, errors, 0)


def summary(names: Iterable[str], held: list[list[bool]], errors: list[list[float]], lost: int) -> dict[str, Any]:
    """What the fits of a scenario say together."""
    truth = tuple(names)
    share, error, scatter = np.mean(held, axis=0), np.mean(errors, axis=0), np.std(errors, axis=0)
    return {
        "fits": len(held),
        "failed": lost,
        "intervals that hold the truth, %": dict(zip(truth, (100 * share).tolist(), strict=True)),
        "mean error in standard errors": dict(zip(truth, error.tolist(), strict=True)),
        "scatter in standard errors": dict(zip(truth, scatter.tolist(), strict=True)),
    }


def markdown(results: dict[str, dict[str, Any]]) -> str:
    """One row for each scenario."""
    names = (*TRUTH, "before")
    lines = ["| readings | fits | failed | mu, % | E, % | before, % |", "| --- | ---: | ---: | ---: | ---: | ---: |"]
    for name, row in results.items():
        held = row["intervals that hold the truth, %"]
        shares = [held[one] / 100 if one in held else None for one in names]
        cells = ("" if p is None else f"{100 * p:.1f} ± {100 * np.sqrt(p * (1 - p) / row['fits']):.1f}" for p in shares)
        lines.append(f"| {name} | {row['fits']} | {row['failed']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=list(SCENARIOS), help="names of scenarios; all unless given")
    parser.add_argument("--loops", type=int, help="of each scenario, in place of its own number")
    parser.add_argument("--linear", action="store_true", help="readings that are linear in the parameters")
    asked = parser.parse_args()
    configure_jax()
    covered = linear_coverage if asked.linear else coverage
    results = {name: covered(SCENARIOS[name], asked.loops or SCENARIOS[name].loops) for name in asked.scenarios}
    report("loop_coverage", markdown(results), {"seed": SEED, "results": results})


if __name__ == "__main__":
    main()
