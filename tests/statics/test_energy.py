"""Work and energy along a pull: the closed form of one tendon, and the balance in every configuration."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain
from scipy.integrate import quad

import cddf_jax as cddf

LENGTH, d, MU, E = (PAPER[name] for name in ("length", "tendon_offset", "friction_coefficient", "youngs_modulus"))
CLOSES = 1e-11  # of the work: Gauss quadrature of smooth functions along the pull
LOADS = cddf.Loads(tip_force=(0.5, 2.0), tip_moment=0.05, gravity=(0.0, 9.81))


def left_over(balance):
    """The residual over the work that went in and out."""
    return abs(float(balance.residual)) / float(jnp.sum(jnp.abs(balance.actuation_work)))


def test_one_tendon_against_the_closed_form():
    """The closed form of docs/theory.md (16), exact kinematics and constant d.

    With a = mu G(L) / E: pulled length d ln(1 + a T) / mu, so W = (d / mu)(T - ln(1 + a T) / a), and
    U = int (T(s) d)^2 / (2 E J) ds; what is left is friction.
    """
    plain, tension = paper_plain("exact"), 75.0
    a = MU * plain.compliance(plain.length) / E
    work = d / MU * (tension - np.log1p(a * tension) / a)

    def bending(s):
        return (plain.closed_form(tension, s) * d) ** 2 / (2 * E * plain.second_moment(s))

    elastic = quad(bending, 0, plain.length, epsabs=0, epsrel=1e-12)[0]
    balance = cddf.energy_balance(paper_body("exact"), tension)
    assert balance.actuation_work == pytest.approx([work], rel=CLOSES)
    assert balance.elastic_energy == pytest.approx(elastic, rel=CLOSES)
    assert balance.friction_loss == pytest.approx([work - elastic], rel=1e-10)
    assert balance.load_work == 0.0
    assert balance.status == cddf.Status.successful


def pair(heights, other, end):
    """One tendon along straight lines through three points, and one that is straight, both anchored at `end`.

    Where the points do not lie on one line it bends sharply.
    """
    bent = cddf.Tendon(cddf.Piecewise.linear([0.0, 0.06, LENGTH], heights), end=end)
    return replace(paper_body("exact"), tendons=(bent, cddf.Tendon(cddf.Linear(*other, LENGTH), -1, end=end)))


def parallel_tendons(axial_stiffness=1e30, free_length=0.0, friction_coefficient=MU):
    """Two tendons that stretch, by a negligible amount unless stated; one compiled program for all of them."""
    tendons = (cddf.Tendon(d, side, axial_stiffness=axial_stiffness, free_length=free_length) for side in (+1, -1))
    body = paper_body("exact", density=1100.0, friction_coefficient=friction_coefficient)
    return replace(body, tendons=tuple(tendons))


ONE_PULLS, IN_OUT = (75.0, 0.0), (+1, -1)  # the other tendon has no tension
MIDDLE = 0.012 - 0.003 * 0.06 / LENGTH  # on the line from 12 to 9 mm
EXACT = {
    "loads that help": (parallel_tendons(), ONE_PULLS, LOADS, IN_OUT),
    "slanted antagonists": (pair((0.012, MIDDLE, 0.009), (0.012, 0.009), LENGTH), (75.0, 20.0), None, IN_OUT),
    "a sharp bend": (pair((0.012, 0.009, 0.009), (d, d), 0.1), ONE_PULLS, None, IN_OUT),
    "tendons that stretch": (parallel_tendons(3000.0, 0.3), (60.0, 30.0), LOADS, IN_OUT),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_the_balance_closes_in_the_exact_kinematics(name):
    """Virtual work, docs/theory.md: the work of the tendons is stored, lost to friction, or lifts the loads."""
    body, tension, loads, direction = EXACT[name]
    balance = cddf.energy_balance(body, tension, loads, direction=direction)
    assert left_over(balance) < CLOSES
    if name != "tendons that stretch":  # an antagonist that stretches slides in before the body takes it out again
        assert np.all(balance.friction_loss >= 0)


@pytest.mark.slow
def test_a_load_that_opposes_and_is_overcome():
    """While the curvature changes sign the balance closes with the number of steps only."""
    body, loads = parallel_tendons(), cddf.Loads(tip_force=(0.0, -2.0))
    coarse, fine = (cddf.energy_balance(body, ONE_PULLS, loads, direction=IN_OUT, num_steps=n) for n in (16, 64))
    assert left_over(fine) < 2e-5 < left_over(coarse) < 5e-4
    assert fine.load_work > 0
    ends = [cddf.solve(body, pulls, loads, direction=IN_OUT).tip_position for pulls in ((0.0, 0.0), ONE_PULLS)]
    lifted = -np.dot((0.0, -2.0), ends[1] - ends[0])
    assert fine.load_work == pytest.approx(lifted, rel=1e-12)


def test_the_published_kinematics_have_a_residual():
    """Arm d (1 - d kappa), travel int d kappa: not consistent with virtual work (docs/theory.md)."""
    balance = cddf.energy_balance(paper_body("published"), 75.0)
    assert 0.03 < left_over(balance) < 0.07
    assert balance.residual > 0
    assert balance.friction_loss[0] > 0


def test_a_failed_solve():
    unbalanced = cddf.energy_balance(paper_body("exact"), float("nan"), throw=False)
    assert unbalanced.status == cddf.Status.unphysical
    assert np.isnan(unbalanced.elastic_energy)
    with pytest.raises(cddf.SolveError, match="not physical"):
        cddf.energy_balance(paper_body("exact"), float("nan"))
