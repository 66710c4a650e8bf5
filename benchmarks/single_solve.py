"""One solve at a time, warm: `python benchmarks/single_solve.py`, a minute.

Wall times of `cddf.solve(...)`, which returns when the result is known, and of the same inside a `jax.jit` that returns
the tip tensions and the tip position alone. Calls of the same kind follow each other. Rounds of all kinds alternate;
the table holds medians over rounds of the medians in a round. Bodies: the paper's with one tendon in the plane and with
three tendons around it in space, and the made-up helix of `data/`. The error estimate of each answer stands beside it.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from batch import paper
from space import three_tendons
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

CALLS, ROUNDS = 200, 7
HELIX = Path(__file__).parents[1] / "data" / "helix_made_up.toml"


def helix() -> cddf.Manipulator:
    """The made-up body whose tendon winds by half a turn."""
    return cddf.read_manipulator(HELIX)


CASES: dict[str, tuple[Callable[[], cddf.Manipulator], tuple[float, ...], tuple[float, ...] | None]] = {
    "one tendon in the plane": (paper, (40.0,), None),
    "the same under (0, -1) N": (paper, (40.0,), (0.0, -1.0)),
    "three tendons": (three_tendons, (20.0, 5.0, 10.0), None),
    "the same under (0.3, -0.5, 0.7) N": (three_tendons, (20.0, 5.0, 10.0), (0.3, -0.5, 0.7)),
    "half a helix": (helix, (40.0,), None),
    "the same under (0, 0.1, 0.2) N": (helix, (40.0,), (0.0, 0.1, 0.2)),
}


def tip(*given: Any) -> tuple:
    """Tip tensions and position."""
    found = cddf.solve(*given, direction=1.0, throw=False)
    return found.tip_tension, found.tip_position


def median_ms(call: Callable[[], Any]) -> float:
    """The median of calls that follow each other."""
    spent = []
    for _ in range(CALLS):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(spent))


def main() -> None:
    """Measure, print and save."""
    configure_jax()
    calls: dict[tuple[str, str], Callable[[], Any]] = {}
    errors = {}
    for name, (body, pull, force) in CASES.items():
        given = body(), jnp.asarray(pull), None if force is None else cddf.Loads(tip_force=force)
        inside = jax.jit(tip)
        calls[name, "solve, ms"] = lambda given=given: cddf.solve(*given, direction=1.0)
        calls[name, "inside a jit, ms"] = lambda given=given, inside=inside: jax.block_until_ready(inside(*given))
        errors[name] = float(cddf.solve(*given, direction=1.0).error_estimate)
    for call in calls.values():
        call()
    rounds = [{key: median_ms(call) for key, call in calls.items()} for _ in range(ROUNDS)]
    rows = {name: {"error estimate": error} for name, error in errors.items()}
    for name, what in calls:
        rows[name][what] = float(np.median([times[name, what] for times in rounds]))
    lines = ["| what | `solve`, ms | inside a jit, ms | error estimate |", "| --- | ---: | ---: | ---: |"]
    for name, row in rows.items():
        lines.append(
            f"| {name} | {row['solve, ms']:.2f} | {row['inside a jit, ms']:.2f} | {row['error estimate']:.1e} |"
        )
    report("single_solve", "\n".join(lines) + "\n", rows)


if __name__ == "__main__":
    main()
