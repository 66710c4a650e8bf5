"""Designs of bodies in space, whose tendons find their way around the axis and their distance from it.

A straight tube of constant stiffness. Its own closed forms, with the torsional stiffness 2 G J = 2 E J / 3 of a
Poisson's ratio of 0.5:

Parallel tendon: what turns is P = T_base d / (E J), and the angle to the base phi(s) = ln(1 + mu P s) / mu in the plane
at the angle of the tendon, as in the plane (docs/theory.md).

Helix: in the frame that winds with the tendon the strain has two components, twist u and bending b about the binormal,
2 G J u = -T d sin(theta) and E J b = T d cos(theta). The tendon rises by theta: tan(theta) = d (u + w) / (1 - d b).
"""

from functools import lru_cache
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from kinds import of_kind, root_of
from matplotlib.figure import Figure
from read_back import y_of
from refusals import refused
from scipy.integrate import quad, solve_ivp
from scipy.optimize import minimize_scalar

import cddf_jax as cddf
from cddf_jax.designing.body_quantities import BODY_QUANTITIES, BodyView
from cddf_jax.figures.designs import design_figure, draw_design

L, E, MU, POISSON = 0.14, 1.4e6, 0.2, 0.5
EJ = E * np.pi / 4 * (12e-3**4 - 4e-3**4)
NEAREST, FARTHEST = 5e-3, 10e-3  # m, of a tendon from the axis
FEW = 8  # nodes


def tube(*tendons, **others):
    numbers: dict[str, Any] = {"length": L, "outer_radius": 12e-3, "inner_radius": 4e-3, "youngs_modulus": E}
    return cddf.Manipulator(tendons=tendons, **{**numbers, "friction_coefficient": MU, **others})


def arc(pull):
    """Where the tip comes along the axis and across: of a parallel tendon with T_base d / (E J) = pull, 1/m."""

    def angle(s):
        return np.log1p(MU * pull * s) / MU

    return [quad(lambda s, of=of: of(angle(s)), 0.0, L, epsabs=0, epsrel=1e-13)[0] for of in (np.cos, np.sin)]


# --- least tension for a pose --------------------------------------------------------------------


@pytest.mark.slow
def test_the_least_tension_for_a_pose():
    """The pose tells the angle and T d: the tendon goes as far out as it may, and T is proportional to 1 / d."""
    (along, across), tension = arc(8.0), 8.0 * EJ / FARTHEST
    found = cddf.design(
        tube(cddf.Tendon(7e-3, angle=0.5)),
        cddf.Least("base_tension"),
        free=("tendons.0.angle", "tendons.*.offset", "base_tension"),
        bounds={"tendons.*.offset": (NEAREST, FARTHEST)},
        constraints=[
            cddf.Limit("tip_y", equal=across * np.cos(2.0)),
            cddf.Limit("tip_z", equal=across * np.sin(2.0)),
        ],
        cases=cddf.LoadCase(10.0, direction=1),
        nodes=FEW,
    )
    assert found.success
    assert found.value["tendons.0.angle"] == pytest.approx(2.0, abs=1e-7)
    assert found.value["base_tension"] == pytest.approx(tension, rel=1e-7)
    assert found.free["tendons.0.offset"].status == "at upper bound"
    assert found.free["tendons.0.offset"].multiplier == pytest.approx(tension / FARTHEST, rel=1e-6)
    assert found.equilibria[0].tip_position[0] == pytest.approx(along, rel=1e-8)
    angle = found.free["tendons.0.angle"]
    assert (angle.start, angle.status) == (0.5, "inside")
    assert (angle.lower, angle.upper) == pytest.approx((0.5 - np.pi, 0.5 + np.pi))  # half a turn either way


# --- most twist ----------------------------------------------------------------------------------


def risen(tension, d, w):
    """The angle theta at which a helix of w rad/m rises, and its derivative by the tension."""

    def strains(theta):
        return -tension * d * np.sin(theta) / (2 * EJ / (2 * (1 + POISSON))), tension * d * np.cos(theta) / EJ

    def miss(theta):
        u, b = strains(theta)
        return np.sin(theta) * (1 - d * b) - np.cos(theta) * d * (u + w)

    theta = root_of(miss, -np.pi / 2, np.pi / 2, xtol=1e-15)
    return theta, *strains(theta)


