"""A batch of solves in space beside a compiled loop: `python benchmarks/space.py`, some minutes.

The body is the paper's with three parallel tendons, 120 degrees apart, which all slide in. The three tensions differ
from solve to solve. Outputs are the tip tensions and the tip position, and once also the error estimate and how the
solve ended, which the loop does not tell. Beside `solve` runs what a numba user would
write for exactly this case: tensions, rotation (a quaternion) and position by RK4, in parallel on both cores. All calls
run in turn in one process; times are medians. Errors are those of the tip tension (relative) and of the tip position
(m), the largest of all samples, against RK4 of 512 steps, which shares nothing with `solve`.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from batch import DEVICES, batched, interleaved, on_devices, paper
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

COUNT, CHUNK = 102_400, 1_280
STEPS, FEWER = (8, 16, 32), (5, 6, 8)  # of RK4; nodes beside the default of 16
ANGLES = np.radians([0.0, 120.0, 240.0])


def three_tendons() -> cddf.Manipulator:
    """The paper's body with three tendons around it."""
    plane = paper()
    offset = plane.tendons[0].offset
    fields = {name: getattr(plane, name) for name in ("length", "outer_radius", "inner_radius", "youngs_modulus")}
    return cddf.Manipulator(
        **fields,
        friction_coefficient=plane.friction_coefficient,
        tendons=tuple(cddf.Tendon(offset, angle=angle) for angle in ANGLES),
    )


def tip(robot: cddf.Manipulator, nodes: int) -> Callable[..., Any]:
    """T_tip and u(L) as a function of the three base tensions."""

    def at(*tensions):
        found = cddf.solve(robot, jnp.stack(tensions), direction=1.0, nodes=nodes, throw=False)
        return found.tip_tension, found.tip_position

    return at


def judged(robot: cddf.Manipulator) -> Callable[..., Any]:
    """The same, with the error estimate and the status."""

    def at(*tensions):
        found = cddf.solve(robot, jnp.stack(tensions), direction=1.0, throw=False)
        return found.tip_tension, found.tip_position, found.error_estimate[None], found.status[None]

    return at


@numba.njit
def rate(state, stiffness, mu, y, z, out):
    """T' = -mu |u x e_x| T, q' = q (0, u) / 2, r' = R e_x with u = (0, -sum T z, sum T y) / (E J)."""
    u2, u3 = 0.0, 0.0
    for i in range(3):
        u2 -= state[i] * z[i] / stiffness
        u3 += state[i] * y[i] / stiffness
    turning = np.sqrt(u2 * u2 + u3 * u3)
    for i in range(3):
        out[i] = -mu * turning * state[i]
    a, b, c, d = state[3], state[4], state[5], state[6]
    out[3] = 0.5 * (-c * u2 - d * u3)
    out[4] = 0.5 * (c * u3 - d * u2)
    out[5] = 0.5 * (a * u2 - b * u3)
    out[6] = 0.5 * (a * u3 + b * u2)
    out[7] = a * a + b * b - c * c - d * d
    out[8] = 2.0 * (b * c + a * d)
    out[9] = 2.0 * (b * d - a * c)


@numba.njit(parallel=True)
def runge_kutta(tensions, stiffness, length, mu, y, z, out):
    """RK4 with stiffness at the ends and the middles of the steps."""
    steps = stiffness.size // 2
    h = length / steps
    for i in numba.prange(tensions.shape[0]):
        state, k1, k2, k3, k4 = np.zeros(10), np.empty(10), np.empty(10), np.empty(10), np.empty(10)
        state[:3] = tensions[i]
        state[3] = 1.0
        for k in range(steps):
            rate(state, stiffness[2 * k], mu, y, z, k1)
            rate(state + 0.5 * h * k1, stiffness[2 * k + 1], mu, y, z, k2)
            rate(state + 0.5 * h * k2, stiffness[2 * k + 1], mu, y, z, k3)
            rate(state + h * k3, stiffness[2 * k + 2], mu, y, z, k4)
            for j in range(10):
                state[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
        out[i, :3], out[i, 3:] = state[:3], state[7:]


def numba_loop(robot: cddf.Manipulator, steps: int) -> Callable[..., np.ndarray]:
    """A function that runs the loop over samples."""
    length, offset = float(robot.length), float(robot.tendons[0].offset(0.0))
    stiffness = np.asarray(robot.stiffness(jnp.linspace(0.0, length, 2 * steps + 1)))
    y, z = offset * np.cos(ANGLES), offset * np.sin(ANGLES)

    def run(*tensions):
        given = np.column_stack([np.asarray(x) for x in tensions])
        out = np.empty((len(given), 6))
        runge_kutta(given, stiffness, length, float(robot.friction_coefficient), y, z, out)
        return out

    return run


def columns(found: Any) -> np.ndarray:
    """Tip tensions and position of every sample."""
    return found if isinstance(found, np.ndarray) else np.column_stack([np.asarray(x) for x in found])


def main() -> None:
    """Run, print and store the table."""
    configure_jax(all_cores=True)
    jax.config.update("jax_num_cpu_devices", DEVICES)
    robot, rng = three_tendons(), np.random.default_rng(0)
    samples = tuple(jax.device_put(jnp.asarray(rng.uniform(1.0, 40.0, COUNT)), on_devices()) for _ in range(3))
    exact = numba_loop(robot, 512)(*samples)
    functions = {"solve": batched(tip(robot, 16), CHUNK)}
    functions["solve, with error estimate and result"] = batched(judged(robot), CHUNK)
    functions |= {f"solve, {nodes} nodes": batched(tip(robot, nodes), CHUNK) for nodes in FEWER}
    functions |= {f"RK4 of {steps} steps, numba": numba_loop(robot, steps) for steps in STEPS}
    times = interleaved({name: lambda f=f: f(*samples) for name, f in functions.items()})
    rows = {}
    for name, function in functions.items():
        found = columns(function(*samples))
        rows[name] = {
            "us": 1e6 * times[name] / COUNT,
            "over solve": times[name] / times["solve"],
            "tension error": float(np.nanmax(np.abs(found[:, :3] / exact[:, :3] - 1))),
            "position error": float(np.nanmax(np.abs(found[:, 3:6] - exact[:, 3:]))),
        }
    lines = ["| what | us a solve | times as long as `solve` | error of T_tip | error of the position, m |"]
    lines += ["| --- | ---: | ---: | ---: | ---: |"]
    for name, row in rows.items():
        errors = f"{row['tension error']:.1e} | {row['position error']:.1e}"
        lines.append(f"| {name} | {row['us']:.3f} | {row['over solve']:.2f} | {errors} |")
    report("space", "\n".join(lines) + "\n", rows)


if __name__ == "__main__":
    main()
