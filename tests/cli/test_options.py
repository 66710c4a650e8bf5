"""What is typed as an option, read directly: numbers with units, and one clear line for what cannot be read."""

import numpy as np
import pytest
from bodies import paper_body
from kinds import of_kind
from refusals import refused

import cddf_jax as cddf
from cddf_jax.cli.fit_options import read_before, read_leave_out, read_noise, read_priors, read_setting
from cddf_jax.cli.options import read_data
from cddf_jax.errors import InputError
from cddf_jax.estimation.observations import Noise
from cddf_jax.estimation.parameter_space import Prior
from cddf_jax.files.actuation import read_actuation, read_directions, read_loads

ONE, TWO = paper_body("exact"), paper_body("exact", num_tendons=2)


# --- tensions and targets ------------------------------------------------------------------------


def test_tensions_and_targets():
    assert read_actuation(["0.075 kN"], ONE) == [75.0]
    assert read_actuation(["20 N"], TWO) == [20.0, 20.0]
    in_order = read_actuation(["tip_stiffness=0.35 N/mm", "20 N"], TWO)  # of the tendons
    stiffness, tension = of_kind(list, in_order)
    assert (type(stiffness), float(stiffness.value), tension) == (cddf.TipStiffness, 350.0, 20.0)
    (curvature,) = of_kind(list, read_actuation(["curvature=0.008 1/mm at 7 cm"], ONE))
    assert (float(curvature.value), float(curvature.arc_length)) == (8.0, 0.07)
    for text, kind, value in (
        ("displacement = 5 mm", cddf.Displacement, 0.005),
        ("tip_angle=45 deg", cddf.TipAngle, np.pi / 4),
        ("tip_tension=0.04 kN", cddf.TipTension, 40.0),
        ("total_tension=80 N", cddf.TotalTension, 80.0),
    ):
        (target,) = of_kind(list, read_actuation([text], ONE))
        assert type(target) is kind
        assert float(target.value) == pytest.approx(value, rel=1e-15)


def test_rows_to_leave_out():
    assert read_leave_out(None) == ""
    assert read_leave_out(["8, 14", "20-23"]) == "8, 14, 20-23"
    assert read_leave_out(["run_1.csv=8, 14", "run_2.csv = 3"]) == {"run_1.csv": "8, 14", "run_2.csv": "3"}


def test_a_place_of_the_tip_with_limits():
    place = of_kind(cddf.TipPosition, read_actuation(["tip_position=100, 80 mm"], TWO))
    np.testing.assert_allclose(place.value, [0.1, 0.08], rtol=1e-15)
    assert (float(place.minimum_tension), place.maximum_tension) == (0.0, None)
    place = of_kind(cddf.TipPosition, read_actuation(["tip_position = 100 mm, 8 cm from 1 N to 0.05 kN"], TWO))
    np.testing.assert_allclose(place.value, [0.1, 0.08], rtol=1e-15)
    assert (place.minimum_tension, place.maximum_tension) == (1.0, 50.0)
    message = "base_tension: a tip_position stands for all tendons; give it alone"
    assert refused(read_actuation, ["tip_position=100, 80 mm", "3 N"], TWO) == message


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("75", "base_tension needs a unit of force, got '75'; write for example '12.5 N'"),
        ("", "base_tension is not a number, got ''; write for example '12.5 N'"),
        ("-5 N", "base_tension '-5 N': a tendon cannot push; give 0 N or more"),
        ("tip_angle=45", "base_tension tip_angle needs a unit of angle, got '45'; write for example '12.5 deg'"),
        ("tip_angle 45 deg", "base_tension is not a number, got 'tip_angle 45 deg'; write for example '12.5 N'"),
        ("tip-angle=45 deg", "'tip-angle=45 deg': unknown target 'tip-angle'; did you mean tip_angle?"),
        ("mu=0.4", "'mu=0.4': unknown target 'mu'; known are displacement, tip_angle, tip_tension, curvature, "),
        ("tip_position=0.1 m", "base_tension tip_position needs two components X, Y, or three in space, got '0.1 m'"),
        ("tip_position=1, 2, 3 mm", "'tip_position=1, 2, 3 mm': 3 components given; this body needs 2"),
        ("tip_position=1, 2 mm from 3 N to 2 N", "give a least tension of 0 N or more, and a largest"),
        ("tip_tension=-4 N", "'tip_tension=-4 N': a tendon cannot push; give 0 N or more"),
        ("tip_stiffness=0 N/m", "'tip_stiffness=0 N/m': a stiffness is positive; give more than 0 N/m"),
        ("curvature=8 1/m", "say where the curvature is wanted as in 'curvature=12 1/m at 70 mm'"),
        ("curvature=8 1/m at 70", "base_tension curvature at needs a unit of length, got '70'"),
        ("curvature=8 1/m at 150 mm", "150 mm is not on the body; give an arc length from 0 mm to 140 mm"),
    ],
)
def test_wrong_tensions_and_targets(target, message):
    said = refused(read_actuation, [target], ONE)
    assert said.startswith("base_tension ")
    assert message in said


