"""What of a sweep is drawn: outputs over what varies, with words and units, in the units of engineers."""

from collections.abc import Mapping, Sequence
from itertools import islice, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .axes import OPTIONS
from .errors import InputError
from .sweep_outputs import COMPONENTS, RESULT, RESULT_NAMES

if TYPE_CHECKING:
    import xarray

SHOWN = {"m": (1e3, "mm"), "rad": (np.degrees(1.0), "deg"), "Pa": (1e-6, "MPa")}  # else SI
SUCCESSFUL = RESULT_NAMES.index("successful")
MOST = {1: 2000, 2: 300}  # values that are drawn along each of one or two axes
NEAR = 1e-6  # relative: a value along an axis that is that near is meant


class Axis(NamedTuple):
    """Something that varies, in the unit of its label."""

    dimension: str
    values: np.ndarray
    words: str
    unit: str

    @property
    def label(self) -> str:
        return label_of(self.words, self.unit)


class Quantity(NamedTuple):
    """One component of an output over all dimensions of the sweep, in the unit of its label."""

    values: np.ndarray
    label: str
    yes_or_no: bool


class Part(NamedTuple):
    """A sweep with its options at one value each."""

    place: tuple[Any, ...]  # to take it from an array over all dimensions
    label: str


class View(NamedTuple):
    """What is to be drawn."""

    answer: "xarray.Dataset"
    quantities: list[Quantity]
    varied: Mapping[str, str]
    options: list[str]

    @property
    def codes(self) -> np.ndarray:
        """Of the results, over all dimensions of the sweep."""
        return self.answer[RESULT].values

    @property
    def dimensions(self) -> list[str]:
        return [str(dimension) for dimension in self.answer[RESULT].dims]

    def axis(self, name: str) -> Axis:
        coordinate = self.answer.coords[name]
        scale, unit = unit_of(coordinate)
        return Axis(str(coordinate.dims[0]), scale * coordinate.values, self.varied[name], unit)

    def parts(self, most: int) -> list[Part]:
        """One for each combination of options."""
        found = product(*(range(self.answer.sizes[option]) for option in self.options))
        parts = []
        for combination in islice(found, most):
            at = dict(zip(self.options, combination, strict=True))
            label = ", ".join(self._told(option, i) for option, i in at.items())
            parts.append(Part(tuple(at.get(d, slice(None)) for d in self.dimensions), label))
        return parts

    def slices(self, name: str, most: int) -> list[Part]:
        """Some of the values along an axis, as parts."""
        return [
            Part(tuple(int(i) if d == name else slice(None) for d in self.dimensions), self._told(name, int(i)))
            for i in spread(self.answer.sizes[name], most)
        ]

    def _told(self, name: str, place: int) -> str:
        """A value along a dimension in words."""
        if name == "tendon":
            return f"tendon {place + 1}"
        if name not in self.answer.coords:
            return f"{name} {place}"
        if name == "component" or name in OPTIONS:
            return _option(name, self.answer.coords[name].values[place])
        axis = self.axis(name)
        return f"{axis.words} = {axis.values[place]:.4g} {axis.unit}".strip().replace("-", "\N{MINUS SIGN}")


# --- one output that a user chose ----------------------------------------------------------------


