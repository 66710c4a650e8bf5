"""A taper for uniform curvature: `python benchmarks/designs.py`, about a minute.

The paper's body in the exact kinematics at 50 N. Nine radii of a spline are free; the tip angle must be 1 rad. The
same task is solved by `cddf.design` and by what a user would write otherwise: SciPy's SLSQP with finite differences,
over a loop of RK4 (32 steps) compiled by numba, and over SciPy's `solve_ivp`. Errors are the largest relative error
of the radius along the body, against the analytic J(s) = T d exp(-mu kappa s) / (E kappa). Times are medians of warm
calls in one run. The first call of `cddf.design` compiles and is shown separately.
"""

import time
from collections.abc import Callable
from typing import Any

import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from methods import median_time
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

LENGTH, INNER, OFFSET, MODULUS, FRICTION, PULL, ANGLE = 0.14, 0.007, 0.010, 1.4e6, 0.42, 50.0, 1.0
KNOTS = np.linspace(0.0, LENGTH, 9)
START = np.linspace(0.020, 0.013, 9)
STEPS = 32
FINE = np.linspace(0.0, LENGTH, 2 * STEPS + 1)


@numba.njit
def curvature_by_rk4(second_moment):
    """Kappa at every step, and the tip angle. J is given at steps and half steps."""
    h = LENGTH / STEPS
    kappa = np.empty(STEPS + 1)
    tension, angle = PULL, 0.0
    for i in range(STEPS):
        stiff = MODULUS * second_moment[2 * i : 2 * i + 3] / OFFSET
        kappa[i] = tension / stiff[0]
        k1 = -FRICTION * tension**2 / stiff[0]
        t2 = tension + 0.5 * h * k1
        k2 = -FRICTION * t2**2 / stiff[1]
        t3 = tension + 0.5 * h * k2
        k3 = -FRICTION * t3**2 / stiff[1]
        t4 = tension + h * k3
        k4 = -FRICTION * t4**2 / stiff[2]
        angle += h / 6 * (tension / stiff[0] + 2 * (t2 + t3) / stiff[1] + t4 / stiff[2])
        tension += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    kappa[STEPS] = tension / (MODULUS * second_moment[2 * STEPS] / OFFSET)
    return kappa, angle


def by_numba(radii: np.ndarray) -> tuple[np.ndarray, float]:
    return curvature_by_rk4(np.pi / 4 * (CubicSpline(KNOTS, radii)(FINE) ** 4 - INNER**4))


def by_solve_ivp(radii: np.ndarray) -> tuple[np.ndarray, float]:
    spline = CubicSpline(KNOTS, radii)

    def curvature(s: Any, tension: Any) -> Any:
        return tension * OFFSET / (MODULUS * np.pi / 4 * (spline(s) ** 4 - INNER**4))

    def rates(s: float, y: np.ndarray) -> list[float]:
        kappa = curvature(s, y[0])
        return [-FRICTION * kappa * y[0], kappa]

    found = solve_ivp(rates, (0.0, LENGTH), [PULL, 0.0], t_eval=FINE[::2], rtol=1e-6, atol=1e-9)
    return curvature(FINE[::2], found.y[0]), float(found.y[1, -1])


def by_slsqp(model: Callable[[np.ndarray], tuple[np.ndarray, float]]) -> np.ndarray:
    """The radii, m, by SLSQP with finite differences."""

    def unevenness(x: np.ndarray) -> float:
        kappa, _ = model(x * START)
        return float(np.var(kappa) / np.mean(kappa) ** 2)

    miss = {"type": "eq", "fun": lambda x: model(x * START)[1] - ANGLE}
    bounds = [(0.4, 2.0)] * len(START)
    options = {"maxiter": 300, "ftol": 1e-14}
    return (
        minimize(unevenness, np.ones(9), bounds=bounds, constraints=[miss], method="SLSQP", options=options).x * START
    )


def by_design() -> np.ndarray:
    """The radii, m, by `cddf.design`."""
    tendon = cddf.Tendon(OFFSET)
    body = cddf.Manipulator(LENGTH, cddf.Spline(KNOTS, START), INNER, (tendon,), MODULUS, FRICTION)
    found = cddf.design(
        body,
        cddf.Even("curvature"),
        free=("outer_radius",),
        bounds={"outer_radius": (0.008, 0.040)},
        constraints=[cddf.Limit("tip_angle", equal=ANGLE)],
        cases=cddf.LoadCase(PULL),
    )
    assert found.success, found.result
    return np.asarray(found.manipulator.outer_radius.values)  # type: ignore[attr-defined]  # a spline, as it was given


def error(radii: np.ndarray) -> float:
    """Largest relative error of the radius along the body."""
    s, kappa = np.linspace(0.0, LENGTH, 1001), ANGLE / LENGTH
    second_moment = PULL * OFFSET * np.exp(-FRICTION * kappa * s) / (MODULUS * kappa)
    exact = (4 * second_moment / np.pi + INNER**4) ** 0.25
    return float(np.max(np.abs(CubicSpline(KNOTS, radii)(s) / exact - 1)))


def main() -> None:
    """Measure, print and save."""
    configure_jax()
    import jax

    jax.config.update("jax_enable_compilation_cache", False)
    began = time.perf_counter()
    by_design()
    first = time.perf_counter() - began
    calls = {
        "cddf.design": by_design,
        "SLSQP, finite differences, numba RK4": lambda: by_slsqp(by_numba),
        "SLSQP, finite differences, solve_ivp": lambda: by_slsqp(by_solve_ivp),
    }
    rows = {name: {"ms": 1e3 * median_time(call, least=3.0), "error": error(call())} for name, call in calls.items()}
    base = rows["cddf.design"]["ms"]
    lines = ["| a taper for uniform curvature | ms | times ours | error of radius |", "| --- | ---: | ---: | ---: |"]
    lines += [
        f"| {name} | {row['ms']:.3g} | {row['ms'] / base:.2g} | {row['error']:.1e} |" for name, row in rows.items()
    ]
    text = "\n".join([*lines, "", f"The first call of cddf.design compiles: {first:.1f} s.", ""])
    report("designs", text, {"first_s": first, "rows": rows})


if __name__ == "__main__":
    main()
