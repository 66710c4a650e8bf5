"""What `validate` lets pass and what it refuses, with the place and the remedy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body
from hypothesis import given, settings, strategies as st
from refusals import refused

import cddf_jax as cddf
from cddf_jax.statics.equilibrium_text import describe_crossing

BODY, TURN, AT_70_MM = paper_body("exact"), 2 * np.pi, 1e-3 * 70


def with_offset(offset, **tendon):
    return replace(BODY, tendons=(cddf.Tendon(offset, **tendon),))


def in_space(*tendons, **others):
    return replace(BODY, tendons=tuple(cddf.Tendon(offset, angle=angle) for offset, angle in tendons), **others)


def helix(turns, start=0.0):
    return cddf.Linear(start, start + TURN * turns, 0.14)


@pytest.mark.parametrize(
    "body",
    [
        BODY,
        replace(BODY, friction_coefficient=0.0, inner_radius=0.0),
        replace(BODY, outer_radius=lambda s: 0.02 - 0.3 * s**2),
        with_offset(cddf.Linear(0.020, 0.013, 0.14)),  # on the very surface
        with_offset(0.015, end=0.1),  # inside the wall until 0.1 m only: 20 mm - 0.1/0.14 * 7 mm = 15 mm
        with_offset(0.010, axial_stiffness=1.2e4, free_length=0.3),
        with_offset(cddf.Spline([0.0, 0.05, 0.1, 0.14], [0.012, 0.009, 0.010, 0.009])),
        replace(BODY, outer_radius=cddf.Piecewise([0.07], [cddf.Constant(0.02), cddf.Constant(0.015)])),
        in_space((0.010, 0.0), (0.010, 2.0), (0.010, 4.0)),
        in_space((0.010, 0.0), (0.011, 0.0)),  # one above the other
        in_space((0.010, helix(3)), (0.010, helix(3, 0.1))),  # side by side
        in_space((0.010, helix(1)), (0.012, helix(-1))),  # one winds around the other
        in_space((0.010, cddf.Piecewise([0.07], [cddf.Constant(0.5), cddf.Constant(0.5 + TURN)]))),
        replace(  # one ends before they would meet, at 70 mm
            BODY, tendons=[cddf.Tendon(0.01, angle=helix(0.25)), cddf.Tendon(0.01, angle=helix(-0.25, 1.57), end=0.069)]
        ),
        in_space((0.010, 0.0), poissons_ratio=0.8, rest_curvature=(0.0, helix(1), 2.0)),  # an effective ratio
    ],
)
def test_sound_bodies_pass(body):
    assert body.validate() is body


@settings(max_examples=20)
@given(
    st.floats(1e-3, 10),
    st.floats(0.3, 1),
    st.floats(0, 0.9),
    st.floats(0, 1),
    st.sampled_from([np.float64, np.float32]),
)
def test_scaled_cones_pass_in_either_precision(length, taper, bore, place, dtype):
    base = 0.2 * length
    inner, offset = bore * base, (bore + place * (1 - bore)) * base
    body = cddf.conical(
        length=length,
        outer_radius=(base, taper * base),
        inner_radius=(inner, taper * inner),
        tendon_offset=(offset, taper * offset),
        youngs_modulus=1e6,
        friction_coefficient=0.3,
    )
    jax.tree.map(lambda x: jnp.asarray(x, dtype), body).validate()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (replace(BODY, length=0.0), "length must be above 0, got 0 m; correct its value"),
        (replace(BODY, friction_coefficient=-0.1), "friction_coefficient must be 0 or more, got -0.1; correct its"),
        (replace(BODY, youngs_modulus=np.nan), "youngs_modulus must be finite, got nan; correct its value"),
        (with_offset(0.01, friction_coefficient=-0.2), "tendon 1: friction_coefficient must be 0 or more, got -0.2;"),
        (
            with_offset(0.01, end=0.15),
            "tendon 1: end at s = 150 mm lies beyond the tip at 140 mm; anchor it on the body, or leave end out for "
            "the tip",
        ),
        (
            # 20 mm - 7 mm * s / 140 mm falls to 15 mm at s = 100 mm, between two points of the grid 0.14 mm apart
            replace(BODY, inner_radius=0.015),
            "outer_radius must exceed inner_radius: at s = 100.1 mm they are 14.995 mm and 15 mm; "
            "make the wall thicker there or shorten the body",
        ),
        (
            replace(BODY, outer_radius=cddf.Linear(0.02, 0.013, 0.0)),  # 0 / 0
            "outer_radius must be finite: at s = 0 mm it is nan; correct the profile there",
        ),
        (
            with_offset(cddf.Linear(0.01, -0.01, 0.14)),
            "tendon 1: offset must be 0 or more: at s = 70.14 mm it is -0.02 mm; "
            "give the distance from the neutral axis, and the side by side=-1",
        ),
        (
            with_offset(0.015),  # leaves the wall after s = 100 mm by the line above
            "tendon 1: offset must lie inside the wall: at s = 100.1 mm it is 15 mm and the wall runs "
            "from 7 mm to 14.995 mm; move the tendon, or allow it with offsets_outside_wall",
        ),
        (
            with_offset(cddf.Piecewise([0.07], [cddf.Constant(0.01), cddf.Constant(0.011)])),
            "tendon 1: offset must not jump: at s = 70 mm it goes from 10 mm to 11 mm; make the pieces meet",
        ),
        (replace(BODY, outer_radius=lambda s: 0.02), "outer_radius must give one value per arc length, got shape ()"),
        (
            jax.tree.map(lambda x: np.stack([x, x]), BODY),
            "length must be one number, got shape (2,); validate one manipulator at a time",
        ),
        (
            in_space((0.010, 1.0), (0.012, 0.0), (0.010, 1.0 + TURN)),
            "tendons 1 and 3 must not touch or cross: at s = 0 mm they are 0 mm apart; "
            "change an offset or an angle",
        ),
        (  # a quarter of a turn on one side meets a quarter on the other in the middle; 1 % of the offset apart
            # 0.01 / pi of the length before
            in_space((0.010, helix(0.25)), (0.010, helix(-0.25, TURN / 4))),
            "tendons 1 and 2 must not touch or cross: at s = 69.58 mm they are 0.094 mm apart;",
        ),
        (  # a side is the angle 0 or pi
            replace(BODY, tendons=(cddf.Tendon(0.010), cddf.Tendon(0.010, angle=helix(0.5, -TURN / 4)))),
            "tendons 1 and 2 must not touch or cross: at s = 69.58 mm they are 0.094 mm apart;",
        ),
        (  # 10 turns against 10 turns, from half a turn apart: first together after 1/40 of the length
            in_space((0.010, helix(10)), (0.010, helix(-10, TURN / 2))),
            "tendons 1 and 2 must not touch or cross: at s = 3.5 mm they are ",
        ),
        (  # radii that cross at 1/3 of the length, and differ by 1 % of the greater one before
            in_space((cddf.Linear(0.012, 0.009, 0.14), 0.3), (cddf.Linear(0.0105, 0.012, 0.14), 0.3)),
            "tendons 1 and 2 must not touch or cross: at s = 43.",
        ),
        (
            in_space((0.010, cddf.Piecewise([0.07], [cddf.Constant(0.5), cddf.Constant(1.0)]))),
            "tendon 1: angle must not jump: at s = 70 mm it goes from 28.6479 deg to 57.2958 deg; make the pieces meet",
        ),
        (
            in_space((0.010, lambda s: jnp.log(s - AT_70_MM + 1e-9))),
            "tendon 1: angle must be finite: at s = 0 mm it is nan; correct the profile there",
        ),
        (
            in_space((0.01, 0.0), poissons_ratio=45.0),  # percent
            "poissons_ratio must be above -1 and at most 5, got 45; correct its value, or give torsional_stiffness",
        ),
        (
            in_space((0.01, 0.0), torsional_stiffness=cddf.Linear(0.02, -0.01, 0.14)),  # 0 after 2/3
            "torsional_stiffness must be above 0: at s = 93.38 mm it is -1e-05 N m^2; correct it there",
        ),
        (
            in_space((0.01, 0.0), extensible=True, shear_stiffness=-5.0),
            "shear_stiffness must be above 0: at s = 0 mm it is -5 N; correct it there",
        ),
        (
            in_space((0.01, 0.0), rest_curvature=(lambda s: jnp.sqrt(s - AT_70_MM), 0.0, 0.0)),
            "rest_curvature twist must be finite: at s = 0 mm it is nan; correct the profile there",
        ),
    ],
)  # fmt: skip
def test_refused_with_place_and_remedy(body, message):
    assert message in refused(body.validate)


def test_a_thin_place_between_grid_points_is_seen_at_a_breakpoint():
    ring = cddf.Piecewise([0.0500123, 0.0500124], [cddf.Constant(r) for r in (0.02, 0.005, 0.02)])
    message = refused(replace(BODY, outer_radius=ring).validate)
    assert message.startswith("outer_radius must exceed inner_radius: at s = 50.0123 mm they are 5 mm and 7 mm")


def test_offsets_outside_the_wall_may_be_allowed():
    body = with_offset(0.005)
    assert body.validate(offsets_outside_wall=True) is body
    assert "offset must be 0 or more" in refused(with_offset(-0.005).validate, offsets_outside_wall=True)


@pytest.mark.parametrize("transformation", [jax.jit, jax.vmap])
def test_traced_numbers_are_a_type_error(transformation):
    def validated(modulus):
        return replace(BODY, youngs_modulus=modulus).validate().youngs_modulus

    with pytest.raises(TypeError, match=r"validate: youngs_modulus is traced; call validate\(\) before jit"):
        transformation(validated)(jnp.array([1.4e6]))


def test_crossing_is_described_where_it_is_worst():
    # no friction, constant wall: kappa = T d / (E J + T d^2) (published), so d kappa = x / (1 + x), x = T d^2 / (E J)
    body = replace(BODY, outer_radius=0.020, friction_coefficient=0.0, kinematics="published")
    x = 900 * 0.01**2 / (1.4e6 * np.pi / 4 * (0.020**4 - 0.007**4))
    text = describe_crossing(cddf.solve(body, 900.0, throw=False))
    assert text == f"tendon 1: offset * curvature is {x / (1 + x):.3g} at s = 0 mm"
