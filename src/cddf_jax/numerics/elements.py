"""Elements of the body with Gauss nodes: integration and interpolation along the arc length.

The body is cut into elements, in each of which everything is smooth; they do not move. One small matrix integrates a
function sampled at the nodes from the start of the element to every node and to its end. For an analytic function
their error falls like rho^(-2 order).

The magnitude of a rate that changes its sign has a kink. It is integrated over the sub-intervals between neighbouring
nodes, each divided at the root of the rate.
"""

from collections.abc import Callable
from functools import lru_cache, partial, reduce
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.polynomial import legendre

from .arrays import sum_of
from .rotations import dot, length_of, parts_of, square_root

Tree = TypeVar("Tree")
LARGEST_ORDER = 16  # Gauss nodes in one element
POINTS_BETWEEN = 4  # Gauss points in a part of a sub-interval


class Rule(NamedTuple):
    """The Gauss rule on an element scaled to [0, 1], as NumPy constants; p = order.

    Sub-intervals lie between 0, the nodes and 1. On each of them a quartic has the values and slopes of the polynomial
    through the nodes at both ends, and its integral.
    """

    nodes: np.ndarray  # (p,)
    weights: np.ndarray  # (p,) integral over the element
    totals: np.ndarray  # (p + 1, p) integral from 0 to each node and to 1
    differentiation: np.ndarray  # (p, p) derivative at each node
    series: np.ndarray  # (p, p) values at the nodes -> Legendre coefficients
    interpolation: np.ndarray  # (p + 2, p + 2) likewise of the values at 0, the nodes and 1
    ends: np.ndarray  # (2, p) values at the nodes -> their polynomial at 0 and at 1
    barycentric: np.ndarray  # (p,) barycentric weights of the nodes
    points: np.ndarray  # (p + 2,) 0, the nodes and 1
    step: np.ndarray  # (p + 1,) widths of the sub-intervals
    quartics: np.ndarray  # (5, p + 1, p) values at the nodes -> coefficients, over sub-intervals of width 1
    inner: np.ndarray  # (p + 1, q, p) likewise the polynomial at `POINTS_BETWEEN` Gauss points in each sub-interval


@lru_cache
def gauss_rule(order: int) -> Rule:
    """The rule with `order` nodes, exact for polynomials of degree 2 order - 1."""
    roots, weights = legendre.leggauss(order)
    # values at the nodes -> Legendre coefficients
    series = legendre.legvander(roots, order - 1).T * weights * (np.arange(order)[:, None] + 0.5)
    points, each = np.concatenate([[-1.0], roots, [1.0]]), np.eye(order)  # each coefficient
    barycentric = 1.0 / np.prod(np.where(each > 0, 1.0, roots[:, None] - roots), axis=1)
    slopes = np.stack([legendre.legval(points, legendre.legder(one)) for one in each], axis=1) @ series
    step, values = np.diff(points)[:, None] / 2, legendre.legvander(points, order - 1) @ series
    totals = np.stack([legendre.legval(points[1:], legendre.legint(one, lbnd=-1)) for one in each], axis=1) @ series / 2
    gains = np.diff(totals, axis=0, prepend=0.0)
    between = points[:-1, None] + step * (legendre.leggauss(POINTS_BETWEEN)[0] + 1)
    return Rule(
        nodes=(roots + 1) / 2,
        weights=weights / 2,
        totals=totals,
        differentiation=2 * slopes[1:-1],
        series=series,
        interpolation=np.linalg.inv(legendre.legvander(points, order + 1)),
        ends=values[[0, -1]],
        barycentric=barycentric / np.max(np.abs(barycentric)),
        points=(points + 1) / 2,
        step=step[:, 0],
        quartics=_quartics_between(values, 2 * step * slopes[:-1], 2 * step * slopes[1:], gains / step),
        inner=legendre.legvander(between, order - 1) @ series,
    )


