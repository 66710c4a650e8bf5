"""The error estimate of 1,000 random bodies under loads that bend them far and turn their tendons over.

    python benchmarks/error_estimate.py

For each group: how many were solved, in how many the curvature changes its sign, the errors of tip tension
and tip position, and whether the estimate is ever below the error. The errors are differences from solves with 160
nodes in each piece; those with 96 differ from them by as much as is told. An error below 1e-12 counts as rounding.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf

ROUNDING = 1e-12
IN_ALL, IN_SPACE = 250, 125


class Group(NamedTuple):
    """Random bodies of one shape, so that one program solves them all."""

    body: cddf.Manipulator
    size: int
    components: int  # of the force on the tip


def groups() -> dict[str, Group]:
    slanted = {"tendon_offset": (0.010, 0.010)}
    helix = cddf.Tendon(0.010, angle=cddf.Linear(0.0, 2.0, 0.140))
    names = "length", "outer_radius", "inner_radius", "youngs_modulus", "friction_coefficient"
    paper = paper_body()
    in_space = cddf.Manipulator(**{name: getattr(paper, name) for name in names}, tendons=(helix,))
    return {
        "one parallel tendon": Group(paper_body(), IN_ALL, 2),
        "one slanted tendon": Group(paper_body(**slanted), IN_ALL, 2),
        "a slanted pair": Group(paper_body(num_tendons=2, **slanted), IN_ALL, 2),
        "a winding tendon in space": Group(in_space, IN_SPACE, 3),
        "published, a slanted pair": Group(paper_body(kinematics="published", num_tendons=2, **slanted), IN_SPACE, 2),
    }


def random_numbers(group: Group, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Factors on all numbers of the body from 1/1.4 to 1.4, tensions up to where d kappa is 0.4, and a force."""
    leaves = jax.tree.leaves(eqx.filter(group.body, eqx.is_inexact_array_like))
    factors = np.exp(rng.uniform(-0.3, 0.3, (group.size, len(leaves))))
    tension = rng.uniform(1.0, 80.0, (group.size, group.body.num_tendons))
    force = rng.normal(size=(group.size, group.components)) * np.exp(rng.uniform(-2.0, 2.3, (group.size, 1)))
    return factors, tension, force


@partial(jax.jit, static_argnames=("nodes", "static"))
def _solved(numbers: tuple, arrays: Any, static: Any, nodes: int) -> tuple:
    def one(factors, tension, force):
        leaves, structure = jax.tree.flatten(arrays)
        body = eqx.combine(structure.unflatten([x * f for x, f in zip(leaves, factors, strict=True)]), static)
        direction = tuple([1.0] * body.num_tendons)
        loads = cddf.Loads(tip_force=force)
        found = cddf.solve(body, tension, loads, direction=direction, nodes=nodes, throw=False)
        turning = found.curvature if found.curvature.ndim == 1 else found.curvature[:, 1]
        both = (jnp.min(turning) < 0) & (jnp.max(turning) > 0)
        place = found.tip_position / jnp.asarray(body.length)
        return found.status, found.tip_tension, place, found.tip_angle, found.error_estimate, both

    return jax.vmap(one)(*numbers)


def row(name: str, group: Group, rng: np.random.Generator) -> str:
    """A line of the table."""
    arrays, static = eqx.partition(jax.tree.map(jnp.asarray, group.body), eqx.is_inexact_array)
    numbers = tuple(map(jnp.asarray, random_numbers(group, rng)))
    found, fine, finer = (jax.device_get(_solved(numbers, arrays, static, nodes)) for nodes in (16, 96, 160))

    def errors(one: tuple, other: tuple) -> tuple[np.ndarray, np.ndarray]:
        tension = np.max(np.abs(one[1] / other[1] - 1), axis=1)
        place = np.max(np.abs(one[2] - other[2]), axis=1)
        return tension, np.maximum(place, np.abs(one[3] - other[3]))

    good = np.isin(found[0], [0, 1, 2]) & np.isin(finer[0], [0, 1, 2])
    tension, shape = (x[good] for x in errors(found, finer))
    reference = np.maximum(*errors(fine, finer))[good]
    both, estimate = np.maximum(tension, shape), found[4][good]
    below = np.sum((estimate < both) & (both > ROUNDING))
    worst = np.max(both / np.maximum(estimate, ROUNDING))
    parts = [f"{np.sum(good)} of {group.size}", np.sum(found[5][good]), np.sum(found[0][good] == 2)]
    spread = [f"{np.median(x):.0e}, {np.quantile(x, 0.95):.0e}, {np.max(x):.0e}" for x in (tension, shape)]
    return f"| {' | '.join(map(str, [name, *parts, *spread, below, f'{worst:.2f}', f'{np.max(reference):.0e}']))} |"


def main() -> None:
    rng = np.random.default_rng(7)
    head = ["bodies", "solved", "with both signs", "inaccurate", "error of tip tension: median, 95 %, largest"]
    head += ["of place and angle", "estimate below the error", "largest error over estimate", "96 against 160 nodes"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for name, group in groups().items():
        lines.append(row(name, group, rng))
        print(lines[-1], flush=True)
    report("error_estimate", "\n".join(lines) + "\n", {"rows": lines[2:]})


if __name__ == "__main__":
    with jax.enable_x64(True):
        main()
