"""Samples of several quantities at once, for the axis of a sweep along which they vary together."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..numerics.given_numbers import check_numbers

if TYPE_CHECKING:
    from scipy.stats.qmc import QMCEngine

Ranges = Mapping[str, tuple[float, float]]


def latin_hypercube(ranges: Ranges, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """`count` samples, one in each of `count` equal slices of every range.

    Args:
        ranges: by name, the least and the largest value, SI.
        count: how many.
        seed: of the generator; the same seed gives the same samples.

    Returns:
        By name, `count` values.

    Raises:
        InputError: for an empty range, or no samples.
    """
    from scipy.stats import qmc

    return _spread(ranges, count, qmc.LatinHypercube(max(len(ranges), 1), rng=np.random.default_rng(seed)))


def sobol(ranges: Ranges, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """As `latin_hypercube`, by a scrambled Sobol sequence; `count` is a power of 2, which keeps its balance.

    Raises:
        InputError: also when `count` is not a power of 2.
    """
    if count < 1 or count & (count - 1):
        raise InputError(f"sobol: count must be a power of 2 such as {2 ** max(count, 1).bit_length()}, got {count}")
    from scipy.stats import qmc

    return _spread(ranges, count, qmc.Sobol(max(len(ranges), 1), rng=np.random.default_rng(seed)))


def _spread(ranges: Ranges, count: int, sampler: "QMCEngine") -> dict[str, np.ndarray]:
    if not ranges or count < 1:
        raise InputError(f"samples: give one range or more and a count of 1 or more, got {len(ranges)} and {count}")
    for name, limits in ranges.items():
        check_numbers(f"samples: the range of {name!r}", limits)
        if np.shape(limits) != (2,) or not np.all(np.isfinite(limits)) or not limits[0] < limits[1]:
            raise InputError(f"samples: the range of {name!r} must be (least, largest), got {limits!r}")
    low, high = np.transpose(list(ranges.values()))
    points = low + (high - low) * sampler.random(count)
    return dict(zip(ranges, points.T, strict=True))
