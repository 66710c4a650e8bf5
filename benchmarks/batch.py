"""A batch of 100,000 unloaded solves beside a compiled loop: `python benchmarks/batch.py`, five minutes.

The body is the paper's with one parallel tendon, exact kinematics. Tension, friction coefficient and modulus differ
from solve to solve. Outputs are tip tension, tip position and tip angle. `solve` runs in chunks of 5,120 lanes on two
devices of the CPU, with the samples already on the devices. Beside it runs what a numba user would write: the four
equations of exactly this case, for one tendon, by RK4 with 8 and 32 steps, in parallel on both cores. All calls run
in turn in one process; times are medians. Errors are those of the tip tension (relative, against the closed form) and
of the tip position (m, against 48 nodes).

Then 16,384 of the samples under a tip force, in chunks of 256 lanes, and the gradient of each, beside shooting: RK4
from the base, and the secant method on M_ext(0) until the moment at the tip is 1e-8 N m. Shooting applies the force in
one step. It does not locate kinks, and does not ask which equilibrium it found or whether that is stable. The curvature
changes sign in a tenth of the samples under (0, -1) N, and in all of them under (0, -10) N. There 32 steps are not
enough, so 512 are shown too.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.identification.parameters import with_parameters

COUNT, LOADED, ROUNDS = 102_400, 16_384, 15
CHUNK, LOADED_CHUNK = 5_120, 256
DEVICES = 2
FORCES = {(0.0, 2.0): (32,), (0.0, -1.0): (32, 512), (0.0, -10.0): (32, 512)}  # N, and the steps of RK4


def paper() -> cddf.Manipulator:
    """The paper's body in the exact kinematics."""
    robot = cddf.read_manipulator(Path(__file__).parents[1] / "data" / "smooth_sil_940.toml")
    fields = {name: getattr(robot, name) for name in ("length", "outer_radius", "inner_radius", "tendons")}
    return cddf.Manipulator(
        **fields, youngs_modulus=robot.youngs_modulus, friction_coefficient=robot.friction_coefficient
    )


def tip(robot: cddf.Manipulator, nodes: int, force: tuple[float, float] | None = None) -> Callable[..., Any]:
    """T_tip, u(L) and phi(L) as a function of T_base, mu and E."""
    loads = None if force is None else cddf.Loads(tip_force=force)

    def at(tension, mu, modulus):
        body = with_parameters(robot, {"friction_coefficient": mu, "youngs_modulus": modulus})
        found = cddf.solve(body, tension, loads, nodes=nodes, throw=False)
        return found.tip_tension[0], found.tip_position, found.tip_angle

    return at


def on_devices() -> NamedSharding:
    """Sharding that gives each device an equal share."""
    mesh = jax.make_mesh((DEVICES,), ("lanes",), axis_types=(jax.sharding.AxisType.Auto,))
    return NamedSharding(mesh, PartitionSpec("lanes"))


def batched(function: Callable[..., Any], chunk: int) -> Callable[..., Any]:
    """The function over a batch: an equal share on each device, in chunks."""
    mesh, lanes = on_devices().mesh, on_devices().spec

    def share(*inputs):
        return jax.lax.map(lambda x: function(*x), inputs, batch_size=chunk)

    return jax.jit(jax.shard_map(share, mesh=mesh, in_specs=(lanes,) * 3, out_specs=lanes))


def columns(tip: Any) -> np.ndarray:
    """T_tip, x, y and phi of every sample as columns, from `solve` or from the loop."""
    return tip if isinstance(tip, np.ndarray) else np.column_stack([np.asarray(x) for x in tip])


@numba.njit(parallel=True)
def runge_kutta(tension, friction, modulus, length, outer, inner, offset, steps, out):
    """T' = -mu kappa T with kappa = d T / (E J), phi' = kappa, u' = (cos phi, sin phi)."""
    h = length / steps
    stiffness = np.empty(2 * steps + 1)
    for k in range(2 * steps + 1):
        part = 0.5 * k / steps
        stiffness[k] = (outer[0] + (outer[1] - outer[0]) * part) ** 4 - (inner[0] + (inner[1] - inner[0]) * part) ** 4
    for i in numba.prange(tension.size):
        mu, bend = friction[i], offset / (modulus[i] * np.pi / 4)
        T, phi, x, y = tension[i], 0.0, 0.0, 0.0
        for k in range(steps):
            a1 = bend * T / stiffness[2 * k]
            t1 = -mu * a1 * T
            a2 = bend * (T + 0.5 * h * t1) / stiffness[2 * k + 1]
            t2 = -mu * a2 * (T + 0.5 * h * t1)
            a3 = bend * (T + 0.5 * h * t2) / stiffness[2 * k + 1]
            t3 = -mu * a3 * (T + 0.5 * h * t2)
            a4 = bend * (T + h * t3) / stiffness[2 * k + 2]
            t4 = -mu * a4 * (T + h * t3)
            p2, p3, p4 = phi + 0.5 * h * a1, phi + 0.5 * h * a2, phi + h * a3
            x += h / 6 * (np.cos(phi) + 2 * np.cos(p2) + 2 * np.cos(p3) + np.cos(p4))
            y += h / 6 * (np.sin(phi) + 2 * np.sin(p2) + 2 * np.sin(p3) + np.sin(p4))
            phi += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            T += h / 6 * (t1 + 2 * t2 + 2 * t3 + t4)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = T, x, y, phi


