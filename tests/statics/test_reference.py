"""Both kinematics against SciPy's integrators, which share no line with the library (see bodies.py)."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import (
    PAPER,
    constant,
    paper_body,
    paper_plain,
    paper_with,
    straight,
)
from kinds import of_kind
from loaded_bodies import largest_difference, reference_solution
from scipy.interpolate import CubicSpline

import cddf_jax as cddf

LENGTH = PAPER["length"]
TENSION = 1e-8  # relative; the accuracy that issue 2 asks of the default
POSITION = 1e-7  # of positions and displacements, per length, and of angles
ALONG = 1e-6  # rad and per length: between the nodes the interpolant has degree 8, not the order 16 of the ends


def compare(body, plain, base_tension, direction: int | tuple[int, ...] = +1):
    solution = cddf.solve(body, base_tension, direction=direction)
    reference = reference_solution(plain, base_tension, direction)
    np.testing.assert_allclose(solution.tip_tension, reference.tip_tension, rtol=TENSION)
    assert largest_difference(solution, reference, plain) < POSITION
    at = np.linspace(0, reference.arc_length.size - 1, 12).astype(int)  # one shape for every case
    along = of_kind(cddf.Fields, solution.at(reference.arc_length[at]))
    np.testing.assert_allclose(along.heading, reference.heading[at], atol=ALONG)
    np.testing.assert_allclose(along.position, reference.position[at], atol=ALONG * LENGTH)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("direction", [+1, -1], ids=["in", "out"])
def test_one_tendon(kinematics, direction):
    compare(paper_body(kinematics), paper_plain(kinematics), 30.0, direction)


PARALLEL, SLANTED = (0.010, 0.010), (0.012, 0.009)


@pytest.mark.parametrize(
    ("first", "second", "end", "direction", "tension"),
    [
        (PARALLEL, PARALLEL, None, (+1, +1), (75.0, 20.0)),
        (PARALLEL, PARALLEL, None, (-1, +1), (30.0, 40.0)),
        (SLANTED, SLANTED, None, (+1, -1), (75.0, 20.0)),
        (SLANTED, SLANTED, None, (-1, +1), (30.0, 60.0)),
        pytest.param(PARALLEL, SLANTED, 0.08, (+1, -1), (40.0, 15.0), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_two_tendons(first, second, end, direction, tension):
    """Antagonists by their offsets at base and tip. One structure for slanted and parallel ones.

    Where the first ends before the tip, the curvature jumps, and with it the angle of the slanted one to the axis.
    """
    one, other = (cddf.Tendon(cddf.Linear(*ends, length=LENGTH), side) for ends, side in ((first, +1), (second, -1)))
    offsets = [straight(*ends, length=LENGTH) for ends in (first, second)]
    slopes = [constant((tip - base) / LENGTH) for base, tip in (first, second)]
    ends = (LENGTH if end is None else end, LENGTH)
    plain = paper_plain("exact", (+1, -1), offsets=offsets, slopes=slopes, ends=ends)
    compare(paper_with(replace(one, end=end), other), plain, tension, direction)


@pytest.mark.slow
def test_three_tendons_with_their_own_friction():
    offsets, friction, sides = (0.010, 0.012, 0.008), (0.42, 0.1, 0.3), (+1, -1, +1)
    tendons = [cddf.Tendon(*numbers[:2], None, numbers[2]) for numbers in zip(offsets, sides, friction, strict=True)]
    plain = paper_plain("exact", sides, offsets=[constant(d) for d in offsets], friction=list(friction))
    compare(paper_with(*tendons), plain, (40.0, 10.0, 15.0), (+1, -1, +1))


KNOTS = np.array([0.0, 0.05, 0.10, LENGTH])


CONVERGING, DIVERGING = (base + (tip - base) * KNOTS / LENGTH for base, tip in ((0.012, 0.009), (0.008, 0.0115)))


@pytest.mark.parametrize(
    ("kinematics", "heights", "direction"),
    [
        ("exact", CONVERGING, +1),
        ("exact", DIVERGING, -1),
        pytest.param("published", CONVERGING, +1, marks=pytest.mark.slow),
        pytest.param("published", DIVERGING, -1, marks=pytest.mark.slow),
        ("exact", np.array([0.008, 0.012, 0.010, 0.010]), +1),
        ("exact", np.array([0.012, 0.008, 0.011, 0.010]), -1),
    ],
)
def test_one_tendon_along_straight_lines(kinematics, heights, direction):
    """In the exact kinematics T jumps by exp(-mu |delta psi|) where the tendon turns by a finite angle, at a knot."""
    slope = np.diff(heights) / np.diff(KNOTS)

    def slope_at(s):
        return slope[min(np.searchsorted(KNOTS, s, side="right") - 1, 2)]

    offset = [lambda s: np.interp(s, KNOTS, heights)]
    plain = paper_plain(kinematics, offsets=offset, slopes=[slope_at], breaks=(0.05, 0.10))
    tendon = cddf.Tendon(cddf.Piecewise.linear(KNOTS, heights))
    compare(paper_with(tendon, kinematics=kinematics), plain, 30.0, direction)


SPLINE_KNOTS = np.array([0.0, 0.03, 0.06, 0.10, 0.14])
SPLINE_HEIGHTS = np.array([0.0100, 0.0108, 0.0110, 0.0103, 0.0090])


@pytest.mark.slow
def test_a_spline_offset():
    offset = CubicSpline(SPLINE_KNOTS, SPLINE_HEIGHTS, bc_type="not-a-knot")
    plain = paper_plain("exact", offsets=[offset], slopes=[offset.derivative()], breaks=tuple(SPLINE_KNOTS[1:-1]))
    compare(paper_with(cddf.Tendon(cddf.Spline(SPLINE_KNOTS, SPLINE_HEIGHTS))), plain, 60.0)


def test_nothing_bends_beyond_the_last_anchor():
    solution = cddf.solve(paper_with(cddf.Tendon(0.010, end=0.08)), 40.0)
    beyond = of_kind(cddf.Fields, solution.at([0.0800001, 0.1, 0.14]))
    np.testing.assert_array_equal(beyond.curvature, 0.0)
    np.testing.assert_array_equal(beyond.tension, 0.0)
    np.testing.assert_allclose(beyond.heading, solution.tip_angle, atol=1e-12)
    # docs/theory.md (16), closed form of SciPy at the anchor
    np.testing.assert_allclose(solution.tip_tension, [paper_plain().closed_form(40.0, 0.08)], rtol=TENSION)


def test_a_step_of_the_section():
    step = cddf.Piecewise([0.05, 0.09], [cddf.Constant(0.020), cddf.Constant(0.014), cddf.Constant(0.017)])
    plain = paper_plain(
        "exact", outer_radius=lambda s: 0.020 if s < 0.05 else 0.014 if s < 0.09 else 0.017, breaks=(0.05, 0.09)
    )
    compare(paper_with(cddf.Tendon(0.010), outer_radius=step), plain, 40.0)
