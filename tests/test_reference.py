"""Both kinematics against SciPy's integrators, which share no line with the library (see bodies.py)."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    PAPER,
    constant,
    fields_at,
    paper_body,
    paper_plain,
    reference_solution,
    straight,
    two_slanted_tendons,
)
from scipy.interpolate import CubicSpline

import cddf_jax as cddf

LENGTH = PAPER["length"]
TENSION = 1e-8  # relative; the accuracy that issue 2 asks of the default
POSITION = 1e-7  # per length
ALONG = 1e-6  # rad and per length: between the nodes the interpolant has degree 8, not the order 16 of the ends

TAPER = cddf.Linear(0.020, 0.013, LENGTH)
PAIR = (+1, -1)


def manipulator(kinematics, *tendons, outer_radius=TAPER):
    return cddf.Manipulator(LENGTH, outer_radius, 0.007, tendons, 1.4e6, 0.42, kinematics=kinematics)


def compare(body, plain, base_tension, direction=+1, nodes=16):
    solution = cddf.solve(body, base_tension, direction=direction, nodes=nodes)
    reference = reference_solution(plain, base_tension, direction)
    np.testing.assert_allclose(solution.tip_tension, reference.tip_tension, rtol=TENSION)
    np.testing.assert_allclose(solution.tip_position, reference.tip_position, atol=POSITION * LENGTH)
    np.testing.assert_allclose(solution.tip_angle, reference.tip_angle, atol=POSITION)
    np.testing.assert_allclose(solution.wrap_angle[:, -1], reference.wrap_angle, atol=POSITION)
    np.testing.assert_allclose(solution.tendon_displacement, reference.displacement, atol=POSITION * LENGTH)
    at = np.linspace(0, reference.arc_length.size - 1, 12).astype(int)  # one shape for every case
    along = fields_at(solution, reference.arc_length[at])
    np.testing.assert_allclose(along.heading, reference.heading[at], atol=ALONG)
    np.testing.assert_allclose(along.position, reference.position[at], atol=ALONG * LENGTH)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("direction", [+1, -1], ids=["in", "out"])
def test_one_tendon(kinematics, direction):
    compare(paper_body(kinematics), paper_plain(kinematics), 30.0, direction)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("direction", [(+1, +1), (+1, -1), (-1, +1)], ids=str)
def test_two_tendons(kinematics, direction):
    tension = (75.0, 20.0) if direction[0] > 0 else (30.0, 40.0)
    compare(paper_body(kinematics, num_tendons=2), paper_plain(kinematics, PAIR), tension, direction)


def test_three_tendons_with_their_own_friction():
    offsets, friction, sides = (0.010, 0.012, 0.008), (0.42, 0.1, 0.3), (+1, -1, +1)
    tendons = [cddf.Tendon(*numbers[:2], None, numbers[2]) for numbers in zip(offsets, sides, friction, strict=True)]
    plain = paper_plain("exact", sides, offsets=[constant(d) for d in offsets], friction=list(friction))
    compare(manipulator("exact", *tendons), plain, (40.0, 10.0, 15.0), (+1, -1, +1))


def slanted_plain(kinematics, sides, base=0.012, tip=0.009):
    count = len(sides)
    offsets, slopes = [straight(base, tip, LENGTH)] * count, [constant((tip - base) / LENGTH)] * count
    return paper_plain(kinematics, sides, offsets=offsets, slopes=slopes)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("direction", [+1, -1], ids=["in", "out"])
@pytest.mark.parametrize(("base", "tip"), [(0.012, 0.009), (0.008, 0.0115)], ids=["converging", "diverging"])
def test_one_slanted_tendon(kinematics, direction, base, tip):
    body = paper_body(kinematics, tendon_offset=(base, tip))
    compare(body, slanted_plain(kinematics, (+1,), base, tip), 30.0, direction)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("direction", [(+1, +1), (+1, -1)], ids=str)
def test_two_slanted_tendons(kinematics, direction):
    compare(two_slanted_tendons(kinematics), slanted_plain(kinematics, PAIR), (75.0, 20.0), direction)


def test_a_tendon_sliding_out_beside_one_sliding_in_slanted():
    compare(two_slanted_tendons("exact"), slanted_plain("exact", PAIR), (30.0, 60.0), (-1, +1))


SPLINE_KNOTS = np.array([0.0, 0.03, 0.06, 0.10, 0.14])
SPLINE_HEIGHTS = np.array([0.0100, 0.0108, 0.0110, 0.0103, 0.0090])


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_a_spline_offset(kinematics):
    scipy_spline = CubicSpline(SPLINE_KNOTS, SPLINE_HEIGHTS, bc_type="not-a-knot")
    plain = paper_plain(
        kinematics, offsets=[scipy_spline], slopes=[scipy_spline.derivative()], breaks=tuple(SPLINE_KNOTS[1:-1])
    )
    compare(manipulator(kinematics, cddf.Tendon(cddf.Spline(SPLINE_KNOTS, SPLINE_HEIGHTS))), plain, 60.0)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_a_tendon_that_ends_before_the_tip(kinematics):
    body = manipulator(kinematics, cddf.Tendon(0.010, end=0.08), cddf.Tendon(0.011))
    plain = paper_plain(kinematics, (+1, +1), offsets=[constant(0.010), constant(0.011)], ends=(0.08, LENGTH))
    compare(body, plain, (40.0, 30.0))


def test_a_tendon_that_ends_beside_a_slanted_one_makes_it_turn():
    """The curvature jumps where the first ends, and with it the slanted tendon's angle to the axis."""
    body = manipulator("exact", cddf.Tendon(0.010, end=0.08), cddf.Tendon(cddf.Linear(0.012, 0.009, LENGTH)))
    offsets, slopes = [constant(0.010), straight(0.012, 0.009, LENGTH)], [constant(0.0), constant(-0.003 / LENGTH)]
    plain = paper_plain("exact", (+1, +1), offsets=offsets, slopes=slopes, ends=(0.08, LENGTH))
    compare(body, plain, (40.0, 30.0))


