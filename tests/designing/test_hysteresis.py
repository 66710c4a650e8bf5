"""A quantity of a person's own, the width of the loop of the tip angle, against closed forms (docs/hysteresis.md).

Exact kinematics, constant d, one tendon, g = mu d H / E with H = int_0^L ds / J. Pulled up from a low tension, and all
slid in, mu phi = ln(1 + g T). On the way down from T_max, with the front inside,
mu phi = ln[y (y_0 + g) / ((y + y_0) / 2)^2] with y = 1/T and y_0 = 1/T_max.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, paper_body, paper_plain, replaced

import cddf_jax as cddf

L, MU = PAPER["length"], PAPER["friction_coefficient"]
LOW, AT, HIGH = 5.0, 40.0, 75.0


def closed(g, mu, low=LOW, at=AT, high=HIGH):
    """The width, rad."""
    y, before = 1 / at, 1 / high
    assert (y - before) / 2 < g < (1 / low - y) / 2
    return np.log(y * (before + g) / ((y + before) / 2) ** 2 / (1 + g * at)) / mu


FLOW = paper_plain("exact").compliance(L)  # d H, 1/m^2


def width(body, equilibrium):
    at = equilibrium.base_tension[0]
    angle = cddf.trace(body, jnp.stack([HIGH + 0 * at, at, LOW + 0 * at, at])).tip_angle
    return angle[1] - angle[3]


@pytest.mark.slow
def test_a_design_of_the_narrowest_loop_has_the_width_of_the_closed_form():
    """The modulus of least width among those that bend to 0.9 rad at 40 N."""
    found = cddf.design(
        paper_body("exact"),
        cddf.Least(width),
        free=("youngs_modulus",),
        bounds={"youngs_modulus": (0.5e6, 5e6)},
        constraints=[cddf.Limit("tip_angle", least=0.9)],
        cases=cddf.LoadCase(AT),
        nodes=8,
    )
    assert found.success
    assert found.objectives[0].start == pytest.approx(closed(MU * FLOW / 1.4e6, MU), rel=1e-7)
    # where a pull to the middle tension bends the tip by a given angle the width is the same for all bodies
    assert found.objective == pytest.approx(closed(np.expm1(MU * 0.9) / AT, MU), rel=1e-6)
    assert found.value["youngs_modulus"] == pytest.approx(MU * FLOW * AT / np.expm1(0.9 * MU), rel=1e-6)


@pytest.mark.slow
def test_the_width_of_a_body_and_its_slopes_in_both_modes():
    """By modulus, friction and tension, against differences of the closed form, right to 1e-8."""

    def width_by(p):
        body = replaced(paper_body("exact"), youngs_modulus=p[0] * 1e6, friction_coefficient=p[1])
        return width(body, cddf.solve(body, p[2], throw=False))

    def plain(p):
        return closed(p[1] * FLOW / (p[0] * 1e6), p[1], at=p[2])

    at = np.array([1.2, 0.42, AT])
    value, forward, reverse = both_modes(width_by)(at)
    slopes = [(plain(at + step) - plain(at - step)) / (2 * np.max(step)) for step in np.diag(1e-4 * at)]
    assert value == pytest.approx(plain(at), rel=1e-9)
    assert forward == pytest.approx(slopes, rel=1e-6, abs=1e-9)
    assert reverse == pytest.approx(np.asarray(forward), rel=1e-9, abs=1e-12)
