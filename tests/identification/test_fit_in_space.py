"""Fits to tips and markers: in the plane, and of a helix as a turned camera sees them."""

import dataclasses

import jax
import numpy as np
import pytest
from bodies import paper_body, three_tendon_tube
from kinds import bench_of, of_kind
from scipy.spatial.transform import Rotation

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.identification.course import course_of
from cddf_jax.identification.parameters import PLAIN

MU, E = 0.35, 1.2e6
HEAD = cddf.Marker(0.080, (0.002, 0.011, 0.004))


def in_plane(**numbers):
    return paper_body("exact", **numbers)


def winding(**numbers):
    """The paper's body with a helix of a quarter of a turn."""
    return dataclasses.replace(
        paper_body("exact", **numbers), tendons=(cddf.Tendon(0.010, angle=cddf.Linear(0.0, np.pi / 2, 0.14)),)
    )


def test_markers_of_a_file(tmp_path):
    """Millimetres in the file, metres in the table."""
    path = tmp_path / "bench.csv"
    path.write_text("base_tension [N], x@120mm [mm], y@head (mm)\n10, 118, 11.5\n")
    table = cddf.read_measurements(path)
    np.testing.assert_allclose([table["x@120mm"][0], table["y@head"][0]], [0.118, 0.0115])


def test_a_marker_on_the_axis_at_the_tip_is_the_tip():
    body, pulls = in_plane(), np.array([10.0, 40.0])
    columns = {"tip_x": [0.0, 0.0], "tip_y": [0.0, 0.0], "x@140mm": [0.0, 0.0], "y@140mm": [0.0, 0.0]}
    table = cddf.Measurements.from_columns("zeros", base_tension=pulls, **columns)
    camera = {"camera_turn_z": np.pi / 2, "camera_x": 0.1}
    shown = jax.jit(lambda camera: bench_of(table, body).predict(body, camera, 16))(camera)
    np.testing.assert_allclose(shown["x@140mm"], shown["tip_x"], atol=1e-12)
    np.testing.assert_allclose(shown["y@140mm"], shown["tip_y"], atol=1e-12)
    straight = [cddf.solve(body, pull).tip_position for pull in pulls]
    np.testing.assert_allclose(shown["tip_x"], [0.1 - y for _, y in straight], atol=1e-12)  # a quarter of a turn
    np.testing.assert_allclose(shown["tip_y"], [x for x, _ in straight], atol=1e-12)


@pytest.mark.parametrize(
    ("columns", "setting", "words"),
    [
        ({"tip_z": [0.01]}, PLAIN, "the body is in the plane; give its tendons an angle"),
        ({"x@head": [0.01]}, PLAIN, "no marker has this name; give BenchSetting"),
        ({"x@200mm": [0.01]}, PLAIN, "at 200 mm, but the body is 140 mm long"),
        ({"x@head": [0.01]}, cddf.BenchSetting(markers={"head": cddf.Marker(-0.01)}), "at -10 mm"),
        ({"tip_x": [0.01]}, cddf.BenchSetting(markers={"head": HEAD}), "the marker 'head' is in no table"),
    ],
)
def test_what_cannot_be_read(columns, setting, words):
    table = cddf.Measurements.from_columns("bench", base_tension=[10.0], **columns)
    with pytest.raises(InputError, match=words):
        cddf.fit(in_plane(), table, setting=setting)


def test_a_marker_position_that_is_given_twice(tmp_path):
    (tmp_path / "bench.csv").write_text("base_tension [N]\n10\n")
    (tmp_path / "markers.csv").write_text("row,marker,arc_length [mm],x [mm]\n1,head,80,79\n")
    (table,) = cddf.read_tables([tmp_path / "bench.csv", tmp_path / "markers.csv"])
    with pytest.raises(InputError, match="the table gives the position of the marker 'head' already"):
        cddf.fit(in_plane(), table, setting=cddf.BenchSetting(markers={"head": HEAD}))


