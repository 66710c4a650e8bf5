"""Pull and release of several tendons in space, along reference paths: `python benchmarks/space_history.py`.

`trace` does not know such bodies yet. This is the method that it is to have. The reference values are those of an
independent code (`space_history.json`), each with an estimate of its error.

The body lies on a grid of nodes. Tensions and strains belong to the nodes, slips to the elements between them. With
the weights of the trapezoidal rule the jump of a tension across an element and the slip there are work-conjugate. A
joint is an element without length; one more follows the tip. Each tendon obeys Coulomb's law in every element: the jump
of its tension is a share z of the limit of friction, between -1 and 1, which changes only while the tendon slips, and
reaches the ends where it slides. The law is softened by a very small elastic slip e: z = x / sqrt(1 + x^2), where x
grows by dw / e with the slip dw. Newton's method treats z as an unknown of its own (primal-dual), so that it hardly
overshoots. Where it does not settle at once with the small e, as at a turn, it goes from a large e to the small one
(continuation).

In space it settled on all random paths that were tried. In the plane, where several tendons act on one curvature, up
to one path of twelve steps in ten did not.
"""

import json
import time
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from table import report

import cddf_jax as cddf
from cddf_jax.mechanics import space
from cddf_jax.mechanics.friction import PerTendon
from cddf_jax.mechanics.geometry import SPACE, Space
from cddf_jax.mechanics.problem import guarded_section, load_rate
from cddf_jax.numerics.arrays import all_finite, largest_size, varying_as, zero_as
from cddf_jax.numerics.elements import smooth_pieces
from cddf_jax.numerics.fixed_point import slope_along, solve_small
from cddf_jax.numerics.rotations import as_matrix, of_turn, product
from cddf_jax.robot.cross_section import AnySection, spatial, where_present
from cddf_jax.robot.loads import Loads, force_at_points
from cddf_jax.robot.manipulator import Manipulator

PATHS = Path(__file__).parent / "space_history.json"
ELEMENTS, INCREMENTS = 64, 16
PerElement = Float[Array, "K tendons"]
LEAST_TURN = 1e-11  # rad: below it the turn of a tendon counts as this, so that the limit of friction is smooth
ELASTIC = 3e-12  # m, by which a tendon moves in an element before it slides
REMEMBERED = 1000.0  # elastic slips, with which a tendon that slid begins an increment: z is 1 less 5e-7
SLIDING = 1e-13  # of 1 - z^2: what rounding leaves of it where a tendon slides
SETTLED, ROUNDED = 1e-10, 1e-8  # relative change in a round that has settled; the same after PATIENCE rounds
PATIENCE = 20  # rounds, after which steps are damped
# elastic slip at first, m; factor on it after a round whose change was smaller than the next number; most rounds
ATTEMPTS = (
    (ELASTIC, 1.0, 0.0, 10.0),
    (1e-3, 0.1, 1.0, 60.0),
    (1e-3, 0.3, 1e-2, 120.0),
    (1e-2, 0.3, 1e-3, 200.0),
    (1e-2, 0.5, 1e-4, 320.0),
)
Number = Float[Array, ""]
STIFFEST = 1e-7  # the least strain of a tendon per tension, over d^2 / (E J), its slip per tension by bending


class Node(NamedTuple):
    """The unknowns at a node. Those of all nodes have a leading axis K + 1; the last node is beyond the tip."""

    tension: PerTendon  # T, N
    heading: Array | None  # phi, rad, or a quaternion; None without loads, where nothing depends on it
    slip: PerTendon  # w, m, of the element before: how far the tendon has moved through the body towards the base
    moment: Array | None  # M_ext, N m; None without loads


class Given(NamedTuple):
    """What acts on the body at one instant."""

    base_tension: PerTendon  # N; not used for a tendon that is driven by its displacement
    displacement: PerTendon  # m, pulled in at the base; used for such a tendon only
    force: Float[Array, "K components"] | None  # N of the loads beyond the middle of each element, N; None without
    tip_moment: Array | None  # N m


