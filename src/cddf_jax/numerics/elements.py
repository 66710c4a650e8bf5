"""Elements of the body with Gauss nodes: integration and interpolation along the arc length.

The body is cut into elements, in each of which everything is smooth; they do not move. One small matrix integrates a
function sampled at the nodes from the start of the element to every node and to its end. For an analytic function
their error falls like rho^(-2 order).

The magnitude of a rate that changes its sign has a kink. It is integrated over the sub-intervals between neighbouring
nodes, each divided at the root of the rate.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.polynomial import legendre

from .rotations import length_of, square_root

Tree = TypeVar("Tree")
LARGEST_ORDER = 16  # Gauss nodes in one element
ROOT_STEPS = 1  # of Newton's method, from the root of the straight line between two nodes
POINTS_BETWEEN = 4  # Gauss points in a part of a sub-interval


class Rule(NamedTuple):
    """The Gauss rule on an element scaled to [0, 1], as NumPy constants; p = order.

    Sub-intervals lie between 0, the nodes and 1.
    """

    nodes: np.ndarray  # (p,)
    weights: np.ndarray  # (p,) integral over the element
    totals: np.ndarray  # (p + 1, p) integral from 0 to each node and to 1
    differentiation: np.ndarray  # (p, p) derivative at each node
    series: np.ndarray  # (p, p) values at the nodes -> Legendre coefficients
    interpolation: np.ndarray  # (p + 1, p + 1) likewise of the values at 0 and the nodes
    ends: np.ndarray  # (2, p) values at the nodes -> their polynomial at 0 and at 1
    barycentric: np.ndarray  # (p,) barycentric weights of the nodes
    points: np.ndarray  # (p + 2,) 0, the nodes and 1
    at_points: np.ndarray  # (p + 2, p) values at the nodes -> their polynomial at the points
    slopes: np.ndarray  # (p + 2, p) likewise its derivative
    inner: np.ndarray  # (p + 1, q, p) likewise its value at `POINTS_BETWEEN` Gauss points in each sub-interval


@lru_cache
def gauss_rule(order: int) -> Rule:
    """The rule with `order` nodes, exact for polynomials of degree 2 order - 1."""
    roots, weights = legendre.leggauss(order)
    values = legendre.legvander(roots, order - 1)
    series = values.T * weights * (np.arange(order)[:, None] + 0.5)  # values at the nodes -> Legendre coefficients
    identity = np.eye(order)
    points = np.concatenate([[-1.0], roots, [1.0]])
    between = legendre.leggauss(POINTS_BETWEEN)[0]
    barycentric = 1.0 / np.prod(np.where(identity > 0, 1.0, roots[:, None] - roots), axis=1)
    inner = points[:-1, None] + np.diff(points)[:, None] * (between + 1) / 2
    return Rule(
        nodes=(roots + 1) / 2,
        weights=weights / 2,
        totals=np.stack([legendre.legval(points[1:], legendre.legint(row, lbnd=-1)) for row in identity], 1)
        @ series
        / 2,
        differentiation=2 * np.stack([legendre.legval(roots, legendre.legder(row)) for row in identity], 1) @ series,
        series=series,
        interpolation=np.linalg.inv(legendre.legvander(points[:-1], order)),
        ends=legendre.legvander(np.array([-1.0, 1.0]), order - 1) @ series,
        barycentric=barycentric / np.max(np.abs(barycentric)),
        points=(points + 1) / 2,
        at_points=legendre.legvander(points, order - 1) @ series,
        slopes=2 * np.stack([legendre.legval(points, legendre.legder(row)) for row in identity], 1) @ series,
        inner=legendre.legvander(inner, order - 1) @ series,
    )


def times(matrix: np.ndarray, values: Float[Array, "p *k"]) -> Float[Array, "q *k"]:
    """The product of a constant matrix and values along their first axis.

    The matrix is the right factor: XLA then multiplies a batch without copies.
    """
    return jnp.moveaxis(jnp.moveaxis(values, 0, -1) @ jnp.asarray(matrix.T, values.dtype), -1, 0)


# --- one element --------------------------------------------------------------------------------


def totals(width: Float[Array, ""], rate: Float[Array, "p *k"]) -> tuple[Float[Array, "p *k"], Float[Array, "*k"]]:
    """The integral of a rate from the start of an element to its nodes, and over the element."""
    found = times(gauss_rule(rate.shape[0]).totals, width * rate)
    return found[:-1], found[-1]


@jax.custom_jvp
def totals_of_magnitude(
    width: Float[Array, ""], rate: Float[Array, "p *k"]
) -> tuple[Float[Array, "p *k"], Float[Array, "*k"]]:
    """As `totals`, of |rate|. A sub-interval in which the rate changes its sign is divided at the root."""
    return _totals_by_sign(width, rate, rate)


@totals_of_magnitude.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    (width, rate), (wider, change) = primals, tangents
    found = totals_of_magnitude(width, rate)
    moved = _totals_by_sign(width, rate, change)  # the root moves, but there the rate is zero
    return found, jax.tree.map(lambda by_rate, total: by_rate + wider / width * total, moved, found)


def _totals_by_sign(
    width: Float[Array, ""], rate: Float[Array, "p *k"], values: Float[Array, "p *k"]
) -> tuple[Float[Array, "p *k"], Float[Array, "*k"]]:
    """As `totals`, of values times the sign of a rate, which is 1 where the rate is 0.

    Roots are those of the cubic through the rate and its slopes at the ends of a sub-interval.
    """
    rule = gauss_rule(rate.shape[0])
    step = jnp.asarray(np.diff(rule.points).reshape(-1, *[1] * (rate.ndim - 1)), rate.dtype)
    ends = times(rule.at_points, rate)
    left = ends < 0
    crosses = ends[:-1] * ends[1:] < 0
    root = _root_of_cubic(_hermite(ends, times(rule.slopes, rate), step), jnp.where(crosses, ends[1:] - ends[:-1], 1.0))
    a, b, c, d = _hermite(times(rule.at_points, values), times(rule.slopes, values), step)
    before = step * root * (a + root * (b / 2 + root * (c / 3 + root * d / 4)))
    gain = times(np.diff(rule.totals, axis=0, prepend=0.0), values)
    signed = jnp.where(crosses, 2 * before - gain, gain)
    turned = jnp.where(crosses, left[:-1], left[:-1] | left[1:])
    sums = times(np.tril(np.ones((len(step), len(step)))), width * jnp.where(turned, -signed, signed))
    return sums[:-1], sums[-1]


class Root(NamedTuple):
    """The first root of each function in an element."""

    exists: Bool[Array, "*k"]
    place: Float[Array, "*k"]  # in [0, 1]; 1 where there is none
    total: Float[Array, "*k"]  # the integral up to there, over an element of width 1


def first_root(values: Float[Array, "p *k"]) -> Root:
    """The first change of sign of functions, with derivatives of any order."""
    rule = gauss_rule(values.shape[0])
    points = jnp.asarray(rule.points.reshape(-1, *[1] * (values.ndim - 1)), values.dtype)
    step, ends = jnp.diff(points, axis=0), times(rule.at_points, values)
    crosses = ends[:-1] * ends[1:] < 0
    first = crosses & (times(np.tril(np.ones((len(step), len(step)))), crosses.astype(values.dtype)) < 1.5)
    a, b, c, d = cubic = _hermite(ends, times(rule.slopes, values), step)
    root = _root_of_cubic(cubic, jnp.where(crosses, ends[1:] - ends[:-1], 1.0))
    before = times(rule.totals, values) - times(np.diff(rule.totals, axis=0, prepend=0.0), values)
    total = before + step * root * (a + root * (b / 2 + root * (c / 3 + root * d / 4)))
    exists = jnp.any(first, axis=0)
    place = jnp.where(exists, jnp.sum(jnp.where(first, points[:-1] + step * root, 0.0), axis=0), 1.0)
    return Root(exists, place, jnp.sum(jnp.where(first, total, 0.0), axis=0))


def _root_of_cubic(cubic: tuple[Array, Array, Array, Array], change: Array) -> Array:
    """The root in [0, 1] of a cubic that changes its sign, by Newton's method from the root of the chord.

    The last step gives it derivatives of any order.

    `change`: the value at 1 less that at 0.
    """

    def newton(root: Array, cubic: tuple[Array, Array, Array, Array]) -> Array:
        a, b, c, d = cubic
        height, rise = a + root * (b + root * (c + root * d)), b + root * (2 * c + 3 * root * d)
        return jnp.clip(root - height / jnp.where(rise == 0, change, rise), 0.0, 1.0)

    still = jax.lax.stop_gradient(cubic)
    root = jax.lax.stop_gradient(-cubic[0] / change)
    for _ in range(ROOT_STEPS):
        root = newton(root, still)
    return newton(root, cubic)


def totals_of_length(
    width: Float[Array, ""], rate: Float[Array, "p *k n"]
) -> tuple[Float[Array, "p *k"], Float[Array, "*k"]]:
    """As `totals`, of the length of a vector, also where the vector passes near zero.

    The length of the polynomial is integrated by Gauss points in every sub-interval. What they miss is found on the
    cubic through values and slopes at the ends of the sub-interval, see `_missed`.
    """
    rule = gauss_rule(rate.shape[0])
    step = jnp.asarray(np.diff(rule.points).reshape(-1, *[1] * (rate.ndim - 2)), rate.dtype)
    points, slopes = times(rule.at_points, rate), times(rule.slopes, rate)
    weights = legendre.leggauss(POINTS_BETWEEN)[1] / 2
    inner = length_of(times(rule.inner.reshape(-1, len(rule.nodes)), rate))
    inner = inner.reshape(len(step), POINTS_BETWEEN, *inner.shape[1:])
    parts = step * (jnp.tensordot(inner, jnp.asarray(weights, rate.dtype), (1, 0)))
    parts = parts + step * _missed(_hermite(points, slopes, step[..., None]))
    sums = times(np.tril(np.ones((len(step), len(step)))), width * parts)
    return sums[:-1], sums[-1]


def totals_switched(
    integrate: Callable[[Array, Array], tuple[Array, Array]],
    size: Callable[[Array], Array],
    width: Float[Array, ""],
    before: Array,
    after: Array,
    place: Float[Array, ""],
) -> tuple[Array, Array]:
    """The integral of a rate that is `before` up to a place in [0, 1] of the element, and `after` beyond it.

    Args:
        integrate: one of the functions above.
        size: what it integrates of a rate: the rate itself, its magnitude or its length.
        width: of the element.
        before, after: the rates at the nodes, equal at the place.
        place: in [0, 1].
    """
    points = jnp.asarray(gauss_rule(before.shape[0]).points, place.dtype)
    i = jnp.sum(points[1:-1] <= place)  # the last point before the place

    def to_place(rate: Array, nodes: Array) -> Array:
        """By Simpson's rule from the last point before it."""
        along = jnp.stack([points[i], (points[i] + place) / 2, place])
        weights = legendre_basis(along, rate.shape[0]) @ jnp.asarray(gauss_rule(rate.shape[0]).series, rate.dtype)
        first, middle, last = size(jnp.tensordot(weights, rate, 1))
        known = jnp.concatenate([jnp.zeros_like(nodes[:1]), nodes])[i]
        return known + width * (place - points[i]) / 6 * (first + 4 * middle + last)

    (nodes, end), (nodes_after, end_after) = integrate(width, before), integrate(width, after)
    shift = to_place(before, nodes) - to_place(after, nodes_after)
    early = (points[1:-1] < place).reshape(-1, *[1] * (nodes.ndim - 1))
    return jnp.where(early, nodes, nodes_after + shift), jnp.where(place < 1, end_after + shift, end)