def chosen(
    who: str, dataset: "xarray.Dataset", output: str, over: Sequence[str], selection: Mapping[str, Any], most: int
) -> View:
    """An output over one or two numbers, with a part for each combination of what else varies.

    Args:
        who: that asks, for messages.
        dataset: of `sweep`.
        output: its name.
        over: the names of the numbers.
        selection: values of other axes, "tendon" (from 0) and "component" ("X", "Y").
        most: parts that there may be.

    Raises:
        InputError: for names and values that are not there, or more parts.
    """
    if output not in dataset.data_vars or RESULT not in dataset.data_vars:
        raise InputError(f"{who}: {output!r} is no output of this sweep; there are {', '.join(map(str, dataset))}")
    companions = _companions(dataset, output)
    answer = dataset[[output, RESULT, *companions]]
    for name, value in selection.items():
        answer = _select(who, answer, name, value)
    own = [_dimension(who, answer, name) for name in over]
    if len(set(own)) < len(own):
        raise InputError(f"{who}: x and y must be numbers along two different axes, got {' and '.join(over)}")
    rest = [str(d) for d in answer[output].dims if d not in own]
    answer = answer.isel({d: 0 for d in rest if answer.sizes[d] == 1})
    rest = [d for d in rest if d in answer[output].dims]
    _check_rest(who, answer, rest, most)
    answer = answer.isel({d: spread(answer.sizes[d], MOST[len(own)]) for d in own}).load().sortby(list(over))
    drawn = answer[output].transpose(*own, *rest)
    codes = answer[[RESULT]].map(lambda array: array.broadcast_like(drawn).transpose(*drawn.dims))
    lost = answer[RESULT] < 0
    for name in companions:
        lost = lost | answer[name].isnull().any([d for d in answer[name].dims if d not in lost.dims])
    scale, unit = unit_of(drawn)
    words = " ".join([in_words(output), *_chosen_component(dataset, answer, output, rest)])
    numbers = (scale * drawn).where(~lost).transpose(*drawn.dims).values
    quantity = Quantity(numbers, label_of(words, unit), drawn.dtype.kind == "b")
    return View(codes, [quantity], {name: in_words(name) for name in (*over, *rest)}, rest)


def _companions(dataset: "xarray.Dataset", output: str) -> list[str]:
    """Outputs whose NaN tell where a solve gave no number, where the output itself cannot."""
    if dataset[output].dtype.kind == "f":
        return []
    return [str(n) for n, array in dataset.data_vars.items() if array.dtype.kind == "f" and "point" not in array.dims]


def _select(who: str, answer: "xarray.Dataset", name: str, value: Any) -> "xarray.Dataset":
    """The answer at one value of an axis."""
    if name not in answer.coords or answer.coords[name].ndim != 1:
        there = [str(key) for key, coordinate in answer.coords.items() if coordinate.ndim == 1]
        raise InputError(f"{who}: nothing varies along {name!r}; there are {', '.join(there)}")
    coordinate = answer.coords[name]
    values = coordinate.values
    if np.issubdtype(values.dtype, np.number) and np.ndim(value) == 0 and not isinstance(value, str):
        place = int(np.argmin(np.abs(values - value)))
        found = abs(values[place] - value) <= NEAR * max(abs(value), float(np.ptp(values)))
        hint = f"the nearest is {values[place]:.10g}"
    else:
        places = np.flatnonzero(values == value)
        place, found = (int(places[0]), True) if places.size else (0, False)
        hint = f"there are {', '.join(map(str, values))}"
    if not found:
        raise InputError(f"{who}: {name} has no value {value!r}; {hint}")
    return answer.isel({coordinate.dims[0]: place})


def _dimension(who: str, answer: "xarray.Dataset", name: str) -> str:
    """That along which a number varies."""
    if name not in answer.coords or answer.coords[name].ndim != 1 or not _is_number(answer.coords[name].values):
        there = [str(n) for n, c in answer.coords.items() if c.ndim == 1 and _is_number(c.values) and n != "tendon"]
        raise InputError(f"{who}: {name!r} is no number that varies; there are {', '.join(there) or 'none left'}")
    (dimension,), values = answer.coords[name].dims, answer.coords[name].values
    steps = np.diff(values)
    if dimension != name and not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError(
            f"{who}: {name} varies together with others along {dimension!r}, in no order; sweep_figure draws samples"
        )
    return str(dimension)


def _is_number(values: np.ndarray) -> bool:
    return bool(np.issubdtype(values.dtype, np.number))


def _check_rest(who: str, answer: "xarray.Dataset", rest: list[str], most: int) -> None:
    if int(np.prod([answer.sizes[d] for d in rest])) <= most:
        return
    name = max(rest, key=lambda d: answer.sizes[d])
    told = f"{name} varies too, with {answer.sizes[name]} values"
    if name not in answer.coords:
        raise InputError(f"{who}: {told}; choose with dataset.isel({name}=0)")
    value = answer.coords[name].values.tolist()[0]
    raise InputError(f"{who}: {told}; choose one, as in {_keyword(name, value)}")


def _keyword(name: str, value: Any) -> str:
    return f"{name}={value!r}" if name.isidentifier() else f"**{{{name!r}: {value!r}}}"