@pytest.mark.parametrize(
    ("given", "words"), [({"youngs_modulus": 1e6}, "does not belong to the bench"), ({"tip_gain": np.nan}, "finite")]
)
def test_given_numbers_that_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        cddf.BenchSetting(given=given)


@pytest.mark.parametrize(
    ("body", "name", "words"),
    [
        (in_plane(), "camera_turn_x", "camera_turn_x has an effect only on a body in space; give its tendons an angle"),
        (winding(), "shear_factor", "shear_factor has an effect only on a body that stretches; make it extensible"),
    ],
)
def test_parameters_that_have_no_effect_on_the_body(body, name, words):
    table = cddf.Measurements.from_columns("bench", base_tension=[10.0], tip_x=[0.13])
    with pytest.raises(InputError, match=words):
        cddf.fit(body, table, [name])


@pytest.mark.slow
@pytest.mark.parametrize("turns", [0.5, 0.0])
def test_torsion_and_stretch_apart_from_bending(turns, tmp_path):
    """A fit finds the true values for a helix, which twists. A straight tendon does not twist and determines neither.

    The helix is softer in torsion than any material, and its file holds what was fitted.
    """
    truth = {"poissons_ratio": 0.8, "axial_factor": 0.7} if turns else {"poissons_ratio": 0.4}
    tendon = cddf.Tendon(0.010, angle=cddf.Linear(0.0, 2 * np.pi * turns, 0.14) if turns else 0.0)
    start = dataclasses.replace(in_plane(), tendons=(tendon,), extensible=bool(turns))
    body, pulls = dataclasses.replace(start, youngs_modulus=E, **truth), np.array([20.0, 40.0, 60.0])
    found = [cddf.solve(body, pull).tip_position for pull in pulls]
    columns = {f"tip_{axis}": [float(place[i]) for place in found] for i, axis in enumerate("xyz")}
    table = cddf.Measurements.from_columns("simulated", base_tension=pulls, **columns)
    fit = cddf.fit(start, table, ["youngs_modulus", *truth], noise=dict.fromkeys(columns, 1e-4))
    assert fit.value["youngs_modulus"] == pytest.approx(E, rel=1e-6)
    if turns:
        assert [fit.status[name] for name in truth] == ["identified", "identified"]
        assert [fit.value[name] for name in truth] == pytest.approx(list(truth.values()), rel=1e-5)
        cddf.write_manipulator(fit.manipulator, tmp_path / "found.toml")
        again = cddf.read_manipulator(tmp_path / "found.toml")
        assert float(again.poissons_ratio) == fit.value["poissons_ratio"]
    else:
        assert fit.status["poissons_ratio"] == "not identified"


PULLED, RELEASED = [20.0, 40.0, 60.0], [10.0, 5.0]  # N; at 10 N the front has passed the tip of either body


def loop(body, arc_length):
    """Equilibria of a loop, by `solve`, where all of the tendon slides in, and then all of it out."""
    found = [cddf.solve(body, pull) for pull in PULLED]
    found += [cddf.solve(body, pull, direction=-1) for pull in RELEASED]
    return [one.at(arc_length) for one in found], {"base_tension": PULLED + RELEASED, "step": np.arange(5)}


@pytest.mark.slow
def test_a_marker_on_a_loop_brings_friction_modulus_and_camera_back():
    """A marker on the side of the body, by `solve` as above; the camera is shifted by 10 mm."""
    offset = np.array([0.002, 0.011])
    fields, columns = loop(in_plane(friction_coefficient=MU, youngs_modulus=E), HEAD.arc_length)
    headings = np.array([of_kind(cddf.Fields, f).heading for f in fields])
    cos, sin = np.cos(headings), np.sin(headings)
    axis = np.array([f.position for f in fields]).T
    columns |= {
        "x@head": axis[0] + cos * offset[0] - sin * offset[1] + 0.01,
        "y@head": axis[1] + sin * offset[0] + cos * offset[1],
    }
    table = cddf.Measurements.from_columns("simulated", **columns)
    setting = cddf.BenchSetting(markers={"head": cddf.Marker(HEAD.arc_length, (0.002, 0.011))})
    free = ["friction_coefficient", "youngs_modulus", "camera_x"]
    fit = cddf.fit(in_plane(), table, free, setting=setting, noise={"x@head": 1e-4, "y@head": 1e-4})
    assert fit.success, fit.result
    np.testing.assert_allclose([fit.value[name] for name in free], [MU, E, 0.01], rtol=1e-6)


