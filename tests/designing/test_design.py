"""Designs against closed forms, SciPy and each other.

Exact kinematics, constant d, one tendon that slides in (docs/theory.md, (13) and (16)): T = T_base exp(-mu phi) and
E J kappa = T d, so that phi(L) = ln(1 + mu T_base d H / E) / mu with H = int_0^L ds / J.
"""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain, paper_with
from kinds import of_kind, root_of
from refusals import refused
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

import cddf_jax as cddf
from cddf_jax.designing.body_quantities import BODY_QUANTITIES, BodyView
from cddf_jax.errors import InputError
from cddf_jax.estimation.determination import IDENTIFIED, NOT_IDENTIFIED, PRIOR_ONLY

L, d, MU, E = (PAPER[name] for name in ("length", "tendon_offset", "friction_coefficient", "youngs_modulus"))
r = PAPER["inner_radius"]
T = 50.0
FEASIBLE = 1e-6  # scaled, what a design promises
CLOSED = 1e-7  # of a design against a closed form: a solver right to 1e-8, and limits kept to about that
KNOTS = np.linspace(0.0, L, 5)
DENSE = np.linspace(0.0, L, 2001)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def free_form():
    """The paper's body with the outer radius a spline through five even knots, a straight taper at first."""
    return replace(paper_body("exact"), outer_radius=cddf.Spline(KNOTS, np.linspace(0.020, 0.013, 5)))


def limit_of(design, name, side="most"):
    return next(report for report in design.limits if (report.name, report.side) == (name, side))


# --- uniform curvature ------------------------------------------------------


@lru_cache
def uniform(thinnest=0.0105, starts=1):
    return cddf.design(
        free_form(),
        cddf.Even("curvature"),
        free=("outer_radius",),
        bounds={"outer_radius": (thinnest, 0.03)},
        constraints=[cddf.Limit("tip_angle", equal=1.0)],
        cases=cddf.LoadCase(T),
        starts=starts,
    )


@pytest.mark.slow
def test_uniform_curvature_has_the_analytic_radius():
    """J = T d exp(-mu kappa s) / (E kappa); that of the published kinematics is in test_design_command.py.

    A cubic spline through five knots comes within 2e-8 of that radius. The issue asks for 1e-4.
    """
    found, kappa = uniform(), 1.0 / L
    J = T * d * np.exp(-MU * kappa * DENSE) / (E * kappa)
    radius = (4 * J / np.pi + r**4) ** 0.25
    assert found.success
    assert np.asarray(found.manipulator.outer_radius(DENSE)) == pytest.approx(radius, rel=1e-6)
    assert found.equilibria[0].tip_angle == pytest.approx(1.0, abs=FEASIBLE)
    curvature = np.asarray(found.equilibria[0].curvature)
    assert curvature == pytest.approx(np.full(curvature.size, kappa), rel=1e-6)
    # told as the relative standard deviation, at the start that of the paper's cone, by its closed form
    plain, places = paper_plain("exact"), (NODES + 1) / 2 * L
    before = np.array([plain.closed_form(T, s) * d / (E * plain.second_moment(s)) for s in places])
    mean = before @ WEIGHTS / 2
    assert found.objectives[0].start == pytest.approx(np.sqrt((before - mean) ** 2 @ WEIGHTS / 2) / mean, rel=1e-6)
    assert found.objective < 1e-6
    # uniform curvature is reached whatever the tip angle: no multiplier, no sensitivity, every number inside
    assert {number.status for number in found.free.values()} == {"inside"}
    assert limit_of(found, "tip_angle", "equal").multiplier == pytest.approx(0.0, abs=1e-4)
    assert found.outcome.value < 1e-9  # a variance over that of the start
    assert found.violation <= FEASIBLE
    assert found.optimality <= FEASIBLE
    assert found.remarks == ()
    assert found.blocking == ()


@pytest.mark.slow
def test_many_starts_of_which_some_are_no_bodies():
    """Between 4 and 30 mm at every knot many are thinner than their bore: these have no answer and do not spoil it."""
    found, alone = uniform(0.004, starts=16), uniform()
    problem = found.outcome.problem
    thin = np.asarray(problem.free.scaled(np.array([0.02, 0.02, 0.0045, 0.02, 0.02])))
    assert not problem(thin).usable
    assert found.success
    assert len(found.starts) == 5  # the body itself, and from the best four of the others
    assert min(found.starts) < 1e-7  # variance of the curvature over that of the start
    assert np.array(list(found.value.values())) == pytest.approx(np.array(list(alone.value.values())), rel=1e-5)


