"""The minimum of the squares of the residuals by Levenberg-Marquardt over dimensionless unknowns."""

import time
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..progress import SHOWN, stage
from .parameter_space import TINY, Numbers
from .residuals import LeastSquaresProblem

TOLERANCE = 1e-9  # relative, of unknowns and cost; with a smaller one rounding errors of the cost decide on steps
MAX_STEPS = 500
STALLED = 6  # looks at a search that bring no noteworthy fall of the cost, where the model has kinks: it ends
LEAST_RANK = 1e-6  # of the largest singular value: what is determined less does not move to first order
CLEARLY = 10.0  # factor between a cost above a limit and what a step promises, where no step brings it below
SHORTER = 0.25  # factor on the reach after the first step in a row that was not taken
GOOD = 0.75  # of the promised fall of the cost: after a step that brings more, the next may be longer


class Outcome(NamedTuple):
    """Where the optimiser stopped."""

    z: np.ndarray
    parameters: np.ndarray
    size: np.ndarray  # of each parameter: its unit in the Jacobian
    residual: np.ndarray
    jacobian: np.ndarray  # of the residual by the parameters over their size
    cost: np.ndarray  # the sum of squares
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
        problem, residual = self.problem, self.problem.unwhitened(self.outcome.residual)
        pairs = zip(problem.data.noise, noise, strict=True)
        residual[: problem.num_data] *= np.concatenate([np.ravel(now / then) for now, then in pairs])
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(np.sum(residual**2))
        return cost if np.isfinite(cost) else np.inf

    def is_enough(self, closing: float) -> bool:
        """Whether a search may end here.

        It may where a whole step of Gauss-Newton promises a fall of the cost that does not matter, or leaves the cost
        clearly above `closing`.
        """
        problem, outcome = self.problem, self.outcome
        asked = problem.noteworthy > 0 or np.isfinite(closing)
        if not asked or not np.isfinite(outcome.cost) or not np.all(np.isfinite(outcome.jacobian)):
            return False
        basis, _ = np.linalg.qr(outcome.jacobian[:, np.any(outcome.jacobian, axis=0)])  # those that are held are 0
        promised = np.sum((basis.T @ outcome.residual) ** 2)
        return bool(promised < problem.noteworthy * outcome.cost or CLEARLY * promised < outcome.cost - closing)

    def is_near(self, other: "Minimum", errors: float | None = None) -> bool:
        """Whether the estimates of another end differ by less than some standard errors; `accuracy` unless stated."""
        moved = (other.outcome.parameters - self.outcome.parameters) / self.outcome.size
        change, errors = self.outcome.jacobian @ moved, self.problem.accuracy if errors is None else errors
        return bool(np.sum(change**2) < errors**2 / self.problem.num_data * self.outcome.cost)

    @property
    def misfit(self) -> tuple[float, str]:
        """The largest ratio of residuals to the scatter of the data, root mean squares, of a group; and its name."""
        data = zip(self.problem.data.values, self.problem.data.noise, strict=True)
        residuals = self.problem.by_group(self.problem.unwhitened(self.outcome.residual))
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

    def beside(self, i: int, place: float) -> np.ndarray:
        """The z where parameter i has another value, and to first order the others are fitted again.

        They do not move along directions that the data hardly determine.
        """
        space, z, jacobian = self.problem.space, self.outcome.z, self.outcome.jacobian
        _, stretch = jax.jvp(space.parameters, (z,), (np.ones_like(z),))
        slope = jacobian * np.asarray(stretch) / self.outcome.size
        others = np.arange(len(z)) != i
        change = np.zeros(len(z))
        change[i] = space.inverse(i, place) - z[i]
        rows = slope * change[i]
        if np.all(np.isfinite(rows)) and change[i] != 0:
            change[others] = -np.linalg.lstsq(slope[:, others], rows[:, i], rcond=LEAST_RANK)[0]
        return z + change

    def refit(
        self, held: np.ndarray, z: np.ndarray | None = None, closing_rise: float = np.inf
    ) -> tuple[Outcome, float]:
        """Hold some parameters (`held` is NaN for the others), and fit the others, from z or from here.

        Returns where the search ended, and the rise of the cost: NaN if the model gives no number. The search ends
        early where the rise is clearly above `closing_rise`.
        """
        first = self.outcome.z if z is None else z
        moved = minimise(self.problem, first, held, float(self.outcome.cost) + closing_rise)
        return moved, float(moved.cost - self.outcome.cost)


