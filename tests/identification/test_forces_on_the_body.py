"""Forces at places of the body in the rows of a table."""

import dataclasses

import numpy as np
import pytest
from bodies import paper_body
from refusals import refused

import cddf_jax as cddf
from cddf_jax.identification.bench import experiment_of
from cddf_jax.identification.course import course_of, paths_of

LENGTH, STIFFNESS, PLACE = 0.2, 0.02, 0.08  # m, N m^2, m
ROD = cddf.Manipulator(
    length=LENGTH, tendons=(cddf.Tendon(0.008),), friction_coefficient=0.2, bending_stiffness=STIFFNESS
)
AS_FITTED = {"nodes": 8, "short_steps": 4, "throw": False}  # of `trace`: the cells and steps of a fit with 12 nodes


def rows_of(body, table, **how):
    return experiment_of(table, body, **how).predict(body, {}, 12)


@pytest.mark.slow
def test_small_forces_bend_a_cantilever():
    """Tip deflections F s^2 (3 L - s) / 6 E I of forces at s; of both at once their sum, as they are small."""
    forces = 1e-5 * np.array([(1.0, 0.0), (0.0, -2.0), (1.0, -2.0)])  # at PLACE and at the tip, N
    columns = {"force_y@80mm": forces[:, 0], "tip_force_y": forces[:, 1]}
    still = {"base_tension": np.zeros(3), "direction": np.ones(3), "tip_y": np.zeros(3)}
    found = rows_of(ROD, cddf.Measurements.from_columns("bench", **still, **columns))["tip_y"]
    at_place = forces[:, 0] * PLACE**2 * (3 * LENGTH - PLACE) / (6 * STIFFNESS)
    np.testing.assert_allclose(found, at_place + forces[:, 1] * LENGTH**3 / (3 * STIFFNESS), rtol=1e-6)


@pytest.mark.slow
def test_a_weight_that_stays_beside_a_tip_force_that_changes():
    """As a `trace` under these loads: the weight acts before the first row, the tip force begins with it."""
    path, push = np.array([5.0, 8.0, 6.0, 2.0]), np.array([-0.02, -0.05, -0.05, 0.0])
    loads = cddf.Loads(
        np.stack([0 * push, push], axis=1), points=[cddf.PointLoad(PLACE, (0.0, -0.1))]
    )  # no axis of steps: it stays
    history = cddf.trace(ROD, path, loads, **AS_FITTED)
    columns = {"base_tension": path, "tip_force_y": push, "force_y@80mm": np.full(4, -0.1), "step": range(4)}
    table = cddf.Measurements.from_columns("bench", **columns, tip_tension=np.zeros(4), tip_angle=np.zeros(4))
    shown = rows_of(ROD, table, course=course_of(table)[0])
    np.testing.assert_allclose(shown["tip_tension"], history.tip_tension, rtol=1e-9)
    np.testing.assert_allclose(shown["tip_angle"], history.tip_angle, atol=1e-9)


HALF = dataclasses.replace(ROD, tendons=(cddf.Tendon(0.008, end=0.1),), friction_coefficient=0.4)
PULL, PUSH = 4.0, (0.0, -0.5)  # N; the push bends HALF away from its tendon wherever there is a tendon


@pytest.mark.slow
@pytest.mark.parametrize("way", [1, -1])
def test_whether_a_push_comes_with_the_pull_or_before_it(way):
    """It turns the slip: after the push the pull draws the tendon in (1); a push that grows with it lets it out (-1).

    All of the tendon slides, so that `solve` with this direction has the tip tension; `trace` has the path by hand.
    """
    read = {"tip_tension": [0.0], "tip_angle": [0.0]}
    forces = {"force_y@200mm": [PUSH[1]], "base_tension": [PULL]}
    if way == -1:
        table = cddf.Measurements.from_columns("bench", **forces, **read)
        path, loads = [PULL], cddf.Loads(np.array([PUSH]))
    else:  # a row more in which the weight already hangs
        columns = {name: np.append(0.0 if name == "base_tension" else own, own) for name, own in forces.items()}
        read = {name: np.append(np.nan, own) for name, own in read.items()}
        table = cddf.Measurements.from_columns("bench", **columns, **read, step=[1, 2])
        path, loads = [0.0, PULL], cddf.Loads(PUSH)
    followed = course_of(table, paths=paths_of(table, "each" if way == -1 else None))[0]
    shown, history = rows_of(HALF, table, course=followed), cddf.trace(HALF, path, loads, **AS_FITTED)
    for column, values in (("tip_tension", history.tip_tension), ("tip_angle", history.tip_angle)):
        np.testing.assert_allclose(shown[column], values[-1:], rtol=1e-9)
    slides = cddf.solve(HALF, PULL, cddf.Loads(PUSH), direction=way, throw=False)
    np.testing.assert_allclose(shown["tip_tension"], slides.tip_tension, rtol=1e-4)
    assert way * (PULL - shown["tip_tension"][0]) > 0.3


@pytest.mark.slow
def test_a_fit_with_weights_on_the_body():
    """Simulated by `solve` with point loads; found again, and predicted at another force as `solve` has it."""
    body = paper_body("exact")
    pulls, weights = np.array([20.0, 40.0, 60.0, 70.0]), np.array([0.0, -0.5, -1.0, -0.5])

    def hung(pull, weight):
        return cddf.solve(body, pull, cddf.Loads(points=[cddf.PointLoad(0.06, (0.0, weight))]))

    found = [hung(*row) for row in zip(pulls, weights, strict=True)]
    read = {name: [float(np.ravel(getattr(each, name))[0]) for each in found] for name in ("tip_tension", "tip_angle")}
    table = cddf.Measurements.from_columns("bench", base_tension=pulls, **{"force_y@60mm": weights}, **read)
    start = dataclasses.replace(body, friction_coefficient=0.38)
    fitted = cddf.fit(start, table, ["friction_coefficient"], noise={"tip_tension": 0.1, "tip_angle": 1e-3})
    assert fitted.value["friction_coefficient"] == pytest.approx(float(body.friction_coefficient), rel=1e-6)
    value, _, beyond, _ = fitted.predict("tip_angle", {"base_tension": 50.0, "force_y@60mm": [-0.7, -1.2]})
    expected = [float(hung(50.0, weight).tip_angle) for weight in (-0.7, -1.2)]
    np.testing.assert_allclose(value, expected, rtol=1e-6)
    assert beyond.tolist() == [False, True]  # -1.2 N hung on no row
    assert refused(fitted.predict, "tip_angle", {"base_tension": 50.0, "force_y@200mm": -1.0}) == (
        "predict: force @200mm: it must act above 0 and up to the tip at 140 mm, not at 200 mm; correct the place"
    )
