"""One short step of a body whose tendons may slide or rest, solved for all cells at once.

Within a step each tendon obeys Coulomb's law with its slip dw in that step. Where the tendon moved towards the base,
its share sigma of the friction limit is +1; where it moved away, -1; where it did not move, equilibrium determines the
share. The law is softened by a length delta, sigma = dw / sqrt(dw^2 + delta^2). Newton's method reduces delta from a
hundredth to 1e-10 of the largest offset, and so finds where tendons rest. With a smaller delta, the slips of tendons
that rest would be hardly larger than their rounding errors, and the passes would not settle. A single tendon settles
with 1e-13.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..mechanics.friction import PerTendon
from ..numerics.arrays import largest_size, varying_as, zero_as
from ..numerics.fixed_point import slope_along, solve_small
from .cells import Cells, Edge, along_cell, missing_along

Number = Float[Array, ""]
PerCell = Float[Array, "*P tendons"]  # of all cells; without their axis of one
FIRST_SOFTNESS = 1e-2  # delta, over the largest offset
LAST_SOFTNESS = 1e-10
LAST_ALONE = 1e-13  # the same for a single tendon
SHRINKING = (0.1, 0.3, 0.3, 0.5)  # factor on delta in a pass, in each of four attempts
SETTLED = (np.inf, 1e-2, 1e-2, 1e-4)  # delta is reduced after a pass whose change was smaller, in each attempt
PASSES = (40, 120, 200, 320)  # numbers of passes after which the next attempt starts again
LOCATED = 120  # passes after which a front is taken as in the middle of its cell, since its place did not settle
LOCATING = 5  # passes with the last delta, after which the position of a front within its cell is held
TOLERANCE = 1e-10  # of the change in a pass
PATIENCE = 10  # passes with the last delta, after which changes count as rounding, see `_tolerance`
ROUNDING = 1e-8  # the tolerance then
LEAST_RATE = 1e-3  # of the largest slip rate: below it a tendon counts as resting where its front is located


class Ends(NamedTuple):
    """The given numbers at the ends of the body."""

    base_tension: PerTendon  # N; a first guess for a tendon that is driven by its displacement
    displacement: PerTendon  # m, pulled in at the base; used for such a tendon only
    tip_moment: Number  # N m


class Step(NamedTuple):
    """The body after a step."""

    edges: Edge  # leading axis P + 1
    share: PerCell  # sigma of each cell
    slip_rate: PerCell  # -w' in the middle of each cell
    converged: Bool[Array, ""]


class Setting(eqx.Module):
    """A body, its loads, and how it is driven."""

    cells: Cells
    outboard: Float[Array, "P 3 2"]  # force N, newtons, at the starts, middles and ends of the cells
    driven: tuple[int, ...] = eqx.field(static=True)  # the tendons whose displacement is given


class _Sides(NamedTuple):
    """The slopes of the slip of this step along s in the two neighbours of each cell, scaled to the sum 1.

    Where a front lies within a cell, the slip falls to zero along two straight lines with these slopes.
    """

    left: PerCell
    right: PerCell


class _Gaps(NamedTuple):
    """The residuals of the equations."""

    along: Edge  # the integrals over the cells
    law: PerCell  # Coulomb's law, m
    driven: Float[Array, " driven"]  # the displacements, m; of a slack tendon its tension, scaled to a length


class _Change(NamedTuple):
    edges: Edge
    share: PerCell


def after_step(setting: Setting, ends: Ends, before: Step) -> Step:
    """The body after a small change of the tensions or displacements at its base, and of the loads.

    First derivatives are those of the equations, with the positions of fronts within their cells held.
    """
    return _after_step((setting, ends, before))[0]


@eqx.filter_custom_jvp
def _after_step(given: tuple[Setting, Ends, Step]) -> tuple[Step, _Sides, Number]:
    setting, ends, before = given
    zero = zero_as(setting, ends, before)
    start = varying_as(_with_ends(setting, before, ends), zero)
    least = LAST_SOFTNESS if start.share.shape[1] > 1 else LAST_ALONE
    first, last = FIRST_SOFTNESS * setting.cells.scale + zero, least * setting.cells.scale

    def unsettled(carry):
        _, _, softness, change, count, held = carry
        return ((change > _tolerance(held)) | (softness > last)) & (count < PASSES[-1])

    def improve(carry):
        step, sides, softness, _, count, held = carry
        along, rate = _missing(setting, step)
        located = (held < LOCATING) & (count < LOCATED)
        sides = jax.tree.map(lambda new, old: jnp.where(located, new, old), _sides(before, rate), sides)
        gaps = _gaps(setting, ends, before, step, sides, softness, along)
        change = _correction(setting, ends, before, step, sides, softness, gaps)
        new, size = _changed(setting, ends, step._replace(slip_rate=rate), change)
        again = jnp.any(count == jnp.array(PASSES[:-1]))
        attempt = [count < passes for passes in PASSES[:-1]]
        shrinking, settled = (jnp.select(attempt, list(of[:-1]), of[-1]) for of in (SHRINKING, SETTLED))
        held = jnp.where(again, 0.0, held + (softness <= last))
        smaller = jnp.where(size < settled, shrinking, 1.0) * softness
        softness = jnp.where(again, first, jnp.maximum(smaller, last))
        new = jax.tree.map(lambda x, y: jnp.where(again, x, y), start, new)
        sides = jax.tree.map(lambda x: jnp.where(again, 0.5, x), sides)
        return new, sides, softness, size, count + 1.0, held

    half = jnp.full_like(start.share, 0.5)
    carry = start, _Sides(half, half), first, jnp.inf + zero, zero, zero
    step, sides, softness, change, _, held = jax.lax.while_loop(unsettled, improve, carry)
    return step._replace(converged=(change <= _tolerance(held)) & before.converged), sides, softness


def _tolerance(held: Number) -> Number:
    """The tolerance of the change in a pass, after `held` passes with the last delta.

    Where two tendons that do not stretch both rest, their slip is hardly larger than its rounding error. Their shares
    then jitter, and with them the tensions by some 1e-9.
    """
    return jnp.where(held < PATIENCE, TOLERANCE, ROUNDING)


@_after_step.def_jvp
def _(primals, tangents):
    (given,), (direction,) = primals, tangents
    step, sides, softness = found = _after_step(given)
    setting, ends, before = given

    def gaps(given):
        setting, ends, before = given
        there = _with_ends(setting, step, ends)
        return _gaps(setting, ends, before, there, sides, softness, _missing(setting, there)[0]), there.edges

    missing, moved = slope_along(gaps, given, direction)
    change = _correction(setting, ends, before, step, sides, softness, missing)
    edges = jax.tree.map(jnp.add, moved, change.edges)
    constant = jax.tree.map(lambda _: None, found)
    return found, (constant[0]._replace(edges=edges, share=change.share), *constant[1:])


def _changed(setting: Setting, ends: Ends, step: Step, change: _Change) -> tuple[Step, Number]:
    """The changed step, and how large the change was."""
    cells = setting.cells
    share = jnp.clip(step.share + change.share, -1.0, 1.0)
    moment_scale = cells.sections.stiffness[0, 0] / cells.edges[-1]
    scale = Edge(jnp.maximum(jnp.max(ends.base_tension), 1e-3), jnp.ones(()), cells.scale, moment_scale)
    parts = jax.tree.map(lambda x, size: largest_size(x) / size, change.edges, scale)
    # without tension a share has no effect, and rounding errors may change it in every pass
    of_share = (share - step.share) * step.edges.tension[:-1] / scale.tension
    size = jnp.max(jnp.stack([*parts, 1e-3 * largest_size(of_share)]))
    return step._replace(edges=jax.tree.map(jnp.add, step.edges, change.edges), share=share), size


def _with_ends(setting: Setting, step: Step, ends: Ends) -> Step:
    driven = jnp.asarray(setting.driven, int)
    tension = ends.base_tension.at[driven].set(step.edges.tension[0, driven])
    edges = step.edges._replace(
        tension=step.edges.tension.at[0].set(tension), moment=step.edges.moment.at[-1].set(ends.tip_moment)
    )
    return step._replace(edges=edges)


def _in_cells(edges: Edge) -> tuple[Edge, Edge]:
    """The values at the starts and at the ends of the cells."""
    return jax.tree.map(lambda x: x[:-1], edges), jax.tree.map(lambda x: x[1:], edges)


def _missing(setting: Setting, step: Step) -> tuple[Edge, PerCell]:
    """The residuals of the integrals, and the slip rates in the middle of the cells."""
    cells = setting.cells
    along = cells.along(setting.outboard, step.edges, step.share)
    return jax.vmap(missing_along)(cells.width, along), -along.rates.slip[:, 1]


def _sides(before: Step, rate: PerCell) -> _Sides:
    size = jnp.abs(rate - before.slip_rate)
    size = size + LEAST_RATE * jnp.max(size) + 1e-12
    left, right = jnp.concatenate([size[:1], size[:-1]]), jnp.concatenate([size[1:], size[-1:]])
    return _Sides(left / (left + right), right / (left + right))


def _mismatch(softness: Number, sides: _Sides, share: PerCell, at_start: PerCell, at_end: PerCell) -> PerCell:
    """The residual of Coulomb's law in each cell, m, from the slips of this step at its ends."""

    def size(slip):
        return jnp.sqrt(slip**2 + softness**2)

    left, right = sides
    return share * (right * size(at_start) + left * size(at_end)) - (right * at_start + left * at_end)