class Grid(eqx.Module):
    """The K nodes of a body, and the elements behind them, the last of which has no length."""

    manipulator: Manipulator
    places: Float[Array, " K"]  # s, m
    sections: AnySection  # leading axis K
    weights: Float[Array, " K"]  # of the trapezoidal rule, m
    widths: Float[Array, " K"]  # of the element after each node, m
    stretch: PerTendon  # strain of each tendon per tension, 1/N
    free_stretch: PerTendon  # elongation per tension of the tendon outside the body, m/N

    @property
    def geometry(self) -> Space:
        return SPACE

    @property
    def scale(self) -> Number:
        """The length to which slips are compared: the largest offset, m."""
        return jnp.max(jnp.abs(self.sections.offset))

    @property
    def softness(self) -> Number:
        """The length per tension, m/N, by which tensions are compared with displacements."""
        return self.places[-1] * self.scale**2 / self.geometry.bending_stiffness(self.sections)[0]

    def pulled_in(self, nodes: Node) -> PerTendon:
        """The displacement of each tendon at its actuator, m."""
        return nodes.slip[0] + self.free_stretch * nodes.tension[0]

    def at(self, node: Node, section: AnySection, force: Array | None) -> tuple[Array, PerTendon]:
        """The strain of a cross-section in equilibrium, and the slip per arc length of its tendons."""
        geometry, tension = self.geometry, where_present(section, node.tension)
        moment = jnp.asarray(geometry.no_moment, tension.dtype) if node.moment is None else node.moment
        strain = geometry.strain(section, tension, node.heading, moment, force, None)
        return strain, geometry.slip_rate(section, strain, tension, self.stretch)

    def at_all(self, nodes: Node, force: Array | None) -> tuple[Array, Array]:
        """As `at`, for all K nodes."""
        return jax.vmap(self.at)(jax.tree.map(lambda x: x[:-1], nodes), self.sections, force)

    def elements(self, force: Array | None) -> "Element":
        pairs = jax.tree.map(lambda x: jnp.stack([x, jnp.concatenate([x[1:], x[-1:]])], axis=1), self.sections)
        return Element(pairs, self.weights, self.widths, force)


def cut_into_elements(manipulator: Manipulator, count: int, merged: Number | float = 0.0) -> Grid:
    """`count` elements in each smooth piece of the body, and one between two pieces.

    Args:
        manipulator: the body.
        count: number of elements; static.
        merged: 1 to give every second element no length, so that the others are twice as long; else 0.
    """
    ends = smooth_pieces(jnp.asarray(manipulator.length), manipulator.breakpoints)
    numbers = jnp.arange(count + 1)
    fractions = (numbers - merged * (numbers % 2)) / count
    starts, lengths = ends[:-1, None], jnp.diff(ends)[:, None]
    places = starts + lengths * fractions
    inside = starts + lengths * jnp.clip(fractions, 1e-9, 1 - 1e-9)  # a joint has a cross-section on either side
    widths = jnp.diff(places, axis=1)
    none = jnp.zeros_like(starts)
    behind, ahead = jnp.concatenate([none, widths], axis=1), jnp.concatenate([widths, none], axis=1)
    sections = jax.vmap(partial(guarded_section, manipulator))(inside.ravel())
    compliance = manipulator.tendon_compliance
    grid = Grid(
        manipulator,
        places.ravel(),
        sections,
        ((behind + ahead) / 2).ravel(),
        ahead.ravel(),
        compliance,
        compliance * manipulator.tendon_free_length,
    )
    # where tendons that do not stretch rest together, their tensions are those of equal, very stiff tendons
    stiffest = STIFFEST * grid.softness / grid.places[-1]
    return eqx.tree_at(lambda grid: grid.stretch, grid, jnp.maximum(compliance, stiffest))


def forces_on(grid: Grid, loads: Loads) -> Float[Array, "K components"]:
    """The force N of the dead loads beyond the middle of each element, N."""
    body, places = grid.manipulator, grid.places
    rate, tip = load_rate(body, places, loads), jnp.asarray(loads.tip_force)
    gains = grid.widths[:, None] * (rate + jnp.concatenate([rate[1:], rate[-1:]])) / 2
    force = tip + jnp.cumsum(gains[::-1], axis=0)[::-1] - gains / 2
    if not body.point_masses:
        return force
    weight = force_at_points(loads, jnp.stack([jnp.asarray(point.mass) for point in body.point_masses]))
    points = jnp.stack([jnp.asarray(point.arc_length, places.dtype) for point in body.point_masses])
    return force + jnp.where((places + grid.widths / 2)[:, None] < points, 1.0, 0.0) @ weight


