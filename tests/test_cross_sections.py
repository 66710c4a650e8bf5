"""Bodies from tables of cross-sections: which profile is chosen, the way back from a file, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cddf_jax as cddf
from cddf_jax.cross_sections import cross_sections_csv
from cddf_jax.simplest_profile import simplest_profile

LENGTH = 0.14
S = np.linspace(0.0, LENGTH, 201)
HEAD = "arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm]\n"
ROWS = HEAD + "0, 20, 7, 10\n140, 13, 7, 10\n"


def body(**changed):
    numbers = {"length": LENGTH, "outer_radius": (0.02, 0.013), "inner_radius": 0.007, "tendon_offset": 0.01}
    return cddf.conical(**numbers | changed, youngs_modulus=1.4e6, friction_coefficient=0.42)


@pytest.fixture
def read(tmp_path):
    def reading(text, **options):
        path = tmp_path / "body.csv"
        path.write_text(text)
        return cddf.read_cross_sections(path, **options)

    return reading


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        (lambda s: 0.02 + 0.0 * s, cddf.Constant),
        (lambda s: 0.02 - 0.05 * s, cddf.Linear),
        (lambda s: 0.02 - 0.05 * s + 0.3 * s**2 - 1.1 * s**3, cddf.Spline),
        (lambda s: np.where(s < 0.07, 0.02 - 0.05 * s, 0.0165 - 0.02 * (s - 0.07)), cddf.Piecewise),
        (lambda s: 0.02 - 0.007 * np.exp(-(((s - 0.07) / 0.01) ** 2)), cddf.Spline),
    ],
)
@pytest.mark.parametrize("rounding", [0.0, 0.9e-6])
def test_the_simplest_profile_passes_every_point_at_the_tolerance(shape, kind, rounding):
    values = shape(S) + 0.5 * rounding * np.cos(37.0 * np.arange(len(S)))
    profile = simplest_profile(S, values, 1e-6, "radius")
    assert type(profile) is kind
    np.testing.assert_allclose(profile(S), values, rtol=0, atol=1e-6)


def test_a_cubic_needs_four_knots_and_a_kink_one_joint():
    """Four knots make one cubic; two straight lines meet once."""
    cubic = simplest_profile(S, 0.02 - 0.05 * S + 0.3 * S**2 - 1.1 * S**3, 1e-9, "radius")
    assert len(cubic.values) == 4
    cones = simplest_profile(S, np.interp(S, [0.0, 0.07, LENGTH], [0.02, 0.015, 0.013]), 1e-9, "radius")
    np.testing.assert_allclose(cones.ends, [0.07])


@st.composite
def tables(draw):
    """Of few lengths: each is compiled anew."""
    count = draw(st.sampled_from([2, 3, 4, 7, 30]))
    return draw(st.lists(st.floats(0.005, 0.03), min_size=count, max_size=count))


@given(tables())
def test_every_table_of_points_is_passed(values):
    s = np.linspace(0.0, LENGTH, len(values))
    profile = simplest_profile(s, np.array(values), 1e-6, "radius")
    np.testing.assert_allclose(profile(s), values, rtol=0, atol=1.001e-6)


def test_scattered_points_are_refused_with_the_remedy():
    with pytest.raises(cddf.InputError, match="give a greater tolerance"):
        simplest_profile(S, 0.02 + 1e-4 * np.cos(37.0 * np.arange(len(S))), 1e-6, "radius")


def test_a_table_that_was_written_gives_the_body_back(read):
    tendons = [
        cddf.Tendon(cddf.Linear(0.01, 0.009, LENGTH), -1),
        cddf.Tendon(0.01, +1, end=0.1),
    ]
    spline = cddf.Spline([0.0, 0.05, 0.09, LENGTH], [0.02, 0.018, 0.0145, 0.013])
    robot = cddf.Manipulator(LENGTH, spline, 0.007, tendons, 1.4e6, 0.42)
    sections = read(cross_sections_csv(robot))
    again = cddf.Manipulator(**sections._asdict(), youngs_modulus=1.4e6, friction_coefficient=0.42)
    assert [tendon.side for tendon in again.tendons] == [-1, +1]
    assert again.tendons[0].end is None
    np.testing.assert_allclose(again.tendons[1].end, 0.1, rtol=0, atol=1e-12)
    for mine, its in ((robot.outer_radius, again.outer_radius), (robot.inner_radius, again.inner_radius)):
        np.testing.assert_allclose(its(S), mine(S), rtol=0, atol=1e-6)
    np.testing.assert_allclose(again.tendons[0].offset(S), tendons[0].offset(S), rtol=0, atol=1e-9)


def test_a_manipulator_file_takes_its_sections_from_a_table(tmp_path):
    """The same solve as the body whose table was written; nine digits are written."""
    (tmp_path / "body.csv").write_text(cross_sections_csv(body()))
    robot = tmp_path / "robot.toml"
    robot.write_text('cross_sections = "body.csv"\nyoungs_modulus = "1.4 MPa"\nfriction_coefficient = 0.42\n')
    read = cddf.read_manipulator(robot)
    assert float(read.length) == LENGTH
    np.testing.assert_allclose(cddf.solve(read, 75.0).tip_tension, cddf.solve(body(), 75.0).tip_tension, rtol=1e-7)
    robot.write_text(
        'cross_sections = { file = "body.csv", tolerance = "10 um" }\nyoungs_modulus = "1.4 MPa"\n'
        'friction_coefficient = 0.42\n[[tendons]]\nfriction_coefficient = 0.3\naxial_stiffness = "12 kN"\n'
    )
    (tendon,) = cddf.read_manipulator(robot).tendons
    assert (float(tendon.friction_coefficient), float(tendon.axial_stiffness)) == (0.3, 12e3)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('length = "140 mm"\n', "length is in the table of cross_sections too"),
        ("cross_sections = 3\n", "must name a CSV file"),
        ("[[tendons]]\n[[tendons]]\n", "2 tables for 1 columns of offsets"),
        ('[[tendons]]\noffset = "1 mm"\n', "tendon 1: unknown key 'offset'"),
    ],
)
def test_a_bad_manipulator_file_is_refused(tmp_path, lines, message):
    (tmp_path / "body.csv").write_text(ROWS)
    named = "" if "cross_sections" in lines else 'cross_sections = "body.csv"\n'
    robot = tmp_path / "robot.toml"
    robot.write_text(f'{named}youngs_modulus = "1.4 MPa"\nfriction_coefficient = 0.42\n{lines}')
    with pytest.raises(cddf.InputError, match=message):
        cddf.read_manipulator(robot)


def test_one_tendon_needs_no_number(read):
    (tendon,) = read(ROWS.replace("offset_1", "offset")).tendons
    assert float(tendon.offset.value) == 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "add the cross-sections below it"),
        (HEAD + "0, 20, 7, 10\n", "holds one cross-section"),
        (HEAD + "1, 20, 7, 10\n140, 13, 7, 10\n", "row 2, column arc_length: the first must be 0"),
        (HEAD + "0, 20, 7, 10\n140, 13, 7, 10\n70, 15, 7, 10\n", "row 4, column arc_length: must increase, got 70 mm"),
        (HEAD + "0, 20, 7, 10\n140, nan, 7, 10\n", "row 3, column outer_radius: must be finite"),
        (HEAD + "0, 20, , 10\n140, 13, 7, 10\n", "row 2, column inner_radius: the cell is empty"),
        (HEAD + "0, 20, 7, \n140, 13, 7, 10\n", "row 2, column offset_1: cells are empty before the end"),
        (HEAD + "0, 20, 7, 10\n140, 13, 7, -10\n", "row 3, column offset_1: the tendon changes sides"),
        (ROWS.replace("offset_1", "offset_2"), "without gaps, got offset_2"),
        (ROWS.replace(", offset_1 [mm]", "").replace(", 10", ""), "got none"),
        (ROWS.replace("inner_radius", "bore"), "unknown column 'bore'"),
        (ROWS.replace("offset_1", "outer_radius"), "appears twice"),
        (ROWS.replace("outer_radius [mm]", "outer_radius"), "needs a unit of length"),
    ],
)
def test_bad_tables_are_refused(read, text, message):
    with pytest.raises(cddf.InputError, match=rf"body.csv: .*{message}"):
        read(text)


def test_a_tolerance_is_a_positive_length(read):
    with pytest.raises(cddf.InputError, match="tolerance must be a positive length"):
        read(ROWS, tolerance=0.0)