# --- the loss at a given tip angle ---------------------------------------------------------------


@pytest.mark.slow
def test_the_loss_at_a_given_angle_does_not_depend_on_the_taper():
    """docs/identifiability.md: 1 - exp(-mu theta), whatever the body: nothing to gain among free-form bodies.

    Its sensitivities are those by friction and by the angle; neither stiffness nor length count.
    """
    found = cddf.design(
        free_form(),
        cddf.Least("tension_loss"),
        free=("outer_radius",),
        bounds={"outer_radius": (0.0105, 0.030)},
        cases=cddf.LoadCase(cddf.TipAngle(0.8)),
    )
    kept = np.exp(-MU * 0.8)
    assert found.result == "undetermined: no free number changes the objective"
    assert not found.success
    assert found.feasible
    assert found.objectives[0].start == pytest.approx(1 - kept, rel=1e-8)
    assert found.objective == pytest.approx(1 - kept, rel=1e-7)
    cost = found.sensitivity
    assert cost["friction_coefficient"] == pytest.approx(0.8 * kept, rel=1e-6)
    assert cost["base_tension.value"] == pytest.approx(MU * kept, rel=1e-6)
    assert cost["youngs_modulus"] * E == pytest.approx(0.0, abs=1e-6)
    assert cost["length"] * L == pytest.approx(0.0, abs=1e-6)


# --- least peak strain ---------------------------------------------------------------------------


def even_strain(angle=1.0):
    """A solid body with R kappa = e everywhere, at the least peak that a body of this angle can have.

    E J kappa = T d with J = pi R^4 / 4 and T = T_base exp(-mu phi) makes R^3 exp(mu phi) constant, and with
    phi' = e / R the radius straight: R = R_0 - mu e s / 3, R_0^3 = 4 T_base d / (pi E e).
    """

    def base(e):
        return (4 * T * d / (np.pi * E * e)) ** (1 / 3)

    def miss(e):
        return -3 / MU * np.log1p(-MU * e * L / (3 * base(e))) - angle

    e = root_of(miss, 1e-4, 0.4, xtol=1e-15)
    return e, base(e), base(e) - MU * e * L / 3


def least_strain(bounds=(0.010, 0.030)):
    return cddf.design(
        paper_body("exact", inner_radius=0.0, outer_radius=(0.0150, 0.0130)),
        cddf.Least("strain"),
        free=("outer_radius",),
        bounds={"outer_radius": bounds},
        constraints=[cddf.Limit("tip_angle", equal=1.0)],
        cases=cddf.LoadCase(T),
    )


def test_the_least_peak_strain_is_even_strain_of_a_cone():
    found, (strain, base, tip) = least_strain(), even_strain()
    assert found.success
    assert found.objective == pytest.approx(strain, rel=CLOSED)
    assert found.value == pytest.approx({"outer_radius.base": base, "outer_radius.tip": tip}, rel=1e-6)
    # dead certain by its price: how the peak grows with the angle, against the closed form at 1 +- h
    h = 1e-4
    slope = (even_strain(1 + h)[0] - even_strain(1 - h)[0]) / (2 * h)
    assert limit_of(found, "tip_angle", "equal").multiplier == pytest.approx(slope, rel=1e-5)


def test_a_bound_that_holds_has_its_price():
    """The base at most 15.5 mm: what a wider bound would gain, by designing again with it 10 um wider and narrower."""
    h = 1e-5
    found, wider, narrower = (least_strain((0.010, 0.0155 + step)) for step in (0.0, h, -h))
    number = found.free["outer_radius.base"]
    assert found.success
    assert number.status == "at upper bound"
    assert number.value == pytest.approx(0.0155, rel=1e-9)
    assert found.free["outer_radius.tip"].status == "inside"
    assert found.free["outer_radius.tip"].multiplier == 0.0
    assert found.objective > even_strain()[0]
    assert number.multiplier == pytest.approx((narrower.objective - wider.objective) / (2 * h), rel=1e-3)


