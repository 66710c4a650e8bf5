"""Make the simulated data sets: `python data/make_simulated.py` writes the four CSV files beside this script.

The paper prints no table of its measurements. So these tables are computed with its model, and noise is added. Each
file states at its top what was simulated and how. Every run of the script gives the same bytes.
"""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import cddf_jax as cddf
from cddf_jax.files.manipulator_file import read_manipulator

HERE = Path(__file__).resolve().parent
SEED = 2020
NOTE = (
    "SIMULATED, not measured: written by data/make_simulated.py, random seed ({seed}, {stream}) of NumPy's default_rng."
)

CELL_FLOOR, CELL_FRACTION = 0.1, 0.01  # sd of the load cells at tip and pulley: N, and fraction of the tension
TIP_GAIN = 1.001  # of the load cell at the tip
BASE_SD, ANGLE_SD = 0.05, 0.5  # sd of the load cell at the base, N, and of the tip angle, deg
LOOP_GAIN, LOOP_ZERO = 1.02, 0.3  # of the load cell at the tip in the loop: a cell that is off, factor and N
FRICTION_SCATTER = 0.01  # sd of mu from trial to trial, relative
CELL_NOTE = f"tension sd {CELL_FLOOR} N and {100 * CELL_FRACTION:g} % of it in quadrature"
BENCH_NOTES = (
    f"Noise, normal: base tension sd {BASE_SD} N; tip {CELL_NOTE}, gain {TIP_GAIN}.",
    f"Friction: one mu per trial, scattered about the truth with a relative sd of {100 * FRICTION_SCATTER:g} %.",
)


def with_noise(rng: np.random.Generator, tension: np.ndarray) -> np.ndarray:
    """Readings of a load cell. Its sd is a floor (N) and a fraction of the tension, added in quadrature."""
    return tension + rng.normal(size=tension.shape) * np.hypot(CELL_FLOOR, CELL_FRACTION * tension)


def pull(manipulator: cddf.Manipulator, friction: np.ndarray, base_tension: np.ndarray) -> tuple[np.ndarray, ...]:
    """Tip tension (N) and tip angle (deg) without noise, one row per friction coefficient."""

    def one(mu, tension):
        equilibrium = cddf.solve(replace(manipulator, friction_coefficient=mu), tension, throw=False)
        return equilibrium.tip_tension[0], equilibrium.tip_angle

    trials = jax.vmap(jax.vmap(one, (None, 0)), (0, None))
    tip_tension, tip_angle = jax.jit(trials)(friction, base_tension)
    return np.asarray(tip_tension), np.rad2deg(tip_angle)


def bench(manipulator: cddf.Manipulator, stream: int, levels: np.ndarray, trials: int) -> tuple[np.ndarray, ...]:
    """Trials that pull through all levels: trial numbers, and readings of base tension, tip tension and tip angle."""
    rng = np.random.default_rng((SEED, stream))
    friction = float(manipulator.friction_coefficient) * (1 + FRICTION_SCATTER * rng.normal(size=trials))
    tip_tension, tip_angle = pull(manipulator, friction, levels)
    base_reading = levels + BASE_SD * rng.normal(size=tip_tension.shape)
    tip_reading = with_noise(rng, TIP_GAIN * tip_tension)
    angle_reading = tip_angle + ANGLE_SD * rng.normal(size=tip_angle.shape)
    trial = np.repeat(np.arange(1, trials + 1), len(levels))
    return trial, base_reading.ravel(), tip_reading.ravel(), angle_reading.ravel()


def table(notes: tuple[str, ...], columns: dict[str, tuple[str, np.ndarray]]) -> str:
    """The text of a CSV file with notes at its top. A column is a format and its values."""
    formats, values = zip(*columns.values(), strict=True)
    rows = (",".join(map(format, row, formats)) for row in zip(*values, strict=True))
    return "\n".join([*(f"# {note}" for note in notes), ",".join(columns), *rows]) + "\n"


def truth(paper: cddf.Manipulator, kinematics: str) -> str:
    """The note that says what was simulated."""
    numbers = f"mu {paper.friction_coefficient}, E {paper.youngs_modulus / 1e6} MPa"
    return f"Truth: data/smooth_sil_940.toml ({numbers}), {kinematics}"


def readings(base: np.ndarray, tip: np.ndarray, angle: np.ndarray | None = None) -> dict[str, tuple[str, np.ndarray]]:
    """The columns that a bench reads, N and deg."""
    columns = {"base_tension [N]": (".2f", base), "tip_tension [N]": (".2f", tip)}
    return columns if angle is None else columns | {"tip_angle [deg]": (".1f", angle)}


