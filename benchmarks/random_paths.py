"""How many random paths of several tendons settle, in the plane and in space, with loads and without.

Each path has 12 steps. Of the tensions, up to 50 N, four of ten stay from step to step and one of seven is 0 N.
Friction is 0.1 to 0.6. Without an argument all kinds of bodies are followed; `python random_paths.py space 3 loaded 64`
is one kind with its number of paths.
"""

import sys

import equinox as eqx
import jax
import numpy as np

import cddf_jax as cddf

jax.config.update("jax_enable_x64", True)
LENGTH, STEPS, PATHS, LARGEST = 0.14, 12, 64, 50.0


def robot(in_space: bool, count: int) -> cddf.Manipulator:
    """A tapered body; every second tendon is slanted, and in space every third winds by one radian."""
    tendons = []
    for i in range(count):
        offset = cddf.Linear(0.010, 0.008, LENGTH) if i % 2 else 0.009 + (0.0 if in_space else 0.0005 * i)
        start = 2 * np.pi * i / count
        angle = cddf.Linear(start, start + (1.0 if i % 3 == 0 else 0.0), LENGTH) if in_space else None
        tendons.append(cddf.Tendon(offset, side=-1 if i % 2 and not in_space else 1, angle=angle))
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=cddf.Linear(0.012, 0.010, LENGTH),
        inner_radius=0.004,
        youngs_modulus=1.4e6,
        friction_coefficient=0.3,
        tendons=tuple(tendons),
    )


def settled(in_space: bool, count: int, loaded: bool, paths: int) -> tuple[int, int, int]:
    """Of random paths, how many settled in all steps; of all their steps, how many were inaccurate; steps in all."""
    rng, body = np.random.default_rng(count), robot(in_space, count)
    followed = jax.jit(lambda mu, pulls, loads: _status(body, mu, pulls, loads))
    good = inaccurate = 0
    for _ in range(paths):
        pulls = rng.uniform(0.0, LARGEST, (STEPS, count)) * (rng.random((STEPS, count)) > 1 / 7)
        for step in range(1, STEPS):
            pulls[step] = np.where(rng.random(count) < 0.4, pulls[step - 1], pulls[step])
        force = 0.4 * rng.normal(size=(STEPS, 3 if in_space else 2))
        status = np.asarray(followed(rng.uniform(0.1, 0.6), pulls, cddf.Loads(tip_force=force) if loaded else None))
        good += bool(np.all(status != cddf.Status.not_converged))
        inaccurate += int(np.sum(status == cddf.Status.inaccurate))
    return good, inaccurate, paths * STEPS


def _status(body: cddf.Manipulator, mu: jax.Array, pulls: jax.Array, loads: cddf.Loads | None) -> jax.Array:
    body = eqx.tree_at(lambda b: b.friction_coefficient, body, mu)
    return cddf.trace(body, pulls, loads, nodes=8, short_steps=8, throw=False).status


if __name__ == "__main__":
    kinds = [(space, count, load) for space in (False, True) for count in (1, 2, 3, 4) for load in (False, True)]
    paths = PATHS
    if sys.argv[1:]:
        kinds, paths = [(sys.argv[1] == "space", int(sys.argv[2]), sys.argv[3] == "loaded")], int(sys.argv[4])
    for in_space, count, loaded in kinds:
        good, inaccurate, steps = settled(in_space, count, loaded, paths)
        words = f"{'space' if in_space else 'plane'}, {count} tendons, {'a force' if loaded else 'no loads'}"
        print(f"| {words} | {good} of {paths} | {inaccurate} of {steps} |", flush=True)
