"""A fit and a profile beside SciPy and lmfit: `python benchmarks/fits.py`.

Friction and modulus from the tip tensions and tip angles of data/tip_angle_simulated.csv, exact kinematics, with
known noise. SciPy and lmfit fit what a user would write: the paper's iteration in NumPy over 200 points, row by row.
lmfit is used if it is installed (`pip install lmfit`). The distance is that of the estimates from a SciPy fit of the
closed form at tolerance 1e-15, in standard errors. All times are medians of one run after compilation; the first call
is reported separately.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from methods import median_time
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq, least_squares
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"
NOISE = {"tip_tension": 0.5, "tip_angle": np.radians(1.0)}
START = np.array([0.42, 1.4e6])
S = np.linspace(0.0, 0.140, 200)
OFFSET = 0.010
SECOND_MOMENT = np.pi / 4 * ((0.020 - 0.007 * S / 0.140) ** 4 - 0.007**4)
COMPLIANCE = 2.942783188998e4  # G(L), 1/m^2


def iterated(mu: float, modulus: float, pull: float) -> tuple[np.ndarray, np.ndarray]:
    """Tension and heading along the body by the paper's iteration, as a user would write it."""
    tension, angle = np.full_like(S, pull), np.zeros_like(S)
    for _ in range(50):
        angle = cumulative_trapezoid(tension * OFFSET / (modulus * SECOND_MOMENT), S, initial=0.0)
        last, tension = tension, pull * np.exp(-mu * angle)
        if np.max(np.abs(tension - last)) < 1e-9 * pull:
            break
    return tension, angle


def closed(mu: float, modulus: float, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tip = pull / (1 + mu * pull * COMPLIANCE / modulus)
    return tip, np.log(pull / tip) / mu


def residual_of(table: cddf.Measurements, tip: np.ndarray, angle: np.ndarray, model: Callable) -> Callable:
    """(predicted - observed) / noise as a function of (mu, E) divided by their start values."""
    pulls = table["base_tension"]

    def residual(x):
        predicted = np.array(model(*(x * START), pulls))
        return np.concatenate(
            [(predicted[0] - tip) / NOISE["tip_tension"], (predicted[1] - angle) / NOISE["tip_angle"]]
        )

    return residual


def by_rows(mu: float, modulus: float, pulls: np.ndarray) -> np.ndarray:
    rows = (iterated(mu, modulus, pull) for pull in pulls)
    return np.array([(tension[-1], angle[-1]) for tension, angle in rows]).T


def once(call: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    answer = call()
    return time.perf_counter() - begin, answer


def ours(robot: cddf.Manipulator, table: cddf.Measurements) -> tuple[dict[str, float], np.ndarray]:
    first, fit = once(lambda: cddf.fit(robot, table, noise=NOISE))
    profile_first, _ = once(lambda: fit.profile("youngs_modulus"))
    times = {
        "first fit": first,
        "fit": median_time(lambda: cddf.fit(robot, table, noise=NOISE).covariance, least=2.0),
        "first profile": profile_first,
        "profile": median_time(lambda: fit.profile("youngs_modulus").rise, least=1.0),
    }
    return times, np.array([fit.value["friction_coefficient"], fit.value["youngs_modulus"]])


def with_scipy(table: cddf.Measurements) -> tuple[dict[str, float], np.ndarray]:
    tip, angle = table["tip_tension"], table["tip_angle"]
    residual = residual_of(table, tip, angle, by_rows)
    time_of_fit, found = once(lambda: least_squares(residual, [1.0, 1.0], x_scale="jac"))

    def rise(modulus):
        held = least_squares(lambda x: residual([x[0], modulus]), [found.x[0]])
        return 2 * (held.cost - found.cost) - 3.841458820694124

    covariance = np.linalg.inv(found.jac.T @ found.jac)
    error = np.sqrt(covariance[1, 1])

    def profile():
        return [
            brentq(rise, found.x[1] + sign * 1.2 * error, found.x[1] + sign * 4 * error, xtol=1e-6) for sign in (-1, 1)
        ]

    return {"fit": time_of_fit, "profile": once(profile)[0]}, found.x * START


def with_lmfit(table: cddf.Measurements) -> tuple[dict[str, float], np.ndarray] | None:
    try:
        import lmfit  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    tip, angle = table["tip_tension"], table["tip_angle"]

    def minimise(residual, start):
        parameters = lmfit.create_params(mu=start[0], modulus=start[1])
        minimizer = lmfit.Minimizer(
            lambda p: residual(np.array([p["mu"].value, p["modulus"].value])), parameters, scale_covar=False
        )
        return minimizer, minimizer.minimize()

    residual = residual_of(table, tip, angle, by_rows)
    time_of_fit, (minimizer, found) = once(lambda: minimise(residual, [1.0, 1.0]))
    x = np.array([found.params["mu"].value, found.params["modulus"].value])
    profile, _ = once(lambda: lmfit.conf_interval(minimizer, found, p_names=["modulus"], sigmas=[0.95]))
    return {"fit": time_of_fit, "profile": profile}, x * START


def main() -> None:
    """Measure and write the table."""
    from dataclasses import replace

    robot = replace(cddf.read_manipulator(DATA / "smooth_sil_940.toml"), kinematics="exact")
    table = cddf.read_measurements(DATA / "tip_angle_simulated.csv")
    exact = least_squares(
        residual_of(table, table["tip_tension"], table["tip_angle"], closed),
        [1.0, 1.0],
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    error = np.sqrt(np.diag(np.linalg.inv(exact.jac.T @ exact.jac))) * START
    rows = {"cddf_jax": ours(robot, table), "SciPy": with_scipy(table), "lmfit": with_lmfit(table)}
    results = {
        name: row[0] | {"distance": float(np.max(np.abs(row[1] - exact.x * START) / error))}
        for name, row in rows.items()
        if row is not None
    }
    base = results["cddf_jax"]
    lines = [
        f"{len(table)} rows; seconds, and in brackets times the time of cddf_jax",
        "",
        "| | distance from exact, standard errors | fit | profile of E |",
        "| --- | --- | --- | --- |",
    ]
    for name, row in results.items():
        cells = [f"{row[what]:.3g} ({row[what] / base[what]:.3g} x)" for what in ("fit", "profile")]
        lines.append(f"| {name} | {row['distance']:.1e} | " + " | ".join(cells) + " |")
    first = ", ".join(f"{what} {base[f'first {what}']:.3g} s" for what in ("fit", "profile"))
    lines += ["", f"The first calls of cddf_jax, with compilation: {first}."]
    text = "\n".join(lines) + "\n"
    report("fits", text, results)


if __name__ == "__main__":
    configure_jax()
    main()
