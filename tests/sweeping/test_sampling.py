"""Latin hypercube and Sobol samples: their defining property, slice by slice."""

import numpy as np
import pytest

import cddf_jax as cddf

RANGES = {"base_tension": (5.0, 85.0), "friction_coefficient": (0.1, 0.6), "youngs_modulus": (1e6, 2e6)}


@pytest.mark.parametrize("sampler", [cddf.latin_hypercube, cddf.sobol])
def test_every_slice_of_every_range_holds_one_sample(sampler):
    samples = sampler(RANGES, 64, seed=3)
    assert list(samples) == list(RANGES)
    for name, (low, high) in RANGES.items():
        slices = np.floor(64 * (samples[name] - low) / (high - low)).astype(int)
        assert sorted(slices) == list(range(64))


def test_sobol_fills_every_box_of_a_grid():
    samples = cddf.sobol(dict(list(RANGES.items())[:2]), 64)
    boxes = {
        (int(8 * (a - 5.0) / 80.0), int(8 * (b - 0.1) / 0.5))
        for a, b in zip(samples["base_tension"], samples["friction_coefficient"], strict=True)
    }
    assert len(boxes) == 64  # a (0, 6, 2)-net: one point in each of the 8 x 8 boxes


def test_a_seed_repeats_and_another_does_not():
    one, same, other = (cddf.latin_hypercube(RANGES, 10, seed=seed)["base_tension"] for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize(
    ("ranges", "count", "message"),
    [
        ({}, 8, "one range or more"),
        ({"base_tension": (5.0, 5.0)}, 8, "'base_tension' must be"),
        ({"base_tension": (5.0, np.inf)}, 8, "'base_tension' must be"),
    ],
)
def test_bad_ranges(ranges, count, message):
    with pytest.raises(cddf.InputError, match=message):
        cddf.latin_hypercube(ranges, count)


def test_sobol_wants_a_power_of_two():
    with pytest.raises(cddf.InputError, match=r"power of 2 such as 128, got 100"):
        cddf.sobol(RANGES, 100)
