"""Cost of a step of `trace` in solves, and its accuracy: `python benchmarks/traces.py [BODIES] [STEPS]`.

Bodies are the paper's with friction from 0.3 to 0.5, paths are random tensions from 5 to 85 N. The same tensions are
given to `solve`. Errors are those of the tip tension, in the exact kinematics without drag, where 1/T is a play of the
inverse of the base tension.
"""

import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax


def numbers(found: Any) -> tuple[jax.Array, ...]:
    return found.tip_tension, found.tip_angle, found.tip_position, found.tendon_displacement, found.error_estimate


def traced(friction: jax.Array, path: jax.Array, drag: float | None) -> tuple[jax.Array, ...]:
    return numbers(cddf.trace(paper_body(friction_coefficient=friction, drag=drag), path, throw=False))


def solved(friction: jax.Array, path: jax.Array, drag: float | None) -> tuple[jax.Array, ...]:
    return jax.vmap(
        lambda tension: numbers(cddf.solve(paper_body(friction_coefficient=friction, drag=drag), tension, throw=False))
    )(path)


def play(ratio: np.ndarray, path: np.ndarray) -> np.ndarray:
    """The tip tension after each step, bodies first, where the tension is T / (1 + ratio T) after a pull."""
    state, tips = np.full_like(ratio, np.inf), []
    for tension in path:
        state = np.clip(state, 1 / tension - ratio, 1 / tension + ratio)
        tips.append(1 / state)
    return np.stack(tips, axis=1)


def timed(function: Callable[..., Any], *args: jax.Array) -> tuple[float, Any]:
    """The least of three times, s, and what is found."""
    compiled = jax.jit(jax.vmap(function, (0, None)))
    found, times = jax.block_until_ready(compiled(*args)), []
    for _ in range(3):
        begin = time.perf_counter()
        found = jax.block_until_ready(compiled(*args))
        times.append(time.perf_counter() - begin)
    return min(times), found


def main() -> None:
    configure_jax()
    num_bodies, num_steps = (int(x) for x in sys.argv[1:]) if len(sys.argv) > 1 else (1000, 100)
    rng = np.random.default_rng(0)
    friction, path = rng.uniform(0.3, 0.5, num_bodies), rng.uniform(5, 85, num_steps)
    lines = [f"{num_bodies} bodies, {num_steps} steps", "", "| drag, N/m | `trace`, us a step | `solve`, us | ratio |"]
    lines += ["| ---: | ---: | ---: | ---: |"]
    results: dict[str, Any] = {"bodies": num_bodies, "steps": num_steps}
    for drag in (None, 5.0):
        seconds, found = [], []
        for function in (traced, solved):
            time_taken, result = timed(
                lambda mu, path, f=function, drag=drag: f(mu, path, drag), jnp.asarray(friction), jnp.asarray(path)
            )
            seconds.append(1e6 * time_taken / num_bodies / num_steps)
            found.append(result)
        lines.append(f"| {drag or 0:g} | {seconds[0]:.2f} | {seconds[1]:.2f} | {seconds[0] / seconds[1]:.1f} |")
        results[f"drag {drag or 0:g}, us"] = dict(zip(("trace", "solve"), seconds, strict=True))
        if drag is None:
            ratio = 1 / np.asarray(found[1][0][:, 0, 0]) - 1 / path[0]
            error = np.max(np.abs(np.asarray(found[0][0]) / play(ratio, path) - 1))
            results["error"] = float(error)
    results["memory, GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    lines += ["", f"Largest error of the tip tension {results['error']:.1e}; {results['memory, GB']:.1f} GB of memory."]
    report("traces", "\n".join(lines) + "\n", results)


if __name__ == "__main__":
    main()