class Element(NamedTuple):
    """The known numbers of an element."""

    sections: AnySection  # at its ends; leading axis 2
    weight: Number  # of the node before it, m
    width: Number  # m
    force: Array | None  # of the loads beyond its middle, N


class Missing(NamedTuple):
    """What is missing in the equations of an element, and the numbers that its friction depends on."""

    slip: PerTendon  # m
    heading: Array | None
    moment: Array | None  # N m
    drop: PerTendon  # D = T_k - T_k+1, N
    limit: PerTendon  # C, the largest |D|, N


class Along(NamedTuple):
    """Values along an element."""

    strain: Array  # its mean
    slip_rate: PerTendon  # at its start
    turn: PerTendon  # by which the tendons turn, rad
    step: Array | None  # the change of the position along it, m; None without loads


def turned(width: Number, sections: AnySection, strains: Array) -> PerTendon:
    """The angle by which tendons turn along an element, rad, from values at both its ends."""
    tangents = jax.vmap(space.tangents)(spatial(sections), strains)
    mean, change = jnp.mean(tangents, axis=0), tangents[1] - tangents[0]
    turn = space.turn_vectors(width * jnp.mean(strains, axis=0), mean, change)
    return jnp.sqrt(jnp.sum(turn**2, axis=-1) + LEAST_TURN**2)


def turned_on(heading: Array, turn: Array) -> Array:
    """The heading beyond an element, from that before it and the strain times its length."""
    return product(heading, of_turn(space.curvature_of_strain(turn)))


def along(grid: Grid, element: Element, start: Node, end: Node) -> Along:
    both = jax.tree.map(lambda a, b: jnp.stack([a, b]), start, end)
    strains, slips = jax.vmap(grid.at, (0, 0, None))(both, element.sections, element.force)
    mean, turn = jnp.mean(strains, axis=0), turned(element.width, element.sections, strains)
    step = None
    if start.heading is not None:
        middle = turned_on(start.heading, element.width / 2 * mean)
        step = element.width * grid.geometry.axis(middle, mean)
    return Along(mean, slips[0], turn, step)


def missing(grid: Grid, element: Element, start: Node, end: Node) -> Missing:
    """The residuals of an element: of the sum of the slips, of heading and moment.

    The limit of friction is that at which T falls by the factor exp(mu turn), Liu et al. (2020) eq. (8), and by the
    drag.
    """
    there, geometry = along(grid, element, start, end), grid.geometry
    before, beyond = jax.tree.map(lambda x: x[0], element.sections), jax.tree.map(lambda x: x[1], element.sections)
    limit = jnp.tanh(before.friction_coefficient * there.turn / 2) * (start.tension + end.tension)
    if before.drag is not None:
        limit = limit + element.width * before.drag
    limit = where_present(before, where_present(beyond, limit))
    heading = moment = None
    if start.heading is not None and end.heading is not None:
        heading = end.heading - turned_on(start.heading, element.width * there.strain)
    if start.moment is not None and end.moment is not None and there.step is not None and element.force is not None:
        moment = end.moment - start.moment - geometry.moment_rate(there.step, element.force)
    slip = start.slip - end.slip - element.weight * there.slip_rate
    return Missing(slip, heading, moment, start.tension - end.tension, limit)


class Body(NamedTuple):
    """The body after an increment."""

    nodes: Node  # leading axis K + 1; the last one is beyond the tip
    share: PerElement  # z of each element
    converged: Bool[Array, ""]


class Setting(eqx.Module):
    """What is solved: the body, what acts on it, and the body before."""

    grid: Grid
    given: Given
    before: Body
    driven: tuple[int, ...] = eqx.field(static=True)  # the tendons whose displacement is given


