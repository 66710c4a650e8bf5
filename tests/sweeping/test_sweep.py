"""Sweeps: against the closed form and against single solves; errors of an axis name the axis."""

import re
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_plain
from kinds import of_kind
from loaded_bodies import PlainLoads, loaded_reference
from refusals import refused

import cddf_jax as cddf
from cddf_jax.sweeping.axes import dimensions_of
from cddf_jax.sweeping.one_solve import OUTPUTS
from cddf_jax.sweeping.sweep import Sweep

TENSIONS, FRICTION = np.linspace(5.0, 85.0, 5), np.linspace(0.1, 0.6, 4)
SAME = 1e-12  # another batch, another order of the same operations
COMPLIANCE = paper_plain().compliance(0.14)  # G(L) of T_tip = T / (1 + mu G T / E), docs/theory.md (16)
xarray = pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def grid():
    """A product of two axes with every scalar of one tendon, and derivatives by a swept number and another."""
    return cddf.sweep(
        paper_body(),
        {"base_tension": TENSIONS, "friction_coefficient": FRICTION},
        outputs=("tip_tension", "tip_position", "tip_angle", "tension_loss", "stable", "num_iterations", "curvature"),
        sensitivities=("friction_coefficient", "youngs_modulus"),
    )


def test_tip_tensions_are_those_of_the_closed_form(grid):
    x = TENSIONS[:, None] * FRICTION * COMPLIANCE / 1.4e6
    np.testing.assert_allclose(grid.tip_tension[..., 0], TENSIONS[:, None] / (1 + x), rtol=1e-11)
    # its derivatives, by hand
    slope = -TENSIONS[:, None] * x / (1 + x) ** 2
    np.testing.assert_allclose(grid.tip_tension_by_friction_coefficient[..., 0], slope / FRICTION, rtol=1e-10)
    np.testing.assert_allclose(grid.tip_tension_by_youngs_modulus[..., 0], -slope / 1.4e6, rtol=1e-10)


def test_it_is_labelled(grid):
    assert dict(grid.sizes) == {
        "base_tension": 5,
        "friction_coefficient": 4,
        "tendon": 1,
        "component": 2,
        "point": 18,
    }
    assert list(grid.component.values) == ["X", "Y"]
    np.testing.assert_array_equal(grid.base_tension, TENSIONS)
    assert grid.tip_position.dims == ("base_tension", "friction_coefficient", "component")
    units = {name: grid[name].attrs.get("units") for name in grid.variables}
    assert units["base_tension"] == units["tip_tension"] == "N"
    assert units["friction_coefficient"] == units["tension_loss"] == "1"
    assert units["tip_position"] == "m"
    assert units["tip_tension_by_friction_coefficient"] == "N"
    assert units["tip_position_by_youngs_modulus"] == "m/Pa"
    assert units["curvature_by_youngs_modulus"] == "1/m/Pa"


def test_all_is_well_and_said_to_be(grid):
    assert grid.successful.all()
    assert grid.stable.dtype == bool
    assert grid.stable.all()
    assert "stable_by_youngs_modulus" not in grid


def test_every_output_is_an_attribute_of_an_equilibrium():
    found, names = cddf.solve(paper_body(), 40.0), [name for name in OUTPUTS if name != "base_tension"]
    answer = cddf.sweep(paper_body(), {"base_tension": [40.0]}, outputs=names)
    for name in names:
        assert answer[name].shape[1:] == np.shape(getattr(found, name))
        np.testing.assert_allclose(answer[name][0], getattr(found, name), rtol=1e-10, atol=1e-12)


def one_by_one(answer, solve):
    """`solve(**coordinates)` for every solve of an answer whose numbers vary along `sample`."""
    names = [name for name, coord in answer.coords.items() if coord.dims == ("sample",)]
    for i in range(answer.sizes["sample"]):
        found = solve(*(float(answer[name][i]) for name in names))
        np.testing.assert_allclose(answer.tip_tension[i], found.tip_tension, rtol=1e-9)
        np.testing.assert_allclose(answer.tip_position[i], found.tip_position, rtol=1e-9, atol=1e-10)


