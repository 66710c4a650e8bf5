"""The minimum of the squares of the residuals by Levenberg-Marquardt over dimensionless unknowns."""

import time
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..programs.kept import kept_program
from ..progress import SHOWN, stage
from .parameter_space import TINY, Numbers
from .residuals import Data, LeastSquaresProblem

TOLERANCE = 1e-9  # relative, of unknowns and cost; with a smaller one rounding errors of the cost decide on steps
BATCH_TOLERANCE = 1e-6  # of a lane of many: far below any standard error
MAX_STEPS = 500
BRIEF = 0.3  # s: after a portion of steps that took longer, the next one is shorter
LONG = 20.0  # s: a search that took longer says how to stop it
UNEXPLAINED = 0.9  # of the scatter of the data, left in the residuals: hardly anything is explained
GOOD, POOR = 0.99, 0.01  # actual over predicted reduction from which a step is good, and below which it is not taken
LONGER, SHORTER = 3.5, 0.25  # factors on the reach after a good step, and after the first in a row that was not taken


class Outcome(NamedTuple):
    """Where the optimiser stopped; for many searches at once all arrays have a leading axis."""

    z: np.ndarray
    parameters: np.ndarray
    size: np.ndarray  # of each parameter: its unit in the Jacobian
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    cost: np.ndarray  # the sum of squares, or of the loss
    num_steps: np.ndarray
    solved: np.ndarray


def hold_one(count: int, i: int, value: ArrayLike) -> np.ndarray:
    """The argument `held` for which parameter i has this value and the other parameters are free."""
    return np.where(np.arange(count) == i, value, np.nan)


class Minimum(NamedTuple):
    """A problem, and where the search for its minimum ended."""

    problem: LeastSquaresProblem
    outcome: Outcome

    def cost_with(self, noise: Sequence[Numbers]) -> float:
        """The cost with other noise; infinite if the model gives no number."""
        problem, residual = self.problem, self.outcome.residual.copy()
        pairs = zip(problem.data.noise, noise, strict=True)
        residual[: problem.num_data] *= np.concatenate([np.ravel(now / then) for now, then in pairs])
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(np.sum(problem.softened(residual) ** 2))
        return cost if np.isfinite(cost) else np.inf

    @property
    def misfit(self) -> tuple[float, str]:
        """The largest ratio of residuals to the scatter of the data, root mean squares, of a group; and its name."""
        data = zip(self.problem.data.values, self.problem.data.noise, strict=True)
        residuals = self.problem.by_group(self.outcome.residual)
        with np.errstate(over="ignore", invalid="ignore"):
            ratios = [
                float(np.linalg.norm(r * np.ravel(s)))
                / max(float(np.linalg.norm(v - np.mean(v)) or np.linalg.norm(v)), TINY)
                for (v, s), r in zip(data, residuals, strict=True)
            ]
        return max(zip(ratios, self.problem.groups, strict=True))

    @property
    def in_words(self) -> str:
        """The step, the misfit, and the parameters in SI units."""
        values = zip(self.problem.space.names, self.outcome.parameters, strict=True)
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in values)
        ratio, group = self.misfit
        return f"step {self.outcome.num_steps}, misfit {100 * ratio:.3g} % ({group}), {numbers}"

    def refit(self, held: np.ndarray, z: np.ndarray | None = None) -> tuple[Outcome, float]:
        """Hold some parameters (`held` is NaN for the others), and fit the others, from z or from here.

        Returns where the search ended, and the rise of the cost: NaN if the model gives no number.
        """
        moved = minimise(self.problem, self.outcome.z if z is None else z, held)
        return moved, float(moved.cost - self.outcome.cost)