def numba_loop(robot: cddf.Manipulator, steps: int) -> Callable[..., np.ndarray]:
    """A function that runs the loop over samples."""
    ends = np.array([0.0, float(robot.length)])
    outer, inner = map(np.asarray, robot.radii(ends))
    offset = float(robot.tendons[0].offset(0.0))

    def run(tension, mu, modulus):
        out = np.empty((len(tension), 4))
        samples = np.asarray(tension), np.asarray(mu), np.asarray(modulus)
        runge_kutta(samples[0], samples[1], samples[2], ends[1], outer, inner, offset, steps, out)
        return out

    return run


@numba.njit
def shoot(moment, tension, mu, bend, offset, force, stiffness, h, out):
    """T' = -mu |kappa| T with kappa = (d T + M) / (E J), phi' = kappa, u' = t, M' = -t x F. Returns M at the tip."""
    half = 0.5 * h
    T, phi, x, y, M = tension, 0.0, 0.0, 0.0, moment
    for k in range(stiffness.size // 2):
        c1, s1, a1 = np.cos(phi), np.sin(phi), (offset * T + M) * bend / stiffness[2 * k]
        t1, m1 = -mu * abs(a1) * T, s1 * force[0] - c1 * force[1]
        p, T2, M2 = phi + half * a1, T + half * t1, M + half * m1
        c2, s2, a2 = np.cos(p), np.sin(p), (offset * T2 + M2) * bend / stiffness[2 * k + 1]
        t2, m2 = -mu * abs(a2) * T2, s2 * force[0] - c2 * force[1]
        p, T3, M3 = phi + half * a2, T + half * t2, M + half * m2
        c3, s3, a3 = np.cos(p), np.sin(p), (offset * T3 + M3) * bend / stiffness[2 * k + 1]
        t3, m3 = -mu * abs(a3) * T3, s3 * force[0] - c3 * force[1]
        p, T4, M4 = phi + h * a3, T + h * t3, M + h * m3
        c4, s4, a4 = np.cos(p), np.sin(p), (offset * T4 + M4) * bend / stiffness[2 * k + 2]
        t4, m4 = -mu * abs(a4) * T4, s4 * force[0] - c4 * force[1]
        x += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
        y += h / 6 * (s1 + 2 * s2 + 2 * s3 + s4)
        phi += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        T += h / 6 * (t1 + 2 * t2 + 2 * t3 + t4)
        M += h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)
    out[0], out[1], out[2], out[3] = T, x, y, phi
    return M


