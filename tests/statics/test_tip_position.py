"""A position of the tip instead of base tensions: reached, nearest, least sum, limits, derivatives.

Parallel tendons of one friction that all slide in keep the ratio of their tensions, so that they pull as one with
the moment M = |sum of T d e^(i angle)|. On an even body, eq. (13) with a = mu M / (E J): the heading after s is
ln(1 + a s) / mu, in the plane at the angle of the sum. Of all tensions with one sum, two neighbours alone pull least.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, codes
from places import ROOT
from refusals import refused
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

import cddf_jax as cddf

L, d, MU, E, RADIUS = 0.2, 0.005, 0.3, 2e7, 0.006
STIFFNESS = E * np.pi / 4 * RADIUS**4
ANGLES = 2 * np.pi / 3 * np.arange(3)
PULLED = np.array([20.0, 12.0, 3.0])
LEAST = np.array([17.0, 9.0, 0.0])  # the same sum of arms, without what cancels


def body(tendons=tuple(cddf.Tendon(d, angle=angle) for angle in ANGLES)):
    return cddf.Manipulator(
        length=L,
        outer_radius=RADIUS,
        inner_radius=0.0,
        tendons=tendons,
        youngs_modulus=E,
        friction_coefficient=MU,
    )


def tip_of(tensions):
    """The closed form."""
    moment = d * np.sum(np.asarray(tensions) * np.exp(1j * ANGLES))
    a = MU * np.abs(moment) / STIFFNESS
    along = quad(lambda s: np.cos(np.log1p(a * s) / MU), 0, L, epsabs=1e-14)[0]
    aside = quad(lambda s: np.sin(np.log1p(a * s) / MU), 0, L, epsabs=1e-14)[0]
    turned = moment / np.abs(moment)
    return np.array([along, aside * turned.real, aside * turned.imag])


def nearest(place):
    """The tensions of tendons 1 and 2 whose tip is nearest to a place between them, by a search over M alone."""
    angle = np.arctan2(place[2], place[1])
    one, two = np.linalg.solve([np.cos(ANGLES[:2]), np.sin(ANGLES[:2])], [np.cos(angle), np.sin(angle)])
    along = np.array([one, two, 0.0])
    found: Any = minimize_scalar(
        lambda pull: np.sum((tip_of(pull * along) - place) ** 2), bounds=(5, 60), options={"xatol": 1e-11}
    )
    return found.x * along


class Lane(NamedTuple):
    place: np.ndarray
    least: float = 0.0
    most: float = 1e3
    tension: np.ndarray | float = np.nan  # wanted
    status: cddf.Status = cddf.Status.unphysical


REACHABLE, BEYOND = tip_of(PULLED), tip_of(PULLED) + np.array([0.01, 0.003, 0.002])
LANES = [
    Lane(REACHABLE, tension=LEAST, status=cddf.Status.successful),
    Lane(REACHABLE, least=1.5, tension=LEAST + 1.5, status=cddf.Status.direction_contradicted),  # tendon 3 is paid out
    Lane(BEYOND, tension=nearest(BEYOND), status=cddf.Status.unreachable),
    Lane(tip_of([20.0, 0, 0]), most=5.0, tension=np.array([5.0, 0, 0]), status=cddf.Status.unreachable),
    Lane(REACHABLE * np.nan),
    Lane(REACHABLE, least=-1.0),
    Lane(REACHABLE, least=3.0, most=2.0),
]


def reach(numbers):
    target = cddf.TipPosition(numbers[:3], minimum_tension=numbers[3], maximum_tension=numbers[4])
    found = cddf.solve(body(), target, direction=1.0, nodes=8, throw=False)
    return found.base_tension, found


NUMBERS = np.stack([[*lane.place, lane.least, lane.most] for lane in LANES])


@pytest.fixture(scope="module")
def reached():
    """The equilibria of the lanes."""
    return jax.jit(jax.vmap(lambda numbers: reach(numbers)[1]))(NUMBERS)


def test_the_least_tensions_that_reach_a_place_or_come_nearest(reached):
    assert codes(reached.status) == [lane.status for lane in LANES]
    for i, lane in enumerate(LANES):
        # the nearest place has a level minimum, found to 1e-7 of the tensions by SciPy and by us
        np.testing.assert_allclose(reached.base_tension[i], lane.tension, rtol=2e-7, atol=1e-7)
    np.testing.assert_allclose(reached.base_tension[:2], np.stack([LEAST, LEAST + 1.5]), rtol=1e-9, atol=1e-9)


def test_the_miss_and_the_rank_are_reported(reached):
    for i, lane in enumerate(LANES[:4]):
        np.testing.assert_allclose(reached.target_miss[i], tip_of(lane.tension) - lane.place, atol=1e-9)
    assert np.all(np.isnan(reached.target_miss[4:]))
    # an axis that neither stretches nor shears has two directions to bend; a third tendon adds none
    assert reached.target_rank[:2].tolist() == [2, 2]


@pytest.mark.slow
def test_derivatives_in_both_modes_undo_those_of_the_tip():
    """Of the tensions by place, least and most."""
    derivatives = jax.jit(jax.vmap(both_modes(lambda numbers: reach(numbers)[0])))
    h = 1e-4
    for lanes in derivatives(NUMBERS)[1:]:
        by_place, by_least = lanes[1, :, :3], lanes[1, :, 3]  # among lanes that fail
        steps = h * np.eye(3)[:2]
        pushed = np.stack([(tip_of(LEAST + step) - tip_of(LEAST - step)) / (2 * h) for step in steps], axis=1)
        np.testing.assert_allclose(by_place @ pushed, np.eye(3)[:, :2], atol=1e-6)
        np.testing.assert_allclose(by_least, 1.0, rtol=1e-7)  # what all tendons pull alike cancels


def in_plane(ends):
    return body(tuple(cddf.Tendon(d, end=end) for end in ends))


def test_two_segments_in_the_plane_reach_what_their_tensions_give():
    two, pulled = in_plane((L, L / 2)), jnp.array([15.0, 9.0])
    tip = cddf.solve(two, pulled, direction=1, nodes=8).tip_position
    found = cddf.solve(two, cddf.TipPosition(tip), direction=1, nodes=8)
    np.testing.assert_allclose(found.base_tension, pulled, rtol=1e-7)
    np.testing.assert_allclose(found.target_miss, 0.0, atol=1e-9 * L)
    assert found.target_rank == 2


def test_two_tendons_in_one_place_leave_their_tensions_open():
    twins = in_plane((L, L))
    found = cddf.solve(twins, cddf.TipPosition(tip_of([20.0, 0, 0])[:2]), direction=1, nodes=8, throw=False)
    assert found.status == cddf.Status.undetermined
    assert float(jnp.sum(found.base_tension)) == pytest.approx(20.0, rel=1e-9)
    assert found.target_rank == 1


@pytest.mark.slow
def test_a_place_under_gravity_is_reached_where_one_more_pass_changes_a_little():
    """Passes end with a change of 3e-11 there, since the next one would change less than 1e-12."""
    robot = cddf.read_manipulator(ROOT / "data" / "three_tendons_made_up.toml")
    pull, gravity = np.array([0.0, 24.4, 19.4]), cddf.Loads(gravity=(0.0, 0.0, -9.81))
    place = cddf.solve(robot, pull, gravity).tip_position
    np.testing.assert_allclose(cddf.solve(robot, cddf.TipPosition(place), gravity).base_tension, pull, atol=1e-7)


@pytest.mark.slow
def test_a_place_is_reached_with_directions_that_fit_where_there_are_some():
    """Beside these pulls, others reach the place with a tendon of which a part sticks: no direction fits it."""
    pull = (12.145884, 22.237196, 0.0)
    robot = cddf.read_manipulator(ROOT / "data" / "three_tendons_made_up.toml")
    pulled = cddf.solve(robot, pull)
    assert not np.any(pulled.direction_contradicted)
    found = cddf.solve(robot, cddf.TipPosition(pulled.tip_position))
    assert not np.any(found.direction_contradicted)
    assert found.status == cddf.Status.successful
    np.testing.assert_allclose(found.tip_position, pulled.tip_position, atol=1e-9)
    assert float(jnp.sum(found.base_tension)) <= sum(pull) + 1e-6


AT = (0.1, 0.1, 0.0)
REFUSED = {
    "one of several": (body(), [cddf.TipPosition(AT), 1.0, 2.0], "a TipPosition stands for all base tensions; give it"),
    "two in space": (body(), cddf.TipPosition(AT[:2]), "3 components, m, in space, got shape (2,)"),
    "three in the plane": (in_plane((None,)), cddf.TipPosition(AT), "2 components, m, in the plane (space=True makes"),
    "limits": (body(), cddf.TipPosition(AT, minimum_tension=(1.0, 2.0)), "one per tendon (3), N, got shape (2,)"),
    "no value": (body(), cddf.TipPosition, "solve: TipPosition needs a value, as in TipPosition(...)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_one_line(case):
    *told, message = REFUSED[case]
    assert message in refused(cddf.solve, *told, error=(TypeError, ValueError))
