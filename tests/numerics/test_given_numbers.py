"""What enters from Python is a plain number, or it is refused in one line."""

from decimal import Decimal
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr
from bodies import PAPER, paper_body
from refusals import refused

import cddf_jax as cddf
from cddf_jax.identification.experiment_design import Candidate
from cddf_jax.numerics.given_numbers import check_numbers

UNITS = pint.UnitRegistry()
PULL = UNITS.Quantity(75, "force_pound")
MASKED = np.ma.masked_array([10.0, 20.0], mask=[False, True])

# each of them NumPy turns into float64 without an error
REFUSED = {
    "a unit": (PULL, "a number with a unit"),
    "an array with a unit": (np.array([1.0, 2.0]) * UNITS.N, "a number with a unit"),
    "an array of xarray in pounds": (xr.DataArray([1.0], attrs={"units": "lbf"}), "a number with a unit"),
    "a unit inside xarray": (xr.DataArray(np.array([1.0]) * UNITS.lbf), "a number with a unit"),
    "a mask": (MASKED, "a masked value"),
    "text": ("75", "text"),
    "a truth value": (True, "a truth value"),
    "truth values of JAX": (jnp.array([True]), "a truth value"),
    "a complex number": (75 + 1j, "a complex number"),
    "a date": (np.datetime64("2026-01-01"), "a date or duration"),
    "a duration": (np.timedelta64(75, "s"), "a date or duration"),
    "nothing": (None, "something other than a number"),
    "a mapping": ({"a": 75.0}, "something other than a number"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_plain_number(name):
    given, words = REFUSED[name]
    said = refused(check_numbers, "load", given)
    assert said.startswith(f"load: {words} cannot be used, got ")
    assert ("pint: value.to_base_units().magnitude" in said) == ("unit" in words)


def test_plain_numbers():
    plain = [75, 75.0, np.float32(75), Decimal(75), Fraction(75, 2), [1, [2.0]], np.arange(3), [8.0, None], MASKED[:1]]
    series = [pd.Series([1.0]), pd.Series([1.0, None], dtype="Float64"), xr.DataArray([1.0], attrs={"units": "N"})]
    for given in [*plain, *series, np.array([1.0, None], object), jnp.ones(2), jnp.ones(2, jnp.bfloat16)]:
        check_numbers("load", given)
    jax.jit(lambda traced: check_numbers("load", [traced, 1.0]))(1.0)


TABLE = {"base_tension": [10.0, 20.0], "tip_tension": [8.0, 15.0]}
IN_ORDER = cddf.Measurements.from_columns(**TABLE, step=[1, 2])
CASE = cddf.LoadCase(10.0)
ENTRIES = {
    "solve": lambda given: cddf.solve(paper_body(), given),
    "direction": lambda given: cddf.solve(paper_body(), 75.0, direction=given),
    "length": lambda given: cddf.conical(**PAPER | {"length": given}),
    "tendon": lambda given: cddf.Tendon(offset=given),
    "point mass": lambda given: cddf.PointMass(arc_length=0.1, mass=given),
    "profile": lambda given: cddf.Piecewise.linear([0.0, given], [0.02, 0.01]),
    "loads": lambda given: cddf.Loads(tip_force=(0.0, given)),
    "target": cddf.TipAngle,
    "trace": lambda given: cddf.trace(paper_body(), [10.0, given]),
    "axis": lambda given: cddf.sweep(paper_body(), {"base_tension": [10.0, given]}),
    "column": lambda given: cddf.Measurements.from_columns(**TABLE | {"tip_tension": [8.0, given]}),
    "limit": lambda given: cddf.Limit("wall_thickness", least=given),
    "bounds of a design": lambda given: cddf.design(
        paper_body(), cddf.Least("mass"), ("outer_radius",), {"outer_radius": (8e-3, given)}, cases=CASE
    ),
    "start": lambda given: cddf.least_squares_fit(lambda p: p["a"], {"a": given}, np.ones(1)),
    "noise": lambda given: cddf.least_squares_fit(lambda p: p["a"], {"a": 1.0}, np.ones(1), given),
    "prior": lambda given: cddf.least_squares_fit(
        lambda p: p["a"], {"a": 1.0}, np.ones(1), 0.1, priors={"a": (1.0, given)}
    ),
    "bounds": lambda given: cddf.least_squares_fit(
        lambda p: p["a"], {"a": 1.0}, np.ones(1), 0.1, bounds={"a": (0.0, given)}
    ),
    "marker": lambda given: cddf.BenchSetting(markers={"head": cddf.Marker(given)}),
    "past": lambda given: cddf.fit(paper_body(), IN_ORDER, before=given),
    "noise of the base": lambda given: cddf.fit(paper_body(), IN_ORDER, noise={"base_tension": given}),
    "candidate": lambda given: Candidate("pull", {"base_tension": given}, {"tip_tension": 0.1}),
}


@pytest.mark.parametrize("name", ENTRIES)
def test_every_entry_refuses(name):
    for given, words in ((PULL, "a number with a unit"), (MASKED[1], "a masked value"), (True, "a truth value")):
        assert words in refused(ENTRIES[name], given)
