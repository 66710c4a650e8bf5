"""What `cddf sweep` reads at the command line and in a task file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import units
from ..errors import InputError
from ..files.actuation import read_actuation
from ..robot.manipulator import Manipulator
from ..sweeping.axes import Dimension as Axis, dimensions_of, latin_hypercube
from ..sweeping.sweep import Sweep
from .options import read_all

OVER = '"base_tension=5N:85N:17" or "youngs_modulus=1.2 MPa, 1.4 MPa"'
TOGETHER = "friction_coefficient,youngs_modulus"
MOST = 100_000_000  # values along an axis
SAMPLE = '"youngs_modulus=1.2MPa:1.6MPa"'


def read_sweep(
    manipulator: Manipulator,
    over: Sequence[str],
    together: Sequence[str] = (),
    sample: Sequence[str] = (),
    samples: int = 0,
    base_tension: Sequence[str] = (),
    **given: Any,
) -> Sweep:
    """The sweep over axes such as "base_tension=5N:85N:17" and samples such as "youngs_modulus=1.2MPa:1.6MPa".

    Axes that are one are named together, "friction_coefficient,youngs_modulus". What is sampled varies along one more
    dimension, "sample". `given` are other fields of `Sweep`.
    """
    axes = read_all(over, "--over", OVER, lambda name, text: text)
    ranges = read_all(sample, "--sample", SAMPLE, lambda name, text: text)
    if not axes and not ranges:
        raise InputError(f"nothing varies; give --over {OVER} or --sample")
    if ranges and not samples:
        raise InputError("--sample needs the number of samples; give for example --samples 1000")
    if samples and not ranges:
        raise InputError(f"--samples {samples}: nothing is sampled; give for example --sample {SAMPLE}")
    names = [*axes, *ranges]
    tensions = read_actuation(base_tension, manipulator) if base_tension else None
    draft = Sweep(
        manipulator=manipulator,
        dimensions=tuple(Axis(name, {name: np.zeros(1)}) for name in names),
        base_tension=tensions[0] if isinstance(tensions, list) and len(tensions) == 1 else tensions,
        **given,
    )
    dimension_of: dict[str, units.Dimension] = {name: units.DIMENSION_OF[draft.case.unit(name)] for name in names}
    values = {
        name: np.concatenate([_range(name, part.strip(), dimension_of[name]) for part in text.split(",")])
        for name, text in axes.items()
    }
    joined = _joined(values, together)
    if ranges:
        limits = {name: _limits(name, text, dimension_of[name]) for name, text in ranges.items()}
        joined["sample"] = latin_hypercube(limits, samples)
    return replace(draft, dimensions=dimensions_of(joined))


def _joined(values: Mapping[str, object], together: Sequence[str]) -> dict[str, object]:
    """The axes; numbers that vary together form one axis in the place of the first of them."""
    joined = dict(values)
    for text in together:
        names = [name.strip() for name in text.split(",")]
        if len(set(names)) < max(len(names), 2):
            raise InputError(f"--together {text!r}: name two axes or more, each once, as in {TOGETHER}")
        for name in names:
            if name not in values:
                raise InputError(f"--together {text!r}: there is no --over {name}; give it its values there")
            if name not in joined:
                raise InputError(f"--together {text!r}: {name} varies together with others already; name all at once")
        axis = "_and_".join(names), {name: joined[name] for name in names}
        rest = {name: values for name, values in joined.items() if name not in names[1:]}
        joined = dict(axis if name == names[0] else (name, values) for name, values in rest.items())
    return joined


def _range(name: str, text: str, dimension: units.Dimension) -> np.ndarray:
    """One number, or an even range."""
    what, (*ends, count) = f"--over {name}", text.split(":")
    if not ends:
        return np.array([units.quantity(text, dimension, what)])
    if len(ends) != 2 or not count.strip().isdecimal() or int(count) < 2:
        example = _example(name, dimension)
        raise InputError(f"{what}: write first, last and how many, 2 or more, as in {example}:11, got {text!r}")
    if int(count) > MOST:
        raise InputError(f"{what}: {count} values are more than the {MOST:,} that one axis may have; give fewer")
    start, stop = (units.quantity(end.strip(), dimension, what) for end in ends)
    return np.linspace(start, stop, int(count))


def _example(name: str, dimension: units.Dimension) -> str:
    """A range, "youngs_modulus=1 MPa:2 MPa"."""
    return f"{name}={':'.join(units.written(x, dimension) for x in (1.0, 2.0))}"


def _limits(name: str, text: str, dimension: units.Dimension) -> tuple[float, float]:
    ends = text.split(":")
    if len(ends) != 2:
        raise InputError(f"--sample {name}: write least and largest as in {_example(name, dimension)}, got {text!r}")
    least, largest = (units.quantity(end.strip(), dimension, f"--sample {name}") for end in ends)
    return least, largest
