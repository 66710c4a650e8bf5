"""What `cddf sweep` reads at the command line, what it writes, and what it says in the end."""

import os
import platform
import re
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from . import units
from .axes import OPTIONS, dimensions_of
from .axes import Dimension as Axis
from .chunks import Layout, even_chunks
from .equilibrium import RESULTS
from .errors import InputError
from .lanes import Lanes
from .manipulator import Manipulator
from .sampling import latin_hypercube, sobol
from .solve_command import TARGETS, read_actuation
from .store import ZarrStore, needed
from .sweep_outputs import COMPONENTS, RESULT, RESULT_NAMES
from .sweeping import Sweep
from .work import COPIES

if TYPE_CHECKING:
    import xarray

OVER = '"base_tension=5N:85N:17" or "kinematics=published,exact"'
SAMPLE = '"youngs_modulus=1.2MPa:1.6MPa"'
SAMPLERS = {"latin_hypercube": latin_hypercube, "sobol": sobol}
DIMENSIONS: dict[str, units.Dimension] = {
    "1": "dimensionless",
    "m": "length",
    "N": "force",
    "Pa": "pressure",
    "kg/m^3": "density",
    "rad": "angle",
    "N m": "moment",
    "m/s^2": "acceleration",
    "1/m": "curvature",
    "N/m": "stiffness",
}
BYTES = {"B": 1, "kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30, "TiB": 2**40}
NETCDF_MOST = 2**31 - 1  # bytes of one variable of a NetCDF 3 file, as SciPy writes it
PROBES = 4  # programs that a dry run times, where the options make more
PACKAGES = ("cddf-jax", "jax", "jaxlib", "numpy", "equinox", "xarray", "zarr")


# --- reading -------------------------------------------------------------------------------------


class Samples(NamedTuple):
    """What varies together along the dimension "sample"."""

    ranges: Sequence[str] = ()
    size: int | None = None
    sampler: str = "latin_hypercube"
    seed: int = 0


def read_sweep(manipulator: Manipulator, over: Sequence[str], sample: Samples, **given: Any) -> Sweep:
    """The sweep over axes such as "base_tension=5N:85N:17" and samples such as "youngs_modulus=1.2MPa:1.6MPa".

    Args:
        manipulator: the body.
        over: one axis each, in the order of the dimensions.
        sample: what varies together along one more dimension.
        given: other fields of `Sweep`.

    Raises:
        InputError: names the option, the text and the remedy.
    """
    axes, ranges = _by_name("--over", over, OVER), _by_name("--sample", sample.ranges, SAMPLE)
    if not axes and not ranges:
        raise InputError(f"nothing varies; give --over {OVER} or --sample")
    _check_samples(ranges, sample.size)
    if given.get("base_tension") is not None and "base_tension" in (*axes, *ranges):
        raise InputError("base_tension is given by --base-tension and varies too; leave one out")
    names = [name for name in (*axes, *ranges) if name not in OPTIONS]
    draft = Sweep(
        manipulator=manipulator, dimensions=tuple(Axis(name, {name: np.zeros(1)}, {}) for name in names), **given
    )
    si = {name: draft.case.unit(name) for name in names}
    values: dict[str, Any] = {name: _values(name, text, si.get(name, "")) for name, text in axes.items()}
    if ranges:
        limits = {name: _limits(name, text, si[name]) for name, text in ranges.items()}
        values["sample"] = SAMPLERS[sample.sampler](limits, sample.size, sample.seed)  # type: ignore[arg-type]
    return replace(draft, dimensions=dimensions_of(values))


def _by_name(option: str, texts: Sequence[str], example: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, _, values = (part.strip() for part in text.partition("="))
        if not name or not values:
            raise InputError(f"{option} {text!r}: write for example {example}")
        if name in found:
            raise InputError(f"{option} {name} is given twice; leave one out")
        found[name] = values
    return found


def _check_samples(ranges: Mapping[str, str], count: int | None) -> None:
    if ranges and count is None:
        raise InputError("--sample needs the number of samples; give for example --samples 1000")
    if count is not None and not ranges:
        raise InputError(f"--samples {count}: nothing is sampled; give for example --sample {SAMPLE}")
    for name in ranges:
        if name in OPTIONS:
            raise InputError(f"--sample {name}: only numbers have a range; write --over {name}=, with a list")


def _values(name: str, text: str, si: str) -> Any:
    """The values along an axis: an even range of numbers, or a list."""
    if name in OPTIONS:
        return _options(name, text)
    what, dimension = f"--over {name}", DIMENSIONS[si]
    if ":" not in text:
        return [units.quantity(part.strip(), dimension, what) for part in text.split(",")]
    first, _, rest = text.partition(":")
    last, _, count = (part.strip() for part in rest.partition(":"))
    if not count.isdigit() or int(count) < 2:
        raise InputError(
            f"{what}: write first, last and how many, 2 or more, as in {_example(name, dimension)}, got {text!r}"
        )
    start, stop = (units.quantity(end.strip(), dimension, what) for end in (first, last))
    if start == stop:
        raise InputError(f"{what}: first and last are the same, got {text!r}; give two different ones")
    return np.linspace(start, stop, int(count))


def _options(name: str, text: str) -> list[Any]:
    values = [part.strip() for part in text.split(",")]
    if name == "kinematics":
        return values
    if name == "nodes" and all(value.isdigit() for value in values):
        return [int(value) for value in values]
    if name == "nodes":
        raise InputError(f"--over nodes: write whole numbers as in nodes=8,16, got {text!r}")
    raise InputError(f"--over {name}: the command line takes no {name}s; use cddf_jax.sweep in Python")


def _limits(name: str, text: str, si: str) -> tuple[float, float]:
    dimension = DIMENSIONS[si]
    low, colon, high = (part.strip() for part in text.partition(":"))
    if not colon or ":" in high:
        unit = "" if si == "1" else f" {si}"
        raise InputError(f"--sample {name}: write least and largest as in {name}=1{unit}:2{unit}, got {text!r}")
    least, largest = (units.quantity(end, dimension, f"--sample {name}") for end in (low, high))
    if not least < largest:
        raise InputError(f"--sample {name}: the least comes first and is less than the largest, got {text!r}")
    return least, largest


def _example(name: str, dimension: units.Dimension) -> str:
    ends = ("0.1", "0.6") if dimension == "dimensionless" else (units.written(x, dimension) for x in (1.0, 2.0))
    return f"{name}={':'.join(ends)}:11"


def read_base_tension(texts: Sequence[str], manipulator: Manipulator) -> Any:
    """What `Sweep` takes for texts as `cddf solve` takes them; None for none.

    Raises:
        InputError: as `read_actuation`.
    """
    if not texts:
        return None
    entries = read_actuation(texts, manipulator)
    if len(entries) == 1:
        return entries[0]
    return np.array(entries) if all(isinstance(entry, float) for entry in entries) else tuple(entries)


def read_outputs(text: str) -> tuple[str, ...]:
    """The names in "tip_tension, tip_angle", each once."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",")))


def read_memory(text: str) -> float:
    """Bytes out of a text such as "2 GB".

    Raises:
        InputError: for text that is none.
    """
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([A-Za-z]+)\s*", text)
    if not found or found[2] not in BYTES or not float(found[1]) > 0:
        raise InputError(f"--memory {text!r}: write a number above 0 and one of {', '.join(BYTES)} as in '2 GB'")
    return float(found[1]) * BYTES[found[2]]


def read_processes(
    coordinator: str | None, num_processes: int | None, process_id: int | None, distributed: bool
) -> dict[str, Any] | None:
    """Arguments of `jax.distributed.initialize`; None for one process alone.

    Raises:
        InputError: where some of them are missing, or do not fit.
    """
    given = {"coordinator_address": coordinator, "num_processes": num_processes, "process_id": process_id}
    if all(value is None for value in given.values()):
        return {} if distributed else None
    if coordinator is None or num_processes is None or process_id is None:
        raise InputError(
            "--coordinator, --num-processes and --process-id belong together; "
            "give all three, or --distributed alone under Slurm or MPI"
        )
    if not re.fullmatch(r".+:\d+", coordinator):
        raise InputError(f"--coordinator {coordinator!r}: write host and port as in 'node1:1234'")
    if process_id >= num_processes:
        raise InputError(f"--process-id {process_id}: {num_processes} processes are 0 to {num_processes - 1}")
    return given


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
    if places.csv is not None and not [name for name in layout.variables if name != RESULT and _is_short(layout, name)]:
        raise InputError(f"--csv {places.csv}: a table takes no outputs along the body; add one such as tip_tension")
    for path in (places.netcdf, places.csv):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)


def _check_netcdf(path: Path, work: Sweep) -> None:
    layout = work.layout
    largest = max(int(np.prod(v.shape)) * v.dtype.itemsize for v in layout.variables.values())
    if largest > NETCDF_MOST:
        raise InputError(f"--netcdf {path}: a variable has {_size(largest)}, NetCDF 3 takes 2 GB; use the Zarr store")
    total = 2 * layout.size * layout.bytes_each  # as it is read and as it is written
    if total > work.allowed:
        raise InputError(
            f"--netcdf {path}: takes {_size(total)} of memory, {_size(work.allowed)} are allowed; raise --memory"
        )


def _is_short(layout: Layout, name: str) -> bool:
    """Whether an output is a number or a few for each solve, not a line along the body."""
    return "point" not in layout.variables[name].dims


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
    from .sweep_figure import in_words, sweep_figure

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
        "netcdf": None if places.netcdf is None else str(places.netcdf),
        "csv": None if places.csv is None else str(places.csv),
    }
    write_all(places.folder, {**drawn, written: as_json(told | {"paths": paths})})
    return paths


def _target(work: Sweep, name: str) -> str:
    """What is to be reached, in words, where a number is that of a target."""
    found = re.fullmatch(r"base_tension(?:\.(\d+))?\.value", name)
    if not found:
        return ""
    target = work.base_tension if found[1] is None else work.base_tension[int(found[1])]
    return next(f"Target {_plain(kind)}" for kind, known in TARGETS.items() if isinstance(target, known.make))


# --- exports -------------------------------------------------------------------------------------


@contextmanager
def _in_one_step(path: Path) -> Iterator[Path]:
    """A name beside the path, which takes its place when all is written."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        yield draft
        os.replace(draft, path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; choose another place") from None
    finally:
        draft.unlink(missing_ok=True)


def write_netcdf(answer: "xarray.Dataset", path: Path) -> None:
    """The whole answer as a NetCDF file.

    Raises:
        InputError: where it cannot be written.
    """
    whole = answer.load().drop_encoding()
    texts = {name: (c.dims, list(map(str, c.values))) for name, c in whole.coords.items() if c.dtype.kind == "T"}
    with _in_one_step(path) as draft:  # SciPy's writer knows no text of any length
        whole.assign_coords(texts).to_netcdf(draft, engine="scipy", format="NETCDF3_64BIT")


def write_csv(layout: Layout, answer: "xarray.Dataset", path: Path) -> None:
    """A table with a row for each solve: what varies, the outputs that are no lines along the body, the result.

    Raises:
        InputError: where it cannot be written.
    """
    pandas = needed("pandas")
    with _in_one_step(path) as draft, open(draft, "w", encoding="utf-8", newline="") as file:
        for i, (region, block) in enumerate(_blocks(layout, answer)):
            columns = _axis_columns(layout, region) | _output_columns(layout, block)
            pandas.DataFrame(columns).to_csv(file, index=False, header=i == 0)


def _blocks(layout: Layout, answer: "xarray.Dataset") -> Iterator[tuple[tuple[slice, ...], "xarray.Dataset"]]:
    """The answer in the order of its rows, as much at once as memory allows."""
    sizes = list(layout.shape.values())
    rows = replace(layout, chunks=even_chunks(sizes, layout.chunk_size, [False] * len(sizes)))
    for index in rows.indices():
        region = rows.region(index)
        yield region, answer.isel(dict(zip(layout.shape, region, strict=True))).load()


def _axis_columns(layout: Layout, region: tuple[slice, ...]) -> dict[str, np.ndarray]:
    places = np.meshgrid(*(np.arange(r.start, r.stop) for r in region), indexing="ij")
    at = {dimension: place.ravel() for dimension, place in zip(layout.shape, places, strict=True)}
    found: dict[str, np.ndarray] = {}
    for dimension, place in at.items():
        of_it = {name: c for name, c in layout.coords.items() if c[0] == (dimension,)}
        found |= {} if dimension in of_it else {dimension: place}
        found |= {_head(name, attrs): values[place] for name, (_, values, attrs) in of_it.items()}
    return found


def _output_columns(layout: Layout, block: "xarray.Dataset") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, variable in layout.variables.items():
        if not _is_short(layout, name) or name == RESULT:
            continue
        values, own = block[name].values, variable.dims[len(layout.shape) :]
        for place in np.ndindex(values.shape[len(layout.shape) :]):
            words = map(_component, own, place, values.shape[len(layout.shape) :])
            label = "_".join([name, *(word.removeprefix("tendon ") for word in words if word)])
            found[_head(label, variable.attrs)] = values[(..., *place)].ravel()
    return found | {RESULT: np.array(RESULT_NAMES)[block[RESULT].values.ravel()]}


def _component(dimension: str, place: int, size: int) -> str:
    """What tells the components of an output apart: "X", "tendon 2"; nothing where there is one."""
    if dimension == "component":
        return COMPONENTS[place]
    return f"tendon {place + 1}" if size > 1 else ""


def _head(name: str, attrs: Mapping[str, Any]) -> str:
    unit = attrs.get("units", "1")
    return name if unit == "1" else f"{name} [{unit}]"


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
    for _, block in _blocks(layout, answer):
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
        if name != RESULT
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
        "outputs": [name for name in layout.variables if name != RESULT],
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


# --- saying --------------------------------------------------------------------------------------


def in_words(told: Mapping[str, Any]) -> str:
    """What the terminal shows of what `carry_out` tells."""
    results, paths = told["results"], told["paths"]
    counts = ", ".join(f"{count:,} {_plain(name)}" for name, count in results.items())
    lines = [f"{_solved(told)}: {counts}"]
    lines += [f"{_plain(name)}: {_meaning(name)}" for name in results if name != "successful"]
    lines += [f"{name}: {_range(output)}" for name, output in told["outputs"].items() if output["min"] is not None]
    lines += [f"no figure: {paths['no_figure']}"] if paths["no_figure"] else []
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
        labels = filter(None, map(_component, own, place, least.shape))
        low, high = (_number(ends[place], unit) for ends in (least, largest))
        found.append(" ".join([*labels, f"{low} to {high}"]))
    return ", ".join(found)


def _number(value: Any, unit: str) -> str:
    if value.dtype.kind == "b":
        return str(bool(value)).lower()
    if unit in DIMENSIONS and unit != "1":
        return units.shown(value, DIMENSIONS[unit])
    return f"{float(value):.5g} {'' if unit == '1' else unit}".strip()


def rehearsal_in_words(told: Mapping[str, Any]) -> str:
    """What the terminal shows of what `rehearse` tells."""
    chunks, memory, expected = told["chunks"], told["memory"], told["expected"]
    shape = " x ".join(map(str, chunks["shape"]))
    lines = [
        f"{told['solves']:,} solves",
        *(f"{axis['dimension']}: {_axis_in_words(axis)}" for axis in told["axes"]),
        f"answer: {', '.join(told['outputs'])}; {_size(told['bytes'])} on disk at most",
        f"chunks: {chunks['count']:,} of {shape} solves at most",
        f"memory: {_size(memory['needed'])} needed, {_size(memory['allowed'])} allowed",
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
        dimension = DIMENSIONS[axis["unit"]]
        plain = dimension == "dimensionless"
        first, last = (f"{end:.5g}" if plain else units.shown(end, dimension) for end in (axis["first"], axis["last"]))
        ends = f"{first} to {last}"
    return f"{name} {ends}, {axis['count']:,} value{'s' if axis['count'] > 1 else ''}".strip()


def _plain(name: str) -> str:
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


def _size(count: float) -> str:
    """Bytes with a fitting unit."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.4g} {unit}"
        count /= 1000
    return f"{count:.4g} TB"
