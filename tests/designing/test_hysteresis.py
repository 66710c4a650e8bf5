"""The width of the loop of the tip angle, against closed forms (docs/hysteresis.md).

Exact kinematics, constant d, one tendon, g = mu d H / E with H = int_0^L ds / J. Pulled up from a low tension, and all
slid in, mu phi = ln(1 + g T). On the way down from T_max, with the front inside,
mu phi = ln[y (y_0 + g) / ((y + y_0) / 2)^2] with y = 1/T and y_0 = 1/T_max.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, paper_body, paper_plain, replaced
from refusals import refused

import cddf_jax as cddf
from cddf_jax.designing.body_quantities import BODY_QUANTITIES, BodyView
from cddf_jax.designing.task_file import read_task

L, MU = PAPER["length"], PAPER["friction_coefficient"]
LOW, AT, HIGH = 5.0, 40.0, 75.0
TASK = """
robot = "robot.toml"
nodes = 8
[free]
youngs_modulus = { bounds = ["0.5 MPa", "5 MPa"] }
[[case]]
base_tension = "40 N"
loop = ["5 N", "75 N"]
[[objective]]
least = "hysteresis"
[[limit]]
quantity = "tip_angle"
least = "0.9 rad"
"""


def closed(g, mu, low=LOW, at=AT, high=HIGH):
    """The width, rad."""
    y, before = 1 / at, 1 / high
    assert (y - before) / 2 < g < (1 / low - y) / 2
    return np.log(y * (before + g) / ((y + before) / 2) ** 2 / (1 + g * at)) / mu


FLOW = paper_plain("exact").compliance(L)  # d H, 1/m^2


@pytest.mark.slow
def test_a_design_of_least_hysteresis_has_the_width_of_the_closed_form(tmp_path):
    """The modulus of least width among those that bend to 0.9 rad at 40 N, from a task in a file."""
    cddf.write_manipulator(paper_body("exact"), tmp_path / "robot.toml")
    (tmp_path / "task.toml").write_text(TASK)
    found = read_task(tmp_path / "task.toml").design()
    assert found.success
    assert found.objectives[0].start == pytest.approx(closed(MU * FLOW / 1.4e6, MU), rel=1e-7)
    # where a pull to the middle tension bends the tip by a given angle the width is the same for all bodies
    assert found.objective == pytest.approx(closed(np.expm1(MU * 0.9) / AT, MU), rel=1e-6)
    assert found.value["youngs_modulus"] == pytest.approx(MU * FLOW * AT / np.expm1(0.9 * MU), rel=1e-6)
    assert "- least hysteresis: 14.798 deg -> 19.927 deg" in str(found)


def width_of(body, case):
    return BODY_QUANTITIES["hysteresis"].of(BodyView(body, jnp.zeros(1), case, case.solve(body)))


@pytest.mark.slow
def test_loads_and_other_tendons():
    """A tendon that is slack, and loads of 0 N, change nothing; under others the width is that of a finer path."""
    plain = closed(MU * FLOW / 1.4e6, MU)
    in_space = replace(paper_body("exact", num_tendons=2), tendons=(cddf.Tendon(0.010, angle=1.0), cddf.Tendon(0.008)))
    slack = cddf.LoadCase((AT, 0.0), loop=(LOW, HIGH))
    for body, case in ((paper_body("exact"), replace(slack, base_tension=AT, loads=cddf.Loads())), (in_space, slack)):
        assert width_of(body, case) == pytest.approx(plain, rel=1e-3)
    pair, loads = paper_body("exact", num_tendons=2), cddf.Loads(tip_force=(0.0, -1.0))
    path = [[HIGH, 10.0], [AT, 10.0], [LOW, 10.0], [AT, 10.0]]
    angle = cddf.trace(pair, path, loads, short_steps=64).tip_angle
    found = width_of(pair, cddf.LoadCase((AT, 10.0), loads, loop=(LOW, HIGH)))
    assert found == pytest.approx(float(angle[1] - angle[3]), rel=5e-3)


@pytest.mark.slow
def test_the_width_of_a_body_and_its_slopes_in_both_modes():
    """By modulus, friction and tensions of the loop, against differences of the closed form, right to 1e-8."""

    def width(p):
        body = replaced(paper_body("exact"), youngs_modulus=p[0] * 1e6, friction_coefficient=p[1])
        return width_of(body, cddf.LoadCase(p[3], loop=jnp.stack([p[2], p[4]])))

    def plain(p):
        return closed(p[1] * FLOW / (p[0] * 1e6), *p[1:])

    at = np.array([1.2, 0.42, LOW, AT, HIGH])
    value, forward, reverse = both_modes(width)(at)
    slopes = [(plain(at + step) - plain(at - step)) / (2 * np.max(step)) for step in np.diag(1e-4 * at)]
    assert value == pytest.approx(plain(at), rel=1e-9)
    assert forward == pytest.approx(slopes, rel=1e-6, abs=1e-9)
    assert reverse == pytest.approx(np.asarray(forward), rel=1e-9, abs=1e-12)
    assert np.isnan(jax.jit(width)(at[[0, 1, 3, 2, 4]]))  # a tension below the loop has no width


@pytest.mark.parametrize(
    ("case", "message"),
    [
        (cddf.LoadCase(AT), "'hysteresis' needs a loop of the load case, as in LoadCase(40.0, loop="),
        (
            cddf.LoadCase(cddf.TipAngle(1.0), loop=(LOW, HIGH), name="grip"),
            "needs tensions of grip in place of targets",
        ),
        (cddf.LoadCase(80.0, loop=(LOW, HIGH)), "80 N, must lie inside its loop, 5 to 75 N"),
    ],
)
def test_what_has_no_width(case, message):
    asked = paper_body(), cddf.Least("hysteresis"), ("youngs_modulus",)
    assert message in refused(cddf.design, *asked, cases=case)


@pytest.mark.parametrize("loop", [(75.0, 5.0), (5.0,), (5.0, np.nan)])
def test_what_is_no_loop(loop):
    assert "loop must be two tensions" in refused(cddf.LoadCase, AT, loop=loop)
