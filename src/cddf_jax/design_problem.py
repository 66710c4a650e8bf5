"""A design as an optimiser sees it: one number to be made small, margins that may not be negative, zeros."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .design_space import Space
from .limits import Limit
from .load_cases import LoadCase, alike, stacked
from .manipulator import Manipulator
from .objectives import Objective
from .profiles import Scalar
from .quantities import View

Vector = Float[Array | np.ndarray, " n"]


class Term(eqx.Module):
    """An objective and what it counts."""

    objective: Objective
    weight: Scalar
    reference: Scalar  # its size at the start, over which it counts


class Cap(eqx.Module):
    """A level that an objective may not exceed."""

    objective: Objective
    most: Scalar  # SI, as the objective's own values
    reference: Scalar


class Evaluation(NamedTuple):
    """What is found at one point, by term and by limit; the leading axis is that of the load cases, or 1."""

    aims: tuple[Array, ...]  # (cases, ...) SI
    capped: tuple[Array, ...]  # the same of the objectives that have a cap
    margins: tuple[Array, ...]  # (cases, sides, ...), scaled; negative where a limit is broken
    zeros: tuple[Array, ...]  # (cases, ...), scaled
    codes: Int[Array, " cases"]  # results of the solves


class Values(NamedTuple):
    """What the optimiser is told."""

    objective: Float[Array, ""]
    inequality: Vector  # may not be negative
    equality: Vector


class Problem(eqx.Module):
    """Start body, free numbers, load cases, aims and limits.

    Its unknowns are the scaled free numbers and then, for every objective that is a peak, a height that the peak may
    not exceed: what is made small in its place (the epigraph form, smooth where a maximum is not).
    """

    manipulator: Manipulator
    space: Space
    cases: tuple[LoadCase, ...]
    terms: tuple[Term, ...]
    caps: tuple[Cap, ...]
    limits: tuple[Limit, ...]
    stations: Float[Array | np.ndarray, " points"]  # arc lengths over the length, at which limits are looked at
    worst: bool = eqx.field(static=True)  # whether the worst case counts, and not the weighted mean
    nodes: int = eqx.field(static=True)

    @property
    def peaks(self) -> tuple[int, ...]:
        """The places of the terms that are peaks."""
        return tuple(i for i, term in enumerate(self.terms) if term.objective.peak or self.worst)

    @property
    def shares(self) -> Float[Array, " cases"]:
        """The weights of the load cases, one in all."""
        weights = jnp.stack([jnp.asarray(case.weight) for case in self.cases])
        return weights / jnp.sum(weights)

    def body(self, z: Vector) -> Manipulator:
        """The body that is to be made."""
        return self.space.applied(self.manipulator, self.cases[0], z)[0]

    def view(self, z: Vector, case: LoadCase) -> View:
        """The body as a case has it, solved."""
        body, used = self.space.applied(self.manipulator, case, z)
        body = used.body(body)
        return View(body, self._places(body), used, used.solve(body, self.nodes), self.nodes)

    def _places(self, body: Manipulator) -> Float[Array, " points"]:
        return jnp.asarray(self.stations) * jnp.asarray(body.length)

    def evaluate(self, z: Vector) -> Evaluation:
        """Aims, margins and zeros at scaled free numbers."""
        body = self.body(z)
        alone = View(body, self._places(body))
        idle = _look(self, alone, bent=False)
        if not any(part.bent for part in (*(each.objective for each in (*self.terms, *self.caps)), *self.limits)):
            return _joined([idle], self, jnp.zeros((0,), int))

        def of_case(case: LoadCase) -> Any:
            view = self.view(z, case)
            return _look(self, view, bent=True), view.equilibrium.result._value

        found = self._of_every_case(of_case)
        codes = jnp.stack([jnp.asarray(code) for _, code in found])
        return _joined([idle, *(look for look, _ in found)], self, codes)

    def _of_every_case(self, function: Callable[[LoadCase], Any]) -> list[Any]:
        """The function of every case; cases of one kind at once."""
        answers: list[Any] = [None] * len(self.cases)
        for group in alike(self.cases):
            if len(group) == 1:
                answers[group[0]] = function(self.cases[group[0]])
                continue
            many = jax.vmap(function)(stacked([self.cases[i] for i in group]))
            for k, i in enumerate(group):
                answers[i] = jax.tree.map(lambda x, k=k: x[k], many)
        return answers

    def values(self, unknowns: Vector) -> tuple[Values, Evaluation]:
        """What the optimiser is told, and what it is made of."""
        z, heights = unknowns[: len(self.space.names)], unknowns[len(self.space.names) :]
        found = self.evaluate(z)
        total, below = jnp.zeros_like(unknowns[0]), []
        for i, (term, aim) in enumerate(zip(self.terms, found.aims, strict=True)):
            if i in self.peaks:
                height = heights[self.peaks.index(i)]
                total += term.weight * height
                below.append(height - jnp.ravel(aim) / term.reference)
            else:
                total += term.weight / term.reference * self.mean(aim)
        flat = [jnp.ravel(margin) for margin in found.margins]
        none = jnp.zeros((0,), total.dtype)
        flat += [self.room(cap, aim) for cap, aim in zip(self.caps, found.capped, strict=True)]
        inequality = jnp.concatenate([none, *flat, *below])
        return Values(total, inequality, jnp.concatenate([none, *map(jnp.ravel, found.zeros)])), found

    def room(self, cap: Cap, aim: Array) -> Vector:
        """What is left below a cap, scaled."""
        peak = cap.objective.peak or self.worst
        return (cap.most - jnp.ravel(aim if peak else self.mean(aim))) / cap.reference

    def mean(self, aim: Float[Array, " cases"]) -> Float[Array, ""]:
        """Over the cases by their weights."""
        return aim[0] if aim.shape[0] == 1 else self.shares @ aim


class _Look(NamedTuple):
    """What one view shows: None for what it does not concern."""

    aims: list[Any]
    capped: list[Any]
    margins: list[Any]
    zeros: list[Any]


def _look(problem: Problem, view: View, bent: bool) -> _Look:
    concerned = [limit if limit.bent == bent else None for limit in problem.limits]

    def seen(objective: Objective) -> Any:
        return objective.values(view) if objective.bent == bent else None

    return _Look(
        [seen(term.objective) for term in problem.terms],
        [seen(cap.objective) for cap in problem.caps],
        [None if limit is None else limit.inequalities(view) for limit in concerned],
        [None if limit is None else limit.equalities(view) for limit in concerned],
    )


def _joined(looks: list[_Look], problem: Problem, codes: Array) -> Evaluation:
    def each(parts: list[list[Any]]) -> tuple[Array, ...]:
        return tuple(jnp.stack([part for part in parts if part is not None]) for parts in zip(*parts, strict=True))

    return Evaluation(
        each([look.aims for look in looks]),
        each([look.capped for look in looks]),
        each([look.margins for look in looks]),
        each([look.zeros for look in looks]),
        codes,
    )


def split(flat: np.ndarray, like: tuple[Any, ...]) -> list[np.ndarray]:
    """The pieces of a vector that belong to each array, in their shapes; what is left over belongs to none."""
    pieces = np.split(flat, np.cumsum([np.size(array) for array in like]))
    return [piece.reshape(np.shape(array)) for piece, array in zip(pieces, like, strict=False)]
