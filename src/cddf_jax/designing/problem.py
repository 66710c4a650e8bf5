"""A design as a nonlinear program: an objective to be made small, margins that must not be negative, equations."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from ..robot.manipulator import Manipulator
from ..robot.profiles import Scalar
from ..statics.status import Status
from .body_quantities import BodyView
from .constrained import Point
from .free_numbers import FreeNumbers, Vector
from .load_cases import LoadCase, alike, stacked
from .objectives import Limit, Objective

Answer = TypeVar("Answer", bound=PyTree)
Part = Float[Array | np.ndarray, " _"]  # of a vector
USABLE = (  # with which a search can go on
    *(Status.successful, Status.direction_contradicted, Status.crossing),
    *(Status.inaccurate, Status.unstable),
)


class Term(eqx.Module):
    """An objective with its weight."""

    objective: Objective
    weight: Scalar
    reference: Scalar  # its size at the start, relative to which it counts
    most: Scalar | None = None  # a level that it must not exceed, SI; infinite for none


class DesignEvaluation(NamedTuple):
    """All values at one point, by term and by limit; the leading axis is the load cases, or 1."""

    aims: tuple[Array, ...]  # (cases, ...) SI, of the terms
    margins: tuple[Array, ...]  # (cases, sides, ...), scaled; negative where a limit is broken
    zeros: tuple[Array, ...]  # (cases, ...), scaled
    codes: Int[Array, " cases"]  # statuses of the solves


class ProgramValues(NamedTuple):
    """The values of the nonlinear program."""

    objective: Float[Array, ""]
    inequality: Vector  # must not be negative
    equality: Vector


class DesignProblem(eqx.Module):
    """Start body, free numbers, load cases, objectives and limits.

    The unknowns are the scaled free numbers, followed by a height for every objective that is a peak. The peak must not
    exceed its height, and the height is made small (the epigraph form: it is smooth, while a maximum is not).
    """

    manipulator: Manipulator
    free: FreeNumbers
    cases: tuple[LoadCase, ...]
    terms: tuple[Term, ...]
    limits: tuple[Limit, ...]
    stations: Vector  # arc lengths over the length, at which limits are evaluated
    implied: tuple[bool, ...] = eqx.field(static=True)  # of each limit, whether it is one that every body must keep
    worst: bool = eqx.field(static=True)  # whether the worst case counts, and not the weighted mean
    nodes: int = eqx.field(static=True)

    @property
    def peaks(self) -> tuple[int, ...]:
        """The places of the terms that are peaks."""
        return tuple(i for i, term in enumerate(self.terms) if term.objective.peak or self.worst)

    @property
    def shares(self) -> Float[Array, " cases"]:
        """The weights of the load cases; their sum is one."""
        weights = jnp.stack([jnp.asarray(case.weight) for case in self.cases])
        return weights / jnp.sum(weights)

    def split(self, unknowns: Vector) -> tuple[Part, Part]:
        """The scaled free numbers, and the heights of the peaks."""
        count = len(self.free.names)
        return unknowns[:count], unknowns[count:]

    def body(self, z: Vector) -> Manipulator:
        """The body with these scaled free numbers."""
        return self.free.applied(self.manipulator, self.cases[0], z)[0]

    def view(self, z: Vector, case: LoadCase) -> BodyView:
        """The body in a load case, solved."""
        body, used = self.free.applied(self.manipulator, case, z)
        body = used.body(body)
        return BodyView(body, self._places(body), used, used.solve(body, self.nodes), self.nodes)

    def _places(self, body: Manipulator) -> Float[Array, " points"]:
        return jnp.asarray(self.stations) * jnp.asarray(body.length)

    def __call__(self, x: np.ndarray) -> Point:
        """The nonlinear program at some unknowns; problems with the same structure share one compiled program."""
        values, slopes, found = jax.tree.map(np.asarray, _values_and_slopes(self, jnp.asarray(x)))
        finite = all(np.all(np.isfinite(part)) for part in (*values, *slopes))
        usable = finite and bool(np.all(np.isin(found.codes, USABLE)))
        inequality, equality = (values.inequality, slopes.inequality), (values.equality, slopes.equality)
        return Point(np.array(x), float(values.objective), slopes.objective, *inequality, *equality, usable)

    def evaluation(self, x: np.ndarray) -> DesignEvaluation:
        """The objectives, margins and equations of the nonlinear program, before they are put together."""
        return jax.tree.map(np.asarray, _values_and_slopes(self, jnp.asarray(x))[2])

    def _evaluate(self, z: Vector) -> DesignEvaluation:
        """Objectives, margins and zeros at scaled free numbers; of the body alone once, else of every case."""
        body = self.body(z)
        straight = BodyView(body, self._places(body))

        def of_case(case: LoadCase) -> DesignEvaluation:
            bent = self.view(z, case)
            aims = tuple(t.objective.values(bent if t.objective.known.bent else straight) for t in self.terms)
            views = [bent if limit.known.bent else straight for limit in self.limits]
            margins = tuple(limit.inequalities(view) for limit, view in zip(self.limits, views, strict=True))
            zeros = tuple(limit.equalities(view) for limit, view in zip(self.limits, views, strict=True))
            return DesignEvaluation(aims, margins, zeros, bent.equilibrium.status)

        def once(parts: Sequence[Objective | Limit], values: Sequence[Array]) -> tuple[Array, ...]:
            return tuple(x if part.known.bent else x[:1] for part, x in zip(parts, values, strict=True))

        aims, margins, zeros, codes = self._of_every_case(of_case)
        aims = once([term.objective for term in self.terms], aims)
        return DesignEvaluation(aims, once(self.limits, margins), once(self.limits, zeros), codes)

    def _of_every_case(self, function: Callable[[LoadCase], Answer]) -> Answer:
        """The function of every case, with a leading axis on its values; similar cases are computed together."""
        answers: dict[int, Answer] = {}
        for group in alike(self.cases):
            if len(group) == 1:
                answers[group[0]] = function(self.cases[group[0]])
                continue
            many = jax.vmap(function)(stacked([self.cases[i] for i in group]))
            answers |= {i: jax.tree.map(lambda x, k=k: x[k], many) for k, i in enumerate(group)}
        return jax.tree.map(lambda *values: jnp.stack(values), *(answers[i] for i in range(len(self.cases))))

    def values(self, unknowns: Vector) -> tuple[ProgramValues, DesignEvaluation]:
        """The values of the nonlinear program, and its evaluation."""
        z, heights = self.split(unknowns)
        found = self._evaluate(z)
        total, below = jnp.zeros_like(unknowns[0]), []
        for i, (term, aim) in enumerate(zip(self.terms, found.aims, strict=True)):
            if i in self.peaks:
                height = heights[self.peaks.index(i)]
                total += term.weight * height
                below.append(height - jnp.ravel(aim) / term.reference)
            else:
                total += term.weight / term.reference * self.mean(aim)
            if term.most is not None:  # how far it is below its level
                room = (term.most - jnp.ravel(aim if i in self.peaks else self.mean(aim))) / term.reference
                below.append(jnp.where(jnp.isinf(term.most), 1.0, room))
        none = jnp.zeros((0,), total.dtype)
        inequality = jnp.concatenate([none, *map(jnp.ravel, found.margins), *below])
        return ProgramValues(total, inequality, jnp.concatenate([none, *map(jnp.ravel, found.zeros)])), found

    def over_the_cases(self, i: int, aim: Array | np.ndarray) -> Float[Array, ""]:
        """One value of an objective over the cases: for a peak the largest, else the weighted mean."""
        return jnp.max(aim) if i in self.peaks else self.mean(aim)

    def mean(self, aim: Float[Array | np.ndarray, " cases"]) -> Float[Array, ""]:
        """The mean over the cases by their weights."""
        aim = jnp.asarray(aim)
        return aim[0] if aim.shape[0] == 1 else self.shares @ aim


def pieces_of(flat: np.ndarray, like: Sequence[Array | np.ndarray]) -> list[np.ndarray]:
    """The first entries of a vector, in pieces with the shapes of some arrays."""
    pieces = np.split(flat, np.cumsum([np.size(array) for array in like]))
    return [piece.reshape(np.shape(array)) for piece, array in zip(pieces, like, strict=False)]


@eqx.filter_jit
def _values_and_slopes(problem: DesignProblem, x: Array) -> tuple[ProgramValues, ProgramValues, DesignEvaluation]:
    def twice(x: Array) -> tuple[ProgramValues, tuple[ProgramValues, DesignEvaluation]]:
        values, found = problem.values(x)
        return values, (values, found)

    slopes, (values, found) = jax.jacfwd(twice, has_aux=True)(x)
    return values, slopes, found
