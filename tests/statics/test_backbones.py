"""Backbones with discs: a bending stiffness, masses per length and at places, a modulus that varies along the body."""

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, codes, paper_body
from kinds import root_of
from refusals import refused
from scipy.integrate import quad, solve_ivp

import cddf_jax as cddf

L, OFFSET, MU, PULL, GRAVITY = 0.2, 0.008, 0.25, 0.8, np.array([2.0, -9.81])


class Numbers(NamedTuple):
    """Of a backbone whose stiffness and mass per length fall in straight lines to 60 % of those at the base."""

    stiffness: Any = 0.02  # E I at the base, N m^2
    factor: Any = 0.9
    per_length: Any = 0.15  # kg/m at the base
    mass: Any = 0.020  # kg, of a disc
    place: Any = 0.08  # m, of it
    tip_mass: Any = 0.010  # kg, of a camera
    tip_place: Any = L
    force: Any = 0.02  # N, on the tip in the direction of gravity over its size


def robot(x: Numbers = Numbers()) -> cddf.Manipulator:
    return cddf.Manipulator(
        length=L,
        tendons=(cddf.Tendon(OFFSET),),
        friction_coefficient=MU,
        bending_stiffness=cddf.Linear(x.stiffness, 0.6 * x.stiffness, L),
        stiffness_factor=x.factor,
        mass_per_length=cddf.Linear(x.per_length, 0.6 * x.per_length, L),
        point_masses=(cddf.PointMass(x.place, x.mass), cddf.PointMass(x.tip_place, x.tip_mass)),
    )


def loads(x: Numbers = Numbers()) -> cddf.Loads:
    return cddf.Loads(tip_force=x.force * jnp.asarray(GRAVITY), gravity=GRAVITY)


def observed(x: Numbers, **options: Any) -> tuple[jax.Array, Any]:
    eq = cddf.solve(robot(x), PULL, loads(x), throw=False, **options)
    moment = 100 * eq.base_moment  # all of them of about one size
    return jnp.stack([eq.tip_tension[0], eq.tip_angle, *10 * eq.tip_position, moment]), eq.status


def reference(x: Numbers = Numbers()) -> np.ndarray:
    """The same by shooting with SciPy, docs/theory.md: exact kinematics, one tendon of constant offset.

    theta' = |kappa|, phi' = kappa, M' = -(t x N), E I kappa = d T_base exp(-mu theta) + M, M(L) = 0.
    """
    drop = 0.4 / L

    def rate(s: float, y: np.ndarray) -> list[float]:
        rest = x.per_length * ((L - s) - drop * (L**2 - s**2) / 2)  # int_s^L
        beyond = x.force + rest + x.mass * (s < x.place) + x.tip_mass * (s < x.tip_place)
        (nx, ny), (c, n) = beyond * GRAVITY, (np.cos(y[1]), np.sin(y[1]))
        kappa = (OFFSET * PULL * np.exp(-MU * y[0]) + y[4]) / (x.factor * x.stiffness * (1 - drop * s))
        return [abs(kappa), kappa, c, n, -(c * ny - n * nx)]

    def tip(moment: float) -> np.ndarray:
        y = np.array([0.0, 0.0, 0.0, 0.0, moment])
        stops = sorted({0.0, x.place, x.tip_place, L})
        for a, b in pairwise(stops):
            inside = lambda s, y, b=b: rate(min(s, b - 1e-12), y)  # noqa: E731
            y = solve_ivp(inside, (a, b), y, rtol=1e-11, atol=1e-13).y[:, -1]
        return y

    moment = root_of(lambda m: tip(m)[4], -0.5, 0.5, xtol=1e-14, rtol=1e-13)
    theta, angle, u, v, _ = tip(moment)
    return np.array([PULL * np.exp(-MU * theta), angle, 10 * u, 10 * v, 100 * moment])


