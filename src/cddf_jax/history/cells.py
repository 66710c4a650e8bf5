"""A body cut into short cells, along which tendons may slide in, slide out, or rest.

Along each cell the friction of a tendon is a share sigma of its limit: +1 where the tendon slides in, -1 where it
slides out, and between -1 and +1 where it rests or where its direction changes within the cell. Everything else is
integrated over a cell to fourth order: by Simpson's rule, with the value in the middle from Hermite's cubic polynomial.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..mechanics import bending
from ..mechanics.bending import slip_rate
from ..mechanics.friction import PerTendon, ratio_beyond, tension_rate
from ..mechanics.geometry import PLANE, axis_of
from ..mechanics.problem import Problem, guarded_section, lay_out
from ..numerics.elements import Elements, smooth_pieces
from ..robot.cross_section import CrossSection, planar, where_present
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator

Number = Float[Array, ""]
STIFFEST = 1e-7  # the least strain of a tendon per tension, over d^2 / (E J), its slip per tension by bending


class Edge(NamedTuple):
    """The values at an edge between cells; those of all edges have a leading axis."""

    tension: Float[Array, "*edges tendons"]  # T, N
    heading: Float[Array, "*edges"]  # phi, rad
    slip: Float[Array, "*edges tendons"]  # w, m: how far the tendon has moved through the body towards the base
    moment: Float[Array, "*edges"]  # M_ext, N m


class Cells(eqx.Module):
    """The P cells, with the cross-sections at the start, the middle and the end of each."""

    edges: Float[Array, " edges"]  # s, m
    sections: CrossSection  # leading axes P, 3
    before: CrossSection | None  # just before each cell; None where no tendon can turn by a finite angle there
    stretch: PerTendon  # strain of each tendon per tension, 1/N
    free_stretch: PerTendon  # elongation per tension of the tendon outside the body, m/N

    @property
    def width(self) -> Float[Array, " P"]:
        return jnp.diff(self.edges)

    @property
    def scale(self) -> Number:
        """The length to which slips are compared: the largest offset, m."""
        return jnp.max(jnp.abs(self.sections.offset))

    def at(self, arc_length: Float[Array, "*points"]) -> Int[Array, "*points"]:
        """The index of the cell that holds an arc length, m."""
        return jnp.sum(self.edges[1:-1] <= arc_length[..., None], axis=-1)

    def pulled_in(self, edges: Edge) -> PerTendon:
        """The displacement of each tendon at its actuator, m."""
        return edges.slip[0] + self.free_stretch * edges.tension[0]

    def along(self, outboard: Float[Array, "P 3 2"], edges: Edge, share: Float[Array, "P tendons"]) -> "Along":
        """Values and rates along all cells, from the values at their edges; leading axis P.

        Args:
            outboard: the force N of the dead loads beyond the start, the middle and the end of each cell, in newtons.
            edges: the values at the edges.
            share: sigma of each tendon.
        """
        starts, ends = jax.tree.map(lambda x: x[:-1], edges), jax.tree.map(lambda x: x[1:], edges)
        along = jax.vmap(along_cell, (0, 0, 0, 0, None))
        return along(self.inputs(outboard), starts, ends, share, self.stretch)

    def inputs(self, outboard: Float[Array, "P 3 2"]) -> "Inputs":
        """The known numbers of each cell."""
        return Inputs(self.width, self.sections, self.before, outboard)


def cut_into_cells(manipulator: Manipulator, count: int, merged: Number | float = 0.0) -> Cells:
    """About `count` cells, which end where the body or a tendon is not smooth.

    Args:
        manipulator: the body.
        count: number of cells; static.
        merged: 1 to give every second cell the width 0, so that the others are twice as long; else 0.
    """
    problem = _laid_out(manipulator, None, count, merged)
    free = manipulator.tendon_compliance * manipulator.tendon_free_length
    sections = _sections(problem)
    before = None
    if problem.joints is not None:
        ends = jax.tree.map(lambda x: x[:-1, 2], sections)
        before = jax.tree.map(lambda x, end: jnp.concatenate([x[:1, 0], end]), sections, ends)
    return Cells(problem.elements.edges, sections, before, _stretch(manipulator, problem), free)


def forces_along(manipulator: Manipulator, count: int, merged: Number, loads: Loads) -> Float[Array, "P 3 2"]:
    """The dead loads beyond the start, the middle and the end of each cell, N."""
    problem = _laid_out(manipulator, loads, count, merged)
    along = problem.outboard
    return jnp.stack([along.starts, along.nodes[:, 1], along.ends], axis=1)


def _laid_out(manipulator: Manipulator, loads: Loads | None, count: int, merged: Number | float) -> Problem:
    places = jnp.arange(1, count)
    splits = jnp.asarray(manipulator.length) * ((places - merged * (places % 2)) / count)
    still = jnp.zeros(manipulator.num_tendons, splits.dtype)
    ends = smooth_pieces(jnp.asarray(manipulator.length), jnp.concatenate([manipulator.breakpoints, splits]))
    cut = Elements.between(ends, 3)  # the second of three Gauss nodes is the middle
    return lay_out(manipulator, still, still, 3, loads, cut)


def _sections(problem: Problem) -> CrossSection:
    cut = problem.elements
    nudge = 1e-9 * cut.width  # a joint has a cross-section on either side
    places = jnp.stack([cut.edges[:-1] + nudge, cut.nodes[:, 1], cut.edges[1:] - nudge], axis=1)
    return planar(jax.vmap(jax.vmap(partial(guarded_section, problem.manipulator)))(places))


def _stretch(manipulator: Manipulator, problem: Problem) -> PerTendon:
    """1 / (E A), with a small value for a tendon that does not stretch.

    Where two tendons that do not stretch both rest, their friction is not determined. With the small stretch it is that
    of two equal, very stiff tendons.
    """
    sections = problem.nodes
    by_bending = jnp.max(sections.offset**2 / sections.stiffness[..., None], axis=(0, 1))
    return jnp.maximum(manipulator.tendon_compliance, STIFFEST * by_bending)


# --- along one cell -------------------------------------------------------------------------------


class Along(NamedTuple):
    """The values at the start, the middle and the end of a cell (a leading axis of 3), and their rates along s."""

    values: Edge
    rates: Edge
    turning: Float[Array, "3 tendons"]  # psi', rad/m
    turn: PerTendon  # the finite angle by which a tendon turns at the start of the cell, rad


class Inputs(NamedTuple):
    """The known numbers of a cell."""

    width: Number  # m
    sections: CrossSection  # at its start, its middle and its end
    before: CrossSection | None  # just before it
    outboard: Float[Array, "3 2"]  # force N, newtons


def along_cell(inputs: Inputs, start: Edge, end: Edge, share: PerTendon, stretch: PerTendon) -> Along:
    """Values and rates along a cell, from the values at its ends; those in the middle are on cubic polynomials.

    Args:
        inputs: the known numbers of the cell.
        start, end: the values at its ends.
        share: sigma of each tendon.
        stretch: strain of the tendons per tension, 1/N.
    """
    width, sections, before, force = inputs

    def rates_at(i: int, here: Edge) -> tuple[Edge, PerTendon]:
        section = jax.tree.map(lambda x: x[i], sections)
        tension = where_present(section, here.tension)  # beyond the anchor `here` still holds its tension
        kappa = bending.curvature(section, tension, here.moment)
        moment_rate = PLANE.moment_rate(axis_of(here.heading), force[i])
        turning = bending.turning(section, kappa, tension, share, moment_rate)
        loss = tension_rate(share, section, turning, tension)
        return Edge(loss, kappa, -slip_rate(section, kappa, tension, stretch), moment_rate), turning

    turn = jnp.zeros_like(share)
    if before is not None:
        turn, tension = _across(before, jax.tree.map(lambda x: x[0], sections), start, share)
        start = start._replace(tension=tension)
    (first, leaving), (last, arriving) = rates_at(0, start), rates_at(2, end)
    middle = jax.tree.map(lambda a, b, f, g: (a + b) / 2 + width / 8 * (f - g), start, end, first, last)
    halfway, turning = rates_at(1, middle)

    def three(*trees):
        return jax.tree.map(lambda *x: jnp.stack(x), *trees)

    return Along(three(start, middle, end), three(first, halfway, last), three(leaving, turning, arriving), turn)


def _across(before: CrossSection, after: CrossSection, here: Edge, share: PerTendon) -> tuple[PerTendon, PerTendon]:
    """The angle by which a tendon turns between two cells, rad, and its tension beyond, N."""

    def angle(section, tension):
        pull = where_present(section, tension)
        return bending.tangent_angle(section, bending.curvature(section, pull, here.moment))

    arriving, beyond, turn = angle(before, here.tension), here.tension, jnp.zeros_like(share)
    for _ in range(3):  # the angle beyond depends only weakly on the tension there
        turn = where_present(after, jnp.abs(angle(after, beyond) - arriving))
        beyond = here.tension / ratio_beyond(share, before, turn, jnp.ones_like(share))
    return turn, beyond


def missing_along(width: Number, along: Along) -> Edge:
    """The residuals of the integrals over one cell: the change of the values less the integrals of the rates."""
    return jax.tree.map(lambda x, rate: x[2] - x[0] - integral(width, rate), along.values, along.rates)


def integral(width: Number, rate: Float[Array, "3 *k"]) -> Float[Array, "*k"]:
    """The integral over a cell, by Simpson's rule."""
    return width / 6 * (rate[0] + 4 * rate[1] + rate[2])