@numba.njit(parallel=True)
def shooting(tension, friction, modulus, length, stiffness, offset, force, out):
    """The secant method, which starts with M_ext(0) = 0 and with that of the straight body."""
    h = length / (stiffness.size // 2)
    for i in numba.prange(tension.size):
        bend = 1.0 / (modulus[i] * np.pi / 4)
        before, moment = 0.0, force[1] * length
        error = shoot(before, tension[i], friction[i], bend, offset, force, stiffness, h, out[i])
        for _ in range(50):
            new = shoot(moment, tension[i], friction[i], bend, offset, force, stiffness, h, out[i])
            if abs(new) < 1e-8 or new == error:
                break
            before, moment, error = moment, moment - new * (moment - before) / (new - error), new


def numba_shooting(robot: cddf.Manipulator, force: tuple[float, float], steps: int) -> Callable[..., np.ndarray]:
    """A function that runs shooting over samples."""
    length, offset = float(robot.length), float(robot.tendons[0].offset(0.0))
    stiffness = np.asarray(robot.second_moment(jnp.linspace(0.0, length, 2 * steps + 1))) * 4 / np.pi

    def run(*samples):
        tension, mu, modulus = map(np.asarray, samples)
        out = np.empty((len(tension), 4))
        shooting(tension, mu, modulus, length, stiffness, offset, np.asarray(force), out)
        return out

    return run


def interleaved(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Median seconds of each call. All run in turn, after a first call of each."""
    for call in calls.values():
        jax.block_until_ready(call())
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            begin = time.perf_counter()
            jax.block_until_ready(call())
            times[name].append(time.perf_counter() - begin)
    return {name: float(np.median(spent)) for name, spent in times.items()}


def rows_of(functions: dict[str, Callable[..., Any]], samples: tuple, numba32: str, exact: np.ndarray) -> dict:
    """Times of all functions, and errors of those that return the tip, against an exact tip."""
    times = interleaved({name: lambda f=f: f(*samples) for name, f in functions.items()})
    rows = {name: {"us": 1e6 * t / len(samples[0]), "numba32 over it": times[numba32] / t} for name, t in times.items()}
    for name, function in functions.items():
        if "mu" not in name:
            found = columns(function(*samples))
            rows[name]["tension error"] = float(np.max(np.abs(found[:, 0] / exact[:, 0] - 1)))
            rows[name]["position error"] = float(np.max(np.abs(found[:, 1:3] - exact[:, 1:3])))
    return rows


def loaded_rows(robot: cddf.Manipulator, samples: tuple) -> dict:
    """The rows under the tip forces."""
    rows = {}
    for force, steps in FORCES.items():
        under = f"under ({force[0]:g}, {force[1]:g}) N"
        theirs = {f"numba, RK4, {n} steps, shooting, {under}": numba_shooting(robot, force, n) for n in steps}
        value = tip(robot, 16, force)
        by_two = jax.grad(lambda *x, value=value: value(*x)[0], (1, 2))
        functions = {
            f"`solve`, 16 nodes, {under}": batched(value, LOADED_CHUNK),
            f"gradient of its tip tension by mu and E, reverse, {under}": batched(by_two, LOADED_CHUNK),
        } | theirs
        exact = columns(batched(tip(robot, 48, force), LOADED_CHUNK)(*samples))
        rows |= rows_of(functions, samples, next(iter(theirs)), exact)
    return rows


def main() -> None:
    """Measure, print and save."""
    configure_jax(all_cores=True)
    jax.config.update("jax_num_cpu_devices", DEVICES)
    robot, rng = paper(), np.random.default_rng(0)
    ranges = ((5.0, 85.0), (0.1, 0.6), (1e6, 2e6))
    samples = tuple(rng.uniform(*limits, COUNT) for limits in ranges)
    placed = jax.device_put(samples, on_devices())
    by_numbers = {nodes: tip(robot, nodes) for nodes in (16, 8)}
    functions: dict[str, Callable[..., Any]] = {
        f"`solve`, {nodes} nodes": batched(value, CHUNK) for nodes, value in by_numbers.items()
    }
    functions["its Jacobian by mu and E, 16 nodes"] = batched(jax.jacfwd(by_numbers[16], (1, 2)), CHUNK)
    functions["gradient of its tip tension by mu and E, reverse, 16 nodes"] = batched(
        jax.grad(lambda *x: by_numbers[16](*x)[0], (1, 2)), CHUNK
    )
    functions |= {f"numba, RK4, {steps} steps": numba_loop(robot, steps) for steps in (8, 32)}
    compliance = (1.0 / float(cddf.closed_form_tension(robot, 1.0, robot.length)) - 1.0) * float(
        robot.youngs_modulus / robot.friction_coefficient
    )
    tension, mu, modulus = samples
    exact = columns(batched(tip(robot, 48), CHUNK)(*placed))
    exact[:, 0] = tension / (1 + mu / modulus * compliance * tension)
    rows = rows_of(functions, placed, "numba, RK4, 32 steps", exact) | loaded_rows(
        robot, jax.device_put(tuple(x[:LOADED] for x in samples), on_devices())
    )
    lines = ["| what | us a solve | times faster than numba, 32 steps | error of T_tip | error of u(L), m |"]
    lines += ["| --- | ---: | ---: | ---: | ---: |"]
    for name, row in rows.items():
        errors = [f"{row[key]:.1e}" if key in row else "" for key in ("tension error", "position error")]
        lines.append(f"| {name} | {row['us']:.3f} | {row['numba32 over it']:.1f} | " + " | ".join(errors) + " |")
    text = "\n".join(lines) + "\n"
    report("batch", text, rows)


if __name__ == "__main__":
    main()
