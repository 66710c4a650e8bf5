"""A body at one instant of a path that is followed in short steps: the start, the next instant, and results."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..mechanics.bending import stretch_rate
from ..mechanics.fields import Fields, planar_fields
from ..mechanics.friction import PerTendon, Pull
from ..mechanics.geometry import axis_of
from ..mechanics.problem import State, guarded_section
from ..numerics.arrays import largest_size
from ..robot.cross_section import planar, where_present
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import nan_unless
from ..statics.solve import solve
from .cells import Along, Cells, Edge, integral
from .short_step import Ends, Setting, Step, after_step

Number = Float[Array, ""]
AT_LIMIT = 1e-3  # a tendon counts as sliding where |sigma| is above 1 less this


class Given(NamedTuple):
    """The given numbers at one instant."""

    ends: Ends
    outboard: Float[Array, "P 3 2"]  # force N, newtons, at the starts, middles and ends of the cells


class Instant(NamedTuple):
    """A body at one instant, with work and loss up to it."""

    given: Given
    step: Step
    along: Along  # the cells
    slid: Float[Array, "P tendons"]  # slip towards the base in the last short step, m, the mean over a cell
    work: Number  # of actuators and loads since the straight body, J
    friction_loss: Number  # J


def at_rest(manipulator: Manipulator, cells: Cells, given: Given, loads: Loads | None) -> Instant:
    """The body before the first step, whose tendons have no tension: straight, or bent by loads that stay.

    Args:
        manipulator: the body.
        cells: its cells.
        given: the given numbers at that instant.
        loads: that act on it before the first step, or None.
    """
    still = given.ends.base_tension
    slips = jnp.zeros((cells.edges.size, still.size), still.dtype)
    line = slips[:, 0]
    edges, good = Edge(slips, line, slips, line), jnp.asarray(True)
    if loads is not None:
        found = solve(manipulator, still, loads, direction=1.0, throw=False)
        state = jax.vmap(found._dense.state)(cells.edges)
        edges, good = Edge(slips, state.heading, slips, state.moment), found._dense.solved
    along = cells.along(given.outboard, edges, slips[1:])
    gains = jax.vmap(integral)(cells.width, -along.rates.slip)
    slip = jnp.concatenate([jnp.cumsum(gains[::-1], axis=0)[::-1], slips[:1]])
    edges = edges._replace(slip=slip)
    step = Step(edges, slips[1:], -along.rates.slip[:, 1], good)
    instant = Instant(given, step, cells.along(given.outboard, edges, slips[1:]), slips[1:], line[0], line[0])
    return instant._replace(work=stored_in(cells, instant))


def moved(cells: Cells, driven: tuple[int, ...], before: Instant, given: Given) -> Instant:
    """The body one short step later; `driven` are the tendons whose displacement is given."""
    step = after_step(Setting(cells, given.outboard, driven), given.ends, before.step)
    old, new = before.along, cells.along(given.outboard, step.edges, step.share)

    def mean(a, b):
        return (a + b) / 2

    def whole(density):
        return jnp.sum(jax.vmap(integral)(cells.width, density))

    pulled_in = cells.pulled_in(step.edges) - cells.pulled_in(before.step.edges)
    pull = mean(before.step.edges.tension[0], step.edges.tension[0])
    # the work of N, integrated by parts as M_ext' dphi: then work = stored + loss holds in each short step
    by_force = -whole(mean(old.rates.moment, new.rates.moment) * (new.values.heading - old.values.heading))
    heading = step.edges.heading[-1] - before.step.edges.heading[-1]
    by_moment = mean(before.given.ends.tip_moment, given.ends.tip_moment) * heading
    friction = mean(old.rates.tension, new.rates.tension) * (new.values.slip - old.values.slip)
    slipped = step.edges.slip - before.step.edges.slip
    jumps = mean(_jumps(old, before.step), _jumps(new, step)) * slipped[:-1]
    lost = whole(jnp.sum(friction, axis=-1)) + jnp.sum(jumps)
    return Instant(
        given,
        step,
        new,
        slid=(slipped[:-1] + slipped[1:]) / 2,
        work=before.work + jnp.sum(pull * pulled_in) + by_force + by_moment,
        friction_loss=before.friction_loss - lost,
    )


def _jumps(along: Along, step: Step) -> Float[Array, "P tendons"]:
    """The jumps of the tensions at the starts of the cells, N."""
    return along.values.tension[:, 0] - step.edges.tension[:-1]


# --- results at an instant -----------------------------------------------------------------------


class Shape(NamedTuple):
    """The shape of a body along its cells."""

    along: Along  # the cells
    position: Float[Array, "edges 2"]  # u, m
    wrap_angle: Float[Array, "edges tendons"]  # theta, rad


def shape_of(cells: Cells, instant: Instant) -> Shape:
    """Position and wrap angle, integrated along the body."""
    along = instant.along

    def summed(rate: Array, jumps: Array | float = 0.0) -> Array:
        gains = jax.vmap(integral)(cells.width, rate) + jumps
        return jnp.concatenate([jnp.zeros_like(gains[:1]), jnp.cumsum(gains, axis=0)])

    return Shape(along, summed(axis_of(along.values.heading)), summed(jnp.abs(along.turning), along.turn))


def stored_in(cells: Cells, instant: Instant) -> Number:
    """The energy of bending and of the stretch of the tendons, J."""
    along, edges = instant.along, instant.step.edges
    tension = where_present(cells.sections, along.values.tension)
    stretch = jnp.sum(tension * stretch_rate(cells.stretch, tension, cells.sections), axis=-1)
    density = (cells.sections.stiffness * along.rates.heading**2 + stretch) / 2
    return jnp.sum(jax.vmap(integral)(cells.width, density)) + jnp.sum(cells.free_stretch * edges.tension[0] ** 2) / 2


def fields_of_instant(
    manipulator: Manipulator, cells: Cells, instant: Instant, shape: Shape, arc_length: Number
) -> Fields:
    """The fields at one arc length, tendons last; cubic polynomials within the cells."""
    i = cells.at(arc_length)
    width = cells.width[i]
    place = (arc_length - cells.edges[i]) / jnp.where(width > 0, width, 1.0)
    along, outboard = jax.tree.map(lambda x: x[i], (shape.along, instant.given.outboard))
    between = partial(_cubic, place, width)
    here = jax.tree.map(lambda x, rate: between(x[0], x[2], rate[0], rate[2]), along.values, along.rates)
    axis, turning = axis_of(along.values.heading), jnp.abs(along.turning)
    state = State(
        Pull(jnp.ones_like(here.tension)),
        here.heading,
        here.moment,
        outboard[0] + place * (outboard[2] - outboard[0]),
        None,
        between(shape.wrap_angle[i], shape.wrap_angle[i + 1], turning[0], turning[2]),
        between(shape.position[i], shape.position[i + 1], axis[0], axis[2]),
    )
    section = planar(guarded_section(manipulator, arc_length))
    fields = planar_fields(section, here.tension, instant.step.share[i], arc_length, state)
    return nan_unless((arc_length >= 0) & (arc_length <= cells.edges[-1]), fields)


def _cubic(place: Number, width: Number, start: Array, end: Array, rate: Array, end_rate: Array) -> Array:
    """Hermite's cubic polynomial at a point from 0 to 1 of a cell, from values and rates at its ends."""
    t, u = place, 1 - place
    return u**2 * (1 + 2 * t) * start + t**2 * (1 + 2 * u) * end + width * t * u * (u * rate - t * end_rate)


