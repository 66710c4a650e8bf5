"""Which creep of a loop a fit notices: `python benchmarks/loop_checks.py`, about 10 minutes.

The loops are those of `loop_coverage.py`, 200 for each size: 33 readings of tip tension and tip angle, noise estimated.

Creep: the body goes on bending while it is measured; each tip angle is read larger by a part that grows with the row,
up to the stated part in the last one; or the zero of the camera drifts by the stated angle.
A fit notices where one of its remarks is about drift. "any" counts outliers and all other remarks too.
"""

from collections.abc import Callable

import numpy as np
from loop_coverage import NOISE, PATH, SCENARIOS, SEED, simulated
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

LOOPS = 200
Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


def creeping(part: float) -> Change:
    """The tip angle grows by a part of itself until the last row."""

    def change(read: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return read | {"tip_angle": read["tip_angle"] * (1 + part * np.arange(PATH.size) / (PATH.size - 1))}

    return change


def drifting(angle: float) -> Change:
    """The zero of the camera drifts, rad until the last row."""

    def change(read: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return read | {"tip_angle": read["tip_angle"] + angle * np.arange(PATH.size) / (PATH.size - 1)}

    return change


CHANGES: dict[str, Change] = {
    "nothing": lambda read: read,
    **{f"creep of the tip angle, {100 * part:g} %": creeping(part) for part in (0.01, 0.02, 0.03, 0.05, 0.1)},
    **{f"drift of the camera, {angle:g} deg": drifting(np.radians(angle)) for angle in (0.5, 1.0, 1.5, 2.0, 3.0)},
}


def noticed(change: Change) -> dict[str, float]:
    """Per cent of the loops with a remark about drift, and with any remark; how far off the modulus is."""
    body, found = paper_body(), []
    read = simulated(SCENARIOS["tensions and angle"])
    for k in range(LOOPS):
        rng = np.random.default_rng((SEED, k))
        noisy = {name: values + NOISE[name] * rng.normal(size=values.size) for name, values in read.items()}
        rows = {"base_tension": PATH, "step": np.arange(PATH.size)} | change(noisy)
        fit = cddf.fit(body, cddf.Measurements.from_columns("loop", ("simulated",), **rows))
        remarks = " ".join(fit.remarks)
        off = abs(fit.value["youngs_modulus"] / 1.4e6 - 1)
        found.append(("drift from the first row" in remarks, bool(remarks) or not fit.success, off))
    drift, every, off = np.mean(found, axis=0)
    return {"about drift, %": 100 * drift, "any, %": 100 * every, "modulus off, mean, %": 100 * off}


def markdown(results: dict[str, dict[str, float]]) -> str:
    """One row for each change."""
    head = "| changed | remark about drift, % of loops | any remark, % | mean error of the modulus, % |"
    lines = [head, "| --- | ---: | ---: | ---: |"]
    for name, row in results.items():
        drift, every, off = row.values()
        lines.append(f"| {name} | {drift:.1f} | {every:.1f} | {off:.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    configure_jax()
    results = {name: noticed(change) for name, change in CHANGES.items()}
    text = markdown(results)
    report("loop_checks", text, {"loops": LOOPS, "seed": SEED, "noticed": results})


if __name__ == "__main__":
    main()
