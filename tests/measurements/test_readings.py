"""Every kind of data that a fit explains: its unit in a file, its prediction and derivatives; and a fit finds it."""

import numpy as np
import pytest
from bodies import paper_body
from kinds import bench_of

import cddf_jax as cddf
from cddf_jax.measurements.readings import NAMED, columns_of, kind_of
from cddf_jax.quantities import QUANTITIES

READINGS = {name: kind for name, kind in NAMED.items() if not kind.in_space}  # of a body in the plane
MU, E = 0.35, 1.2e6
TRUTH = {"friction_coefficient": MU, "youngs_modulus": E}
PULLS = np.array([10.0, 30.0, 50.0])


def robot(mu=MU, modulus=E):
    return paper_body("exact", youngs_modulus=modulus, friction_coefficient=mu)


def read_all(body):
    """Every kind of column, read off one call of `solve` for each row."""
    found = [cddf.solve(body, pull) for pull in PULLS]
    return {column: np.array([float(np.ravel(READINGS[column].of(one))[0]) for one in found]) for column in READINGS}


@pytest.fixture(scope="module")
def table():
    """Noise-free."""
    return cddf.Measurements.from_columns("simulated", base_tension=PULLS, **read_all(robot()))


@pytest.fixture(scope="module")
def differences():
    """By parameter and column, central differences of `solve`, which err by 1e-6 or less."""
    found = {}
    for name, step, ends in (
        ("friction_coefficient", 1e-4 * MU, (robot(mu=MU * 1.0001), robot(mu=MU * 0.9999))),
        ("youngs_modulus", 1e-4 * E, (robot(modulus=E * 1.0001), robot(modulus=E * 0.9999))),
    ):
        up, down = map(read_all, ends)
        found[name] = {column: (up[column] - down[column]) / (2 * step) for column in READINGS}
    return found


@pytest.fixture(scope="module")
def answer(table):
    return bench_of(table, robot()).evaluate(robot(), {name: np.asarray(x) for name, x in TRUTH.items()}, 16)


@pytest.mark.parametrize("column", READINGS)
def test_a_file_gives_its_unit(column, tmp_path):
    scale, unit = QUANTITIES[column].shown
    path = tmp_path / "bench.csv"
    path.write_text(f"base_tension [N], {column}{f' [{unit}]' if unit else ''}\n10, 0.5\n")
    np.testing.assert_allclose(cddf.read_measurements(path)[column], [0.5 / scale])


@pytest.mark.parametrize("column", READINGS)
def test_its_prediction_and_derivatives(column, table, answer, differences):
    """Against one solve a row and its differences."""
    values, slopes, _, against, _ = answer
    assert against.shape == (len(PULLS), 1)  # rows and tendons
    assert not np.any(against)  # a tendon alone is pulled in
    np.testing.assert_allclose(values[column], table[column], rtol=1e-9)
    for i, name in enumerate(sorted(TRUTH)):  # the flat order of a mapping
        np.testing.assert_allclose(slopes[column][:, i], differences[name][column], rtol=1e-5)


def test_a_fit_to_all_of_them_finds_the_truth(table):
    """Data without noise were made with it; the fit begins elsewhere."""
    noise = {column: 1e-3 * float(np.max(np.abs(table[column]))) for column in READINGS}
    fit = cddf.fit(robot(0.5, 1.5e6), table, noise=noise)
    for name, true in TRUTH.items():
        assert fit.status[name] == "identified"
        np.testing.assert_allclose(fit.value[name], true, rtol=1e-6)


def test_columns_of_several_tendons():
    tensions = [column for column in columns_of(3) if kind_of(column) == "tip_tension"]
    assert tensions == ["tip_tension", "tip_tension_2", "tip_tension_3"]
    assert [kind_of(column) for column in ("tip_angle", "tip_angle_2", "base_tension")] == ["tip_angle", "", ""]