@dataclass
class Watch:
    """The searches of one fit as they go on."""

    ends: list[Minimum] = field(default_factory=list)  # of the searches that hold no parameter, so far
    deadline: float = np.inf  # s, of the clock, when searches end wherever they are

    def saw(self, minimum: Minimum, *, first: bool, free: bool) -> None:
        """Where a search is after a step; `first`: its first one."""
        if free:
            self.ends[len(self.ends) - (not first) :] = [minimum]

    def best(self, noise: Sequence[Numbers]) -> Minimum | None:
        """The best place so far, with some noise."""
        return min(self.ends, key=lambda end: end.cost_with(noise), default=None)


WATCHED: ContextVar[Watch | None] = ContextVar("WATCHED", default=None)


def minimise(
    problem: LeastSquaresProblem, z: np.ndarray, held: np.ndarray | None = None, closing: float = np.inf
) -> Outcome:
    """Search for the minimum from the dimensionless unknowns z.

    `held` are values at which parameters are held, NaN for those that are free. It is looked at after each step,
    so that progress can be shown, and it can be interrupted. It ends early where the cost is clearly above `closing`.
    """
    watch, reach, steps = WATCHED.get() or Watch(), np.array([1.0, SHORTER]), 0
    costs: list[float] = []
    rows = problem.num_data + len(problem.data.prior)
    known = _Known(np.zeros(rows), np.zeros((rows, len(z))), np.asarray(False))
    at = np.full(len(z), np.nan) if held is None else held
    with stage("step 1") as here:
        while True:
            step = bool(costs) or np.isinf(closing)  # or else a look at the first place, which may do
            *found, known, reach, ended = _descend(problem, z, at, known, reach, np.asarray(int(step)), TOLERANCE)
            outcome = Outcome(*map(np.asarray, found))
            first, steps, z = steps == 0, steps + int(outcome.num_steps), outcome.z
            minimum = Minimum(problem, outcome._replace(num_steps=np.asarray(steps)))
            watch.saw(minimum, first=first, free=held is None)
            costs.append(float(outcome.cost))
            if minimum.is_enough(closing) or _has_stalled(costs, problem.noteworthy):
                return minimum.outcome._replace(solved=np.asarray(True))
            if ended or steps >= problem.max_steps or time.monotonic() > watch.deadline:
                return minimum.outcome
            if SHOWN.get():
                how_to_end = "; Ctrl-C ends it with the best so far" if held is None else ""  # a profile has none
                here.what = minimum.in_words + how_to_end


def _has_stalled(costs: Sequence[float], noteworthy: float) -> bool:
    """Whether the last looks at a search brought no noteworthy fall of the cost; never for a model without kinks."""
    return noteworthy > 0 and len(costs) > STALLED and costs[-STALLED - 1] - costs[-1] < noteworthy * costs[-1]


def evaluate(problem: LeastSquaresProblem, z: np.ndarray) -> Outcome:
    """Cost, residuals and derivatives at z, as if a search had ended there."""
    free = np.full(len(z), np.nan)
    found = *_at(problem, z, free, _residual_and_slope(problem, free, z)), 0, True
    return Outcome(*map(np.asarray, found))


# --- the steps, by optimistix --------------------------------------------------------------------


class _Reach(NamedTuple):
    """How far the steps of a search may go."""

    size: Float[Array, ""]  # 1 / damping
    shrink: Float[Array, ""]  # factor on it after the next step that is not taken
    num_steps: Int[Array, ""]


