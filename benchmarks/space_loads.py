"""A batch in space under a tip force beside compiled shooting: `python benchmarks/space_loads.py`, some minutes.

The body is that of `space.py`: three parallel tendons, which all slide in. Tensions and all three components of the
tip force differ from solve to solve. Outputs are the tip tensions and the tip position. `solve` runs its lanes one
after the other on each of two devices. Beside it runs what a numba user would write for exactly this case, in parallel
on both cores: tensions, rotation (a quaternion) and position by RK4, the curvature by Newton's method at every place,
and shooting on the moment at the base. Its three numbers are found until the moment at the tip is gone: by Newton's
method with a Jacobian of differences, or by Broyden's, which starts with that of a rigid body and needs fewer shots.
Shooting does not ask which equilibrium it found, nor whether that is stable, and has no error estimate.

All calls run in turn in one process; times are medians. Errors are those of the tip tension (relative) and of the tip
position (m) against shooting with 2048 steps, the median and the largest of all samples.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from batch import DEVICES, interleaved, on_devices
from space import ANGLES, columns, three_tendons
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

COUNT = 1_024
PULLS, FORCES = (5.0, 40.0), (0.1, 1.0)  # N: the tensions, and the largest of each component of the tip force
NODES, EXACT = (16, 8), 2048  # of `solve`, and the steps of the reference
STEPS = {16: 1e-9, 32: 1e-9, 128: 1e-11, 512: 1e-12, EXACT: 1e-12}  # of RK4, and the moment left at the tip, N m
SHOTS, ITERATIONS, DIFFERENCE = 40, 3, 1e-6
TWIST = 2.0 / 3.0  # G J_polar over E J where Poisson's ratio is 0.5


def tip(robot: cddf.Manipulator, nodes: int) -> Callable[..., Any]:
    """T_tip and u(L) as a function of the base tensions and the tip force."""

    def at(tensions, force):
        loads = cddf.Loads(tip_force=force)
        found = cddf.solve(robot, tensions, loads, direction=1.0, nodes=nodes, throw=False)
        return found.tip_tension, found.tip_position

    return at


def one_by_one(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function over a batch: an equal share on each device, one lane after the other."""
    mesh, lanes = on_devices().mesh, on_devices().spec

    def share(*inputs):
        return jax.lax.map(lambda x: function(*x), inputs)

    return jax.jit(jax.shard_map(share, mesh=mesh, in_specs=(lanes, lanes), out_specs=lanes))


@numba.njit
def solve_three(H, right, out):
    """H out = right, for H symmetric, by Cramer's rule."""
    a, b, c, d, e, f = H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    one = 1.0 / (a * A + b * B + c * C)
    out[0] = one * (A * right[0] + B * right[1] + C * right[2])
    out[1] = one * (B * right[0] + (a * f - c * c) * right[1] + (b * c - a * e) * right[2])
    out[2] = one * (C * right[0] + (b * c - a * e) * right[1] + (a * d - b * b) * right[2])


@numba.njit
def tangents(u, y, z, t, b):
    """The directions t = w / |w| with w = e_x + u x rho, and |w|, and b = rho x t, of three tendons."""
    for i in range(3):
        w0, w1, w2 = 1.0 + u[1] * z[i] - u[2] * y[i], -u[0] * z[i], u[0] * y[i]
        size = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        t[i, 0], t[i, 1], t[i, 2], t[i, 3] = w0 / size, w1 / size, w2 / size, size
        b[i, 0], b[i, 1], b[i, 2] = y[i] * t[i, 2] - z[i] * t[i, 1], z[i] * t[i, 0], -y[i] * t[i, 0]


