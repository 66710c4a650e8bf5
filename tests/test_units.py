"""Quantities with units: exact decimal conversion, what is refused, the way back to text; every name has a unit."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusals import refused

from cddf_jax.designing.body_quantities import BODY_QUANTITIES
from cddf_jax.errors import InputError
from cddf_jax.files.actuation import TARGETS
from cddf_jax.identification.parameters import PARAMETERS
from cddf_jax.measurements.columns import COLUMNS
from cddf_jax.quantities import QUANTITIES
from cddf_jax.sweeping.one_solve import OUTPUTS
from cddf_jax.units import Dimension, quantity, to_si, written

DIMENSIONS = ("length", "force", "pressure", "density", "angle", "dimensionless")


def bits(value):
    return struct.pack("<d", value)


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [  # the value is the decimal one, as Python rounds its literal
        ("140 mm", "length", 0.14),
        ("-5.3 µm", "length", -5.3e-6),
        ("1 in", "length", 0.0254),  # the inch by definition
        ("75 N", "force", 75.0),
        ("7.5 kgf", "force", 73.549875),  # 7.5 * 9.80665 by hand
        ("1.4 MPa", "pressure", 1400000.0),
        ("1.07 g/cm^3", "density", 1070.0),
        ("0.42", "dimensionless", 0.42),
        ("0.8 %", "strain", 0.008),
        ("180 deg", "angle", math.pi),
        ("0.5 turn", "angle", math.pi),
    ],
)
def test_quantity_is_exact(text, dimension, value):
    assert bits(quantity(text, dimension, "x")) == bits(value)


def test_counts_have_a_unit_with_a_scale():
    counts = np.array([0.0, 20.0, -7.0])
    np.testing.assert_array_equal(to_si(counts, "0.05 mm", "length", "x"), counts * 5e-5)
    np.testing.assert_array_equal(to_si(counts, "-0.05mm", "length", "x"), counts * -5e-5)
    np.testing.assert_array_equal(to_si(counts, "1/m", "curvature", "x"), counts)  # one over a metre is a unit


@pytest.mark.parametrize(
    ("text", "dimension", "message"),
    [
        ("140", "length", "L needs a unit of length, got '140'; write for example '12.5 mm'"),
        ("140 N", "length", "L needs a unit of length, got '140 N'; write for example '12.5 mm'"),
        ("5 Grad", "angle", "L needs a unit of angle, got '5 Grad' with the unknown unit 'Grad'; write for"),
        ("5 mm", "strain", "L needs a unit of strain, got '5 mm'; write for example '12.5 %'"),
        ("0.42 mm", "dimensionless", "L is a plain number, got '0.42 mm'; leave the unit 'mm' out"),
        ("long", "length", "L is not a number, got 'long'; write for example '12.5 mm'"),
        (True, "dimensionless", "L is not a number, got True"),
        ("nan mm", "length", "L must be finite, got 'nan mm'; write"),
        ("1e400 N", "force", "L must be finite, got '1e400 N'"),
    ],
)
def test_quantity_refuses(text, dimension, message):
    assert message in refused(quantity, text, dimension, "L")


def test_columns_are_converted_like_single_numbers():
    numbers = np.random.default_rng(0).uniform(-200, 200, 2000).round(2)
    units: dict[str, Dimension] = {"mm": "length", "kN": "force", "deg": "angle", "lbf": "force", "m": "length"}
    for unit, dimension in units.items():
        single = [quantity(f"{number} {unit}", dimension, "x") for number in numbers]
        found = to_si(numbers, unit, dimension, "x")
        np.testing.assert_array_max_ulp(found, np.array(single), maxulp=2)  # factor and product are rounded
    np.testing.assert_array_equal(to_si(numbers, "mm", "length", "x"), numbers / 1000)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("N", "column tip_x needs a unit of length, got [N]; write for example [mm]"),
        ("", "column tip_x needs a unit of length, got none; write for example [mm]"),
        ("mmm", "column tip_x needs a unit of length, got [mmm] with the unknown unit 'mmm'; write for example [mm]"),
    ],
)
def test_columns_refuse(unit, message):
    with pytest.raises(InputError, match="^" + message.replace("[", r"\[") + "$"):
        to_si(np.zeros(3), unit, "length", "column tip_x")


@pytest.mark.parametrize(
    ("value", "dimension", "text"),
    [
        (0.14, "length", "140 mm"),
        (1.4e6, "pressure", "1.4 MPa"),
        (75.0, "force", "75 N"),
        (0.1 + 0.2, "length", "300.00000000000004 mm"),
        (1.2e-12, "length", "1.2E-9 mm"),
        (math.pi / 2, "angle", "90 deg"),
        (0.42, "dimensionless", "0.42"),
        (-0.0, "force", "-0 N"),
    ],
)
def test_written_as_an_engineer_would(value, dimension, text):
    assert written(value, dimension) == text


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(DIMENSIONS))
def test_written_reads_back_to_the_last_bit(value, dimension):
    assert bits(quantity(written(value, dimension), dimension, "x")) == bits(value)


@pytest.mark.parametrize("names", [OUTPUTS, PARAMETERS, COLUMNS, TARGETS, BODY_QUANTITIES])
def test_every_table_of_names_is_in_the_registry(names):
    assert set(names) <= set(QUANTITIES)


def test_every_quantity_has_a_known_dimension():
    assert all(known.dimension is None or known.unit for known in QUANTITIES.values())
