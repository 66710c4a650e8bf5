"""The registry of quantities: names, dimensions and words in one place."""

import pytest

from cddf_jax.designing import body_quantities
from cddf_jax.files.actuation import TARGETS
from cddf_jax.identification.parameters import PARAMETERS
from cddf_jax.measurements.columns import COLUMNS
from cddf_jax.quantities import QUANTITIES, dimension_of
from cddf_jax.sweeping.one_solve import OUTPUTS


@pytest.mark.parametrize("names", [OUTPUTS, PARAMETERS, COLUMNS, TARGETS, body_quantities.BODY_QUANTITIES])
def test_every_table_of_names_is_in_the_registry(names):
    assert set(names) <= set(QUANTITIES)


def test_words_labels_and_units():
    assert QUANTITIES["tip_tension"].words == "tip tension"
    assert QUANTITIES["tip_angle"].words == "heading of the tip"
    assert QUANTITIES["tip_x"].label == "Tip position X"
    assert QUANTITIES["tension"].axis_label == "Tension $T$ (N)"
    assert QUANTITIES["strain"].shown == (100.0, "%")
    assert QUANTITIES["youngs_modulus"].shown == (1e-6, "MPa")
    assert [QUANTITIES[name].unit for name in ("drag", "yield_strain", "stable")] == ["N/m", "1", ""]
    with pytest.raises(AssertionError, match="stable"):
        dimension_of("stable")