def test_numbers_that_vary_together():
    ranges = {"base_tension": (5.0, 85.0), "outer_radius.tip": (0.0125, 0.0150), "tendons.0.offset": (0.008, 0.011)}
    answer = cddf.sweep(paper_body("exact"), {"sample": cddf.latin_hypercube(ranges, 6)})

    def solve(tension, tip, offset):
        return cddf.solve(paper_body("exact", outer_radius=(0.020, tip), tendon_offset=offset), tension)

    assert answer["outer_radius.tip"].attrs["units"] == "m"
    assert answer.tip_tension.dims == ("sample", "tendon")
    one_by_one(answer, solve)


# --- loops ---------------------------------------------------------------------------------------

PATH = [0.0, 75.0, 40.0, 60.0, 75.0]


def test_tensions_with_a_history(tmp_path):
    """Each loop is that of the play in 1/T, clip(1/T, 1/T_base - g, 1/T_base + g), g = mu G / E; and all is resumed."""
    axes = {"friction_coefficient": FRICTION, "base_tension": PATH}
    options = {"outputs": ("tip_tension",), "history": True}
    answer = cddf.sweep(paper_body(), axes, **options, out=tmp_path / "loops.zarr", chunk=10)
    assert answer.tip_tension.dims == ("friction_coefficient", "base_tension", "tendon")
    assert answer.tip_tension.encoding["chunks"] == (2, 5, 1)  # a path is not cut
    assert answer.successful.all()
    g, inverse = FRICTION * COMPLIANCE / 1.4e6, np.full(4, 1e300)
    for step, tension in enumerate(PATH):
        inverse = np.clip(inverse, 1 / max(tension, 1e-300) - g, 1 / max(tension, 1e-300) + g)
        np.testing.assert_allclose(answer.tip_tension[:, step, 0], 1 / inverse, rtol=1e-11, atol=1e-200)
    again = cddf.sweep(paper_body(), axes, **options, out=tmp_path / "loops.zarr", chunk=10)
    assert again.identical(answer)
    with pytest.raises(cddf.InputError, match="holds other work: its history is true, not false"):
        cddf.sweep(paper_body(), axes, **{**options, "history": False}, out=tmp_path / "loops.zarr", chunk=10)


@pytest.mark.slow
def test_derivatives_and_fields_of_loops():
    """From 75 N back to 40 N the tip tension stays at 75 / (1 + 75 g), g = mu G / E, where mu is large."""
    axes, names = {"friction_coefficient": FRICTION, "base_tension": PATH}, ("tip_tension", "curvature")
    answer = cddf.sweep(paper_body(), axes, history=True, outputs=names, sensitivities=("friction_coefficient",))
    assert answer.curvature.dims == ("friction_coefficient", "base_tension", "point")
    g = FRICTION * COMPLIANCE / 1.4e6
    slope = -(75.0**2) * g / FRICTION / (1 + 75 * g) ** 2
    there = answer.tip_tension_by_friction_coefficient[:, 2, 0]
    np.testing.assert_allclose(there[2:], slope[2:], rtol=1e-10)


PAIR = paper_body("exact", num_tendons=2)
PULL, AGAINST = [30.0, 60.0, 45.0], [5.0, 10.0, 10.0]


