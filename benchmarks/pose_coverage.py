"""How often 95 % intervals from poses in space contain the true value: `python benchmarks/pose_coverage.py`.

A body of 200 mm with three tendons at 120 degrees is pulled to 40 poses, one after another: in each pose one or two
tendons at random have 2 to 14 N, the others 0.6 N. Base cells have 0.04 N of noise; a tracker sees the tip from an
unknown place and direction, with 0.4 mm of noise. Both are given to the fit; with `--estimated` that of the base cells
is not. Friction coefficient, modulus and the six numbers of the tracker's frame are fitted. The benches are simulated
with twice the elements and increments of the fit. The seed is fixed beforehand, 22; bench k is drawn from (22, k), its
poses too.

Each bench is fitted with history. `--without` fits them without history, as if each pose were pulled from rest.
`--linear` takes a model that is linear about the truth in place of the fit, with the same noise: it tells which
intervals miss the truth because of the noise that was drawn.
"""

import argparse
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from loop_coverage import summary
from scipy.spatial.transform import Rotation
from scipy.stats import norm
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

SEED, POSES = 22, 40
LOW, CELL, TRACKER = 0.6, 0.04, 4e-4  # N, N, m
TRUTH = {"friction_coefficient": 0.186, "youngs_modulus": 1.06e6}
START = {"friction_coefficient": 0.25, "youngs_modulus": 1e6}
ANGLES = (0.11, 0.11 + 2 * np.pi / 3, 0.11 + 4 * np.pi / 3)


def body_of(friction_coefficient: float, youngs_modulus: float) -> cddf.Manipulator:
    """A tube of silicone with three tendons."""
    return cddf.Manipulator(
        length=0.2,
        outer_radius=0.0114,
        inner_radius=0.003,
        youngs_modulus=youngs_modulus,
        friction_coefficient=friction_coefficient,
        tendons=tuple(cddf.Tendon(offset=0.0086, angle=angle) for angle in ANGLES),
    )


class Draw(NamedTuple):
    """What is drawn for a bench."""

    pulls: np.ndarray  # (poses, 3), N
    turn: np.ndarray  # (3, 3), of the tracker
    place: np.ndarray  # (3,), m
    off: np.ndarray  # (poses, 3), m, the noise of the tracker in its own frame
    misread: np.ndarray  # (poses, 3), N, the noise of the base cells


def drawn(number: int) -> Draw:
    """Bench `number`."""
    rng = np.random.default_rng((SEED, number))
    pulls = np.full((POSES, 3), LOW)
    for row in pulls:
        pulled = rng.permutation(3)[: rng.integers(1, 3)]
        row[pulled] = rng.uniform(2.0, 14.0, pulled.size)
    turn, place = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(scale=0.3, size=3)
    return Draw(pulls, turn, place, TRACKER * rng.normal(size=(POSES, 3)), CELL * rng.normal(size=pulls.shape))


def bench(draw: Draw) -> cddf.Measurements:
    """One simulated table."""
    history = cddf.trace(body_of(**TRUTH), draw.pulls, nodes=22, short_steps=8, throw=False)
    tip = np.asarray(history.tip_position) @ draw.turn.T + draw.place + draw.off
    read = draw.pulls + draw.misread
    columns = {f"base_tension{end}": read[:, i] for i, end in enumerate(("", "_2", "_3"))}
    columns |= {f"tip_{axis}": tip[:, i] for i, axis in enumerate("xyz")} | {"step": np.arange(POSES)}
    return cddf.Measurements.from_columns("poses", ("simulated",), **columns)


def coverage(numbers: range, history: bool, estimated: bool) -> dict[str, Any]:
    """Per cent of the intervals that hold the truth."""
    held, errors, lost, named = [], [], 0, 0
    noise = dict.fromkeys(("tip_x", "tip_y", "tip_z"), TRACKER) | ({} if estimated else {"base_tension": CELL})
    for k in numbers:
        fit = cddf.fit(
            body_of(**START),
            bench(drawn(k)),
            (*TRUTH, "camera"),
            noise=noise,
            history=history,
        )
        if not fit.success:
            lost += 1
            print(f"bench {k}: {fit.result}", flush=True)
            continue
        named += all(status == "identified" for status in fit.status.values())
        ends = [fit.confidence_interval[name] for name in TRUTH]
        held.append([low <= true <= high for (low, high), true in zip(ends, TRUTH.values(), strict=True)])
        errors.append([(fit.value[name] - true) / fit.standard_error[name] for name, true in TRUTH.items()])
        print(f"bench {k}: errors of {errors[-1][0]:.2f} and {errors[-1][1]:.2f} standard errors", flush=True)
    return summary(TRUTH, held, errors, lost) | {"all eight identified": named}


