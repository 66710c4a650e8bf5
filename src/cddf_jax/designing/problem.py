"""A design as a nonlinear program: an objective to be made small, margins that must not be negative, equations."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..robot.manipulator import Manipulator
from ..robot.profiles import Scalar
from ..statics.status import Status
from .body_quantities import BodyView
from .constrained import Point
from .free_numbers import FreeNumbers, Vector
from .load_cases import LoadCase, of_every_case
from .objectives import Limit, Objective

Part = Float[Array | np.ndarray, " _"]  # of a vector
Values = tuple[Array, Array]  # objective and scaled margins, or their slopes
USABLE = (  # with which a search can go on
    *(Status.successful, Status.direction_contradicted, Status.crossing),
    *(Status.inaccurate, Status.unstable),
)


class Term(eqx.Module):
    """An objective with its weight."""

    objective: Objective
    weight: Scalar
    size: Scalar  # at the start, relative to which it counts
    most: Scalar | None = None  # a level that it must not exceed, SI; infinite for none


class Kept(eqx.Module):
    """A limit that the body must keep."""

    limit: Limit
    size: Scalar  # relative to which violations count


class DesignEvaluation(NamedTuple):
    """All values at one point, by term and by limit, SI; the leading axis is the load cases, or 1."""

    aims: tuple[Array, ...]  # (cases, ...) of the terms
    margins: tuple[Array, ...]  # (cases, sides, ...) of the limits
    codes: Int[Array, " cases"]  # statuses of the solves


class DesignProblem(eqx.Module):
    """Start body, free numbers, load cases, objectives and limits.

    The unknowns are the scaled free numbers, followed by a height for every objective that is a peak. The peak must not
    exceed its height, and the height is made small (the epigraph form: it is smooth, while a maximum is not).
    """

    manipulator: Manipulator
    free: FreeNumbers
    cases: tuple[LoadCase, ...]
    terms: tuple[Term, ...]
    limits: tuple[Kept, ...]
    stations: Vector  # arc lengths over the length, at which limits are evaluated
    worst: bool = eqx.field(static=True)  # whether the worst case counts, and not the weighted mean
    nodes: int = eqx.field(static=True)

    @property
    def peaks(self) -> tuple[int, ...]:
        """The places of the terms that are peaks."""
        return tuple(i for i, term in enumerate(self.terms) if term.objective.peak or self.worst)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the unknowns."""
        ranges, heights = self.free.ranges, np.full(len(self.peaks), np.inf)
        return np.append(0 * ranges, -heights), np.append(ranges, heights)

    def split(self, unknowns: Vector) -> tuple[Part, Part]:
        """The scaled free numbers, and the heights of the peaks."""
        count = len(self.free.names)
        return unknowns[:count], unknowns[count:]

    def unknowns(self, z: np.ndarray) -> np.ndarray:
        """Scaled free numbers, followed by the heights of the peaks there."""
        aims = self.evaluation(z).aims
        return np.append(z, [np.max(aims[i]) / float(self.terms[i].size) for i in self.peaks])

    def body(self, z: Vector) -> Manipulator:
        """The body with these scaled free numbers."""
        return self.free.applied(self.manipulator, self.cases[0], z)[0]

    def view(self, z: Vector, case: LoadCase) -> BodyView:
        """The body in a load case, solved."""
        body, used = self.free.applied(self.manipulator, case, z)
        body = used.body(body)
        return BodyView(body, self.stations * jnp.asarray(body.length), used, used.solve(body, self.nodes), self.nodes)

    def __call__(self, x: np.ndarray) -> Point:
        """The nonlinear program at some unknowns; problems with the same structure share one compiled program."""
        found = jax.tree.map(np.asarray, _values_and_slopes(self, jnp.asarray(x)))
        (objective, margins), (gradient, slopes), there = found
        known = zip(there.margins, self.limits, strict=True)
        equations = np.concatenate([np.full(own.size, kept.limit.equal is not None) for own, kept in known])
        equal = np.pad(equations, (0, margins.size - equations.size))  # peaks and levels are none
        usable = all(np.all(np.isfinite(part)) for part in (objective, margins, gradient, slopes))
        usable = usable and bool(np.all(np.isin(there.codes, USABLE)))
        return Point(np.array(x), float(objective), gradient, margins, slopes, equal, usable)

    def evaluation(self, z: np.ndarray) -> DesignEvaluation:
        """Objectives and margins, before they are put together; heights after the free numbers do not count."""
        x = np.append(self.split(z)[0], np.zeros(len(self.peaks)))
        return jax.tree.map(np.asarray, _values_and_slopes(self, jnp.asarray(x))[2])

    def _evaluate(self, z: Vector) -> DesignEvaluation:
        """Objectives and margins at scaled free numbers; of the body alone once, else of every case."""
        body = self.body(z)
        straight = BodyView(body, self.stations * jnp.asarray(body.length))
        aims, limits = [term.objective for term in self.terms], [kept.limit for kept in self.limits]

        def of_case(case: LoadCase) -> DesignEvaluation:
            bent = self.view(z, case)
            values = tuple(aim.values(bent if aim.known.bent else straight) for aim in aims)
            margins = tuple(limit.margins(bent if limit.known.bent else straight) for limit in limits)
            return DesignEvaluation(values, margins, bent.equilibrium.status)

        def once(parts: Sequence[Objective | Limit], values: Sequence[Array]) -> tuple[Array, ...]:
            return tuple(x if part.known.bent else x[:1] for part, x in zip(parts, values, strict=True))

        found = of_every_case(of_case, self.cases)
        return DesignEvaluation(once(aims, found.aims), once(limits, found.margins), found.codes)

    def values(self, unknowns: Vector) -> tuple[Values, DesignEvaluation]:
        """The objective and the scaled margins of the nonlinear program, and its evaluation."""
        z, heights = self.split(unknowns)
        found = self._evaluate(z)
        total = jnp.zeros_like(unknowns[0])
        margins = [jnp.ravel(own) / kept.size for own, kept in zip(found.margins, self.limits, strict=True)]
        for i, (term, aim) in enumerate(zip(self.terms, found.aims, strict=True)):
            if i in self.peaks:
                height = heights[self.peaks.index(i)]
                total += term.weight * height
                margins.append(height - jnp.ravel(aim) / term.size)
            else:
                total += term.weight / term.size * self.mean(aim)
            if term.most is not None:  # how far it is below its level
                room = (term.most - jnp.ravel(aim if i in self.peaks else self.mean(aim))) / term.size
                margins.append(jnp.where(jnp.isinf(term.most), 1.0, room))
        return (total, jnp.concatenate(margins)), found

    def rows_along(self, x: np.ndarray) -> np.ndarray:
        """(rows, stations) scaled margins of every limit along the body, and of every peak below its height."""
        found, (_, heights) = self.evaluation(x), self.split(x)
        known = zip(found.margins, self.limits, strict=True)
        rows = [own / float(kept.size) for own, kept in known if kept.limit.known.along]
        for i, height in zip(self.peaks, heights, strict=True):
            if self.terms[i].objective.peak:
                rows.append(height - found.aims[i] / float(self.terms[i].size))
        count = len(self.stations)
        return np.concatenate([np.zeros((0, count)), *(row.reshape(-1, count) for row in rows)])

    def over_the_cases(self, i: int, aim: Array | np.ndarray) -> Float[Array, ""]:
        """One value of an objective over the cases: for a peak the largest, else the weighted mean."""
        return jnp.max(aim) if i in self.peaks else self.mean(aim)

    def mean(self, aim: Float[Array | np.ndarray, " cases"]) -> Float[Array, ""]:
        """The mean over the cases by their weights."""
        aim, weights = jnp.asarray(aim), jnp.stack([jnp.asarray(case.weight) for case in self.cases])
        return aim[0] if aim.shape[0] == 1 else (weights / jnp.sum(weights)) @ aim


def pieces_of(flat: np.ndarray, like: Sequence[Array | np.ndarray]) -> list[np.ndarray]:
    """The first entries of a vector, in pieces with the shapes of some arrays."""
    pieces = np.split(flat, np.cumsum([np.size(array) for array in like]))
    return [piece.reshape(np.shape(array)) for piece, array in zip(pieces, like, strict=False)]


@eqx.filter_jit
def _values_and_slopes(problem: DesignProblem, x: Array) -> tuple[Values, Values, DesignEvaluation]:
    def twice(x: Array) -> tuple[Values, tuple[Values, DesignEvaluation]]:
        values, found = problem.values(x)
        return values, (values, found)

    slopes, (values, found) = jax.jacfwd(twice, has_aux=True)(x)
    return values, slopes, found
