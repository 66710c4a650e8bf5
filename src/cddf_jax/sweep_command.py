"""`cddf sweep`: where its answer goes, how it runs, what a dry run would take."""

import platform
import re
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from .errors import InputError
from .lanes import Lanes
from .solve_command import TARGETS
from .store import ZarrStore
from .sweep_exports import blocks_of, is_short, write_csv, write_netcdf
from .sweep_outputs import RESULT, RESULT_NAMES, VERDICTS
from .sweep_words import plain_words, size_in_words
from .sweeping import Sweep
from .work import COPIES

if TYPE_CHECKING:
    import xarray

NETCDF_MOST = 2**31 - 1  # bytes of one variable of a NetCDF 3 file, as SciPy writes it
PROBES = 4  # programs that a dry run times, where the options make more
PACKAGES = ("cddf-jax", "jax", "jaxlib", "numpy", "equinox", "xarray", "zarr")


# --- where it goes -------------------------------------------------------------------------------


class Places(NamedTuple):
    """Where the answer goes."""

    store: Path
    folder: Path
    stem: str  # of the figures and the JSON in the folder
    netcdf: Path | None = None
    csv: Path | None = None


def read_places(out: Path | None, netcdf: Path | None, csv: Path | None) -> Places:
    """The store itself where the name ends with .zarr, or the folder for it and all that goes with it.

    Raises:
        InputError: for no place, and for a place that cannot be.
    """
    if out is None:
        raise InputError("--out is missing; give a store such as --out sweep.zarr, or --dry-run to see what it takes")
    for option, path in (("--netcdf", netcdf), ("--csv", csv)):
        if path is not None and path.is_dir():
            raise InputError(f"{option} {path}: is a folder; give the name of a file")
    if netcdf is not None and netcdf == csv:
        raise InputError(f"--netcdf and --csv are both {csv}; give them different names")
    if out.suffix == ".zarr":
        return Places(out, out.parent, out.stem, netcdf, csv)
    return Places(out / "sweep.zarr", out, "sweep", netcdf, csv)


def check_places(places: Places, work: Sweep) -> None:
    """Find out before everything is computed what could not be written afterwards.

    Raises:
        InputError: for an answer that does not fit into a NetCDF file, or has nothing for a table.
        OSError: for a folder that cannot be made.
    """
    layout = work.layout
    if places.netcdf is not None:
        _check_netcdf(places.netcdf, work)
    if places.csv is not None and not [
        name for name in layout.variables if name not in VERDICTS and is_short(layout, name)
    ]:
        raise InputError(f"--csv {places.csv}: a table takes no outputs along the body; add one such as tip_tension")
    for path in (places.netcdf, places.csv):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)


def _check_netcdf(path: Path, work: Sweep) -> None:
    layout = work.layout
    largest = max(int(np.prod(v.shape)) * v.dtype.itemsize for v in layout.variables.values())
    if largest > NETCDF_MOST:
        raise InputError(
            f"--netcdf {path}: a variable has {size_in_words(largest)}, NetCDF 3 takes 2 GB; use the Zarr store"
        )
    total = 2 * layout.size * layout.bytes_each  # as it is read and as it is written
    if total > work.allowed:
        size, allowed = size_in_words(total), size_in_words(work.allowed)
        raise InputError(f"--netcdf {path}: takes {size} of memory, {allowed} are allowed; raise --memory")


# --- running -------------------------------------------------------------------------------------


