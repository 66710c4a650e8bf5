"""Friction and modulus from 17 levels with tip positions: `python benchmarks/seventeen_levels.py`, two minutes.

The readings are those of the model for the paper's body, exact kinematics, at 5 to 85 N, with simulated noise of 0.3
N and 0.3 mm. SciPy's `least_squares` fits the paper's iteration on 200 points, in NumPy and compiled by numba. It
does so in two forms: with the double integral of equation (14), as a user would take it from the paper, and with that
integral solved by hand, where the moment is d T. cddf_jax has two rows: the search alone, which is what SciPy does,
and `fit`, which also finds what the data determine. The distance is that of the estimates from a SciPy fit of our own
model at tolerance 1e-15, in standard errors. So it shows the error that the 200 points cause. Times are medians of
warm calls in turn in one run.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from fits import OFFSET, SECOND_MOMENT, S, iterated
from methods import median_time
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.estimation.levenberg_marquardt import minimise

LEVELS = np.arange(5.0, 86.0, 5.0)
NOISE = {"tip_tension": 0.3, "tip_x": 3e-4, "tip_y": 3e-4}
TRUTH, START = np.array([0.42, 1.4e6]), np.array([0.3, 1.0e6])
POINTS = len(S)
ROUNDS = 9


def paper(mu: float, modulus: float) -> cddf.Manipulator:
    """The paper's body in the exact kinematics."""
    return cddf.conical(
        length=S[-1],
        outer_radius=(0.020, 0.013),
        inner_radius=0.007,
        tendon_offset=OFFSET,
        youngs_modulus=modulus,
        friction_coefficient=mu,
    )


def tip(mu: float, modulus: float, pull: float) -> np.ndarray:
    """Tip tension and position by the paper's iteration."""
    tension, angle = iterated(mu, modulus, pull)
    return np.array([tension[-1], np.trapezoid(np.cos(angle), S), np.trapezoid(np.sin(angle), S)])


def update_as_printed(mu: float, modulus: float, pull: float, kappa: np.ndarray) -> tuple[np.ndarray, ...]:
    """Tensions and tip of a shape, and its curvature by eq. (14): the moment of all tendon forces outboard."""
    weight = np.triu(np.full((POINTS, POINTS), S[1] - S[0]))
    weight[:, -1] *= 0.5
    np.fill_diagonal(weight, 0.5 * (S[1] - S[0]))
    weight[-1, -1] = 0.0
    angle = cumulative_trapezoid(kappa, S, initial=0.0)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = (cumulative_trapezoid(component, S, initial=0.0) for component in (cos, sin))
    tension = pull * np.exp(-mu * angle)
    # normal force T kappa n and friction -mu T kappa t per length, and -T t at the tip
    force_x, force_y = -tension * kappa * (sin + mu * cos), tension * kappa * (cos - mu * sin)
    arm_x, arm_y = (x - OFFSET * sin) - x[:, None], (y + OFFSET * cos) - y[:, None]
    moment = np.sum(weight * (arm_x * force_y - arm_y * force_x), axis=1)
    moment -= tension[-1] * (arm_x[:, -1] * sin[-1] - arm_y[:, -1] * cos[-1])
    return tension, np.array([tension[-1], x[-1], y[-1]]), moment / (modulus * SECOND_MOMENT)


def tip_as_printed(mu: float, modulus: float, pull: float) -> np.ndarray:
    """Tip tension and position by the paper's iteration from the shape without friction."""
    tension, tip, kappa = update_as_printed(mu, modulus, pull, pull * OFFSET / (modulus * SECOND_MOMENT))
    for _ in range(50):
        last = tension
        tension, tip, kappa = update_as_printed(mu, modulus, pull, kappa)
        if np.max(np.abs(tension - last)) < 1e-9 * pull:
            break
    return tip


@numba.njit
def iterated_by_numba(mu, modulus, pulls, out):
    """The iteration of `fits.iterated` written as loops, and the position of the tip."""
    step = S[1] - S[0]
    tension, angle = np.empty(POINTS), np.empty(POINTS)
    for row in range(pulls.size):
        tension[:] = pulls[row]
        for _ in range(50):
            change, angle[0] = 0.0, 0.0
            before = tension[0] * OFFSET / (modulus * SECOND_MOMENT[0])
            for k in range(1, POINTS):
                here = tension[k] * OFFSET / (modulus * SECOND_MOMENT[k])
                angle[k] = angle[k - 1] + 0.5 * step * (before + here)
                before = here
            for k in range(POINTS):
                new = pulls[row] * np.exp(-mu * angle[k])
                change, tension[k] = max(change, abs(new - tension[k])), new
            if change < 1e-9 * pulls[row]:
                break
        x, y = 0.0, 0.0
        for k in range(1, POINTS):
            x += 0.5 * step * (np.cos(angle[k - 1]) + np.cos(angle[k]))
            y += 0.5 * step * (np.sin(angle[k - 1]) + np.sin(angle[k]))
        out[row, 0], out[row, 1], out[row, 2] = tension[-1], x, y