@jax.jit
def slopes(truth: jax.Array, pulls: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The tip of each pose, m; its slopes by the logarithms of friction coefficient and modulus, and by the pulls."""

    def tip(logarithms: jax.Array, pulls: jax.Array) -> jax.Array:
        own = tuple(truth * jnp.exp(logarithms))
        body = eqx.tree_at(lambda body: (body.friction_coefficient, body.youngs_modulus), body_of(**TRUTH), own)
        return cddf.trace(body, pulls, estimate_error=False, throw=False).tip_position

    found, push = jax.linearize(tip, jnp.zeros(2), pulls)
    by_truth = jax.vmap(lambda unit: push(unit, 0.0 * pulls))(jnp.eye(2))
    units = jnp.eye(pulls.size).reshape(-1, *pulls.shape)
    return found, by_truth, jax.lax.map(lambda unit: push(jnp.zeros(2), unit), units, batch_size=30)


def linear_coverage(numbers: range) -> dict[str, Any]:
    """As `coverage`, of weighted linear regression about the truth: its errors are normal, with the variance stated."""
    errors = []
    for k in numbers:
        draw = drawn(k)
        tip, by_truth, by_pulls = map(np.asarray, slopes(jnp.array(list(TRUTH.values())), draw.pulls))
        by_turn = np.stack([np.cross(axis, tip) for axis in np.eye(3)])
        by_place = np.broadcast_to(np.eye(3)[:, None], (3, POSES, 3))
        jacobian = np.concatenate([by_truth, by_turn, by_place]).reshape(8, -1).T
        by_pulls = by_pulls.reshape(draw.pulls.size, -1).T
        root = np.linalg.cholesky(TRACKER**2 * np.eye(3 * POSES) + CELL**2 * by_pulls @ by_pulls.T)
        left = (draw.off @ draw.turn).ravel() - by_pulls @ draw.misread.ravel()
        q, r = np.linalg.qr(np.linalg.solve(root, jacobian))
        found, spread = np.linalg.solve(r, q.T @ np.linalg.solve(root, left)), np.linalg.inv(r)
        errors.append((found / np.linalg.norm(spread, axis=1))[:2])
        print(f"bench {k}: errors of {errors[-1][0]:.2f} and {errors[-1][1]:.2f} standard errors", flush=True)
    held = [[abs(error) < norm.ppf(0.975) for error in each] for each in errors]
    return summary(TRUTH, held, errors, 0) | {"all eight identified": len(held)}


def markdown(row: dict[str, Any]) -> str:
    """The table of one run."""
    held = row["intervals that hold the truth, %"]
    shares = (held[name] / 100 for name in TRUTH)
    cells = " | ".join(f"{100 * p:.1f} ± {100 * np.sqrt(p * (1 - p) / row['fits']):.1f}" for p in shares)
    lines = ["| benches | failed | all eight identified | mu, % | E, % |", "| ---: | ---: | ---: | ---: | ---: |"]
    return "\n".join([*lines, f"| {row['fits']} | {row['failed']} | {row['all eight identified']} | {cells} |"]) + "\n"


def main() -> None:
    """Simulate, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the number of the first one")
    parser.add_argument("--estimated", action="store_true", help="the noise of the base cells is estimated")
    parser.add_argument("--without", action="store_true", help="fit without history")
    parser.add_argument("--linear", action="store_true", help="a model that is linear about the truth, not fitted")
    asked = parser.parse_args()
    configure_jax()
    numbers = range(asked.first, asked.first + asked.benches)
    row = linear_coverage(numbers) if asked.linear else coverage(numbers, not asked.without, asked.estimated)
    ways = {"_linear": asked.linear, "_without_history": asked.without, "_estimated": asked.estimated}
    name = "".join(["pose_coverage", *(way for way, chosen in ways.items() if chosen)])
    report(name, markdown(row), {"seed": SEED, "results": row})


if __name__ == "__main__":
    main()
