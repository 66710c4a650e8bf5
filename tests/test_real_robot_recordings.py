"""The study of recordings of a real robot, fitting/real_robot_recordings.py, with the data of data/opencr_v4."""

import runpy
from types import SimpleNamespace

import numpy as np
import pytest
from places import ROOT

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(str(ROOT / "fitting"))
    STUDY = SimpleNamespace(**runpy.run_path(str(ROOT / "fitting" / "real_robot_recordings.py")))

FOUND = {  # by the study itself: the friction moment
    "offset": 4.394e-3,
    "outside_compliance": 1.39e-4,
    "slack_offset": 1e-6 * np.array([-81.0, -68.0, 197.0, 105.0, -179.0, -94.0, -61.0, -620.0, -227.0]),
    "angle": np.array([-3.0321, -0.9440, 1.2253, -2.5375, -0.4772, 1.6256, -2.0372, 0.0318, 2.0831]),
    "camera": np.zeros(3),
    "camera_turn": np.array([-0.0494, -0.0322]),
    "friction_moment": 2.40e-3,
}


def beginning(rows):
    whole = STUDY.read("validation")
    return STUDY.Recording(*(values[:rows] for values in whole))


def predicted(recording, **other):
    body = STUDY.robot(STUDY.loops_of())
    parameters = {name: np.asarray(value) for name, value in {**FOUND, **other}.items()}
    return np.asarray(STUDY.by_arcs(recording, float(body.stiffness(0.0)), parameters)), body, parameters


def test_the_recordings_are_those_of_the_origin():
    """Rows as its files have; at first the tip is as far from the base as the body is long."""
    for name, rows in (("training", 1620), ("validation", 443)):
        recording = STUDY.read(name)
        assert recording.displacement.shape == (rows, 9)
        assert recording.tip[0, 0] == pytest.approx(0.18825, abs=1.5e-3)
        assert np.all(np.diff(recording.time) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0.0, 2.4e-3])
def test_a_body_of_arcs_bends_as_trace_says(moment):
    """Without friction on tendons it is the same body, on elements and by another solver, which halves each step."""
    recording = beginning(24)
    halved = STUDY.Recording(*(np.repeat(values, 2, axis=0)[1:] for values in recording))
    for whole, half in zip(recording, halved, strict=True):
        half[1::2] = (whole[:-1] + whole[1:]) / 2
    place, body, parameters = predicted(halved, friction_moment=moment)
    assert np.ptp(place[:, 0]) > 0.05
    apart = np.linalg.norm(STUDY.followed(body, recording, parameters) - place[::2], axis=1)
    assert np.max(apart) < 1e-4


@pytest.mark.slow
def test_a_friction_moment_and_a_lag_predict_better_and_as_well_as_another_study_says():
    """An independent study of the same recordings has 3.62 / 6.92 mm with a friction moment, fitted on training."""
    training, validation = (STUDY.read(name) for name in ("training", "validation"))
    for recording, other in ((training, 3.62e-3), (validation, 6.92e-3)):
        place, _, parameters = predicted(recording)
        missed = STUDY.misfits(place, recording, parameters)
        assert missed["misfit"] == pytest.approx(other, rel=0.02)
        assert missed["across"] < missed["in_plane"] < missed["misfit"]
        without, _, parameters = predicted(recording, friction_moment=0.0)
        assert STUDY.misfits(without, recording, parameters)["misfit"] > 1.05 * missed["misfit"]
