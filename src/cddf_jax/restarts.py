"""Fits from several starts: where further ones lie, when one is not enough, and which search is taken."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .determination import NOT_IDENTIFIED
from .levenberg_marquardt import minimise
from .remarks import UNEXPLAINED
from .whole_search import BETTER_ELSEWHERE, NO_NUMBER, NOT_SETTLED, STOPPED_SHORT, Ending, FitProblem, search_from

ROUNDS = (8, 8, 16)  # further searches; after each round the best is looked at
DECADES = (1.0, 2.0, 3.0)  # how many powers of ten up and down the starts of a round spread; beyond them as the last
FAR = 1e3  # times its start: a parameter that is not identified there has run off
SAME = 1e-6  # relative difference of costs below which two searches came to the same
LOWER = 1e-3  # relative difference of costs that makes one the better
ONE_DATUM = 0.99  # share of what the data feel of some parameters, which is as good as all
EXACT = 1e-9  # a cost that is as good as 0: a residual of nothing but rounding
FAILURES = {
    NO_NUMBER: "ended where the model gives no number",
    STOPPED_SHORT: "stopped short of a minimum",
    BETTER_ELSEWHERE: "ended beside a better minimum",
    NOT_SETTLED: "did not settle",
}


class Searched(NamedTuple):
    """The search that is taken, and what the others came to."""

    ending: Ending
    cost: np.ndarray  # that the search from each start came down to, the best first; empty where one was enough
    remark: str = ""  # why there were several starts though none were asked for, and what came of them


class _Descent(NamedTuple):
    """Where a search ended with the noise that was first guessed."""

    z: np.ndarray
    cost: float


def search_many(fit: FitProblem, starts: int, seed: int) -> Searched:
    """The best of so many searches, the first from the given start."""
    first = fit.problem.space.first()
    if starts == 1:
        ending = search_from(fit, first)
        return Searched(ending, np.array([_cost(fit, ending)]))
    found = [_descend(fit, first), *_elsewhere(fit, slice(0, starts - 1), seed)]
    return Searched(search_from(fit, min(found, key=lambda search: search.cost).z), np.sort(_costs(found)))


def search_as_needed(fit: FitProblem, seed: int) -> Searched:
    """One search from the given start; where that is in trouble, rounds of others until the best is in none."""
    ending = first = search_from(fit, fit.problem.space.first())
    reason = trouble(fit, first)
    if not reason:
        return Searched(first, np.empty(0))
    cost = [np.array([_cost(fit, first)])]
    known = [] if first.lower is None else [_descend(fit, first.lower)]
    for last, count in zip(np.cumsum(ROUNDS), ROUNDS, strict=True):
        found = [*known, *_elsewhere(fit, slice(last - count, last), seed)]
        ending, known = _better(fit, ending, found), []
        cost.append(_costs(found))
        if _is_enough(fit, ending, found):
            if ending is first and ending.success:  # all came to the same: the data hold no more anywhere
                return Searched(first, np.empty(0))
            break
    costs = np.sort(np.concatenate(cost))
    return Searched(ending, costs, _in_words(reason, costs, ending is not first))


def _better(fit: FitProblem, ending: Ending, found: list[_Descent]) -> Ending:
    """The best of what was found if it is lower, or as low and in no trouble; else what we have."""
    best, cost = min(found, key=lambda search: search.cost), _cost(fit, ending)
    if not best.cost < cost * (1 + SAME) + EXACT:
        return ending
    other = search_from(fit, best.z)
    return other if best.cost < (1 - LOWER) * cost - EXACT or not trouble(fit, other) else ending


def _is_enough(fit: FitProblem, ending: Ending, found: list[_Descent]) -> bool:
    """Whether the data hold all parameters, or all searches of a round came to the same that is no plateau."""
    if NOT_IDENTIFIED not in ending.told.status.values() and not trouble(fit, ending):
        return True
    cost = _cost(fit, ending)
    alike = np.isfinite(cost) and np.allclose(_costs(found), cost, rtol=SAME, atol=EXACT)
    plateau = ending.told.rank < len(fit.names) and _is_flat(fit, ending)
    return bool(alike and not plateau)


def _in_words(reason: str, cost: np.ndarray, improved: bool) -> str:
    if not improved:
        return f"the search {reason}; {len(cost) - 1} searches from other starts found nothing better"
    same = int(np.sum(cost <= (1 + LOWER) * cost[0] + EXACT))
    return f"the search from the given start {reason}; {same} of {len(cost)} starts led to the result, the best found"


def trouble(fit: FitProblem, ending: Ending) -> str:
    """What makes other starts worth while; "" for nothing.

    The search failed: it reached no minimum, or one that hardly explains the data, about as well as the best constant
    (`unexplained_groups`). Or it ended nowhere: the data do not hold some parameters there, and one of these has run
    off from its start, or a single datum feels them, or the derivatives are singular though the data tell no
    combination of them.
    """
    if ending.result in FAILURES:
        return FAILURES[ending.result]
    if not ending.success:
        return "hardly explained the data"
    told, evidence = ending.told, ending.evidence
    lost = np.array([word == NOT_IDENTIFIED for word in told.status.values()])
    lost[list(evidence.bounded_above)] = False
    gone = lost & (fit.problem.space.times_the_start(ending.outcome.parameters) > FAR)
    felt = np.sum(evidence.jacobian[:, lost] ** 2, axis=1)
    if told.rank < len(lost) and not (told.combinations and np.max(felt) < ONE_DATUM * np.sum(felt)):
        gone = lost
    names = [name for name, far in zip(told.names, gone, strict=True) if far]
    return f"ended where the data do not hold {', '.join(names)}" if names else ""


def _is_flat(fit: FitProblem, ending: Ending) -> bool:
    """Whether what is left of some group scatters like the group itself."""
    groups = np.split(ending.outcome.residual, np.cumsum([v.size for v in fit.data.values]))[:-1]
    left = [np.std(r * np.ravel(s)) for r, s in zip(groups, ending.noise, strict=True)]
    return any(a > UNEXPLAINED * np.std(v) > 0 for a, v in zip(left, fit.data.values, strict=True))


# --- searches -------------------------------------------------------------------------------------


def _elsewhere(fit: FitProblem, which: slice, seed: int) -> list[_Descent]:
    """Searches from some of the further starts, which a scrambled Sobol sequence spreads; nothing is compiled anew."""
    problem, space = fit.problem, fit.problem.space
    count = max(which.stop, sum(ROUNDS))
    draws = qmc.Sobol(space.num_parameters, rng=np.random.default_rng(seed)).random(2 ** int(np.ceil(np.log2(count))))
    decades = np.repeat(DECADES, [*ROUNDS[:-1], count])
    found = []
    for draw, reach in zip(draws[which], decades[which], strict=True):
        moved, z = space.elsewhere(np.clip(draw, 1e-6, 1 - 1e-6), reach)
        end = minimise(
            eqx.tree_at(lambda p: p.space, problem, moved), fit.data.first_guess(), z, max_steps=fit.max_steps
        )
        found.append(_Descent(space.seen_from(moved, end.z), _finite(end.cost)))
    return found


def _descend(fit: FitProblem, z: np.ndarray) -> _Descent:
    end = minimise(fit.problem, fit.data.first_guess(), z, max_steps=fit.max_steps)
    return _Descent(end.z, _finite(end.cost))


def _cost(fit: FitProblem, ending: Ending) -> float:
    """With the noise that was first guessed."""
    ratio = [np.ravel(now / then) for now, then in zip(ending.noise, fit.data.first_guess(), strict=True)]
    residual = ending.outcome.residual.copy()
    residual[: fit.problem.num_data] *= np.concatenate(ratio)
    return _finite(np.sum(np.asarray(fit.problem.softened(jnp.asarray(residual))) ** 2))


def _costs(found: list[_Descent]) -> np.ndarray:
    return np.array([search.cost for search in found])


def _finite(cost: float) -> float:
    return float(cost) if np.isfinite(cost) else np.inf