def _gaps(
    setting: Setting, ends: Ends, before: Step, step: Step, sides: _Sides, softness: Number, along: Edge
) -> _Gaps:
    """The residuals of all equations; `along` are those of the integrals."""
    moved = step.edges.slip - before.edges.slip
    law = _mismatch(softness, sides, step.share, moved[:-1], moved[1:])
    return _Gaps(along, law, _driven_gap(setting, ends, step.edges))


def _driven_gap(setting: Setting, ends: Ends, edges: Edge) -> Float[Array, " driven"]:
    """The displacement less the given one, m; or, if that is less, the tension of a slack tendon as a length."""
    driven = jnp.asarray(setting.driven, int)
    missed = (setting.cells.pulled_in(edges) - ends.displacement)[driven]
    return jnp.minimum(missed, _per_tension(setting) * edges.tension[0, driven])


def _per_tension(setting: Setting) -> Number:
    """The length per tension, m/N, by which tensions are compared with displacements."""
    sections = setting.cells.sections
    return setting.cells.edges[-1] * jnp.max(sections.offset**2) / sections.stiffness[0, 0]


# --- the linear equations -------------------------------------------------------------------------


def _correction(
    setting: Setting, ends: Ends, before: Step, step: Step, sides: _Sides, softness: Number, gaps: _Gaps
) -> _Change:
    """The change of all unknowns that makes the residuals zero to first order; linear in the residuals."""
    blocks = _blocks(setting, before, step, sides, softness)
    change, by_tension = _swept(blocks, gaps, setting.cells.scale, setting.driven)
    if not setting.driven:
        return change
    push = jax.linearize(partial(_driven_gap, setting, ends), step.edges)[1]
    slopes = jax.vmap(push)(by_tension.edges).T
    tension = solve_small(slopes, -(gaps.driven + push(change.edges)))[0]
    return jax.tree.map(lambda x, k: x + jnp.tensordot(tension, k, 1), change, by_tension)