def _quartics_between(values: np.ndarray, first: np.ndarray, last: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """The quartics with given values and slopes at both ends of sub-intervals of width 1, and given means."""
    rise = np.diff(values, axis=0)
    cubic = np.stack([values[:-1], first, 3 * rise - 2 * first - last, first + last - 2 * rise, 0 * rise])
    missing = 30 * (mean - np.tensordot(1 / np.arange(1.0, 6.0), cubic, 1))  # of t^2 (1 - t)^2
    return cubic + np.multiply.outer([0.0, 0.0, 1.0, -2.0, 1.0], missing)


def times(matrix: np.ndarray, values: Float[Array, "p *k"]) -> Float[Array, "..."]:
    """The product of a constant matrix (*q, p) and values along their first axis.

    The matrix is the right factor: XLA then multiplies a batch without copies.
    """
    flat = jnp.asarray(matrix.reshape(-1, matrix.shape[-1]).T, values.dtype)
    return jnp.moveaxis(jnp.moveaxis(values, 0, -1) @ flat, -1, 0).reshape(*matrix.shape[:-1], *values.shape[1:])


def last_coefficients(vectors: Float[Array, "p *k n"]) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """The larger of the last two Legendre coefficients of vectors, and the part of the two before that it is."""
    found = length_of(times(gauss_rule(vectors.shape[0]).series[-4:], vectors))
    last, before = jnp.maximum(found[-1], found[-2]), jnp.max(found[:-2], axis=0, initial=0.0)
    return last, jnp.minimum(1.0, last / jnp.maximum(before, jnp.finfo(last.dtype).tiny))


# --- one element --------------------------------------------------------------------------------

Totals = tuple[Float[Array, "p *k"], Float[Array, "*k"]]  # from the start of an element to its nodes, and to its end
Quartics = tuple[Array, ...]  # their five coefficients over the sub-intervals, scaled to width 1, each (q, *k)


def totals(width: Float[Array, ""], rate: Float[Array, "p *k"]) -> Totals:
    """The integral of a rate."""
    found = times(gauss_rule(rate.shape[0]).totals, width * rate)
    return found[:-1], found[-1]


def sums(width: Float[Array, ""], gains: Float[Array, "q *k"]) -> Totals:
    """The integral whose gains over the sub-intervals, for an element of width 1, are given."""
    found = times(np.tril(np.ones((len(gains), len(gains)))), width * gains)
    return found[:-1], found[-1]


def quartics(values: Float[Array, "p *k"]) -> Quartics:
    """The quartics over the sub-intervals of the polynomial through the nodes."""
    coefficients = times(np.concatenate(gauss_rule(values.shape[0]).quartics), values)
    return tuple(jnp.split(coefficients, 5))  # with indices, gradients of batches under loads take a third longer


def with_slopes(function: Callable[..., Array]) -> Callable[..., Array]:
    """The same function, whose derivative is a sum of products of slopes and changes; the slopes are found once.

    So little has to be iterated: without it a gradient of a batch under loads takes a third longer. Each entry of the
    result may depend on what stands at its own place only: numbers, or vectors along the last axis.
    """

    @jax.custom_jvp
    def known(*given: Any) -> Array:
        return function(*given)

    @known.defjvp
    def _(given: tuple, changes: tuple) -> tuple[Array, Array]:
        value, slopes_times = jax.vjp(function, *given)
        products = jax.tree.map(jnp.multiply, slopes_times(jnp.ones_like(value)), changes)
        entries, vectors = [], []
        for product in jax.tree.leaves(products):
            (entries if product.ndim == value.ndim else vectors).append(product)
        if vectors:
            entries.append(sum_of(parts_of(sum_of(vectors)))[..., 0])
        return value, sum_of(entries)

    return known


@with_slopes
def gains_of_magnitude(rate: Quartics) -> Float[Array, "q *k"]:
    """The integral of |rate| over each sub-interval, which is divided where the rate changes its sign."""
    whole, (crosses, root) = _integral(rate, 1.0), _roots(rate)
    left = (rate[0] < 0) | (~crosses & (sum(rate) < 0))
    signed = jnp.where(crosses, 2 * _integral(rate, root) - whole, whole)
    return _along(_rule_of(rate).step, whole) * jnp.where(left, -signed, signed)


def _along(numbers: np.ndarray, like: Float[Array, "_ *k"]) -> Float[Array, "q *_"]:
    return jnp.asarray(numbers.reshape(-1, *[1] * (like.ndim - 1)), like.dtype)


def _rule_of(curve: Quartics) -> Rule:
    return gauss_rule(curve[0].shape[0] - 1)


def _value(curve: Quartics, t: Array) -> Array:
    a, b, c, d, e = curve
    return a + t * (b + t * (c + t * (d + t * e)))


def _rate(curve: Quartics, t: Array) -> Array:
    _, b, c, d, e = curve
    return b + t * (2 * c + t * (3 * d + 4 * t * e))


def _integral(curve: Quartics, t: Array | float) -> Array:
    a, b, c, d, e = curve
    return t * (a + t * (b / 2 + t * (c / 3 + t * (d / 4 + t * e / 5))))


def _roots(curve: Quartics) -> tuple[Bool[Array, "q *k"], Float[Array, "q *k"]]:
    """Whether quartics change their sign, and the root in [0, 1], by Newton's method from the root of the chord.

    The last step gives it derivatives of any order.
    """
    end = sum(curve)
    crosses = curve[0] * end < 0
    change = jnp.where(crosses, end - curve[0], 1.0)

    def newton(curve: Quartics, root: Array) -> Array:
        rise = _rate(curve, root)
        return jnp.clip(root - _value(curve, root) / jnp.where(rise == 0, change, rise), 0.0, 1.0)

    start = jax.lax.stop_gradient(-curve[0] / change)
    return crosses, newton(curve, newton(tuple(map(jax.lax.stop_gradient, curve)), start))


@jax.custom_jvp
def first_root(curve: Quartics) -> Float[Array, "*k"]:
    """The first place in [0, 1] where functions change their sign; 1 where they do not. Derivatives of any order."""
    rule, (crosses, root) = _rule_of(curve), _roots(curve)
    places = _along(rule.points[:-1], root) + _along(rule.step, root) * root
    return jnp.min(jnp.where(crosses, places, 1.0), axis=0)


@first_root.defjvp
def _(primals: tuple[Quartics], tangents: tuple[Quartics]) -> tuple[Array, Array]:
    (curve,), (change,) = primals, tangents
    place = first_root(curve)
    rule, inside, t = _around(curve, place)
    height, rise = _value(change, t), _rate(curve, t)
    moved = -_along(rule.step, rise) * height / jnp.where(rise == 0, 1.0, rise)
    return place, jnp.where(place < 1, jnp.sum(jnp.where(inside, moved, 0.0), axis=0), 0.0)


def _around(curve: Quartics, place: Float[Array, "*k"]) -> tuple[Rule, Array, Array]:
    """The rule, and for each sub-interval whether it holds the place, and where in it the place is, from 0 to 1."""
    rule = _rule_of(curve)
    t = (place - _along(rule.points[:-1], curve[0])) / _along(rule.step, curve[0])
    return rule, (t > 0) & (t <= 1), t


def total_to(curve: Quartics, place: Float[Array, "*k"]) -> Float[Array, "*k"]:
    """The integral from the start of an element of width 1 to a place in [0, 1]."""
    rule, _, t = _around(curve, place)
    return jnp.sum(_along(rule.step, t) * _integral(curve, jnp.clip(t, 0.0, 1.0)), axis=0)


@jax.custom_jvp
def total_to_root(curve: Quartics, root: Float[Array, "*k"]) -> Float[Array, "*k"]:
    """The integral from the start of an element of width 1 to a root, which moves; but there the values are zero."""
    return total_to(curve, root)


@total_to_root.defjvp
def _(primals: tuple[Quartics, Array], tangents: tuple[Quartics, Array]) -> tuple[Array, Array]:
    return total_to_root(*primals), total_to(tangents[0], primals[1])


Size = Callable[[Array], Array]  # of a rate: the rate itself, its magnitude or its length
SizeOver = Callable[[Array, Quartics], Array]  # its integral over each sub-interval, from the rate and its quartics


def switched(
    size: Size, gains: SizeOver | None, branches: Float[Array, "branches p *k"], places: Float[Array, " places"]
) -> Float[Array, "q *k"]:
    """The integral of the size of a rate over the sub-intervals; the rate changes its branch at each place.

    Args:
        size: the rate itself, its magnitude or its length.
        gains: integrates it over sub-intervals that hold no place; None where it is the rate itself.
        branches: the rates at the nodes, one branch more than places; equal where they meet.
        places: in [0, 1] of the element, in increasing order.
    """
    rule, curve = gauss_rule(branches.shape[1]), jax.vmap(quartics)(branches)
    starts, step = (jnp.asarray(x, places.dtype) for x in (rule.points[:-1], rule.step))
    cuts = jnp.clip((places[:, None] - starts) / step, 0.0, 1.0)
    whole = jnp.ones_like(cuts[:1])
    first, last = jnp.concatenate([0 * whole, cuts]), jnp.concatenate([cuts, whole])
    shape = jax.eval_shape(size, curve[0]).shape  # the rates may be vectors
    first, last = (jnp.broadcast_to(x.reshape(x.shape + (1,) * (len(shape) - 2)), shape) for x in (first, last))

    def between(curve: Quartics, a: Array, b: Array) -> Array:
        a, b = (x.reshape(x.shape + (1,) * (curve[0].ndim - x.ndim)) for x in (a, b))
        return size(_integral(curve, b) - _integral(curve, a))

    found = _along(rule.step, first[0]) * with_slopes(between)(curve, first, last)
    # with `where`, XLA adds the few branches itself; without it the sum takes up to ten times as long, see `added_up`
    found = jnp.where(first < last, found, 0.0)
    if gains is not None:
        found = jnp.where((first <= 0) & (last >= 1), jax.vmap(gains)(branches, curve), found)
    return jnp.sum(found, axis=0)


def gains_of_length(rate: Float[Array, "p *k n"], curve: Quartics) -> Float[Array, "q *k"]:
    """The integral of the length of a vector over each sub-interval, also where the vector passes near zero.

    The length of the polynomial is integrated by Gauss points. What they miss is found on the quartic.
    """
    rule = gauss_rule(rate.shape[0])
    weights = jnp.asarray(legendre.leggauss(POINTS_BETWEEN)[1] / 2, rate.dtype)
    inner = jnp.tensordot(length_of(times(rule.inner, rate)), weights, ((1,), (0,)))
    return _along(rule.step, inner) * (inner + _missed(curve))


@with_slopes
def _missed(curve: Quartics) -> Float[Array, "q *k"]:
    """The integral of the length of quartics over [0, 1] less that by Gauss points.

    Near its minimum z, the length is about the root of alpha^2 + beta^2 (t - z)^2, whose integral has a closed form.
    The rest is integrated by Gauss points on either side of z.
    """
    nodes, weights = legendre.leggauss(POINTS_BETWEEN)
    nodes, weights = ((nodes + 1) / 2).tolist(), (weights / 2).tolist()  # of any precision, as Python numbers are
    z = _nearest(curve)
    value, rate = _value(curve, z[..., None]), _rate(curve, z[..., None])
    alpha, beta = dot(value, value), dot(rate, rate)
    cut = jnp.clip(z, 0.0, 1.0)

    def rest(t: Array) -> Array:
        return length_of(_value(curve, t[..., None])) - square_root(alpha + beta * (t - z) ** 2)

    found = _kernel(alpha, beta, 1.0 - z) + _kernel(alpha, beta, z)
    for node, weight in zip(nodes, weights, strict=True):
        found = found + weight * (cut * rest(cut * node) + (1 - cut) * rest(cut + (1 - cut) * node))
        found = found - weight * length_of(_value(curve, jnp.asarray(node, z.dtype)))
    return found


def _nearest(curve: Quartics) -> Float[Array, "q *k"]:
    """Where a quartic is nearest to zero: on its chord, and after one step of Newton's method; without derivatives."""

    def nearer(t: Array, value: Array, rate: Array) -> Array:
        speed = dot(rate, rate)
        return jnp.clip(t - dot(value, rate) / jnp.where(speed > 0, speed, 1.0), -0.5, 1.5)

    z = nearer(jnp.zeros_like(curve[0][..., 0]), curve[0], reduce(jnp.add, curve[1:]))
    return jax.lax.stop_gradient(nearer(z, _value(curve, z[..., None]), _rate(curve, z[..., None])))


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

    @property
    def nudge(self) -> Float[Array, ""]:
        """A step away from an edge, m, just large enough that rounding does not confuse the two sides of the edge."""
        return 8 * float(jnp.finfo(self.edges.dtype).eps) * self.edges[-1]

    def before_edge(self, arc_length: Float[Array, ""]) -> Float[Array, ""]:
        """The arc length, or just before it where an element ends: there cross-sections may jump."""
        ends = (self.edges == arc_length) & (self.edges > 0)
        return jnp.where(jnp.any(ends), arc_length - self.nudge, arc_length)

    def gain(self, rate: Float[Array, "P p *k"]) -> Float[Array, "P *k"]:
        """The integral of `rate` over each element."""
        return self._widths(rate) * (jnp.moveaxis(rate, 1, -1) @ jnp.asarray(self.rule.weights, rate.dtype))

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
        return self._widths(values) * (jnp.moveaxis(values, 1, -1) @ weights)

    def resample(
        self, start: Float[Array, "P *k"], values: Float[Array, "P p *k"], end: Float[Array, "P *k"], places: np.ndarray
    ) -> Array:
        """The polynomials through start, nodes and end of the elements, at other points in [0, 1] of each."""
        basis = legendre.legvander(2 * places - 1, self.order + 1) @ self.rule.interpolation
        return jax.vmap(lambda a, b, c: times(basis, jnp.concatenate([a[None], b, c[None]])))(start, values, end)

    def refined(self, values: Float[Array, "P p *k"], finer: "Elements") -> Float[Array, "Q q *k"]:
        """The polynomials through the nodes, at the nodes of elements into which each of these is divided equally."""
        parts = finer.nodes.shape[0] // self.nodes.shape[0]
        places = (np.arange(parts)[:, None] + finer.rule.nodes).ravel() / parts
        basis = legendre.legvander(2 * places - 1, self.order - 1) @ self.rule.series
        return jax.vmap(partial(times, basis))(values).reshape(*finer.nodes.shape, *values.shape[2:])

    def interpolate(self, start: Tree, values: Tree, end: Tree, arc_length: Float[Array, ""]) -> Tree:
        """The polynomials through start, nodes and end of the element that holds `arc_length`.

        Args:
            start, values, end: trees of arrays with leading axes P, (P, p) and P.
        """
        i, x = self._within(arc_length)
        x = 2 * x - 1
        basis = [jnp.ones_like(x), x]
        for n in range(1, self.order + 1):
            basis.append(((2 * n + 1) * x * basis[n] - n * basis[n - 1]) / (n + 1))
        weights = jnp.stack(basis) @ jnp.asarray(self.rule.interpolation, x.dtype)

        def at(a: Array, b: Array, c: Array) -> Array:
            return jnp.tensordot(weights, jnp.concatenate([a[i][None], b[i], c[i][None]]), 1)

        return jax.tree.map(at, start, values, end)

    def lagrange(self, place: Float[Array, ""]) -> Float[Array, " p"]:
        """The weights of the nodes in the value of their polynomial at a point in [0, 1].

        At a node, derivatives with respect to the point are wrong.
        """
        apart = place - jnp.asarray(self.rule.nodes, place.dtype)
        safe = jnp.where(apart == 0, jnp.finfo(apart.dtype).tiny ** 0.5, apart)
        terms = jnp.asarray(self.rule.barycentric, apart.dtype) / safe
        return terms / jnp.sum(terms)

    def _widths(self, values: Float[Array, "P p *k"]) -> Float[Array, "P *_"]:
        return self.width.reshape((-1, *[1] * (values.ndim - 2)))

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


def smooth_pieces(length: Float[Array, ""], breakpoints: Float[Array, " n"]) -> Float[Array, " ends"]:
    """Base, breakpoints and tip in increasing order. A breakpoint at an end of the body keeps its own derivative."""
    if not breakpoints.size:
        return jnp.stack([jnp.zeros_like(length), length])
    breaks = breakpoints.astype(length.dtype)
    breaks = jnp.where(breaks > length, length, jnp.where(breaks < 0, 0.0, breaks))
    return jnp.sort(jnp.concatenate([jnp.zeros_like(length)[None], breaks, length[None]]))


def elements_between(ends: Float[Array, " ends"], nodes: int, least: int = 1) -> Elements:
    """At least `least` elements of equal width between neighbouring ends, with at least `nodes` nodes together.

    One element of 16 nodes is far more accurate for a smooth body than two of 8.
    """
    count = max(least, -(-nodes // LARGEST_ORDER))
    order = -(-nodes // count)
    if count == 1:
        return Elements.between(ends, order)
    fraction = jnp.arange(count) / count
    starts = ends[:-1, None] + jnp.diff(ends)[:, None] * fraction.astype(ends.dtype)
    return Elements.between(jnp.concatenate([starts.ravel(), ends[-1:]]), order)
