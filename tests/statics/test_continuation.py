"""Which equilibrium is found where there are several, whether it is stable, and where there is none."""

import re

import numpy as np
import pytest
from bodies import PAPER, RIGIDITY, ROD, paper_body, paper_plain
from kinds import root_of
from loaded_bodies import (
    NotFoundError,
    PlainLoads,
    largest_difference,
    loaded_reference,
)
from scipy.special import jv

import cddf_jax as cddf

LENGTH = PAPER["length"]
AGREES = 1e-9  # the reference integrates with a relative tolerance of 1e-11 per step


def solved(loads: PlainLoads, tension=0.0, body=None, direction=+1):
    body = paper_body("exact") if body is None else body
    return cddf.solve(body, tension, cddf.Loads(*loads), direction=direction, throw=False)


def pressed(times, degrees):
    """A tip force in units of E J / L^2 at the middle of the paper's body."""
    force = times * 1.4e6 * paper_plain().second_moment(LENGTH / 2) / LENGTH**2
    angle = np.radians(degrees)
    return PlainLoads((float(force * np.cos(angle)), float(force * np.sin(angle))))


# --- straight columns ----------------------------------------------------------------------------

EULER = np.pi**2 * RIGIDITY / (4 * 0.2**2)
# Greenhill (1881): a column buckles under its weight at q L^3 = (9/4) j^2 E J, j the first zero of J_(-1/3): 7.837
ZERO = np.asarray(root_of(lambda x: jv(-1 / 3, x), 1.0, 3.0))
GREENHILL = 9 / 4 * ZERO**2 * RIGIDITY / (0.2**3 * 1000.0 * np.pi * 0.004**2)


def rod():
    return cddf.conical(**ROD, density=1000.0)


COLUMNS = {
    "pressed": lambda fraction: PlainLoads((-fraction * EULER, 0.0)),
    "under its weight": lambda fraction: PlainLoads(gravity=(-fraction * GREENHILL, 0.0)),
}


@pytest.mark.parametrize("column", COLUMNS)
@pytest.mark.parametrize("fraction", [0.999, 1.001, 12.0])
def test_a_straight_column_is_stable_up_to_its_critical_load(column, fraction):
    """Euler: pi^2 E J / (4 L^2). Greenhill: 7.837 E J / L^3 per length. Beyond, straight is unstable."""
    assert abs(GREENHILL * 0.2**3 * 1000.0 * np.pi * 0.004**2 / RIGIDITY - 7.837) < 1e-3
    loads = COLUMNS[column](fraction)
    solution = solved(loads, body=rod())
    assert bool(solution.stable) == (fraction < 1)
    assert solution.status == (cddf.Status.successful if fraction < 1 else cddf.Status.unstable)
    np.testing.assert_array_equal(solution.curvature, 0.0)
    np.testing.assert_allclose(solution.tip_position, [0.2, 0.0], atol=1e-12)
    assert solution.load_fraction == 1.0
    if fraction == 1.001:
        with pytest.raises(cddf.SolveError, match="The equilibrium is unstable"):
            cddf.solve(rod(), 0.0, cddf.Loads(*loads))


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.95, 1.05])
def test_equal_tendons_stiffen_a_column_in_the_published_kinematics(fraction):
    """E J kappa = sum sigma d T (1 - sigma d kappa): 2 T d^2 adds to E J, docs/theory.md."""
    tension = 0.3 * RIGIDITY / 0.002**2
    critical = EULER * (1 + 2 * tension * 0.002**2 / RIGIDITY)
    assert critical > 1.5 * EULER
    pair = cddf.conical(**ROD, num_tendons=2, kinematics="published")
    solution = solved(PlainLoads((-fraction * critical, 0.0)), tension, pair)
    assert bool(solution.stable) == (fraction < 1)
    np.testing.assert_allclose(solution.curvature, 0.0, atol=1e-9)


# --- which equilibrium ---------------------------------------------------------------------------


HARD = {
    # tension (N), force in E J / L^2, its angle (degrees), least number of steps, least tip angle (degrees)
    "against the tendon": (60.0, 4.0, 240.0, 3, -180.0),
    "curled past 170 degrees": (60.0, 8.0, 180.0 + 20.0, 4, 165.0),
    "turned over, steeply": (30.0, 4.0, 205.0, 5, -180.0),
    # near a buckling load an unstable branch runs close to the path; a long step may land on it
    "aside from the unstable branch": (10.0, 6.0, 185.0, 1, -180.0),
}


CHANGING_SIGN = [case for case in HARD if not case.startswith("aside")]


@pytest.mark.parametrize("case", HARD)
def test_the_end_of_the_path(case):
    """The equilibrium to which SciPy's reference comes in small steps."""
    tension, times, degrees, steps, angle = HARD[case]
    loads, plain = pressed(times, degrees), paper_plain("exact")
    solution = solved(loads, tension)
    assert solution.status == cddf.Status.successful
    assert solution.num_load_steps >= steps
    assert np.degrees(float(solution.tip_angle)) > angle
    difference = largest_difference(solution, loaded_reference(plain, tension, loads), plain)
    if case in CHANGING_SIGN:  # of their curvature, where `solve` promises 1e-7 of the length
        assert difference < min(1e-7, max(AGREES, float(solution.error_estimate)))
    else:
        assert difference < AGREES


# --- where the path ends -------------------------------------------------------------------------

# tension (N), force in E J / L^2, its angle: bent up by the tendon and pressed down and back, the body snaps through
SNAPPING = {"60 N": (60.0, 4.0, 213.5), "45 N": (45.0, 4.0, 206.0)}


def limit(plain, tension, loads):
    """The largest part of the loads to which the reference finds a way, within 1e-4."""
    with pytest.raises(NotFoundError) as error:
        loaded_reference(plain, tension, loads)
    found = re.search(r"beyond ([0-9.]+) of", str(error.value))
    assert found
    return float(found[1])


@pytest.mark.parametrize("case", SNAPPING)
def test_a_body_that_snaps(case):
    """The path ends in a fold; near it the moment goes like the root of what is left, so that 3e-3 is close."""
    tension, times, degrees = SNAPPING[case]
    loads = pressed(times, degrees)
    fold = limit(paper_plain("exact"), tension, loads)
    solution = solved(loads, tension)
    assert solution.status == cddf.Status.load_limit
    np.testing.assert_allclose(solution.load_fraction, fold, atol=3e-3)
    for name in ("tip_tension", "position", "curvature", "tension", "base_moment", "error_estimate"):
        assert np.all(np.isnan(getattr(solution, name))), name
    assert not solution.stable
    with pytest.raises(cddf.SolveError, match=rf"up to {100 * float(solution.load_fraction):.3g} % of the loads"):
        cddf.solve(paper_body("exact"), tension, cddf.Loads(*loads))
    # a little less is carried, a little more is not; in the last percent before a fold errors grow without bound
    below = solved(loads.times(0.98 * fold), tension)
    assert below.status == cddf.Status.successful
    assert below.stable
    assert solved(loads.times(1.01 * fold), tension).status == cddf.Status.load_limit
