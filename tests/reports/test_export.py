"""Results as xarray, pandas, NetCDF and CSV: the numbers of the equilibrium itself, with labels and units."""

import jax
import numpy as np
import pandas
import pytest
from scipy import stats

import cddf_jax as cddf

ROBOT = cddf.Manipulator(
    0.14, 0.015, 0.0, [cddf.Tendon(0.01), cddf.Tendon(0.008, -1)], youngs_modulus=1.4e6, friction_coefficient=0.42
)


@pytest.fixture(scope="module")
def equilibrium():
    return cddf.solve(ROBOT, [30.0, 10.0], direction=[1, -1], throw=False)


def test_a_dataset_holds_the_fields_with_units(equilibrium):
    """Against the equilibrium's own polynomials, and its tip against its scalars."""
    data = cddf.as_dataset(equilibrium)
    fields = equilibrium.at(np.linspace(0.0, 0.14, 201))
    assert data.tension.dims == ("tendon", "arc_length")
    assert data.normal_force.dims == ("tendon", "arc_length", "component")
    for name in ("curvature", "heading", "position", "tension", "wrap_angle", "normal_force", "friction_force"):
        np.testing.assert_allclose(data[name], getattr(fields, name), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(data.tension.sel(arc_length=0.14, method="nearest"), data.tip_tension, rtol=1e-12)
    np.testing.assert_allclose(data.position.sel(arc_length=0.14, method="nearest"), data.tip_position, rtol=1e-12)
    assert [data[name].attrs["units"] for name in ("tension", "curvature", "normal_force")] == ["N", "1/m", "N/m"]
    assert data.attrs["result"] == "successful"


def test_a_frame_of_an_equilibrium_goes_through_csv(equilibrium, tmp_path):
    frame = cddf.as_frame(equilibrium)
    assert list(frame.columns[:4]) == ["arc_length [m]", "x [m]", "y [m]", "heading [rad]"]
    np.testing.assert_allclose(frame["x [m]"].iloc[-1], equilibrium.tip_position[0], rtol=1e-14)
    np.testing.assert_allclose(frame["tension_2 [N]"].iloc[-1], equilibrium.tip_tension[1], rtol=1e-14)
    fields = equilibrium.at(np.linspace(0.0, 0.14, 201))
    np.testing.assert_allclose(
        frame["friction_force_1_y [N/m]"], fields.friction_force[0, :, 1], rtol=1e-12, atol=1e-13
    )
    frame.to_csv(tmp_path / "eq.csv", index=False)
    pandas.testing.assert_frame_equal(pandas.read_csv(tmp_path / "eq.csv"), frame)


def test_a_failed_solve_stays_failed():
    """A slender body under 1e5 N bends to where tendons cross: no numbers, and the reason."""
    failed = cddf.solve(ROBOT, [1e5, 0.0], direction=[1, -1], throw=False)
    data = cddf.as_dataset(failed)
    assert cddf.in_words(failed.status) in data.attrs["result"]
    assert "successful" not in data.attrs["result"]


def test_a_batch_and_places_off_the_body_are_refused(equilibrium):
    batch = jax.tree.map(lambda x: np.stack([x, x]), equilibrium)
    with pytest.raises(cddf.InputError, match=r"a batch of shape \(2,\)"):
        cddf.as_dataset(batch)
    with pytest.raises(cddf.InputError, match=r"within 0 to 0.14 m"):
        cddf.as_dataset(equilibrium, [0.2])
    with pytest.raises(TypeError, match="got float"):
        cddf.as_frame(3.0)  # pyright: ignore[reportArgumentType]


def test_what_is_not_identified_has_no_number_in_a_frame():
    """The line y = a x / b tells a / b only, which linear regression through the origin gives: sum x y / sum x^2."""
    x, y = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.51, 0.98, 1.52, 1.99])
    told = cddf.least_squares_fit(
        lambda p: p["a"] * x / p["b"], {"a": 1.0, "b": 1.5}, y, bounds={"a": (0.0, None), "b": (0.0, None)}
    )
    frame = cddf.as_frame(told)
    assert np.isnan(frame.loc[["a", "b"], "value"]).all()
    assert np.isinf(frame.loc[["a", "b"], "standard_error"]).all()
    ratio = frame.loc["a / b"]
    assert ratio.status == "identified"
    np.testing.assert_allclose(ratio.value, np.sum(x * y) / np.sum(x**2), rtol=1e-6)
    error = np.sqrt(np.sum((y - ratio.value * x) ** 2) / 3 / np.sum(x**2))  # textbook interval of a slope, n - 1 = 3
    np.testing.assert_allclose(
        [ratio.value - ratio.lower, ratio.upper - ratio.value], stats.t.ppf(0.975, 3) * error, 1e-4
    )
