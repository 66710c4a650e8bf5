"""Study: load cells at base and tip alone. They determine only the ratio of friction and modulus."""

from pathlib import Path

import cddf_jax as cddf
from cddf_jax.application import configure_jax

DATA = Path(__file__).parents[1] / "data"


def study() -> cddf.Fit:
    """Fit friction and modulus to tension pairs."""
    manipulator = cddf.read_manipulator(DATA / "smooth_sil_940.toml")
    return cddf.fit(manipulator, cddf.read_measurements(DATA / "load_cells_simulated.csv"))


if __name__ == "__main__":
    configure_jax()
    fit = study()
    print(*fit.verdict, sep="\n")
    cddf.write_fit(fit, "out/fitting/tensions_only")
