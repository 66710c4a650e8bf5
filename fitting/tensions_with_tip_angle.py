"""Study: tensions and tip angles, exact kinematics. They determine friction and modulus without a pulley test."""

from dataclasses import replace
from pathlib import Path

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"


def study() -> cddf.Fit:
    """Fit friction and modulus to tension pairs with tip angles."""
    manipulator = replace(cddf.read_manipulator(DATA / "smooth_sil_940.toml"), kinematics="exact")
    return cddf.fit(manipulator, cddf.read_measurements(DATA / "tip_angle_simulated.csv"))


if __name__ == "__main__":
    configure_jax()
    fit = study()
    print(*fit.verdict, sep="\n")
    cddf.write_fit(fit, "out/fitting/tensions_with_tip_angle")
