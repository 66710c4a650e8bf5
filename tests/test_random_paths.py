"""The judge of states in the study of random paths, against what can be said of them by hand."""

import runpy

import numpy as np
import pytest
from places import ROOT

Body = runpy.run_path(str(ROOT / "benchmarks" / "tangent.py"))["Body"]
LENGTH, STIFFNESS, ELEMENTS = 0.2, 0.02, 16


def judged(angles, in_space, tension, slides, force=(0.0, 0.0, 0.0)):
    """A straight body with tendons at 9 mm."""
    routes = tuple(lambda s, a=angle: (0.009 + 0 * s, a + 0 * s) for angle in angles)
    body = Body(LENGTH, lambda s: STIFFNESS + 0 * s, 2 / 3, routes, 0.3, in_space)
    pulled = np.full((ELEMENTS + 1, len(angles)), tension)
    strain, slid = np.zeros((ELEMENTS + 1, 3)), np.tile(slides, (ELEMENTS, 1))
    return body.determined(pulled, strain, slid, np.array(force))


@pytest.mark.parametrize("in_space", [False, True])
@pytest.mark.parametrize("part", [0.0, 0.5, 0.9])
def test_a_column_under_a_part_of_its_critical_force(part, in_space):
    """It bends 1 / (1 - part) times as far; the critical force of a clamped column is pi^2 E J / (2 L)^2, Euler."""
    critical = np.pi**2 * STIFFNESS / (4 * LENGTH**2)
    told = judged([0.0], in_space, 0.0, [1], (-part * critical, 0.0, 0.0))
    assert told.compliance == pytest.approx(max(1 / (1 - part), 1.5 * in_space), rel=0.02)  # of twist 3 / 2
    assert (told.open_tensions, told.open_shapes) == (0, 0)


def test_tendons_that_stick_together_leave_tensions_open():
    """Antagonists, and three at 120 degrees: one tension in each element, unless one of them slides."""
    three = np.radians([0.0, 120.0, 240.0])
    for angles, in_space in (([0.0, np.pi], False), (three, True)):
        held = judged(angles, in_space, 5.0, [0] * len(angles))
        assert (held.open_tensions, held.open_shapes, held.missing) == (ELEMENTS, 0, pytest.approx(0.0, abs=1e-12))
        assert judged(angles, in_space, 5.0, [1] + [0] * (len(angles) - 1)).open_tensions == 0
    # any four in space: their arms have two components, so that two tensions are open
    assert judged([0.0, 1.0, 2.5, 4.0], True, 5.0, [0] * 4).open_tensions == 2 * ELEMENTS
