"""Every quantity with a name in a file, a table, a sweep, a fit or a figure: its dimension, its words and its label.

Other modules use names of this registry, and add what only they need.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError
from .units import Dimension, preferred, shown, si_unit


class Quantity(NamedTuple):
    """A kind of number, in SI units wherever it is kept."""

    name: str
    dimension: Dimension | None  # None without any unit: a label, yes or no, mixed units
    description: str = ""  # in a few words, if the name does not say enough
    title: str = ""  # at an axis or in a table, if it is not the name in words
    symbol: str = ""  # in formulas, as Matplotlib takes it

    @property
    def words(self) -> str:
        """The description, or else the name in words: "tip tension"."""
        return self.description or self.name.replace("_", " ")

    @property
    def label(self) -> str:
        """The label of an axis or a column, without the unit: "Tip tension"."""
        return self.title or self.name.replace("_", " ").capitalize()

    @property
    def unit(self) -> str:
        """The SI unit, "1" for a plain number, "" without a unit."""
        return "" if self.dimension is None else si_unit(self.dimension)

    @property
    def shown(self) -> tuple[float, str]:
        """The factor from SI to the unit in figures, and that unit: "%" of a strain, "" for a plain number."""
        return (1.0, "") if self.dimension is None else preferred(self.dimension)

    @property
    def axis_label(self) -> str:
        """Label, symbol and unit of an axis: "Tension $T$ (N)"."""
        unit = self.shown[1]
        return " ".join(part for part in (self.label, self.symbol, f"({unit})" if unit else "") if part)


_ALL = (
    # the manipulator
    Quantity("length", "length"),
    Quantity("outer_radius", "length"),
    Quantity("inner_radius", "length"),
    Quantity("wall_thickness", "length"),
    Quantity("offset", "length"),
    Quantity("angle", "angle", "angle of the tendon around the axis"),
    Quantity("clearance", "length", "clearance of the tendons to both sides of the wall"),
    Quantity("end", "length"),
    Quantity("free_length", "length"),
    Quantity("outside_compliance", "compliance", "compliance of the tendon outside the body"),
    Quantity("tendon_stretch", "stretch", "strain of the tendon per tension, 1 / (E A)"),
    Quantity("outside_friction", "dimensionless", "friction of the tendon outside the body, mu times wrap angle"),
    Quantity("outside_drag", "force", "constant friction of the tendon outside the body"),
    Quantity("friction_moment", "moment", "friction moment of the body"),
    Quantity("youngs_modulus", "pressure", title="Young's modulus"),
    Quantity("stiffness_factor", "dimensionless"),
    Quantity("axial_factor", "dimensionless", "factor on the axial stiffness"),
    Quantity("shear_factor", "dimensionless", "factor on the shear stiffness"),
    Quantity("bending_stiffness", "bending stiffness"),
    Quantity("torsional_stiffness", "torsional stiffness"),
    Quantity("axial_stiffness", "force"),
    Quantity("shear_stiffness", "force"),
    Quantity("poissons_ratio", "dimensionless", title="Poisson's ratio"),
    Quantity("rest_curvature", "curvature", "twist and curvatures about y and z at rest"),
    Quantity("yield_strain", "strain"),
    Quantity("friction_coefficient", "dimensionless"),
    Quantity("drag", "force per length"),
    Quantity("density", "density"),
    Quantity("mass_per_length", "mass per length"),
    Quantity("mass", "mass"),
    Quantity("volume", "volume"),
    Quantity("taper", "dimensionless", "decrease of the outer radius along the body"),
    Quantity("slope", "dimensionless", "slope of both radii, either way"),
    # what acts on it
    Quantity("base_tension", "force"),
    Quantity("total_tension", "force"),
    Quantity("direction", "dimensionless", "direction of sliding, +1 in and -1 out"),
    Quantity("tip_force", "force"),
    *(Quantity(f"tip_force_{axis}", "force") for axis in "xyz"),
    Quantity("tip_moment", "moment"),
    Quantity("force", "force", "force at a point"),
    Quantity("moment", "moment", "moment at a point"),
    Quantity("gravity", "acceleration"),
    # its equilibrium
    Quantity("tip_tension", "force"),
    Quantity("tension_loss", "strain", "loss of tension"),
    Quantity("displacement", "length"),
    Quantity("tendon_displacement", "length"),
    Quantity("tip_angle", "angle", "heading of the tip"),
    Quantity("tip_position", "length", "position of the tip"),
    Quantity("tip_frame", "dimensionless", "axes of the tip, in columns"),
    *(Quantity(f"tip_{axis}", "length", title=f"Tip position {axis.upper()}") for axis in "xyz"),
    *(Quantity(f"tip_axis_{axis}", "dimensionless", f"{axis.upper()} of the direction of the tip") for axis in "xyz"),
    *(Quantity(f"tip_stiffness{axis}", "stiffness") for axis in ("", "_x", "_y", "_z")),
    Quantity("tip_twist", "curvature", "twist at the tip"),
    Quantity("base_moment", "moment", "moment of the loads at the base"),
    Quantity("peak_strain", "dimensionless", "peak strain of the wall"),
    Quantity("peak_strain_at", "length", "arc length of the peak strain"),
    # its history
    Quantity("front", "length", "arc length up to which the tendon slid last"),
    Quantity("num_turns", "dimensionless", "turns that are still remembered"),
    Quantity("work", "energy", "work put in at the base"),
    Quantity("friction_loss", "energy", "energy lost to friction"),
    Quantity("stored_energy", "energy", "energy stored in the body"),
    # along it
    Quantity("arc_length", "length", symbol="$s$"),
    Quantity("curvature", "curvature", symbol=r"$\kappa$"),
    Quantity("twist", "curvature"),
    Quantity("bending", "curvature", "size of the curvature without twist"),
    Quantity("heading", "angle", symbol=r"$\phi$"),
    Quantity("frame", "dimensionless", "axes of the cross-section, in columns"),
    Quantity("path", "length", "place of the tendon"),
    Quantity("position", "length"),
    Quantity("strain", "strain", symbol=r"$R|\kappa|$"),
    Quantity("crossing", "dimensionless", "curvature times offset; 1 where fibres cross"),
    Quantity("tension", "force", symbol="$T$"),
    Quantity("wrap_angle", "angle"),
    Quantity("normal_force", "force per length", "normal force on the body", symbol=r"$|F_\mathrm{CDDN}|$"),
    Quantity("friction_force", "force per length", "friction force on the body", symbol=r"$|F_\mathrm{CDDF}|$"),
    # how it was solved
    Quantity("target_miss", None, "reached less wanted, SI"),
    Quantity("load_fraction", "dimensionless", "fraction of the loads carried"),
    Quantity("num_load_steps", "dimensionless", "steps of the loads"),
    Quantity("stable", None, "stability"),
    Quantity("direction_contradicted", None, "travel against the direction"),
    Quantity("error_estimate", "dimensionless", "estimated relative error"),
    Quantity("num_iterations", "dimensionless", "iterations"),
    # the bench
    Quantity("trial", None),
    Quantity("step", None),
    Quantity("time", "time"),
    Quantity("weight", "force"),
    Quantity("pulling_tension", "force"),
    Quantity("outer_radius_error", "length"),
    Quantity("tendon_offset_error", "length"),
    Quantity("base_gain", "dimensionless"),
    Quantity("tip_gain", "dimensionless"),
    Quantity("base_zero", "force"),
    Quantity("tip_zero", "force"),
    Quantity("pretension", "force"),
    Quantity("slack_offset", "length", "displacement at which a tendon begins to pull"),
    Quantity("backlash", "length", "way back of a motor before the tendon follows"),
    Quantity("lag", "time", "time by which the body comes after the motors"),
    Quantity("angle_zero", "angle"),
    *(Quantity(f"marker_{axis}", "length", title=f"Marker position {axis.upper()}") for axis in "xyz"),
    *(Quantity(f"camera_{axis}", "length", "where the camera sees the base") for axis in "xyz"),
    *(Quantity(f"camera_turn_{axis}", "angle", "turn of the body's frame in that of the camera") for axis in "xyz"),
    *(Quantity(f"gravity_turn_{axis}", "angle", "turn of gravity in the body's frame") for axis in "xyz"),
    Quantity("tendon_angle_error", "angle", "true angle of the tendons less that stated"),
    Quantity("before", "force", "largest base tension before the first row", "Base tension before"),
)
QUANTITIES: dict[str, Quantity] = {known.name: known for known in _ALL}


# the range, SI, of what has a sign and whole turns in the plane, and is an angle between two axes or a size in space
IN_SPACE = {"tip_angle": (0.0, math.pi), "heading": (0.0, math.pi), "curvature": (0.0, math.inf)}


def check_range_in_space(what: str, name: str, values: ArrayLike) -> None:
    """Refuse values that a quantity cannot have in space.

    Raises:
        InputError: for the largest of them, with the remedy; it begins with `what`.
    """
    low, high = IN_SPACE.get(name, (-math.inf, math.inf))
    values = np.ravel(values)
    outside = values[(values < low) | (values > high)]
    if outside.size:
        dimension = dimension_of(name)
        upper = f" and at most {shown(high, dimension)}" if high < math.inf else ""
        rule = f"{name} of a body in space is 0 or more{upper}, got {shown(max(outside, key=abs), dimension)}"
        raise InputError(rule, where=what, remedy=TAKE_THE_PLANE)


TAKE_THE_PLANE = "take a body in the plane (tendons with a side and no angle), where it has a sign and no limit"


def dimension_of(name: str) -> Dimension:
    """The dimension of a known quantity that has a unit or is a plain number."""
    dimension = QUANTITIES[name].dimension
    assert dimension is not None, name
    return dimension
