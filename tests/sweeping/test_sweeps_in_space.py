"""Sweeps of bodies in space: symmetry, one solve at a time, labels, and what is refused."""

import numpy as np
import pytest
from bodies import paper_body, paper_with

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.sweeping.axes import dimensions_of
from cddf_jax.sweeping.export import write_csv
from cddf_jax.sweeping.one_solve import IN_SPACE
from cddf_jax.sweeping.sweep import Sweep

pytest.importorskip("xarray")
LENGTH, THIRD = 0.14, 2 * np.pi / 3
THREE = paper_with(*(cddf.Tendon(0.010, angle=i * THIRD) for i in range(3)))
TENSIONS = {f"base_tension_{i}": [0.0, 30.0] for i in (1, 2, 3)}


def sweep_of(body, axes, **others):
    return Sweep(manipulator=body, dimensions=dimensions_of(axes), **others)


@pytest.mark.slow
def test_every_output_of_three_tendons(tmp_path):
    outputs = [name for name in IN_SPACE if name != "base_tension"]
    work = sweep_of(THREE, TENSIONS, outputs=tuple(outputs), nodes=6)
    grid = work.run()
    assert grid.successful.all()
    assert grid.tip_position.dims == (*TENSIONS, "component")
    assert grid.tip_frame.dims == (*TENSIONS, "component", "axis")
    assert list(grid.component.values) == ["X", "Y", "Z"]
    # three tendons, each alone, bend the body into three planes that a turn about X takes into each other
    cosine, sine = np.cos(THIRD), np.sin(THIRD)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    tips = [grid.tip_position[place].values for place in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    np.testing.assert_allclose(tips[1], turn @ tips[0], atol=1e-13)
    np.testing.assert_allclose(tips[2], turn @ tips[1], atol=1e-13)
    # no tension, and three that are equal, leave it straight
    np.testing.assert_allclose(grid.tip_position[0, 0, 0], [LENGTH, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(grid.tip_position[1, 1, 1], [LENGTH, 0.0, 0.0], atol=1e-15)
    found = cddf.solve(THREE, [30.0, 30.0, 0.0], nodes=6)
    for name in outputs:
        there = grid[name][1, 1, 0]
        assert there.shape == np.shape(getattr(found, name))
        # positions and forces that are zero but for rounding, and the number of passes of a batch
        np.testing.assert_allclose(there, getattr(found, name), rtol=1e-9, atol=1e-10)
    write_csv(grid, tmp_path / "grid.csv")
    head = (tmp_path / "grid.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"tip_position.Z [m]", "tip_tension_3 [N]", "tip_frame.Z.x", "base_moment.Y [N m]"} <= set(head)
    assert not any(name.startswith(("frame", "curvature")) for name in head)


def test_components_that_the_plane_has_not():
    """They belong to loads in space; one in the plane has other names."""
    loads = cddf.Loads(tip_force=(0.0, 0.0, 0.0))
    work = sweep_of(paper_body("exact"), {"loads.tip_force.2": [0.0, 0.1]}, loads=loads, base_tension=10.0)
    assert work.case.in_space
    assert work.case.unit("loads.tip_moment.1") == "N m"
    for name, message in (
        ("loads.tip_force.2", "'loads.tip_force.2' is not a number of the body"),
        ("loads.points.0.force.1", "there is no such point load; give it first, by --point-load or Loads"),
    ):
        with pytest.raises(InputError, match=message):
            cddf.sweep(paper_body("exact"), {name: [0.0, 0.1]}, base_tension=10.0)


def test_what_is_refused():
    with pytest.raises(InputError, match=r"^sweep: .*'heading' is not an output in space; there are"):
        cddf.sweep(THREE, {"base_tension": [5.0]}, outputs=("heading",))
    with pytest.raises(InputError, match=r"^sweep: .*the published kinematics are those of the plane"):
        cddf.sweep(paper_body(), {"base_tension": [5.0]}, loads=cddf.Loads(tip_force=(0.0, 0.0, 1.0)))
