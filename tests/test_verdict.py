"""When the rows of a table cannot have told a parameter, from the results of their solves."""

from types import SimpleNamespace

import numpy as np
import pytest

from cddf_jax.equilibrium import RESULTS
from cddf_jax.measurements import Measurements
from cddf_jax.verdict import Look, doubt


def look(stated=False, **counts):
    """Ten rows of which so many end in each result, the first ones; lines 3 to 12 of a file."""
    codes = [getattr(RESULTS, name)._value for name, count in counts.items() for _ in range(count)]
    codes += [RESULTS.successful._value] * (10 - len(codes))
    table = Measurements("bench", {"base_tension": np.arange(10.0)}, np.arange(3, 13))
    return Look("bench", table, SimpleNamespace(_value=np.array(codes)), stated)


@pytest.mark.parametrize(
    ("counts", "kinds"),
    [({"crossing": 6}, "crossing"), ({"crossing": 3, "not_converged": 3}, "not converged, crossing")],
)
def test_most_rows_without_a_body(counts, kinds):
    assert f"(6 of 10, the first is row 3: {kinds})" in doubt(look(stated=True, **counts))


def test_half_of_the_rows_are_not_most():
    assert doubt(look(crossing=5)) == ""
    assert doubt(look(inaccurate=10)) == ""  # a matter of nodes


def test_a_stated_direction_is_believed():
    assert doubt(look(stated=True, direction_contradicted=10)) == ""


def test_a_direction_that_nobody_stated_is_not():
    told = doubt(look(direction_contradicted=1))
    assert told.startswith(
        "tendons travel against the direction taken for them in 1 of 10 rows of bench (the first is row 3)"
    )
