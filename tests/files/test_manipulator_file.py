"""Manipulators in TOML: the shipped one, exact round trips, and errors that name file, key, value and remedy."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from bodies import paper_body
from kinds import of_kind
from places import DATA
from refusals import refused

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.files.manipulator_file import read_manipulator, read_robot_file, write_manipulator

PAPER = DATA / "smooth_sil_940.toml"
TEXT = """
length = "140 mm"
outer_radius = { base = "20 mm", tip = "13 mm" }
inner_radius = "7 mm"
youngs_modulus = "1.4 MPa"
friction_coefficient = 0.42
[[tendons]]
offset = "10 mm"
"""


def read(tmp_path, text):
    path = tmp_path / "body.toml"
    path.write_text(text, encoding="utf-8")
    return read_manipulator(path)


def assert_identical(one, other):
    """The same structure and the same bits."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert (a.dtype, a.shape, np.asarray(a).tobytes()) == (b.dtype, b.shape, np.asarray(b).tobytes())


def assert_same_when_read_again(body, path, **options):
    write_manipulator(body, path, **options)
    assert_identical(read_manipulator(path), body)


# --- reading -------------------------------------------------------------------------------------


def test_the_papers_body():
    assert_identical(read_manipulator(PAPER), paper_body())


def test_optional_keys(tmp_path):
    text = TEXT.replace("[[tendons]]", 'name = "a"\ndensity = "1.07 g/cm^3"\n[[tendons]]')
    text += 'side = -1\nend = "10 cm"\nfriction_coefficient = "0.3"\n'
    body = read(tmp_path, text + 'axial_stiffness = "12 kN"\nfree_length = "30 cm"')
    tendon = body.tendons[0]
    assert (body.density, body.kinematics) == (1070.0, "exact")
    assert (tendon.side, tendon.end, tendon.friction_coefficient) == (-1, 0.1, 0.3)
    assert (tendon.axial_stiffness, tendon.free_length) == (12000.0, 0.3)
    plain = read(tmp_path, "\ufeff" + TEXT).tendons[0]
    assert (plain.side, plain.end, plain.friction_coefficient) == (1, None, None)
    assert (plain.axial_stiffness, plain.free_length) == (None, 0.0)


def test_friction_besides_that_of_curvature(tmp_path):
    text = TEXT.replace("[[tendons]]", 'friction_moment = "2 mN m"\ndrag = "0.8 N/m"\n[[tendons]]')
    own = 'outside_compliance = "0.02 mm/N"\noutside_friction = 0.3\noutside_drag = "0.5 N"\ndrag = "0.3 N/mm"\n'
    body = read(tmp_path, text + own)
    (tendon,) = body.tendons
    assert (body.friction_moment, tendon.outside_friction, tendon.outside_drag) == (2e-3, 0.3, 0.5)
    assert (body.drag, tendon.drag) == (0.8, 300.0)
    assert_same_when_read_again(body, tmp_path / "again.toml")
    with pytest.raises(InputError, match="outside_drag must be 0 or more"):
        read(tmp_path, text + own.replace("0.5 N", "-0.5 N"))


@pytest.mark.parametrize("written", ['"0.8 %"', "0.008", '"0.008"'])
def test_a_yield_strain_in_per_cent_or_as_a_fraction(tmp_path, written):
    body = read(tmp_path, TEXT.replace("[[tendons]]", f"yield_strain = {written}\n[[tendons]]"))
    assert body.yield_strain == 0.008
    assert_same_when_read_again(body, tmp_path / "again.toml")


@pytest.mark.parametrize(
    ("form", "profile"),
    [
        ('"18 mm"', cddf.Constant(0.018)),
        ('{ base = "2 cm", tip = "13 mm" }', cddf.Linear(0.02, 0.013, 0.14)),
        ('{ base = "2 cm", tip = "13 mm", length = "200 mm" }', cddf.Linear(0.02, 0.013, 0.2)),
        (
            '{ ends = ["40 mm"], pieces = ["20 mm", { base = "19 mm", tip = "13 mm" }] }',
            cddf.Piecewise([0.04], [cddf.Constant(0.02), cddf.Linear(0.019, 0.013, 0.14)]),
        ),
        (
            '{ lines = [["0 mm", "20 mm"], ["60 mm", "15 mm"], ["14 cm", "14 mm"]] }',
            cddf.Piecewise.linear([0, 0.06, 0.14], [0.02, 0.015, 0.014]),
        ),
        (
            '{ spline = [["0 mm", "20 mm"], ["60 mm", "18 mm"], ["100 mm", "16 mm"], ["140 mm", "15 mm"]] }',
            cddf.Spline([0, 0.06, 0.1, 0.14], [0.02, 0.018, 0.016, 0.015]),
        ),
    ],
)
def test_forms_of_a_profile(tmp_path, form, profile):
    body = read(tmp_path, TEXT.replace('{ base = "20 mm", tip = "13 mm" }', form))
    assert_identical(body.outer_radius, profile)
    assert_same_when_read_again(body, tmp_path / "again.toml")