CAMERA = np.array([0.01, -0.02, 0.03, 0.3, -0.2, 0.1])
POSE = [f"{name}_{axis}" for name in ("camera", "camera_turn") for axis in "xyz"]


@pytest.mark.slow
def test_a_marker_and_the_tip_on_a_loop_in_space_as_a_camera_sees_them():
    """The same in space, without a fit: the positions and frames of `solve`, turned by SciPy."""
    body = winding()
    tips, (fields, columns) = loop(body, 0.14)[0], loop(body, HEAD.arc_length)
    heads = [f.position + np.asarray(of_kind(cddf.SpatialFields, f).frame) @ np.array(HEAD.offset) for f in fields]
    turn = Rotation.from_rotvec(CAMERA[3:])
    for end, places in (("@head", heads), ("", [tip.position for tip in tips])):
        seen = turn.apply(np.array(places)) + CAMERA[:3]
        columns |= {f"{axis}@head" if end else f"tip_{axis}": seen[:, i] for i, axis in enumerate("xyz")}
    table = cddf.Measurements.from_columns("simulated", **columns)
    rows = bench_of(table, body, course=course_of(table)[0], setting=cddf.BenchSetting(markers={"head": HEAD}))
    shown = rows.predict(body, dict(zip(POSE, CAMERA, strict=True)), 16)
    assert len(shown) == 6
    for name, values in shown.items():
        np.testing.assert_allclose(values, columns[name], atol=1e-8, err_msg=name)


@pytest.mark.slow
def test_markers_of_a_history_under_loads():
    """Those of `trace` with the same elements, under a force that bends the body out of its plane."""
    loads, pulls = cddf.Loads(tip_force=(0.0, -0.5, 0.3)), [10.0, 30.0, 5.0]
    table = cddf.Measurements.from_columns("simulated", base_tension=pulls, step=[1, 2, 3], **{"x@head": [0.1] * 3})
    setting, body = cddf.BenchSetting(loads=loads, markers={"head": HEAD}), winding()
    rows = bench_of(table, body, course=course_of(table, stepped=True)[0], setting=setting)
    found = rows.shown(body, {}, 6)
    expected = cddf.trace(body, pulls, loads, nodes=4, short_steps=4, throw=False)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    fields = of_kind(cddf.SpatialFields, expected.at(0.08))
    heads = np.asarray(fields.position) + np.einsum("sij,j->si", np.asarray(fields.frame), np.array(HEAD.offset))
    np.testing.assert_allclose(np.asarray(found.markers)[:, 0], heads, atol=1e-9)


@pytest.mark.slow
def test_a_camera_and_a_tendon_turned_about_the_axis_act_alike():
    """Tips alone show only how far both are turned: by 0.1 rad, which SciPy turns them by."""
    pulls, turn = np.linspace(10.0, 70.0, 4), 0.1
    found = [cddf.solve(winding(friction_coefficient=MU, youngs_modulus=E), pull) for pull in pulls]
    tip = Rotation.from_rotvec([turn, 0.0, 0.0]).apply(np.array([one.tip_position for one in found]))
    columns = {f"tip_{axis}": tip[:, i] for i, axis in enumerate("xyz")}
    columns["tip_tension"] = np.array([one.tip_tension[0] for one in found])
    table = cddf.Measurements.from_columns("simulated", base_tension=pulls, **columns)
    noise = {column: 0.05 if column == "tip_tension" else 1e-4 for column in columns}
    free = ["friction_coefficient", "youngs_modulus", "camera_turn_x", "tendon_angle_error"]
    fit = cddf.fit(winding(), table, free, noise=noise)
    assert [fit.status[name] for name in free] == ["identified"] * 2 + ["not identified"] * 2
    value, error, _ = fit.sums["camera_turn_x + tendon_angle_error"]
    assert value == pytest.approx(turn, abs=1e-7)
    # turning moves each tip across the axis by its distance from it
    assert error == pytest.approx(1e-4 / np.linalg.norm(tip[:, 1:]), rel=0.3)
    assert "Some have the same effect: only the sums and differences above are determined." in fit.verdict[-1]


