"""The registry of quantities has every name."""

import pytest

from cddf_jax.designing import body_quantities
from cddf_jax.files.actuation import TARGETS
from cddf_jax.identification.parameters import PARAMETERS
from cddf_jax.measurements.columns import COLUMNS
from cddf_jax.quantities import QUANTITIES
from cddf_jax.sweeping.one_solve import OUTPUTS


@pytest.mark.parametrize("names", [OUTPUTS, PARAMETERS, COLUMNS, TARGETS, body_quantities.BODY_QUANTITIES])
def test_every_table_of_names_is_in_the_registry(names):
    assert set(names) <= set(QUANTITIES)
