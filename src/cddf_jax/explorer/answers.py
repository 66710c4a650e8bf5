"""The answers of the explorer: a picture, a curve and a taper, with numbers only where a solve is good."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..figures.geometry import lines_along
from ..mechanics.fields import AnyFields, SpatialFields
from ..statics.equilibrium import Equilibrium, ended_as
from ..statics.equilibrium_text import result_in_words, wall_remarks
from ..statics.named_numbers import Case
from ..statics.status import Status

GOOD = (Status.successful, Status.direction_contradicted)


class Picture(NamedTuple):
    """An equilibrium and its fields along a grid of arc lengths; NumPy, SI."""

    case: Case
    equilibrium: Equilibrium
    along: AnyFields
    peak_strain: np.ndarray  # of the wall, a fraction

    @property
    def good(self) -> bool:
        """Whether there is something to show; other solves have no numbers, or doubtful ones."""
        return ended_as(self.equilibrium, *GOOD)

    @property
    def message(self) -> str:
        """The message of the result, as `solve` gives it, and remarks; empty if it is successful."""
        return " ".join([text for text in (result_in_words(self.equilibrium), *wall_remarks(self.equilibrium)) if text])

    @property
    def peak_curvature(self) -> float:
        """The largest |kappa|, 1/m; in space of bending alone, without twist."""
        return float(np.max(lines_along(self.case.manipulator, self.along, "bending")))

    @property
    def peak_twist(self) -> float | None:
        """The largest size of the twist, 1/m; None in the plane."""
        return float(np.max(np.abs(self.along.twist))) if isinstance(self.along, SpatialFields) else None


class Curve(NamedTuple):
    """The answer over the base tension of one tendon, with everything else as set; NaN where no solve is good. SI."""

    tendon: int  # from 0
    base_tension: np.ndarray
    tip_tension: np.ndarray
    tip_angle: np.ndarray


class Taper(NamedTuple):
    """The results for one taper of the body, SI; NaN where a solve is not good."""

    tension_loss: float  # of tendon 1 at the tensions that are set
    tip_angle: float
    peak_strain: float
    base_tension: float  # of tendon 1 at which the tip has the angle that is asked for
    strain_there: float


def where_good(status: Int[Array, "*lanes"], numbers: tuple) -> tuple:
    """The numbers of a solve; NaN without a good status."""
    good = (status == GOOD[0]) | (status == GOOD[1])
    return tuple(jnp.where(good, number, jnp.nan) for number in numbers)