@pytest.mark.slow
def test_a_backbone_with_discs_against_scipy_and_its_lanes():
    nominal = Numbers()
    lanes = [
        nominal,
        nominal._replace(mass=-0.02),  # none of these three is a body
        nominal._replace(place=0.21),
        nominal._replace(stiffness=-0.02),
        nominal._replace(mass=0.0, per_length=0.0, tip_mass=0.03, force=0.0),
        nominal._replace(mass=0.0, per_length=0.0, tip_mass=0.0, force=0.03),
        nominal._replace(place=L, mass=0.004),  # two masses at one place
        nominal._replace(tip_mass=0.014, mass=0.0),
    ]
    batch = Numbers(*map(jnp.asarray, zip(*lanes, strict=True)))
    found, result = jax.jit(jax.vmap(observed))(batch)
    good, bad = cddf.Status.successful, cddf.Status.unphysical
    assert codes(result) == [good, bad, bad, bad, good, good, good, good]
    assert np.all(np.isnan(found[1:4]))
    np.testing.assert_allclose(found[0], reference(), rtol=1e-8)
    np.testing.assert_allclose(found[4], found[5], rtol=1e-10)  # the weight of a mass at the tip is a force there
    np.testing.assert_allclose(found[6], found[7], rtol=1e-8)  # elements and a kink lie elsewhere


@pytest.mark.slow
def test_derivatives_by_masses_places_and_stiffness():
    x = Numbers()
    _, forward, reverse = both_modes(lambda flat: observed(Numbers(*flat))[0])(jnp.asarray([*x]))
    np.testing.assert_allclose(forward, reverse, rtol=1e-7, atol=1e-9)
    for i, name in enumerate(x._fields):
        h = 1e-4 * x[i]
        at = [reference(x._replace(**{name: x[i] + k * h})) for k in (-2, -1, 0)]
        if name == "tip_place":  # from inside, by the second-order formula
            expected = (1.5 * at[2] - 2 * at[1] + 0.5 * at[0]) / h
        else:
            expected = (reference(x._replace(**{name: x[i] + h})) - at[1]) / (2 * h)
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose(forward[:, i], expected, rtol=1e-4, atol=1e-5 * scale, err_msg=name)


# --- the same body, described in another way --------------------------------------------------------


def tip_tension(body: cddf.Manipulator) -> np.ndarray:
    return np.asarray(cddf.solve(body, 50.0).tip_tension)


def test_a_stiffness_and_a_mass_per_length_are_those_of_the_radii():
    cone, s = paper_body("exact", density=1070.0), np.linspace(0.0, 0.14, 9)
    told = {"length": 0.14, "tendons": cone.tendons, "friction_coefficient": 0.42}
    same = cddf.Manipulator(
        **told,
        bending_stiffness=lambda s: 1.4e6 * np.pi / 4 * ((0.020 - 0.05 * s) ** 4 - 0.007**4),  # E J, eq. (12)
        mass_per_length=lambda s: 1070.0 * np.pi * ((0.020 - 0.05 * s) ** 2 - 0.007**2),
    )
    np.testing.assert_allclose(same.stiffness(s), cone.stiffness(s), rtol=1e-12)
    np.testing.assert_allclose(same.distributed_mass(s), cone.distributed_mass(s), rtol=1e-12)
    np.testing.assert_allclose(tip_tension(same), tip_tension(cone), rtol=1e-10)
    assert np.all(np.isnan(same.outer_strain(s, 1.0 + s)))


def test_a_modulus_that_varies_along_the_body():
    varying = paper_body("exact", youngs_modulus=cddf.Linear(1.8e6, 1.0e6, 0.14))

    def compliance(s: float) -> float:  # d / (E J)
        J = np.pi / 4 * ((0.020 - 0.05 * s) ** 4 - 0.007**4)
        return 0.010 / ((1.8e6 - 0.8e6 * s / 0.14) * J)

    expected = 50.0 / (1 + 0.42 * 50.0 * quad(compliance, 0, 0.14, epsrel=1e-12)[0])  # docs/theory.md (16)
    np.testing.assert_allclose(tip_tension(varying), expected, rtol=1e-9)
    np.testing.assert_allclose(cddf.closed_form_tension(varying, 50.0, 0.14), expected, rtol=1e-10)
    constant, s = paper_body("exact", youngs_modulus=cddf.Constant(1.4e6)), np.linspace(0.0, 0.14, 9)
    np.testing.assert_array_equal(constant.stiffness(s), paper_body("exact").stiffness(s))
    jump = paper_body("exact", youngs_modulus=cddf.Piecewise([0.05], [1.8e6, 1.0e6]))
    assert jump.breakpoints.tolist() == [0.05]