def test_nothing_bends_beyond_the_last_anchor():
    solution = cddf.solve(manipulator("exact", cddf.Tendon(0.010, end=0.08)), 40.0)
    beyond = fields_at(solution, np.array([0.0800001, 0.1, 0.14]))
    np.testing.assert_array_equal(beyond.curvature, 0.0)
    np.testing.assert_array_equal(beyond.tension, 0.0)
    np.testing.assert_allclose(beyond.heading, solution.tip_angle, atol=1e-12)
    # design.md section 3, closed form of SciPy at the anchor
    np.testing.assert_allclose(solution.tip_tension, [paper_plain().closed_form(40.0, 0.08)], rtol=TENSION)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_a_step_of_the_section(kinematics):
    step = cddf.Piecewise([0.05, 0.09], [cddf.Constant(0.020), cddf.Constant(0.014), cddf.Constant(0.017)])
    plain = paper_plain(
        kinematics, outer_radius=lambda s: 0.020 if s < 0.05 else 0.014 if s < 0.09 else 0.017, breaks=(0.05, 0.09)
    )
    compare(manipulator(kinematics, cddf.Tendon(0.010), outer_radius=step), plain, 40.0)


def kinked_plain(heights, sides=(+1,)):
    knots, heights = np.array([0.0, 0.05, 0.10, LENGTH]), np.asarray(heights)
    slope = np.diff(heights) / np.diff(knots)

    def slope_at(s):
        return slope[min(np.searchsorted(knots, s, side="right") - 1, 2)]

    count = len(sides)
    return paper_plain(
        "exact",
        sides,
        offsets=[lambda s: np.interp(s, knots, heights)] * count,
        slopes=[slope_at] * count,
        breaks=(0.05, 0.10),
    )


@pytest.mark.parametrize("direction", [+1, -1], ids=["in", "out"])
@pytest.mark.parametrize("heights", [(0.008, 0.012, 0.010, 0.010), (0.012, 0.008, 0.011, 0.010)], ids=["out", "in"])
def test_a_kinked_tendon_loses_tension_at_the_kink(direction, heights):
    """In the exact kinematics T jumps by exp(-mu |delta psi|) where the tendon turns by a finite angle."""
    body = manipulator("exact", cddf.Tendon(cddf.Piecewise.linear([0.0, 0.05, 0.10, LENGTH], heights)))
    compare(body, kinked_plain(heights), 30.0, direction)


def test_the_jump_at_a_kink_is_the_capstan_of_its_angle():
    heights = (0.008, 0.012, 0.010, 0.010)
    body = manipulator("exact", cddf.Tendon(cddf.Piecewise.linear([0.0, 0.05, 0.10, LENGTH], heights)))
    solution = cddf.solve(body, 30.0)
    gap = 1e-9
    before, after = (fields_at(solution, jnp.asarray(0.05 + side * gap)) for side in (-1, +1))
    # psi = phi + atan2(d', 1 - d kappa), design.md section 2; d' = 0.08 before, -0.04 after
    psi = [
        float(at.heading + np.arctan2(slope, 1 - 0.012 * at.curvature))
        for at, slope in ((before, 0.08), (after, -0.04))
    ]
    jump = np.exp(-0.42 * abs(psi[1] - psi[0]))
    assert jump < 0.97
    np.testing.assert_allclose(after.tension / before.tension, [jump], rtol=1e-7)  # 2 gap kappa_c is of this size
