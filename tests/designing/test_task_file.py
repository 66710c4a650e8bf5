"""What cannot be designed is refused in one line that names what is wrong, and the remedy."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_with
from refusals import refused

import cddf_jax as cddf
from cddf_jax.designing.body_quantities import BODY_QUANTITIES
from cddf_jax.designing.free_numbers import free_numbers_of
from cddf_jax.robot.profiles import Shifted
from cddf_jax.robot.reshape import stretched

MASS = cddf.Least("mass")
TENSION = cddf.Least("base_tension")


def refused_design(message, body=None, **changes):
    asked = {"objective": TENSION, "free": ("outer_radius",), "cases": cddf.LoadCase(50.0)} | changes
    assert message in refused(cddf.design, paper_body("exact") if body is None else body, **asked)


# --- what is free --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"free": ()}, "free must list one name or more"),
        ({"free": "outer_radius"}, "free must list one name or more"),
        ({"free": ("outer_radios",)}, "did you mean 'outer_radius'?"),
        ({"free": ("outer_radius", "outer_radius.tip")}, "'outer_radius.tip' is free twice; leave one out"),
        ({"free": ("outer_*",)}, "'outer_*': a * stands for all tendons, as in 'tendons.*.offset'"),
        ({"free": ("tendons.0.end",)}, "'tendons.0.end' is not a number here; give it a value at the start"),
        ({"free": ("density",)}, "'density' starts at 0; give it bounds"),
        ({"free": ("direction",)}, "a direction cannot be free; it is 1 or -1"),
    ],
)
def test_what_cannot_be_free(changes, message):
    refused_design(message, **changes)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"inner_radius": (1e-3, 9e-3)}, "'inner_radius' has bounds and is not free; add it to free"),
        ({"outer_radius": 0.03}, "the bounds of 'outer_radius' must be (lower, upper), got 0.03"),
        ({"outer_radius": (0.01, "thick")}, "the bounds of 'outer_radius': text cannot be used, got 'thick'"),
        ({"outer_radius": (0.03, 0.01)}, "the bounds of 'outer_radius' must be finite and increase, got 0.03 and 0.01"),
        ({"outer_radius": (0.015, 0.03)}, "'outer_radius' starts at 0.013, outside its bounds 0.015 to 0.03; widen"),
    ],
)
def test_invalid_bounds(bounds, message):
    refused_design(message, bounds=bounds)


def test_tendons_of_different_kinds_share_no_number():
    body = paper_with(cddf.Tendon(0.010), cddf.Tendon(cddf.Linear(0.012, 0.009, 0.14), -1))
    message = "'tendons.*.offset': the tendons are of different kinds; name them one by one"
    refused_design(message, body, free=("tendons.*.offset",), cases=cddf.LoadCase((50.0, 10.0)))


def test_a_profile_of_an_unknown_kind():
    odd = replace(paper_body("exact"), outer_radius=Shifted(cddf.Linear(0.02, 0.013, 0.14), 1e-3))
    refused_design("outer_radius is not one number; name a number of it: outer_radius.profile.base,", odd)
    message = "a profile of type Shifted cannot be stretched with the length; keep the length fixed"
    assert message in refused(stretched, odd, 0.15)


def test_default_bounds():
    """A tenth of the start, and ten times it; scaled from 0 at the lower bound in units of the start."""
    from cddf_jax.statics.named_numbers import Case

    space = free_numbers_of(Case(paper_body("exact"), 50.0, None, 1), ("youngs_modulus", "outer_radius"), {})
    assert space.names == (("youngs_modulus",), ("outer_radius.base",), ("outer_radius.tip",))
    assert space.lower == pytest.approx([1.4e5, 2e-3, 1.3e-3], rel=1e-12)
    assert space.upper == pytest.approx([1.4e7, 0.2, 0.13], rel=1e-12)
    assert space.scaled(space.start) == pytest.approx([0.9, 0.9, 0.9], rel=1e-12)
    assert space.numbers(space.scaled(space.start)) == pytest.approx(space.start, rel=1e-12)


# --- what is wanted ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        ("mass", "the objective must be one such as Least(\"mass\") or a function, got 'mass'"),
        ([], "give an objective"),
        ([TENSION, MASS], "several objectives are a list of pairs (weight, objective)"),
        ([(0.0, TENSION)], "the weight of least base_tension must be above 0, got 0"),
        ([(np.nan, TENSION)], "a weight must be finite, got nan"),
        (MASS, 'the body has no mass, since its density is 0; give it one, or take "volume"'),
        (lambda body, found: found.position, "has shape"),
        (cddf.Least("tip_position"), "tip_position has shape"),
        (cddf.Near("tip_position", (1.0, 2.0, 3.0)), "tip_position has shape"),
        (cddf.Near("curvature", 5.0, at=[0.1, 0.5]), "compared at 0.5 m, beyond the tip at 0.14 m"),
        (cddf.Near("position", [[0.0, 0.0], [0.1, 0.0]]), "say where"),
        (lambda body, found: jnp.log(0.01 - body.length), "has no finite value for the start"),
    ],
)
def test_what_is_no_objective(objective, message):
    refused_design(message, objective=objective)


@pytest.mark.parametrize("kind", [cddf.Least, cddf.Limit])
def test_an_unknown_quantity_is_answered_with_the_known_ones(kind):
    said = refused(kind, "weight")
    assert "'weight' is not a quantity of a body; known are " in said
    assert all(name in said for name in BODY_QUANTITIES)


def test_what_does_not_vary_along_the_body():
    message = "mass varies neither along the body nor between tendons; take Least or Most of it"
    assert message in refused(cddf.Even, "mass")
    message = "Near(at=...) takes a list of arc lengths, and a quantity that varies along the body"
    assert message in refused(cddf.Near, "tip_angle", 1.0, at=[0.1])
    assert message in refused(cddf.Near, "curvature", 1.0, at=0.1)


# --- what must be kept ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("quantity", "sides", "message"),
    [
        ("mass", {}, "a limit of mass needs least, most or both, or else equal"),
        ("strain", {"equal": 0.1}, "strain varies along the body and cannot equal one value; take Near or Even of it"),
        ("mass", {"least": 2.0, "most": 1.0}, "mass cannot be at least 2 and at most 1; exchange them"),
        ("tip_position", {"equal": (0.1, 0.0)}, "tip_position must be a finite number, got equal=[0.1, 0.0]"),
        ("strain", {"most": np.nan}, "strain"),  # no number is below NaN, and none above
    ],
)
def test_what_is_no_limit(quantity, sides, message):
    assert message in refused(cddf.Limit, quantity, **sides)


def test_limits_of_a_design():
    refused_design("constraints must be a list of limits, as in [Limit(", constraints=[("mass", 1.0)])
    refused_design("the body has no mass", constraints=[cddf.Limit("mass", most=1.0)])


# --- how it is used ------------------------------------------------------------------------------

SOFT = cddf.LoadCase(50.0, numbers={"youngs_modulus": 1e6}, name="soft")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cases": []}, "cases must be one LoadCase or more"),
        ({"free": ("youngs_modulus",), "cases": SOFT}, "'youngs_modulus' is free, and soft sets it; leave one out"),
        ({"cases": cddf.LoadCase(50.0, numbers={"young_modulus": 1e6})}, "did you mean 'youngs_modulus'?"),
        ({"starts": 0}, "starts must be a whole number of 1 or more, got 0"),
        ({"nodes": True}, "nodes must be a whole number of 4 or more"),
        ({"worst": 1}, "worst must be true or false, got 1"),
    ],
)
def test_how_a_body_cannot_be_used(changes, message):
    refused_design(message, **changes)


@pytest.mark.parametrize("weight", [0.0, np.nan])
def test_a_case_that_counts_nothing(weight):
    assert "the weight must be above 0" in refused(cddf.LoadCase, 50.0, weight=weight)


def test_a_start_without_equilibrium():
    """A Young's modulus below zero is none; the case is named."""
    body = paper_body("exact", youngs_modulus=-1.0)
    refused_design("the start has no equilibrium in grip: ", body, cases=[cddf.LoadCase(50.0, name="grip")])
