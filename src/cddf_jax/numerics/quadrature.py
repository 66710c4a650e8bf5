"""Gauss panels: integration and interpolation along the arc length.

The body is cut into panels, in each of which everything is smooth. A panel has `order` Gauss nodes.
One small matrix integrates a function sampled there from the start of the panel to every node. The
Gauss weights integrate it to the end of the panel; for an analytic function their error falls like
rho^(-2 order).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial import legendre

Tree = TypeVar("Tree")
LARGEST_ORDER = 16  # Gauss nodes in one panel


class Rule(NamedTuple):
    """The Gauss rule on a panel scaled to [0, 1], as NumPy constants; p = order."""

    nodes: np.ndarray  # (p,)
    weights: np.ndarray  # (p,) integral over the panel
    integration: np.ndarray  # (p, p) integral from 0 to each node
    differentiation: np.ndarray  # (p, p) derivative at each node
    interpolation: np.ndarray  # (p + 1, p + 1) values at 0 and the nodes -> Legendre coefficients
    barycentric: np.ndarray  # (p,) barycentric weights of the nodes
    ends: np.ndarray  # (2, p) values at the nodes -> their polynomial at 0 and at 1


@lru_cache
def gauss_rule(order: int) -> Rule:
    """The rule with `order` nodes, exact for polynomials of degree 2 order - 1."""
    roots, weights = legendre.leggauss(order)
    values = legendre.legvander(roots, order - 1)
    series = values.T * weights * (np.arange(order)[:, None] + 0.5)
    identity = np.eye(order)
    integrals = np.stack([legendre.legval(roots, legendre.legint(row, lbnd=-1)) for row in identity], axis=1)
    slopes = np.stack([legendre.legval(roots, legendre.legder(row)) for row in identity], axis=1)
    places = np.concatenate([[-1.0], roots])
    barycentric = 1.0 / np.prod(np.where(identity > 0, 1.0, roots[:, None] - roots), axis=1)
    return Rule(
        nodes=(roots + 1) / 2,
        weights=weights / 2,
        integration=integrals @ series / 2,
        differentiation=2 * slopes @ series,
        interpolation=np.linalg.inv(legendre.legvander(places, order)),
        barycentric=barycentric / np.max(np.abs(barycentric)),
        ends=legendre.legvander(np.array([-1.0, 1.0]), order - 1) @ series,
    )


class Panels(eqx.Module):
    """Panels along the body, P of them with p nodes each."""

    edges: Float[Array, " edges"]  # arc length, m, from 0 to L
    width: Float[Array, " P"]
    nodes: Float[Array, "P p"]
    order: int = eqx.field(static=True)

    @classmethod
    def between(cls, edges: Float[Array, " edges"], order: int) -> "Panels":
        """The panels between edges."""
        width = edges[1:] - edges[:-1]
        places = jnp.asarray(gauss_rule(order).nodes, edges.dtype)
        return cls(edges, width, edges[:-1, None] + width[:, None] * places, order)

    @property
    def rule(self) -> Rule:
        return gauss_rule(self.order)

    @property
    def shares(self) -> Float[Array, "P p"]:
        """The weight of each node in a mean along the body; their sum is 1."""
        return self.width[:, None] * self.constant("weights") / self.edges[-1]

    @property
    def neighbours(self) -> tuple[Float[Array, "P p"], Float[Array, "P p"]]:
        """The arc lengths of the nodes before and after each node of a panel; the ends have mirrored nodes beyond."""
        first = self.rule.nodes[0]
        places = jnp.asarray([-first, *self.rule.nodes, 1.0 + first], self.edges.dtype)
        along = self.edges[:-1, None] + self.width[:, None] * places
        return along[:, :-2], along[:, 2:]

    def constant(self, name: str) -> Float[Array, "..."]:
        """A matrix of the rule in the precision of the edges."""
        return jnp.asarray(getattr(self.rule, name), self.edges.dtype)

    def _width_for(self, rate: Float[Array, "P p *k"]) -> Float[Array, "P *_"]:
        return self.width.reshape((-1, *[1] * (rate.ndim - 2)))

    def without_empty(self, values: Float[Array, "P p *k"]) -> Float[Array, "P p *k"]:
        """The values, with zero at the nodes of panels of width 0."""
        return jnp.where(self._width_for(values)[:, None] > 0, values, 0.0)

    def with_empty(self, values: Float[Array, "P p *k"], count: int) -> Float[Array, "Q p *k"]:
        """The values at the nodes of these panels, followed by those of `count` panels of width 0 at the tip."""
        tip = jnp.tensordot(self.constant("ends")[1], values[-1], 1)
        return jnp.concatenate([values, jnp.broadcast_to(tip, (count, *values.shape[1:]))])

    def gain(self, rate: Float[Array, "P p *k"]) -> Float[Array, "P *k"]:
        """The integral of `rate` over each panel."""
        return self._width_for(rate) * (jnp.moveaxis(rate, 1, -1) @ self.constant("weights"))

    def integrate(self, rate: Float[Array, "P p *k"]) -> tuple[Float[Array, "edges *k"], Float[Array, "P p *k"]]:
        """The integral of `rate` from the base to every edge and to every node."""
        scaled = self._width_for(rate)[:, None] * rate
        at_edges = self._sums_before_edges(jnp.moveaxis(scaled, 1, -1) @ self.constant("weights"))
        return at_edges, at_edges[:-1, None] + self.accumulate(scaled, 1)

    def integrate_together(self, rates: Tree) -> tuple[Tree, Tree]:
        """As `integrate`, for a tree of rates of any shapes (P, p, *k): one product of matrices for all of them."""
        arrays, structure = jax.tree.flatten(rates)
        rows = [rows_of(rate) for rate in arrays]
        found = jax.vmap(self.integrate)(jnp.concatenate(rows))
        parts = zip(*[apart(each, rows) for each in found], arrays, strict=True)
        integrals = [(edges.T.reshape(-1, *rate.shape[2:]), of_rows(nodes, rate)) for edges, nodes, rate in parts]
        edges, nodes = zip(*integrals, strict=True)
        return structure.unflatten(edges), structure.unflatten(nodes)

    def _sums_before_edges(self, gain: Float[Array, "P *k"]) -> Float[Array, "edges *k"]:
        """The sum over the panels before each edge."""
        count = gain.shape[0]
        if count == 1:
            return jnp.concatenate([jnp.zeros_like(gain), gain])
        before = jnp.asarray(np.tril(np.ones((count + 1, count)), -1), gain.dtype)
        return jnp.tensordot(before, gain, 1)

    def accumulate(self, rate: Float[Array, "*k"], axis: int = 0) -> Float[Array, "*k"]:
        """The integral of `rate` from the start of a panel of width 1 to its nodes, which lie along `axis`.

        The matrix is the right factor: XLA then multiplies a batch without copies.
        """
        return jnp.moveaxis(jnp.moveaxis(rate, axis, -1) @ self.constant("integration").T, -1, axis)

    def differentiate(self, values: Float[Array, "P p *k"]) -> Float[Array, "P p *k"]:
        """The derivative along s of the polynomials through the nodes of each panel."""
        width = jnp.where(self.width > 0, self.width, 1.0)
        slopes = jnp.moveaxis(values, 1, -1) @ self.constant("differentiation").T  # right factor, as in `accumulate`
        return jnp.moveaxis(slopes, -1, 1) / width.reshape((-1, *[1] * (values.ndim - 1)))

    def rate(self, starts: Float[Array, "P *k"], values: Float[Array, "P p *k"]) -> Float[Array, "P p *k"]:
        """The rate at the nodes whose integral from the start of each panel has these values; it inverts `integrate`.

        For such values it is more accurate than `differentiate`, which does without the values at the starts.
        """
        width = jnp.where(self.width > 0, self.width, 1.0)
        inverse = jnp.asarray(np.linalg.inv(self.rule.integration), self.edges.dtype)
        rates = jnp.moveaxis(values - starts[:, None], 1, -1) @ inverse.T
        return jnp.moveaxis(rates, -1, 1) / width.reshape((-1, *[1] * (values.ndim - 1)))

    def at_starts_and_ends(self, values: Float[Array, "P p *k"]) -> Float[Array, "2 P *k"]:
        """The polynomials through the nodes of each panel, at its start and at its end."""
        return jnp.moveaxis(jnp.moveaxis(values, 1, -1) @ self.constant("ends").T, -1, 0)

    @property
    def check_rule(self) -> tuple[np.ndarray, np.ndarray]:
        """Points in [0, 1] and weights, whose sum is the integral by three more nodes less that by the nodes."""
        more = gauss_rule(self.order + 3)
        return np.append(self.rule.nodes, more.nodes), np.append(-self.rule.weights, more.weights)

    def dense_gain(self, rate: Callable[[Array], Array], times: int, order: int) -> Float[Array, "P *k"]:
        """The integral of a function of the arc length over each panel, in `times` parts with `order` nodes each."""
        rule = gauss_rule(order)
        fractions = (np.arange(times)[:, None] + rule.nodes).ravel() / times
        weights = jnp.asarray(np.tile(rule.weights, times) / times, self.edges.dtype)
        places = self.edges[:-1, None] + self.width[:, None] * jnp.asarray(fractions, self.edges.dtype)
        values = jax.vmap(jax.vmap(rate))(places)
        return self._width_for(values) * (jnp.moveaxis(values, 1, -1) @ weights)

    def resample(self, start: Float[Array, "P *k"], values: Float[Array, "P p *k"], nodes: np.ndarray) -> Array:
        """The polynomials through the starts and the nodes of the panels, at other points in [0, 1] of each panel."""
        basis = legendre.legvander(2 * nodes - 1, self.order) @ self.rule.interpolation
        at_start, at_nodes = jnp.split(jnp.asarray(basis, self.edges.dtype), [1], axis=1)
        inside = jnp.moveaxis(values, 1, -1) @ at_nodes.T  # right factor, as in `accumulate`
        return jnp.moveaxis(inside + start[..., None] * at_start[:, 0], -1, 1)

    def extended(self, values: Float[Array, "P p *k"], places: np.ndarray) -> Array:
        """The polynomials through the nodes of the panels alone, at other points in [0, 1] of each panel."""
        basis = legendre.legvander(2 * places - 1, self.order - 1)
        basis = basis @ np.linalg.inv(legendre.legvander(2 * self.rule.nodes - 1, self.order - 1))
        weights = jnp.asarray(basis, self.edges.dtype)
        return jnp.moveaxis(jnp.moveaxis(values, 1, -1) @ weights.T, -1, 1)

    def _within(self, arc_length: Float[Array, ""]) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """The index of the panel that holds `arc_length`, and the position within the panel, from 0 to 1.

        The last panel with a width holds the tip, so that derivatives there are those of the body.
        """
        inside = self.edges[1:-1]
        i = jnp.sum((inside <= arc_length) & (inside < self.edges[-1]))
        width = self.width[i]
        return i, (arc_length - self.edges[i]) / jnp.where(width > 0, width, 1.0)

    def lagrange(self, place: Float[Array, ""]) -> Float[Array, " p"]:
        """The weights of the nodes in the value of their polynomial at a point in [0, 1].

        At a node, derivatives with respect to the point are wrong.
        """
        apart = place - self.constant("nodes")
        terms = self.constant("barycentric") / jnp.where(apart == 0, jnp.finfo(apart.dtype).tiny ** 0.5, apart)
        return terms / jnp.sum(terms)

    def shifted(self, values: Float[Array, "P p *k"], new: "Panels") -> Float[Array, "P p *k"]:
        """The values at the nodes of panels whose edges have moved a little, to second order in the distance."""
        shift = (new.nodes - self.nodes).reshape((*self.nodes.shape, *[1] * (values.ndim - 2)))
        rate = self.differentiate(values)
        return values + shift * (rate + shift / 2 * self.differentiate(rate))

    def weights_on(self, new: "Panels") -> Float[Array, "points nodes"]:
        """The matrix that interpolates from these nodes to those of other panels: a row for each new node."""

        def weights_at(arc_length):
            i, place = self._within(arc_length)
            chosen = jnp.where(jnp.arange(self.edges.shape[0] - 1) == i, 1.0, 0.0).astype(place.dtype)
            return (chosen[:, None] * self.lagrange(place)).ravel()

        return jax.vmap(weights_at)(new.nodes.ravel())

    def interpolate(self, start: Tree, values: Tree, arc_length: Float[Array, ""]) -> Tree:
        """The polynomials through the start and the nodes of the panel that holds `arc_length`.

        Args:
            start, values: trees of arrays with leading axes P and (P, p).
        """
        i, x = self._within(arc_length)
        x = 2 * x - 1
        basis = [jnp.ones_like(x), x]
        for n in range(1, self.order):
            basis.append(((2 * n + 1) * x * basis[n] - n * basis[n - 1]) / (n + 1))
        weights = jnp.stack(basis) @ self.constant("interpolation")
        return jax.tree.map(lambda a, b: jnp.tensordot(weights, jnp.concatenate([a[i][None], b[i]]), 1), start, values)


def rows_of(array: Float[Array, "..."], leading: int = 0) -> Float[Array, "numbers P p"]:
    """An array whose axes are `leading` ones, panels, nodes and components, as rows: one for each number at a node."""
    flat = array.reshape(*array.shape[: leading + 2], -1)
    return jnp.moveaxis(flat, -1, leading).reshape(-1, *array.shape[leading : leading + 2])


def of_rows(rows: Float[Array, "numbers P p"], array: Float[Array, "..."], leading: int = 0) -> Float[Array, "..."]:
    """The inverse of `rows_of`: the shape of `array`, but with the panels and nodes of the rows."""
    before, after = array.shape[:leading], array.shape[leading + 2 :]
    flat = rows.reshape(*before, -1, *rows.shape[1:])
    return jnp.moveaxis(flat, leading, -1).reshape(*before, *rows.shape[1:], *after)


def apart(joined: Float[Array, "numbers ..."], rows: Sequence[Array]) -> list[Array]:
    """The parts of an array, as long as those of which it was made by `jnp.concatenate`."""
    return jnp.split(joined, np.cumsum([len(each) for each in rows])[:-1].tolist())


def panels(length: Float[Array, ""], breakpoints: Float[Array, " n"], nodes: int) -> Panels:
    """Panels between the breakpoints, with at least `nodes` Gauss nodes in each smooth piece.

    One panel of 16 nodes is far more accurate for a smooth body than two of 8.
    """
    ends = jnp.zeros_like(length)[None], breakpoints.astype(length.dtype), length[None]
    return panels_between(jnp.sort(jnp.clip(jnp.concatenate(ends), 0.0, length)), nodes)


def panels_between(joints: Float[Array, " joints"], nodes: int) -> Panels:
    """As `panels`, between joints in increasing order; the first is the base and the last the tip."""
    per_piece = -(-nodes // LARGEST_ORDER)
    order = -(-nodes // per_piece)
    if per_piece == 1:
        return Panels.between(joints, order)
    fraction = jnp.arange(per_piece) / per_piece
    starts = joints[:-1, None] + jnp.diff(joints)[:, None] * fraction.astype(joints.dtype)
    return Panels.between(jnp.concatenate([starts.ravel(), joints[-1:]]), order)