@numba.njit
def rate(state, bend, slope, mu, y, z, moment, force, u, work, out):
    """T', q' and r' where E J is `bend` and its derivative `slope`; u is a guess, and then the curvature.

    K u + sum T rho x t = R^T M with M = M(0) - r x F tells u, and its derivative along the body u'. The rate of a
    tension T' = -mu |t' + u x t| T depends on u', and u' on T': a few iterations find both.
    """
    H, right, more, t, b = work[0:3], work[3], work[4], work[5:8], work[8:11]
    q0, q1, q2, q3 = state[3], state[4], state[5], state[6]
    x0, x1, x2 = q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3, 2.0 * (q1 * q2 + q0 * q3), 2.0 * (q1 * q3 - q0 * q2)
    y0, y1, y2 = 2.0 * (q1 * q2 - q0 * q3), q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3, 2.0 * (q2 * q3 + q0 * q1)
    z0, z1, z2 = 2.0 * (q1 * q3 + q0 * q2), 2.0 * (q2 * q3 - q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3
    M0 = moment[0] - state[8] * force[2] + state[9] * force[1]
    M1 = moment[1] - state[9] * force[0] + state[7] * force[2]
    M2 = moment[2] - state[7] * force[1] + state[8] * force[0]
    m0, m1, m2 = x0 * M0 + x1 * M1 + x2 * M2, y0 * M0 + y1 * M1 + y2 * M2, z0 * M0 + z1 * M1 + z2 * M2
    for _ in range(6):
        tangents(u, y, z, t, b)
        H[:] = 0.0
        H[0, 0], H[1, 1], H[2, 2] = TWIST * bend, bend, bend
        right[0], right[1], right[2] = m0 - TWIST * bend * u[0], m1 - bend * u[1], m2 - bend * u[2]
        for i in range(3):
            T = state[i] / t[i, 3]
            H[0, 0] += T * (y[i] * y[i] + z[i] * z[i] - b[i, 0] * b[i, 0])
            H[0, 1] -= T * b[i, 0] * b[i, 1]
            H[0, 2] -= T * b[i, 0] * b[i, 2]
            H[1, 1] += T * (z[i] * z[i] - b[i, 1] * b[i, 1])
            H[1, 2] -= T * (y[i] * z[i] + b[i, 1] * b[i, 2])
            H[2, 2] += T * (y[i] * y[i] - b[i, 2] * b[i, 2])
            for j in range(3):
                right[j] -= state[i] * b[i, j]
        solve_three(H, right, more)
        for j in range(3):
            u[j] += more[j]
        if abs(more[0]) + abs(more[1]) + abs(more[2]) < 1e-10:
            break
    f1, f2 = y0 * force[0] + y1 * force[1] + y2 * force[2], z0 * force[0] + z1 * force[1] + z2 * force[2]
    m0, m1, m2 = u[2] * m1 - u[1] * m2, u[0] * m2 - u[2] * m0 + f2, u[1] * m0 - u[0] * m1 - f1  # their derivatives
    more[:] = 0.0  # u'; T' without it is the start
    for k in range(ITERATIONS + 1):
        for i in range(3):
            w0, w1, w2 = more[1] * z[i] - more[2] * y[i], -more[0] * z[i], more[0] * y[i]
            along = w0 * t[i, 0] + w1 * t[i, 1] + w2 * t[i, 2]
            c0 = (w0 - along * t[i, 0]) / t[i, 3] + u[1] * t[i, 2] - u[2] * t[i, 1]
            c1 = (w1 - along * t[i, 1]) / t[i, 3] + u[2] * t[i, 0] - u[0] * t[i, 2]
            c2 = (w2 - along * t[i, 2]) / t[i, 3] + u[0] * t[i, 1] - u[1] * t[i, 0]
            out[i] = -mu * np.sqrt(c0 * c0 + c1 * c1 + c2 * c2) * state[i]
        if k < ITERATIONS:
            right[0], right[1], right[2] = m0 - TWIST * slope * u[0], m1 - slope * u[1], m2 - slope * u[2]
            for i in range(3):
                for j in range(3):
                    right[j] -= out[i] * b[i, j]
            solve_three(H, right, more)
    out[3] = -0.5 * (q1 * u[0] + q2 * u[1] + q3 * u[2])
    out[4] = 0.5 * (q0 * u[0] + q2 * u[2] - q3 * u[1])
    out[5] = 0.5 * (q0 * u[1] + q3 * u[0] - q1 * u[2])
    out[6] = 0.5 * (q0 * u[2] + q1 * u[1] - q2 * u[0])
    out[7], out[8], out[9] = x0, x1, x2


@numba.njit
def shoot(tension, moment, force, bend, slope, h, mu, y, z, state, work, missed):
    """RK4 from a moment at the base; `missed` becomes the moment at the tip, which has to vanish."""
    k1, k2, k3, k4, place, u = work[11], work[12], work[13], work[14], work[15], work[16, :3]
    state[:] = 0.0
    state[:3] = tension
    state[3] = 1.0
    u[:] = 0.0
    for k in range(bend.size // 2):
        rate(state, bend[2 * k], slope[2 * k], mu, y, z, moment, force, u, work, k1)
        place[:] = state + 0.5 * h * k1
        rate(place, bend[2 * k + 1], slope[2 * k + 1], mu, y, z, moment, force, u, work, k2)
        place[:] = state + 0.5 * h * k2
        rate(place, bend[2 * k + 1], slope[2 * k + 1], mu, y, z, moment, force, u, work, k3)
        place[:] = state + h * k3
        rate(place, bend[2 * k + 2], slope[2 * k + 2], mu, y, z, moment, force, u, work, k4)
        for j in range(10):
            state[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    missed[0] = moment[0] - state[8] * force[2] + state[9] * force[1]
    missed[1] = moment[1] - state[9] * force[0] + state[7] * force[2]
    missed[2] = moment[2] - state[7] * force[1] + state[8] * force[0]


@numba.njit(parallel=True)
def shooting(tensions, forces, bend, slope, length, mu, y, z, newton, small, out, shots):
    """The moment at the base of every sample, from that of the straight body on."""
    h = length / (bend.size // 2)
    for i in numba.prange(tensions.shape[0]):
        work, state, missed, other = np.empty((17, 10)), np.empty(10), np.empty(3), np.empty(3)
        force, jacobian = forces[i], np.eye(3)
        moment = np.array([0.0, -length * force[2], length * force[1]])
        shoot(tensions[i], moment, force, bend, slope, h, mu, y, z, state, work, missed)
        count = 1
        while np.max(np.abs(missed)) > small and count < SHOTS:
            if newton:
                for j in range(3):
                    beside = moment.copy()
                    beside[j] += DIFFERENCE
                    shoot(tensions[i], beside, force, bend, slope, h, mu, y, z, state, work, other)
                    jacobian[:, j] = (other - missed) / DIFFERENCE
                count += 3
            step = -np.linalg.solve(jacobian, missed)
            moment += step
            shoot(tensions[i], moment, force, bend, slope, h, mu, y, z, state, work, other)
            count += 1
            if not newton:
                jacobian += np.outer(other - missed - jacobian @ step, step) / np.sum(step * step)
            missed[:] = other
        out[i, :3], out[i, 3:], shots[i] = state[:3], state[7:], count


def numba_shooting(robot: cddf.Manipulator, steps: int, *, newton: bool) -> Callable[..., np.ndarray]:
    """A function that runs shooting over samples; the seventh column is the number of shots."""
    length, offset = float(robot.length), float(robot.tendons[0].offset(0.0))
    s = jnp.linspace(0.0, length, 2 * steps + 1)
    bend, slope = (np.asarray(x) for x in jax.jvp(robot.stiffness, (s,), (jnp.ones_like(s),)))
    y, z, mu = offset * np.cos(ANGLES), offset * np.sin(ANGLES), float(robot.friction_coefficient)

    def run(tensions, forces):
        given, force = np.asarray(tensions), np.asarray(forces)
        out, shots = np.empty((len(given), 6)), np.empty(len(given))
        shooting(given, force, bend, slope, length, mu, y, z, newton, STEPS[steps], out, shots)
        return np.column_stack([out, shots])

    return run


def errors(found: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Of the samples that were solved, and how many were not."""
    lost = ~np.all(np.isfinite(found), axis=1)
    tension = np.max(np.abs(found[~lost, :3] / exact[~lost, :3] - 1), axis=1)
    place = np.max(np.abs(found[~lost, 3:6] - exact[~lost, 3:6]), axis=1)
    kinds = {"tension": tension, "position": place}
    told = {
        f"{kind}, {name}": float(of(x))
        for kind, x in kinds.items()
        for name, of in (("median", np.median), ("largest", np.max))
    }
    return told | {"not solved": int(np.sum(lost))}


def rows_of(robot: cddf.Manipulator, largest: float) -> dict[str, dict[str, float]]:
    """Times and errors under forces up to a largest component."""
    rng = np.random.default_rng(0)
    given = rng.uniform(*PULLS, (COUNT, 3)), rng.uniform(-largest, largest, (COUNT, 3))
    samples = jax.device_put(tuple(map(jnp.asarray, given)), on_devices())
    exact = numba_shooting(robot, EXACT, newton=True)(*samples)
    functions = {f"solve, {nodes} nodes": one_by_one(tip(robot, nodes)) for nodes in NODES}
    for newton, name in ((True, "Newton"), (False, "Broyden")):
        functions |= {
            f"shooting, {name}, {n} steps": numba_shooting(robot, n, newton=newton) for n in STEPS if n < EXACT
        }
    times = interleaved({name: lambda f=f: f(*samples) for name, f in functions.items()})
    rows = {}
    for name, function in functions.items():
        found = columns(function(*samples))
        rows[name] = {"us": 1e6 * times[name] / COUNT, "over solve": times[name] / times[f"solve, {NODES[0]} nodes"]}
        rows[name] |= errors(found, exact) | ({"shots": float(np.mean(found[:, 6]))} if found.shape[1] > 6 else {})
    return rows


def main() -> None:
    """Run, print and store the table."""
    configure_jax(all_cores=True)
    jax.config.update("jax_num_cpu_devices", DEVICES)
    robot, text = three_tendons(), []
    results = {f"components up to {largest:g} N": rows_of(robot, largest) for largest in FORCES}
    for words, rows in results.items():
        heads = ["us a solve", "times as long as `solve`", "shots", "error of T_tip: median", "largest"]
        heads += ["error of the position, m: median", "largest", "not solved"]
        text += [f"Tip force: {words}.", "", f"| what | {' | '.join(heads)} |", "| --- |" + " ---: |" * len(heads)]
        for name, row in rows.items():
            cells = [f"{row['us']:.1f}", f"{row['over solve']:.2f}", f"{row['shots']:.1f}" if "shots" in row else ""]
            told = (f"{kind}, {one}" for kind in ("tension", "position") for one in ("median", "largest"))
            cells += [f"{row[key]:.1e}" for key in told] + [f"{row['not solved']}"]
            text.append(f"| {name} | {' | '.join(cells)} |")
        text.append("")
    report("space_loads", "\n".join(text), results)


if __name__ == "__main__":
    main()