class _Law(NamedTuple):
    """Coulomb's law, linear in the slip: z = level + slope (w - slip)."""

    level: PerElement
    slope: PerElement  # 1/m
    slip: PerElement  # m


class _Search(NamedTuple):
    nodes: Node
    strain: PerElement  # x
    share: PerElement  # z, an unknown of its own
    elastic: Number  # e, m
    rounds: Number  # in this attempt
    change: Number  # in the last round
    attempt: Number
    done: Bool[Array, ""]


def after_increment(setting: Setting) -> Body:
    """The body after a small change of the tensions or displacements at its base, and of the loads.

    Derivatives are those of the equations.
    """
    return Body(*_after_increment(setting))


@eqx.filter_custom_jvp
def _after_increment(setting: Setting) -> tuple[Node, PerElement, Bool[Array, ""]]:
    zero, before = zero_as(setting), setting.before
    start, share = varying_as((_with_ends(setting, before.nodes), before.share), zero)
    sliding_on = _strain_of(share)  # where tendons slide, they are expected to slide on
    first = _Search(start, sliding_on, share, zero + ELASTIC, zero, zero + jnp.inf, zero, zero > 0)

    def unfinished(state: _Search) -> Bool[Array, ""]:
        return ~state.done & (state.attempt < len(ATTEMPTS))

    end = jax.lax.while_loop(unfinished, partial(_round, setting, start), first)
    return end.nodes, _share(setting, end.nodes), end.done & before.converged


def _round(setting: Setting, start: Node, state: _Search) -> _Search:
    """One Newton step; then a smaller elastic slip, or another attempt."""
    law = _law(setting, state)
    change = _correction(setting, state.nodes, law, _rows_of_all(setting, state.nodes, law))
    halved = (state.rounds > PATIENCE) & (state.rounds % 3 == 0)  # where steps go round in a circle
    part = jnp.where(halved, 0.5, 1.0)
    nodes = jax.tree.map(lambda x, dx: x + part * dx, state.nodes, change)
    share = jnp.clip(law.level + part * law.slope * change.slip[1:], -1.0, 1.0)
    size, last = _size(setting.grid, nodes, change), state.elastic <= ELASTIC
    first, shrink, rough, most = (jnp.asarray(x)[state.attempt.astype(int)] for x in zip(*ATTEMPTS, strict=True))
    elastic = jnp.maximum(jnp.where(size < rough, shrink, 1.0) * state.elastic, ELASTIC)
    done = last & ~halved & (size < jnp.where(state.rounds > PATIENCE, ROUNDED, SETTLED))
    onward = _Search(
        nodes, _strain(setting, nodes, elastic), share, elastic, state.rounds + 1, size, state.attempt, done
    )
    attempt = state.attempt + 1
    first = jnp.asarray([elastic for elastic, *_ in ATTEMPTS] + [1.0])[attempt.astype(int)]
    again = _Search(
        start,
        _strain(setting, start, first),
        setting.before.share,
        first + 0.0 * elastic,
        0.0 * state.rounds,
        jnp.inf + 0.0 * size,
        attempt,
        done & False,
    )
    stuck = ~done & (~all_finite(size) | (state.rounds >= most))
    return jax.tree.map(lambda a, b: jnp.where(stuck, a, b), again, onward)


@_after_increment.def_jvp
def _(primals, tangents):
    (setting,), (direction,) = primals, tangents
    nodes, share, _ = found = _after_increment(setting)
    none = jnp.zeros_like(nodes.tension[0, 0])

    def law_of(setting: Setting) -> _Law:
        strain = _strain(setting, nodes, ELASTIC)
        return _law(setting, _Search(nodes, strain, share, none + ELASTIC, none, none, none, none > 0))

    def rows(setting: Setting):
        there = _with_ends(setting, nodes)
        return _rows_of_all(setting, there, law_of(setting)), there

    pushed, moved = slope_along(rows, setting, direction)
    change = jax.tree.map(jnp.add, moved, _correction(setting, nodes, law_of(setting), pushed))
    shares = slope_along(lambda both: _share(*both), (setting, nodes), (direction, change))
    return found, (change, shares, None)