def test_wrong_numbers_of_tensions_targets_and_directions():
    for texts, body, message in (
        (["75 N"] * 2, ONE, "base_tension: 2 given; give one for all, or one for each of 1"),
        (["75 N"] * 3, TWO, "base_tension: 3 given; give one for all, or one for each of 2"),
        (["tip_angle=45 deg"], TWO, "base_tension: 1 given with a target among them; give one tension or target for"),
    ):
        assert refused(read_actuation, texts, body).startswith(message)
    assert refused(read_directions, [1] * 3, TWO) == "direction: 3 given; give one for all, or one for each of 2"
    assert refused(read_directions, [2], ONE).startswith("direction 2: give +1 for a tendon that slides in")
    assert read_directions([-1], TWO) == [-1, -1]
    assert read_directions(None, TWO) is None


# --- loads ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("texts", "values"),
    [
        (("0 N, -5 N", "0.1 N m", "0, -9.81 m/s^2"), [[0.0, -5.0], 0.1, [0.0, -9.81]]),
        (("0, -0.005 kN", "100 N mm", "0 m/s^2, -981 cm/s^2"), [[0.0, -5.0], 0.1, [0.0, -9.81]]),
        (("0, -5, 1 N", "0, 0, 100 N mm", "0, 0, -981 cm/s^2"), [[0.0, -5.0, 1.0], [0.0, 0.0, 0.1], [0.0, 0.0, -9.81]]),
    ],
)
def test_units_of_the_loads(texts, values):
    loads = of_kind(cddf.Loads, read_loads(*texts))
    assert [np.asarray(load).tolist() for load in (loads.tip_force, loads.tip_moment, loads.gravity)] == values


def test_loads_at_places_of_the_body():
    loads = of_kind(cddf.Loads, read_loads(None, None, None, ["60 mm: 0, -1 N", "0.1 m: 1, 0, 0 N and 0, 0, 100 N mm"]))
    found = [[np.asarray(x).tolist() for x in (each.arc_length, each.force, each.moment)] for each in loads.points]
    assert found == [[0.06, [0.0, -1.0], 0.0], [0.1, [1.0, 0.0, 0.0], [0.0, 0.0, 0.1]]]
    for text, message in (
        ("0, -1 N", "needs a place and a force, got '0, -1 N'; write for example '60 mm: 0, -1 N'"),
        ("60: 0, -1 N", "needs a unit of length, got '60'; write for example '12.5 mm'"),
        ("60 mm: 0, -1 m", "X needs a unit of force, got '0 m'; write for example '12.5 N'"),
        ("60 mm: 0, -1 N and 1 N", "needs a unit of moment, got '1 N'; write for example '12.5 N m'"),
    ):
        assert refused(read_loads, None, None, None, [text]) == f"point_load {message}"


