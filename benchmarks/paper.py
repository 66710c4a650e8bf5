"""The paper's body, which most benchmarks measure."""

from typing import Any

import cddf_jax as cddf


def paper_body(**changes: Any) -> cddf.Manipulator:
    """In the exact kinematics, as long as `kinematics` is not among the changes."""
    numbers = {
        "length": 0.140,
        "outer_radius": (0.020, 0.013),
        "inner_radius": 0.007,
        "tendon_offset": 0.010,
        "youngs_modulus": 1.4e6,
        "friction_coefficient": 0.42,
    }
    return cddf.conical(**{**numbers, **changes})
