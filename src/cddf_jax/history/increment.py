"""One increment of a path, solved for all nodes at once by Newton's method.

Each tendon obeys Coulomb's law in every element: the jump of its tension is a share z of the limit of friction,
between -1 and 1, which changes only while the tendon slips, and reaches the ends where it slides. The law is softened
by a very small elastic slip e: z = x / (1 + x^p)^(1/p) with a large even p, where x grows by dw / e with the slip dw.
Newton's method treats z as an unknown of its own (primal-dual), so that it hardly overshoots. Most rounds only find
which elements slide: so at first the slopes of the mechanics stay for some rounds, which halves the time of a step.
Where it does not settle with the small e, as at a turn, it goes from a large e to the small one (continuation).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from ..numerics import tolerances as tol
from ..numerics.arrays import all_finite, largest_size, varying_as, zero_as
from ..numerics.fixed_point import slope_along, solve_small
from .grid import Element, Given, Goal, Grid, Missing, Node, Number, missing

FOUND = "found"  # the name of what Newton's method finds, which the reverse mode keeps
PerElement = Float[Array, "K tendons"]
ByNodes = Float[Array, "K rows 2 unknowns"]  # derivatives of the residuals of elements by the nodes at both ends


class OnGrid(NamedTuple):
    """The body after an increment."""

    nodes: Node  # leading axis K + 1; the last one is beyond the tip
    share: PerElement  # z of each element
    converged: Bool[Array, ""]
    held: Float[Array, "K *strains"] | None  # the strains of a body with friction of its own; None without
    elastic: Number  # the largest elastic slip with which an increment up to here has settled, m


class Setting(eqx.Module):
    """What is solved: the body, what acts on it, and the body before."""

    grid: Grid
    given: Given
    before: OnGrid
    driven: tuple[Goal, ...] = eqx.field(static=True)


class _Law(NamedTuple):
    """Coulomb's law, linear in the slip: z = level + slope (w - slip)."""

    level: PerElement
    slope: PerElement  # 1/m
    slip: PerElement  # m
    share: PerElement  # z


class _Search(NamedTuple):
    nodes: Node
    strain: PerElement  # x
    share: PerElement  # z, an unknown of its own
    elastic: Number  # e, m
    rounds: Number  # in this attempt
    attempt: Number
    done: Bool[Array, ""]


def after_increment(setting: Setting) -> OnGrid:
    """The body after a small change of the tensions or displacements at its base, and of the loads.

    Derivatives are those of the equations.
    """
    nodes, share, converged, elastic = _after_increment(setting)
    held = setting.before.held
    if held is not None:
        held = setting.grid.at_all(nodes, setting.given.force, held)[0]
    return OnGrid(nodes, share, converged, held, jnp.maximum(setting.before.elastic, elastic))


@eqx.filter_custom_jvp
def _after_increment(setting: Setting) -> tuple[Node, PerElement, Bool[Array, ""], Number]:
    start = varying_as(_with_ends(setting, setting.before.nodes), zero_as(setting))

    def unfinished(state: _Search) -> Bool[Array, ""]:
        return ~state.done & (state.attempt < len(tol.ATTEMPTS))

    def rounds(first: _Search) -> _Search:
        """Some rounds with the same slopes of the mechanics; one with friction of the body, which is not smooth."""
        slopes = _missing_of_all(setting, first.nodes, jax.jacrev)
        kept = _attempt(setting, first.attempt).slopes if setting.before.held is None else 1.0

        def goes_on(state: _Search) -> Bool[Array, ""]:
            return unfinished(state) & (state.attempt == first.attempt) & (state.rounds < first.rounds + kept)

        return jax.lax.while_loop(goes_on, partial(_round, setting, start, slopes), first)

    end = jax.lax.while_loop(unfinished, rounds, _begun(setting, start, zero_as(setting)))
    nodes = jax.tree.map(partial(jnp.where, end.done), end.nodes, start)  # finite in either case
    return nodes, _share(setting, nodes, end.elastic), end.done & setting.before.converged, end.elastic


class _Attempt(NamedTuple):
    """How Newton's method is tried."""

    first: Number  # elastic slip, m
    last: Number
    factor: Number  # on the elastic slip
    rough: Number  # change in a round, below which the elastic slip becomes smaller
    rounds: Number  # at most
    slopes: Number  # rounds for which the slopes of the mechanics stay