@dataclass
class Watch:
    """The searches of one fit as they go on."""

    portion: int = 2  # steps between two looks
    ends: list[Minimum] = field(default_factory=list)  # of the searches that hold no parameter, so far
    begun: float = field(default_factory=time.monotonic)  # s, of the clock
    deadline: float = np.inf  # s, of the clock, when searches end wherever they are
    words: str = "step 1"  # where the last search was

    def saw(self, minimum: Minimum, seconds: float, *, first: bool, free: bool) -> None:
        """Where a search is after a portion that took some seconds; `first`: its first one."""
        self.portion = 2 * self.portion if seconds < BRIEF else max(self.portion // 2, 1)
        if free:
            self.ends[len(self.ends) - (not first) :] = [minimum]

    def best(self, noise: Sequence[Numbers]) -> Minimum | None:
        """The best place so far, with some noise."""
        return min(self.ends, key=lambda end: end.cost_with(noise), default=None)

    def in_words(self, minimum: Minimum) -> str:
        """Where a search is, and after a while how to end it."""
        if time.monotonic() - self.begun < LONG:
            return minimum.in_words
        hopeless = not minimum.misfit[0] < UNEXPLAINED
        warning = "; hardly anything is explained: check units, signs and frames" if hopeless else ""
        return f"{minimum.in_words}{warning}; Ctrl-C ends it with the best so far"


WATCHED: ContextVar[Watch | None] = ContextVar("WATCHED", default=None)


def minimise(problem: LeastSquaresProblem, z: np.ndarray, held: np.ndarray | None = None) -> Outcome:
    """Search for the minimum from the dimensionless unknowns z.

    `held` are values at which parameters are held, NaN for those that are free. The steps are done in portions, so that
    progress can be shown, and the search can be interrupted.
    """
    watch, state = WATCHED.get() or Watch(), _first(problem, z)
    at = np.full(len(z), np.nan) if held is None else held
    with stage(watch.words) as here:
        while True:
            first, begun = state.num_steps == 0, time.monotonic()
            last = min(int(state.num_steps) + watch.portion, problem.max_steps)
            state, found = _descend(problem, state, at, np.asarray(TOLERANCE), np.asarray(last))
            state, minimum = Search(*map(np.asarray, state)), Minimum(problem, _outcome(found))
            now = time.monotonic()
            watch.saw(minimum, now - begun, first=bool(first), free=held is None)
            if SHOWN.get():
                here.what = watch.words = watch.in_words(minimum) if held is None else minimum.in_words
            if state.solved or state.failed or last == problem.max_steps or now > watch.deadline:
                return minimum.outcome


def minimise_all(problem: LeastSquaresProblem, z: np.ndarray, data: Data) -> Outcome:
    """Many searches at once, from z, (searches, n).

    The data stand in place of the problem's. Arrays that have a leading axis hold those of each search.
    """

    def one_each(x: Numbers, own: Numbers) -> np.ndarray:
        return np.broadcast_to(x, (len(z), *np.shape(own)))

    return _outcome(_descend_all(problem, jax.tree.map(one_each, data, problem.data), z))


def evaluate(problem: LeastSquaresProblem, z: np.ndarray) -> Outcome:
    """Cost, residuals and derivatives at z, as if a search had ended there."""
    free = np.full(len(z), np.nan)
    _, there = _descend(problem, _first(problem, z), free, np.asarray(TOLERANCE), np.asarray(1))
    return _outcome(there)._replace(num_steps=np.asarray(0), solved=np.asarray(True))


def _outcome(found: tuple[ArrayLike, ...]) -> Outcome:
    """An outcome from the arrays of a program."""
    return Outcome(*map(np.asarray, found))


# --- the steps -----------------------------------------------------------------------------------


class Search(NamedTuple):
    """A search under way."""

    z: Float[Numbers, " n"]  # the best place so far
    residual: Float[Numbers, " m"]  # there, and its Jacobian by z
    slope: Float[Numbers, "m n"]
    trial: Float[Numbers, " n"]  # the next place
    reach: Float[Numbers, ""]  # 1 / damping
    shrink: Float[Numbers, ""]  # factor on the reach after the next step that is not taken
    num_steps: Int[Numbers, ""]
    solved: Bool[Numbers, ""]
    failed: Bool[Numbers, ""]  # there is no next place


def _first(problem: LeastSquaresProblem, z: Numbers) -> Search:
    """A search that has not begun."""
    rows = problem.num_data + len(problem.data.prior)
    none = np.zeros(rows), np.zeros((rows, len(z)))
    return Search(
        z, *none, z, np.asarray(1.0), np.asarray(SHORTER), np.asarray(0), np.asarray(False), np.asarray(False)
    )


@kept_program
@eqx.filter_jit
def _descend(
    problem: LeastSquaresProblem,
    state: Search,
    held: Float[Numbers, " n"],
    tolerance: Float[Numbers, ""],
    last: Int[Numbers, ""],
) -> tuple[Search, tuple[ArrayLike, ...]]:
    """Go on with a search up to its step number `last`."""

    def goes_on(state: Search) -> Bool[Numbers, ""]:
        return (state.num_steps < last) & ~state.solved & ~state.failed

    state = jax.lax.while_loop(goes_on, partial(_step, problem, held, tolerance), jax.tree.map(jnp.asarray, state))
    parameters, stretch = jax.jvp(lambda z: problem.parameters(z, held), (state.z,), (jnp.ones_like(state.z),))
    size = problem.space.size(parameters)
    jacobian = state.slope / jnp.where(stretch == 0, 1.0, stretch) * size
    cost = jnp.sum(problem.softened(state.residual) ** 2)
    return state, (state.z, parameters, size, state.residual, jacobian, cost, state.num_steps, state.solved)


def _step(
    problem: LeastSquaresProblem, held: Float[Numbers, " n"], tolerance: Float[Numbers, ""], state: Search
) -> Search:
    """Evaluate the next place, take it or not, and find the one after it.

    A trust region in the form of Conn, Gould and Toint (2000), Trust Region Methods. A step whose predicted and actual
    reductions are rounding errors of the cost is taken, so that searches end (section 17.4.2); the next one is shorter:
    else rounding errors would lead the search along a flat valley without end. After one step in a row that was not
    taken the next ones shrink faster (Nielsen 1999, Damping parameter in Marquardt's method): near a kink of the model
    only tiny steps help.
    """
    begins, moved = state.num_steps == 0, state.trial - state.z
    residual, slope = _residual_and_slope(problem, held, state.trial)
    (old, old_slope), (new, new_slope) = (_softened(problem, *of) for of in (state[1:3], (residual, slope)))
    cost = jnp.sum(old**2)
    predicted, actual = jnp.sum((old + old_slope @ moved) ** 2) - cost, jnp.sum(new**2) - cost
    rounding = jnp.maximum(jnp.abs(predicted), jnp.abs(actual)) < 10 * jnp.finfo(cost.dtype).eps * cost
    good = (actual < GOOD * predicted) & (predicted < 0) & ~begins
    taken = (actual <= POOR * predicted) | begins
    useful = taken & ~rounding
    reach = state.reach * jnp.where(useful, jnp.where(good, LONGER, 1.0), state.shrink)
    shrink = jnp.where(useful, SHORTER, state.shrink / 2)
    taken = taken | rounding

    def is_near(change: Numbers, value: Numbers) -> Array:
        return jnp.all(jnp.abs(change) < tolerance * (1 + jnp.abs(value)))

    solved = is_near(moved, state.trial) & jnp.where(taken, is_near(new - old, new), True)
    z, kept, kept_slope = (
        jnp.where(taken, *pair) for pair in ((state.trial, state.z), (residual, state.residual), (slope, state.slope))
    )
    step = _damped_step(jnp.where(taken, new, old), jnp.where(taken, new_slope, old_slope), reach)
    return Search(
        z, kept, kept_slope, z + step, reach, shrink, state.num_steps + 1, solved, ~jnp.all(jnp.isfinite(step))
    )


def _damped_step(residual: Float[Numbers, " m"], slope: Float[Numbers, "m n"], reach: Float[Numbers, ""]) -> Array:
    """The step that minimises |residual + slope step|^2 + |step|^2 / reach."""
    known = reach > jnp.finfo(reach.dtype).eps
    damping = jnp.where(known, 1 / jnp.where(known, reach, 1.0), jnp.finfo(reach.dtype).max)
    count = slope.shape[1]
    q, r = jnp.linalg.qr(jnp.concatenate([slope, jnp.sqrt(damping) * jnp.eye(count)]))
    return -jax.scipy.linalg.solve_triangular(r, q.T @ jnp.concatenate([residual, jnp.zeros(count)]))


def _softened(
    problem: LeastSquaresProblem, residual: Float[Numbers, " m"], slope: Float[Numbers, "m n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """The residual as the loss transforms it, and its Jacobian."""

    def push(tangent):
        return jax.jvp(problem.softened, (residual,), (tangent,))

    return jax.vmap(push, in_axes=1, out_axes=(None, 1))(slope)


def _residual_and_slope(
    problem: LeastSquaresProblem, held: Float[Numbers, " n"], z: Float[Numbers, " n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@kept_program
@eqx.filter_jit
def _descend_all(problem: LeastSquaresProblem, data: Data, z: Float[Numbers, "searches n"]) -> tuple[ArrayLike, ...]:
    free = jnp.full(z.shape[1], jnp.nan)

    def one(data, z):
        own = replace(problem, data=data)
        return _descend(own, _first(own, z), free, np.asarray(BATCH_TOLERANCE), np.asarray(problem.max_steps))[1]

    return jax.vmap(one)(data, z)
