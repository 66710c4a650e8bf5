"""Every drawing function, in one style: `from cddf_jax import figures`.

Functions named `draw_` take and return Matplotlib axes, so that they can be combined: `draw_shape(robot, equilibrium,
axes=axes)` draws into axes of yours, in your style, and `draw_shape(robot, equilibrium)` makes a figure as wide as a
column of a page, in the house style; it is `axes.figure`, and `save(axes.figure, "shape.pdf")` writes it. Functions
named `_figure` make a whole figure with its legends. Every axis says its unit: mm, N, deg, MPa, 1/m and per cent, what
engineers write. No display is needed, and neither pyplot nor any global setting of Matplotlib is touched.
"""

from .along_figure import draw_along
from .design_figure import design_figure, draw_design, draw_trade_off, pareto_figure
from .estimate_figures import bootstrap_figure, correlation_figure, draw_correlation
from .fit_figures import draw_fit, draw_residuals, residuals_figure, table_figures
from .force_figure import draw_force_arrows
from .plan_figure import draw_plan, plan_figure
from .plotting import DOUBLE_COLUMN, SINGLE_COLUMN, house_style, new_figure, render, save
from .profile_figures import draw_profile, profiles_figure
from .sections_figure import draw_section_column, sections_figure
from .solve_figure import draw_shape, equilibrium_figure
from .sweep_figure import sweep_figure
from .sweep_lines import draw_lines
from .sweep_maps import draw_map

__all__ = [
    "DOUBLE_COLUMN",
    "SINGLE_COLUMN",
    "bootstrap_figure",
    "correlation_figure",
    "design_figure",
    "draw_along",
    "draw_correlation",
    "draw_design",
    "draw_fit",
    "draw_force_arrows",
    "draw_lines",
    "draw_map",
    "draw_plan",
    "draw_profile",
    "draw_residuals",
    "draw_section_column",
    "draw_shape",
    "draw_trade_off",
    "equilibrium_figure",
    "house_style",
    "new_figure",
    "pareto_figure",
    "plan_figure",
    "profiles_figure",
    "render",
    "residuals_figure",
    "save",
    "sections_figure",
    "sweep_figure",
    "table_figures",
]
