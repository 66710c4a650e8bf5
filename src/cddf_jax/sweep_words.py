"""What `cddf sweep` says in the end."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from . import units
from .equilibrium import RESULTS
from .sweep_exports import component_label


def in_words(told: Mapping[str, Any]) -> str:
    """What the terminal shows of what `carry_out` tells."""
    results, paths = told["results"], told["paths"]
    counts = ", ".join(f"{count:,} {plain_words(name)}" for name, count in results.items())
    lines = [f"{_solved(told)}: {counts}"]
    lines += [f"{plain_words(name)}: {_meaning(name)}" for name in results if name != "successful"]
    lines += [f"{name}: {_range(output)}" for name, output in told["outputs"].items() if output["min"] is not None]
    lines += [f"no figure: {paths['no_figure']}"] if paths["no_figure"] else []
    lines += (
        [f"not in the table, as they run along the body: {', '.join(paths['not_in_csv'])}"]
        if paths["not_in_csv"]
        else []
    )
    lines += [f"not in the figure: {'; '.join(paths['left_out'])}"] if paths["left_out"] else []
    written = [paths["store"], *paths["figures"], paths["json"], paths["netcdf"], paths["csv"]]
    return "\n".join([*lines, f"written: {', '.join(path for path in written if path)}"])


def _solved(told: Mapping[str, Any]) -> str:
    """ "850 solves in 2.1 s, 405 a second", or how many of them were there already."""
    total, before = told["solves"], told["solves_there_before"]
    new = total - before
    what = f"{total:,} solve{'s' if total > 1 else ''}"
    if not new:
        return f"{what}, all there already"
    now = f" in {_duration(told['seconds'])} with compiling, {_rate(new / told['seconds'])}"
    return what + (f", {before:,} there already, {new:,} more" if before else "") + now


def _range(output: Mapping[str, Any]) -> str:
    """ "5.2 N to 45.1 N", of the components of an output one after the other."""
    unit = output["unit"] or ""
    least, largest = (np.atleast_1d(np.asarray(output[end])) for end in ("min", "max"))
    own = [dimension for dimension in output["dims"] if dimension != "point"]
    found = []
    for place in np.ndindex(least.shape if own else (1,)):
        labels = filter(None, map(component_label, own, place, least.shape))
        low, high = (_number(ends[place], unit) for ends in (least, largest))
        found.append(" ".join([*labels, f"{low} to {high}"]))
    return ", ".join(found)


def _number(value: Any, unit: str) -> str:
    if value.dtype.kind == "b":
        return str(bool(value)).lower()
    if unit in units.DIMENSION_OF and unit != "1":
        return units.shown(value, units.DIMENSION_OF[unit])
    return f"{float(value):.5g} {'' if unit == '1' else unit}".strip()


def rehearsal_in_words(told: Mapping[str, Any]) -> str:
    """What the terminal shows of what `rehearse` tells."""
    chunks, memory, expected = told["chunks"], told["memory"], told["expected"]
    shape = " x ".join(map(str, chunks["shape"]))
    lines = [
        f"{told['solves']:,} solves",
        *(f"{axis['dimension']}: {_axis_in_words(axis)}" for axis in told["axes"]),
        f"answer: {', '.join(told['outputs'])}; {size_in_words(told['bytes'])} on disk at most",
        f"chunks: {chunks['count']:,} of {shape} solves at most",
        f"memory: {size_in_words(memory['needed'])} needed, {size_in_words(memory['allowed'])} allowed",
    ]
    if told["store"]:
        there = told["store"]
        lines.append(
            f"{there['path']}: {there['chunks_there']:,} of {chunks['count']:,} chunks are there already, "
            f"{there['solves_there']:,} solves"
            if there["chunks_there"]
            else f"{there['path']}: nothing there yet"
        )
    if expected["rate"] is None:
        return "\n".join([*lines, "expected time: none, everything is there"])
    times = f"{_duration(expected['seconds'])} at {_rate(expected['rate'])}"
    return "\n".join([*lines, f"expected time: {times}, after {_duration(expected['compile_seconds'])} of compiling"])


def _axis_in_words(axis: Mapping[str, Any]) -> str:
    name = axis["name"] if axis["name"] != axis["dimension"] else ""
    if axis["unit"] is None:
        ends = f"{axis['first']} to {axis['last']}" if axis["count"] > 1 else str(axis["first"])
    else:
        dimension = units.DIMENSION_OF[axis["unit"]]
        plain = dimension == "dimensionless"
        first, last = (f"{end:.5g}" if plain else units.shown(end, dimension) for end in (axis["first"], axis["last"]))
        ends = f"{first} to {last}"
    return f"{name} {ends}, {axis['count']:,} value{'s' if axis['count'] > 1 else ''}".strip()


def plain_words(name: str) -> str:
    return name.replace("_", " ")


def _meaning(result: str) -> str:
    return RESULTS[getattr(RESULTS, result)]


def _rate(rate: float) -> str:
    return f"{rate:,.0f} a second" if rate >= 10 else f"{rate:.2g} a second"


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    if seconds < 3600:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def size_in_words(count: float) -> str:
    """Bytes with a fitting unit."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.4g} {unit}"
        count /= 1000
    return f"{count:.4g} TB"