def by_numpy(mu: float, modulus: float) -> np.ndarray:
    return np.array([tip(mu, modulus, pull) for pull in LEVELS])


def as_printed(mu: float, modulus: float) -> np.ndarray:
    return np.array([tip_as_printed(mu, modulus, pull) for pull in LEVELS])


def by_numba(mu: float, modulus: float) -> np.ndarray:
    out = np.empty((LEVELS.size, 3))
    iterated_by_numba(mu, modulus, LEVELS, out)
    return out


@jax.jit
def by_solve(mu: Any, modulus: Any) -> jax.Array:
    """Tip tension and position by `solve`."""
    body = eqx.tree_at(lambda m: (m.friction_coefficient, m.youngs_modulus), paper(*TRUTH), (mu, modulus))

    def one(pull):
        found = cddf.solve(body, pull, throw=False)
        return jnp.concatenate([found.tip_tension, found.tip_position])

    return jax.vmap(one)(jnp.asarray(LEVELS))


def scipy_fit(model: Callable[[float, float], Any], readings: np.ndarray, **options: Any) -> np.ndarray:
    """Friction coefficient and modulus by `least_squares`."""
    weight = 1.0 / np.array(list(NOISE.values()))

    def residual(x):
        return ((np.asarray(model(*(x * START))) - readings) * weight).ravel()

    return least_squares(residual, [1.0, 1.0], x_scale="jac", **options).x * START


def in_turn(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Median seconds of each call. They run in turn, a fifth of a second each, as the machine changes its speed."""
    rounds = [{name: median_time(call, least=0.2) for name, call in calls.items()} for _ in range(ROUNDS)]
    return {name: float(np.median([one[name] for one in rounds])) for name in calls}


def table_of(readings: np.ndarray) -> cddf.Measurements:
    """The readings as a table, read from a file as a user would."""
    lines = ["base_tension [N], tip_tension [N], tip_x [m], tip_y [m]"]
    lines += [", ".join(repr(float(x)) for x in (pull, *row)) for pull, row in zip(LEVELS, readings, strict=True)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "levels_simulated.csv"
        path.write_text("\n".join(lines) + "\n")
        return cddf.read_measurements(path)


def main() -> None:
    """Measure, print and save."""
    configure_jax()
    rng = np.random.default_rng(0)
    readings = np.asarray(by_solve(*TRUTH)) + np.array(list(NOISE.values())) * rng.normal(size=(LEVELS.size, 3))
    table = table_of(readings)
    started = paper(*START)
    exact = scipy_fit(by_solve, readings, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = cddf.fit(started, table, noise=NOISE)
    search, first = fit.minimum, np.asarray(fit.minimum.problem.space.first())
    error = np.array([fit.standard_error[name] for name in fit.names])

    calls: dict[str, Callable[[], np.ndarray]] = {
        "cddf_jax, the search": lambda: minimise(search.problem, first).parameters,
        "cddf_jax, fit": lambda: np.array(list(cddf.fit(started, table, noise=NOISE).value.values())),
        "SciPy over our model": lambda: scipy_fit(by_solve, readings),
        "SciPy over numba": lambda: scipy_fit(by_numba, readings),
        "SciPy over NumPy": lambda: scipy_fit(by_numpy, readings),
        "SciPy over NumPy, eq. (14) as printed": lambda: scipy_fit(as_printed, readings),
    }
    times = in_turn(calls)
    rows = {
        name: {"ms": 1e3 * times[name], "distance": float(np.max(np.abs(np.asarray(call()) - exact) / error))}
        for name, call in calls.items()
    }
    base, whole = rows["cddf_jax, the search"]["ms"], rows["cddf_jax, fit"]["ms"]
    lines = [
        "| | ms | times our search | times our fit | distance, standard errors |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, row in rows.items():
        times = f"{row['ms']:.3g} | {row['ms'] / base:.3g} | {row['ms'] / whole:.3g}"
        lines.append(f"| {name} | {times} | {row['distance']:.1e} |")
    text = "\n".join(lines) + "\n"
    report("seventeen_levels", text, rows)


if __name__ == "__main__":
    main()
