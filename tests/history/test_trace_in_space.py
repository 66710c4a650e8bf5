"""Pull and release of one tendon in space, against the plane, single pulls, and Coulomb's law at many discs."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, codes, lane, paper_body, paper_with
from kinds import of_kind, root_of
from scipy.spatial.transform import Rotation

import cddf_jax as cddf

LENGTH, OFFSET, MU, MODULUS, RADII, INNER = 0.140, 0.010, 0.42, 1.4e6, (0.020, 0.013), 0.007
LOOP = [75.0, 60.0, 40.0, 20.0, 5.0, 0.0, 50.0, 75.0]
NUMBERS = ("tip_tension", "tip_angle", "tip_position", "front", "tendon_displacement")


def body(angle, friction=MU, **others):
    return paper_with(cddf.Tendon(OFFSET, angle=angle), friction_coefficient=friction, **others)


def helix(turns, friction=MU, **others):
    return body(cddf.Linear(0.0, 2 * np.pi * turns, LENGTH), friction, **others)


@pytest.mark.slow
def test_a_parallel_tendon_is_that_of_the_plane_turned_about_the_axis():
    angle, path = 0.7, [*LOOP[:4], 200.0, 150.0]  # far above 113 N, where a tendon that is released would lock
    history, expected = cddf.trace(body(angle), path), cddf.trace(paper_body("exact"), path)
    for name in ("tip_tension", "tip_angle", "front", "tendon_displacement", "num_turns", "direction"):
        np.testing.assert_allclose(getattr(history, name), getattr(expected, name), rtol=1e-12)
    turn = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
    flat = np.append(np.asarray(expected.tip_position), np.zeros((len(path), 1)), axis=1)
    np.testing.assert_allclose(history.tip_position, flat @ turn.T, atol=1e-12)
    along, there = of_kind(cddf.SpatialFields, history.equilibria), of_kind(cddf.Fields, expected.equilibria)
    np.testing.assert_allclose(along.tension, there.tension, rtol=1e-11)
    np.testing.assert_allclose(along.wrap_angle, there.wrap_angle, atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(along.curvature, axis=-1), there.curvature, rtol=1e-11)
    cosine, sine = np.cos(there.heading), np.sin(there.heading)
    np.testing.assert_allclose(along.frame[..., 0], np.stack([cosine, sine, 0 * sine], -1) @ turn.T, atol=1e-11)
    for name in ("normal_force", "friction_force"):
        flat = np.append(getattr(there, name), np.zeros((*there.tension.shape, 1)), axis=-1)
        np.testing.assert_allclose(getattr(along, name), flat @ turn.T, atol=1e-8)
    np.testing.assert_allclose(np.asarray(history.tip_frame)[:, :, 0], along.frame[:, -1, :, 0], atol=1e-11)
    with pytest.raises(ValueError, match="must have 3 components"):
        cddf.tip_compliance(history, push=(0.0, 1.0))


@pytest.mark.slow
def test_a_pull_is_a_solve_and_what_rests_keeps_its_state():
    """Beyond the front of a release tension and curvature are those of the pull before."""
    robot = helix(0.3, extensible=True, drag=5.0, rest_curvature=(0.0, 3.0, 5.0))
    s = np.linspace(0, LENGTH, 57)
    history, found = cddf.trace(robot, [60.0, 50.0]), cddf.solve(robot, 60.0, direction=1)
    along, of_solve = history.at(s), found.at(s)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9), lane(along, 0), of_solve)
    np.testing.assert_allclose(np.asarray(history.tip_frame)[0], np.asarray(found.tip_frame), atol=1e-12)
    np.testing.assert_allclose(history.tendon_displacement[0], found.tendon_displacement[0], rtol=1e-12)
    front = float(history.front[1])
    assert 0.2 * LENGTH < front < 0.8 * LENGTH
    pulled, released = (jax.tree.map(lambda x, step=step: np.asarray(x[step]), along) for step in range(2))
    rests = s > front + 1e-4
    np.testing.assert_allclose(released.tension[0, rests], pulled.tension[0, rests], rtol=1e-8)
    np.testing.assert_allclose(released.curvature[rests], pulled.curvature[rests], rtol=1e-8, atol=1e-9)
    assert np.all(released.tension[0, s < front - 1e-4] < pulled.tension[0, s < front - 1e-4])
    np.testing.assert_array_equal(history.sliding(s)[1], np.where(s <= front, -1, 0))


# --- Coulomb's law at many discs, with NumPy: neither fronts nor directions -------------------------


class Discs:
    """One tendon through many discs: its tension and the curvature are constant in each cell between two of them.

    At a disc the tendon turns by the angle theta, and the tensions beside it differ at most by exp(mu theta). Where
    they differ by less the tendon rests, else it slides as they say; and it slides by what paths beyond grow shorter.
    """

    def __init__(self, turns, cells):
        self.h, s = LENGTH / cells, LENGTH * (np.arange(cells) + 0.5) / cells
        outer = RADII[0] + (RADII[1] - RADII[0]) * s / LENGTH
        bending = MODULUS * np.pi / 4 * (outer**4 - INNER**4)
        rate = 2 * np.pi * turns / LENGTH
        angle, zero = rate * s, np.zeros(cells)
        self.arm = OFFSET * np.stack([zero, np.cos(angle), np.sin(angle)], axis=1)
        self.straight = np.stack([zero + 1, -OFFSET * rate * np.sin(angle), OFFSET * rate * np.cos(angle)], axis=1)
        self.stiffness = np.stack([2 / 3 * bending, bending, bending], axis=1)  # 2 G J of a Poisson's ratio of 0.5
        self.tension, self.cells = np.zeros(cells), cells

    def curvature(self, cell, tension):
        """By damped passes of K u = -T rho x t, up to rounding errors."""
        u = np.zeros(3)
        for _ in range(60):
            new = -tension * np.cross(self.arm[cell], self.tangent(cell, u)) / self.stiffness[cell]
            if np.max(np.abs(new - u)) < 1e-13:
                break
            u = new
        return u

    def course(self, cell, u):
        return self.straight[cell] + np.cross(u, self.arm[cell])

    def tangent(self, cell, u):
        w = self.course(cell, u)
        return w / np.linalg.norm(w)

    def state(self, cell, tension):
        u = self.curvature(cell, tension)
        return u, self.tangent(cell, u)

    def turn(self, one, other):
        """Between the tendon in two cells, rad."""
        between = Rotation.from_rotvec(self.h * (one[0] + other[0]) / 2).as_matrix()
        return np.linalg.norm(one[1] - between @ other[1])

    def pull(self, base_tension):
        """Go to a base tension; then look whether the slip at every disc is as Coulomb's law says."""
        before, now, sliding = self.tension.copy(), base_tension, np.zeros(self.cells)
        here = self.state(0, base_tension)
        for cell in range(self.cells):
            for sigma in (0.0, 1.0, -1.0):
                tension, bound = before[cell] if sigma == 0 else now, 0.0
                for _ in range(60 if sigma else 1):
                    there = self.state(cell, tension)
                    # from the base it is half a cell
                    bound = MU * (self.h / 2 * self.first_rate(tension) if cell == 0 else self.turn(here, there))
                    new = now * np.exp(-sigma * bound) if sigma else tension
                    settled, tension = abs(new - tension) < 1e-12, new
                    if settled:
                        break
                low, high = now * np.exp(-bound), now * np.exp(bound)
                if (sigma == 0 and low <= tension <= high) or (sigma != 0 and sigma * (tension - before[cell]) >= 0):
                    break
            self.tension[cell], sliding[cell], now, here = tension, sigma, tension, self.state(cell, tension)
        lengths = [
            [np.linalg.norm(self.course(cell, self.curvature(cell, T[cell]))) for cell in range(self.cells)]
            for T in (before, self.tension)
        ]
        slip = self.h * np.cumsum((np.array(lengths[0]) - np.array(lengths[1]))[::-1])[::-1]
        assert np.all(sliding * slip >= -1e-15)
        assert np.all(np.abs(slip[sliding == 0]) < 1e-15)

    def first_rate(self, tension):
        """The turning of the tendon per length in the first cell, with its tension constant."""
        return self.turn(self.state(0, tension), self.state(1, tension)) / self.h

    def tip(self):
        """Tip tension, by what the last two cells say, and tip position."""
        position, frame = np.zeros(3), np.eye(3)
        for cell in range(self.cells):
            turn = self.h * self.curvature(cell, self.tension[cell])
            half = frame @ Rotation.from_rotvec(turn / 2).as_matrix()
            position, frame = position + self.h * half[:, 0], frame @ Rotation.from_rotvec(turn).as_matrix()
        return np.append(1.5 * self.tension[-1] - 0.5 * self.tension[-2], position)