@pytest.mark.parametrize(
    ("option", "text", "message"),
    [
        ("tip_force", "5 N", " needs two components X, Y, or three in space, got '5 N'; write for example '0 N, -12"),
        ("tip_force", "1 N, 2 N, 3 m", " Z needs a unit of force, got '3 m'; write for example '12.5 N'"),
        ("tip_force", "0, -5", " X needs a unit of force, got '0'; write for example '12.5 N'"),
        ("tip_force", "0 N,", " Y is not a number, got ''; write for example '12.5 N'"),
        ("tip_moment", "0.1", " needs a unit of moment, got '0.1'; write for example '12.5 N m'"),
        ("tip_moment", "0.1 N m, 0", " is one number in the plane and three in space, got '0.1 N m, 0'"),
        ("gravity", "0, -9.81 m", " X needs a unit of acceleration, got '0 m'; write for example '12.5 m/s^2'"),
    ],
)
def test_wrong_loads(option, text, message):
    texts = [text if option == own else None for own in ("tip_force", "tip_moment", "gravity")]
    assert refused(read_loads, *texts).startswith(option + message)


# --- priors, noise, columns ------------------------------------------------------------------------


def test_priors_and_noise():
    for sign in ("+-", "±"):
        assert read_priors([f"youngs_modulus = 1.4 MPa {sign} 100 kPa"]) == {"youngs_modulus": Prior(1.4e6, 1e5)}
    assert read_noise(["tip_tension=0.0005 kN"]) == {"tip_tension": 0.5}
    assert read_noise(["tip_tension=0.2 N + 1 %"]) == {"tip_tension": Noise(0.2, 0.01)}
    assert read_noise(["tip_tension=1 %"]) == {"tip_tension": Noise(0.0, 0.01)}


def of_marker(texts):
    return read_setting(None, texts, None)


def of_given(texts):
    return read_setting(None, None, texts)


def test_the_setting_of_a_bench():
    loads = cddf.Loads(gravity=(0.0, -9.81))
    setting = read_setting(loads, ["head=1, 11 mm at 8 cm"], ["camera_turn_z=90 deg", "tip_gain_2=1.03"])
    assert setting.loads is loads
    assert setting.markers == {"head": cddf.Marker(0.08, (0.001, 0.011))}
    assert setting.given == {"camera_turn_z": np.pi / 2, "tip_gain_2": 1.03}
    assert read_setting(None, None, None) == cddf.BenchSetting()


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (of_marker, "head=80 mm", "--marker head: write for example "),
        (of_marker, "head=0, 11 mm at 80", "--marker head needs a unit of length, got '80'"),
        (of_given, "tip_gain", "--given 'tip_gain': write for example "),
        (of_given, "tip_gian=1", "'tip_gian' is not a parameter that can be fitted"),
        (of_given, "youngs_modulus=1 MPa", "given: youngs_modulus does not belong to the bench"),
        (read_priors, "youngs_modulus", "--prior 'youngs_modulus': write for example "),
        (read_priors, "youngs_modulus=1.4 MPa", "--prior youngs_modulus: write for example "),
        (read_priors, "mu=0.4 +- 0.1", "'mu' is not a parameter that can be fitted; there are friction_coefficient"),
        (read_priors, "youngs_modulus=1.4 MPa +- 0.1", "--prior youngs_modulus needs a unit of pressure, got '0.1'"),
        (read_noise, "tip_tension", "--noise 'tip_tension': write for example "),
        (read_noise, "tip_tension=0.5 mm", "--noise tip_tension needs a unit of force, got '0.5 mm'"),
        (read_noise, "tip_tension=0.1 N + 0.2 N", "--noise tip_tension: the part that grows with the reading is in %"),
    ],
)
def test_what_a_fit_cannot_read(read, text, message):
    assert refused(read, [text]).startswith(message)


def test_names_of_columns():
    twice = ["a=trial", "a=weight [N]"]
    assert refused(read_data, [], twice) == "--column a is given twice; leave one out"
    assert refused(read_data, [], ["wrap_angle"]).startswith("--column 'wrap_angle': write for example ")


def test_what_was_before():
    assert read_before(None) == "rest"
    assert read_before("75 N") == 75.0
    assert read_before("rest, 0.08 kN") == ["rest", 80.0]
    with pytest.raises(InputError, match=r"--before"):
        read_before("75")
