"""The minimum of the squares of the residuals by Levenberg-Marquardt over dimensionless unknowns."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float

from ..programs.kept import kept_program
from .parameter_space import Numbers
from .residuals import Data, LeastSquaresProblem

TOLERANCE = 1e-9  # relative, of unknowns and cost; with a smaller one rounding errors of the cost decide on steps
BATCH_TOLERANCE = 1e-6  # of a lane of many: far below any standard error
MAX_STEPS = 500


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

    def refit(self, held: np.ndarray, z: np.ndarray | None = None) -> tuple[Outcome, float]:
        """Hold some parameters (`held` is NaN for the others), and fit the others, from z or from here.

        Returns where the search ended, and the rise of the cost: NaN if the model gives no number.
        """
        moved = minimise(self.problem, self.outcome.z if z is None else z, held)
        return moved, float(moved.cost - self.outcome.cost)


class _Acceptance(optx.ClassicalTrustRegion):
    """Also accepts a step whose predicted and actual reductions are rounding errors of the cost, so that searches end.

    The remedy of Conn, Gould and Toint (2000), Trust Region Methods, section 17.4.2. The next step is made shorter:
    else rounding errors would lead the search along a flat valley without end.
    """

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        _, accept, result, new = super().step(first_step, y, y_eval, f_info, f_eval_info, state)
        cost = f_info.as_min()
        least = 10 * jnp.finfo(cost.dtype).eps * cost
        changes = self.predict_reduction(y_eval - y, f_info), f_eval_info.as_min() - cost
        noise = jnp.maximum(*map(jnp.abs, changes)) < least
        size = jnp.where(noise, self.low_constant * state.step_size, new.step_size)
        return size, accept | noise, result, eqx.tree_at(lambda state: state.step_size, new, size)


def minimise(problem: LeastSquaresProblem, z: np.ndarray, held: np.ndarray | None = None) -> Outcome:
    """Search for the minimum from the dimensionless unknowns z.

    `held` are values at which parameters are held, NaN for those that are free.
    """
    held = np.full(len(z), np.nan) if held is None else held
    return _outcome(_descend(problem, z, held, TOLERANCE))


def minimise_all(problem: LeastSquaresProblem, z: np.ndarray, data: Data) -> Outcome:
    """Many searches at once, from z, (searches, n).

    The data stand in place of the problem's. Arrays that have a leading axis hold those of each search.
    """

    def one_each(x: Numbers, own: Numbers) -> np.ndarray:
        return np.broadcast_to(x, (len(z), *np.shape(own)))

    return _outcome(_descend_all(problem, jax.tree.map(one_each, data, problem.data), z))


def evaluate(problem: LeastSquaresProblem, z: np.ndarray) -> Outcome:
    """Cost, residuals and derivatives at z, as if a search had ended there."""
    return _outcome((*_at(problem, z, np.full(len(z), np.nan)), 0, True))


def _outcome(found: tuple[ArrayLike, ...]) -> Outcome:
    """An outcome from the arrays of a program."""
    return Outcome(*map(np.asarray, found))


@kept_program
@eqx.filter_jit
def _at(
    problem: LeastSquaresProblem, z: Float[Numbers, " n"], held: Float[Numbers, " n"]
) -> tuple[Float[Numbers, "..."], ...]:
    """The first entries of an outcome at a place, from z to the cost."""
    residual, by_z = _residual_and_slope(problem, held, z)
    parameters, stretch = jax.jvp(lambda z: problem.parameters(z, held), (z,), (jnp.ones_like(z),))
    size = problem.space.size(parameters)
    slope = by_z / jnp.where(stretch == 0, 1.0, stretch)
    return z, parameters, size, residual, slope * size, jnp.sum(problem.softened(residual) ** 2)


@eqx.filter_jit
def _residual_and_slope(
    problem: LeastSquaresProblem, held: Float[Numbers, " n"], z: Float[Numbers, " n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """The residual and its Jacobian by z, forward mode."""

    def push(tangent):
        return jax.jvp(lambda z: problem.residual(z, held), (z,), (tangent,))

    return jax.vmap(push, out_axes=(None, 1))(jnp.eye(z.shape[0]))


@kept_program
@eqx.filter_jit
def _descend(
    problem: LeastSquaresProblem, z: Float[Numbers, " n"], held: Float[Numbers, " n"], tolerance: float
) -> tuple[ArrayLike, ...]:
    # With an explicit Jacobian, the optimiser need not differentiate the model for every product with it. It is
    # computed in one place, so that it is traced once.
    @jax.custom_jvp
    def residual(z):
        return problem.softened(_residual_and_slope(problem, held, z)[0])

    @residual.defjvp
    def _(primals, tangents):
        value, slope = _residual_and_slope(problem, held, *primals)
        return jax.jvp(problem.softened, (value,), (slope @ tangents[0],))

    optimiser = eqx.tree_at(lambda o: o.search, optx.LevenbergMarquardt(tolerance, tolerance), _Acceptance())
    # The optimiser calls it within and without `vmap`. For JAX these are different contexts, and it would trace twice.
    with jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), ())):
        solution = optx.least_squares(
            lambda z, _: residual(z),
            optimiser,
            jnp.asarray(z),
            options={"jac": "fwd"},
            max_steps=problem.max_steps,
            throw=False,
        )
        found = _at(problem, solution.value, held)
    return *found, solution.stats["num_steps"], solution.result == optx.RESULTS.successful


@kept_program
@eqx.filter_jit
def _descend_all(problem: LeastSquaresProblem, data: Data, z: Float[Numbers, "searches n"]) -> tuple[ArrayLike, ...]:
    free = jnp.full(z.shape[1], jnp.nan)

    def one(data, z):
        return _descend(replace(problem, data=data), z, free, BATCH_TOLERANCE)

    return jax.vmap(one)(data, z)