# --- least tension, everything limited -----------------------------------------------------------

SECOND, ANGLE, DENSITY = 5.0, 0.8, 1100.0
LIMITS = {
    "clearance": ("least", 1e-3),
    "wall_thickness": ("least", 3e-3),
    "taper": ("least", 0.0),
    "slope": ("most", 0.06),
    "strain": ("most", 0.2),
    "crossing": ("most", 0.2),
    "tension": ("most", 120.0),
    "mass": ("most", 0.2),
}
BEST_SAG = 0.013


def sag(body: cddf.Manipulator, equilibrium: cddf.Equilibrium) -> Any:
    """Of the straight body's tip per newton across it: int (L - s)^2 / (E J) ds."""
    s = (NODES + 1) / 2 * jnp.asarray(body.length)
    return jnp.sum(WEIGHTS / 2 * (body.length - s) ** 2 / body.stiffness(s)) * body.length


def pulled_two(**limits):
    """The least tension that bends a stiff body with two tendons: radii, offset of both, and tension are free."""
    sides = {**LIMITS, **{name: (LIMITS[name][0], value) for name, value in limits.items()}}
    return cddf.design(
        paper_body("exact", tendon_offset=0.0102, num_tendons=2, density=DENSITY),
        cddf.Least("base_tension"),
        free=("outer_radius", "tendons.*.offset", "base_tension_1"),
        bounds={"outer_radius": (0.010, 0.030)},
        constraints=[
            cddf.Limit("tip_angle", equal=ANGLE),
            cddf.Limit(sag, most=BEST_SAG),
            *(cddf.Limit(name, **{side: value}) for name, (side, value) in sides.items()),
        ],
        cases=cddf.LoadCase((60.0, SECOND), direction=(+1, -1)),
    )


def moment_of_two(base, tip, offset, s, tension):
    """In closed form: phi' E J / d = T_1 exp(-mu phi) - T_2 exp(mu phi) is separable.

    With u = exp(mu phi), m = sqrt(T_1 T_2) and h(s) = int_0^s dx / J: artanh(u sqrt(T_2 / T_1)) grows by mu m d h / E.
    """
    radius = base + (tip - base) * s * (NODES + 1) / 2 / L
    flow = (4 / np.pi / (radius**4 - r**4)) @ WEIGHTS * s / 2
    ratio = np.sqrt(SECOND / tension)
    u = np.tanh(np.arctanh(ratio) + MU * np.sqrt(tension * SECOND) * offset * flow / E) / ratio
    return offset * (tension / u - SECOND * u)


@pytest.fixture(scope="module")
def stiff():
    return pulled_two()


def test_everything_that_is_limited_is_kept_everywhere(stiff):
    """Each limit looked at again along the whole body, from the free numbers alone and the closed form."""
    body, pulled = stiff.manipulator, stiff.value["base_tension_1"]
    outer = np.asarray(body.outer_radius(DENSE))
    offsets = np.asarray(body.offset(DENSE))
    moment = np.array([moment_of_two(*list(stiff.value.values())[:3], s=s, tension=pulled) for s in DENSE])
    curvature = moment / (E * np.pi / 4 * (outer**4 - r**4))
    # the one sliding in loses tension, the other one gains it up to the tip
    tension = max(pulled, SECOND * np.exp(MU * ANGLE))
    slope = np.diff(outer) / np.diff(DENSE)
    room = {  # over the size of each limit
        "clearance": min(np.min(outer - offsets), np.min(offsets - r)) / 1e-3 - 1,
        "wall_thickness": np.min(outer - r) / 3e-3 - 1,
        "taper": np.min(-slope) / 0.05,  # over its size at the start, 7 mm on 140
        "slope": 1 - np.max(np.abs(slope)) / 0.06,
        "strain": 1 - np.max(outer * np.abs(curvature)) / 0.2,
        "crossing": 1 - np.max(offsets * np.abs(curvature)) / 0.2,
        "tension": 1 - tension / 120.0,
        "mass": 1 - DENSITY * quad(lambda s: float(np.pi * (np.interp(s, DENSE, outer) ** 2 - r**2)), 0, L)[0] / 0.2,
    }
    assert stiff.violation <= FEASIBLE
    for name, margin in room.items():
        report = limit_of(stiff, name, LIMITS[name][0])
        assert margin >= -FEASIBLE
        assert report.active == (margin < 1e-5), name
        assert report.margin == pytest.approx(margin, abs=1e-5), name
        assert (report.multiplier > 0) == report.active, name
    assert body.tendons[0].offset.value == body.tendons[1].offset.value
    for name, number in stiff.free.items():
        assert number.lower <= number.value <= number.upper, name


