"""The answer of `cddf plan`."""

from ..estimation.determination import NOT_IDENTIFIED, Determination
from ..files.writing import markdown_table, picked
from ..identification.experiment_design import Plan, Ranked
from ..identification.parameters import unit_of
from ..identification.verdict import error_in_words
from .report import Report


def plan_report(plan: Plan) -> Report:
    """What to measure next."""
    text, answer = plan_as_markdown(plan), plan_as_dict(plan)
    return Report("plan", text, answer, lambda: {"plan.md": text})


def plan_as_markdown(plan: Plan) -> str:
    """First in words what to do, then the table."""
    lines = ["# What to measure next", "", f"- now: {_known_in_words(plan.now)}"]
    for i, ranked in enumerate(plan.chosen, 1):
        lines.append(f"- {i}. {ranked.candidate.name}: then {_known_in_words(ranked.expected)}")
    rows = []
    for ranked in plan.ranking:
        names, expected = ranked.expected.names, ranked.expected
        errors = ", ".join(f"{name} {error_in_words(expected, name)}" for name in names)
        lost = ", ".join(name for name in names if expected.status[name] == NOT_IDENTIFIED)
        gain = f"{ranked.gain:.2f}".replace("-0.00", "0.00")
        rows.append([ranked.candidate.name, gain, errors, f"all but {lost}" if lost else "all"])
    head = ("candidate", "gain", "expected standard error", "identified")
    lines += ["", *markdown_table(head, rows)]
    gain = "growth of the logarithm of the determinant of the Fisher information (D-optimality)"
    if plan.criterion != "D":
        gain = f"fall of the logarithm of the standard error of {plan.criterion} (c-optimality)"
    lines += ["", f"Gain: {gain}, each candidate alone.", ""]
    return "\n".join(lines + [f"- warning: {r.candidate.name}: {text}" for r in plan.ranking for text in r.warnings])


def _known_in_words(known: Determination) -> str:
    parts = [f"{name} +- {error_in_words(known, name)}" for name in known.names if known.status[name] != NOT_IDENTIFIED]
    parts += [f"{name} +- {100 * e.standard_error / e.value:.2g} %" for name, e in known.combinations.items()]
    lost = [f"{name} not identified" for name in known.names if known.status[name] == NOT_IDENTIFIED]
    return "; ".join(parts + lost)


def plan_as_dict(plan: Plan) -> dict[str, object]:
    """A plan for JSON, SI units; an infinite number becomes null there."""

    def told(ranked: Ranked) -> dict[str, object]:
        expected = ranked.expected
        unit = {name: unit_of(name) for name in (*expected.names, *expected.combinations)}
        numbers = picked(ranked, ("gain", "warnings")) | picked(expected, ("standard_error", "status", "combinations"))
        return {"name": ranked.candidate.name, "unit": unit} | numbers

    now = picked(plan.now, ("value", "standard_error", "status"))
    ranking, chosen = (list(map(told, some)) for some in (plan.ranking, plan.chosen))
    return {"criterion": plan.criterion, "now": now, "ranking": ranking, "chosen": chosen}