def tip_twist(turns, base_tension, d):
    """With friction: the tangent (cos theta, 0, sin theta) of the winding frame turns by theta' and, across it, by
    a = b cos(theta) - (u + w) sin(theta). T' = -mu T |(theta', a)| with theta' = T' dtheta/dT is solved for T'."""
    w = 2 * np.pi * turns / L

    def rate(_, tension):
        theta, u, b = risen(tension[0], d, w)
        h = 1e-4 * tension[0]
        slope = (risen(tension[0] + h, d, w)[0] - risen(tension[0] - h, d, w)[0]) / (2 * h)
        a = b * np.cos(theta) - (u + w) * np.sin(theta)
        return [-MU * tension[0] * abs(a) / np.sqrt(1 - (MU * tension[0] * slope) ** 2)]

    left = solve_ivp(rate, (0.0, L), [base_tension], rtol=1e-11, atol=1e-12, method="DOP853").y[0, -1]
    return risen(left, d, w)[1]


@pytest.mark.slow
def test_the_most_twist_of_a_helix():
    """More turns twist more and lose more tension: in between is the most that reaches the tip, as SciPy finds it.

    One tendon is pulled, and another winds beside it. At about half a turn the tendon is straight and loses nothing,
    and the body winds around it: that is a kink.
    """
    tendons = [cddf.Tendon(8e-3, angle=cddf.Linear(base, base + 2 * np.pi * -0.75, L)) for base in (0.0, 2.0)]
    found = cddf.design(
        tube(*tendons),
        cddf.Most("tip_twist"),
        free=("tendons.*.angle.winding",),
        bounds={"tendons.*.angle.winding": (-6 * np.pi, -1.2 * np.pi)},
        cases=cddf.LoadCase((10.0, 0.0), direction=1),
    )
    exact = {"xatol": 1e-7}
    best: Any = minimize_scalar(lambda turns: -tip_twist(turns, 10.0, 8e-3), bounds=(-2.9, -0.7), options=exact)
    assert found.success
    assert found.objective == pytest.approx(-best.fun, rel=1e-7)
    winding = found.value["tendons.*.angle.winding"]
    assert winding == pytest.approx(2 * np.pi * best.x, rel=1e-4)
    tips = [float(of_kind(cddf.Linear, tendon.angle).tip) for tendon in found.manipulator.tendons]
    assert tips == pytest.approx([winding, 2.0 + winding])


# --- even loss between tendons -------------------------------------------------------------------


@lru_cache
def even():
    tendons = [cddf.Tendon(d, angle=cddf.Linear(a, a + 2 * np.pi, L)) for d, a in ((7e-3, 0.0), (9e-3, np.pi))]
    return cddf.design(
        tube(*tendons),
        cddf.Even("tension_loss"),
        free=("tendons.1.offset",),
        bounds={"tendons.1.offset": (NEAREST, FARTHEST)},
        cases=cddf.LoadCase(30.0, direction=1),
        nodes=FEW,
    )


@pytest.mark.slow
def test_even_loss_between_tendons():
    """Half a turn brings one tendon to where the other one is, once both have one offset: then they lose the same."""
    found = even()
    before, after = found.equilibria_at_start[0].tension_loss, found.equilibria[0].tension_loss
    assert found.success
    assert found.value["tendons.1.offset"] == pytest.approx(7e-3, rel=1e-5)
    np.testing.assert_allclose(after[0], after[1], rtol=1e-5)
    assert found.objectives[0].start == pytest.approx(float(np.std(before) / np.mean(before)), rel=1e-12)


@pytest.mark.slow
def test_the_figure_of_a_design_in_space():
    """The routing before and after, in degrees and millimetres, and the body in three dimensions."""
    figure = design_figure(even())
    room, _, angle, offset, bending, twist = figure.axes
    assert room.name == "3d"
    labels = [axes.get_ylabel() for axes in (angle, offset, bending, twist)]
    assert labels == ["Angle (deg)", "Offset (mm)", "Bending (1/m)", "Twist (1/m)"]
    ends = np.array([[y_of(line)[[0, -1]] for line in axes.lines] for axes in (angle, offset)])
    turned, moved = [[0.0, 360.0], [180.0, 540.0]], [[7.0, 7.0], [9.0, 9.0]]
    np.testing.assert_allclose(ends, [turned * 2, [*moved, [7.0, 7.0], [7.0, 7.0]]], rtol=1e-5)
    assert [line.get_linestyle() for line in angle.lines] == ["-", "--"] * 2  # each tendon has its own
    assert np.max(np.abs(y_of(bending.lines[1]))) < 1e-3 < np.max(y_of(bending.lines[0]))
    assert np.all(y_of(twist.lines[1]) < 0)  # the winding tendons unwind
    with pytest.raises(cddf.InputError, match="projection"):
        draw_design(even(), Figure().subplots())