def test_limits_that_no_body_keeps_are_named():
    """At most 30 N, where 30.8 N are needed; what is in its way is what has a price in the optimum, no other limit."""
    found = pulled_two(tension=30.0)
    assert not found.success
    assert not found.feasible
    assert found.result == "infeasible"
    assert 1e-3 < found.violation < 30.84893 / 30 - 1  # the others give way too
    assert found.sensitivity == {}
    names = ("tip_angle", "sag", "clearance", "slope", "tension")
    assert len(found.blocking) == len(names)
    assert all(any(name in text for text in found.blocking) for name in names)


def test_derivatives_against_finite_differences(stiff):
    """Slopes of objective, margins and equations at a point beside the optimum."""
    rng = np.random.default_rng(3)
    problem, x = stiff.outcome.problem, stiff.outcome.local.point.x
    x = x * (1 + 0.02 * rng.random(x.size))
    point, h = problem(x), 1e-4
    for along in np.eye(x.size):
        ahead, behind, ahead2, behind2 = (problem(x + k * h * along) for k in (1, -1, 2, -2))

        def difference(of, near=(ahead, behind), far=(ahead2, behind2)):
            """Central, of fourth order: errors of h^4, and of rounding of the solver, 1e-12 / h."""
            inner, outer = of(near[0]) - of(near[1]), of(far[0]) - of(far[1])
            return (8 * inner - outer) / (12 * h)

        assert point.gradient @ along == pytest.approx(difference(lambda at: at.objective), rel=1e-7, abs=1e-8)
        slopes = difference(lambda at: at.margins)
        assert point.slopes @ along == pytest.approx(slopes, rel=1e-6, abs=1e-6)


# --- between the stations ------------------------------------------------------------------------


@pytest.mark.slow
def test_a_limit_broken_between_the_stations_only_is_kept_everywhere():
    """A bore that bulges over 1.6 mm between two knots, and a wall of 4 mm around it of the least volume.

    With a straight outer wall R = max r + 4 mm, and the volume pi int (R^2 - r^2) ds by SciPy between the knots.
    """
    middle = 16.5 / 32 * L  # midway between stations, which are 1/32 of the length apart
    knots = np.sort(np.r_[0.0, 0.03, 0.05, middle + 1e-3 * np.array([-9.0, -3.2, -0.8, 0.8, 3.2, 9.0]), 0.095, 0.12, L])
    inner = cddf.Spline(knots, np.where(np.abs(knots - middle) < 1e-3, 7e-3, 6e-3))
    body = replace(paper_body("exact", outer_radius=0.02), inner_radius=inner)
    found = cddf.design(
        body,
        cddf.Least("volume"),
        free=("outer_radius",),
        bounds={"outer_radius": (0.0101, 0.03)},
        constraints=[cddf.Limit("wall_thickness", least=4e-3)],
        cases=cddf.LoadCase(T),
        nodes=4,
    )
    fine = np.asarray(inner(np.linspace(middle - 1e-3, middle + 1e-3, 20001)))
    at_stations = np.asarray(inner(np.r_[np.linspace(0, L, 33), knots]))
    assert np.max(fine) > np.max(at_stations) + 1e-4 * 4e-3  # it bulges between the stations
    assert found.success
    radius = np.max(fine) + 4e-3
    assert found.value["outer_radius"] == pytest.approx(radius, abs=FEASIBLE * 4e-3)
    again = CubicSpline(knots, np.asarray(inner.values), bc_type="not-a-knot")
    bore = sum(quad(lambda s: again(s) ** 2, *ends, epsabs=1e-16)[0] for ends in pairwise(knots))
    assert found.objective == pytest.approx(np.pi * (radius**2 * L - bore), rel=1e-6)
    # its price: how the volume grows with the wall, 2 pi R L
    report = limit_of(found, "wall_thickness", "least")
    assert report.multiplier == pytest.approx(2 * np.pi * radius * L, rel=1e-6)
    assert report.arc_length == pytest.approx(middle, abs=1e-4)
    assert np.min(np.asarray(found.manipulator.outer_radius(fine)) - fine) >= 4e-3 * (1 - FEASIBLE)