@pytest.mark.slow
def test_loops_of_several_tendons_and_under_loads_are_traces():
    """One by one; a tension that is not on the path stays, or is an axis of its own."""
    names = "tip_angle", "tip_tension", "front", "work", "curvature", "error_estimate"
    few: dict[str, Any] = {"short_steps": 4, "nodes": 6}
    axes = {"path": {"base_tension_1": PULL, "base_tension_2": AGAINST}, "friction_coefficient": [0.2, 0.42]}
    answer = cddf.sweep(PAIR, axes, history=True, outputs=names, **few)
    assert answer.tip_tension.dims == ("path", "friction_coefficient", "tendon")
    assert answer.attrs["path"] == "path"
    assert answer.successful.all()
    for i, mu in enumerate([0.2, 0.42]):
        body = eqx.tree_at(lambda b: b.friction_coefficient, PAIR, np.asarray(mu))
        history = cddf.trace(body, np.stack([PULL, AGAINST], axis=1), **few)
        for name in names:
            of = {"curvature": history.equilibria, "work": history.energies}.get(name, history)
            expected = getattr(of, name)
            np.testing.assert_allclose(answer[name][:, i], expected, rtol=1e-7, atol=1e-9, err_msg=name)
    across = {"base_tension_1": PULL, "base_tension_2": [10.0, 20.0]}
    slopes = cddf.sweep(PAIR, across, history="base_tension_1", sensitivities=("friction_coefficient",), **few)

    def angles(mu):
        body = eqx.tree_at(lambda b: b.friction_coefficient, PAIR, np.asarray(mu))
        return np.asarray(cddf.trace(body, [[pull, 20.0] for pull in PULL], throw=False, **few).tip_angle)

    mu, step = float(PAIR.friction_coefficient), 1e-4
    differences = (angles(mu + step) - angles(mu - step)) / (2 * step)
    # slips have rounding errors
    np.testing.assert_allclose(slopes.tip_angle_by_friction_coefficient[:, 1], differences, rtol=1e-4)
    np.testing.assert_allclose(slopes.tip_angle[:, 1], angles(mu), rtol=1e-7)
    pushed = {"path": {"base_tension": PULL, "loads.tip_force.1": [0.0, -0.1, -0.2]}}
    changing = cddf.sweep(paper_body("exact"), pushed, history=True, **few)
    loads = [cddf.Loads(tip_force=(0.0, force)) for force in (0.0, -0.1, -0.2)]
    np.testing.assert_allclose(
        changing.tip_angle, cddf.trace(paper_body("exact"), PULL, loads, **few).tip_angle, rtol=1e-7
    )


@pytest.mark.slow
def test_loads_that_are_not_on_a_path_act_before_its_first_step():
    """Before it nothing rubs inside the body: it bends by the moment times L / (E J). Later its friction would hold."""
    stiffness, moment = 1.4e6 * np.pi / 4 * (0.01**4 - 0.004**4), 0.006
    tube = cddf.Manipulator(
        length=0.14,
        outer_radius=0.01,
        inner_radius=0.004,
        youngs_modulus=1.4e6,
        friction_coefficient=0.0,
        friction_moment=0.01,  # larger than the moment
        tendons=[cddf.Tendon(0.007)],
    )
    loads = cddf.Loads(tip_moment=moment, points=[cddf.PointLoad(0.05)])
    zero = [0.0, 0.0]
    for name in ("loads.tip_force.1", "loads.points.0.force.1"):
        over = {"path": {"base_tension": zero, name: zero}}
        found = cddf.sweep(tube, over, loads=loads, history=True, outputs=("tip_angle",), nodes=4, short_steps=2)
        np.testing.assert_allclose(found.tip_angle, moment * 0.14 / stiffness, rtol=1e-9)


ONE = paper_body()


@pytest.mark.parametrize(
    ("body", "axes", "options", "message"),
    [
        (ONE, {"friction_coefficient": [0.4]}, {"base_tension": 5.0}, 'history needs the axis "base_tension"'),
        (ONE, {"base_tension": PATH}, {"direction": 1}, "with history there is no direction; leave it out"),
        (ONE, {"base_tension": PATH}, {"sensitivities": ("base_tension",)}, "with history there is no base_tension"),
        (ONE, {"base_tension": PATH}, {"outputs": ("stable",)}, "'stable' is not an output of a history; there are"),
        (PAIR, {"base_tension": PULL}, {"short_steps": 1}, "short_steps must be a whole number of 2 or more, got 1"),
        (PAIR, {"base_tension": PULL}, {"outputs": ("num_turns",)}, "'num_turns' is not an output of a history"),
        (
            PAIR,
            {"base_tension_1": PULL},
            {"base_tension": (10.0, cddf.TipAngle(1.0))},
            "with history base_tension must hold tensions, N, in place of targets",
        ),
    ],
)
def test_what_has_no_history(body, axes, options, message):
    with pytest.raises(cddf.InputError, match=message):
        cddf.sweep(body, axes, **{"history": True, **options})


