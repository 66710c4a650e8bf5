"""The figures and numbers of Liu et al. (2020), section IV, computed here, beside those that the paper prints."""

import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from ..errors import InputError
from ..figures import looks, style as draw
from ..figures.along import draw_along
from ..figures.body import draw_force_arrows
from ..files.writing import markdown_table
from ..measurements.table import Measurements
from ..numerics.arrays import evaluated
from ..progress import stage
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..statics.literal_iteration import IterationHistory, iteration_history
from ..statics.solve import solve
from ..statics.status import Status
from .report import Report

PULL = 75.0  # N, the base tension of Fig. 4, 5 and 6
LIGHT_PULL = 10.0  # N, the other one of Fig. 6
PULLS = np.arange(0.0, 85.1, 2.5)  # N, the model's line in Fig. 8
HISTORY_PULLS = np.array([10.0, 25.0, 40.0, 55.0, 75.0, 85.0])  # N, Fig. 3
HISTORY_UPDATES = 10
LEVELS_APART = 5.0  # N, of the trials
NUMBERS = ("paper", "ours", "difference")  # of the table


class PaperResults(NamedTuple):
    """Everything that is drawn and tabulated, as NumPy arrays in SI units."""

    manipulator: Manipulator
    light: Equilibrium  # at `LIGHT_PULL`
    strong: Equilibrium  # at `PULL`
    tip_tension: np.ndarray  # at `PULLS`
    histories: IterationHistory  # base tensions `HISTORY_PULLS` first
    history: IterationHistory  # at `PULL`
    trials: str  # in words
    base_tension: np.ndarray  # of the trials, where the tip tension was read too
    observed: np.ndarray  # tip tension of the trials
    predicted: np.ndarray  # the same by the model


def reproduce(manipulator: Manipulator, load_cells: Measurements) -> Report:
    """The paper's Fig. 3, 4, 5, 6 and 8 (PDF and PNG), and a table of its numbers beside ours.

    Args:
        manipulator: the paper's, with one tendon, in the plane.
        load_cells: trials with the columns base_tension and tip_tension; simulated ones are labelled as simulated.
    """
    if manipulator.num_tendons != 1:
        raise InputError(f"the paper's manipulator has one tendon, this one has {manipulator.num_tendons}; keep one")
    if manipulator.in_space:
        raise InputError(
            "the paper's manipulator bends in a plane, this one is in space; remove the angle of its tendon"
        )
    if "tip_tension" not in load_cells:
        raise InputError(f"{load_cells.name}: the column tip_tension is missing; Fig. 8 shows it over base_tension")
    results = computed(manipulator, load_cells)
    figures = {
        "fig3_tip_error": tip_error_figure(results),
        "fig4_iterations": iterations_figure(results),
        "fig5_distributed_forces": distributed_forces_figure(results),
        "fig6_shapes": shapes_figure(results),
        "fig8_tip_tension": tip_tension_figure(results),
    }
    rows = compared_numbers(results)
    text = compared_in_words(rows)
    return Report("reproduction", text, {"table": rows}, lambda: {"reproduction.md": text, **figures})


@stage("solving")
def computed(manipulator: Manipulator, load_cells: Measurements) -> PaperResults:
    """All solves, for a manipulator and trials as in `reproduce`."""
    read = load_cells.has("tip_tension")
    base, observed = load_cells["base_tension"][read], load_cells["tip_tension"][read]
    pulls, pull = np.concatenate([PULLS, base]), partial(solve, throw=False)
    equilibria = evaluated(jax.vmap(pull, (None, 0)), manipulator, pulls)
    good = equilibria.status == Status.successful
    if not np.all(good):
        solve(manipulator, pulls[np.argmin(good)])  # raises and says why
    light, strong = (jax.tree.map(lambda x, i=i: x[i], equilibria) for i in np.searchsorted(PULLS, (LIGHT_PULL, PULL)))
    line, predicted = np.split(np.asarray(equilibria.tip_tension)[:, 0], [len(PULLS)])
    iterate = partial(iteration_history, max_updates=HISTORY_UPDATES, nodes=64)
    histories = evaluated(jax.vmap(iterate, (None, 0)), manipulator, HISTORY_PULLS)
    history = jax.tree.map(lambda x: x[np.searchsorted(HISTORY_PULLS, PULL)], histories)
    trials = "simulated trials" if load_cells.simulated else "trials"
    return PaperResults(manipulator, light, strong, line, histories, history, trials, base, observed, predicted)


# --- figures -------------------------------------------------------------------------------------


def tip_error_figure(results: PaperResults) -> Figure:
    """Fig. 3: how far each update of the paper's algorithm moves the tip."""
    history = results.histories
    updates = np.arange(1, HISTORY_UPDATES + 1)
    with draw.axes_or_new(None, 2.5) as axes:
        for pull, error, curve in zip(HISTORY_PULLS, history.tip_error, looks.CURVES, strict=True):
            axes.semilogy(updates, 1e3 * error, label=f"{pull:g} N", **curve)
        threshold = 1e3 * history.tip_tolerance
        axes.axhline(threshold, color=looks.GREY, linewidth=0.8)
        label = f"$e_\\mathrm{{tip,th}}$ = {threshold:g} mm"
        axes.text(HISTORY_UPDATES, 1.1 * threshold, label, ha="right", va="bottom")
        axes.set(xlabel="Update", ylabel="Tip error $e_\\mathrm{tip}$ (mm)", ylim=(1e-5, 1e2), xticks=updates)
        axes.legend(title="$T_\\mathrm{base}$", ncols=2)
    return draw.figure_of(axes)


