"""A loaded solve beside an unloaded one and beside SciPy: `python benchmarks/loads.py`.

The body is the paper's in the exact kinematics at 40 N. The loads are a tip force that helps the tendon, one that
opposes it until the curvature changes sign, and one so large that it takes several steps. SciPy solves the same
equations as a user would write them: with `solve_bvp`, and by shooting on the base moment with `solve_ivp` and
`brentq`. The error is the largest of the errors of tip tension (relative), tip angle (rad) and tip position (per
length). Its reference is shooting at a relative tolerance of 1e-13. All times are medians of one run.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from methods import median_time
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

PULL, BATCH, LENGTH, OFFSET, MU, MODULUS = 40.0, 1024, 0.140, 0.010, 0.42, 1.4e6
FORCES = {
    "no load": None,
    "helps: (0, 2) N": (0.0, 2.0),
    "opposes, kappa changes sign: (0, -10) N": (0.0, -10.0),
    "large: (0, -60) N": (0.0, -60.0),
}


def stiffness(s: Any) -> Any:
    """E J(s) of the paper's body."""
    return MODULUS * np.pi / 4 * ((0.020 - 0.007 * s / LENGTH) ** 4 - 0.007**4)


def rate(force: tuple[float, float]) -> Callable:
    """Derivatives of T, phi, x, y, M_ext."""

    def derivatives(s, state):
        tension, heading, _, _, moment = state
        kappa = (OFFSET * tension + moment) / stiffness(s)
        cos, sin = np.cos(heading), np.sin(heading)
        bend = -(cos * force[1] - sin * force[0])
        return np.array([-MU * np.abs(kappa) * tension, kappa, cos, sin, bend])

    return derivatives


def shooting(force: tuple[float, float], tolerance: float = 1e-9) -> np.ndarray:
    """The state at the tip by solve_ivp. brentq finds the base moment in ten steps of the load."""

    def tip(moment, force):
        at = {"rtol": tolerance, "atol": 1e-3 * tolerance, "method": "DOP853"}
        return solve_ivp(rate(force), (0, LENGTH), [PULL, 0, 0, 0, moment], **at).y[:, -1]

    moment, reach = 0.0, 0.25 * abs(force[1]) * LENGTH + 1e-3
    for fraction in np.linspace(0.1, 1.0, 10):
        now = (fraction * force[0], fraction * force[1])
        low, high = moment - reach, moment + reach
        root = brentq(lambda m, now=now: tip(m, now)[4], low, high, xtol=1e-14, full_output=True)[1]
        moment = float(root.root)
    return tip(moment, force)[:4]


def collocation(force: tuple[float, float]) -> np.ndarray:
    """The state at the tip by solve_bvp in five steps of the load. The kink is not located."""
    s = np.linspace(0, LENGTH, 50)
    state = np.stack([0 * s + PULL, 0 * s, s, 0 * s, 0 * s])
    found = None
    for fraction in np.linspace(0.2, 1.0, 5):
        now = (fraction * force[0], fraction * force[1])
        found = solve_bvp(
            rate(now), lambda a, b: np.array([a[0] - PULL, a[1], a[2], a[3], b[4]]), s, state, tol=1e-6, max_nodes=50000
        )
        s, state = found.x, found.y
    assert found is not None
    return found.sol(LENGTH)[:4]


def pose(equilibrium: cddf.Equilibrium) -> np.ndarray:
    return np.array([equilibrium.tip_tension[0], equilibrium.tip_angle, *equilibrium.tip_position])


def error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.max(np.abs(found - truth) / np.array([truth[0], 1.0, LENGTH, LENGTH])))


def measure(robot: cddf.Manipulator, force: tuple[float, float] | None) -> dict[str, float]:
    """Errors, and times in microseconds."""
    truth = shooting(force or (0.0, 0.0), 1e-13)

    def solve(pull, scale):
        loads = None if force is None else cddf.Loads(tip_force=scale * jnp.asarray(force))
        return cddf.solve(robot, pull, loads, throw=False)

    def tip_tension(pull, scale):
        return solve(pull, scale).tip_tension[0]

    one, many = jax.jit(solve), jax.jit(jax.vmap(tip_tension))
    slope, slopes = jax.jit(jax.grad(tip_tension, (0, 1))), jax.jit(jax.vmap(jax.grad(tip_tension, (0, 1))))
    at, batch = (PULL, 1.0), (np.linspace(20.0, 60.0, BATCH), np.linspace(0.8, 1.0, BATCH))
    row = {
        "error": error(pose(one(*at)), truth),
        "steps": float(one(*at).num_load_steps),
        "one": 1e6 * median_time(lambda: one(*at).tip_tension),
        "public call": 1e6 * median_time(lambda: solve(*at).tip_tension),
        "batch, each": 1e6 * median_time(lambda: many(*batch)) / BATCH,
        "gradient, one": 1e6 * median_time(lambda: slope(*at)),
        "gradient, batch, each": 1e6 * median_time(lambda: slopes(*batch)) / BATCH,
    }
    if force is not None:
        for name, call in {"shooting": shooting, "solve_bvp": collocation}.items():
            row[f"{name} error"] = error(call(force), truth)
            row[name] = 1e6 * median_time(lambda call=call: call(force))
    return row


def main() -> None:
    """Measure, print and save."""
    configure_jax()
    jax.config.update("jax_enable_compilation_cache", False)
    robot = cddf.read_manipulator(Path(__file__).parents[1] / "data" / "smooth_sil_940.toml")
    robot = replace(robot, kinematics="exact")
    rows = {name: measure(robot, force) for name, force in FORCES.items()}
    unloaded = rows["no load"]["one"]
    columns = list(rows["large: (0, -60) N"])
    lines = ["| load | " + " | ".join(columns) + " | one / unloaded |", "| --- |" + " ---: |" * (len(columns) + 1)]
    for name, row in rows.items():
        cells = [(f"{row[c]:.1e}" if "error" in c else f"{row[c]:.3g}") if c in row else "-" for c in columns]
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {row['one'] / unloaded:.3g} |")
    text = "Times in microseconds.\n\n" + "\n".join(lines) + "\n"
    report("loads", text, {"batch": BATCH, "rows": rows})


if __name__ == "__main__":
    main()
