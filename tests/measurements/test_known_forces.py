"""Columns of forces at places of the body; expected values by hand."""

import numpy as np
import pytest

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.measurements.columns import column_dimension, column_meant, column_resembled
from cddf_jax.measurements.forces import check_on_body, forces_of


def test_the_names_of_columns():
    spelled = ("force_y@60mm", "Force_Y @ 60 mm", "F y@60mm", "fy@60 mm")
    assert {column_meant(name) for name in spelled} == {"force_y@60mm"}
    assert column_meant("Tip Force_x") == column_meant("tip_force_x") == "tip_force_x"
    assert column_meant("x@60mm") == "x@60mm"  # a marker
    assert column_dimension("force_y@60mm") == "force"
    assert column_resembled("Force @ 60 mm") == "force_y@60mm"  # of which component is not said


def test_a_file_with_a_weight_on_the_body(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("base_tension [N],tip_force_x [N],force_y@6 cm [mN],tip_angle [deg]\n5,1,-200,3\n6,0,0,4\n")
    table = cddf.read_measurements(path)
    places, forces = forces_of(table.columns, len(table))
    assert places == {"6cm": 0.06}
    np.testing.assert_allclose(forces, [[(1.0, 0.0), (0.0, -0.2)], [(0.0, 0.0), (0.0, 0.0)]])


def test_a_force_that_is_not_on_the_body():
    with pytest.raises(InputError, match="force @head is not a number, got 'head'; write for example"):
        forces_of({"force_x@head": np.zeros(2)}, 2)
    for place in (0.0, 0.2):
        with pytest.raises(InputError, match="force @there: it must act above 0 and up to the tip at 140 mm, not at "):
            check_on_body({"there": place}, 0.14)


def test_a_known_force_is_needed_in_every_row():
    columns = {"base_tension": [1.0, 2.0], "tip_angle": [0.1, 0.2], "force_y@60mm": [1.0, np.nan]}
    with pytest.raises(InputError, match="row 2, column force_y@60mm: must be finite"):
        cddf.Measurements.from_columns("bench", **columns)
