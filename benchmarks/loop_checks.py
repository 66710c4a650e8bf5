"""Which creep and which mixed-up rows of a loop a fit notices: `python benchmarks/loop_checks.py`, about 10 minutes.

The loops are those of `loop_coverage.py`, 200 for each size: 33 readings of tip tension and tip angle, noise estimated.

Creep: the body goes on bending while it is measured; each tip angle is read larger by a part that grows with the row,
up to the stated part in the last one; or the zero of the camera drifts by the stated angle.
Mixed up: the rows are said to have been measured in a wrong order. A number of neighbouring pairs, by chance, are
exchanged; or all rows.
A fit notices where one of its remarks is about the order: drift, or an order that fits better. "any" counts outliers
and all other remarks too.
"""

from collections.abc import Callable

import numpy as np
from loop_coverage import NOISE, PATH, SCENARIOS, SEED, simulated
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

LOOPS = 200
OF_ORDER = ("drift from the first row", "the other way round", "than in one by chance")
Change = Callable[[dict[str, np.ndarray], np.random.Generator], dict[str, np.ndarray]]


def creeping(part: float) -> Change:
    """The tip angle grows by a part of itself until the last row."""

    def change(read: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        return read | {"tip_angle": read["tip_angle"] * (1 + part * np.arange(PATH.size) / (PATH.size - 1))}

    return change


def drifting(angle: float) -> Change:
    """The zero of the camera drifts, rad until the last row."""

    def change(read: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        return read | {"tip_angle": read["tip_angle"] + angle * np.arange(PATH.size) / (PATH.size - 1)}

    return change


def exchanged(pairs: int) -> Change:
    """Neighbouring rows, no row twice."""

    def change(read: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        order = np.arange(PATH.size)
        for first in rng.permutation(np.arange(rng.integers(2), PATH.size - 1, 2))[:pairs]:
            order[[first, first + 1]] = order[[first + 1, first]]
        return {name: values[order] for name, values in (read | {"base_tension": PATH}).items()}

    return change


def shuffled(read: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """All rows, by chance."""
    order = rng.permutation(PATH.size)
    return {name: values[order] for name, values in (read | {"base_tension": PATH}).items()}


CHANGES: dict[str, Change] = {
    "nothing": lambda read, rng: read,
    **{f"creep of the tip angle, {100 * part:g} %": creeping(part) for part in (0.01, 0.02, 0.03, 0.05, 0.1)},
    **{f"drift of the camera, {angle:g} deg": drifting(np.radians(angle)) for angle in (0.5, 1.0, 1.5, 2.0, 3.0)},
    **{f"neighbouring rows exchanged, pairs: {pairs}": exchanged(pairs) for pairs in (1, 2, 4, 8)},
    "all rows shuffled": shuffled,
}


def noticed(change: Change) -> dict[str, float]:
    """Per cent of the loops with a remark about the order, and with any remark; how far off the modulus is."""
    body, found = paper_body(), []
    read = simulated(SCENARIOS["tensions and angle"])
    for k in range(LOOPS):
        rng = np.random.default_rng((SEED, k))
        noisy = {name: values + NOISE[name] * rng.normal(size=values.size) for name, values in read.items()}
        rows = {"base_tension": PATH, "step": np.arange(PATH.size)} | change(noisy, rng)
        fit = cddf.fit(body, cddf.Measurements.from_columns("loop", notes=("simulated",), **rows))
        remarks = " ".join(fit.remarks)
        of_order = any(text in remarks for text in OF_ORDER)
        off = abs(fit.value["youngs_modulus"] / 1.4e6 - 1)
        found.append((of_order, bool(remarks) or not fit.success, off))
    order, every, off = np.mean(found, axis=0)
    return {"about the order, %": 100 * order, "any, %": 100 * every, "modulus off, mean, %": 100 * off}


def markdown(results: dict[str, dict[str, float]]) -> str:
    """One row for each change."""
    head = "| changed | remark about the order, % of loops | any remark, % | mean error of the modulus, % |"
    lines = [head, "| --- | ---: | ---: | ---: |"]
    for name, row in results.items():
        order, every, off = row.values()
        lines.append(f"| {name} | {order:.1f} | {every:.1f} | {off:.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    configure_jax()
    results = {name: noticed(change) for name, change in CHANGES.items()}
    text = markdown(results)
    report("loop_checks", text, {"loops": LOOPS, "seed": SEED, "noticed": results})


if __name__ == "__main__":
    main()
