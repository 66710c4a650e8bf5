"""All results of the benchmarks on one page: `python benchmarks/table.py`, the last step of `make benchmark`.

It measures nothing. It collects what the other scripts left in out/benchmark and writes benchmarks/measured.md, which
the documentation shows. The table of a script that was not run stays as it was, with its date.
"""

import json
import os
import platform
from collections.abc import Mapping
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cddf_jax.files.writing import as_json, write_all

FOLDER = Path("out/benchmark")
KEPT = Path("benchmarks")
PARTS = {
    "batch": "One solve, batches, gradients, loads",
    "single_solve": "One solve at a time",
    "space": "Batches in space",
    "space_loads": "Batches in space under a tip force",
    "traces": "Pull and release of one tendon",
    "sweeps": "Sweeps: size, devices, processes, precision, memory",
    "fits": "Fit and profile",
    "seventeen_levels": "Fit of 17 levels with tip positions",
    "designs": "A design",
    "cold_start": "Cold start",
    "program_size": "Size of the programs",
    "error_estimate": "The error estimate of 1,000 bodies",
    "methods": "Accuracy of the methods",
    "loads": "Accuracy under loads",
    "interval_coverage": "Coverage of intervals",
    "loop_coverage": "Coverage of intervals from loops",
    "loop_checks": "What a fit of a loop notices",
    "standard_errors": "Standard errors",
}


def report(name: str, text: str, results: Mapping[str, Any]) -> None:
    """Print the table of a script, and leave it with its results where `main` finds them."""
    print(text)
    write_all(FOLDER, {f"{name}.md": text, f"{name}.json": as_json(results)})


def main() -> None:
    """Print and save."""
    packages = {name: version(name) for name in ("jax", "numpy", "scipy", "numba", "lmfit")}
    about = {"cores": os.cpu_count(), "processor": platform.machine(), "python": platform.python_version(), **packages}
    versions = ", ".join(f"{name} {value}" for name, value in about.items())
    remark = (
        "Each time is a median of one run. Each script says what it compares. Older tables may be of older versions."
    )
    pages, results = [f"# Benchmarks\n\n{versions}. {remark}\n"], {}
    earlier = KEPT / "measured.md"
    sections = earlier.read_text().split("\n## ")[1:] if earlier.exists() else []
    kept = {title: text for title, _, text in (section.partition("\n\n") for section in sections)}
    for name, title in PARTS.items():
        page, text = FOLDER / f"{name}.md", f"Not measured: run benchmarks/{name}.py."
        results[name] = None
        if page.exists():
            when = date.fromtimestamp(page.stat().st_mtime)
            text = f"`benchmarks/{name}.py`, {when}\n\n{page.read_text()}"
            results[name] = json.loads((FOLDER / f"{name}.json").read_text())
        pages.append(f"## {title}\n\n{text if page.exists() else kept.pop(title, text)}")
        kept.pop(title, None)
    pages += [f"## {title}\n\n{text}" for title, text in kept.items()]  # those that were written by hand
    text = "\n".join(pages)
    print(text)
    write_all(KEPT, {"measured.md": text})
    write_all(FOLDER, {"benchmark.json": as_json({"about": about, "results": results})})


if __name__ == "__main__":
    main()