@pytest.mark.slow
def test_tendons_loads_and_directions():
    """By SciPy; one tendon is pulled in, the other slides out."""
    body, direction = paper_body(num_tendons=2), (1, -1)
    rng = np.random.default_rng(0)
    pulls = {"base_tension_1": rng.uniform(20, 60, 4), "base_tension_2": rng.uniform(0, 15, 4)}
    answer = cddf.sweep(body, {"sample": pulls | {"loads.tip_force.1": rng.uniform(-2, 2, 4)}}, direction=direction)

    def solve(*numbers):
        *tensions, force = numbers
        plain = paper_plain(body.kinematics, (+1, -1))
        return loaded_reference(plain, tensions, PlainLoads((0.0, force)), direction=direction)

    assert answer["loads.tip_force.1"].attrs["units"] == "N"
    one_by_one(answer, solve)


def test_one_tension_for_all_tendons_one_of_several_and_a_load():
    """The numbers of a solve, by the names of what varies; test_tendons_loads_and_directions solves such cases."""
    body = paper_body(num_tendons=2)
    both = Sweep(manipulator=body, dimensions=dimensions_of({"base_tension": [30.0]})).case
    assert both.with_numbers({"base_tension": 30.0}).base_tension == 30.0
    one_way = Sweep(
        manipulator=body, dimensions=dimensions_of({"direction_2": [-1]}), base_tension=30.0, direction=1
    ).case
    assert one_way.direction.tolist() == [1, 1]  # one for all is one for each where a tendon has its own axis
    over = {"base_tension_2": [20.0], "loads.tip_force.1": [-2.0]}
    one = Sweep(manipulator=body, dimensions=dimensions_of(over), base_tension=30.0).case
    there = one.with_numbers({"base_tension_2": 20.0, "loads.tip_force.1": -2.0})
    np.testing.assert_array_equal(there.base_tension, [30.0, 20.0])
    np.testing.assert_array_equal(of_kind(cddf.Loads, there.loads).tip_force, [0.0, -2.0])
    assert [one.unit(name) for name in over] == ["N", "N"]


@pytest.mark.slow
def test_a_target_is_swept_by_its_value():
    angles = np.deg2rad([20.0, 40.0])
    axes, outputs = {"base_tension.value": angles}, ("tip_angle", "base_tension")
    answer = cddf.sweep(paper_body(), axes, cddf.TipAngle(0.0), outputs=outputs)
    assert answer["base_tension.value"].attrs["units"] == "rad"
    np.testing.assert_allclose(answer.tip_angle, angles, rtol=1e-9)
    expected = [float(cddf.solve(paper_body(), cddf.TipAngle(angle)).base_tension[0]) for angle in angles]
    np.testing.assert_allclose(answer.base_tension[:, 0], expected, rtol=1e-8)


def test_both_kinematics_beside_each_other():
    """The tip tensions by their laws in both kinematics (docs/theory.md); the nodes are those of the sweep."""
    outputs = ("tip_tension", "tip_angle")
    both = [
        cddf.sweep(paper_body(kinematics), {"base_tension": [40.0, 75.0]}, outputs=outputs, nodes=8)
        for kinematics in ("published", "exact")
    ]
    answer = xarray.concat(both, xarray.DataArray(["published", "exact"], dims="kinematics", name="kinematics"))
    tension = answer.base_tension.values
    published, exact = answer.tip_tension[..., 0].values
    expected = tension / (1 + tension * 0.42 * COMPLIANCE / 1.4e6)
    np.testing.assert_allclose(published, expected, rtol=1e-10)
    np.testing.assert_allclose(exact, tension * np.exp(-0.42 * answer.tip_angle[1]), rtol=1e-10)  # the capstan law