def legendre_basis(place: Float[Array, "*k"], count: int) -> Float[Array, "*k count"]:
    """The first Legendre polynomials at places in [0, 1] of an element."""
    x = 2 * place - 1
    basis = [jnp.ones_like(x), x]
    for n in range(1, count - 1):
        basis.append(((2 * n + 1) * x * basis[n] - n * basis[n - 1]) / (n + 1))
    return jnp.stack(basis[:count], axis=-1)


def _hermite(value: Array, slope: Array, step: Array) -> tuple[Array, Array, Array, Array]:
    """The coefficients of the cubics through values and slopes at neighbouring points, over widths of 1."""
    start, end, rise = value[:-1], step * slope[:-1], value[1:] - value[:-1]
    last = step * slope[1:]
    return start, end, 3 * rise - 2 * end - last, end + last - 2 * rise


def _missed(cubic: tuple[Array, Array, Array, Array]) -> Array:
    """The integral of |c| over [0, 1] less that by Gauss points, for a cubic c in space.

    Near its minimum z, |c| is about the root of alpha^2 + beta^2 (t - z)^2, whose integral has a closed form. The rest
    is integrated by Gauss points on either side of z.
    """
    a, b, c, d = cubic
    nodes, weights = legendre.leggauss(POINTS_BETWEEN)
    nodes, weights = (nodes + 1) / 2, weights / 2

    def at(t):
        return a + t[..., None] * (b + t[..., None] * (c + t[..., None] * d))

    def rate(t):
        return b + t[..., None] * (2 * c + t[..., None] * (3 * d))

    def nearest(t, value, rate):
        speed = jnp.sum(rate**2, axis=-1)
        return jnp.clip(t - jnp.sum(value * rate, axis=-1) / jnp.where(speed > 0, speed, 1.0), -0.5, 1.5)

    chord = at(jnp.ones(a.shape[:-1], a.dtype)) - a
    z = nearest(jnp.zeros(a.shape[:-1], a.dtype), a, chord)
    z = jax.lax.stop_gradient(nearest(z, at(z), rate(z)))
    alpha, beta = jnp.sum(at(z) ** 2, axis=-1), jnp.sum(rate(z) ** 2, axis=-1)
    cut = jnp.clip(z, 0.0, 1.0)

    def rest(t):
        return length_of(at(t)) - square_root(alpha + beta * (t - z) ** 2)

    found = _kernel(alpha, beta, 1.0 - z) + _kernel(alpha, beta, z)
    for node, weight in zip(nodes, weights, strict=True):
        found = found + weight * (cut * rest(cut * node) + (1 - cut) * rest(cut + (1 - cut) * node))
        found = found - weight * length_of(at(jnp.full(a.shape[:-1], node, a.dtype)))
    return found