CASES = [
    ("length =", "lenght =", "unknown key 'lenght'; did you mean length?"),
    ('length = "140 mm"\n', "", "length is missing; add it"),
    ('offset = "10 mm"', "side = 1", "tendon 1: offset is missing; add it"),
    ('"140 mm"', "140", "length needs a unit of length, got 140; write for example '12.5 mm'"),
    (', tip = "13 mm"', "", "outer_radius is not a profile, got {'base': '20 mm'}; write \"7 mm\", { base, tip },"),
    ('"7 mm"', "true", "inner_radius is not a number, got True"),
    ('"7 mm"', '{ spline = [["0 mm", "7 mm"]] }', "inner_radius: Spline: arc_length and values must be two lists"),
    ('"7 mm"', '{ ends = [], pieces = ["7 mm", "6 mm"] }', "inner_radius: Piecewise: 2 pieces need 1 ends"),
    ('"7 mm"', '{ ends = [], pieces = [{}] }', "inner_radius: piece 1 is not a profile, got {}"),
    ('"7 mm"', '{ lines = ["7 mm"] }', "inner_radius: lines holds pairs [arc length, value], got '7 mm'; write"),
    ('"7 mm"', '{ lines = [["5 mm", "7 mm"], ["0 mm", "7 mm"]] }', "inner_radius: Piecewise.linear: arc_length must"),
    ("[[tendons]]", "[tendons]", "tendons must be one table per tendon; write each below a line [[tendons]]"),
    ("offset =", "side = 2\noffset =", "tendon 1: Tendon: side must be +1 or -1, got 2"),
    ("offset =", "end = 0.1\noffset =", "tendon 1: end needs a unit of length, got 0.1"),
    ("offset =", "free_lenght = 1\noffset =", "tendon 1: unknown key 'free_lenght'; did you mean free_length?"),
    ('"10 mm"', '"5 mm"', "tendon 1: offset must lie inside the wall: at s = 0 mm it is 5 mm"),
    ("length =", 'kinematics = "best"\nlength =', "kinematics must be one of ('published', 'exact'), got 'best'"),
    ("length =", 'offsets_outside_wall = "yes"\nlength =', "offsets_outside_wall must be true or false, got 'yes'"),
    ("length =", 'gravity = ["9.81 m/s^2"]\nlength =', "gravity holds two components X, Y, or three in space, got ["),
    ("length =", 'gravity = "0, -9.81 m/s^2"\nlength =', "-9.81 m/s^2'; write [\"0 m/s^2\", \"-9.81 m/s^2\"], or"),
    ("length =", 'gravity = ["0 m/s^2", "-9.81 m"]\nlength =', "gravity Y needs a unit of acceleration, got '-9.81 m'"),
    ('"140 mm"', "140 mm", "(at line 2, column 14); quantities are quoted, as in length = \"140 mm\""),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), CASES)
def test_bad_files_are_refused(tmp_path, old, new, message):
    assert old in TEXT
    said = refused(read, tmp_path, TEXT.replace(old, new, 1))
    assert message in said
    assert said.startswith(f"{tmp_path / 'body.toml'}: {'is not TOML: ' if new == '140 mm' else ''}")


@pytest.mark.parametrize(
    ("written", "gravity"),
    [
        ('["0 m/s^2", "-981 cm/s^2"]', (0.0, -9.81)),
        ('["9.81 m/s^2", "0 m/s^2", "0.5 m/s^2"]', (9.81, 0.0, 0.5)),
        ('["0 m/s^2", "0 m/s^2"]', (0.0, 0.0)),
    ],
)
def test_gravity_is_read_beside_the_manipulator(tmp_path, written, gravity):
    path = tmp_path / "body.toml"
    path.write_text(f"gravity = {written}\n{TEXT}")
    read = read_robot_file(path)
    assert read.gravity == gravity
    with pytest.warns(
        UserWarning, match=r"body.toml: its gravity is no part of a Manipulator; .* read_robot_file"
    ) as said:
        assert_identical(read_manipulator(path), read.manipulator)
    assert said[0].filename == __file__
    write_manipulator(read.manipulator, path, gravity=gravity)
    assert read_robot_file(path).gravity == gravity
    path.write_text(TEXT)
    assert read_robot_file(path).gravity is None
    assert_identical(read_manipulator(path), read.manipulator)