class _Blocks(NamedTuple):
    """The derivatives of the equations of each cell: integrals of T, phi, w and M, then Coulomb's law.

    Tension and heading are known at the base, slip and moment at the tip.
    """

    by_start: Float[Array, "P rows known"]  # by tension and heading at the start of the cell
    here: Float[Array, "P rows rows"]  # by tension and heading at its end, slip and moment at its start, and shares
    by_end: Float[Array, "P rows sought"]  # by slip and moment at its end


def _flat(edge: Edge) -> tuple[Array, Array]:
    """Tension and heading; slip and moment."""
    return jnp.append(edge.tension, edge.heading), jnp.append(edge.slip, edge.moment)


def _edge(known: Array, sought: Array) -> Edge:
    return Edge(known[:-1], known[-1], sought[:-1], sought[-1])


def _blocks(setting: Setting, before: Step, step: Step, sides: _Sides, softness: Number) -> _Blocks:
    cells, (starts, ends) = setting.cells, _in_cells(step.edges)

    def equations(inputs, known, here, sought_end):
        cell, sides, slip_before, slip_before_end = inputs
        known_end, sought, share = jnp.split(here, [known.size, known.size + sought_end.size])
        start, end = _edge(known, sought), _edge(known_end, sought_end)
        missing = missing_along(cell.width, along_cell(cell, start, end, share, cells.stretch))
        law = _mismatch(softness, sides, share, start.slip - slip_before, end.slip - slip_before_end)
        return jnp.concatenate([*_flat(missing), law / cells.scale])

    known, sought = jax.vmap(_flat)(starts)
    known_end, sought_end = jax.vmap(_flat)(ends)
    here = jnp.concatenate([known_end, sought, step.share], axis=1)
    slip = before.edges.slip
    inputs = cells.inputs(setting.outboard), sides, slip[:-1], slip[1:]
    return _Blocks(*jax.vmap(jax.jacfwd(equations, argnums=(1, 2, 3)))(inputs, known, here, sought_end))