def carry_out(work: Sweep, places: Places, options: Mapping[str, Any], progress: bool = False) -> dict[str, Any] | None:
    """Run the sweep, and write what goes beside the store; what is to be said, SI units, for JSON.

    With several processes only the first has something to write and to say; None for the others.

    Args:
        work: the sweep.
        places: where everything goes.
        options: of the command line, which are told again.
        progress: show a bar.

    Raises:
        InputError: as `sweep`, and for a place that cannot be written.
    """
    first = jax.process_index() == 0
    check_places(places, work)
    there = solves_there(work, places.store)[0]
    start = time.perf_counter()
    answer = work.run(places.store, progress)
    seconds = time.perf_counter() - start
    if not first:
        return None
    told = {
        "solves": work.layout.size,
        "solves_there_before": there,
        "seconds": seconds,
        "axes": _axes(work),
        **_summary(work, answer),
        "options": {name: str(value) if isinstance(value, Path) else value for name, value in options.items()},
        "identity": work.identity,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }
    return told | {"paths": _write(work, answer, places, told)}


def solves_there(work: Sweep, store: Path) -> tuple[int, int, int]:
    """How many solves a store has already, in how many chunks, of how many; 0 of a store that is not there.

    Raises:
        InputError: for a store of something else.
    """
    if not store.exists():
        return 0, 0, len(list(work.layout.indices()))
    opened = ZarrStore(store, work.layout, work.identity, create=False)
    there = [index for index in opened.layout.indices() if opened.has(index)]
    return sum(map(opened.layout.count, there)), len(there), len(list(opened.layout.indices()))


def _write(work: Sweep, answer: "xarray.Dataset", places: Places, told: dict[str, Any]) -> dict[str, Any]:
    """Exports, figures and the JSON; where they are."""
    from .artifacts import as_json, write_all
    from .plotting import render
    from .sweep_figure import left_out, sweep_figure
    from .sweep_view import in_words

    if places.netcdf is not None:
        write_netcdf(answer, places.netcdf)
    if places.csv is not None:
        write_csv(work.layout, answer, places.csv)
    varied = [name for axis in work.dimensions for name in (*axis.numbers, *axis.options)]
    figure = sweep_figure(answer, work.outputs, {name: _target(work, name) or in_words(name) for name in varied})
    drawn = {} if isinstance(figure, str) else render(figure, places.stem)
    written = f"{places.stem}.json"
    paths: dict[str, Any] = {
        "store": str(places.store),
        "json": str(places.folder / written),
        "figures": [str(places.folder / name) for name in drawn],
        "no_figure": figure if isinstance(figure, str) else None,
        "left_out": left_out(answer, work.outputs) if drawn else [],
        "not_in_csv": [name for name in work.outputs if not is_short(work.layout, name)] if places.csv else [],
        "netcdf": None if places.netcdf is None else str(places.netcdf),
        "csv": None if places.csv is None else str(places.csv),
    }
    write_all(places.folder, {**drawn, written: as_json(told | {"paths": paths})})
    return paths


def _target(work: Sweep, name: str) -> str:
    """What is to be reached, in words, where a number is that of a target."""
    found = re.fullmatch(r"base_tension(?:_(\d+))?\.value", name)
    if not found:
        return ""
    target = work.base_tension if found[1] is None else work.base_tension[int(found[1]) - 1]
    return next(f"Target {plain_words(kind)}" for kind, known in TARGETS.items() if isinstance(target, known.make))


# --- what is told --------------------------------------------------------------------------------


def _axes(work: Sweep) -> list[dict[str, Any]]:
    """What varies, by dimension, its ends and how many values."""
    found = []
    for dimension in work.dimensions:
        together = dimension.name not in (dimension.numbers | dimension.options)
        for name, values in (dimension.numbers | dimension.options).items():
            ends = (min(values), max(values)) if together else (values[0], values[-1])
            unit = work.case.unit(name) if name in dimension.numbers else None
            found.append(
                {"name": name, "dimension": dimension.name, "first": ends[0], "last": ends[1]}
                | {"count": dimension.size, "unit": unit}
            )
    return found