def test_failed_and_doubtful_solves_are_masked_and_harm_no_neighbour():
    options: dict[str, Any] = {"outputs": ["tip_tension"], "sensitivities": ["youngs_modulus"]}
    answer = cddf.sweep(paper_body("exact"), {"base_tension": [40.0, -1.0, 4000.0, 75.0]}, **options)
    kinds = [cddf.Status(code).name for code in answer.result.values]
    assert kinds == ["successful", "unphysical", "crossing", "successful"]
    assert answer.successful.values.tolist() == [True, False, False, True]
    assert answer.result.attrs["flag_meanings"].split() == [status.name for status in cddf.Status]
    assert np.isnan(answer.tip_tension[1, 0])
    alone = cddf.sweep(paper_body("exact"), {"base_tension": [40.0, 50.0, 60.0, 75.0]}, **options)  # the same program
    for name in ("tip_tension", "tip_tension_by_youngs_modulus"):
        np.testing.assert_allclose(answer[name][[0, 3]], alone[name][[0, 3]], rtol=SAME)


@pytest.mark.slow
def test_sensitivities_are_those_of_reverse_mode():
    body = eqx.tree_at(
        lambda m: m.tendons[0].friction_coefficient, paper_body("exact"), 0.3, is_leaf=lambda x: x is None
    )
    names = ("outer_radius.tip", "youngs_modulus", "tendons.0.friction_coefficient", "base_tension")
    moduli = [1.2e6, 1.6e6]
    answer = cddf.sweep(body, {"youngs_modulus": moduli}, 50.0, outputs=["tip_angle"], sensitivities=names)

    @jax.jit
    def slopes(modulus):
        def angle(body, tension):
            return cddf.solve(body, tension, throw=False).tip_angle

        there = eqx.tree_at(lambda m: m.youngs_modulus, body, modulus)
        by_body, by_tension = jax.grad(angle, (0, 1))(there, 50.0)
        tendon = by_body.tendons[0].friction_coefficient
        return by_body.outer_radius.tip, by_body.youngs_modulus, tendon, by_tension

    for i, modulus in enumerate(moduli):
        found = [float(answer[f"tip_angle_by_{name}"][i]) for name in names]
        np.testing.assert_allclose(found, slopes(modulus), rtol=1e-9)
    assert answer["tip_angle_by_outer_radius.tip"].attrs["units"] == "rad/m"


def test_single_precision():
    with jax.enable_x64(False):
        single = cddf.sweep(paper_body(), {"base_tension": TENSIONS}, outputs=["tip_tension"])
    assert single.tip_tension.dtype == np.float32
    assert single.attrs["precision"] == "float32"
    double = TENSIONS / (1 + TENSIONS * 0.42 * COMPLIANCE / 1.4e6)
    np.testing.assert_allclose(single.tip_tension[:, 0], double, rtol=1e-5)
    assert np.max(np.abs(single.tip_tension[:, 0] - double)) > 0


def test_short_steps_in_single_precision_are_refused():
    with jax.enable_x64(False), pytest.raises(cddf.InputError, match="several tendons or loads need 64-bit numbers"):
        cddf.sweep(PAIR, {"base_tension": PULL}, history=True)