def _attempt(setting: Setting, number: Number) -> _Attempt:
    rows = jnp.asarray(tol.ATTEMPTS, number.dtype)
    found, scale = _Attempt(*rows[jnp.minimum(number, len(rows) - 1).astype(int)]), setting.grid.scale
    return found._replace(first=found.first * scale, last=found.last * scale)


def _begun(setting: Setting, start: Node, attempt: Number) -> _Search:
    """The start of an attempt, in which tendons that slide are expected to slide on."""
    none, share = 0.0 * attempt, setting.before.share + 0.0 * attempt
    return _Search(start, _strain_of(share), share, _attempt(setting, attempt).first, none, attempt, none > 0)


def _round(setting: Setting, start: Node, slopes: Missing, state: _Search) -> _Search:
    """One Newton step; then a smaller elastic slip, or another attempt."""
    law, attempt = _law(state.strain, state.share, state.nodes, state.elastic), _attempt(setting, state.attempt)
    lacks = _missing_of_all(setting, state.nodes)
    by_nodes = _by_nodes(setting, state.nodes, law, lacks, slopes)
    change = _correction(setting, state.nodes, by_nodes, _rows_of_all(setting, state.nodes, law, lacks))
    halved = (state.rounds // tol.PATIENCE) % 2 > 0  # where steps go round in a circle
    part = jnp.where(halved, 0.5, 1.0)
    nodes = jax.tree.map(lambda x, dx: x + part * dx, state.nodes, change)
    share = jnp.clip(law.level + part * law.slope * change.slip[1:], -1.0, 1.0)
    size = _size(setting.grid, nodes, change)
    elastic = jnp.maximum(jnp.where(size < attempt.rough, attempt.factor, 1.0) * state.elastic, attempt.last)
    done = (state.elastic <= attempt.last) & ~halved & (size < tol.INCREMENT)
    strain = _strain(setting, nodes, elastic)
    onward = _Search(nodes, strain, share, elastic, state.rounds + 1, state.attempt, done)
    stuck = ~done & (~all_finite(size) | (state.rounds >= attempt.rounds))
    again = _begun(setting, start, state.attempt + 1)
    return jax.tree.map(lambda a, b: jnp.where(stuck, a, b), again, onward)


@_after_increment.def_jvp
def _(primals, tangents):
    (setting,), (direction,) = primals, tangents
    nodes, share, _, least = found = checkpoint_name(_after_increment(setting), FOUND)

    def law_of(setting: Setting) -> _Law:
        law = _law(_strain(setting, nodes, least), share, nodes, least)
        return law._replace(slope=jax.lax.stop_gradient(law.slope))  # it only scales what is zero

    def rows(setting: Setting):
        there = _with_ends(setting, nodes)
        return _rows_of_all(setting, there, law_of(setting), _missing_of_all(setting, there)), there

    pushed, moved = slope_along(rows, setting, direction)
    lacks, slopes = _missing_of_all(setting, nodes), _missing_of_all(setting, nodes, jax.jacrev)
    by_nodes = _by_nodes(setting, nodes, law_of(setting), lacks, slopes)
    change = jax.tree.map(jnp.add, moved, _correction(setting, nodes, by_nodes, pushed))
    shares = slope_along(lambda both: _share(*both, least), (setting, nodes), (direction, change))
    return found, (change, shares, None, 0.0 * least)


def _strain_of(share: PerElement) -> PerElement:
    """x, of z. A tendon that slid need not slide back as far: its x is that where sliding begins."""
    return share / jnp.maximum(1.0 - share**tol.CORNER, tol.SLIDING) ** (1 / tol.CORNER)


def _size_of(strain: PerElement) -> PerElement:
    """The quotient x / z."""
    return (1.0 + strain**tol.CORNER) ** (1 / tol.CORNER)


def _strain(setting: Setting, nodes: Node, elastic: Number) -> PerElement:
    """The slips since the increment before, in elastic slips, from where the shares were: x."""
    slid = nodes.slip[1:] - setting.before.nodes.slip[1:]  # the slip of an element is that before its end
    return _strain_of(setting.before.share) + slid / elastic


def _law(strain: PerElement, share: PerElement, nodes: Node, elastic: Number) -> _Law:
    level = strain / _size_of(strain)
    slope = (1.0 - share * level ** (tol.CORNER - 1)) / (_size_of(strain) * elastic)
    return _Law(level, slope, nodes.slip[1:], share)


def _share(setting: Setting, nodes: Node, elastic: Number) -> PerElement:
    """z; a tendon without tension forgets it."""
    strain = _strain(setting, nodes, elastic)
    taut = jnp.maximum(nodes.tension[:-1], nodes.tension[1:]) > 0
    return jnp.where(taut, strain / _size_of(strain), 0.0)


def _with_ends(setting: Setting, nodes: Node) -> Node:
    """The nodes with the given tensions at the base and the given moment at the tip."""
    given, driven = setting.given, tendons_of(setting.driven)
    tension = given.base_tension.at[driven].set(nodes.tension[0, driven])
    nodes = nodes._replace(tension=nodes.tension.at[0].set(tension))
    if nodes.moment is None or given.tip_moment is None:
        return nodes
    return nodes._replace(moment=nodes.moment.at[-1].set(given.tip_moment))


def _size(grid: Grid, nodes: Node, change: Node) -> Number:
    """How large a change is."""
    parts = [
        largest_size(change.tension) / jnp.maximum(largest_size(nodes.tension), 1e-3),
        largest_size(change.slip) / grid.scale,
    ]
    return jnp.max(jnp.stack(parts if change.heading is None else [*parts, largest_size(change.heading)]))


# --- the equations, and Newton's method with the active set held ----------------------------------


class Rows(NamedTuple):
    """The residuals of all elements, and of the driven tendons."""

    elements: Float[Array, "K rows"]
    driven: Float[Array, " driven"]  # m


def _rows_of_all(setting: Setting, nodes: Node, law: _Law, lacks: Missing) -> Rows:
    rows = jax.vmap(partial(_rows, setting.grid, nodes))(law, _at_ends(nodes), lacks)
    return Rows(rows, _driven_gap(setting, nodes))


def _at_ends(nodes: Node) -> Float[Array, "K 2 unknowns"]:
    """The unknowns at both ends of each element."""
    flat = jax.vmap(lambda node: ravel_pytree(node)[0])(nodes)
    return jnp.stack([flat[:-1], flat[1:]], axis=1)


def _node(nodes: Node, unknowns: Array) -> Node:
    """One node, from its unknowns."""
    return ravel_pytree(jax.tree.map(lambda x: x[0], nodes))[1](unknowns)


def _missing_of_all(setting: Setting, nodes: Node, taken: Callable = lambda of: of) -> Missing:
    """What is missing in all elements; with `jax.jacrev` its slopes by the nodes at both ends, the last two axes."""

    def of(both: Array, element: Element) -> Missing:
        return missing(setting.grid, element, *map(partial(_node, nodes), both))

    elements = setting.grid.elements(setting.given, setting.before.held)
    return jax.vmap(taken(of))(_at_ends(nodes), elements)


def _by_nodes(setting: Setting, nodes: Node, law: _Law, lacks: Missing, slopes: Missing) -> ByNodes:
    """The derivatives of the residuals, from those of what is missing."""

    def of(law: _Law, both: Array, lacks: Missing, slopes: Missing) -> Array:
        push = jax.linearize(partial(_rows, setting.grid, nodes, law), both, lacks)[1]
        units = jnp.eye(both.size, dtype=both.dtype).reshape(*both.shape, *both.shape)
        return jax.vmap(jax.vmap(push, -1, -1), -2, -2)(units, slopes)

    return jax.vmap(of)(law, _at_ends(nodes), lacks, slopes)


def _rows(grid: Grid, nodes: Node, law: _Law, both: Array, lacks: Missing) -> Array:
    """The residuals of an element."""
    start, end, limit = *map(partial(_node, nodes), both), lacks.limit
    if grid.sections.drag is not None or grid.outside is not None:  # it takes no more than the tension
        left = jnp.maximum(start.tension, 0.0)
        limit = jnp.where((law.share > 0) & (limit > left), left, limit)
    coulomb = start.tension - end.tension - limit * (law.level + law.slope * (end.slip - law.slip))
    parts = lacks.slip / grid.scale, coulomb / (1.0 + law.slope * grid.scale), lacks.heading, lacks.moment
    return jnp.concatenate([jnp.ravel(part) for part in parts if part is not None])


def _driven_gap(setting: Setting, nodes: Node) -> Float[Array, " driven"]:
    """The readings less the given ones, m; of a displacement, if that is less, the tension of a slack tendon.

    Where its base tension sets a driven tendon, the tension less the given one.
    """
    grid, given, found = setting.grid, setting.given, [jnp.zeros(0, nodes.tension.dtype)]
    for goal in setting.driven:
        tendon, tension = goal.tendon, nodes.tension[0, goal.tendon]
        missed = grid.as_length(goal) * (grid.reading(nodes, goal) - given.goal[tendon])
        missed = jnp.minimum(missed, grid.softness * tension) if goal.quantity == "displacement" else missed
        by_tension = grid.softness * (tension - given.base_tension[tendon])
        found.append(jnp.where(given.by_goal[tendon] > 0, missed, by_tension)[None])
    return jnp.concatenate(found)


def tendons_of(driven: tuple[Goal, ...]) -> Int[Array, " driven"]:
    """Their indices."""
    return jnp.asarray([goal.tendon for goal in driven], int)


def _correction(setting: Setting, nodes: Node, by_nodes: ByNodes, missed: Rows) -> Node:
    """The change of all unknowns that makes the residuals zero to first order; linear in the residuals."""
    factors = _eliminated(nodes, by_nodes)
    (change,) = _swept(nodes, factors, missed.elements[:, :, None], jnp.zeros((1, 1)))
    if not setting.driven:
        return change
    known = factors.by_known.shape[2]  # of an element: first the tensions
    pulls = jnp.eye(known, dtype=nodes.tension.dtype)[:, tendons_of(setting.driven)]
    by_tension = _swept(nodes, factors, jnp.zeros((*missed.elements.shape, len(setting.driven))), pulls)
    push = jax.linearize(partial(_driven_gap, setting), nodes)[1]
    tension = solve_small(jnp.stack([push(slope) for slope in by_tension], axis=1), -(missed.driven + push(change)))[0]
    return jax.tree.map(lambda x, *slopes: x + jnp.tensordot(tension, jnp.stack(slopes), 1), change, *by_tension)


class _Factors(NamedTuple):
    """The blocks of all elements, eliminated from base to tip; constant where derivatives are taken."""

    inverse: Float[Array, "K rows rows"]
    by_known: Float[Array, "K rows known"]
    by_sought_at_end: Float[Array, "K rows sought"]  # of all unknowns of an element


def _eliminated(nodes: Node, by_nodes: ByNodes) -> _Factors:
    """Block elimination: what is known at the end of each element is a linear function of what is sought there."""
    known = sum(x[0].size for x in (nodes.tension, nodes.heading) if x is not None)  # the first unknowns of a node
    sought = by_nodes.shape[-1] - known

    def outwards(by_sought: Array, both: Array) -> tuple[Array, _Factors]:
        (by_known, by_start), (by_known_end, by_end) = (jnp.split(both[:, end], [known], axis=1) for end in range(2))
        inverse = jnp.linalg.inv(jnp.concatenate([by_known_end, by_start + by_known @ by_sought], axis=1))
        of_end = -inverse @ by_end
        return of_end[:known], _Factors(inverse, by_known, of_end)

    return jax.lax.scan(outwards, zero_as(by_nodes) + jnp.zeros((known, sought)), by_nodes)[1]


def _swept(nodes: Node, factors: _Factors, missed: Float[Array, "K rows columns"], start: Array) -> list[Node]:
    """The changes that make the residuals zero, one for each column; `start` are those of what is known at the base.

    From base to tip, what is known at the end of each element; from tip to base, all numbers. Linear in the residuals.
    """
    known, count = factors.by_known.shape[2], start.shape[1]
    zero = zero_as((factors, missed))

    def outwards(at_start: Array, element: tuple[_Factors, Array]) -> tuple[Array, Array]:
        factors, lacks = element
        values = -factors.inverse @ (lacks + factors.by_known @ at_start)
        return values[:known], values

    start = zero + jnp.broadcast_to(start, (known, count))
    values = jax.lax.scan(outwards, start, (factors, missed))[1]

    def back(at_end: Array, element: tuple[Array, Array]) -> tuple[Array, Array]:
        here = element[0] @ at_end + element[1]
        return here[known:], here

    last = zero + jnp.zeros((factors.by_sought_at_end.shape[2], count))
    here = jax.lax.scan(back, last, (factors.by_sought_at_end, values), reverse=True)[1]
    all_known = jnp.concatenate([start[None], here[:, :known]])
    all_sought = jnp.concatenate([here[:, known:], last[None]])
    all_unknowns = jnp.concatenate([all_known, all_sought], axis=1)
    return [jax.vmap(partial(_node, nodes))(all_unknowns[..., column]) for column in range(count)]
