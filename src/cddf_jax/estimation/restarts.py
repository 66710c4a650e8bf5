"""Fits from several starts: where further ones lie, when one is not enough, and which search is taken."""

import time

import numpy as np

from ..progress import each, stage
from .determination import NOT_IDENTIFIED
from .levenberg_marquardt import WATCHED, Outcome, Watch, minimise
from .residuals import LeastSquaresProblem
from .whole_search import STOPPED_SHORT, Ending, FitTask, interrupted_at, search_from

ROUNDS = (8, 8, 16)  # further searches; after each round the best one is judged
DECADES = (1.0, 2.0, 3.0)  # powers of ten, up and down, over which the starts of each round spread
FAR = 1e3  # an unidentified parameter beyond this times its start went far away
SAME = 1e-6  # relative difference of costs below which two searches have the same result
LOWER = 1e-3  # relative difference of costs from which one search is better
ONE_DATUM = 0.99  # share of one datum in the squared derivatives, above which it counts as the only one
EXACT = 1e-9  # a cost that is as good as 0: a residual of nothing but rounding
LONGEST = 30.0  # s: searches from other starts that nobody asked for end then


@stage("searching")
def search(task: FitTask, starts: int | None, seed: int) -> Ending:
    """The best of some searches, the first from the given start; after Ctrl-C the best place so far.

    With `starts` None there is one search; if it is in trouble, rounds of others follow until the best is in none, or
    they take too long.
    """
    watch = Watch()
    before = WATCHED.set(watch)
    try:
        return _from_starts(task, starts, seed) if starts else _until_without_trouble(task, seed, watch)
    except KeyboardInterrupt:
        best = watch.best(task.problem.data.noise)
        if best is None:
            raise
        return interrupted_at(task, best)
    finally:
        WATCHED.reset(before)


def _from_starts(task: FitTask, starts: int, seed: int) -> Ending:
    """The best of as many searches as were asked for."""
    problem = task.problem
    found = [minimise(problem, problem.space.first()), *_elsewhere(problem, slice(0, starts - 1), seed)]
    ending = search_from(task, min(found, key=_height).z)
    known = ending.determination.combinations or set(ending.determination.status.values()) != {NOT_IDENTIFIED}
    if not known and np.any(problem.space.times_the_start(ending.minimum.outcome.parameters) > FAR):
        ending = ending._replace(result=STOPPED_SHORT)  # it went far away: the cost falls without a minimum
    return ending._replace(starts=np.sort([*map(_height, found)]))


def _until_without_trouble(task: FitTask, seed: int, watch: Watch) -> Ending:
    """One search, and others while the best one is in trouble."""
    ending = first = search_from(task, task.problem.space.first())
    reason = trouble(task, first)
    if not reason:
        return first
    costs, late = [_cost(task, first)], time.monotonic() + LONGEST
    for last, count in zip(np.cumsum(ROUNDS), ROUNDS, strict=True):
        watch.deadline = late
        found = _elsewhere(task.problem, slice(last - count, last), seed, late)
        watch.deadline = np.inf
        costs += map(_height, found)
        ending = _better(task, ending, found)
        alike = np.allclose([*map(_height, found)], _cost(task, ending), rtol=SAME, atol=EXACT)
        if alike and ending is first and first.success:  # the data determine no more anywhere
            return first
        if time.monotonic() > late:
            reason += f" (other searches ended after {LONGEST:.0f} s; give starts to allow more)"
            break
        if not trouble(task, ending):
            break
    same = np.sum(np.array(costs) <= (1 + LOWER) * min(costs) + EXACT)
    led = f"{same} of {len(costs)} starts led to the result, the best found"
    if ending is first:
        led = f"nothing better was found from {len(costs) - 1} other start(s)"
    return ending._replace(starts=np.sort(costs), restarted=f"the search from the given start {reason}; {led}")


def _better(task: FitTask, ending: Ending, found: list[Outcome]) -> Ending:
    """The best of the searches if its cost is lower, or as low and without trouble; else the given ending."""
    best, cost = min(found, key=_height), _cost(task, ending)
    if not _height(best) < cost * (1 + SAME) + EXACT:
        return ending
    other = search_from(task, best.z)
    return other if _height(best) < (1 - LOWER) * cost - EXACT or not trouble(task, other) else ending


def trouble(task: FitTask, ending: Ending) -> str:
    """Why searches from other starts are useful; "" if they are not.

    The search failed. Or the data do not determine some parameters where it ended, and one of these went far away from
    its start, or only one datum depends on them, or the derivatives are singular and the data determine no combination
    of them.
    """
    if not ending.success:
        return f"failed ({ending.result.partition(';')[0]})"
    determination, evidence = ending.determination, ending.evidence
    lost = np.array([word == NOT_IDENTIFIED for word in determination.status.values()])
    lost[list(evidence.bounded_above)] = False
    gone = lost & (task.problem.space.times_the_start(ending.minimum.outcome.parameters) > FAR)
    slope = np.sum(evidence.jacobian[:, lost] ** 2, axis=1)
    many = np.max(slope) < ONE_DATUM * np.sum(slope)
    if determination.rank < len(lost) and not (determination.combinations and many):
        gone = lost
    names = [name for name, far in zip(determination.names, gone, strict=True) if far]
    return f"ended where the data do not determine {', '.join(names)}" if names else ""


# --- searches -------------------------------------------------------------------------------------


def _elsewhere(problem: LeastSquaresProblem, which: slice, seed: int, late: float = np.inf) -> list[Outcome]:
    """Searches from some of the further starts, which a scrambled Sobol sequence spreads; they share one program.

    When the clock shows `late` there are no more, but there is one at least.
    """
    space = problem.space
    count = max(which.stop, sum(ROUNDS))
    from scipy.stats import qmc

    draws = qmc.Sobol(len(space.names), rng=np.random.default_rng(seed)).random(2 ** int(np.ceil(np.log2(count))))
    decades = np.repeat(DECADES, [*ROUNDS[:-1], count])
    found = []
    for draw, reach in each("start", list(zip(draws[which], decades[which], strict=True))):
        found.append(minimise(problem, space.elsewhere(np.clip(draw, 1e-6, 1 - 1e-6), reach)))
        if time.monotonic() > late:
            break
    return found


def _height(end: Outcome) -> float:
    """The cost, with the first guess of the noise; infinite if the model gives no number."""
    return float(end.cost) if np.isfinite(end.cost) else np.inf


def _cost(task: FitTask, ending: Ending) -> float:
    """The cost of an ending, with the first guess of the noise."""
    return ending.minimum.cost_with(task.problem.data.noise)