def _chosen_component(dataset: "xarray.Dataset", answer: "xarray.Dataset", output: str, rest: list[str]) -> list[str]:
    """Which tendon or component it is, where there are several and one was chosen."""
    gone = [str(d) for d in dataset[output].dims if d in ("tendon", "component") and d not in rest]
    return [told for d in gone if (told := _component(d, _place(answer, d), dataset.sizes[d]))]


def _place(answer: "xarray.Dataset", dimension: str) -> int:
    value = answer.coords[dimension].item()
    return COMPONENTS.index(value) if dimension == "component" else int(value)


# --- words and numbers ---------------------------------------------------------------------------


def thinned(answer: "xarray.Dataset", dimensions: list[str], most: int) -> "xarray.Dataset":
    """No more than so many values along each dimension, samples in all, in ascending order."""
    sampled = [dimension for dimension in dimensions if dimension not in answer.coords]
    others = int(np.prod([answer.sizes[dimension] for dimension in dimensions if dimension not in sampled]))
    few = max(most // others, 1) if sampled else most
    places = {d: spread(answer.sizes[d], few if d in sampled or not sampled else most) for d in dimensions}
    answer = answer.isel(places).load()
    return answer.sortby([dimension for dimension in dimensions if dimension not in sampled])


def spread(size: int, most: int) -> np.ndarray:
    """Places all over an axis, its ends among them."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))


def quantities(answer: "xarray.Dataset", outputs: Sequence[str]) -> list[Quantity]:
    """The outputs, component by component."""
    found, rank = [], answer[RESULT].ndim
    lost = _lost(answer, outputs)
    for name in outputs:
        scale, unit = unit_of(answer[name])
        values, own = answer[name].values, answer[name].dims[rank:]
        for place in np.ndindex(values.shape[rank:]):
            told = [_component(str(d), i, answer.sizes[d]) for d, i in zip(own, place, strict=True)]
            words = " ".join([in_words(name), *filter(None, told)])
            numbers = np.where(lost, np.nan, scale * values[(..., *place)])
            found.append(Quantity(numbers, label_of(words, unit), values.dtype.kind == "b"))
    return found


def _lost(answer: "xarray.Dataset", outputs: Sequence[str]) -> np.ndarray:
    """Where a solve gave no numbers, which whole numbers and true or false cannot tell."""
    rank, lost = answer[RESULT].ndim, answer[RESULT].values < 0
    for values in (answer[name].values for name in outputs if answer[name].dtype.kind == "f"):
        lost |= np.any(np.isnan(values), axis=tuple(range(rank, values.ndim)))
    return lost


def _component(dimension: str, place: int, size: int) -> str:
    if dimension == "component":
        return COMPONENTS[place]
    return f"of tendon {place + 1}" if size > 1 else ""


def unit_of(array: "xarray.DataArray") -> tuple[float, str]:
    """What to multiply SI by, and the unit that then holds."""
    unit = array.attrs.get("units", "1")
    return (100.0, "%") if array.name == "tension_loss" else SHOWN.get(unit, (1.0, "" if unit == "1" else unit))


def label_of(words: str, unit: str) -> str:
    return f"{words} ({unit})" if unit else words


def in_words(name: str) -> str:
    """The name of a number or output in words: "loads.tip_force.1" is "Tip force Y"."""
    if name == "youngs_modulus":
        return "Young's modulus"
    parts = name.removeprefix("loads.").replace("tendons.", "tendon.").split(".")
    places = COMPONENTS if parts[0] in ("tip_force", "gravity") else range(1, 100)
    words = " ".join(str(places[int(part)]) if part.isdigit() else part for part in parts).replace("_", " ")
    return words[:1].upper() + words[1:]


def _option(name: str, value: Any) -> str:
    if name == "component":
        return str(value)
    return f"{value} kinematics" if name == "kinematics" else f"{value} {name}"


def names_of(codes: np.ndarray) -> str:
    """The results among some codes in words."""
    return ", ".join(RESULT_NAMES[code].replace("_", " ") for code in np.unique(codes))


def write_ticks(axes: Axes, quantity: Quantity) -> None:
    axes.ticklabel_format(useOffset=False)
    if quantity.yes_or_no:
        axes.set_ylim(-0.15, 1.15)
        axes.set_yticks([0, 1], ["no", "yes"])