@pytest.mark.slow
def test_rows_under_loads_in_space():
    """Each as `solve` has it, and a row that has no solution changes no other."""
    tendon = cddf.Tendon(0.010, angle=0.0)
    body = dataclasses.replace(in_plane(density=1070.0), tendons=(tendon,))
    gravity, pulls, weights = np.array([0.0, 0.0, -9.81]), np.array([10.0, 5000.0, 40.0]), [0.1, 0.0, -0.2]
    columns = {"direction": [1, 1, 1], "tip_force_z": [0.2, 0.1, 0.0], "force_y@80mm": weights, "tip_z": np.zeros(3)}
    table = cddf.Measurements.from_columns("rows", base_tension=pulls, **columns)
    bench = bench_of(table, body, setting=cddf.BenchSetting(cddf.Loads(gravity=gravity)))
    shown = bench.evaluate(body, {"friction_coefficient": 0.42}, 12)
    good = shown.status == cddf.Status.successful
    assert good.tolist() == [True, False, True]
    for row in np.flatnonzero(good):
        points = [cddf.PointLoad(0.08, (0.0, weights[row], 0.0))]
        loads = cddf.Loads(tip_force=(0.0, 0.0, table["tip_force_z"][row]), gravity=gravity, points=points)
        found = cddf.solve(body, pulls[row], loads, direction=1, nodes=12)
        for i, axis in enumerate("xyz"):
            np.testing.assert_allclose(shown.readings[f"tip_{axis}"][row], found.tip_position[i], atol=1e-12)
        assert np.all(np.isfinite(shown.derivatives["tip_z"][row]))


@pytest.mark.slow
def test_the_direction_of_gravity_and_a_known_cell():
    """In the plane: tips under gravity that is turned by 0.2 rad, and a tip cell that reads 3 % too much."""
    robot = in_plane(friction_coefficient=MU, youngs_modulus=E, density=1070.0)
    down, turn = np.array([0.0, -9.81]), 0.2
    cos, sin = np.cos(turn), np.sin(turn)
    loads = cddf.Loads(gravity=np.array([[cos, -sin], [sin, cos]]) @ down)
    pulls = np.linspace(10.0, 70.0, 7)
    found = [cddf.solve(robot, pull, loads) for pull in pulls]
    table = cddf.Measurements.from_columns(
        "simulated",
        base_tension=pulls,
        tip_tension=[1.03 * float(one.tip_tension[0]) for one in found],
        **{f"tip_{axis}": [float(one.tip_position[i]) for one in found] for i, axis in enumerate("xy")},
    )
    setting = cddf.BenchSetting(cddf.Loads(gravity=down), given={"tip_gain": 1.03})
    noise = {"tip_tension": 0.05, "tip_x": 1e-4, "tip_y": 1e-4}
    free = ["friction_coefficient", "youngs_modulus", "gravity_turn_z"]
    fit = cddf.fit(in_plane(density=1070.0), table, free, setting=setting, noise=noise)
    assert fit.success
    np.testing.assert_allclose([fit.value[name] for name in free], [MU, E, turn], rtol=1e-5)


# --- tip angles that no body in space can have -----------------------------------------------------

# simulated with mu 0.2 and E 10 MPa, an independent code: 198 deg fold to 162 deg between the axes
TENSIONS, ANGLES = [2.0, 5.0, 10.0, 15.0, 20.0], [27.01, 62.63, 116.60, 160.54, 198.10]
ROD = dataclasses.replace(paper_body("exact"), tendons=(cddf.Tendon(offset=2.5e-3, angle=0.0),))