@pytest.mark.slow
def test_loops_against_coulombs_law_at_discs():
    """Errors fall with the square of the length of the cells; two lengths are extrapolated. A front lies in a cell."""
    path, robot = [60.0, 45.0, 20.0, 30.0, 24.0, 55.0], helix(1.0)
    found = []
    for cells in (80, 160):
        discs, tips = Discs(1.0, cells), []
        for tension in path:
            discs.pull(tension)
            tips.append(discs.tip())
        found.append(np.array(tips))
    expected = (4 * found[1] - found[0]) / 3
    history = cddf.trace(robot, [*path, 60.0, 10.0])  # eight steps, as elsewhere: one program for all of them
    np.testing.assert_allclose(history.tip_tension[:6], expected[:, 0], rtol=1e-6)
    np.testing.assert_allclose(history.tip_position[:6], expected[:, 1:], atol=1e-6)
    assert np.max(history.error_estimate) < 1e-6


@pytest.mark.slow
def test_increments_find_the_same():
    """With loads that are zero."""
    path = [75.0, 60.0, 40.0, 20.0, 50.0]
    exact = cddf.trace(helix(0.5), [*path, 30.0, 60.0, 10.0])  # eight steps, as above
    found = cddf.trace(helix(0.5), path, cddf.Loads(), nodes=22)
    np.testing.assert_allclose(found.tip_tension, exact.tip_tension[:5], atol=0.05)
    np.testing.assert_allclose(found.tip_position, exact.tip_position[:5], atol=2e-4 * LENGTH)
    np.testing.assert_allclose(np.asarray(found.tip_frame), np.asarray(exact.tip_frame)[:5], atol=1e-3)