# --- near what is wanted -------------------------------------------------------------------------


@pytest.mark.slow
def test_a_shape_and_a_tip_that_a_body_has_are_found_again():
    """From positions and tip pose of another body: its radii, and its length, with which tapers stretch."""
    truth = paper_body("exact", length=0.150, outer_radius=(0.018, 0.014))
    shape = cddf.solve(truth, T)
    places = np.linspace(0.02, 0.12, 6)
    at = shape.at(jnp.asarray(places))
    found = cddf.design(
        paper_body("exact"),
        [
            (1.0, cddf.Near("position", np.asarray(at.position), at=places)),
            (0.5, cddf.Near("tip_position", np.asarray(shape.tip_position))),
            (0.5, cddf.Near("tip_angle", float(shape.tip_angle))),
        ],
        free=("outer_radius", "length"),
        bounds={"length": (0.10, 0.20)},
        cases=cddf.LoadCase(T),
    )
    assert found.success
    # squares are zero there: the search stops where they are about 1e-12 of those at the start
    expected = {"outer_radius.base": 0.018, "outer_radius.tip": 0.014, "length": 0.150}
    assert found.value == pytest.approx(expected, rel=1e-4)
    by_name = {objective.name: objective for objective in found.objectives}
    before = np.asarray(found.equilibria_at_start[0].at(jnp.asarray(places)).position)
    difference = np.sqrt(np.mean((before - np.asarray(at.position)) ** 2))
    assert by_name["near position"].start == pytest.approx(difference, rel=1e-6)
    assert by_name["near position"].end < 1e-5 * L
    assert by_name["near tip_angle"].end < 1e-4
    assert of_kind(cddf.Linear, found.manipulator.outer_radius).length == pytest.approx(0.150, rel=1e-4)


# --- stiffness -----------------------------------------------------------------------------------


def firmness(body: cddf.Manipulator, equilibrium: cddf.Equilibrium) -> Any:
    """Of the straight body's tip: newtons across it per meter."""
    return 1.0 / sag(body, equilibrium)


def firmest(most):
    """Of the cones of a volume one number is left, the radius at the tip: the best of 4000 steps, and its firmness."""
    tip = np.linspace(0.008, 0.014, 4001)
    # pi L ((R_0^2 + R_0 R_1 + R_1^2) / 3 - r^2) is the volume
    base = (-tip + np.sqrt(tip**2 - 4 * (tip**2 - 3 * (most / (np.pi * L) + r**2)))) / 2
    s = L * (NODES + 1) / 2
    radius = base[:, None] + (tip - base)[:, None] * s / L
    firm = E / (((L - s) ** 2 * 4 / np.pi / (radius**4 - r**4)) @ WEIGHTS * L / 2)
    best = int(np.argmax(firm))
    assert 0 < best < 4000
    return tip[best], firm[best]


def test_the_most_of_something_within_a_volume():
    """The firmest cone of 70 ml, and what more volume is worth."""
    most, h = 7e-5, 1e-3
    found = cddf.design(
        paper_body("exact"),
        cddf.Most(firmness),
        free=("outer_radius",),
        bounds={"outer_radius": (0.008, 0.04)},
        constraints=[cddf.Limit("volume", most=most), cddf.Limit("clearance", least=-2e-3)],
        cases=cddf.LoadCase(20.0),
    )
    tip, firm = firmest(most)
    assert found.success
    assert found.objective == pytest.approx(firm, rel=1e-6)  # flat there: the square of a step of 2e-4
    assert found.value["outer_radius.tip"] == pytest.approx(tip, abs=2e-6)
    assert found.objectives[0].name == "most firmness"
    worth = (firmest(most * (1 + h))[1] - firmest(most * (1 - h))[1]) / (2 * h * most)
    report = limit_of(found, "volume")
    assert report.active
    assert report.multiplier == pytest.approx(worth, rel=1e-4)


