"""`trace` of several tendons and of loads, followed in increments.

The expected values are those of an independent time-stepping simulation (`docs/hysteresis.md`), of `solve`
where every tendon slides one way, of the exact `trace` of one tendon, and properties.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, codes, paper_body, stretching

import cddf_jax as cddf
from cddf_jax.numerics import tolerances

PAIR = paper_body("exact", num_tendons=2)
ONE = paper_body("exact")
PATH = np.array([[75.0, 20.0], [60.0, 20.0], [40.0, 20.0], [30.0, 20.0]])
ANGLES = np.array([45.858, 44.148, 31.046, 15.168])  # deg, section 3: steps refined from both sides
PLACES = jnp.linspace(0.0, 0.140, 9)
GRID = 2e-4  # relative error of 64 elements by the trapezoidal rule, where tendons slide one way


@pytest.fixture(scope="module")
def pair():
    return cddf.trace(PAIR, PATH)


def test_antagonists_meet_the_table_within_the_error_estimate(pair):
    error = np.abs(np.asarray(pair.tip_angle) - np.radians(ANGLES))
    assert np.all(error < np.asarray(pair.error_estimate))
    np.testing.assert_allclose(np.degrees(pair.tip_angle), ANGLES, atol=0.016)
    np.testing.assert_allclose(pair.tip_tension[1:3], [[50.304, 23.855], [45.013, 17.772]], atol=0.03)
    np.testing.assert_allclose(1e3 * pair.front[1:3, 0], [52.74, 125.43], atol=0.12)  # neutral points
    np.testing.assert_allclose(pair.front[1:3, 0], pair.front[1:3, 1], atol=2e-4)  # a tenth of an element
    np.testing.assert_array_equal(pair.sliding(jnp.array([0.02, 0.1]))[1], [[-1, 1], [1, -1]])


def test_without_an_estimate_the_answer_is_the_same(pair):
    """The error is not known, and said to be so; a history goes on without it, also from one that had it."""
    found = cddf.trace(PAIR, PATH, estimate_error=False)
    np.testing.assert_allclose(found.tip_tension, pair.tip_tension, rtol=1e-10)
    assert np.all(np.isnan(found.error_estimate))
    np.testing.assert_array_equal(found.status, cddf.Status.successful)
    on = [cddf.trace(PAIR, PATH[:1], start=each, estimate_error=False).tip_angle for each in (found, pair)]
    np.testing.assert_allclose(on[0], on[1], rtol=1e-10)


@pytest.mark.slow
def test_small_steps_have_few_increments_and_stay_accurate():
    """A loop of small steps differs from one with four times the increments by their error; a tiny step has two."""
    turns = np.linspace(0.0, 2 * np.pi, 24)
    path = np.stack([40.0 + 25.0 * np.cos(turns), 40.0 - 25.0 * np.cos(turns)], axis=1)
    few, many = (cddf.trace(PAIR, path, short_steps=count, estimate_error=False) for count in (16, 64))
    np.testing.assert_allclose(few.tip_tension, many.tip_tension, atol=65.0 * 1e-3)
    np.testing.assert_allclose(few.tip_position, many.tip_position, atol=0.14 * 1e-4)
    two, most = (cddf.trace(PAIR, path[-1:] + 0.2, start=few, short_steps=count) for count in (2, 16))
    np.testing.assert_allclose(two.tip_tension, most.tip_tension, rtol=1e-12)


def test_a_small_body_is_similar(pair):
    """All lengths a twentieth, and the tensions their square: angles and tensions in proportion, as every law says."""
    small = {name: np.asarray(PAPER[name]) / 20 for name in ("length", "outer_radius", "inner_radius", "tendon_offset")}
    found = cddf.trace(paper_body("exact", num_tendons=2, **small), PATH / 400)
    np.testing.assert_allclose(found.tip_angle, pair.tip_angle, rtol=1e-9)
    np.testing.assert_allclose(400 * found.tip_tension, pair.tip_tension, rtol=1e-9)


@pytest.mark.slow
def test_a_softer_law_is_within_its_error(pair, monkeypatch):
    """That to which increments go whose tendons stick together; the estimate is larger by what it may cost."""
    monkeypatch.setattr(tolerances, "ATTEMPTS", tolerances.ATTEMPTS[2:3])
    jax.clear_caches()
    soft = cddf.trace(PAIR, PATH)
    jax.clear_caches()
    apart = np.max(np.abs(soft.tip_tension - pair.tip_tension), axis=1) / np.max(pair.tip_tension, axis=1)
    assert np.all(soft.error_estimate > 1e-3)
    assert np.all(np.maximum(apart, np.abs(soft.tip_angle - pair.tip_angle)) < 1e-3)


@pytest.mark.slow
def test_refined_antagonists_meet_the_table():
    rough, fine = (cddf.trace(PAIR, PATH, nodes=22, short_steps=count).tip_angle for count in (32, 64))
    np.testing.assert_allclose(np.degrees(2 * fine - rough), ANGLES, atol=0.005)  # the error falls with the steps


@pytest.mark.slow
def test_a_pull_after_a_release():
    """Tendons that rest by their friction alone, between parts that slide, settle with more increments too."""
    path = [[75.0, 20.0], [40.0, 20.0], [50.0, 20.0], [30.0, 20.0]]
    history = cddf.trace(PAIR, path, short_steps=32)
    np.testing.assert_allclose(np.degrees(history.tip_angle)[[0, 1, 3]], ANGLES[[0, 2, 3]], atol=0.016)


@pytest.mark.slow
def test_random_paths_settle_and_end_where_solve_does():
    """After every path all tendons are let go and pulled in proportion, which `solve` has an answer for."""
    three = replace(PAIR, tendons=(cddf.Tendon(0.010), cddf.Tendon(0.008, side=-1), cddf.Tendon(0.006)))
    pull = np.outer([0.0, 70.0], [1.0, 0.4, 0.3])
    found = cddf.solve(three, pull[1])
    for path in np.random.default_rng(7).uniform(0.0, 75.0, (4, 6, 3)):
        # so few nodes and steps may be inaccurate on the way
        history = cddf.trace(three, np.concatenate([path, pull]), nodes=8, short_steps=8, throw=False)
        assert np.all(np.isfinite(history.tip_angle))
        error = float(history.error_estimate[-1])
        np.testing.assert_allclose(history.tip_angle[-1], found.tip_angle, atol=error)
        np.testing.assert_allclose(history.tip_tension[-1], found.tip_tension, atol=error * 70.0)


@pytest.mark.slow
def test_a_neutral_point_that_leaves_at_the_tip():
    """Both tendons rest in the last cell for a moment. Once each slides one way all along, `solve` has the answer."""
    pulled = np.concatenate([np.linspace(10, 70, 10), np.linspace(64, 4, 10)])
    path = np.stack([pulled, np.full(20, 20.0)], axis=1)
    rough, fine = (cddf.trace(PAIR, path, short_steps=n, nodes=n // 2, throw=False) for n in (8, 16))
    out = slice(15, 20)  # from 30.7 N on
    for history in (rough, fine):
        good = np.isfinite(history.tip_angle)
        np.testing.assert_array_equal(good, np.ones(20, bool))
        for step in range(20)[out]:
            found = cddf.solve(PAIR, path[step], direction=[-1, 1])
            error = float(history.error_estimate[step])
            np.testing.assert_allclose(history.tip_angle[step], found.tip_angle, atol=error)
            np.testing.assert_allclose(history.tip_tension[step], found.tip_tension, atol=error * 30.0)
    apart = np.abs(rough.tip_angle - fine.tip_angle)
    assert np.all(apart < rough.error_estimate)


@pytest.mark.slow
def test_what_came_before_is_the_step_before_the_first(pair):
    """The same path, whose first step is not in the result."""
    found = cddf.trace(PAIR, PATH[1:], before=PATH[0])
    for name in ("tip_tension", "tip_angle", "front", "tendon_displacement", "error_estimate"):
        np.testing.assert_allclose(getattr(found, name), np.asarray(getattr(pair, name))[1:], rtol=1e-9, err_msg=name)
    for name in ("work", "friction_loss"):
        whole = np.asarray(getattr(pair.energies, name))
        np.testing.assert_allclose(getattr(found.energies, name), whole[1:], rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(found.at(0.07).tension, np.asarray(pair.at(0.07).tension)[1:], rtol=1e-9)


@pytest.mark.slow
def test_tensions_before_displacements(pair):
    """The same motions, whose later steps are given as displacements of tendon 1."""
    lengths = cddf.Displacement(pair.tendon_displacement[1:, 0])
    found = cddf.trace(PAIR, [lengths, PATH[1:, 1]], before=PATH[0])
    error = np.asarray(pair.error_estimate)[1:, None]
    for name in ("base_tension", "tip_tension"):
        assert np.all(np.abs(getattr(found, name) - getattr(pair, name)[1:]) < 75.0 * error)
    np.testing.assert_allclose(found.tip_angle, pair.tip_angle[1:], atol=1e-9)  # displacement over the offset
    np.testing.assert_allclose(found.energies.work, pair.energies.work[1:], rtol=1e-3)


def test_what_follows_a_failed_step_fails_as_well():
    failed = cddf.trace(PAIR, PATH, estimate_error=False)
    numbers = jnp.full(len(PATH), jnp.nan), jnp.full(len(PATH), int(cddf.Status.unphysical))
    failed = eqx.tree_at(lambda found: (found.tip_angle, found.status), failed, numbers)
    found = cddf.trace(PAIR, PATH[:1], start=failed, estimate_error=False, throw=False)
    assert np.all(np.isnan(found.tip_angle))
    assert np.all(np.isnan(found.tip_tension))
    np.testing.assert_array_equal(found.status, cddf.Status.unphysical)


@pytest.mark.slow
def test_tendons_that_slide_one_way_are_as_in_solve(pair):
    found = cddf.solve(PAIR, PATH[0])
    np.testing.assert_allclose(pair.tip_angle[0], found.tip_angle, rtol=GRID)
    np.testing.assert_allclose(pair.tip_position[0], found.tip_position, atol=GRID * 0.14)
    np.testing.assert_allclose(pair.tendon_displacement[0], found.tendon_displacement, rtol=GRID)
    fields, expected = pair.at(PLACES), found.at(PLACES)
    for name in ("tension", "curvature", "position", "heading", "wrap_angle", "normal_force", "friction_force"):
        one = np.asarray(getattr(fields, name)[0])
        other = np.asarray(getattr(expected, name))
        np.testing.assert_allclose(one, other, atol=2e-3 * np.max(np.abs(other)), err_msg=name)


def test_work_is_stored_or_lost(pair):
    missed = np.asarray(pair.energies.work - pair.energies.stored_energy - pair.energies.friction_loss)
    np.testing.assert_allclose(missed, 0.0, atol=2e-9 * float(pair.energies.work[0]))


LOAD = cddf.Loads(tip_force=(0.0, -1.0))


@pytest.fixture(scope="module")
def loop():
    """One tendon, which has an exact answer, with loads that are zero."""
    return cddf.trace(ONE, [75.0, 60.0, 40.0, 20.0, 0.0], cddf.Loads(), nodes=22)


@pytest.fixture(scope="module")
def exact(loop):
    return cddf.trace(ONE, loop.base_tension)


@pytest.fixture(scope="module")
def loaded():
    return cddf.trace(ONE, [40.0, 75.0, 75.0, 60.0, 60.0], LOAD)


def test_one_tendon_is_as_the_exact_play(loop, exact):
    np.testing.assert_allclose(loop.tip_angle, exact.tip_angle, atol=1e-4)
    np.testing.assert_allclose(loop.tip_tension, exact.tip_tension, atol=0.03)
    np.testing.assert_allclose(loop.front, exact.front, atol=2e-5)
    np.testing.assert_array_equal(loop.sliding(jnp.array([0.02, 0.138]))[1], [-1, 0])
    # closed forms of section 2, J; the error of the loss falls with the square of the increments
    np.testing.assert_allclose(loop.energies.work[0], 415.405749e-3, rtol=GRID)
    np.testing.assert_allclose(loop.energies.stored_energy[0], 355.679440e-3, rtol=GRID)
    np.testing.assert_allclose(loop.energies.friction_loss[4], 99.331129e-3, rtol=2e-4)


def test_loads_that_rest_on_the_body(loaded):
    for step, tension in ((0, 40.0), (1, 75.0)):
        found = cddf.solve(ONE, tension, LOAD)
        np.testing.assert_allclose(loaded.tip_angle[step], found.tip_angle, atol=GRID)
        np.testing.assert_allclose(loaded.tip_tension[step], found.tip_tension[0], rtol=GRID)
    np.testing.assert_allclose(loaded.tip_position[2], loaded.tip_position[1], atol=1e-7)  # nothing happens
    missed = np.asarray(loaded.energies.work - loaded.energies.stored_energy - loaded.energies.friction_loss)
    # the error of the trapezoidal rule along the path
    np.testing.assert_allclose(missed, 0.0, atol=1e-4 * float(loaded.energies.work[1]))


def test_rest_without_tension_changes_nothing(loaded):
    """Without tension friction has no effect; steps of zero newton settle all the same."""
    rested = cddf.trace(ONE, [0.0, 0.0, 40.0, 40.0, 75.0], LOAD)
    unpulled = float(cddf.solve(ONE, 0.0, LOAD).tip_angle)
    np.testing.assert_allclose(rested.tip_angle[:2], unpulled, atol=GRID)
    np.testing.assert_allclose(rested.tip_angle[2:4], float(loaded.tip_angle[0]), atol=1e-6)
    assert float(rested.tip_angle[4]) == pytest.approx(float(loaded.tip_angle[1]), abs=1e-6)


def test_splitting_a_step_changes_nothing_beyond_the_error(loaded):
    split = cddf.trace(ONE, [40.0, 75.0, 67.0, 62.0, 60.0], LOAD)
    error = float(loaded.error_estimate[3] + split.error_estimate[4])
    assert abs(float(split.tip_angle[4] - loaded.tip_angle[3])) < error


@pytest.mark.slow
def test_a_history_goes_on(loaded):
    first = cddf.trace(ONE, [40.0, 40.0, 40.0, 40.0, 75.0], LOAD)  # five steps, as above: one program for both
    second = cddf.trace(ONE, [75.0, 60.0], LOAD, start=first)
    np.testing.assert_allclose(second.tip_angle, loaded.tip_angle[2:4], atol=1e-10)
    np.testing.assert_allclose(second.energies.friction_loss, loaded.energies.friction_loss[2:4], atol=1e-12)
    staying = cddf.trace(ONE, [75.0, 60.0], start=first)  # the loads stay as they are
    np.testing.assert_allclose(staying.tip_angle, loaded.tip_angle[2:4], atol=1e-10)


@pytest.mark.slow
def test_a_history_under_a_load_in_space_goes_on():
    """The load stays where none is given, as with the same load; the body of the plane is in space as before."""
    load = cddf.Loads(tip_force=(0.0, 0.1, 0.1))
    first = cddf.trace(ONE, [5.0], load, short_steps=2)
    given, staying = (cddf.trace(ONE, [10.0], each, start=first, short_steps=2) for each in (load, None))
    np.testing.assert_array_equal(staying.tip_position, given.tip_position)


@pytest.mark.slow
def test_gravity_rests_while_a_force_changes():
    """The same in two calls: pulled under gravity alone, which `solve` has an answer for, and then a force."""
    body, gravity = with_masses(ONE), (0.0, -9.81)
    tension, force = [60.0, 60.0, 40.0], [(0.0, 0.0), (0.0, -0.5), (0.0, -0.2)]

    def traced(gravity):
        return cddf.trace(body, tension, cddf.Loads(gravity=gravity, tip_force=force))

    together = jax.jit(traced)(jnp.array(gravity))
    under_gravity = cddf.trace(body, tension[:1], cddf.Loads(gravity=gravity))
    pushed = [cddf.Loads(gravity=gravity, tip_force=one) for one in force[1:]]
    after = cddf.trace(body, tension[1:], pushed, start=under_gravity)
    np.testing.assert_allclose(
        together.tip_angle[0], cddf.solve(body, 60.0, cddf.Loads(gravity=gravity)).tip_angle, atol=GRID
    )
    np.testing.assert_allclose(together.tip_angle[1:], after.tip_angle, atol=1e-9)
    np.testing.assert_allclose(together.tip_tension[1:], after.tip_tension, rtol=1e-9)
    np.testing.assert_allclose(together.energies.work[1:], after.energies.work, rtol=1e-9)
    np.testing.assert_allclose(together.energies.friction_loss[0], under_gravity.energies.friction_loss[0], rtol=1e-9)
    # gravity that comes with the first tension ends in the same state: the tendon slides one way. Its loss differs
    with_tension = cddf.trace(body, tension[:1], [cddf.Loads(gravity=gravity)])
    assert abs(with_tension.energies.friction_loss[0] / together.energies.friction_loss[0] - 1) > 1e-3


def gives_way(body, force=0.0, moment=0.0):
    """How far the tip of a body that slides goes, m/N, and turns, rad/(N m): by differences of `solve`."""
    up, down = (cddf.solve(body, 75.0, cddf.Loads((0.0, sign * force), sign * moment)) for sign in (1, -1))
    moved, turned = up.tip_position[1] - down.tip_position[1], up.tip_angle - down.tip_angle
    return float(moved) / (2 * (force + moment)), float(turned) / (2 * (force + moment))


@pytest.mark.slow
def test_a_push_meets_a_stiffer_body_than_the_sliding_one():
    """A tendon that rests holds the tip; that of `solve` slides."""
    loads = [cddf.Loads(), cddf.Loads(tip_force=(0.0, -0.05)), cddf.Loads()]
    pushed = cddf.trace(ONE, [75.0, 75.0, 75.0], loads)
    given_way = float(pushed.tip_position[0, 1] - pushed.tip_position[1, 1]) / 0.05
    sliding, _ = gives_way(ONE, force=0.01)
    free, _ = gives_way(eqx.tree_at(lambda b: b.friction_coefficient, ONE, np.asarray(0.0)), force=0.01)
    assert 0 < given_way < 0.9 * min(sliding, free)
    assert float(pushed.energies.friction_loss[2]) > float(pushed.energies.friction_loss[0])
    exact = cddf.trace(ONE, [75.0])  # its compliance takes the same path
    np.testing.assert_allclose(-cddf.tip_compliance(exact, push=(0.0, -0.05))[1], given_way, rtol=1e-6)
    harder = -cddf.tip_compliance(exact, push=(0.0, -0.2))[1]
    assert float(harder) > given_way  # the harder, the more of the tendon slides
    tiny = cddf.tip_compliance(exact, push=(0.0, -1e-3))
    # only the angle is held by a tendon that does not stretch, but for the first half of an element
    assert abs(float(tiny[2])) < 1e-3 * gives_way(ONE, moment=1e-3)[1]
    assert abs(float(tiny[1])) > 0.4 * sliding
    with pytest.raises(cddf.SolveError, match="a push of 1e-06 N moves the tip by less than 1e-06 of the length"):
        cddf.tip_compliance(exact, push=(0.0, -1e-6))


@pytest.mark.slow
def test_a_push_as_small_as_rounding_is_nan_in_a_compiled_function():
    """No error can be raised there."""
    history = cddf.trace(ONE, [75.0], nodes=8)
    compiled = jax.jit(lambda push: cddf.tip_compliance(history, push=push, short_steps=2))
    assert np.all(np.isnan(compiled(jnp.array([0.0, -1e-6]))))
    assert np.all(np.isfinite(compiled(jnp.array([0.0, -0.05]))))


def with_masses(body):
    masses = cddf.PointMass(0.1, 0.05), cddf.PointMass(0.14, 0.02)
    return replace(body, density=np.asarray(1070.0), point_masses=masses)


ALL_LOADS = cddf.Loads(gravity=(0.0, -9.81), tip_force=(0.3, -1.0))
SLANTED = {"tendon_offset": (0.012, 0.008)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "loads"),
    [
        (stretching(paper_body("exact", drag=5.0, num_tendons=2, **SLANTED), 2e3, 0.2), None),
        (stretching(with_masses(paper_body("published", drag=5.0, num_tendons=2)), 2e3, 0.2), ALL_LOADS),
        (stretching(with_masses(paper_body("exact", drag=5.0)), 2e3, 0.2), ALL_LOADS),
        (paper_body("published"), cddf.Loads(tip_moment=-0.05)),
    ],
    ids=["slanted, drag, stretch", "all of it", "one tendon, all of it", "one, tip moment"],
)
def test_a_pull_of_all_tendons_is_a_solve(body, loads):
    """Their tensions grow in proportion, so that every tendon slides one way all along, under loads that stay."""
    shares = np.array([1.0, 0.3])[: body.num_tendons]
    history = cddf.trace(body, np.outer([30.0, 60.0], shares), loads, nodes=11, short_steps=8)
    for step, tension in enumerate((30.0, 60.0)):
        found = cddf.solve(body, tension * shares, loads)
        error = float(history.error_estimate[step])
        assert error < 1e-3
        tips = np.ravel(history.tip_tension[step])
        np.testing.assert_allclose(tips, found.tip_tension, atol=error * np.max(tips))
        np.testing.assert_allclose(history.tip_position[step], found.tip_position, atol=error * 0.14)
        np.testing.assert_allclose(history.tip_angle[step], found.tip_angle, atol=error)


@pytest.mark.slow
def test_drag_uses_up_the_first_tensions_from_rest():
    """A tendon rests from where its drag leaves no tension; once it slides all along, `solve` has the answer."""
    body, path = paper_body("exact", num_tendons=2, drag=60.0), [[30.0, 8.0], [60.0, 20.0]]
    history = cddf.trace(body, path)
    for step, tensions in enumerate(path):
        found = cddf.solve(body, tensions)
        np.testing.assert_allclose(history.tip_angle[step], found.tip_angle, atol=GRID)
        np.testing.assert_allclose(history.tip_tension[step], found.tip_tension, rtol=GRID)


@pytest.mark.slow
def test_drag_never_makes_a_tendon_push():
    """Where both are let go, drag takes no more than the tension, or the step says that it does not settle."""
    history = cddf.trace(paper_body("exact", num_tendons=2, drag=60.0), [[20.0, 0.0], [0.0, 0.0]], throw=False)
    assert codes(history.status)[0] == cddf.Status.successful
    assert codes(history.status)[1] in (cddf.Status.successful, cddf.Status.not_converged)
    tension = np.asarray(history.at(PLACES).tension)
    assert np.min(tension[np.isfinite(tension)]) > -1e-9


@pytest.mark.slow
def test_displacements_of_tendons_one_of_which_is_slack():
    # section 2: from 75 N back by 0.5 and 2 mm, then slack, then taken up; the other tendon has no tension
    start = float(cddf.solve(ONE, 75.0).tendon_displacement[0])
    wanted = start - np.array([0.0, 0.5e-3, 2e-3, start + 3e-3, start - 8e-3])
    history = cddf.trace(PAIR, [cddf.Displacement(wanted), np.zeros(5)])
    np.testing.assert_allclose(history.base_tension[:3, 0], [75.0, 56.100971, 41.836412], rtol=GRID)
    np.testing.assert_allclose(history.base_tension[3], 0.0, atol=1e-9)
    np.testing.assert_allclose(history.tendon_displacement[:3, 0], wanted[:3], atol=1e-12)
    np.testing.assert_allclose(history.tendon_displacement[3, 0], 0.0, atol=1e-9)
    slack = cddf.Status.slack
    np.testing.assert_array_equal(history.status, [0, 0, 0, slack, 0])
    taken_up = cddf.solve(ONE, cddf.Displacement(8e-3))
    np.testing.assert_allclose(history.base_tension[4, 0], taken_up.base_tension[0], rtol=GRID)


@pytest.mark.slow
def test_a_tip_angle_and_the_sum_of_the_tensions():
    """Pulled from rest as `solve` finds it; after a turn its tensions would bend the tip by degrees less."""
    angles, total = np.radians([20.0, 40.0, 20.0, 20.0]), np.array([60.0, 80.0, 80.0, 80.0])
    history = cddf.trace(PAIR, [cddf.TipAngle(angles), cddf.TotalTension(total)])
    np.testing.assert_allclose(history.tip_angle, angles, atol=1e-8)
    np.testing.assert_allclose(jnp.sum(history.base_tension, axis=1), total, atol=1e-7)
    first = cddf.solve(PAIR, (cddf.TipAngle(angles[0]), cddf.TotalTension(total[0])))
    np.testing.assert_allclose(history.base_tension[0], first.base_tension, atol=60.0 * GRID)
    again = cddf.trace(PAIR, history.base_tension)  # the tensions that were found, on another way between the steps
    np.testing.assert_allclose(again.tip_angle, angles, atol=2e-3)
    unaware = cddf.solve(PAIR, (cddf.TipAngle(angles[2]), cddf.TotalTension(total[2])))
    assert abs(float(history.base_tension[2, 0] - unaware.base_tension[0])) > 5.0
    pushed = cddf.trace(PAIR, [cddf.TipAngle([0.5] * 4), cddf.TotalTension([5.0] * 4)], throw=False)
    assert pushed.status[0] == cddf.Status.unreachable


@pytest.mark.slow
def test_back_to_the_straight_body():
    """Without tensions it is straight: a tension of 0 N is reached, although it is found to rounding errors only."""
    path = [cddf.TipAngle([0.3, 0.0, 0.3, 0.0]), [0.0] * 4]
    history = cddf.trace(PAIR, path, nodes=4, short_steps=4, estimate_error=False)
    np.testing.assert_allclose(history.base_tension[1::2], 0.0, atol=1e-9)
    assert codes(history.status) == [0, 0, 0, 0]


@pytest.mark.slow
def test_a_tip_tension_is_reached():
    """Of one tendon, which has an exact answer; at 20 N the whole tendon slides out."""
    wanted = [75.0, 20.0]
    found = cddf.trace(ONE, cddf.TipTension(cddf.trace(ONE, wanted).tip_tension))
    np.testing.assert_allclose(found.base_tension, wanted, rtol=5 * GRID)


def test_derivatives():
    """In both modes, against differences so small that no tendon begins to slide or to rest in another element.

    In the second step the tendons rest together, and hold tensions that rounding moves by 1e-10 of their size.
    """

    def found(numbers):
        body = eqx.tree_at(lambda b: (b.friction_coefficient, b.youngs_modulus), PAIR, (numbers[0], numbers[1] * 1.4e6))
        path = jnp.array([[75.0, 20.0], [60.0, 20.0], [60.0, 30.0]]).at[1, 0].set(60 * numbers[2])
        history = cddf.trace(body, path, short_steps=4, nodes=8, estimate_error=False)
        return jnp.concatenate([history.tip_angle[1:], history.tip_tension[1:].ravel()])

    at, step, derivatives = np.array([0.42, 1.0, 1.0]), 2e-5, both_modes(found)
    ends = [(derivatives(at + step * unit)[0], derivatives(at - step * unit)[0]) for unit in np.eye(3)]
    differences = np.stack([(above - below) / (2 * step) for above, below in ends], axis=1)
    sizes = np.max(np.abs(differences), axis=1, keepdims=True)
    for slopes in derivatives(at)[1:]:
        off = np.abs(slopes - differences) / sizes
        assert np.all(off[:4] < 1e-6), off
        assert np.all(off[4:] < 1e-5), off  # 1e-10 over the step


@pytest.mark.slow
def test_a_lane_that_fails_is_alone():
    def traced(tension):
        path = jnp.array([[75.0, 20.0], [60.0, 20.0]]).at[1, 0].set(tension)
        return cddf.trace(PAIR, path, short_steps=4, nodes=8)

    lanes = jax.jit(jax.vmap(traced))(jnp.array([60.0, jnp.nan]))
    alone = traced(60.0)
    np.testing.assert_allclose(lanes.tip_angle[0], alone.tip_angle, atol=1e-9)
    np.testing.assert_allclose(lanes.tip_angle[1, 0], alone.tip_angle[0], atol=1e-9)  # up to the bad step
    assert np.isnan(lanes.tip_angle[1, 1])
    np.testing.assert_array_equal(lanes.status[1], [0, cddf.Status.unphysical])


def test_bad_input_is_refused(exact):
    with pytest.raises(ValueError, match=r"\(steps, 2\)"):
        cddf.trace(PAIR, [1.0, 2.0])
    with pytest.raises(ValueError, match="one entry per tendon"):
        cddf.trace(PAIR, cddf.Displacement([1e-3]))
    with pytest.raises(ValueError, match="one number for each step"):
        cddf.trace(PAIR, [cddf.Displacement([1e-3]), [1.0, 2.0]])
    with pytest.raises(ValueError, match="2 steps and 1 loads"):
        cddf.trace(ONE, [1.0, 2.0], [LOAD])
    with pytest.raises(TypeError, match="must be a Loads"):
        cddf.trace(ONE, [1.0, 2.0], 3.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="tip_moment holds three numbers for three steps"):
        cddf.trace(ONE, [1.0, 2.0, 3.0], cddf.Loads(tip_moment=(0.1, 0.2, 0.3)))
    with pytest.raises(ValueError, match="short_steps"):
        cddf.trace(PAIR, PATH, short_steps=0)
    with pytest.raises(ValueError, match="start is a history of one tendon"):
        cddf.trace(ONE, [1.0], LOAD, start=exact)
    with pytest.raises(ValueError, match="history of another body"):
        cddf.trace(PAIR, PATH, start=exact)
    with pytest.raises(ValueError, match="must hold numbers, in rows of one length"):
        cddf.trace(PAIR, [[75.0, 20.0], [60.0]])
    with pytest.raises(ValueError, match=r"before must be .rest. or base tensions, N, of the shape .tendons,., .2,."):
        cddf.trace(PAIR, PATH, before=80.0)
    with pytest.raises(ValueError, match="before must hold tensions of 0 N or more"):
        cddf.trace(PAIR, PATH, before=[80.0, -1.0])
    for push in (None, (0.0, 0.0), (0.0, np.nan), (1.0,)):
        with pytest.raises(ValueError, match="push"):
            cddf.tip_compliance(exact, push=push)
    with pytest.raises(ValueError, match="before must be the largest"):
        cddf.trace(ONE, [2.0], before=1.0)
    with pytest.raises(cddf.SolveError, match="not physical"):
        cddf.trace(ONE, [np.nan] * 5)
