"""Curvature-dependent distributed friction in tendon-driven continuum manipulators (Liu et al., IROS 2020).

Names are loaded on first use, so that importing the package starts nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .bootstrap import Bootstrap
    from .closed_form import closed_form_tension
    from .contact import Contact, self_contact
    from .cross_sections import read_cross_sections, section_columns
    from .design_results import Design
    from .designing import design
    from .determination import Determination
    from .energy import EnergyBalance, energy_balance
    from .equilibrium import RESULTS, Equilibrium, Fields, SolveError
    from .errors import InputError
    from .holds import SerialCorrelation, average_holds
    from .identification import Fit, fit
    from .interchange import as_dataset, as_frame
    from .least_squares import LeastSquaresFit, least_squares_fit
    from .limits import Limit
    from .literal_iteration import IterationHistory, LiteralIteration, iteration_history
    from .load_cases import LoadCase, uncertain_cases
    from .loads import Loads
    from .manipulator import Manipulator, PointMass, Tendon, conical
    from .manipulator_file import read_manipulator, write_manipulator
    from .marching import Marching
    from .measurements import Measurements, read_measurements
    from .model_comparison import Comparison, compare, cross_validation
    from .model_free import ModelFreeFriction, model_free_friction
    from .next_measurement import Candidate, Plan, plan, standard_candidates
    from .objectives import Even, Least, Most, Near
    from .observations import Noise
    from .parameter_space import Uniform
    from .pareto import ParetoFront, pareto_front
    from .profile_likelihood import Profile
    from .profiles import Constant, Linear, Piecewise, Spline
    from .pulley import pulling_tension
    from .report import write_fit
    from .sampling import latin_hypercube, sobol
    from .solver import FixedPoint
    from .statics import solve
    from .stiffness import TipJacobian, tip_compliance, tip_jacobian
    from .sweeping import sweep
    from .targets import CurvatureAt, Displacement, TipAngle, TipStiffness, TipTension, TotalTension
    from .trial_files import read_tables

_HOME = {
    "bootstrap": "Bootstrap",
    "closed_form": "closed_form_tension",
    "contact": "Contact, self_contact",
    "cross_sections": "read_cross_sections, section_columns",
    "design_results": "Design",
    "designing": "design",
    "determination": "Determination",
    "energy": "EnergyBalance, energy_balance",
    "equilibrium": "RESULTS, Equilibrium, Fields, SolveError",
    "errors": "InputError",
    "holds": "SerialCorrelation, average_holds",
    "identification": "Fit, fit",
    "interchange": "as_dataset, as_frame",
    "least_squares": "LeastSquaresFit, least_squares_fit",
    "limits": "Limit",
    "literal_iteration": "IterationHistory, LiteralIteration, iteration_history",
    "load_cases": "LoadCase, uncertain_cases",
    "loads": "Loads",
    "manipulator": "Manipulator, PointMass, Tendon, conical",
    "manipulator_file": "read_manipulator, write_manipulator",
    "marching": "Marching",
    "measurements": "Measurements, read_measurements",
    "model_comparison": "Comparison, compare, cross_validation",
    "model_free": "ModelFreeFriction, model_free_friction",
    "next_measurement": "Candidate, Plan, plan, standard_candidates",
    "objectives": "Even, Least, Most, Near",
    "observations": "Noise",
    "parameter_space": "Uniform",
    "pareto": "ParetoFront, pareto_front",
    "profile_likelihood": "Profile",
    "profiles": "Constant, Linear, Piecewise, Spline",
    "pulley": "pulling_tension",
    "report": "write_fit",
    "sampling": "latin_hypercube, sobol",
    "solver": "FixedPoint",
    "statics": "solve",
    "stiffness": "TipJacobian, tip_compliance, tip_jacobian",
    "sweeping": "sweep",
    "targets": "CurvatureAt, Displacement, TipAngle, TipStiffness, TipTension, TotalTension",
    "trial_files": "read_tables",
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names.split(", ")}

__version__ = "0.1.0"
__all__ = [
    "RESULTS",
    "Bootstrap",
    "Candidate",
    "Comparison",
    "Constant",
    "Contact",
    "CurvatureAt",
    "Design",
    "Determination",
    "Displacement",
    "EnergyBalance",
    "Equilibrium",
    "Even",
    "Fields",
    "Fit",
    "FixedPoint",
    "InputError",
    "IterationHistory",
    "Least",
    "LeastSquaresFit",
    "Limit",
    "Linear",
    "LiteralIteration",
    "LoadCase",
    "Loads",
    "Manipulator",
    "Marching",
    "Measurements",
    "ModelFreeFriction",
    "Most",
    "Near",
    "Noise",
    "ParetoFront",
    "Piecewise",
    "Plan",
    "PointMass",
    "Profile",
    "SerialCorrelation",
    "SolveError",
    "Spline",
    "Tendon",
    "TipAngle",
    "TipJacobian",
    "TipStiffness",
    "TipTension",
    "TotalTension",
    "Uniform",
    "as_dataset",
    "as_frame",
    "average_holds",
    "closed_form_tension",
    "compare",
    "conical",
    "cross_validation",
    "design",
    "energy_balance",
    "fit",
    "iteration_history",
    "latin_hypercube",
    "least_squares_fit",
    "model_free_friction",
    "pareto_front",
    "plan",
    "pulling_tension",
    "read_cross_sections",
    "read_manipulator",
    "read_measurements",
    "read_tables",
    "section_columns",
    "self_contact",
    "sobol",
    "solve",
    "standard_candidates",
    "sweep",
    "tip_compliance",
    "tip_jacobian",
    "uncertain_cases",
    "write_fit",
    "write_manipulator",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