def _swept(blocks: _Blocks, gaps: _Gaps, scale: Number, driven: tuple[int, ...]) -> tuple[_Change, _Change]:
    """The change that makes the residuals zero, and the change by one newton at the base of each driven tendon.

    From the base to the tip, tension and heading at the end of each cell are found as linear functions of slip and
    moment there. From the tip to the base, all numbers follow.
    """
    missing = jnp.concatenate([*jax.vmap(_flat)(gaps.along), gaps.law / scale], axis=1)
    count = blocks.by_end.shape[2]  # of known, and of sought numbers
    zero = jnp.zeros((count, count), missing.dtype) + zero_as(missing)
    pulls = jnp.eye(count, dtype=missing.dtype)[:, list(driven)]

    def outwards(carry, inputs):
        by_sought, known = carry  # at the start of this cell: known = by_sought @ sought + known
        (by_start, here, by_end), missing = inputs
        here = here.at[:, count : 2 * count].add(by_start @ by_sought)
        factors = jax.scipy.linalg.lu_factor(here)
        slopes = jax.scipy.linalg.lu_solve(factors, -by_end)
        given = jnp.zeros((missing.size, known.shape[1])).at[:, 0].set(missing)
        values = jax.scipy.linalg.lu_solve(factors, -(given + by_start @ known))
        return (slopes[:count], values[:count]), (slopes, values)

    first = zero, jnp.concatenate([zero[:, :1], pulls], axis=1)
    _, found = jax.lax.scan(outwards, first, (blocks, missing))

    def back(sought, found):
        slopes, values = found
        here = slopes @ sought + values
        return here[count : 2 * count], here

    _, here = jax.lax.scan(back, jnp.zeros_like(first[1]), found, reverse=True)
    known = jnp.concatenate([first[1][None], here[:, :count]])
    sought = jnp.concatenate([here[:, count : 2 * count], jnp.zeros_like(first[1])[None]])
    column = jax.vmap(lambda known, sought, share: _Change(jax.vmap(_edge)(known, sought), share), -1)
    changes = column(known, sought, here[:, 2 * count :])
    return jax.tree.map(lambda x: x[0], changes), jax.tree.map(lambda x: x[1:], changes)
