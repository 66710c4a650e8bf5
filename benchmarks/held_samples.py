"""Samples of one hold treated as independent readings: `python benchmarks/held_samples.py`, about a minute.

200 benches of the paper's body are simulated. Each has eight levels of base tension, and each level is held for 50
samples of tip tension and tip angle. Their noise is autoregressive (correlation 0.95 from sample to sample; 0 for
comparison). Friction coefficient and modulus are fitted to all samples, as if they were independent, and to one mean
for each hold (`average_holds`). The tip tension and angle of one tendon are closed forms. The result is how often the
95 % intervals contain the true value.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.files.writing import as_json, write_all
from cddf_jax.measurements.holds import correlation_of_rows, holds_of
from cddf_jax.measurements.table import Measurements

BENCHES, SAMPLES, SEED = 200, 50, 18
LEVELS = np.arange(10.0, 81.0, 10.0)  # N
MU, E, COMPLIANCE = 0.42, 1.4e6, 2.942783188998e4  # truth; G(L) of the paper's body, 1/m^2
START = {"friction_coefficient": MU, "youngs_modulus": E}
DEVIATION = {"tip_tension": 0.2, "tip_angle": 0.01}  # N, rad


class Predict:
    """Tip tension T / (1 + mu T G / E) and tip angle ln(T / T_tip) / mu, exact kinematics."""

    def __init__(self, base_tension: np.ndarray) -> None:
        self.base_tension = base_tension

    def __call__(self, p: dict[str, Any]) -> dict[str, Any]:
        loss = 1 + p["friction_coefficient"] / p["youngs_modulus"] * COMPLIANCE * self.base_tension
        return {"tip_tension": self.base_tension / loss, "tip_angle": jnp.log(loss) / p["friction_coefficient"]}


def autoregressive(rng: np.random.Generator, lag_one: float) -> np.ndarray:
    """Noise of variance 1 for every sample of every hold."""
    noise = rng.normal(size=(LEVELS.size, SAMPLES))
    for k in range(1, SAMPLES):
        noise[:, k] = lag_one * noise[:, k - 1] + np.sqrt(1 - lag_one**2) * noise[:, k]
    return noise.ravel()


def bench(rng: np.random.Generator, lag_one: float) -> Measurements:
    """The table of one bench."""
    base = np.repeat(LEVELS, SAMPLES)
    clean = Predict(base)(START)
    read: dict[str, Any] = {
        name: np.asarray(clean[name]) + DEVIATION[name] * autoregressive(rng, lag_one) for name in DEVIATION
    }
    return Measurements.from_columns("bench", base_tension=base, **read)


def fitted(table: Measurements, predict: Predict) -> cddf.LeastSquaresFit:
    """The fit of friction and modulus with estimated noise."""
    bounds = dict.fromkeys(START, (0.0, None))
    return cddf.least_squares_fit(predict, START, {name: table[name] for name in DEVIATION}, bounds=bounds)


def coverage(lag_one: float) -> dict[str, Any]:
    """Per cent of the benches whose intervals contain the true value, and per cent with an alarm."""
    all_samples, means = Predict(np.repeat(LEVELS, SAMPLES)), Predict(LEVELS)
    held: dict[str, list[list[bool]]] = {"all samples": [], "one mean a hold": []}
    alarms = []
    for k in range(BENCHES):
        table = bench(np.random.default_rng((SEED, k)), lag_one)
        fits = {
            "all samples": fitted(table, all_samples),
            "one mean a hold": fitted(cddf.average_holds(table), means),
        }
        for how, fit in fits.items():
            ends = [fit.confidence_interval[name] for name in START]
            held[how].append([low <= truth <= high for (low, high), truth in zip(ends, START.values(), strict=True)])
        residual = fits["all samples"].residuals["tip_angle"] / fits["all samples"].noise["tip_angle"]
        alarms.append(correlation_of_rows(residual, holds_of(table)) > 0)
    shares = {how: dict(zip(START, (100 * np.mean(rows, axis=0)).tolist(), strict=True)) for how, rows in held.items()}
    return {"intervals that hold the truth, %": shares, "alarms": 100 * float(np.mean(alarms))}


def main() -> None:
    """Simulate, print and save."""
    configure_jax()
    results = {f"lag one {lag_one:g}": coverage(lag_one) for lag_one in (0.95, 0.0)}
    text = as_json({"benches": BENCHES, "samples a hold": SAMPLES, "seed": SEED, "results": results})
    print(text)
    write_all("out/benchmark", {"held_samples.json": text})


if __name__ == "__main__":
    main()