def load_cells(paper: cddf.Manipulator) -> str:
    """The paper's load-cell experiment: 5 to 85 N in 5 N steps, six trials."""
    stream = 1
    trial, base, tip, _ = bench(paper, stream, np.arange(5.0, 86.0, 5.0), trials=6)
    notes = (
        NOTE.format(seed=SEED, stream=stream),
        "After the load-cell experiment of Liu et al. (2020), section IV, Fig. 8: 17 levels of 5 to 85 N, six trials.",
        truth(paper, "PUBLISHED kinematics."),
        *BENCH_NOTES,
    )
    return table(notes, {"trial": ("d", trial), **readings(base, tip)})


def tip_angle(paper: cddf.Manipulator) -> str:
    """The same bench with a camera on the tip: eight levels, three trials, exact kinematics."""
    stream = 2
    trial, base, tip, angle = bench(replace(paper, kinematics="exact"), stream, np.arange(10.0, 81.0, 10.0), trials=3)
    notes = (
        NOTE.format(seed=SEED, stream=stream),
        "Tension pairs with the heading of the tip, as a camera would add it: 8 levels of 10 to 80 N, three trials.",
        truth(paper, "but EXACT kinematics: fit it with kinematics='exact'."),
        *BENCH_NOTES,
        f"Tip angle: sd {ANGLE_SD} deg.",
    )
    return table(notes, {"trial": ("d", trial), **readings(base, tip, angle)})


def pulley(paper: cddf.Manipulator) -> str:
    """The paper's pulley test, eq. (5): five weights, two known wraps, three trials."""
    stream, mu = 3, float(paper.friction_coefficient)
    trial, wrap, weight = (
        x.ravel() for x in np.meshgrid([1, 2, 3], [90.0, 180.0], [2.0, 5.0, 10.0, 15.0, 20.0], indexing="ij")
    )
    pulling = with_noise(np.random.default_rng((SEED, stream)), weight * np.exp(mu * np.deg2rad(wrap)))
    notes = (
        NOTE.format(seed=SEED, stream=stream),
        "After the pulley test of Liu et al. (2020), section IV: a weight hangs on the tendon, which slides over a "
        "fixed pulley.",
        f"Truth: pulling_tension = weight * exp(mu * wrap_angle), eq. (5), with mu {mu}.",
        f"Noise, normal: pulling {CELL_NOTE}; weight and wrap exact.",
    )
    columns = {
        "trial": ("d", trial),
        "wrap_angle [deg]": (".0f", wrap),
        "weight [N]": (".2f", weight),
        "pulling_tension [N]": (".2f", pulling),
    }
    return table(notes, columns)


def loop(paper: cddf.Manipulator) -> str:
    """A pull and the way back on the bench with a camera: 5 to 85 to 5 N, one trial, exact kinematics."""
    stream = 4
    rng, up = np.random.default_rng((SEED, stream)), np.arange(5.0, 86.0, 5.0)
    levels = np.concatenate([up, up[-2::-1]])
    history = cddf.trace(replace(paper, kinematics="exact"), levels)
    base = levels + BASE_SD * rng.normal(size=levels.size)
    tip = LOOP_ZERO + LOOP_GAIN * np.asarray(history.tip_tension) + CELL_FLOOR * rng.normal(size=levels.size)
    angle = np.rad2deg(history.tip_angle) + ANGLE_SD * rng.normal(size=levels.size)
    notes = (
        NOTE.format(seed=SEED, stream=stream),
        "Pulled from rest and released: 17 levels of 5 to 85 N, then 16 levels back to 5 N; steps in their order.",
        truth(paper, "but EXACT kinematics: fit it with kinematics='exact'."),
        f"Noise, normal: base tension sd {BASE_SD} N; tip tension sd {CELL_FLOOR} N, tip angle sd {ANGLE_SD} deg.",
        f"The tip cell is off: gain {LOOP_GAIN}, zero {LOOP_ZERO} N.",
    )
    return table(notes, {"step": ("d", np.arange(1, levels.size + 1)), **readings(base, tip, angle)})


def write(folder: Path) -> None:
    """Write the four files into `folder`."""
    paper = read_manipulator(HERE / "smooth_sil_940.toml")
    makers = {
        "load_cells_simulated.csv": load_cells,
        "tip_angle_simulated.csv": tip_angle,
        "pulley_simulated.csv": pulley,
        "loop_simulated.csv": loop,
    }
    for name, make in makers.items():
        (folder / name).write_text(make(paper), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    write(HERE)
