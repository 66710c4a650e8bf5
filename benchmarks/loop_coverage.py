"""How often 95 % intervals from loops contain the true value: `python benchmarks/loop_coverage.py`, about 5 minutes.

2,000 loops of the paper's body are simulated: base tensions of 5 to 85 N in steps of 5 N and back, 33 readings of tip
tension and tip angle with 0.1 N and 0.5 degrees of noise. Each is fitted as a user would: `fit` with history, friction
coefficient and modulus free, the noise of both columns estimated; and from the tip angle alone. The intervals are those
of t-statistics. The seed is fixed beforehand, 21; loop k is drawn from (21, k).
"""

from typing import Any

import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

LOOPS, SEED = 2000, 21
UP = np.arange(5.0, 86.0, 5.0)
PATH = np.concatenate([UP, UP[-2::-1]])  # N
NOISE = {"tip_tension": 0.1, "tip_angle": float(np.radians(0.5))}  # N, rad
TRUTH = {"friction_coefficient": 0.42, "youngs_modulus": 1.4e6}
SCENARIOS = {"tensions and angle": ("tip_tension", "tip_angle"), "angle alone": ("tip_angle",)}


def readings(body: cddf.Manipulator, path: np.ndarray) -> dict[str, np.ndarray]:
    """Without noise."""
    history = cddf.trace(body, path)
    return {"tip_tension": np.asarray(history.tip_tension), "tip_angle": np.asarray(history.tip_angle)}


def table(read: dict[str, np.ndarray], columns: tuple[str, ...], rng: np.random.Generator) -> cddf.Measurements:
    """One simulated loop."""
    noisy = {name: values + NOISE[name] * rng.normal(size=values.size) for name, values in read.items()}
    own = {"base_tension": PATH, "step": np.arange(PATH.size)} | {name: noisy[name] for name in columns}
    return cddf.Measurements.from_columns("loop", notes=("simulated",), **own)


def coverage(columns: tuple[str, ...]) -> dict[str, Any]:
    """Per cent of the intervals that hold the truth, and the mean error in standard errors."""
    body, held, errors, lost = paper_body(**TRUTH), [], [], 0
    read = readings(body, PATH)
    for k in range(LOOPS):
        fit = cddf.fit(body, table(read, columns, np.random.default_rng((SEED, k))))
        if not fit.success:
            lost += 1
            continue
        ends = [fit.confidence_interval[name] for name in TRUTH]
        held.append([low <= truth <= high for (low, high), truth in zip(ends, TRUTH.values(), strict=True)])
        errors.append([(fit.value[name] - truth) / fit.standard_error[name] for name, truth in TRUTH.items()])
    share, error = np.mean(held, axis=0), np.mean(errors, axis=0)
    return {
        "fits": len(held),
        "failed": lost,
        "intervals that hold the truth, %": dict(zip(TRUTH, (100 * share).tolist(), strict=True)),
        "mean error in standard errors": dict(zip(TRUTH, error.tolist(), strict=True)),
    }


def markdown(results: dict[str, dict[str, Any]]) -> str:
    """One row for each scenario."""
    lines = ["| readings | fits | failed | mu, % | E, % |", "| --- | ---: | ---: | ---: | ---: |"]
    for name, row in results.items():
        shares = [share / 100 for share in row["intervals that hold the truth, %"].values()]
        cells = (f"{100 * p:.1f} ± {100 * np.sqrt(p * (1 - p) / row['fits']):.1f}" for p in shares)
        lines.append(f"| {name} | {row['fits']} | {row['failed']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    configure_jax(quick_compilation=False)
    results = {name: coverage(columns) for name, columns in SCENARIOS.items()}
    text = markdown(results)
    report("loop_coverage", text, {"loops": LOOPS, "seed": SEED, "results": results})


if __name__ == "__main__":
    main()
