"""Curvature-dependent distributed friction in tendon-driven continuum manipulators (Liu et al., IROS 2020).

Names are loaded on first use, so that importing the package starts nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .closed_form import closed_form_tension
    from .equilibrium import RESULTS, Equilibrium, Fields, SolveError
    from .literal_iteration import IterationHistory, LiteralIteration, iteration_history
    from .manipulator import Manipulator, Tendon, conical
    from .marching import Marching
    from .profiles import Constant, Linear, Piecewise, Spline
    from .solver import FixedPoint
    from .statics import solve

_HOME = {
    "closed_form": ("closed_form_tension",),
    "equilibrium": ("RESULTS", "Equilibrium", "Fields", "SolveError"),
    "literal_iteration": ("IterationHistory", "LiteralIteration", "iteration_history"),
    "manipulator": ("Manipulator", "Tendon", "conical"),
    "profiles": ("Constant", "Linear", "Piecewise", "Spline"),
    "marching": ("Marching",),
    "solver": ("FixedPoint",),
    "statics": ("solve",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__version__ = "0.1.0"
__all__ = [
    "RESULTS",
    "Constant",
    "Equilibrium",
    "Fields",
    "FixedPoint",
    "IterationHistory",
    "Linear",
    "LiteralIteration",
    "Manipulator",
    "Marching",
    "Piecewise",
    "SolveError",
    "Spline",
    "Tendon",
    "closed_form_tension",
    "conical",
    "iteration_history",
    "solve",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
