"""Study: a simulated loop. The way back tells friction, modulus and the errors of the tip cell without other tests."""

from dataclasses import replace
from pathlib import Path

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"
FREE = ("friction_coefficient", "youngs_modulus", "tip_gain", "tip_zero")


def study() -> cddf.Fit:
    """Fit friction, modulus, gain and zero of the tip cell to a pull and the way back."""
    manipulator = replace(cddf.read_manipulator(DATA / "smooth_sil_940.toml"), kinematics="exact")
    return cddf.fit(manipulator, cddf.read_measurements(DATA / "loop_simulated.csv"), FREE)


if __name__ == "__main__":
    configure_jax()
    fit = study()
    print(*fit.verdict, sep="\n")
    cddf.write_fit(fit, "out/fitting/loop_simulated")