def _kernel(alpha: Array, beta: Array, t: Array) -> Array:
    """The integral of sqrt(alpha + beta x^2) from 0 to t."""
    alpha = alpha + 1e-30 * beta + jnp.finfo(alpha.dtype).tiny ** 0.5
    y = t * jnp.sqrt(beta / alpha + 1e-30)
    steep = jnp.abs(y) > 1e-4
    mean = jnp.where(steep, jnp.arcsinh(y) / jnp.where(steep, y, 1.0), 1.0 - y**2 / 6)
    return t / 2 * (jnp.sqrt(alpha + beta * t**2) + jnp.sqrt(alpha) * mean)


# --- all elements -------------------------------------------------------------------------------


class Elements(eqx.Module):
    """The elements of a body, P of them with p nodes each."""

    edges: Float[Array, " edges"]  # arc length, m, from 0 to L
    width: Float[Array, " P"]
    nodes: Float[Array, "P p"]
    order: int = eqx.field(static=True)

    @classmethod
    def between(cls, edges: Float[Array, " edges"], order: int) -> "Elements":
        """The elements between edges."""
        width = edges[1:] - edges[:-1]
        places = jnp.asarray(gauss_rule(order).nodes, edges.dtype)
        return cls(edges, width, edges[:-1, None] + width[:, None] * places, order)

    @property
    def rule(self) -> Rule:
        return gauss_rule(self.order)

    @property
    def shares(self) -> Float[Array, "P p"]:
        """The weight of each node in a mean along the body; their sum is 1."""
        return self.width[:, None] * jnp.asarray(self.rule.weights, self.width.dtype) / self.edges[-1]

    def gain(self, rate: Float[Array, "P p *k"]) -> Float[Array, "P *k"]:
        """The integral of `rate` over each element."""
        return self._along(rate, self.width) * (jnp.moveaxis(rate, 1, -1) @ jnp.asarray(self.rule.weights, rate.dtype))

    def integrate(self, rate: Float[Array, "P p *k"]) -> tuple[Float[Array, "edges *k"], Float[Array, "P p *k"]]:
        """The integral of `rate` from the base to every edge and to every node."""
        nodes, gain = jax.vmap(totals)(self.width, rate)
        edges = jnp.concatenate([jnp.zeros_like(gain[:1]), jnp.cumsum(gain, axis=0)])
        return edges, edges[:-1, None] + nodes

    def differentiate(self, values: Float[Array, "P p *k"]) -> Float[Array, "P p *k"]:
        """The derivative along s of the polynomials through the nodes of each element."""
        return jax.vmap(slope_in_element)(self.width, values)

    def at_starts_and_ends(self, values: Float[Array, "P p *k"]) -> Float[Array, "2 P *k"]:
        """The polynomials through the nodes of each element, at its start and at its end."""
        return jnp.moveaxis(jax.vmap(lambda x: times(self.rule.ends, x))(values), 1, 0)

    def dense_gain(self, rate: Callable[[Array], Array], parts: int, order: int) -> Float[Array, "P *k"]:
        """The integral of a function of the arc length over each element, in equal parts with `order` nodes each."""
        rule = gauss_rule(order)
        fractions = (np.arange(parts)[:, None] + rule.nodes).ravel() / parts
        weights = jnp.asarray(np.tile(rule.weights, parts) / parts, self.edges.dtype)
        places = self.edges[:-1, None] + self.width[:, None] * jnp.asarray(fractions, self.edges.dtype)
        values = jax.vmap(jax.vmap(rate))(places)
        return self._along(values, self.width) * (jnp.moveaxis(values, 1, -1) @ weights)

    def resample(self, start: Float[Array, "P *k"], values: Float[Array, "P p *k"], places: np.ndarray) -> Array:
        """The polynomials through the starts and the nodes of the elements, at other points in [0, 1] of each."""
        basis = legendre.legvander(2 * places - 1, self.order) @ self.rule.interpolation
        return jax.vmap(lambda a, b: times(basis, jnp.concatenate([a[None], b])))(start, values)

    def interpolate(self, start: Tree, values: Tree, arc_length: Float[Array, ""]) -> Tree:
        """The polynomials through the start and the nodes of the element that holds `arc_length`.

        Args:
            start, values: trees of arrays with leading axes P and (P, p).
        """
        i, x = self._within(arc_length)
        weights = legendre_basis(x, self.order + 1) @ jnp.asarray(self.rule.interpolation, x.dtype)
        return jax.tree.map(lambda a, b: jnp.tensordot(weights, jnp.concatenate([a[i][None], b[i]]), 1), start, values)

    def lagrange(self, place: Float[Array, ""]) -> Float[Array, " p"]:
        """The weights of the nodes in the value of their polynomial at a point in [0, 1].

        At a node, derivatives with respect to the point are wrong.
        """
        apart = place - jnp.asarray(self.rule.nodes, place.dtype)
        safe = jnp.where(apart == 0, jnp.finfo(apart.dtype).tiny ** 0.5, apart)
        terms = jnp.asarray(self.rule.barycentric, apart.dtype) / safe
        return terms / jnp.sum(terms)

    def _along(self, values: Float[Array, "P p *k"], widths: Float[Array, " P"]) -> Float[Array, "P *_"]:
        return widths.reshape((-1, *[1] * (values.ndim - 2)))

    def _within(self, arc_length: Float[Array, ""]) -> tuple[Int[Array, ""], Float[Array, ""]]:
        """The index of the element that holds `arc_length`, and the position within it, from 0 to 1.

        The last element with a width holds the tip, so that derivatives there are those of the body.
        """
        inside = self.edges[1:-1]
        i = jnp.sum((inside <= arc_length) & (inside < self.edges[-1]))
        width = self.width[i]
        return i, (arc_length - self.edges[i]) / jnp.where(width > 0, width, 1.0)