@pytest.mark.slow
def test_the_stiffness_of_a_bent_tip():
    """Without friction phi = T d h(s) / E, h = int ds / J, and a force along w bends by (u(L) - u(s)) x w / (E J)."""
    pull = 20.0
    body, case = paper_body("exact", friction_coefficient=0.0), cddf.LoadCase(pull)
    plain = paper_plain("exact", friction=[0.0])
    stiff = E * np.pi / 4 * (plain.outer_radius(DENSE) ** 4 - r**4)

    def along(values):
        """The integral from the base on, through a spline of 4000 pieces."""
        return CubicSpline(DENSE, values).antiderivative()(DENSE)

    heading = along(pull * d / stiff)
    x, y = along(np.cos(heading)), along(np.sin(heading))
    ways = {"tip_stiffness": (-np.sin(heading[-1]), np.cos(heading[-1])), "tip_stiffness_y": (0.0, 1.0)}

    @eqx.filter_jit
    def stiffness(body):
        view = BodyView(body, jnp.zeros(1), case, case.solve(body))
        return {name: BODY_QUANTITIES[name].of(view) for name in ways}

    found = stiffness(body)
    for name, way in ways.items():
        lever = (x[-1] - x) * way[1] - (y[-1] - y) * way[0]
        expected = 1 / along(lever**2 / stiff)[-1]
        assert float(found[name]) == pytest.approx(expected, rel=CLOSED), name


# --- several load cases --------------------------------------------------------------------------

MEAN, SPREAD = np.array([MU, E]), np.array([0.03, 0.05e6])
COVARIANCE = np.array([[SPREAD[0] ** 2, 0.5 * SPREAD.prod()], [0.5 * SPREAD.prod(), SPREAD[1] ** 2]])
WANTED = 0.9


def a_fit(**status) -> Any:
    """What `uncertain_cases` asks of a fit."""
    names = ("friction_coefficient", "youngs_modulus")
    return SimpleNamespace(
        names=names,
        value=dict(zip(names, MEAN, strict=True)),
        covariance=COVARIANCE,
        status=dict.fromkeys(names, IDENTIFIED) | status,
    )


def angles_of(radius, cases):
    """phi(L) of the closed form in every case, J constant."""
    J = np.pi / 4 * (radius**4 - r**4)
    return np.array(
        [np.log1p(mu * T * d * L / (modulus * J)) / mu for mu, modulus in (case.numbers.values() for case in cases)]
    )


def near_in_every_case(cases, worst):
    return cddf.design(
        paper_body("exact", outer_radius=0.015),
        cddf.Near("tip_angle", WANTED),
        free=("outer_radius",),
        bounds={"outer_radius": (0.0105, 0.03)},
        cases=cases,
        worst=worst,
    )


def test_uncertain_cases_have_the_means_and_the_covariance_of_the_fit():
    cases = cddf.uncertain_cases(cddf.LoadCase(T, weight=2.0, name="bent"), a_fit(), num=256)
    draws = np.array([list(case.numbers.values()) for case in cases])
    assert [list(case.numbers) for case in cases[:1]] == [["friction_coefficient", "youngs_modulus"]]
    # balanced points: means to 1 % of the spread, where independent draws would miss by 6 %
    assert draws.mean(axis=0) == pytest.approx(MEAN, abs=0.02 * SPREAD[0], rel=1e-3)
    assert np.abs(draws.mean(axis=0) - MEAN) / SPREAD == pytest.approx([0, 0], abs=0.02)
    scaled = np.cov(draws.T) / np.outer(SPREAD, SPREAD)
    assert scaled == pytest.approx(np.array([[1.0, 0.5], [0.5, 1.0]]), abs=0.05)
    assert sum(float(case.weight) for case in cases) == pytest.approx(2.0)
    assert cases[0].name == "bent 1"
    again = cddf.uncertain_cases(cddf.LoadCase(T), a_fit(), num=256)
    assert [float(case.numbers["youngs_modulus"]) for case in again] == draws[:, 1].tolist()


def test_a_fit_that_does_not_determine_the_body_is_refused():
    with pytest.raises(InputError, match="does not determine youngs_modulus; measure more"):
        cddf.uncertain_cases(cddf.LoadCase(T), a_fit(youngs_modulus=NOT_IDENTIFIED))
    assert len(cddf.uncertain_cases(cddf.LoadCase(T), a_fit(youngs_modulus=PRIOR_ONLY), num=2)) == 2