@pytest.mark.slow
def test_the_stiffness_of_the_tip_in_space():
    """That of a cantilever that is hardly pulled, along both axes across it: 3 E J / L^3."""
    body, case = tube(cddf.Tendon(8e-3, angle=0.3)), cddf.LoadCase(1e-6, direction=1)

    @eqx.filter_jit
    def stiffness(body):
        view = BodyView(body, np.array([0.0, L]), case, case.solve(body, 8), 8)
        return [BODY_QUANTITIES[f"tip_stiffness_{axis}"].of(view) for axis in "yz"]

    assert list(map(float, stiffness(body))) == pytest.approx([3 * EJ / L**3] * 2, rel=1e-7)


# --- what is refused -----------------------------------------------------------------------------

STRAIGHT = tube(cddf.Tendon(8e-3, angle=0.0))
PLANAR = tube(cddf.Tendon(8e-3))
HELIX = tube(cddf.Tendon(8e-3, angle=cddf.Linear(0.0, 3.0, L)))
THREE = tube(*(cddf.Tendon(8e-3, angle=a) for a in (0.0, 2.0, 4.0)))


@pytest.mark.parametrize(
    ("body", "objective", "message"),
    [
        (STRAIGHT, cddf.Even("curvature"), "'curvature' has three components in space; take 'bending' or 'twist'"),
        (STRAIGHT, cddf.Most("tip_stiffness"), "'tip_stiffness' has two directions across the tip in space; take"),
        (PLANAR, cddf.Most("tip_z"), "'tip_z' is zero of a body in the plane; give a tendon an angle"),
        (PLANAR, cddf.Most("twist"), "'twist' is zero of a body in the plane; give a tendon an angle"),
        (tube(cddf.Tendon(8e-3), extensible=True), cddf.Least("strain"), "'strain' is not known along an axis that"),
        (STRAIGHT, cddf.Near("tip_angle", 3.5), "near tip_angle: tip_angle of a body in space is 0 or more and at"),
        (STRAIGHT, cddf.Near("heading", -0.1, at=[0.1]), "near heading: heading of a body in space is 0 or more"),
    ],
)
def test_what_has_no_meaning(body, objective, message):
    asked = {"free": ("youngs_modulus",), "cases": cddf.LoadCase(10.0, direction=1)}
    assert message in refused(cddf.design, body, objective, **asked)


def test_angles_beyond_half_a_turn():
    """The angle lies between the axes of base and tip, so that no limit or target may lie beyond 180 deg."""
    asked: dict[str, Any] = {"free": ("youngs_modulus",), "cases": cddf.LoadCase(10.0)}
    said = refused(cddf.design, STRAIGHT, cddf.Least("mass"), **asked, constraints=cddf.Limit("tip_angle", most=4.0))
    assert said.startswith("design: tip_angle <= 4: tip_angle of a body in space is 0 or more and at most 180 deg")
    asked["cases"] = cddf.LoadCase(cddf.TipAngle(3.5))
    said = refused(cddf.design, STRAIGHT, cddf.Least("base_tension"), **asked)
    assert "the load case: solve: tip_angle of a body in space" in said


def test_a_winding_moves_the_tip_with_the_base():
    """By hand: the angle at the tip is that at the base and the winding, whatever else is set."""
    tendons = [cddf.Tendon(8e-3, angle=cddf.Linear(base, base + 1.0, L)) for base in (0.0, 2.0)]
    case = cddf.LoadCase(10.0).of(tube(*tendons))
    assert float(case.number("tendons.1.angle.winding")) == pytest.approx(1.0)
    assert case.unit("tendons.1.angle.winding") == "rad"
    moved = case.with_numbers({"tendons.1.angle.winding": -3.0, "tendons.1.angle.base": 0.5, "length": 2 * L})
    angle = of_kind(cddf.Linear, moved.manipulator.tendons[1].angle)
    assert (float(angle.base), float(angle.tip), float(angle.length)) == pytest.approx((0.5, -2.5, 2 * L))
    with pytest.raises(cddf.InputError, match="tip follows from base and winding; leave out one of tip and winding"):
        case.with_numbers({"tendons.1.angle.winding": 0.0, "tendons.1.angle.tip": 0.0})


@pytest.mark.parametrize(
    ("body", "free", "message"),
    [
        (PLANAR, ("tendons.0.angle",), "'tendons.0.angle' is not a number here; give it a value at the start"),
        (THREE, ("tendons.*.angle",), "'tendons.*.angle' starts at different values, 0, 2, 4; make them one"),
        (STRAIGHT, ("tendons.*.angle.winding",), "needs a linear angle; give the tendon"),
        (HELIX, ("tendons.0.angle", "tendons.0.angle.winding"), "tip follows from base and winding; leave out one"),
    ],
)
def test_angles_that_cannot_be_free(body, free, message):
    """One angle for three tendons would put them on one line."""
    case = cddf.LoadCase(10.0, direction=1)
    assert message in refused(cddf.design, body, cddf.Least("tip_x"), free=free, cases=case)
