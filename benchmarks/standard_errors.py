"""Standard errors of every parameter of a bench against Monte Carlo: `python benchmarks/standard_errors.py`, 3 minutes.

Twelve parameters are fitted together: those of the body and of its bench. The data are tip tensions, angles and
positions of the paper's body at 12 levels and a pulley test of four angles. Priors describe what is known of the
cells and dimensions of a bench. The readings are those of the solver at the true values. Noise is added 400 times, to
the readings and to the means of the priors, and each time all is fitted again. The scatter of the refits divided by
the standard error of the fit should be 1; with 400 draws it scatters about 1 with a standard deviation of 3.5 per
cent. The mean of the refits should be the true value; with 400 draws it scatters by 0.05 standard errors.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.files.writing import as_json, write_all
from cddf_jax.identification.bench import Bench
from cddf_jax.identification.fit import Fit
from cddf_jax.identification.parameters import starting_value, with_parameters
from cddf_jax.measurements.table import Measurements

REPLICATES, DRAG = 400, 10.0
LEVELS, WRAPS, WEIGHT = np.linspace(8.0, 85.0, 12), np.arange(1.0, 5.0), 10.0
NOISE = {"tip_tension": 0.02, "tip_angle": 5e-4, "tip_x": 5e-5, "tip_y": 5e-5, "pulling_tension": 0.02}
PRIORS = {
    "outer_radius_error": (0.0, 2e-5),
    "tendon_offset_error": (0.0, 2e-5),
    "base_gain": (1.0, 0.005),
    "tip_gain": (1.0, 0.005),
    "base_zero": (0.0, 0.05),
    "tip_zero": (0.0, 0.05),
    "drag": (DRAG, 1.0),
    "pretension": (1.0, 0.1),
}


def fit_at_truth(names: Sequence[str]) -> Fit:
    """The fit to readings without noise. It ends at the true values."""
    paper = cddf.read_manipulator(Path(__file__).parents[1] / "data" / "smooth_sil_940.toml")
    body = with_parameters(paper, {"drag": DRAG})
    truth = {name: starting_value(body, name) for name in names}
    bench = Bench(LEVELS[:, None], (None,))
    read, *_ = bench.evaluate(body, truth, 16)
    pulled = WEIGHT * np.exp(float(paper.friction_coefficient) * WRAPS)
    measured: dict[str, Any] = {name: read[name] for name in NOISE if name in read}
    tables = [
        Measurements.from_columns("bench", base_tension=LEVELS, **measured),
        Measurements.from_columns("pulley", wrap_angle=WRAPS, weight=WEIGHT + 0 * WRAPS, pulling_tension=pulled),
    ]
    priors = {name: prior for name, prior in PRIORS.items() if name in names}
    return cddf.fit(body, tables, tuple(names), priors, noise=NOISE)


def drawn(fit: Fit, rng: np.random.Generator) -> Fit:
    """A fit to new readings, and new means of the priors."""
    tables = []
    for table in fit.tables:
        read: dict[str, Any] = {
            name: own + NOISE.get(name, 0.0) * rng.normal(size=own.size) for name, own in table.columns.items()
        }
        tables.append(Measurements.from_columns(table.name, **read))
    known = fit.options["priors"].items()
    priors = {name: (mean + deviation * rng.normal(), deviation) for name, (mean, deviation) in known}
    return cddf.fit(fit.manipulator, tables, fit.names, priors, noise=NOISE, starts=1)


def compare(fit: Fit, replicates: int) -> dict[str, tuple[float, float, float]]:
    """By parameter: standard error, scatter of the refits divided by it, and bias of their mean divided by it."""
    rng = np.random.default_rng(0)
    estimates = np.array([[*drawn(fit, rng).value.values()][: len(fit.names)] for _ in range(replicates)])
    error = np.sqrt(np.diag(fit.covariance))
    spread = estimates.std(axis=0, ddof=1) / error
    bias = (estimates.mean(axis=0) - np.array([fit.value[name] for name in fit.names])) / error
    rows = zip(error.tolist(), spread.tolist(), bias.tolist(), strict=True)
    return dict(zip(fit.names, rows, strict=True))


def markdown(rows: Mapping[str, tuple[float, float, float]]) -> str:
    """One row per parameter."""
    lines = ["| parameter | standard error (SI) | scatter / standard error | bias / standard error |"]
    lines += ["| --- | ---: | ---: | ---: |"]
    lines += [f"| {name} | {error:.3g} | {spread:.3f} | {bias:+.3f} |" for name, (error, spread, bias) in rows.items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    configure_jax()
    begin = time.perf_counter()
    names = ["friction_coefficient", "youngs_modulus", "length", "angle_zero", *PRIORS]
    rows = compare(fit_at_truth(names), REPLICATES)
    text = markdown(rows)
    print(f"{time.perf_counter() - begin:.0f} s\n{text}")
    write_all("out/benchmark", {"standard_errors.md": text, "standard_errors.json": as_json(rows)})


if __name__ == "__main__":
    main()