def slope_in_element(width: Float[Array, ""], values: Float[Array, "p *k"]) -> Float[Array, "p *k"]:
    """The derivative along s of the polynomial through the nodes of an element; of one without width that for 1 m."""
    return times(gauss_rule(values.shape[0]).differentiation, values) / jnp.where(width > 0, width, 1.0)


def joints(length: Float[Array, ""], breakpoints: Float[Array, " n"]) -> Float[Array, " joints"]:
    """Base, breakpoints and tip in increasing order. A breakpoint at an end of the body keeps its own derivative."""
    breaks = breakpoints.astype(length.dtype)
    breaks = jnp.where(breaks > length, length, jnp.where(breaks < 0, 0.0, breaks))
    return jnp.sort(jnp.concatenate([jnp.zeros_like(length)[None], breaks, length[None]]))


def elements_between(joints: Float[Array, " joints"], nodes: int, least: int = 1) -> Elements:
    """At least `least` elements of equal width between neighbouring joints, with at least `nodes` nodes together.

    One element of 16 nodes is far more accurate for a smooth body than two of 8.
    """
    count = max(least, -(-nodes // LARGEST_ORDER))
    order = -(-nodes // count)
    if count == 1:
        return Elements.between(joints, order)
    fraction = jnp.arange(count) / count
    starts = joints[:-1, None] + jnp.diff(joints)[:, None] * fraction.astype(joints.dtype)
    return Elements.between(jnp.concatenate([starts.ravel(), joints[-1:]]), order)
