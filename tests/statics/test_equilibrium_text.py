"""What `print` shows: numbers with units in a few lines, shapes where numbers are traced or batched."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from bodies import paper_body, two_slanted_tendons

import cddf_jax as cddf


@pytest.mark.parametrize(("ratio", "count"), [(0.5, 0), (0.8, 1)])  # an isotropic material has 0.5 at most
def test_a_poissons_ratio_that_no_material_has(ratio, count):
    body = replace(paper_body("exact"), poissons_ratio=ratio)
    remarks = cddf.solve(body, 40.0, space=True).remarks
    assert [remark.startswith("poissons_ratio = 0.8 is above 0.5") for remark in remarks] == [True] * count
    assert cddf.solve(body, 40.0).remarks == ()  # in the plane nothing depends on it


def test_under_vmap_and_jit_there_are_shapes():
    told = []

    def tip(tension):
        bent = cddf.solve(paper_body(), tension)
        told.extend([str(bent), str(replace(paper_body(), length=tension))])
        return bent

    batch = jax.jit(jax.vmap(tip))(np.array([10.0, 75.0, -1.0]))
    assert "tip_position=f64[2]" in told[0]
    assert told[1].startswith("Manipulator(")
    assert "tip_position=f64[3,2]" in str(batch)
    assert cddf.in_words(batch.status) == "2 successful, 1 unphysical"


def test_a_manipulator():
    wavy = cddf.Tendon(lambda s: 0.010 + 0.001 * np.sin(np.pi * s / 0.1) ** 2, -1, end=0.1, friction_coefficient=0.3)
    pair = two_slanted_tendons(density=1070.0)
    body = replace(pair, tendons=(*pair.tendons, wavy), drag=0.5, yield_strain=0.1)
    assert str(body).splitlines() == [
        "Manipulator of 140 mm, exact kinematics",
        "outer_radius 20 mm at the base, 13 mm at s = 140 mm",
        "inner_radius 7 mm",
        "youngs_modulus 1.4 MPa, friction_coefficient 0.42, density 1070 kg/m^3, drag 0.5 N/m, yield_strain 10 %",
        "tendon 1: offset 12 mm at the base, 9 mm at s = 140 mm, side +1",
        "tendon 2: offset 12 mm at the base, 9 mm at s = 140 mm, side -1",
        "tendon 3: offset 10 mm at the base, 10 mm at s = 100 mm (from 10 mm to 11 mm), side -1, "
        "end 100 mm, friction_coefficient 0.3",
    ]
