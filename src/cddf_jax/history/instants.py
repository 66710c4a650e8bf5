"""A body at one instant of a path that is followed in increments: the start, the next instant, and results."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..mechanics.fields import AnyFields, fields_at
from ..mechanics.friction import PerTendon, Pull
from ..mechanics.problem import State
from ..numerics.arrays import largest_size
from ..robot.cross_section import where_present
from ..statics.equilibrium import nan_unless
from .grid import Along, Given, Goal, Grid, Node, Number, along
from .history import stored_per_length
from .increment import OnGrid, Setting, after_increment

AT_LIMIT = 1e-3  # a tendon counts as sliding where |z| is above 1 less this


class Instant(NamedTuple):
    """A body at one instant, with work and loss up to it."""

    given: Given
    body: OnGrid
    slid: Float[Array, "K tendons"]  # slip towards the base in the last increment, m
    work: Number  # of actuators and loads since the straight body, J
    friction_loss: Number  # J


def at_rest(grid: Grid) -> Instant:
    """The body before the first step, without tensions and loads."""
    none = jnp.zeros((grid.places.size + 1, grid.stretch.size), grid.places.dtype)
    nodes = Node(none, None, none, None)
    strain, rate = grid.at_all(nodes, None, None)
    slip = jnp.cumsum((grid.weights[:, None] * rate)[::-1], axis=0)[::-1]
    nodes = nodes._replace(slip=jnp.concatenate([slip, none[:1]]))
    held = None if grid.manipulator.friction_moment is None else strain
    given = Given(none[0], none[0], none[0], None, None, None)
    body = OnGrid(nodes, none[1:], jnp.asarray(True), held, none[0, 0])
    instant = Instant(given, body, none[1:], none[0, 0], none[0, 0])
    return instant._replace(work=stored_in(grid, instant))


def without_friction(grid: Grid, instant: Instant) -> Instant:
    """The same instant, with friction of the body that holds nothing, and as work only what is stored."""
    nodes, held = instant.body.nodes, instant.body.held
    if grid.manipulator.friction_moment is not None:
        held = grid.at_all(nodes, instant.given.force, None)[0]
    instant = instant._replace(body=instant.body._replace(held=held), slid=0.0 * instant.slid)
    return instant._replace(work=stored_in(grid, instant), friction_loss=0.0 * instant.friction_loss)


def moved(grid: Grid, driven: tuple[Goal, ...], before: Instant, given: Given) -> Instant:
    """The body one increment later."""
    body = after_increment(Setting(grid, given, before.body, driven))
    old, new = before.body.nodes, body.nodes

    def mean(a: Array, b: Array) -> Array:
        return (a + b) / 2

    pulled_in = grid.pulled_in(new) - grid.pulled_in(old)
    slid = new.slip[1:] - old.slip[1:]
    lost = jnp.sum(mean(-jnp.diff(old.tension, axis=0), -jnp.diff(new.tension, axis=0)) * slid)
    if body.held is not None and before.body.held is not None:
        held = mean(
            grid.moment_of_friction(old, before.given.force, before.body.held),
            grid.moment_of_friction(new, given.force, body.held),
        )
        per_length = (held * (body.held - before.body.held)).reshape(grid.weights.size, -1)
        lost = lost + jnp.sum(grid.weights[:, None] * per_length)
    by_loads = jnp.zeros_like(lost)
    if given.force is not None:
        found = _along(grid, given, body).step, _along(grid, before.given, before.body).step
        steps = jax.tree.map(jnp.subtract, *found)
        assert old.heading is not None
        assert new.heading is not None
        turn = jax.vmap(grid.geometry.turn_from)(old.heading, new.heading)
        force, moment, at_tip = jax.tree.map(mean, before.given[3:], given[3:])
        by_loads = jnp.sum(force * steps) + jnp.sum(moment * turn[:-1]) + jnp.sum(at_tip * turn[-1])
    pull = mean(old.tension[0], new.tension[0])
    return Instant(
        given,
        body,
        slid,
        work=before.work + jnp.sum(pull * pulled_in) + by_loads,
        friction_loss=before.friction_loss + lost,
    )


def _along(grid: Grid, given: Given, body: OnGrid) -> Along:
    starts, ends = jax.tree.map(lambda x: x[:-1], body.nodes), jax.tree.map(lambda x: x[1:], body.nodes)
    return jax.vmap(partial(along, grid))(grid.elements(given, body.held), starts, ends)


# --- results at an instant -----------------------------------------------------------------------


class Shape(NamedTuple):
    """The shape of a body at its K nodes."""

    heading: Array
    position: Float[Array, "K components"]  # m
    wrap_angle: Float[Array, "K tendons"]  # theta, rad


def shape_of(grid: Grid, instant: Instant) -> Shape:
    """Heading, position and wrap angle."""
    nodes, geometry = instant.body.nodes, grid.geometry
    found = _along(grid, instant.given, instant.body)

    def onwards(heading: Array, part: tuple[Number, Array]) -> tuple[Array, tuple[Array, Array]]:
        width, strain = part
        middle = geometry.turned_on(heading, width / 2 * strain)
        return geometry.turned_on(heading, width * strain), (heading, width * geometry.axis(middle, strain))

    upright = jnp.asarray(geometry.upright, nodes.tension.dtype) + 0.0 * nodes.tension[0, 0]
    heading, steps = jax.lax.scan(onwards, upright, (grid.widths, found.strain))[1]

    def summed(gains: Array) -> Array:
        return jnp.cumsum(gains, axis=0) - gains

    return Shape(heading, summed(steps), summed(where_present(grid.sections, found.turn)))


def under_no_loads(grid: Grid, instant: Instant) -> Instant:
    """The same instant of a body without loads, with headings and with loads that are zero."""
    nodes, geometry = instant.body.nodes, grid.geometry
    heading = shape_of(grid, instant).heading
    zero = 0.0 * nodes.tension[0, 0]
    still = jnp.zeros((len(heading) + 1, *geometry.no_moment.shape)) + zero
    force = jnp.zeros((len(heading), geometry.components)) + zero
    nodes = nodes._replace(heading=jnp.concatenate([heading, heading[-1:]]), moment=still)
    given = instant.given._replace(force=force, moment=still[1:], tip_moment=still[0])
    return instant._replace(given=given, body=instant.body._replace(nodes=nodes))


def stored_in(grid: Grid, instant: Instant) -> Number:
    """The energy of bending and of the stretch of the tendons, J."""
    nodes, geometry = instant.body.nodes, grid.geometry
    strain = grid.at_all(nodes, instant.given.force, instant.body.held)[0]
    tension = where_present(grid.sections, nodes.tension[:-1])
    per_length = jax.vmap(partial(stored_per_length, geometry), (0, 0, 0, None))
    density = per_length(grid.sections, strain, tension, grid.stretch)
    return jnp.sum(grid.weights * density) + jnp.sum(grid.free_stretch * nodes.tension[0] ** 2) / 2


def fields_of_instant(grid: Grid, instant: Instant, shape: Shape, arc_length: Number) -> AnyFields:
    """The fields at one arc length, tendons last; straight lines between the nodes."""
    places, nodes = grid.places, instant.body.nodes
    i = jnp.clip(jnp.sum(places <= arc_length) - 1, 0, places.size - 2)
    width = places[i + 1] - places[i]
    largest, moments = jnp.max(nodes.tension), _bending_moments(grid, instant, shape)

    def state(s: Number) -> State:
        part = (s - places[i]) / jnp.where(width > 0, width, 1.0)

        def at(values: Array) -> Array:
            return values[i] + part * (values[i + 1] - values[i])

        heading, tension = at(shape.heading), at(nodes.tension)
        if grid.geometry.has_frames:
            heading = heading / jnp.linalg.norm(heading)
        force = None if instant.given.force is None else instant.given.force[i]
        if force is None and (moments is not None or not grid.geometry.has_frames):
            force = jnp.zeros(grid.geometry.components, places.dtype)
        moment = jnp.asarray(grid.geometry.no_moment, places.dtype) if moments is None else at(moments)
        pull = Pull(jnp.ones_like(tension), largest - tension)
        return State(pull, heading, moment, force, None, at(shape.wrap_angle), at(shape.position))

    base = jnp.full_like(nodes.tension[0], largest)
    fields = fields_at(grid.manipulator, base, instant.body.share[i], arc_length, state)
    return nan_unless((arc_length >= 0) & (arc_length <= places[-1]), fields)


def _bending_moments(grid: Grid, instant: Instant, shape: Shape) -> Array | None:
    """M_ext at the K nodes less the moment that friction of the body holds, N m; None where both are zero."""
    nodes, held = instant.body.nodes, instant.body.held
    by_loads = None if nodes.moment is None else nodes.moment[:-1]
    if held is None:
        return by_loads
    own = grid.moment_of_friction(nodes, instant.given.force, held)
    return (0.0 if by_loads is None else by_loads) - grid.geometry.moment_in_fixed_frame(shape.heading, own)


class TipPose(NamedTuple):
    """Tensions and pose of the tip, of which the error is estimated."""

    tension: PerTendon
    position: Float[Array, " components"]
    heading: Array


def tip_of(grid: Grid, instant: Instant) -> TipPose:
    """The tip of a body."""
    shape = shape_of(grid, instant)
    return TipPose(instant.body.nodes.tension[-1], shape.position[-1], shape.heading[-1])


def difference(grid: Grid, tip: TipPose, other: TipPose) -> Number:
    """The largest difference of two passes: in tip tension (relative), position (per length) or angle (rad)."""
    parts = [
        largest_size(tip.tension - other.tension) / _tension_scale(grid, tip),
        largest_size(tip.position - other.position) / grid.places[-1],
        largest_size(grid.geometry.turn_from(tip.heading, other.heading)),
    ]
    return jnp.max(jnp.stack(parts))


def _tension_scale(grid: Grid, tip: TipPose) -> Number:
    """The scale of the tensions, N: the largest at the tip, and the largest loss by drag."""
    drag = grid.sections.drag
    dragged = 0.0 if drag is None else jnp.max(jnp.sum(grid.widths[:, None] * drag, axis=0))
    return jnp.maximum(jnp.max(tip.tension), 1e-3) + dragged


def crosses(grid: Grid, instant: Instant) -> Bool[Array, ""]:
    """Whether fibres cross on the inside of the bend."""
    strain = grid.at_all(instant.body.nodes, instant.given.force, instant.body.held)[0]
    inside = jax.vmap(grid.geometry.inside)(grid.sections, strain)
    return jnp.any(where_present(grid.sections, inside) >= 1.0)


def base_direction(share: Float[Array, "*steps K tendons"], slid: Array) -> Float[Array, "*steps tendons"]:
    """+1 for a tendon that slides in at the base, -1 for one that slides out."""
    without_tension = (share[..., 0, :] == 0) & (slid[..., 0, :] < 0)
    return jnp.where((share[..., 0, :] < 0) | without_tension, -1.0, 1.0)


def fronts_of(grid: Grid, share: Float[Array, "steps K tendons"], slid: Array) -> Float[Array, "steps tendons"]:
    """The arc length, m, up to which each tendon slides in one direction from the base."""
    along, widths = share * base_direction(share, slid)[:, None], grid.widths[:, None]
    moved_freely = (share == 0) & (slid != 0)  # without tension there is no friction
    passed = moved_freely | (widths == 0) | (where_present(grid.sections, jnp.ones_like(share[0])) == 0)
    whole = jnp.cumprod((along > 1 - AT_LIMIT) | passed, axis=1)
    first = jnp.sum(whole, axis=1, keepdims=True).astype(int)
    last = jnp.minimum(first, share.shape[1] - 1)
    part = jnp.clip((1 + jnp.take_along_axis(along, last, axis=1)[:, 0]) / 2, 0.0, 1.0) * grid.widths[last[:, 0]]
    reach = jnp.sum(whole * widths, axis=1)
    begun = jnp.any(slid != 0, axis=1)
    return jnp.where(
        begun, jnp.minimum(reach + jnp.where(first[:, 0] < share.shape[1], part, 0.0), grid.places[-1]), 0.0
    )
