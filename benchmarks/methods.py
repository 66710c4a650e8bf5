"""Accuracy against time of the methods, values and derivatives: `python benchmarks/methods.py`.

The body is the paper's, published kinematics, 75 N. Every method is timed in the same run: one solve through a
compiled call, and a batch of 4096. Beside them is what a user would write otherwise: SciPy's solve_ivp, and the
paper's iteration in NumPy over 200 points. Errors are those of the tip tension, and of its derivatives by mu and E,
against the closed form.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_ivp
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.identification.parameters import with_parameters

PULL, BATCH = 75.0, 4096
METHODS = {
    "FixedPoint, 16 nodes (default)": (cddf.FixedPoint(), 16),
    "FixedPoint, 8 nodes": (cddf.FixedPoint(), 8),
    "LiteralIteration, tip 1e-4 m": (cddf.LiteralIteration(), 16),
    "LiteralIteration, tip 1e-12 m": (cddf.LiteralIteration(tip_tolerance=1e-12), 16),
}


def median_time(call: Callable[[], Any], least: float = 0.3) -> float:
    """Median seconds of a call. After a first call it is repeated for at least `least` seconds."""
    jax.block_until_ready(call())
    times: list[float] = []
    while sum(times) < least or len(times) < 5:
        begin = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def tip_tension(robot: cddf.Manipulator, method: Any, nodes: int) -> Callable[..., jax.Array]:
    """T_tip as a function of mu, E and T_base."""

    def value(mu, modulus, pull):
        body = with_parameters(robot, {"friction_coefficient": mu, "youngs_modulus": modulus})
        return cddf.solve(body, pull, method=method, nodes=nodes, throw=False).tip_tension[0]

    return value


def measure(robot: cddf.Manipulator, method: Any, nodes: int) -> dict[str, float]:
    """Times in microseconds and relative errors of one method."""
    value = tip_tension(robot, method, nodes)
    derivatives = {"value": value, "forward": jax.jacfwd(value, (0, 1)), "reverse": jax.grad(value, (0, 1))}
    one = 0.42, 1.4e6, PULL
    many = np.linspace(0.3, 0.5, BATCH), np.linspace(1.2e6, 1.6e6, BATCH), np.linspace(50.0, 85.0, BATCH)

    def exact(mu, modulus, pull):
        body = with_parameters(robot, {"friction_coefficient": mu, "youngs_modulus": modulus})
        return cddf.closed_form_tension(body, pull, robot.length)

    truth = {"value": exact(*one), "forward": jax.grad(exact, (0, 1))(*one)}
    truth["reverse"] = truth["forward"]
    row = {}
    for name, function in derivatives.items():
        single, batched = jax.jit(function), jax.jit(jax.vmap(function))
        error = np.asarray(single(*one)) / np.asarray(truth[name]) - 1
        row[f"{name} error"] = float(np.max(np.abs(error)))
        row[f"{name} one us"] = 1e6 * median_time(lambda f=single: f(*one))
        row[f"{name} batch us"] = 1e6 * median_time(lambda f=batched: f(*many)) / BATCH
    return row


def geometry(robot: cddf.Manipulator) -> tuple[Callable[[Any], Any], float, float]:
    """E J(s) as plain NumPy, d and mu."""
    length, modulus = float(robot.length), float(robot.youngs_modulus)
    outer, inner, d = 0.020, 0.007, 0.010
    return lambda s: modulus * np.pi / 4 * ((outer - 0.007 * s / length) ** 4 - inner**4), d, 0.42


def scipy_march(robot: cddf.Manipulator) -> float:
    """T' = -mu T^2 d / (E J), with heading and position, by solve_ivp with a usual tight tolerance."""
    stiffness, d, mu = geometry(robot)

    def rate(s, y):
        kappa = d * y[0] / (stiffness(s) + y[0] * d**2)
        return [-mu * kappa / (1 - d * kappa) * y[0], kappa, np.cos(y[1]), np.sin(y[1])]

    return solve_ivp(rate, (0.0, float(robot.length)), [PULL, 0.0, 0.0, 0.0], rtol=1e-9, atol=1e-12).y[0, -1]


def numpy_iteration(robot: cddf.Manipulator) -> float:
    """The paper's iteration over 200 points with trapezoids, to 0.1 mm."""
    stiffness, d, mu = geometry(robot)
    s = np.linspace(0.0, float(robot.length), 200)
    bending, kappa, tip = stiffness(s), d * PULL / (stiffness(s) + PULL * d**2), np.full(2, np.inf)
    while True:
        heading = cumulative_trapezoid(kappa, s, initial=0.0)
        new_tip = np.array([np.trapezoid(np.cos(heading), s), np.trapezoid(np.sin(heading), s)])
        tension = PULL * np.exp(-mu * cumulative_trapezoid(kappa / (1 - d * kappa), s, initial=0.0))
        if np.linalg.norm(new_tip - tip) < 1e-4:
            return float(tension[-1])
        kappa, tip = d * tension * (1 - d * kappa) / bending, new_tip


def main() -> None:
    """Measure, print and save."""
    configure_jax()
    jax.config.update("jax_enable_compilation_cache", False)
    robot = cddf.read_manipulator(Path(__file__).parents[1] / "data" / "smooth_sil_940.toml")
    truth = float(cddf.closed_form_tension(robot, PULL, robot.length))
    rows = {name: measure(robot, *how) for name, how in METHODS.items()}
    for name, call in {
        "SciPy solve_ivp, rtol 1e-9": scipy_march,
        "NumPy iteration, 200 points": numpy_iteration,
    }.items():
        error = abs(call(robot) / truth - 1)
        rows[name] = {"value error": error, "value one us": 1e6 * median_time(lambda call=call: call(robot))}
    columns = list(next(iter(rows.values())))
    lines = ["| method | " + " | ".join(columns) + " |", "| --- |" + " ---: |" * len(columns)]
    for name, row in rows.items():
        cells = [f"{row[c]:.1e}" if "error" in c else f"{row[c]:.3g}" for c in columns if c in row]
        lines.append(f"| {name} | " + " | ".join(cells + ["-"] * (len(columns) - len(cells))) + " |")
    text = "\n".join(lines) + "\n"
    report("methods", text, {"batch": BATCH, "rows": rows})


if __name__ == "__main__":
    main()
