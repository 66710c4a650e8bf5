"""The public names of cddf_jax: each one once, where it is defined."""

from .application import keep_programs as keep_programs
from .designing.design import design as design
from .designing.load_cases import LoadCase as LoadCase, uncertain_cases as uncertain_cases
from .designing.objectives import Even as Even, Least as Least, Limit as Limit, Most as Most, Near as Near
from .designing.pareto import ParetoFront as ParetoFront, pareto_front as pareto_front
from .designing.results import Design as Design
from .errors import InputError as InputError, SolveError as SolveError
from .estimation.determination import Determination as Determination
from .estimation.least_squares import LeastSquaresFit as LeastSquaresFit, least_squares_fit as least_squares_fit
from .estimation.observations import Noise as Noise
from .estimation.profile_likelihood import Profile as Profile
from .files.cross_sections import read_cross_sections as read_cross_sections
from .files.manipulator_file import (
    RobotFile as RobotFile,
    read_manipulator as read_manipulator,
    read_robot_file as read_robot_file,
    write_manipulator as write_manipulator,
)
from .history.history import History as History
from .history.trace import trace as trace
from .identification.experiment_design import (
    Candidate as Candidate,
    Plan as Plan,
    plan as plan,
    standard_candidates as standard_candidates,
)
from .identification.fit import Fit as Fit, fit as fit
from .identification.model_free import (
    ModelFreeFriction as ModelFreeFriction,
    model_free_friction as model_free_friction,
)
from .identification.parameters import BenchSetting as BenchSetting
from .measurements.holds import average_holds as average_holds
from .measurements.markers import Marker as Marker
from .measurements.table import Measurements as Measurements, read_measurements as read_measurements
from .measurements.trials import read_tables as read_tables
from .mechanics.capstan import closed_form_tension as closed_form_tension, pulling_tension as pulling_tension
from .mechanics.fields import Fields as Fields, SpatialFields as SpatialFields
from .mechanics.march import FixedPoint as FixedPoint
from .progress import show_progress as show_progress
from .reports.export import as_dataset as as_dataset, as_frame as as_frame
from .reports.fit_report import write_fit as write_fit
from .robot.loads import Loads as Loads, PointLoad as PointLoad
from .robot.manipulator import Manipulator as Manipulator, PointMass as PointMass, Tendon as Tendon, conical as conical
from .robot.profiles import Constant as Constant, Linear as Linear, Piecewise as Piecewise, Spline as Spline
from .statics.contact import Contact as Contact, self_contact as self_contact
from .statics.equilibrium import Equilibrium as Equilibrium
from .statics.literal_iteration import (
    IterationHistory as IterationHistory,
    LiteralIteration as LiteralIteration,
    iteration_history as iteration_history,
)
from .statics.response import (
    TipJacobian as TipJacobian,
    tip_compliance as tip_compliance,
    tip_jacobian as tip_jacobian,
)
from .statics.solve import solve as solve
from .statics.status import Status as Status, in_words as in_words
from .statics.targets import (
    CurvatureAt as CurvatureAt,
    Displacement as Displacement,
    TipAngle as TipAngle,
    TipPosition as TipPosition,
    TipStiffness as TipStiffness,
    TipTension as TipTension,
    TotalTension as TotalTension,
)
from .sweeping.axes import latin_hypercube as latin_hypercube, sobol as sobol
from .sweeping.sweep import sweep as sweep

__version__: str

__all__: list[str]
