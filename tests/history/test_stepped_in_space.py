"""`trace` of several tendons in space, under loads, by displacements.

The tables are those of an independent code (NumPy; elements and increments refined until tips moved by less than 0.003
mm). Their tensions are good to 1e-3 N, next to a neutral point to 0.02 N. Other origins stand beside the values.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, paper_body, paper_with
from refusals import refused
from scipy.spatial.transform import Rotation

import cddf_jax as cddf

LENGTH, PI = 0.14, np.pi
# base tensions, N, or displacements, m; tip force, N; tip, mm; tip tensions, N (None where only very small slips of
# resting tendons determine them)
THREE = (
    ((2.0, 2.0, 2.0), (0.0, 0.0, 0.0), (140.0, 0.0, 0.0), (2.0, 2.0, 2.0)),
    ((40.0, 2.0, 2.0), (0.0, 0.0, 0.0), (132.9548, 34.9352, 0.0), (30.0982, 2.658, 2.658)),
    ((40.0, 30.0, 2.0), (0.0, 0.0, 0.0), (132.1727, 28.2222, 22.0209), (40.0702, 21.9312, 2.7358)),
    ((2.0, 30.0, 2.0), (0.0, 0.0, 0.0), (135.8946, -13.1789, 23.3048), (2.4898, 24.0984, 1.6066)),
    ((2.0, 2.0, 2.0), (0.0, 0.0, 0.0), (140.0, 0.0, 0.0), (2.0, 2.0, 2.0)),
)
SIDE_LOAD = (
    ((50.0, 10.0), (0.0, 0.0, 0.0), (132.9345, 35.2863, 0.0), (37.8596, 13.2067)),
    ((50.0, 10.0), (0.0, 0.3, 0.3), (132.2469, 37.0669, 2.4294), None),
    ((50.0, 10.0), (0.0, 0.0, 0.0), (132.5077, 36.2805, 0.0), (38.3745, 13.0206)),
    ((50.0, 10.0), (0.0, -0.3, 0.3), (132.7968, 35.2303, 2.4737), (39.1522, 12.7649)),
)
STRETCHING = (
    ((50.0, 10.0), (0.0, 0.0, 0.0), (132.9345, 35.2863, 0.0), (37.8596, 13.2067)),
    ((50.0, 10.0), (0.0, 0.3, 0.3), (132.2456, 37.0687, 2.4293), (37.8595, 13.2066)),
    ((50.0, 10.0), (0.0, 0.0, 0.0), (132.5991, 36.0626, 0.0), (38.0569, 12.7773)),
    ((50.0, 10.0), (0.0, -0.3, 0.3), (132.9575, 34.8518, 2.4739), (38.6402, 12.4226)),
    ((50.0, 10.0), (0.0, 0.0, 0.0), (132.7208, 35.6617, 0.0), (38.6402, 12.4225)),
    ((20.0, 10.0), (0.0, 0.0, 0.0), (139.2436, 11.2588, 0.0), (22.1308, 9.0372)),
)
DISPLACED = (
    ((0.0008, 0.0008, 0.0008), (0.0, 0.0, 0.0), (140.0, 0.0, 0.0), (11.4286, 11.4286, 11.4286)),
    ((0.004, -0.0008, -0.0008), (0.0, 0.0, 0.0), (138.9687, 13.5404, 0.0), (18.639, 7.6619, 7.6619)),
    ((0.004, 0.002, -0.0036), (0.0, 0.0, 0.0), (137.9854, 13.2012, 13.3456), (18.1783, 13.335, 0.0)),
    ((0.0008, 0.002, -0.0004), (0.0, 0.0, 0.0), (139.815, -0.2134, 5.6839), (11.6934, 14.1631, 8.0878)),
    ((0.0008, 0.0008, 0.0008), (0.0, 0.0, 0.0), (140.0, 0.0, 0.0), (11.4286, 11.4286, 11.4286)),
)


def robot(angles, **of_tendons):
    return paper_with(*(cddf.Tendon(0.010, angle=angle, **of_tendons) for angle in angles))


THIRDS = (0.0, 2 * PI / 3, 4 * PI / 3)
STARS = robot(THIRDS)
PAIR = robot((0.0, PI))


def traced(body, table, *, displaced=False, **options):
    given, force = (np.array([row[i] for row in table]) for i in (0, 1))
    path = [cddf.Displacement(lengths) for lengths in given.T] if displaced else given
    loads = cddf.Loads(tip_force=force) if np.any(force) else None
    return cddf.trace(body, path, loads, throw=False, **options)


@pytest.fixture(scope="module")
def three():
    return traced(STARS, THREE)


@pytest.mark.parametrize(
    ("body", "table", "atol"),
    [
        (STARS, THREE, 0.01),
        pytest.param(PAIR, SIDE_LOAD, 0.03, marks=pytest.mark.slow),
        pytest.param(robot((0.0, PI), axial_stiffness=2e3), STRETCHING, 0.01, marks=pytest.mark.slow),
        pytest.param(robot(THIRDS, axial_stiffness=2e3), DISPLACED, 0.01, marks=pytest.mark.slow),
    ],
    ids=["three tendons", "side load", "side load and stretch", "displacements"],
)
def test_the_tables_are_met(three, body, table, atol):
    found = three if table is THREE else traced(body, table, displaced=table is DISPLACED)
    slack = [table is DISPLACED and row[3][2] == 0 for row in table]
    np.testing.assert_array_equal(found.status, np.where(slack, cddf.Status.slack, cddf.Status.successful))
    for step, (_, _, position, tension) in enumerate(table):
        np.testing.assert_allclose(1e3 * found.tip_position[step], position, atol=0.02)
        if tension is not None:
            np.testing.assert_allclose(found.tip_tension[step], tension, atol=atol)
            apart = np.max(np.abs(found.tip_tension[step] - np.array(tension))) / max(tension)
            assert apart < found.error_estimate[step] + 1e-3  # the table's own error


FEW = {"nodes": 8, "short_steps": 8, "throw": False}
RELEASED = np.array([[75.0, 20.0], [60.0, 20.0], [40.0, 20.0]])


@pytest.fixture(scope="module")
def plane_and_space():
    """A pair that bends in one plane, described with and without angles."""
    return [cddf.trace(body, RELEASED, **FEW) for body in (paper_body("exact", num_tendons=2), PAIR)]


@pytest.mark.slow
def test_in_a_plane_space_says_the_same(plane_and_space):
    flat, found = plane_and_space
    np.testing.assert_allclose(found.tip_tension, flat.tip_tension, atol=1e-4)
    np.testing.assert_allclose(found.tip_position[:, :2], flat.tip_position, atol=1e-6 * LENGTH)
    np.testing.assert_allclose(found.tip_position[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.energies.work, flat.energies.work, rtol=1e-5)


@pytest.mark.slow
def test_a_push_on_the_tip(plane_and_space):
    """In its plane a pair gives way as in the plane; without friction nothing rests, and it gives way as in `solve`."""
    flat, found = plane_and_space
    in_plane = cddf.tip_compliance(flat, push=(0.0, -0.2), short_steps=4)
    x, y, z, *turns = cddf.tip_compliance(found, push=(0.0, -0.2, 0.0), short_steps=4)
    np.testing.assert_allclose([x, y, turns[2]], in_plane, rtol=1e-3, atol=1e-4 * abs(float(in_plane[1])))
    np.testing.assert_allclose([z, *turns[:2]], 0.0, atol=1e-6)

    smooth = eqx.tree_at(lambda b: b.friction_coefficient, PAIR, np.asarray(0.0))
    bent, given_way = cddf.trace(smooth, RELEASED, **FEW), []
    for push in (0.02, -0.02):
        solved = cddf.solve(smooth, RELEASED[-1], cddf.Loads(tip_force=(0.0, 0.0, push)), nodes=8)
        given_way.append((cddf.tip_compliance(bent, push=(0.0, 0.0, push), short_steps=4), solved))
    (one, up), (other, down) = given_way
    moved = (up.tip_position - down.tip_position) / 0.04
    turned = Rotation.from_matrix(up.tip_frame @ down.tip_frame.T).as_rotvec() / 0.04
    aside = (one - other) / 2  # without what grows with the square of the push
    np.testing.assert_allclose(aside, [*moved, *turned], rtol=2e-3, atol=1e-6)
    assert refused(cddf.tip_compliance, bent, push=(0.0, 0.1), error=ValueError) == (
        "tip_compliance: after a history, push= must have 3 components (X, Y, Z), N, got (0.0, 0.1)"
    )


@pytest.mark.slow
def test_turning_the_robot_turns_the_answer():
    path = np.array([[40.0, 2.0, 5.0], [40.0, 30.0, 5.0], [10.0, 30.0, 5.0]])
    force, angle = np.array([0.0, 0.3, -0.2]), 0.7
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    one = cddf.trace(STARS, path, cddf.Loads(tip_force=force), **FEW)
    other = cddf.trace(robot(angle + np.array(THIRDS)), path, cddf.Loads(tip_force=turn @ force), **FEW)
    np.testing.assert_allclose(other.tip_tension, one.tip_tension, atol=1e-6)
    np.testing.assert_allclose(other.tip_position, one.tip_position @ turn.T, atol=1e-9)


def test_work_is_stored_or_lost(three):
    """Without loads the balance holds in each increment; with friction back at the straight body all is lost."""
    found = three.energies
    np.testing.assert_allclose(found.work - found.stored_energy - found.friction_loss, 0.0, atol=1e-9)
    assert np.all(np.diff(found.friction_loss) > -1e-12)
    np.testing.assert_allclose(found.stored_energy[-1], found.stored_energy[0], atol=1e-7)


@pytest.mark.slow
def test_derivatives():
    """In both modes, against differences so small that no tendon begins to slide or to rest in another element."""

    def tip(numbers):
        where = lambda b: (b.friction_coefficient, b.youngs_modulus)  # noqa: E731
        body = eqx.tree_at(where, STARS, (numbers[0], numbers[1] * 1.4e6))
        path = jnp.array([[40.0, 2.0, 5.0], [40.0, 30.0, 5.0]]).at[1, 1].set(30 * numbers[2])
        loads = cddf.Loads(tip_force=jnp.array([0.0, 0.0, 0.2]) * numbers[3])
        found = cddf.trace(body, path, loads, short_steps=4, nodes=4, estimate_error=False, throw=False)
        return jnp.append(found.tip_position[-1] / LENGTH, found.tip_tension[-1] / 30.0)

    at, step, derivatives = np.array([0.42, 1.0, 1.0, 1.0]), 1e-6, both_modes(tip)
    ends = [(derivatives(at + step * unit)[0], derivatives(at - step * unit)[0]) for unit in np.eye(4)]
    differences = np.stack([(above - below) / (2 * step) for above, below in ends], axis=1)
    for found in derivatives(at)[1:]:
        np.testing.assert_allclose(found, differences, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("loaded", [False, True])
def test_random_paths_settle_and_forget(loaded):
    """Three tendons that are let go, so that friction forgets, and pulled again end as if nothing had been before."""
    rng, pull = np.random.default_rng(11), np.array([[0.0, 0.0, 0.0], [60.0, 24.0, 18.0]])
    loads = cddf.Loads(tip_force=(0.0, 0.1, 0.2)) if loaded else None

    def after(before):
        return cddf.trace(STARS, np.concatenate([before, pull]), loads, **FEW)

    steps = 3 if loaded else 6  # under loads each takes long
    expected = after(np.zeros((steps, 3)))  # as many steps: one program for all
    for _ in range(2 if loaded else 3):
        found = after(rng.uniform(0.0, 60.0, (steps, 3)))
        assert np.all(np.isfinite(found.tip_angle))
        np.testing.assert_allclose(found.tip_tension[-1], expected.tip_tension[-1], atol=1e-3)
        np.testing.assert_allclose(found.tip_position[-1], expected.tip_position[-1], atol=1e-6 * LENGTH)