# --- laws --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_return_point_memory():
    """Loops within loops close, and what is passed is forgotten."""
    history = cddf.trace(helix(1.0), [75.0, 40.0, 60.0, 50.0, 60.0, 40.0, 75.0, 20.0], throw=False)
    assert set(codes(history.status)) == {0}
    for name in NUMBERS:
        values = np.asarray(getattr(history, name))
        for again, once in ((4, 2), (5, 1), (6, 0)):
            np.testing.assert_allclose(values[again], values[once], rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(history.num_turns, [1, 2, 3, 4, 3, 2, 1, 2])


@pytest.mark.slow
def test_work_is_the_integral_of_tension_by_displacement():
    """T x less the integral of x by T, by Gauss's rule on each of three ways; a cycle loses what it takes."""
    robot, ends, integral = helix(1.0), np.array([0.0, 75.0, 30.0, 50.0]), 0.0
    history = cddf.trace(robot, [*ends[1:], 30.0, *ends])
    energies = history.energies
    work, lost = energies.work, energies.friction_loss
    for k, (a, b) in enumerate(pairwise(ends)):
        nodes, weights = np.polynomial.legendre.leggauss(7 - k)  # eight steps with the ways before
        x = cddf.trace(robot, [*ends[1 : k + 1], *((a + b + (b - a) * nodes) / 2), b]).tendon_displacement
        integral += (b - a) / 2 * (x[k:-1] @ weights)
        np.testing.assert_allclose(work[k], b * x[-1] - integral, rtol=1e-5)
    np.testing.assert_allclose(np.diff(lost)[1:3].sum(), work[3] - work[1], rtol=1e-9)


@pytest.mark.slow
def test_displacements_are_met():
    robot, path = helix(0.3), [60.0, 40.0, 50.0, 20.0, 30.0, 25.0, 55.0, 70.0]
    wanted = cddf.trace(robot, path).tendon_displacement
    np.testing.assert_allclose(cddf.trace(robot, cddf.Displacement(wanted)).base_tension, path, rtol=1e-9)


ANGLES = [1.0, 0.6, 0.8, 0.7, 0.45, 1.02, 0.2, 0.5]  # rad; loops that close


@pytest.mark.slow
def test_tip_angles_of_a_helix_are_met():
    """The tensions against Brent's method on traces of tensions: a pull within the loop, and the last release."""
    robot = helix(0.5)
    found = cddf.trace(robot, cddf.TipAngle(ANGLES))
    np.testing.assert_allclose(found.tip_angle, ANGLES, rtol=1e-12)
    for step in (2, 6):
        before = list(found.base_tension[:step])

        def missed(tension, step=step, before=before):
            path = [*before, *[tension] * (len(ANGLES) - step)]
            return float(cddf.trace(robot, path).tip_angle[step]) - ANGLES[step]

        np.testing.assert_allclose(found.base_tension[step], root_of(missed, 0.0, 95.0, xtol=1e-8), atol=2e-8)
    with pytest.raises(cddf.SolveError, match="No base tension between slack"):
        cddf.trace(robot, cddf.TipAngle([*ANGLES[:7], 3.1]))


@pytest.mark.slow
def test_a_tip_angle_that_grows_in_a_release_is_met_all_the_same():
    """A tendon of one turn that is released from 75 N to 40 N bends the tip from 12.5 to 15.4 degrees."""
    robot, angles = helix(1.0), [0.15, 0.1, 0.2, 0.05, 0.25, 0.5, 0.1, 0.2]
    found = cddf.trace(robot, cddf.TipAngle(angles))
    np.testing.assert_allclose(found.tip_angle, angles, rtol=1e-9)
    again = cddf.trace(robot, found.base_tension)
    for name in (*NUMBERS, "num_turns"):
        np.testing.assert_allclose(getattr(found, name), getattr(again, name), rtol=1e-12, atol=1e-14)


# --- transformations ----------------------------------------------------------------------------------


def tips(numbers):
    mu, turns, high, low = numbers
    robot = body(cddf.Linear(0.0, 2 * jnp.pi * turns, LENGTH), mu)
    history = cddf.trace(robot, jnp.stack([high, low, 50.0]), throw=False)
    return jnp.concatenate([history.tip_position.ravel(), history.tip_tension, history.front[1:2]])


@pytest.mark.slow
def test_derivatives():
    """In both modes against differences."""
    at, derivatives = np.array([MU, 0.3, 60.0, 45.0]), both_modes(tips)
    steps = np.diag(1e-5 * at)
    _, *found = derivatives(at)
    ends = [(derivatives(at + x)[0], derivatives(at - x)[0], 2 * x.max()) for x in steps]
    differences = np.stack([(above - below) / apart for above, below, apart in ends], axis=1)
    for one in found:
        np.testing.assert_allclose(one, differences, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
def test_a_tendon_that_stretches_on_a_rigid_arc():
    """docs/hysteresis.md: a play in ln T against mu theta, with the numbers of an independent derivation.

    A quarter of a circle of 0.1 m, E A = 1e4 N. Pulled to T, the stretch is T R (1 - exp(-mu pi / 2)) / (mu E A).
    """
    radius, stiffness = 0.1, 1e4
    tendon = cddf.Tendon(1e-12, angle=0.0, axial_stiffness=stiffness)
    arc = cddf.Manipulator(
        length=radius * np.pi / 2,
        tendons=(tendon,),
        bending_stiffness=1e6,
        torsional_stiffness=1e6,
        friction_coefficient=MU,
        rest_curvature=(0.0, 0.0, 1 / radius),
    )
    history = cddf.trace(arc, [40.0, 75.0, 40.0, 20.045791, 0.0])
    stretch = 1e3 * history.tendon_displacement
    np.testing.assert_allclose(stretch[np.array([0, 2])], [0.460011, 0.732628], atol=5e-7)
    pulled = 75.0 * radius * (1 - np.exp(-MU * np.pi / 2)) / (MU * stiffness)
    np.testing.assert_allclose(history.tendon_displacement[1], pulled, rtol=1e-9)
    np.testing.assert_allclose(history.front[3], arc.length, rtol=1e-6)  # where all of it slides out again
    np.testing.assert_allclose(history.front[2], radius * np.log(75 / 40) / (2 * MU), rtol=1e-8)
    np.testing.assert_allclose(1e3 * history.energies.friction_loss[-1], 13.107443627, rtol=1e-9)
