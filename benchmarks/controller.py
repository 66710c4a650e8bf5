"""One step of `trace` after another, as a controller takes them: `python benchmarks/controller.py`.

Tensions go around a circle in 50 steps. Each step continues the history of the one before, in a compiled function. The
same path with twice the elements and four times the increments shows the error.
"""

import time
from typing import Any

import jax
import numpy as np
from paper import paper_body

import cddf_jax as cddf
from cddf_jax.application import configure_jax

STEPS = 50


def three_tendons() -> cddf.Manipulator:
    return cddf.Manipulator(
        length=0.200,
        outer_radius=0.011,
        inner_radius=0.003,
        youngs_modulus=1.0e6,
        friction_coefficient=0.3,
        density=1070.0,
        tendons=[cddf.Tendon(offset=0.0085, angle=k * 2 * np.pi / 3) for k in range(3)],
    )


def followed(
    body: cddf.Manipulator, path: np.ndarray, loads: cddf.Loads | None, **finer: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The time of each step after the first, ms, and tip position and tip tensions after it."""
    how: dict[str, Any] = {"estimate_error": False, "throw": False, **finer}
    history = cddf.trace(body, path[:1], loads, **how)
    step = jax.jit(lambda history, pull: cddf.trace(body, pull[None], loads, start=history, **how))
    jax.block_until_ready(step(step(history, path[0]), path[0]))  # compiles, also for the history of a step
    times, positions, tensions = [], [], []
    for pull in path[1:]:
        begin = time.perf_counter()
        history = jax.block_until_ready(step(history, pull))
        times.append(1e3 * (time.perf_counter() - begin))
        positions.append(history.tip_position[-1])
        tensions.append(history.tip_tension[-1])
    return np.array(times), np.array(positions), np.array(tensions)


def main() -> None:
    configure_jax()
    turns = np.linspace(0.0, 2 * np.pi, STEPS)
    star = np.stack([4.0 + 2.5 * np.cos(turns - k * 2 * np.pi / 3) for k in range(3)], axis=1)
    both = np.stack([40.0 + 25.0 * np.cos(turns), 40.0 - 25.0 * np.cos(turns)], axis=1)
    cases = {
        "three tendons in space, gravity": (three_tendons(), star, cddf.Loads(gravity=(9.81, 0.0, 0.0))),
        "two tendons in the plane": (paper_body(num_tendons=2), both, None),
        "two tendons in the plane, a force": (paper_body(num_tendons=2), both, cddf.Loads(tip_force=(0.0, 0.3))),
    }
    print("| body | median, ms | least | largest | position, of the length | tip tension |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for name, (body, path, loads) in cases.items():
        times, positions, tensions = followed(body, path, loads)
        _, near, exact = followed(body, path, loads, nodes=32, short_steps=64)
        off = np.max(np.abs(positions - near)) / float(body.length), np.max(np.abs(tensions - exact)) / np.max(exact)
        shown = [f"{ms:.1f}" for ms in (np.median(times), np.min(times), np.max(times))]
        print("|", " | ".join([name, *shown, *(f"{error:.1e}" for error in off)]), "|", flush=True)


if __name__ == "__main__":
    main()