@pytest.mark.parametrize("gravity", [(9.81,), (0.0, np.nan)])
def test_a_gravity_that_could_not_be_read_is_not_written(tmp_path, gravity):
    with pytest.raises(InputError, match=r"^gravity "):
        write_manipulator(paper_body(), tmp_path / "body.toml", gravity=gravity)
    assert not list(tmp_path.iterdir())


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"none.toml: cannot be read \(No such file or directory\); check the path"):
        read_manipulator(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(TEXT.encode() + b"# \xe9")
    with pytest.raises(InputError, match=r"latin.toml: is not UTF-8 text; save it as UTF-8"):
        read_manipulator(tmp_path / "latin.toml")


SPACE = (
    TEXT.partition("[[tendons]]")[0]
    + """
poissons_ratio = 0.45
extensible = true
axial_factor = 0.8
shear_factor = 1.2
rest_curvature = ["0 1/m", { base = "2 1/m", tip = "1 1/m" }, "0.5 1/m"]
torsional_stiffness = "0.02 N m^2"
axial_stiffness = "1 kN"
[[tendons]]
offset = "12 mm"
angle = "120 deg"
[[tendons]]
offset = "10 mm"
angle = { base = "0 deg", tip = "0.5 turn" }
axial_stiffness = "12 kN"
"""
)


@pytest.mark.parametrize("ratio", [0.45, 0.8])  # of a material, and an effective one, as a fit may find it
def test_a_body_in_space(tmp_path, ratio):
    body = read(tmp_path, SPACE.replace("0.45", str(ratio)))
    assert of_kind(cddf.Constant, body.tendons[0].angle).value == pytest.approx(2 * np.pi / 3, rel=1e-15)
    assert_identical(body.tendons[1].angle, cddf.Linear(0.0, np.pi, 0.14))
    rest = (cddf.Constant(0.0), cddf.Linear(2.0, 1.0, 0.14), cddf.Constant(0.5))
    assert_identical(body.rest_curvature, rest)
    assert (body.extensible, float(body.poissons_ratio)) == (True, ratio)
    assert (body.axial_factor, body.shear_factor) == (0.8, 1.2)
    assert_identical((body.torsional_stiffness, body.axial_stiffness), (cddf.Constant(0.02), cddf.Constant(1000.0)))
    assert (body.tendons[1].axial_stiffness, body.shear_stiffness) == (12000.0, None)
    assert_same_when_read_again(body, tmp_path / "again.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"120 deg"', "120", "tendon 1: angle needs a unit of angle, got 120; write for example '12.5 deg'"),
        ("angle = {", "side = -1\nangle = {", "tendon 2: Tendon: side=-1 is the angle pi; give the angle alone"),
        ("= true", '= "yes"', "extensible must be true or false, got 'yes'"),
        ('"0.5 1/m"', "2", "rest_curvature: about z needs a unit of curvature, got 2; write for example '12.5 1/m'"),
        (', "0.5 1/m"]', "]", "rest_curvature holds three profiles, got"),
        ('"0.02 N m^2"', "0.02", "torsional_stiffness needs a unit of torsional stiffness, got 0.02"),
        ("extensible = true", 'kinematics = "published"', "the published kinematics are those of the plane"),
    ],
)
def test_bad_files_of_bodies_in_space(tmp_path, old, new, message):
    assert old in SPACE
    said = refused(read, tmp_path, SPACE.replace(old, new, 1))
    assert message in said
    assert "body.toml: " in said


# --- round trips ---------------------------------------------------------------------------------


def test_what_is_written_is_for_people(tmp_path):
    write_manipulator(read_manipulator(PAPER), tmp_path / "body.toml")
    lines = (tmp_path / "body.toml").read_text().splitlines()
    assert {'length = "140 mm"', 'youngs_modulus = "1.4 MPa"', 'base = "20 mm"', 'tip = "13 mm"'} <= set(lines)
    assert not any("free_length" in line or "axial_stiffness" in line for line in lines)  # it does not stretch


def test_offsets_outside_the_wall_are_said_in_the_file(tmp_path):
    body = replace(read_manipulator(PAPER), tendons=(cddf.Tendon(0.005),))
    with pytest.raises(InputError, match="allow it with offsets_outside_wall"):
        write_manipulator(body, tmp_path / "body.toml")
    assert_same_when_read_again(body, tmp_path / "body.toml", offsets_outside_wall=True)


class Bulge(eqx.Module):
    """A profile that the file does not know."""

    def __call__(self, arc_length):
        return 0.02 - arc_length**2 / 10


def test_profiles_of_another_kind_are_refused(tmp_path):
    body = replace(read_manipulator(PAPER), outer_radius=Bulge())
    with pytest.raises(InputError, match=r"outer_radius: a profile of type Bulge cannot be written .*; sample it into"):
        write_manipulator(body, tmp_path / "body.toml")
