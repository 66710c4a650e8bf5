"""Study: the method of the paper, Liu et al. (2020) section IV.

The pulley test determines the friction. With it the load cells determine the modulus. Both tables are fitted together,
so that the uncertainty of the friction is part of the uncertainty of the modulus.
"""

from pathlib import Path

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"


def study() -> cddf.Fit:
    """Fit friction and modulus to the pulley test and the tension pairs together."""
    manipulator = cddf.read_manipulator(DATA / "smooth_sil_940.toml")
    names = ("pulley_simulated.csv", "load_cells_simulated.csv")
    return cddf.fit(manipulator, [cddf.read_measurements(DATA / name) for name in names])


if __name__ == "__main__":
    configure_jax()
    fit = study()
    print(*fit.verdict, sep="\n")
    cddf.write_fit(fit, "out/fitting/pulley_then_tensions")