def with_angles(angles, body=ROD, **options):
    table = cddf.Measurements.from_columns("bench", base_tension=TENSIONS, tip_angle=np.radians(angles))
    return bench_of(table, body, **options)


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        (
            ANGLES,
            "bench: row 5, column tip_angle: 198.1 deg, but .* from 0 to 180 deg; leave it out .*, or take a body in",
        ),
        (
            [-60.0, -20.0, 0.0, 20.0, 60.0],
            r"row 1, column tip_angle: -60 deg \(and 1 more\), .*; subtract the reading at",
        ),
        ([-2.0, 2.0, 1.0, 3.0, 4.0], "row 1, column tip_angle: -2 deg"),  # half of the largest is not noise
    ],
)
def test_tip_angles_that_a_body_in_space_cannot_have(angles, words):
    with pytest.raises(InputError, match=words):
        with_angles(angles)
    assert with_angles(angles, paper_body("exact")).columns == ("tip_angle",)  # the plane has signs and whole turns
    with pytest.raises(InputError, match="column tip_angle"):  # nor does a free zero hide them
        with_angles(angles[::-1] if angles[0] == -60.0 else [*angles[1:], angles[0]], free=("angle_zero",))


def test_tip_angles_with_noise_and_a_zero():
    """A reading at rest is below 0 in half of the cases, and a zero of the instrument moves all readings."""
    for angles in ([-1.5, *ANGLES[1:4], np.nan], [-2.9, 30.0, 60.0, 90.0, 179.9]):
        assert with_angles(angles).columns == ("tip_angle",)
    shifted = [-8.0, 20.0, 50.0, 80.0, 100.0]
    with pytest.raises(InputError, match="row 1, column tip_angle: -8 deg"):
        with_angles(shifted)
    assert with_angles(shifted, free=("angle_zero",)).columns == ("tip_angle",)
    assert with_angles(shifted, setting=cddf.BenchSetting(given={"angle_zero": np.radians(-8.0)})).columns


@pytest.mark.slow
def test_rows_that_were_each_pulled_from_rest():
    """Simulated, each row a `trace` of its own with 16 increments. Without history a part sticks in one row."""
    body = three_tendon_tube()
    pulls = np.array([[11.99, 8.0, 3.2], [5.2, 1.0, 1.1], [8.3, 1.2, 6.9], [3.6, 10.6, 1.2], [1.4, 1.1, 9.0]])
    followed = jax.jit(lambda pull: cddf.trace(body, pull[None], short_steps=16, throw=False))
    read = [followed(pull) for pull in pulls]
    names = [f"base_tension{end}" for end in ("", "_2", "_3")]
    columns = dict(zip(names, pulls.T, strict=True))
    columns |= {f"tip_{axis}": [float(each.tip_position[0, i]) for each in read] for i, axis in enumerate("xyz")}
    columns |= {"tip_tension": [float(each.tip_tension[0, 0]) for each in read]}
    table = cddf.Measurements.from_columns("rows", ("simulated",), **columns)
    noise = {"tip_x": 1e-4, "tip_y": 1e-4, "tip_z": 1e-4, "tip_tension": 0.02, "base_tension": 0.0}
    start = dataclasses.replace(body, friction_coefficient=0.2, youngs_modulus=1.2e6)
    found = cddf.fit(start, table, noise=noise)
    assert found.success
    assert found.value["friction_coefficient"] == pytest.approx(
        0.3, abs=3 * found.standard_error["friction_coefficient"]
    )
    assert found.value["youngs_modulus"] == pytest.approx(1e6, abs=3 * found.standard_error["youngs_modulus"])
    assert any("each row was followed from rest, with all that was set in proportion" in one for one in found.warnings)
    again = dataclasses.replace(found, options=found.options | {"history": None})  # as of a fit of other rows
    for fit in (found, again):  # where a part of a tendon sticks in a row, `solve` is far off
        assert fit.predict("tip_y", pulls).value == pytest.approx(columns["tip_y"], abs=1e-4)
        theirs = [float(each.tip_tension[0, 1]) for each in read]
        assert fit.predict("tip_tension_2", pulls).value == pytest.approx(theirs, abs=0.05)
