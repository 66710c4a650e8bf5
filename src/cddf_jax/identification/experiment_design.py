"""`plan`: which measurement to do next, by the Fisher information that each candidate would add.

The expected standard errors are those of the linearised model at the estimate (D- and c-optimal design, as in
Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, ch. 10). Where a parameter is not identified yet, the
estimate is one of many that fit; the plan is then only as good as that guess.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import InputError
from ..estimation.determination import Determination, determine
from ..estimation.evidence import Evidence, without_nan
from ..estimation.parameter_space import Priors, parameter_space, priors_of
from ..estimation.residuals import Shared
from ..measurements.readings import of_tendons
from ..numerics.given_numbers import check_numbers
from ..progress import each
from ..robot.manipulator import Manipulator
from ..statics.status import NOTEWORTHY, words_of
from .fit import Fit
from .fit_inputs import Conditions, unread_rows, unread_table
from .parameters import (
    PLAIN,
    BenchSetting,
    Parameters,
    free_parameters,
    parameter_named,
    starting_value,
)
from .verdict import OUTSIDE

BEFOREHAND = 100.0  # relative standard error before any data, for designs that leave a parameter undetermined


@dataclass(frozen=True)
class Candidate:
    """An experiment that could be done.

    Args:
        name: for the report.
        conditions: columns that are set in an experiment on a manipulator or in a pulley test, SI; numbers, or lists
            of one length: base tensions, displacements, and known forces as in tables (`tip_force_y`, `force_y@60mm`).
            With a column `step` they are set in this order, from rest.
        noise: standard deviation of each column that is read, SI.
    """

    name: str
    conditions: Conditions
    noise: Mapping[str, float]

    def __post_init__(self):
        for column, numbers in (*self.conditions.items(), *self.noise.items()):
            check_numbers(f"candidate {self.name!r}: {column}", numbers)
        if not self.noise or not all(np.ndim(noise) == 0 and noise > 0 for noise in self.noise.values()):
            raise InputError(f"candidate {self.name!r}: noise must name what is read, with standard deviations > 0")


Rows = tuple[np.ndarray, tuple[str, ...]]  # rows of the scaled Jacobian, and warnings


@dataclass(frozen=True)
class Ranked:
    """A candidate, and what would be determined with it."""

    candidate: Candidate
    expected: Determination
    gain: float  # by the criterion: increase of ln det of the information, or decrease of ln of the standard error
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Plan:
    """All candidates, ranked by what each alone would add; and those to do one after the other."""

    criterion: str  # "D" or the name of a parameter
    now: Determination  # what is determined so far
    ranking: tuple[Ranked, ...]  # the best first
    chosen: tuple[Ranked, ...]  # each is the best after those before it; `expected` includes them

    def __str__(self) -> str:
        lines = [f"{ranked.candidate.name}: gain {ranked.gain:.4g}" for ranked in self.ranking]
        return "\n".join([f"by {self.criterion}, the best first:", *lines])


def plan(
    known: Manipulator | Fit,
    candidates: Sequence[Candidate],
    free: Sequence[str] | None = None,
    *,
    priors: Priors | None = None,
    setting: BenchSetting = PLAIN,
    criterion: str = "D",
    num: int = 3,
    nodes: int = 16,
) -> Plan:
    """Rank candidates by what they would add to the knowledge of the parameters.

    Args:
        known: a fit, to whose data the candidates would be added; or a manipulator, before any data.
        candidates: what could be measured; one may be chosen more than once.
        free: parameters to determine, of `parameters.PARAMETERS`; None as in `fit`. A fit has its own.
        priors: by parameter, mean and standard deviation, SI. A fit has its own.
        setting: what all rows share, as in `fit`. A fit has its own.
        criterion: "D" for all parameters together (the volume of their joint interval), or the name of the one
            whose standard error is to become smallest (c-optimal).
        num: how many candidates to choose, one after the other.
        nodes: as in `solve`.

    Raises:
        InputError: without candidates, for a fit that failed, unknown parameters or an unknown criterion.
    """
    if not candidates:
        raise InputError("plan: there are no candidates; give one or more")
    if isinstance(known, Fit):
        if not known.success:
            raise InputError(f"plan: the fit of the data failed: {known.result}")
        if known.trial_effects:
            raise InputError("plan: needs a fit whose friction is the same in every trial; fit without per_trial")
        body, parameters, nodes = known.model.manipulator, known.parameters, known.model.nodes
        evidence, setting = known.widened, known.whole_setting
    else:
        body, parameters = (
            known,
            {name: starting_value(known, name, setting.given) for name in free_parameters(known, free)},
        )
        evidence = _nothing_measured(parameters, priors or {})
    if criterion != "D" and criterion not in evidence.space.names:
        raise InputError(f"plan: criterion {criterion!r} is neither D nor one of {', '.join(evidence.space.names)}")
    rows = [_rows(one, body, setting, parameters, evidence.size, nodes) for one in each("candidate", candidates)]
    ranking = tuple(ranked for ranked, _ in _rank(evidence, candidates, rows, criterion))
    chosen, so_far = [], evidence
    for _ in range(num):
        best, so_far = _rank(so_far, candidates, rows, criterion)[0]
        chosen.append(best)
    return Plan(criterion, determine(evidence), ranking, tuple(chosen))


def _nothing_measured(parameters: Mapping[str, float], priors: Priors) -> Evidence:
    names = tuple(sorted(parameters))
    kinds = [parameter_named(name) for name in names]
    value = np.array([parameters[name] for name in names])
    lower = np.where([kind.positive for kind in kinds], 0.0, -np.inf)
    scale = np.array([kind.scale for kind in kinds])
    size = np.where(value == 0, scale, np.abs(value))
    prior_rows = {
        i: np.eye(len(names))[i : i + 1] * size[i] / float(prior.standard_deviation)
        for i, prior in priors_of(names, priors).items()
    }
    return Evidence(
        space=parameter_space(names, value, lower, np.full(len(names), np.inf), scale),
        value=value,
        size=size,
        at_bound=np.zeros(len(names), bool),
        rows={"before": np.zeros((len(names), len(names)))},  # nothing
        prior_rows=prior_rows,
        noise_slopes={"before": np.zeros((len(names), 0))},
        shared=Shared.of({}, {}, len(names)),
    )


def _with(evidence: Evidence, rows: np.ndarray) -> Evidence:
    """The evidence with more rows; parameters at a bound or with an open profile are judged again."""
    name = f"candidate {len(evidence.rows)}"
    return replace(
        evidence,
        rows={**evidence.rows, name: rows},
        noise_slopes={**evidence.noise_slopes, name: np.zeros((len(rows), 0))},
        open_profile=(),
        ends=None,
        at_bound=np.zeros_like(evidence.at_bound),
    )


def _rank(
    evidence: Evidence, candidates: Sequence[Candidate], rows: Sequence[Rows], criterion: str
) -> list[tuple[Ranked, Evidence]]:
    """Each candidate with the evidence that there would be after it, the best first."""
    before, ranked = _merit(evidence, criterion), []
    for candidate, (more, warnings) in zip(candidates, rows, strict=True):
        after = _with(evidence, more)
        ranked.append((Ranked(candidate, determine(after), _merit(after, criterion) - before, warnings), after))
    return sorted(ranked, key=lambda pair: -pair[0].gain)


def _merit(evidence: Evidence, criterion: str) -> float:
    """The criterion, as a number that is larger for better data."""
    jacobian = evidence.jacobian
    information = jacobian.T @ jacobian + np.eye(len(evidence.space.names)) / BEFOREHAND**2
    if criterion == "D":
        return float(np.linalg.slogdet(information)[1])
    i = evidence.space.names.index(criterion)
    return -0.5 * float(np.log(np.linalg.inv(information)[i, i]))


def _rows(
    candidate: Candidate,
    body: Manipulator,
    setting: BenchSetting,
    parameters: Parameters,
    size: np.ndarray,
    nodes: int,
) -> Rows:
    """The scaled Jacobian of the readings of a candidate, and warnings of rows without a solution, which count as 0."""
    name, read = f"candidate {candidate.name!r}", [*candidate.noise]
    table = unread_table(name, candidate.conditions, body.num_tendons, read)
    experiment = unread_rows(table, body, setting, [*parameters])
    shown = experiment.evaluate(body, parameters, nodes)
    count = len(shown.status)
    ended = [(int(np.sum(np.asarray(shown.status) == status)), status) for status in NOTEWORTHY]
    warnings = [f"{some} of {count} rows: {words_of(status)}" for some, status in ended if some]
    solved = ~np.isin(shown.status, OUTSIDE)[:, None]
    rows = [solved * shown.derivatives[name] * size / candidate.noise[name] for name in experiment.columns]
    return without_nan(np.concatenate(rows)), tuple(warnings)


def standard_candidates(
    manipulator: Manipulator, tension: float, setting: BenchSetting = PLAIN, displacement: float | None = None
) -> list[Candidate]:
    """The usual measurements on a bench, six levels each, with the noise of usual instruments.

    Args:
        manipulator: the body; with two tendons or more, one candidate also pulls the second tendon, and in another
            all are pulled in turn, with what they remember.
        tension: the largest base tension, N; of a bench driven by displacement the range of the load cell.
        setting: of the bench; with loads in all rows a single tendon has no release.
        displacement: of a bench driven by it, the largest one, m. Then tendon 1 is pulled and released, and the others
            hang slack.
    """
    levels = tension * np.arange(1, 7) / 6
    cell, angle, place = 0.01 * tension, np.radians(1.0), 1e-3
    axes = ("tip_x", "tip_y", "tip_z")[: manipulator.components]
    wraps = np.radians([45.0, 90.0, 135.0, 180.0, 225.0, 270.0])
    pulley = Candidate("pulley test", {"wrap_angle": wraps, "weight": 0.1 * tension}, {"pulling_tension": cell})
    if displacement is not None:
        middle = f"@{500 * float(np.asarray(manipulator.length)):.9g}mm"
        return [pulley, *_loops(displacement, cell, dict.fromkeys(axes, place), middle)]
    found = [
        pulley,
        Candidate("tip tensions", {"base_tension": levels}, {"tip_tension": cell}),
        Candidate("tip angles", {"base_tension": levels}, {"tip_angle": angle}),
        Candidate("tip tensions and angles", {"base_tension": levels}, {"tip_tension": cell, "tip_angle": angle}),
        Candidate("tip positions", {"base_tension": levels}, dict.fromkeys(axes, place)),
        Candidate(
            "tip tensions under a tip weight of 1 N",
            {"base_tension": levels, "tip_force_y": -1.0},
            {"tip_tension": cell},
        ),
    ]
    if manipulator.num_tendons == 1 and setting.loads is None:
        back = {"base_tension": [*levels, *levels[-2::-1]], "step": np.arange(11)}
        read = {"tip_tension": cell, "tip_angle": angle}
        found.append(Candidate("tip tensions and angles, pulled and come back down", back, read))
        found.append(Candidate("tip tensions, pulled and come back down", back, {"tip_tension": cell}))
    if manipulator.num_tendons > 1:
        pulled = {"base_tension": levels, "base_tension_2": 0.3 * levels}
        found.append(Candidate("tip tensions, second tendon pulled as well", pulled, {"tip_tension": cell}))
        found.append(_in_turn(manipulator.num_tendons, tension, dict.fromkeys(axes, place)))
    return found


def _loops(largest: float, cell: float, tip: Mapping[str, float], middle: str) -> list[Candidate]:
    """Loops of tendon 1 by displacement; `tip`: the noise of its place, m; `middle`: the end of columns of a marker."""
    there = largest * np.array([0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0]) / 6
    loop = {"displacement": there, "time": 10.0 * np.arange(there.size)}
    marker = {name.removeprefix("tip_") + middle: noise for name, noise in tip.items()}
    return [
        Candidate("loop", loop, tip),
        Candidate("loop of half the displacement", loop | {"displacement": there / 2}, tip),
        Candidate("loop, ten times as fast", loop | {"time": np.arange(there.size)}, tip),
        Candidate("loop with a load cell at the tip", loop, {**tip, "tip_tension": cell}),
        Candidate("loop with a marker in the middle", loop, {**tip, **marker}),
        Candidate("loop under a tip weight of 1 N", loop | {"tip_force_y": -1.0}, tip),
    ]


def _in_turn(num_tendons: int, tension: float, noise: Mapping[str, float]) -> Candidate:
    """Each tendon pulled fully, one after another, and again to one half; the others have a tenth."""
    pulled = np.full((2 * num_tendons, num_tendons), 0.1 * tension)
    for row, pull in enumerate([tension] * num_tendons + [0.5 * tension] * num_tendons):
        pulled[row, row % num_tendons] = pull
    columns = dict(zip(of_tendons("base_tension", num_tendons), pulled.T.tolist(), strict=True))
    return Candidate("tip positions, tendons pulled in turn", columns | {"step": np.arange(len(pulled))}, noise)
