"""The limits without friction and without tension."""

import numpy as np
import pytest
from bodies import paper_body, paper_plain
from scipy.integrate import quad

import cddf_jax as cddf

ROUNDING = 1e-12  # the same operations in another order


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_without_friction_the_tension_is_that_at_the_base(kinematics):
    """Exact: kappa = d T / (E J); published, eq. (17) integrated: d T / (E J + T d^2). SciPy integrates to the tip."""
    solution = cddf.solve(paper_body(kinematics, friction_coefficient=0.0), 50.0)
    np.testing.assert_array_equal(solution.tension, 50.0)
    np.testing.assert_array_equal(solution.tension_loss, 0.0)

    def curvature(s):
        return 0.010 * 50.0 / (1.4e6 * paper_plain().second_moment(s) + (kinematics == "published") * 50.0 * 0.010**2)

    np.testing.assert_allclose(solution.curvature, curvature(np.asarray(solution.arc_length)), rtol=ROUNDING)
    np.testing.assert_allclose(solution.tip_angle, quad(curvature, 0, 0.14, epsrel=1e-13)[0], atol=1e-9)


def test_no_tension_no_bending():
    solution = cddf.solve(paper_body("published"), 0.0)
    np.testing.assert_array_equal(solution.curvature, 0.0)
    np.testing.assert_array_equal(solution.tip_tension, 0.0)
    np.testing.assert_allclose(solution.tip_position, [0.14, 0.0], atol=ROUNDING)
