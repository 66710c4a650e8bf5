"""Study: all 22 poses of a measured soft tentacle in space (../shared/data/soft_tentacle), see `soft_tentacle`.

Fourteen poses have one tendon pulled, eight have two and leave every plane. Gravity acts along the straight body. One
modulus is fitted to all markers at once, with and without an axis that stretches and shears, without friction and with
one friction coefficient. The errors are those of the model: what the fits tell of friction is said in the report.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from soft_tentacle import (
    AHEAD,
    ANCHOR,
    ASIDE,
    BOUNDS,
    GRAVITY,
    LENGTH,
    MARKER,
    POSE_ERROR,
    START,
    TABLE,
    body as planar_body,
    described,
    rms,
)

import cddf_jax as cddf
from cddf_jax.application import configure_jax
from cddf_jax.files.artifacts import as_json, write_all

OUT = "out/fitting/soft_tentacle_in_space"
ANGLES = np.radians([30.0, 150.0])  # of the tendons, from y to z of the body
TO_BODY = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # x along the body, which hangs along -z
CASES = {
    "modulus": (False, ("youngs_modulus",)),
    "modulus and friction": (False, ("youngs_modulus", "friction_coefficient")),
    "modulus, stretch and shear": (True, ("youngs_modulus",)),
    "modulus and friction, stretch and shear": (True, ("youngs_modulus", "friction_coefficient")),
}


class Poses(NamedTuple):
    """The poses in the frame at the base, x along the straight body; m and N."""

    tension: np.ndarray  # (poses, 2)
    markers: np.ndarray  # (poses, markers, 3)

    @property
    def with_two(self) -> np.ndarray:
        """Whether both tendons are pulled."""
        return np.all(self.tension > 0, axis=1)


def read_poses() -> Poses:
    """The whole table."""
    table: Any = np.genfromtxt(TABLE, delimiter=",", names=True, dtype=None, encoding="utf-8")
    tension = np.stack([table["tendon1_tension_N"], table["tendon2_tension_N"]], axis=1)
    places = [[table[f"m{i}_{axis}_m"] for axis in "xyz"] for i in (1, 2, 3, 4)]
    return Poses(tension, np.moveaxis(np.array(places), -1, 0) @ TO_BODY.T)


def body(youngs_modulus: Any, friction_coefficient: Any, extensible: bool) -> cddf.Manipulator:
    """The tentacle with both of its tendons."""
    plain = planar_body(youngs_modulus, friction_coefficient, "exact")
    offset = plain.tendons[0].offset
    tendons = tuple(cddf.Tendon(offset, end=ANCHOR, angle=angle) for angle in ANGLES)
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=plain.outer_radius,
        inner_radius=0.0,
        tendons=tendons,
        youngs_modulus=youngs_modulus,
        friction_coefficient=friction_coefficient,
        density=plain.density,
        extensible=extensible,
    )


class Prediction(eqx.Module):
    """Predicts the markers of all poses from parameters."""

    tension: Any
    extensible: bool = eqx.field(static=True)

    def __call__(self, parameters: dict[str, Any]) -> jax.Array:
        friction = parameters.get("friction_coefficient", 0.0)
        tentacle = body(parameters["youngs_modulus"], friction, self.extensible)
        loads = cddf.Loads(gravity=(GRAVITY, 0.0, 0.0))

        def markers(tension: jax.Array) -> jax.Array:
            at = cddf.solve(tentacle, tension, loads, direction=1.0, nodes=12, throw=False).at(MARKER)
            return at.position + AHEAD[:, None] * at.frame[..., 0] + ASIDE[:, None] * at.frame[..., 2]

        return jax.vmap(markers)(self.tension)


def fit(poses: Poses, extensible: bool, free: tuple[str, ...]) -> cddf.LeastSquaresFit:
    """Fit the free parameters to all poses."""
    predict = Prediction(jnp.asarray(poses.tension), extensible)
    start, bounds = ({name: table[name] for name in free if name in table} for table in (START, BOUNDS))
    sigma = np.full(poses.markers.shape, POSE_ERROR)
    return cddf.least_squares_fit(predict, start, poses.markers, sigma, bounds, max_steps=50)


def report(poses: Poses, fits: dict[str, cddf.LeastSquaresFit]) -> dict[str, Any]:
    """Each fit with its errors, mm per coordinate, of the poses with one tendon and with two."""
    table = {}
    for name, found in fits.items():
        errors = 1e3 * rms(found.residuals, axis=(1, 2)) if found.residuals.ndim == 3 else None
        apart = np.asarray(found.residuals).reshape(poses.markers.shape)
        table[name] = described(found) | {
            "rms_one_tendon_mm": 1e3 * rms(apart[~poses.with_two]),
            "rms_two_tendons_mm": 1e3 * rms(apart[poses.with_two]),
            "rms_of_each_pose_mm": errors,
        }
    return table


def main() -> None:
    """Fit, print, and write the results."""
    configure_jax()
    poses = read_poses()
    fits = {name: fit(poses, *case) for name, case in CASES.items()}
    found = report(poses, fits)
    for name, row in found.items():
        values = ", ".join(f"{key} {float(value):.4g}" for key, value in row["value"].items())
        one, two = row["rms_one_tendon_mm"], row["rms_two_tendons_mm"]
        print(f"{name}: {values}; {one:.2f} mm with one tendon, {two:.2f} mm with two")
    write_all(OUT, {"results.json": as_json(found)})


if __name__ == "__main__":
    main()
