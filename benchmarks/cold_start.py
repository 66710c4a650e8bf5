"""The time of a first call in fresh processes: `python benchmarks/cold_start.py`.

Imports, help, a first solve and a first fit at the command line, with an empty and with a full cache of compiled
code.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from cddf_jax.files.artifacts import as_json, write_all

ROOT = Path(__file__).parents[1]
CDDF = str(Path(sys.executable).parent / "cddf")
ROBOT, PULLEY, TRIALS = (
    f"data/{n}" for n in ("smooth_sil_940.toml", "pulley_simulated.csv", "load_cells_simulated.csv")
)
RUNS = 3


def seconds(command: list[str], cache: str) -> float:
    """Seconds of one run whose cache folder is in `cache`."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, cwd=ROOT, env=os.environ | {"XDG_CACHE_HOME": cache}, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def cold_and_warm(command: list[str]) -> tuple[float, float]:
    """Median seconds with an empty cache, and with the cache that such a run filled."""
    cold, warm = [], []
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(seconds(command, cache))
            warm.append(seconds(command, cache))
    return float(np.median(cold)), float(np.median(warm))


def main() -> None:
    """Measure, print and save."""
    with tempfile.TemporaryDirectory() as out:
        commands = {
            "import jax": [sys.executable, "-c", "import jax"],
            "import cddf_jax": [sys.executable, "-c", "import cddf_jax"],
            "import cddf_jax, its fit loaded": [sys.executable, "-c", "import cddf_jax; cddf_jax.fit"],
            "cddf fit --help": [CDDF, "fit", "--help"],
            "cddf solve": [CDDF, "solve", ROBOT, "--base-tension", "75 N"],
            "cddf fit, shipped data": [CDDF, "fit", ROBOT, PULLEY, TRIALS],
            "cddf fit, shipped data, with figures": [CDDF, "fit", ROBOT, PULLEY, TRIALS, "--out", out],
            "cddf reproduce": [CDDF, "reproduce", ROBOT, TRIALS, "--out", out],
        }
        rows = {name: cold_and_warm(command) for name, command in commands.items()}
    lines = ["| what | empty cache, s | full cache, s |", "| --- | ---: | ---: |"]
    lines += [f"| {name} | {cold:.2f} | {warm:.2f} |" for name, (cold, warm) in rows.items()]
    text = "\n".join(lines) + "\n"
    print(text)
    write_all(ROOT / "out" / "benchmark", {"cold_start.md": text, "cold_start.json": as_json(rows)})


if __name__ == "__main__":
    main()
