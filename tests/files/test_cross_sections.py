"""Bodies from tables of cross-sections: which profile is chosen, the way back from a file, and what is refused."""

import numpy as np
import pytest
from bodies import paper_body
from hypothesis import given, strategies as st
from kinds import of_kind
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

import cddf_jax as cddf
from cddf_jax.files import simplest_profile
from cddf_jax.files.cross_sections import cross_sections_csv
from cddf_jax.robot.profiles import Polyline, Profile

LENGTH = 0.14
S = np.linspace(0.0, LENGTH, 201)
HEAD = "arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm]\n"
ROWS = HEAD + "0, 20, 7, 10\n140, 13, 7, 10\n"
# steps over 10 mm, for a tendon on discs outside the wall
STEPPED = HEAD + "0, 2, 0, 6\n60, 2, 0, 6\n70, 1.8, 0, 6\n130, 1.8, 0, 6\n140, 1.6, 0, 6\n200, 1.6, 0, 6\n"
# the same with true steps
STEPS = HEAD + "0, 2, 0, 6\n60, 2, 0, 6\n60, 1.8, 0, 6\n130, 1.8, 0, 6\n130, 1.6, 0, 6\n200, 1.6, 0, 6\n"


def taken(s, values, tolerance) -> Profile:
    return simplest_profile.simplest_profile(s, values, tolerance)


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
        (lambda s: np.where(s < 0.07, 0.02 - 0.05 * s, 0.0165 - 0.02 * (s - 0.07)), Polyline),
        (lambda s: 0.0165 - 0.0035 * np.tanh((s - 0.07) / 0.0175), cddf.Spline),
    ],
)
@pytest.mark.parametrize("rounding", [0.0, 0.9e-6])
def test_the_simplest_profile_passes_every_point_at_the_tolerance(shape, kind, rounding):
    values = shape(S) + 0.5 * rounding * np.cos(37.0 * np.arange(len(S)))
    profile = taken(S, values, 1e-6)
    assert type(profile) is kind
    np.testing.assert_allclose(profile(S), values, rtol=0, atol=1e-6)


def test_a_cubic_needs_four_knots_and_a_kink_one_joint():
    """Four knots make one cubic; two straight lines meet once."""
    cubic = of_kind(cddf.Spline, taken(S, 0.02 - 0.05 * S + 0.3 * S**2 - 1.1 * S**3, 1e-9))
    assert len(cubic.values) == 4
    cones = taken(S, np.interp(S, [0.0, 0.07, LENGTH], [0.02, 0.015, 0.013]), 1e-9)
    np.testing.assert_allclose(of_kind(Polyline, cones).arc_length, [0.0, 0.07, LENGTH])


