"""The public drawing functions: each one once, where it is defined."""

from .along import (
    draw_along as draw_along,
)
from .body import (
    draw_force_arrows as draw_force_arrows,
    draw_shape as draw_shape,
    equilibrium_figure as equilibrium_figure,
)
from .designs import (
    design_figure as design_figure,
    draw_design as draw_design,
    draw_trade_off as draw_trade_off,
)
from .fit import (
    draw_fit as draw_fit,
    draw_profile as draw_profile,
    draw_residuals as draw_residuals,
    profiles_figure as profiles_figure,
    residuals_figure as residuals_figure,
    table_figures as table_figures,
)
from .history import (
    draw_energy as draw_energy,
    draw_loop as draw_loop,
    history_figure as history_figure,
)
from .style import (
    DOUBLE_COLUMN as DOUBLE_COLUMN,
    SINGLE_COLUMN as SINGLE_COLUMN,
    house_style as house_style,
    new_figure as new_figure,
    render as render,
)
from .sweeps import draw_lines as draw_lines, draw_map as draw_map, sweep_figure as sweep_figure
from .workspace import draw_workspace as draw_workspace

__all__: list[str]