@pytest.mark.slow
def test_the_weighted_mean_of_uncertain_cases():
    """Against SciPy on the closed form, cases of unequal weight."""
    drawn = cddf.uncertain_cases(cddf.LoadCase(T), a_fit(), num=4)
    cases = [replace(case, weight=weight) for case, weight in zip(drawn, (1.0, 2.0, 3.0, 4.0), strict=True)]
    found = near_in_every_case(cases, worst=False)

    def mean(radius):
        return np.array([0.1, 0.2, 0.3, 0.4]) @ (angles_of(radius, cases) - WANTED) ** 2

    best = minimize(lambda x: 1e4 * mean(x[0] * 1e-2), [1.5], method="Nelder-Mead", tol=1e-10).x[0] * 1e-2
    assert found.success
    assert found.value["outer_radius"] == pytest.approx(best, rel=1e-6)
    assert found.objective == pytest.approx(np.sqrt(mean(best)), rel=1e-6)
    tips = [float(equilibrium.tip_angle) for equilibrium in found.equilibria]
    assert tips == pytest.approx(angles_of(found.value["outer_radius"], cases), rel=CLOSED)


def test_the_worst_of_uncertain_cases():
    """The radius that leaves the largest and the smallest angle equally far from what is wanted."""
    cases = cddf.uncertain_cases(cddf.LoadCase(T), a_fit(), num=4)
    found = near_in_every_case(cases, worst=True)

    def ends(radius):
        angles = angles_of(radius, cases)
        return np.max(angles) + np.min(angles) - 2 * WANTED

    best = root_of(ends, 0.011, 0.025, xtol=1e-15)
    assert found.success
    assert found.value["outer_radius"] == pytest.approx(best, rel=1e-6)
    assert found.objective == pytest.approx(np.max(angles_of(best, cases)) - WANTED, rel=1e-6)


# --- limits that jump along the body, and that bind at one place ----------------------------------


def test_a_tendon_that_ends_early_is_in_nobodys_way_beyond():
    """10 mm and 0.75 mm of clearance up to the anchor, the thinnest wall that is allowed behind it."""
    body = paper_with(cddf.Tendon(10e-3, end=0.1))
    bounds, limits = {"outer_radius": (8e-3, 25e-3)}, [cddf.Limit("clearance", least=0.75e-3)]
    found = cddf.design(
        body, cddf.Least("volume"), ("outer_radius",), bounds, limits, cases=cddf.LoadCase(20.0), nodes=8
    )
    assert found.success, found.result
    s = np.linspace(0, 0.1, 2001)
    assert np.min(found.manipulator.outer_radius(s) - 10e-3 - 0.75e-3) > -1e-9
    assert float(found.manipulator.outer_radius(0.1)) == pytest.approx(10.75e-3, rel=1e-6)  # it is lightest there


def test_no_price_where_two_limits_bind_at_one_place():
    """A wall of 3 mm and a tendon at 10 mm both stop the radius at 10 mm: giving way of one alone is worth nothing, and
    a thicker wall costs much. The volume pi (R^2 - r^2) L is proportional to the length."""
    bounds, limits = {"outer_radius": (8e-3, 25e-3)}, [cddf.Limit("wall_thickness", least=3e-3)]
    body = replace(paper_body("exact"), outer_radius=cddf.Piecewise([0.07], [20e-3, 15e-3]))
    found = cddf.design(
        body, cddf.Least("volume"), ("outer_radius",), bounds, limits, cases=cddf.LoadCase(20.0), nodes=8
    )
    wall = found.limits[0]
    assert wall.name == "wall_thickness"
    assert wall.active
    assert np.isnan(wall.multiplier)
    assert "not unique: limits bind at one place" in str(found)
    assert np.isnan(found.sensitivity["inner_radius"])  # a kink
    assert found.sensitivity["length"] == pytest.approx(np.pi * (0.010**2 - r**2), rel=1e-6)


def test_single_precision_is_refused():
    with jax.enable_x64(False):
        said = refused(cddf.design, paper_body(), cddf.Least("mass"), ("outer_radius",), cases=cddf.LoadCase(10.0))
    assert said.startswith("design: needs double precision; jax.config.update")
