"""How `cddf sweep` runs, where its results go, and what it prints: JSON in SI units, and words."""

import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from rich import filesize

from .. import figures
from ..batch.drafts import check_folder
from ..batch.work import COPIES
from ..errors import InputError, in_utf8, within
from ..progress import stage
from ..statics.status import Status, words_of
from ..sweeping.export import is_short, write_csv
from ..sweeping.one_solve import RESULT, VERDICTS
from ..sweeping.sweep import Sweep
from .report import Content, Report, versions

if TYPE_CHECKING:
    import xarray

Json = dict[str, Any]  # what `--json` prints: SI units


# --- where it goes -------------------------------------------------------------------------------


def checked_store(work: Sweep, out: Path | None, csv: Path | None) -> Path:
    """The store itself where the name ends with .zarr, or else that in the folder for it and all that goes with it.

    What could not be written afterwards is refused before anything is computed.
    """
    if out is None:
        raise InputError("--out is missing; give a store such as --out sweep.zarr, or --dry-run to see what it takes")
    store = out if out.suffix == ".zarr" else out / "sweep.zarr"
    for option, path in (("--out", store), ("--csv", csv)):
        if path is not None:
            if path != store and path.is_dir():
                raise InputError(f"{option} {path}: is a folder; give the name of a file")
            with within(option):
                check_folder(path.parent)
    outputs = work.layout.empty.data_vars.items()
    if csv is not None and not any(name not in VERDICTS and is_short(array) for name, array in outputs):
        raise InputError(f"--csv {csv}: a table takes no outputs along the body; add one such as tip_tension")
    return store


# --- running -------------------------------------------------------------------------------------


def is_first_process() -> bool:
    """Whether this process writes and speaks for all of them."""
    return jax.process_index() == 0


def run_sweep(work: Sweep, store: Path, options: Mapping[str, object]) -> "tuple[xarray.Dataset, Json] | None":
    """Run the sweep, and return its answer and the summary that the command prints.

    The options of the command line go into the summary. All processes but the first return None.
    """
    start = time.perf_counter()
    answer = work.run(store)
    seconds = time.perf_counter() - start
    if not is_first_process():
        return None
    counts = np.bincount(answer[RESULT].values.ravel(), minlength=len(Status))
    summary: Json = {
        "solves": work.layout.size,
        "seconds": seconds,
        "results": {status.name: int(n) for status, n in zip(Status, counts, strict=True) if n},
        **({} if work.loads is None else {"loads": work.loads}),
        "options": {name: str(value) if isinstance(value, Path) else value for name, value in options.items()},
        "identity": work.identity,
        "versions": versions("xarray", "zarr"),
        "store": in_utf8(store),
    }
    return answer, summary


def sweep_report(work: Sweep, answer: "xarray.Dataset", summary: Json, name: str, csv: Path | None) -> Report:
    """The summary of `run_sweep`, the figures or why there is none, and the answer as a table if it has a name."""
    from ..figures.style import figure_of

    drawn, no_figure = [output for output in work.outputs if is_short(answer[output])], ""
    made: dict[str, Content] = {}
    try:
        made |= {name: figures.sweep_figure(answer, drawn)} if drawn else {}
    except InputError as error:
        no_figure = str(error)
    tips = answer.data_vars.get("tip_position")
    if tips is not None and tips.sizes["component"] == 3:
        with suppress(InputError):  # no number varies, or no solve gave a tip
            made[f"{name}_workspace"] = figure_of(figures.draw_workspace(answer))

    @stage("writing")
    def files() -> Mapping[str, Content]:
        if csv is not None:
            write_csv(answer, csv)
        return made

    told: Json = summary | {"no_figure": no_figure}
    failure = "" if "successful" in summary["results"] else "no solve was successful; see the results"
    return Report(name, summary_in_words(told), told, files, failure)


# --- words ---------------------------------------------------------------------------------------


def summary_in_words(summary: Json) -> str:
    """The summary of a sweep for the terminal."""
    total = summary["solves"]
    counts = ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in summary["results"].items())
    lines = [f"{total:,} solve{'s' if total > 1 else ''} in {summary['seconds']:.3g} s: {counts}"]
    failed = [name for name in summary["results"] if name != "successful"]
    lines += [f"{name.replace('_', ' ')}: {words_of(Status[name])}" for name in failed]
    lines += [f"no figure: {summary['no_figure']}"] if summary["no_figure"] else []
    return "\n".join(lines)


def rehearse(work: Sweep) -> Report:
    """The number of solves, memory and disk of a sweep, without solving or writing anything."""
    layout, outputs = work.layout, [str(name) for name in work.layout.empty.data_vars if name not in VERDICTS]
    axes = {dimension.name: dimension.size for dimension in work.dimensions}
    disk, memory = layout.size * layout.bytes_each, COPIES * layout.bytes_each * layout.chunk_size
    expected = {"solves": layout.size, "axes": axes, "outputs": outputs, "bytes": disk}
    expected |= {"memory": {"needed": memory, "free": work.free}}
    lines = [
        f"{layout.size:,} solves: {', '.join(f'{name} {size:,}' for name, size in axes.items())}",
        f"answer: {', '.join(outputs)}; {filesize.decimal(disk)} on disk at most",
        f"memory: {filesize.decimal(memory)} needed, {filesize.decimal(int(work.free))} free",
    ]
    return Report("rehearsal", "\n".join(lines), expected, dict)