# --- what is refused --------------------------------------------------------------------------------


REFUSED = {
    "both": ({"youngs_modulus": 1e6}, "youngs_modulus and bending_stiffness are both given"),
    "one radius": ({"outer_radius": 0.01}, "belong together"),
    "density": ({"density": 1000.0}, "give mass_per_length instead"),
    "no point mass": ({"point_masses": (0.1,)}, "PointMass(arc_length="),
    "stiffness": ({"bending_stiffness": -0.02}, "bending_stiffness must be above 0: at s = 0 mm it is -0.02 N m^2"),
    "per length": ({"mass_per_length": -0.1}, "mass_per_length must be 0 or more: at s = 0 mm it is -0.1 kg/m"),
    "mass": ({"point_masses": (cddf.PointMass(0.1, -0.1),)}, "point mass 1: mass must be 0 or more, got -0.1 kg"),
    "place": (
        {"point_masses": (cddf.PointMass(0.3, 0.1),)},
        "point mass 1: arc_length 300 mm lies beyond the tip at 200 mm; put it on the body",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bodies_that_are_refused(case):
    """By their structure when they are made, by their numbers when they are validated."""
    changes, message = REFUSED[case]
    told = {"length": L, "tendons": (cddf.Tendon(0.008),), "friction_coefficient": 0.2, "bending_stiffness": 0.02}
    assert message in refused(lambda: cddf.Manipulator(**told | changes).validate(), error=ValueError)


def test_a_body_without_radii():
    body = robot().validate()
    task = {"free": ("bending_stiffness",), "bounds": {"bending_stiffness": (0.01, 0.03)}, "cases": cddf.LoadCase(1.0)}
    for asked in (lambda: body.area(0.1), lambda: cddf.design(body, cddf.Least("volume"), **task)):
        assert "the body has no radii; give it outer_radius and inner_radius" in refused(asked)
    with_radii = cddf.Manipulator(
        length=L,
        outer_radius=0.01,
        inner_radius=0.0,
        tendons=(cddf.Tendon(0.012),),
        friction_coefficient=0.2,
        bending_stiffness=0.02,
        density=1000.0,
    )
    message = "peak_strain: the body has no outer_radius; give it both radii"
    assert message in refused(lambda: cddf.sweep(body, {"base_tension": [1.0]}, outputs=["peak_strain"]))
    assert "offset must lie inside the wall" in refused(with_radii.validate)  # the wall is known
    np.testing.assert_allclose(with_radii.distributed_mass(0.1), 1000 * np.pi * 1e-4, rtol=1e-12)


def test_the_mass_of_a_design():
    from cddf_jax.designing.body_quantities import BODY_QUANTITIES, BodyView

    found = BODY_QUANTITIES["mass"].of(BodyView(robot(), np.zeros(1)))
    np.testing.assert_allclose(found, 0.15 * 0.8 * L + 0.030, rtol=1e-12)  # a line from 100 to 60 %, and the points


def test_gravity_on_a_body_without_mass_is_refused():
    """Also while the tensions are traced: body and loads are known. Other rooms say the same of files and sweeps."""
    body, fall = paper_body("exact"), cddf.Loads(gravity=(0.0, -9.81))
    message = "loads.gravity: the body has no weight, since its density is 0; give it density, mass_per_length or"
    for solve in (cddf.solve, cddf.tip_compliance, jax.jit(lambda *given: cddf.solve(body, given[1], fall).tip_angle)):
        assert message in refused(solve, body, 20.0, fall)


def test_numbers_have_names_and_units():
    from cddf_jax.statics.named_numbers import Case, unit_of_name

    case = Case(robot(), 1.0, loads(), 1.0)
    named = {"point_masses.0.mass": 0.020, "point_masses.1.arc_length": L, "bending_stiffness.base": 0.02}
    assert {name: float(case.number(name)) for name in named} == named
    units = ["point_masses.0.mass", "point_masses.1.arc_length", "bending_stiffness.base", "mass_per_length.tip"]
    assert [unit_of_name(name) for name in units] == ["kg", "m", "N m^2", "kg/m"]
    assert unit_of_name("bending_stiffness.length") == "m"
    longer = case.with_numbers({"length": 2 * L}).manipulator
    assert float(longer.point_masses[0].arc_length) == 0.16
    np.testing.assert_allclose(longer.stiffness(0.2), 0.9 * 0.02 * 0.8, rtol=1e-12)
    for name in ("youngs_modulus", "outer_radius"):
        assert f"{name}: the body has none" in refused(lambda name=name: case.number(name))


# --- files ------------------------------------------------------------------------------------------

FILE = """
length = "200 mm"
bending_stiffness = { base = "0.02 N m^2", tip = "12000 N mm^2" }
friction_coefficient = 0.25
stiffness_factor = 0.9
mass_per_length = { base = "0.15 kg/m", tip = "90 g/m" }

[[tendons]]
offset = "8 mm"

[[point_mass]]
at = "80 mm"
mass = "20 g"

[[point_mass]]
at = "200 mm"
mass = "10 g"
"""


def same(a: Any, b: Any) -> bool:
    return jax.tree.structure(a) == jax.tree.structure(b) and jax.tree.all(jax.tree.map(np.array_equal, a, b))


def test_files_and_back(tmp_path):
    (tmp_path / "body.toml").write_text(FILE)
    assert same(cddf.read_manipulator(tmp_path / "body.toml"), robot())
    modulus = cddf.Piecewise([0.05], [cddf.Constant(1.8e6), cddf.Linear(1.4e6, 1.0e6, 0.14)])
    for body in (robot(), paper_body("exact", youngs_modulus=modulus)):
        cddf.write_manipulator(body, tmp_path / "again.toml")
        assert same(cddf.read_manipulator(tmp_path / "again.toml"), body)
    (tmp_path / "body.toml").write_text(FILE.replace("[[point_mass]]", "[point_mass]", 1).split("[[point_mass]]")[0])
    assert "below a line [[point_mass]]" in refused(cddf.read_manipulator, tmp_path / "body.toml")


# --- fits -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_factor_on_the_stiffness_is_fitted_where_there_is_no_modulus():
    """Readings of a body of twice the stiffness, docs/theory.md (16): T_tip = T / (1 + mu T G), G = int d / (E I)."""
    G = quad(lambda s: OFFSET / (2 * 0.02 * (1 - 0.4 * s / L)), 0, L, epsrel=1e-12)[0]
    pull, noise = np.linspace(2.0, 16.0, 8), 1e-3 * np.array([1, -1, -1, 1, 1, -1, 1, -1])
    tip = pull / (1 + MU * pull * G)
    read = {"tip_tension": tip + noise, "tip_angle": np.log(pull / tip) / MU + noise}
    body = robot(Numbers(factor=None))
    fit = cddf.fit(body, cddf.Measurements.from_columns("bench", base_tension=pull, **read))
    assert fit.status == {"friction_coefficient": "identified", "stiffness_factor": "identified"}
    assert abs(fit.value["stiffness_factor"] - 2.0) < 3 * fit.standard_error["stiffness_factor"] < 0.1
    assert abs(fit.value["friction_coefficient"] - MU) < 3 * fit.standard_error["friction_coefficient"] < 0.1
    assert fit.manipulator.stiffness_factor == fit.value["stiffness_factor"]
    message = refused(lambda: cddf.fit(body, fit.tables, ("youngs_modulus",)))
    assert message == "fit: the body has no single youngs_modulus; fit stiffness_factor, which multiplies its stiffness"
    message = refused(lambda: cddf.fit(body, fit.tables, ("outer_radius_error",)))
    assert "changes nothing where bending_stiffness is given" in message
