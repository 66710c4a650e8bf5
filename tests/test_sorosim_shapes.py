"""The study of shapes of another toolbox, fitting/sorosim_shapes.py; the shapes are those of data/sorosim_statics."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cddf_jax as cddf

STUDY = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[1] / "fitting" / "sorosim_shapes.py")))


@pytest.mark.slow
def test_shapes_of_another_toolbox():
    """Every twelfth one. They are exact to what their printed loads are; the study itself solves all."""
    given = STUDY.read()
    assert given.position.shape == (500, 14, 3)
    some = given._replace(loads=given.loads[::12], position=given.position[::12])
    found = STUDY.compared(some)
    np.testing.assert_array_equal(found.status, cddf.Status.successful)
    assert np.max(found.apart) < STUDY.ALLOWED
    assert np.all(found.apart[:, -1] < found.by_rounding[:, -1])