@st.composite
def tables(draw):
    """Some are smooth, some monotone, some have a step."""
    count = draw(st.integers(2, 30))
    values = np.array(draw(st.lists(st.floats(0.005, 0.03), min_size=count, max_size=count)))
    kind, x = draw(st.sampled_from(["any", "sorted", "smooth", "steps"])), np.linspace(0.0, 1.0, count)
    s = LENGTH * x
    if kind == "sorted":
        values = np.sort(values)
    elif kind == "smooth":
        values = 0.02 + 0.005 * np.sin(draw(st.floats(0.5, 9.0)) * x + draw(st.floats(0.0, 6.0)))
    elif kind == "steps" and count > 3:
        s[count // 2] = s[count // 2 - 1]
    return s, values


def evaluated(profile, s):
    """By NumPy and SciPy, which need not compile; test_profiles.py holds that the profiles are the same."""
    match profile:
        case cddf.Constant():
            return np.full(s.shape, profile.value)
        case cddf.Linear():
            return profile.base + (profile.tip - profile.base) * s / profile.length
        case Polyline():
            return np.interp(s, profile.arc_length, profile.values)
        case cddf.Spline():
            return CubicSpline(profile.arc_length, profile.values, bc_type="not-a-knot")(s)
    at = np.searchsorted(profile.ends, s, side="right")
    return np.choose(at, [evaluated(piece, s) for piece in profile.pieces])


@given(tables())
def test_every_table_is_passed_and_nothing_lies_beyond_neighbouring_points(table):
    """On a grid that is denser than that of the reader."""
    s, values = table
    profile, width = taken(s, values, 1e-6), np.diff(s)
    slack = 1.001e-6 if np.all(width > 0) else 1.501e-6  # both sides of a step within the tolerance are their mean
    behind = np.append(width == 0, False)
    np.testing.assert_allclose(evaluated(profile, s - 1e-12 * behind), values, rtol=0, atol=slack)
    between = width > 0
    grid = s[:-1][between, None] + width[between, None] * np.linspace(1e-9, 1 - 1e-9, 401)
    curve, ends = evaluated(profile, grid), np.stack([values[:-1][between], values[1:][between]])
    assert np.all(curve >= ends.min(axis=0)[:, None] - slack)
    assert np.all(curve <= ends.max(axis=0)[:, None] + slack)
    climb = curve * np.sign(ends[1] - ends[0])[:, None]
    assert np.all(np.maximum.accumulate(climb, axis=1) - climb <= 2 * slack)  # as near as that to a monotone curve


def _second_moment(s, start, end, base, tip):
    """Of a solid cone between two rows."""
    return np.pi / 4 * (base + (tip - base) * (s - start) / max(end - start, 1e-300)) ** 4


@pytest.mark.parametrize(("text", "steps"), [(STEPPED, False), (STEPS, True)])
def test_a_stepped_rod_bends_as_the_lines_of_its_table(read, text, steps):
    """Exact kinematics, constant d, one tendon: T = T_base / (1 + mu T_base G / E), angle = ln(T_base / T) / mu,
    with G the integral of d / J, by SciPy's quadrature from row to row (theory.md, closed form); ten mm of ramp give
    78.4147 degrees, which SciPy's integration of the differential equations gives too.
    """
    sections = read(text)
    robot = cddf.Manipulator(**sections.body, youngs_modulus=2e9, friction_coefficient=0.2)
    s, radius = 1e-3 * np.loadtxt(text.splitlines()[1:], delimiter=",", usecols=(0, 1)).T
    rows = zip(s[:-1], s[1:], radius[:-1], radius[1:], strict=True)
    G = sum(quad(lambda x, *row: 6e-3 / _second_moment(x, *row), row[0], row[1], row)[0] for row in rows)
    angle = np.log1p(0.2 * 20.0 / 2e9 * G) / 0.2
    if not steps:
        np.testing.assert_allclose(np.degrees(angle), 78.4146086582, rtol=1e-11)
    equilibrium = cddf.solve(robot, 20.0)
    np.testing.assert_allclose(equilibrium.tip_angle, angle, rtol=1e-9)
    np.testing.assert_allclose(equilibrium.tip_tension, [20.0 * np.exp(-0.2 * angle)], rtol=1e-9)


def test_a_repeated_arc_length_is_a_step_at_which_panels_end(read):
    sections = read(STEPS)
    outer, both_sides = sections.outer_radius, np.array([0.06 - 1e-9, 0.06, 0.13 - 1e-9, 0.13])
    assert type(outer) is cddf.Piecewise
    np.testing.assert_array_equal(outer.breakpoints, [0.06, 0.13])
    np.testing.assert_allclose(outer(both_sides), 1e-3 * np.array([2, 1.8, 1.8, 1.6]))
    assert type(sections.tendons[0].offset) is cddf.Constant
    said = "2 mm at the base, 1.6 mm at s = 200 mm (Piecewise, from 1.6 mm to 2 mm)"
    assert sections.columns["outer_radius"] == said


def test_steps_between_slants_and_curves():
    """A cone, a cylinder and a cubic; the points of each lie on it."""
    s = np.concatenate([np.linspace(0, 0.05, 6), np.linspace(0.05, 0.07, 3), np.linspace(0.07, LENGTH, 40)])
    parts = [0.02 - 0.1 * s[:6], np.full(3, 0.012), 0.01 - 3.0 * (s[9:] - 0.06) ** 3]
    read = taken(s, np.concatenate(parts), 1e-9)
    kinds = [type(piece) for piece in of_kind(cddf.Piecewise, read).pieces]
    assert kinds == [cddf.Linear, cddf.Constant, cddf.Spline]
    left = s - 1e-12 * np.isin(np.arange(len(s)), [5, 8])
    np.testing.assert_allclose(read(left), np.concatenate(parts), rtol=0, atol=2e-9)


def test_steps_within_the_tolerance_are_none():
    s = np.array([0.0, 0.05, 0.05, LENGTH])
    read = taken(s, np.array([7e-3, 7e-3, 7.0004e-3, 7.0004e-3]), 1e-6)
    assert of_kind(cddf.Constant, read).value == pytest.approx(7.0002e-3)


def test_the_turns_of_an_offset_are_said(tmp_path):
    """Ten um up and down every 2 mm: nineteen kinks of nearly 2 * 20 um / 2 mm each, 21.77 degrees in all."""
    path = tmp_path / "body.csv"
    path.write_text(HEAD + "\n".join(f"{2 * i}, 20, 7, {10 + 0.01 * (-1) ** i}" for i in range(21)))
    turned = np.degrees(19 * 2 * np.arctan(0.02 / 2))
    said = cddf.read_cross_sections(path).columns["offset_1"]
    assert f"whose kinks turn the tendon by {turned:.3g} deg in all" in said
    assert cddf.read_cross_sections(path, tolerance=2e-5).columns["offset_1"] == "10 mm"


def test_solve_says_what_was_read(cddf_command, tmp_path):
    """No curve through the points of a stepped rod stays between them: it is read as straight lines."""
    (tmp_path / "body.csv").write_text(STEPPED)
    robot = 'cross_sections = "body.csv"\nyoungs_modulus = "2 GPa"\nfriction_coefficient = 0.2\n'
    (tmp_path / "robot.toml").write_text(robot + "offsets_outside_wall = true\n")
    code, out, err = cddf_command("solve", tmp_path / "robot.toml", "-t", "20 N")
    assert (code, "78.415 deg" in out) == (0, True)
    outer = "outer_radius: 2 mm at the base, 1.6 mm at s = 200 mm (Polyline, from 1.6 mm to 2 mm)"
    assert f"note: cross-sections: {outer}; inner_radius: 0 mm; offset_1: 6 mm" in err.splitlines()


def test_scattered_points_are_refused_with_the_remedy():
    s = np.linspace(0.0, LENGTH, 1500)
    with pytest.raises(cddf.InputError, match=r"^neither .* 1000 straight lines .* give a greater tolerance"):
        taken(s, 0.02 + 1e-4 * np.cos(37.0 * np.arange(len(s))), 1e-6)


def test_a_table_that_was_written_gives_the_body_back(read):
    tendons = [cddf.Tendon(cddf.Linear(0.01, 0.009, LENGTH), -1), cddf.Tendon(0.01, +1, end=0.1)]
    spline = cddf.Spline([0.0, 0.05, 0.09, LENGTH], [0.02, 0.018, 0.0145, 0.013])
    robot = cddf.Manipulator(LENGTH, spline, 0.007, tendons, 1.4e6, 0.42)
    sections = read(cross_sections_csv(robot))
    again = cddf.Manipulator(**sections.body, youngs_modulus=1.4e6, friction_coefficient=0.42)
    assert [tendon.side for tendon in again.tendons] == [-1, +1]
    assert again.tendons[0].end is None
    assert again.tendons[1].end == pytest.approx(0.1, rel=0, abs=1e-12)
    for mine, its in ((robot.outer_radius, again.outer_radius), (robot.inner_radius, again.inner_radius)):
        np.testing.assert_allclose(its(S), mine(S), rtol=0, atol=1e-6)
    np.testing.assert_allclose(again.tendons[0].offset(S), tendons[0].offset(S), rtol=0, atol=1e-9)


def test_a_step_that_was_written_is_read_where_it_is(read):
    outer = cddf.Piecewise([0.0503], [cddf.Linear(0.02, 0.018, LENGTH), 0.015])
    sections = read(cross_sections_csv(cddf.Manipulator(LENGTH, outer, 0.007, (cddf.Tendon(0.01),), 1.4e6, 0.42)))
    np.testing.assert_allclose(sections.outer_radius.ends, [0.0503], rtol=1e-9)
    np.testing.assert_allclose(sections.outer_radius(S), outer(S), rtol=0, atol=1e-9)
    assert type(sections.inner_radius) is cddf.Constant


def test_a_tendon_of_a_table_has_more_numbers_in_the_manipulator_file(tmp_path):
    (tmp_path / "body.csv").write_text(cross_sections_csv(paper_body("exact")))
    robot = tmp_path / "robot.toml"
    robot.write_text(
        'cross_sections = { file = "body.csv", tolerance = "10 um" }\nyoungs_modulus = "1.4 MPa"\n'
        'friction_coefficient = 0.42\n[[tendons]]\nfriction_coefficient = 0.3\naxial_stiffness = "12 kN"\n'
    )
    read = cddf.read_manipulator(robot)
    (tendon,) = read.tendons
    assert float(read.length) == LENGTH
    assert (tendon.friction_coefficient, tendon.axial_stiffness) == (0.3, 12e3)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('length = "140 mm"\n', "length and cross_sections are both given; leave one"),
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
    ("rows", "message"),
    [
        ("", "add the cross-sections below it"),
        ("0, 20, 7, 10\n", "holds one cross-section"),
        ("1, 20, 7, 10\n140, 13, 7, 10\n", "row 2, column arc_length: the first must be 0"),
        ("0, 20, 7, 10\n140, 13, 7, 10\n70, 15, 7, 10\n", "row 4, column arc_length: must increase, got 70 mm"),
        ("0, 20, 7, 10\n0, 19, 7, 10\n140, 13, 7, 10\n", "row 3, column arc_length: 0 mm is repeated at an end"),
        ("0, 20, 7, 10\n" + 3 * "70, 15, 7, 10\n" + "140, 13, 7, 10\n", "row 5, .*: 70 mm is repeated three times"),
        ("0, 20, 7, 10\n70, 15, 7, 9\n70, 15, 7, 8\n140, 13, 7, \n", "row 4, column offset_1: the tendon ends in a"),
        ("0, 20, 7, 10\n140, nan, 7, 10\n", "row 3, column outer_radius: must be finite"),
        ("0, 20, , 10\n140, 13, 7, 10\n", "row 2, column inner_radius: the cell is empty"),
        ("0, 20, 7, \n140, 13, 7, 10\n", "row 2, column offset_1: cells are empty before the end"),
        ("0, 20, 7, 10\n140, 13, 7, -10\n", "row 3, column offset_1: the tendon changes sides"),
    ],
)
def test_bad_rows_are_refused(read, rows, message):
    with pytest.raises(cddf.InputError, match=rf"body.csv: .*{message}"):
        read(HEAD + rows)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROWS.replace("offset_1", "offset_2"), "without gaps, got offset_2"),
        (ROWS.replace(", offset_1 [mm]", "").replace(", 10", ""), "got none"),
        (ROWS.replace("inner_radius", "bore"), "unknown column 'bore'"),
        (ROWS.replace("offset_1", "outer_radius"), "both are the column outer_radius; remove one"),
        (ROWS.replace("outer_radius [mm]", "outer_radius"), "needs a unit of length"),
    ],
)
def test_bad_heads_are_refused(read, text, message):
    with pytest.raises(cddf.InputError, match=rf"body.csv: .*{message}"):
        read(text)


def test_a_tolerance_is_a_positive_length(read):
    with pytest.raises(cddf.InputError, match="tolerance must be a positive length"):
        read(ROWS, tolerance=0.0)
