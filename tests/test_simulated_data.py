"""The simulated data sets: made by their script, called what they are, and true to the model within their noise."""

import importlib.util

import numpy as np
import pytest
from bodies import paper_plain
from places import DATA

from cddf_jax.measurements.table import read_measurements
from cddf_jax.measurements.table_warnings import warnings_of

NAMES = ("load_cells_simulated.csv", "loop_simulated.csv", "pulley_simulated.csv", "tip_angle_simulated.csv")

# data/README.md: the truth, and the noise that every file declares
MU, E = 0.42, 1.4e6
CELL_FLOOR, CELL_FRACTION, GAIN, BASE_SD, ANGLE_SD, SCATTER = 0.1, 0.01, 1.001, 0.05, np.deg2rad(0.5), 0.01


COMPLIANCE = paper_plain().compliance(0.14)  # G(L), the integral of d / J along the paper's cone


def tip_tension(base_tension):
    """The closed form; it holds in both kinematics, the offset being constant."""
    return base_tension / (1 + MU / E * base_tension * COMPLIANCE)


def standardised_tip_tension(table):
    """(reading - truth) / sd, with everything that the file declares in the sd."""
    base, truth = table["base_tension"], tip_tension(table["base_tension"])
    loss = 1 - truth / base
    by_base = (truth / base) ** 2 * BASE_SD  # dT_tip / dT_base = (T_tip / T_base)^2
    by_friction = truth * loss * SCATTER  # dT_tip / dln(mu) = -T_tip (1 - T_tip / T_base)
    sd = np.sqrt(CELL_FLOOR**2 + (CELL_FRACTION * truth) ** 2 + by_base**2 + by_friction**2)
    return (table["tip_tension"] - GAIN * truth) / sd


def assert_standard_normal(z):
    """No reading beyond 4 sd, and a scatter that is neither absent nor greater than declared."""
    assert np.max(np.abs(z)) < 4
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3


@pytest.mark.slow
def test_the_script_gives_the_shipped_bytes(tmp_path):
    spec = importlib.util.spec_from_file_location("make_simulated", DATA / "make_simulated.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(NAMES)
    for name in NAMES:
        assert (tmp_path / name).read_bytes() == (DATA / name).read_bytes(), name


@pytest.mark.parametrize("name", NAMES)
def test_every_file_says_what_it_is(name):
    table = read_measurements(DATA / name)
    notes = " ".join(table.notes)
    assert table.simulated
    assert notes.startswith("SIMULATED, not measured: written by data/make_simulated.py, random seed (2020, ")
    assert all(word in notes for word in ("Truth: ", "mu 0.42", "Noise, normal: "))
    assert warnings_of(table, in_order=table.ordered) == ()


def test_load_cells_are_true():
    assert pytest.approx(2.942783188998e4, rel=1e-12) == COMPLIANCE  # docs/theory.md (16)
    assert_standard_normal(standardised_tip_tension(read_measurements(DATA / "load_cells_simulated.csv")))


def test_tip_angles_are_true():
    table = read_measurements(DATA / "tip_angle_simulated.csv")
    assert_standard_normal(standardised_tip_tension(table))
    # constant offset, exact kinematics: tip angle = ln(T_base / T_tip) / mu, docs/identifiability.md
    base = table["base_tension"]
    truth = np.log(base / tip_tension(base)) / MU
    slope = tip_tension(base) * COMPLIANCE / (E * base)  # dangle / dT_base
    by_friction = (slope * base - truth) * SCATTER  # dangle / dln(mu)
    sd = np.sqrt(ANGLE_SD**2 + (slope * BASE_SD) ** 2 + by_friction**2)
    assert_standard_normal((table["tip_angle"] - truth) / sd)


def test_a_loop_is_true():
    """1/T at the tip is a play of 1/T_base, clipped at 1/T_base -+ g; closed forms of docs/hysteresis.md."""
    table = read_measurements(DATA / "loop_simulated.csv")
    up = np.arange(5.0, 86.0, 5.0)
    levels, g, first = np.concatenate([up, up[-2::-1]]), MU / E * COMPLIANCE, 1 / 85.0
    assert_standard_normal((table["base_tension"] - levels) / BASE_SD)
    y, out = 1 / levels, np.arange(33) > 16
    tip = 1 / np.where(out, np.maximum(first + g, y - g), y + g)
    inside = out & (y - g < first + g)
    front = np.log(y * (first + g) / ((y + first) / 2) ** 2)
    slid = -np.log(1 - g * levels, where=out & ~inside, out=np.zeros(33))
    angle = np.where(inside, front, np.where(out, slid, np.log(1 + g * levels))) / MU
    by_base = np.where(inside, 0.0, 1.02 * (tip / levels) ** 2 * BASE_SD)
    assert_standard_normal((table["tip_tension"] - 0.3 - 1.02 * tip) / np.hypot(CELL_FLOOR, by_base))
    assert_standard_normal((table["tip_angle"] - angle) / ANGLE_SD)  # of which the base makes 0.1 deg at most


def test_pulley_is_true():
    table = read_measurements(DATA / "pulley_simulated.csv")
    assert len(table) == 30
    np.testing.assert_allclose(np.unique(table["wrap_angle"]), [np.pi / 2, np.pi], rtol=1e-15)
    truth = table["weight"] * np.exp(MU * table["wrap_angle"])  # Liu et al. (2020), eq. (5)
    assert_standard_normal((table["pulling_tension"] - truth) / np.hypot(CELL_FLOOR, CELL_FRACTION * truth))