def _strain_of(share: PerElement) -> PerElement:
    """x, of z."""
    return share / jnp.sqrt(jnp.maximum(1.0 - share**2, SLIDING))


def _strain(setting: Setting, nodes: Node, elastic: Number | float) -> PerElement:
    """X. What a tendon has slid before, it need not slide back: its x starts from a bound."""
    before = setting.before
    start = jnp.clip(_strain_of(before.share), -REMEMBERED, REMEMBERED)
    return start + (nodes.slip[1:] - before.nodes.slip[1:]) / elastic  # the slip of an element is that before its end


def _law(setting: Setting, state: _Search) -> _Law:
    size = jnp.sqrt(1.0 + state.strain**2)
    level = state.strain / size
    return _Law(level, (1.0 - state.share * level) / (size * state.elastic), state.nodes.slip[1:])


def _share(setting: Setting, nodes: Node) -> PerElement:
    """z; a tendon without tension forgets it."""
    strain = _strain(setting, nodes, ELASTIC)
    return jnp.where(nodes.tension[:-1] > 0, strain / jnp.sqrt(1.0 + strain**2), 0.0)


def _with_ends(setting: Setting, nodes: Node) -> Node:
    """The nodes with the given tensions at the base and the given moment at the tip."""
    given, driven = setting.given, jnp.asarray(setting.driven, int)
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
    """The residuals of all elements, and of the displacements."""

    elements: Float[Array, "K rows"]
    driven: Float[Array, " driven"]  # m; of a slack tendon its tension, as a length


def _rows_of_all(setting: Setting, nodes: Node, law: _Law) -> Rows:
    elements = setting.grid.elements(setting.given.force)
    rows = jax.vmap(partial(_rows, setting.grid))(elements, law, *_ends_of_elements(nodes))
    return Rows(rows, _driven_gap(setting, nodes))


def _ends_of_elements(nodes: Node) -> tuple[Node, Node]:
    return jax.tree.map(lambda x: x[:-1], nodes), jax.tree.map(lambda x: x[1:], nodes)


def _rows(grid: Grid, element: Element, law: _Law, start: Node, end: Node) -> Array:
    """The residuals of an element."""
    lacks = missing(grid, element, start, end)
    limit = lacks.limit
    if grid.sections.drag is not None:  # it takes no more than the tension
        left = jnp.maximum(start.tension, 0.0)
        limit = jnp.where((law.level > 0) & (limit > left), left, limit)
    coulomb = lacks.drop - limit * (law.level + law.slope * (end.slip - law.slip))
    parts = lacks.slip / grid.scale, coulomb / (1.0 + law.slope * grid.scale), lacks.heading, lacks.moment
    return jnp.concatenate([jnp.ravel(part) for part in parts if part is not None])


def _driven_gap(setting: Setting, nodes: Node) -> Float[Array, " driven"]:
    """The displacement less the given one, m; or, if that is less, the tension of a slack tendon as a length."""
    missed = setting.grid.pulled_in(nodes) - setting.given.displacement
    return jnp.minimum(missed, setting.grid.softness * nodes.tension[0])[jnp.asarray(setting.driven, int)]


def _flat(node: Node) -> tuple[Array, Array]:
    """What the march from the base knows, and what it seeks."""

    def flat(*parts: Array | None) -> Array:
        return jnp.concatenate([jnp.ravel(part) for part in parts if part is not None])

    return flat(node.tension, node.heading), flat(node.slip, node.moment)


def _node(like: Node, known: Array, sought: Array) -> Node:
    """The inverse of `_flat`; `like` has the shapes of all nodes."""
    count = like.tension.shape[-1]
    heading = None if like.heading is None else known[count:].reshape(like.heading.shape[1:])
    moment = None if like.moment is None else sought[count:].reshape(like.moment.shape[1:])
    return Node(known[:count], heading, sought[:count], moment)


