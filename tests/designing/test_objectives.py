"""Means along bodies with joints and anchored tendons, against SciPy's integrals between these.

Exact kinematics, constant d, one tendon (docs/theory.md, (16)): T(s) = T_base / (1 + mu T_base d h(s) / E) with
h(s) = int_0^s dx / J, and kappa = T d / (E J) up to the anchor.
"""

import jax
import jax.numpy as jnp
import numpy as np
from bodies import paper_with
from scipy.integrate import quad

import cddf_jax as cddf
from cddf_jax.designing.body_quantities import BODY_QUANTITIES, BodyView

L, OFFSET, E, MU, T, BORE = 0.14, 10e-3, 1.4e6, 0.42, 50.0, 7e-3
STEP, TIP, END = 0.05, 15e-3, 0.11  # m: of the joint, of the radius behind it, of the tendon's anchor
WANTED = {"curvature": 8.0, "tension": 30.0, "outer_radius": 16e-3}
AIMS = (*map(cddf.Even, WANTED), *(cddf.Near(name, value) for name, value in WANTED.items()), cddf.Least("volume"))


class Plain:
    """The closed form; `numbers` are step, radius behind it and anchor."""

    def __init__(self, numbers):
        self.step, self.radius, self.end = numbers

    def outer_radius(self, s):
        return 20e-3 if s < self.step else self.radius

    def second_moment(self, s):
        return np.pi / 4 * (self.outer_radius(s) ** 4 - BORE**4)

    def tension(self, s):
        first = min(s, self.step) / self.second_moment(0.0)
        return T / (1 + MU * T * OFFSET * (first + max(s - self.step, 0.0) / self.second_moment(L)) / E)

    def curvature(self, s):
        return self.tension(s) * OFFSET / (E * self.second_moment(s)) if s < self.end else 0.0

    def mean(self, of, top):
        joints = [place for place in (self.step, self.end) if place < top]
        return quad(of, 0.0, top, points=joints, epsabs=0, epsrel=1e-13)[0] / top

    def values(self):
        even, near = [], []
        for name, wanted in WANTED.items():
            of, top = getattr(self, name), self.end if name == "tension" else L
            mean = self.mean(of, top)
            even.append(self.mean(lambda s, of=of, mean=mean: (of(s) / mean - 1) ** 2, top))
            near.append(self.mean(lambda s, of=of, wanted=wanted: (of(s) - wanted) ** 2, top))
        area = self.mean(lambda s: np.pi * (self.outer_radius(s) ** 2 - BORE**2), L)
        return np.array([*even, *near, area * L])


def test_means_between_joints_and_up_to_anchors_with_their_slopes():
    """A rule of 32 nodes from base to tip is wrong by some per cent, and counts tension beyond the anchor as 0.

    Slopes by the places of joint and anchor, over which integrands jump, and by the radius; central differences of
    fourth order.
    """

    def values(numbers):
        step, radius, end = numbers
        outer_radius = cddf.Piecewise(step[None], [cddf.Constant(20e-3), radius])
        body, case = paper_with(cddf.Tendon(OFFSET, end=end), outer_radius=outer_radius), cddf.LoadCase(T)
        view = BodyView(body, jnp.linspace(0.0, L, 15), case, case.solve(body, 8), 8)
        means = jnp.stack([aim.values(view) for aim in AIMS])
        return means, (means, BODY_QUANTITIES["tension"].of(view))

    numbers, h = np.array([STEP, TIP, END]), 1e-3
    slopes, (means, tension) = jax.jit(jax.jacfwd(values, has_aux=True))(numbers)
    plain = Plain(numbers)
    np.testing.assert_allclose(means, plain.values(), rtol=1e-9)
    reached = np.minimum(np.linspace(0.0, L, 15), END)  # beyond the anchor nothing is less or more than at it
    np.testing.assert_allclose(tension, [[plain.tension(s) for s in reached]], rtol=1e-9)
    for i, size in enumerate(numbers):
        move = np.eye(3)[i] * size * h
        near, far = (Plain(numbers + k * move).values() - Plain(numbers - k * move).values() for k in (1, 2))
        np.testing.assert_allclose(slopes[:, i] * size, (8 * near - far) / (12 * h), rtol=1e-6, atol=1e-12)