class _TrustRegion(optx.AbstractSearch):
    """The trust region of optimistix, whose searches can be continued, and end where only rounding errors are left.

    A step whose predicted and actual reductions are rounding errors of the cost is taken, so that searches end (Conn,
    Gould and Toint 2000, Trust Region Methods, section 17.4.2); so is one that is too short to matter. The next one is
    shorter: else rounding errors would lead the search along a flat valley without end. After one step in a row that
    was not taken the next ones shrink faster (Nielsen 1999, Damping parameter in Marquardt's method): near a kink of
    the model only tiny steps help. The next one is longer already where a step brings three quarters of what it
    promised (More 1978, The Levenberg-Marquardt algorithm). With the 0.99 of optimistix, a parameter that runs to its
    bound would come closer by 4 % in each step, as its logarithm is searched.
    """

    reach: Float[Numbers, " 2"]  # of the first step, and the factor on it if that is not taken
    steps: Int[Numbers, ""]  # after which the search pauses
    tolerance: float

    def init(self, y, f_info_struct):
        size, shrink = jnp.asarray(self.reach)
        return _Reach(size, shrink, jnp.asarray(-1))  # what comes first is no step, but a look at the place

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        classical = optx.ClassicalTrustRegion(high_cutoff=GOOD)
        unit = classical.init(y, f_info)
        factor, accept, result, _ = classical.step(first_step, y, y_eval, f_info, f_eval_info, unit)
        cost, moved = f_info.as_min(), y_eval - y
        changes = classical.predict_reduction(moved, f_info), f_eval_info.as_min() - cost
        rounding = jnp.maximum(*map(jnp.abs, changes)) < 10 * jnp.finfo(cost.dtype).eps * cost
        short = jnp.all(jnp.abs(moved) < self.tolerance * (1 + jnp.abs(y_eval)))
        useful = accept & ~rounding
        size = state.size * jnp.where(useful, factor, state.shrink)
        shrink = jnp.where(useful, jnp.where(first_step, state.shrink, SHORTER), state.shrink / 2)
        new = _Reach(size, shrink, state.num_steps + 1)
        paused = optx.RESULTS.where(new.num_steps < self.steps, result, optx.RESULTS.nonlinear_max_steps_reached)
        return size, accept | rounding | short, paused, new


class _Known(NamedTuple):
    """What is known of the place from which a step begins."""

    residual: Float[Numbers, " m"]
    slope: Float[Numbers, "m n"]
    known: Bool[Numbers, ""]


@eqx.filter_jit
def _at(
    problem: LeastSquaresProblem,
    z: Float[Numbers, " n"],
    held: Float[Numbers, " n"],
    found: tuple[Float[Numbers, " m"], Float[Numbers, "m n"]],
) -> tuple[Float[Numbers, "..."], ...]:
    """The first entries of an outcome at a place, from z to the cost, with the residual and its Jacobian there."""
    residual, by_z = found
    parameters, stretch = jax.jvp(lambda z: problem.parameters(z, held), (z,), (jnp.ones_like(z),))
    size = problem.space.size(parameters)
    slope = by_z / jnp.where(stretch == 0, 1.0, stretch)
    return z, parameters, size, residual, slope * size, jnp.sum(residual**2)


@eqx.filter_jit
def _residual_and_slope(
    problem: LeastSquaresProblem, held: Float[Numbers, " n"], z: Float[Numbers, " n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@eqx.filter_jit
def _descend(
    problem: LeastSquaresProblem,
    z: Float[Numbers, " n"],
    held: Float[Numbers, " n"],
    known: _Known,
    reach: Float[Numbers, " 2"],
    steps: Int[Numbers, ""],
    tolerance: float,
) -> tuple[Any, ...]:
    """So many steps from z: the entries of an outcome, what is known of its place, the reach, whether it ended.

    With an explicit Jacobian, the optimiser need not differentiate the model for every product with it. The model is
    evaluated in one place, so that it is traced once, and not again where the step before has ended.
    """
    first = jnp.asarray(z)

    # JAX takes it as a whole: what is linear in a step is the product with the Jacobian, not what lies within the model
    @jax.custom_jvp
    def looked(z):
        there = known.known & jnp.all(z == first)
        return jax.lax.cond(there, lambda: known[:2], lambda: _residual_and_slope(problem, held, z))

    @looked.defjvp
    def _(primals, tangents):
        value, slope = looked(*primals)
        return (value, slope), (slope @ tangents[0], jnp.zeros_like(slope))

    def residual(z, _):
        value, slope = looked(z)
        return value, (value, slope)

    region = _TrustRegion(reach=reach, steps=steps, tolerance=tolerance)
    optimiser = eqx.tree_at(lambda o: o.search, optx.LevenbergMarquardt(tolerance, tolerance), region)
    # The optimiser calls it within and without `vmap`. For JAX these are different contexts, and it would trace twice.
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ())):
        solution = optx.least_squares(
            residual,
            optimiser,
            first,
            has_aux=True,
            options={"jac": "fwd"},
            max_steps=problem.max_steps + 1,  # and the look at the first place
            throw=False,
        )
    found = solution.state.aux  # of the place: `solution.aux` is that of the last step that was tried
    paused, search = solution.result == optx.RESULTS.nonlinear_max_steps_reached, solution.state.search_state
    solved = (solution.result == optx.RESULTS.successful) | (paused & solution.state.terminate)  # with its last step
    reach = jnp.stack([search.size, search.shrink])
    outcome = *_at(problem, solution.value, held, found), search.num_steps, solved
    return *outcome, _Known(found[0], found[1], jnp.asarray(True)), reach, solved | ~paused