def _correction(setting: Setting, nodes: Node, law: _Law, missed: Rows) -> Node:
    """The change of all unknowns that makes the residuals zero to first order; linear in the residuals."""

    def rows(element: Element, law: _Law, known: Array, sought: Array, known_end: Array, sought_end: Array) -> Array:
        return _rows(setting.grid, element, law, _node(nodes, known, sought), _node(nodes, known_end, sought_end))

    starts, ends = map(jax.vmap(_flat), _ends_of_elements(nodes))
    elements = setting.grid.elements(setting.given.force)
    slopes = jax.vmap(jax.jacfwd(rows, (2, 3, 4, 5)))(elements, law, *starts, *ends)
    change, by_tension = _swept(nodes, slopes, missed.elements, setting.driven)
    if not setting.driven:
        return change
    push = jax.linearize(partial(_driven_gap, setting), nodes)[1]
    tension = solve_small(jax.vmap(push)(by_tension).T, -(missed.driven + push(change)))[0]
    return jax.tree.map(lambda x, slope: x + jnp.tensordot(tension, slope, 1), change, by_tension)


def _swept(nodes: Node, slopes: tuple, missed: Array, driven: tuple[int, ...]) -> tuple[Node, Node]:
    """The change that makes the residuals zero, and the change by one newton at the base of each driven tendon.

    Block elimination: from base to tip, what is known at the end of each element is found as a linear function of what
    is sought there. From tip to base, all numbers follow.
    """
    count, sought = slopes[0].shape[2], slopes[1].shape[2]
    zero = zero_as(slopes)
    pulls = jnp.eye(count, dtype=missed.dtype)[:, jnp.asarray(driven, int)] + zero

    def outwards(carry: tuple[Array, Array], inputs: tuple) -> tuple[tuple, tuple]:
        by_sought, known = carry  # at the start of this element: known = by_sought @ sought + known
        (by_known, by_start, by_known_end, by_end), lacks = inputs
        here = jnp.concatenate([by_known_end, by_start + by_known @ by_sought], axis=1)
        first = jnp.zeros((lacks.size, known.shape[1]), lacks.dtype).at[:, 0].set(lacks)
        factors = jax.scipy.linalg.lu_factor(here)
        of_end = jax.scipy.linalg.lu_solve(factors, -by_end)  # apart: it is constant, and values are linear in `missed`
        values = jax.scipy.linalg.lu_solve(factors, -(first + by_known @ known))
        return (of_end[:count], values[:count]), (of_end, values)

    first = (
        zero + jnp.zeros((count, sought)),
        jnp.concatenate([0.0 * pulls[:, :1] if driven else zero + jnp.zeros((count, 1)), pulls], axis=1),
    )
    found = jax.lax.scan(outwards, first, (slopes, missed))[1]

    def back(at_end: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        here = found[0] @ at_end + found[1]
        return here[count:], here

    last = zero + jnp.zeros((sought, 1 + len(driven)))
    here = jax.lax.scan(back, last, found, reverse=True)[1]
    all_known = jnp.concatenate([first[1][None], here[:, :count]])
    all_sought = jnp.concatenate([here[:, count:], last[None]])
    changes = jax.vmap(jax.vmap(partial(_node, nodes)), (2, 2))(all_known, all_sought)
    return jax.tree.map(lambda x: x[0], changes), jax.tree.map(lambda x: x[1:], changes)


# --- the reference paths --------------------------------------------------------------------------


def body_of(inputs: dict[str, Any]) -> Manipulator:
    """The manipulator of a path."""

    def line(ends: list[float]) -> Any:
        base, tip = ends
        return cddf.Linear(base, tip, inputs["length"]) if base != tip else cddf.Constant(base)

    tendons = [
        cddf.Tendon(line(t["offset"]), angle=line(t["angle"]), friction_coefficient=t["mu"], axial_stiffness=t["EA"])
        for t in inputs["tendons"]
    ]
    sizes = {"outer_radius": line(inputs["outer"]), "inner_radius": line(inputs["inner"])}
    return cddf.Manipulator(
        length=inputs["length"], youngs_modulus=inputs["E"], friction_coefficient=0.0, tendons=tendons, **sizes
    )


def at_rest(grid: Grid, loaded: bool) -> Body:
    """The straight body without tension."""
    count, tendons = grid.places.size, grid.stretch.size
    still, line = jnp.zeros((count + 1, tendons)), jnp.zeros((count + 1, 3))
    heading = jnp.zeros((count + 1, 4)) + jnp.asarray(SPACE.upright)
    nodes = Node(still, heading if loaded else None, still, line if loaded else None)
    return Body(nodes, still[1:], jnp.asarray(True))


def pose(grid: Grid, body: Body, force: Array | None) -> tuple[Array, Array]:
    """Position and rotation of the tip."""
    strain = grid.at_all(body.nodes, force)[0]
    mean = (strain + jnp.concatenate([strain[1:], strain[-1:]])) / 2

    def onwards(heading: Array, part: tuple[Array, Array]) -> tuple[Array, Array]:
        turn = part[0] * part[1]
        return turned_on(heading, turn), part[0] * SPACE.axis(turned_on(heading, turn / 2), part[1])

    heading, steps = jax.lax.scan(onwards, jnp.asarray(SPACE.upright), (grid.widths, mean))
    return jnp.sum(steps, axis=0), as_matrix(heading)


def rows(name: str, path: dict[str, Any]) -> list[str]:
    """Differences from the reference after each point of a path."""
    points, grid = path["points"], cut_into_elements(body_of(path["inputs"]), ELEMENTS)
    loaded = any(np.any(point["tip_force_N"]) for point in points)
    kinds = [[entry["kind"] == "displacement_m" for entry in point["base"]] for point in points]
    driven = tuple(np.flatnonzero(kinds[0]).tolist())

    def given_at(tension: Array, displacement: Array, force: Array) -> Given:
        if not loaded:
            return Given(tension, displacement, None, None)
        loads = Loads(tip_force=force, tip_moment=jnp.zeros(3), gravity=jnp.zeros(3))
        return Given(tension, displacement, forces_on(grid, loads), jnp.zeros(3))

    @jax.jit
    def step(body: Body, start: tuple, end: tuple) -> tuple[Body, tuple[Array, Array]]:
        def part(body: Body, fraction: Array) -> tuple[Body, None]:
            here = given_at(*[a + fraction * (b - a) for a, b in zip(start, end, strict=True)])
            return after_increment(Setting(grid, here, body, driven)), None

        body = jax.lax.scan(part, body, jnp.arange(1.0, INCREMENTS + 1) / INCREMENTS)[0]
        return body, pose(grid, body, given_at(*end).force)

    body, lines = at_rest(grid, loaded), []
    start = jnp.zeros(len(kinds[0])), jnp.zeros(len(kinds[0])), jnp.zeros(3)
    step(body, start, start)[0].share.block_until_ready()
    for number, (point, by_length) in enumerate(zip(points, kinds, strict=True), 1):
        values = np.array([entry["value"] for entry in point["base"]])
        end = tuple(
            map(jnp.asarray, (np.where(by_length, 0, values), np.where(by_length, values, 0), point["tip_force_N"]))
        )
        began = time.perf_counter()
        body, (position, rotation) = jax.block_until_ready(step(body, start, end))
        took, start = time.perf_counter() - began, end
        tension = np.max(np.abs(body.nodes.tension[-1] - np.array(point["tip_tension_N"])))
        away = np.max(np.abs(position - np.array(point["tip_position_m"]))) / path["inputs"]["length"]
        turned_by = np.max(np.abs(rotation - np.array(point["tip_rotation"])))
        told = "not determined" if point["tip_tension_undetermined_common_mode"] else f"{tension:.1e}"
        settled = "yes" if body.converged else "no"
        lines.append(f"| {name} | {number} | {settled} | {told} | {away:.1e} | {turned_by:.1e} | {1e3 * took:.0f} |")
    return lines


def main() -> None:
    """Follow all paths."""
    paths = {name: path for name, path in json.loads(PATHS.read_text()).items() if name != "conventions"}
    head = [
        "path",
        "point",
        "settled",
        "tip tension, N",
        "tip position over length",
        "rotation",
        "ms for 16 increments",
    ]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for name, path in paths.items():
        lines += rows(name.replace("_", " "), path)
    report("space_history", "\n".join(lines) + "\n", {"rows": lines[2:]})


if __name__ == "__main__":
    with jax.enable_x64(True):
        main()
