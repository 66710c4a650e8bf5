"""The answer of `cddf design`: a design, or a trade-off between two objectives."""

from .. import figures
from ..designing.pareto import ParetoFront
from ..designing.results import Design
from ..designing.task_file import DesignTask
from ..files.cross_sections import cross_sections_csv
from ..files.manipulator_file import manipulator_text
from .report import Content, Report


def design_report(task: DesignTask, found: Design | ParetoFront) -> Report:
    """A design or a trade-off; the files hold the manipulators of those designs that keep to all limits."""
    is_front = isinstance(found, ParetoFront)
    designs = {f"design_{i}": each for i, each in enumerate(found.designs, 1)} if is_front else {"design": found}
    name, answer, text = "pareto" if is_front else "design", found.as_dict(), str(found)

    def files() -> dict[str, Content]:
        made: dict[str, Content] = {f"{name}.md": text + "\n"}
        if isinstance(found, ParetoFront):
            from ..figures.style import figure_of

            made[name] = figure_of(figures.draw_trade_off(found))
        elif found.feasible:
            made[name] = figures.design_figure(found)
            made |= {"profile.csv": cross_sections_csv(found.manipulator)} if found.manipulator.has_radii else {}
        return made | {f"{each}.toml": _file(task, design) for each, design in designs.items() if design.feasible}

    failure = "" if found.success else f"the design is not done: {answer['result']}"
    return Report(name, text, answer, files, failure)


def _file(task: DesignTask, found: Design) -> str:
    outside = task.arguments["offsets_outside_wall"]
    return manipulator_text(found.manipulator, offsets_outside_wall=outside, gravity=task.gravity)