class TipPose(NamedTuple):
    """Tensions and pose of the tip, of which the error is estimated."""

    tension: PerTendon
    position: Float[Array, "2"]
    heading: Number


def tip_of(cells: Cells, instant: Instant) -> TipPose:
    """The tip of a body."""
    edges = instant.step.edges
    return TipPose(edges.tension[-1], shape_of(cells, instant).position[-1], edges.heading[-1])


def difference(cells: Cells, tip: TipPose, other: TipPose) -> Number:
    """The largest difference of two passes: in tip tension (relative), position (per length) or angle (rad)."""
    return jnp.max(
        jnp.stack(
            [
                largest_size(tip.tension - other.tension) / _tension_scale(cells, tip),
                largest_size(tip.position - other.position) / cells.edges[-1],
                jnp.abs(tip.heading - other.heading),
            ]
        )
    )


def _tension_scale(cells: Cells, tip: TipPose) -> Number:
    """The scale of the tensions, N: the largest at the tip, and the largest loss by drag."""
    drag = cells.sections.drag
    dragged = 0.0 if drag is None else jnp.max(jnp.sum(cells.width[:, None] * drag[:, 1], axis=0))
    return jnp.maximum(jnp.max(tip.tension), 1e-3) + dragged


def pushed(cells: Cells, instant: Instant, tip: TipPose) -> Number:
    """The largest push of a tendon over the tension scale: an error, made where drag has used up the tension."""
    return jnp.maximum(-jnp.min(instant.step.edges.tension), 0.0) / _tension_scale(cells, tip)


def crosses(cells: Cells, instant: Instant) -> Bool[Array, ""]:
    """Whether fibres cross on the inside of the bend."""
    bend = cells.sections.side * cells.sections.offset * instant.along.rates.heading[..., None]
    return jnp.any(where_present(cells.sections, bend) >= 1.0)


def fronts_of(cells: Cells, share: Float[Array, "steps P tendons"]) -> Float[Array, "steps tendons"]:
    """The arc length, m, up to which each tendon slides in one direction from the base."""
    direction = jnp.where(share[:, :1] < 0, -1.0, 1.0)
    slides = share * direction > 1 - AT_LIMIT
    whole = jnp.cumprod(slides, axis=1)
    first = jnp.sum(whole, axis=1, keepdims=True).astype(int)
    reach = jnp.sum(whole * cells.width[:, None], axis=1)
    last = jnp.minimum(first, share.shape[1] - 1)
    part = (1 + jnp.take_along_axis(share * direction, last, axis=1)[:, 0]) / 2
    width = cells.width[last[:, 0]]
    return jnp.where(first[:, 0] < share.shape[1], reach + jnp.clip(part, 0.0, 1.0) * width, cells.edges[-1])