OWN_FRICTION = replace(paper_body(), tendons=(replace(paper_body().tendons[0], friction_coefficient=0.3),))
HUNG = {"base_tension": 1.0, "loads": cddf.Loads(points=[cddf.PointLoad(0.06, (0.0, -0.1))])}
BAD = {
    "no manipulator": ({"base_tension": [1.0]}, {"manipulator": "robot.toml"}, "manipulator must be a Manipulator"),
    "no loads": ({"base_tension": [1.0]}, {"loads": (0.0, -5.0)}, "loads must be Loads"),
    "one name": ({"base_tension": [1.0]}, {"outputs": "tip_angle"}, "outputs must be a tuple of names"),
    "overruled": (
        {"friction_coefficient": [0.1]},
        {"base_tension": 1.0, "manipulator": OWN_FRICTION},
        "'friction_coefficient' has no effect here; let 'tendons.0.friction_coefficient' vary",
    ),
    "no gravity": ({"density": [1e3]}, {"base_tension": 1.0}, "'density' has no effect here; give loads="),
    "a load that moves along a path": (
        {"path": {"base_tension": [1.0, 2.0], "loads.points.0.arc_length": [0.04, 0.1]}},
        {"loads": HUNG["loads"], "history": True},
        "only base tensions and loads vary along a path, not loads.points.0.arc_length; give it an axis",
    ),
    "no axes": ({}, {}, "axes must be a dictionary"),
    "unknown": ({"youngs_modulos": [1.0]}, {"base_tension": 1.0}, "did you mean 'youngs_modulus'"),
    "tendons count from 1": ({"base_tension.1": [1.0]}, {"base_tension": 1.0}, "from 1; write 'base_tension_2'"),
    "one tension of two": ({"base_tension_1": [1.0]}, {"manipulator": PAIR}, "'base_tension_2' is neither given nor"),
    "no number": ({"outer_radius": [1.0]}, {"base_tension": 1.0}, r"not one number.*outer_radius.tip"),
    "words": ({"base_tension": ["much"]}, {}, "the axis 'base_tension': text cannot be used, got 'much'"),
    "empty": ({"base_tension": []}, {}, "one number or more"),
    "not finite": ({"base_tension": [1.0, np.nan]}, {}, "holds nan at place 1"),
    "lengths": ({"s": {"base_tension": [1.0], "youngs_modulus": [1e6, 2e6]}}, {}, "base_tension 1, youngs_modulus 2"),
    "nothing along it": ({"s": {}}, {}, "nothing varies along the axis 's'"),
    "twice": ({"base_tension": [1.0], "s": {"base_tension": [1.0]}}, {}, "varies along two axes"),
    "inside another": ({"base_tension": [1.0], "base_tension_1": [1.0]}, {}, "only one of them"),
    "reserved": ({"tendon": [1.0]}, {}, "rename it"),
    "no tension": ({"youngs_modulus": [1e6]}, {}, "neither given nor an axis"),
    "nodes": ({"base_tension": [1.0]}, {"nodes": 2}, "nodes must be a whole number of 4 or more, got 2"),
    "no solve in a chunk": ({"base_tension": [1.0]}, {"chunk": 0}, "chunk must be a whole number of 1 or more, got 0"),
    "half a solve": ({"base_tension": [1.0]}, {"chunk": 1.5}, "chunk must be a whole number of 1 or more, got 1.5"),
    "nodes as an axis": ({"nodes": [8, 16]}, {"base_tension": 1.0}, "'nodes' is not a number of the body"),
    "kinematics": ({"kinematics": ["exact"]}, {"base_tension": 1.0}, "the axis 'kinematics': text cannot be used"),
    "axis and output": ({"base_tension": [1.0]}, {"outputs": ["base_tension"]}, "an axis and an output"),
    "sensitivity": ({"base_tension": [1.0]}, {"sensitivities": ["nodes"]}, "'nodes' is not a number of the body"),
    "absent": ({"base_tension": [1.0]}, {"sensitivities": ["drag"]}, "has no 'drag' to differentiate by"),
    "overlap": ({"base_tension": [1.0]}, {"sensitivities": ["base_tension_1"]}, "overlap"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    axes, options, message = BAD[case]
    assert re.search(message, refused(cddf.sweep, axes=axes, **({"manipulator": paper_body()} | options)))


@pytest.mark.slow
def test_a_load_beside_the_body_is_not_physical():
    axes = {"loads.points.0.arc_length": [0.1, 0.15]}
    answer = cddf.sweep(paper_body("exact"), axes, outputs=["tip_angle"], **HUNG)
    assert answer.result.values.tolist() == [cddf.Status.successful, cddf.Status.unphysical]
    assert np.isnan(answer.tip_angle[1])


def test_bodies_that_differ_in_a_plain_function_are_not_the_same_work():
    """A store of one is refused by the sweep of the other; written anew, the same function is the same."""

    def told(radius):
        body = cddf.Manipulator(0.14, radius, 0.007, (cddf.Tendon(0.010),), 1.4e6, 0.42)
        return Sweep(manipulator=body, dimensions=dimensions_of({"base_tension": [1.0]})).identity

    def step(place):
        return lambda s: jnp.where(s < place, 0.02, 0.018)

    assert told(step(0.0501)) == told(step(0.0501))
    assert told(step(0.0501)) != told(step(0.0502))
