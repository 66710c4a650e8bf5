"""The answer of `cddf design`: a design, or a trade-off between two objectives."""

from .. import figures
from ..designing.pareto import ParetoFront
from ..designing.results import Design
from ..designing.task_file import DesignTask
from ..files.cross_sections import cross_sections_csv
from ..files.manipulator_file import manipulator_text
from .report import Content, Report


def design_report(task: DesignTask, found: Design) -> Report:
    """A design; the files hold the new manipulator only where it keeps to all limits."""
    answer, text = found.as_dict(), str(found)

    def files() -> dict[str, Content]:
        made: dict[str, Content] = {"design.md": text + "\n"}
        if found.feasible:
            made |= {"design.toml": _manipulator_file(task, found), "design": figures.design_figure(found)}
        if found.feasible and found.manipulator.has_radii:
            made["profile.csv"] = cross_sections_csv(found.manipulator)
        return made

    failure = "" if found.success else f"the design is not done: {answer['result']}"
    return Report("design", text, answer, files, failure)


def trade_off_report(task: DesignTask, front: ParetoFront) -> Report:
    """A trade-off; the files hold the manipulators of the points that keep to all limits."""
    answer, text = front.as_dict(), str(front)

    def files() -> dict[str, Content]:
        from ..figures.style import figure_of

        feasible = {i: found for i, found in enumerate(front.designs, 1) if found.feasible}
        robots = {f"design_{i}.toml": _manipulator_file(task, found) for i, found in feasible.items()}
        return {"pareto.md": text + "\n", "pareto": figure_of(figures.draw_trade_off(front))} | robots

    failure = "" if front.success else f"the design is not done: {answer['result']}"
    return Report("pareto", text, answer, files, failure)


def _manipulator_file(task: DesignTask, found: Design) -> str:
    outside = task.arguments["offsets_outside_wall"]
    return manipulator_text(found.manipulator, offsets_outside_wall=outside, gravity=task.gravity)
