"""Study: the pulley test alone. It determines the friction, Liu et al. (2020) eq. (5), but not the modulus."""

from pathlib import Path

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"


def study() -> cddf.Fit:
    """Fit the friction coefficient to the pulley test."""
    manipulator = cddf.read_manipulator(DATA / "smooth_sil_940.toml")
    pulley = cddf.read_measurements(DATA / "pulley_simulated.csv")
    return cddf.fit(manipulator, pulley, free=("friction_coefficient",))


if __name__ == "__main__":
    configure_jax()
    fit = study()
    print(*fit.verdict, sep="\n")
    cddf.write_fit(fit, "out/fitting/pulley")