def iterations_figure(results: PaperResults) -> Figure:
    """Fig. 4: the midline at each iteration, from the frictionless start."""
    history = results.history
    midlines = 1e3 * history.position[: int(history.num_updates) + 1]
    with draw.axes_or_new(None, 2.45) as axes:
        near_tip = axes.inset_axes((0.09, 0.42, 0.48, 0.56))
        axes.plot(*midlines[0].T, color=looks.BLACK, linestyle="--", label="start, no friction")
        for k, curve in zip(range(1, len(midlines)), itertools.cycle(looks.CURVES)):
            axes.plot(*midlines[k].T, **dict(curve, marker=""))
            near_tip.plot(*midlines[k].T, **curve, markevery=[-1])
            axes.plot([], [], **curve, label=f"update {k}")
        middle, reach = np.mean(midlines[1:, -1], axis=0), np.ptp(midlines[1:, -1], axis=0)
        low, high = middle - 0.9 * reach, middle + 0.9 * reach
        near_tip.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        near_tip.spines[:].set_visible(True)
        axes.indicate_inset_zoom(near_tip, edgecolor=looks.GREY, linewidth=0.5)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)", aspect="equal")
        draw.figure_of(axes).legend(loc="outside lower center", ncols=3)
    return draw.figure_of(axes)


def distributed_forces_figure(results: PaperResults) -> Figure:
    """Fig. 5: normal and friction force per length, and the tension, along the body."""
    body, equilibrium = results.manipulator, results.strong
    normal: looks.Look = {"color": looks.BLUE, "label": "normal, $|F_\\mathrm{CDDN}|$"}
    friction: looks.Look = {"color": looks.VERMILION, "linestyle": "--", "label": "friction, $|F_\\mathrm{CDDF}|$"}
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN, 3.2)
        forces, tension = figure.subplots(2, sharex=True, height_ratios=(3, 2))
        draw_along(body, equilibrium, "normal_force", forces, **normal)
        draw_along(body, equilibrium, "friction_force", forces, **friction)
        forces.set(xlabel="", ylabel="Distributed force (N/m)")
        forces.legend()
        draw_along(body, equilibrium, "tension", tension)
        figure.align_ylabels()
    return figure


def shapes_figure(results: PaperResults) -> Figure:
    """Fig. 6: the body to scale with the forces of its tendon, under a light and a strong pull."""
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 2.6)
        both = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, bent in zip(both, (results.light, results.strong), strict=True):
            draw_force_arrows(results.manipulator, bent, axes)
            axes.set_title(f"$T_\\mathrm{{base}}$ = {bent.base_tension[0]:g} N")
            axes.label_outer()
    return figure


def tip_tension_figure(results: PaperResults) -> Figure:
    """Fig. 8: tip over base tension, the model's line and the trials, and below them the difference of the two."""
    base, tip = results.base_tension, results.observed
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN, 3.6)
        axes, below = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        axes.plot(PULLS, PULLS, ":", color=looks.GREY, label="no friction, $T_\\mathrm{tip} = T_\\mathrm{base}$")
        axes.plot(PULLS, results.tip_tension, color=looks.BLUE, label="model")
        trials: looks.Look = {"linestyle": "none", "color": looks.BLACK, "markerfacecolor": "white"}
        axes.plot(base, tip, "o", label=results.trials, **trials)
        axes.set(ylabel="Tip tension $T_\\mathrm{tip}$ (N)", ylim=(0, None), xlim=(0, None))
        axes.legend()
        below.axhline(0.0, color=looks.BLUE)
        below.plot(base, tip - results.predicted, "o", **trials)
        below.set(xlabel="Base tension $T_\\mathrm{base}$ (N)", ylabel="Trials − model (N)")
        figure.align_ylabels()
    return figure


# --- table ---------------------------------------------------------------------------------------


def compared_numbers(results: PaperResults) -> list[dict[str, Any]]:
    """The numbers that section IV of the paper prints beside ours: fractions, or where they are whole numbers counts.

    The difference of numbers that cannot be compared is None.
    """
    loss = 1 - results.tip_tension[np.searchsorted(PULLS, PULL)] / PULL
    updates = int(results.history.num_updates)
    levels = len(np.unique(np.round(results.base_tension / LEVELS_APART)))
    there = results.observed > 0
    error = float(np.mean(np.abs(results.predicted[there] / results.observed[there] - 1)))
    rows = [
        ("tension_loss", f"tension loss at {PULL:g} N", 0.40, loss, loss - 0.40,
            'the paper: "about 40 %"; the difference is in percentage points'),
        ("iterations", f"iterations at {PULL:g} N", 6, updates + 1, updates - 5,
            f'the paper: "6 iterations", which counts the start; ours: the start and {updates} updates'),
        ("levels", "levels of base tension", 18, levels, levels - 18,
            "5 to 85 N in 5 N steps, as the paper says too, are 17 levels"),
        ("mean_error", "mean error of the tip tension", 0.1466, error, None,
            f"not comparable: the paper's is against its measured trials, ours against {results.trials}"),
    ]  # fmt: skip
    return [dict(zip(("name", "quantity", *NUMBERS, "note"), row, strict=True)) for row in rows]


def compared_in_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table of these numbers."""
    table = []
    for row in rows:
        count = isinstance(row["paper"], int)
        shown = ["-" if (n := row[name]) is None else f"{n:.0f}" if count else f"{100 * n:.2f} %" for name in NUMBERS]
        table.append([row["quantity"], *shown, row["note"]])
    lines = markdown_table(("quantity", *NUMBERS, "note"), table, right=NUMBERS)
    return "\n".join(["# Liu et al. (2020), section IV, reproduced", "", *lines]) + "\n"