def _summary(work: Sweep, answer: "xarray.Dataset") -> dict[str, Any]:
    """How many solves ended how, and between which values each output lies where they were successful."""
    layout, rank = work.layout, len(work.layout.shape)
    counts = np.zeros(len(RESULT_NAMES), int)
    ranges: dict[str, Any] = {}
    for _, block in blocks_of(layout, answer):
        codes = block[RESULT].values
        counts += np.bincount(codes.ravel(), minlength=len(RESULT_NAMES))
        for name in layout.variables if np.any(block["successful"].values) else ():
            good = block[name].values[block["successful"].values]
            points = tuple(i for i, dim in enumerate(block[name].dims[rank:], 1) if dim == "point")
            ends = [np.fmin.reduce(good, (0, *points)), np.fmax.reduce(good, (0, *points))]
            least, largest = ranges.get(name, ends)
            ranges[name] = np.fmin(least, ends[0]), np.fmax(largest, ends[1])
    outputs = {
        name: {"unit": variable.attrs.get("units"), "dims": variable.dims[rank:]}
        | dict(zip(("min", "max"), ranges.get(name, (None, None)), strict=True))
        for name, variable in layout.variables.items()
        if name not in VERDICTS
    }
    results = {name: int(n) for name, n in zip(RESULT_NAMES, counts, strict=True) if n}
    return {"results": results, "outputs": outputs}


# --- dry runs ------------------------------------------------------------------------------------


def rehearse(work: Sweep, places: Places | None) -> dict[str, Any] | None:
    """What a sweep would take, measured on a piece of it and without writing anything, SI units, for JSON.

    None for all processes but the first, as from `carry_out`.

    Raises:
        InputError: as `carry_out`.
    """
    layout = work.layout
    solves, chunks, of = (0, 0, len(list(layout.indices()))) if places is None else solves_there(work, places.store)
    needed_bytes = COPIES * layout.bytes_each * layout.chunk_size
    store = None if places is None else {"path": str(places.store), "solves_there": solves, "chunks_there": chunks}
    expected = _expected(work, layout.size - solves)
    if jax.process_index() != 0:
        return None
    return {
        "solves": layout.size,
        "axes": _axes(work),
        "outputs": [name for name in layout.variables if name not in VERDICTS],
        "bytes": layout.size * layout.bytes_each,
        "chunks": {"count": of, "shape": layout.chunks, "solves": layout.chunk_size},
        "memory": {"needed": needed_bytes, "allowed": work.allowed},
        "store": store,
        "expected": expected,
    }


def _expected(work: Sweep, missing: int) -> dict[str, Any]:
    """How long the solves that are missing would take, from a piece of the sweep that lies all over it."""
    if not missing:
        return {"seconds": 0.0, "compile_seconds": 0.0, "rate": None}
    programs = list(np.ndindex(*(d.size if d.options else 1 for d in work.dimensions)))
    some = programs[:: -(-len(programs) // PROBES)]
    timed = [_probe(work, program) for program in some]
    each, compiling = (float(np.mean(column)) for column in zip(*timed, strict=True))
    processes = jax.process_count()
    return {
        "seconds": each * missing / processes,
        "compile_seconds": compiling * len(programs),
        "rate": processes / each,
    }


def _probe(work: Sweep, program: tuple[int, ...]) -> tuple[float, float]:
    """Seconds for each solve and for compiling, with the options at these places along the dimensions."""
    sizes = [1 if d.options else d.size for d in work.dimensions]
    total = int(np.prod(sizes))
    lanes = Lanes(work.solver(program), min(total, work.layout.chunk_size))
    count, batch = min(total, lanes.size), min(total, lanes.batch)
    starts = np.linspace(0, total - batch, -(-count // batch)).astype(int)  # neighbours, as they are in a batch
    places = np.unravel_index((starts[:, None] + np.arange(batch)).ravel()[:count], sizes)
    numbers = {
        name: values[place].astype(work.dtype)
        for dimension, place in zip(work.dimensions, places, strict=True)
        for name, values in dimension.numbers.items()
    }
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        lanes(numbers, count)
        seconds.append(time.perf_counter() - start)
    return seconds[1] / count, max(seconds[0] - seconds[1], 0.0)
