"""The axes of a sweep: what varies along each dimension of its dataset, and samples of several numbers for one axis."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from ..numerics.given_numbers import check_numbers
from ..statics.named_numbers import holds

if TYPE_CHECKING:
    from scipy.stats.qmc import QMCEngine

PATH = "path"  # the attribute of a dataset that names the dimension whose base tensions were traced in their order
ALONG_A_PATH = ("base_tension", "loads.")  # how the names of numbers begin that may vary along it
Ranges = Mapping[str, tuple[float, float]]
RESERVED = ("tendon", "point", "component", "axis", "result", "successful")


class Dimension(NamedTuple):
    """A dimension of the dataset; everything along it has the same length."""

    name: str
    numbers: dict[str, np.ndarray]  # by the name of a number of the case

    @property
    def size(self) -> int:
        return len(next(iter(self.numbers.values())))


def dimensions_of(axes: object) -> tuple[Dimension, ...]:
    """The dimensions of a sweep from its argument `axes`."""
    if not isinstance(axes, Mapping) or not axes:
        raise InputError('sweep: axes must be a dictionary such as {"base_tension": values}, with one axis or more')
    found = tuple(_dimension(name, values) for name, values in axes.items())
    names = [name for dimension in found for name in dimension.numbers]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"sweep: {name!r} varies along two axes; let it vary along one")
        inner = [other for other in names if holds(name, other)]
        if inner:
            raise InputError(f"sweep: {name!r} includes {inner[0]!r}; let only one of them vary")
    return found


def _dimension(name: object, values: object) -> Dimension:
    if not isinstance(name, str) or not name or "/" in name or name in RESERVED:
        raise InputError(f"sweep: a dimension cannot be called {name!r}; rename it")
    together = values if isinstance(values, Mapping) else {name: values}
    if not together:
        raise InputError(f"sweep: nothing varies along the axis {name!r}; give names and values")
    numbers = {key: _numbers(key, given) for key, given in together.items()}
    sizes = {key: len(given) for key, given in numbers.items()}
    if len(set(sizes.values())) > 1:
        got = ", ".join(f"{key} {size}" for key, size in sizes.items())
        raise InputError(f"sweep: what varies together along {name!r} must have one length, got {got}")
    return Dimension(name, numbers)


def _numbers(name: str, given: object) -> np.ndarray:
    check_numbers(f"sweep: the axis {name!r}", given)
    try:
        values = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"sweep: the axis {name!r} must be a list of numbers, got {given!r}") from None
    if values.ndim != 1 or values.size == 0:
        raise InputError(f"sweep: the axis {name!r} must be a list of one number or more, got shape {values.shape}")
    if not np.all(np.isfinite(values)):
        place = int(np.argmin(np.isfinite(values)))
        raise InputError(f"sweep: the axis {name!r} holds {values[place]} at place {place}; leave it out")
    return values


# --- samples --------------------------------------------------------------------------------------


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
