"""Histories of many pairs of tendons beside an independent method in a loop: `benchmarks/pairs.py [BODIES] [STEPS]`.

The bodies are the paper's with two tendons that stretch, and friction from 0.3 to 0.5. All follow one random path of
both tensions. `trace` follows them in one program, one after the other and as a batch. The independent method is that
of `stepped_reference.py`, NumPy and SciPy, in a loop. It follows the first body only, and a few steps. Both cut the
body into 32 parts and each step into four. Times are for a step of one body, and for 1,000 bodies and 100 steps at this
rate.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import stepped_reference as plain
from paper import paper_body

import cddf_jax as cddf
from cddf_jax.application import configure_jax

PARTS, SHORT_STEPS, FEW = 32, 4, 5
STRETCH = 1e4  # N, that of the independent method


def pair() -> cddf.Manipulator:
    body = paper_body(num_tendons=2)
    stiffness = [np.asarray(STRETCH)] * 2
    return eqx.tree_at(lambda b: [t.axial_stiffness for t in b.tendons], body, stiffness, is_leaf=lambda x: x is None)


def followed(body: cddf.Manipulator, friction: jax.Array, path: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Tip angle and status after each step."""
    here = eqx.tree_at(lambda b: b.friction_coefficient, body, friction)
    how = {"nodes": PARTS // 4, "short_steps": SHORT_STEPS, "estimate_error": False, "throw": False}
    found = cddf.trace(here, path, **how)
    return found.tip_angle, found.status


def in_a_loop(friction: float, path: np.ndarray) -> np.ndarray:
    """The tip angle after each step by the independent method, rad."""
    plain.MU = friction
    body, angles, before = plain.Body((1, -1), PARTS), [], np.zeros(2)
    x = np.zeros((PARTS + 1, body.size))
    for tension in path:
        for part in np.arange(1, SHORT_STEPS + 1) / SHORT_STEPS:
            x = body.after_step(x, before + part * (tension - before), np.zeros(2))
        before = tension
        angles.append(body.tip(x)[0])
    return np.array(angles)


def timed(function, *args) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """The less of two times, s, and what is found; compiled before."""
    compiled = jax.jit(function).lower(*args).compile()
    times, found = [], None
    for _ in range(2):
        begin = time.perf_counter()
        found = jax.block_until_ready(compiled(*args))
        times.append(time.perf_counter() - begin)
    assert found is not None
    return min(times), (np.asarray(found[0]), np.asarray(found[1]))


def main() -> None:
    configure_jax()
    bodies, steps = (int(x) for x in sys.argv[1:]) if len(sys.argv) > 1 else (16, 20)
    rng, body = np.random.default_rng(0), pair()
    friction = rng.uniform(0.3, 0.5, bodies)
    path = np.stack([rng.uniform(20, 75, steps), rng.uniform(5, 30, steps)], axis=1)

    def one(mu):
        return followed(body, mu, jnp.asarray(path))

    rows = {}
    ways = {"one after the other": lambda mu: jax.lax.map(one, mu), "as a batch": jax.vmap(one)}
    for number, (name, each) in enumerate(ways.items(), 1):
        seconds, (angle, status) = timed(each, jnp.asarray(friction))
        rows[f"`trace`, {bodies} bodies, {steps} steps, {name}"] = seconds / bodies / steps
        begin = time.perf_counter()
        few = in_a_loop(friction[0], path[:FEW])
        rows[f"NumPy, 1 body, {FEW} steps, run {number}"] = (time.perf_counter() - begin) / FEW
        print(f"{name}: {np.sum(status == cddf.Status.not_converged)} of {status.size} steps did not settle")
        print(f"tip angles of both methods apart by {np.max(np.abs(angle[0, :FEW] - few)):.1e} rad at most")
    print("| what | ms a step | 1,000 bodies, 100 steps |\n| --- | ---: | ---: |")
    for name, seconds in rows.items():
        print(f"| {name} | {1e3 * seconds:.3g} | {1e5 * seconds / 60:.3g} min |")


if __name__ == "__main__":
    main()
