"""Sweeps of a thousand to ten million solves: `python benchmarks/sweeps.py`, about three minutes.

The body is the paper's in the exact kinematics. Tension and friction coefficient form a product grid. Outputs are tip
tension, tip position and tip angle; every solve also has its error estimate and its result. Each row is a process of
its own. It first sweeps a small grid, which compiles, then `ROUNDS` times the large one. The time is the median. The
memory is the peak of the process beyond its peak after the small sweep. Errors are those of the tip tension against
the closed form, relative. Rows with two processes share one store. The last rows are the loop of benchmarks/batch.py,
compiled by numba, on both cores: only the numbers, without any check, all in memory.
"""

import json
import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

ROUNDS = 3
FORCE = {"loads": cddf.Loads(tip_force=(0.0, -1.0))}
ROWS: dict[str, dict[str, Any]] = {
    "1,000 solves": {"solves": 1_000},
    "100,000 solves": {"solves": 100_000},
    "the same on one device": {"solves": 100_000, "devices": 1},
    "the same, 8 nodes": {"solves": 100_000, "nodes": 8},
    "the same, float32": {"solves": 100_000, "precision": "float32"},
    "the same, with derivatives by mu and E": {"solves": 100_000, "slopes": True},
    "10,000 solves under a tip force": {"solves": 10_000, "loaded": True},
    "10,000,000 solves into a store": {"solves": 10_000_000, "stored": True, "rounds": 1},
    "1,000,000 solves into a store, one process of one device": {"solves": 1_000_000, "stored": True, "devices": 1},
    "the same, two such processes": {"solves": 1_000_000, "stored": True, "devices": 1, "processes": 2},
    "1,000 solves, unchecked, by RK4 of 32 steps in numba": {"solves": 1_000, "numba": True},
    "100,000 solves, unchecked, by numba": {"solves": 100_000, "numba": True},
    "10,000,000 solves, unchecked, by numba": {"solves": 10_000_000, "numba": True, "rounds": 1},
}


def axes(solves: int) -> dict[str, np.ndarray]:
    count = int(np.sqrt(solves))
    return {
        "base_tension": np.linspace(5.0, 85.0, count),
        "friction_coefficient": np.linspace(0.1, 0.6, solves // count),
    }


def peak() -> float:
    """Peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def child(asked: dict[str, Any]) -> dict[str, float]:
    """Measure one row; it runs in its own process."""
    configure_jax(all_cores=True)
    if asked.get("numba"):
        return loop(asked)
    jax.config.update("jax_num_cpu_devices", asked.get("devices", os.cpu_count()))
    if asked.get("processes", 1) > 1:
        jax.distributed.initialize(f"127.0.0.1:{asked['port']}", asked["processes"], asked["rank"])
    jax.config.update("jax_enable_x64", asked.get("precision") != "float32")
    options: dict[str, Any] = {"nodes": asked.get("nodes", 16)}
    options["sensitivities"] = ("friction_coefficient", "youngs_modulus") if asked.get("slopes") else ()
    options |= FORCE if asked.get("loaded") else {}
    folder = Path(asked["folder"])

    def run(solves: int, name: str) -> Any:
        out = folder / f"{name}.zarr" if asked.get("stored") else None
        return cddf.sweep(paper_body(), axes(solves), out=out, **options)

    run(min(asked["solves"], 65_536), "small")
    before, spent, found = peak(), [], None
    for i in range(asked.get("rounds", ROUNDS)):
        begin = time.perf_counter()
        found = run(asked["solves"], str(i))
        spent.append(time.perf_counter() - begin)
    assert found is not None
    row: dict[str, float] = {
        "us a solve": 1e6 * float(np.median(spent)) / found.successful.size,
        "memory, MB": peak() - before,
    }
    if not asked.get("loaded"):
        row["error"] = closed_form_error(found)
    return row | {"doubtful": int((~found.successful).sum())}


def loop(asked: dict[str, Any]) -> dict[str, float]:
    """Measure a row of the loop of batch.py with 32 steps."""
    import batch

    def samples(solves: int) -> tuple[np.ndarray, ...]:
        tension, friction = (x.ravel() for x in np.meshgrid(*axes(solves).values(), indexing="ij"))
        return tension, friction, np.full(tension.size, 1.4e6)

    run = batch.numba_loop(paper_body(), 32)
    run(*samples(min(asked["solves"], 65_536)))
    before, spent, found = peak(), [], np.empty((0, 4))
    tension, friction, modulus = samples(asked["solves"])
    for _ in range(asked.get("rounds", ROUNDS)):
        begin = time.perf_counter()
        found = run(tension, friction, modulus)
        spent.append(time.perf_counter() - begin)
    memory = peak() - before
    compliance = 1.0 / float(cddf.closed_form_tension(paper_body(), 1.0, 0.140)) - 1.0
    exact = tension / (1 + friction / 0.42 * compliance * tension)
    error = float(np.max(np.abs(found[:, 0] / exact - 1)))
    return {"us a solve": 1e6 * float(np.median(spent)) / tension.size, "memory, MB": memory, "error": error}


def closed_form_error(found: Any) -> float:
    """The largest relative error of the tip tension, against T / (1 + mu G T / E)."""
    robot = paper_body()
    compliance = 1.0 / float(cddf.closed_form_tension(robot, 1.0, robot.length)) - 1.0
    worst = 0.0
    for i in range(0, found.sizes["base_tension"], 100):
        part = found.tip_tension.isel(tendon=0, base_tension=slice(i, i + 100))
        tension, share = part.base_tension.values[:, None], part.friction_coefficient.values / 0.42
        worst = max(worst, float(np.max(np.abs(part.values * (1 + share * compliance * tension) / tension - 1))))
    return worst


def measured(asked: dict[str, Any]) -> dict[str, float]:
    """Start the processes of a row, and return its measurement."""
    count, folder = asked.get("processes", 1), tempfile.mkdtemp()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        commands = [{**asked, "rank": rank, "port": port, "folder": folder} for rank in range(count)]
        started = [
            subprocess.Popen([sys.executable, __file__, json.dumps(one)], stdout=subprocess.PIPE, text=True)
            for one in commands
        ]
        rows = [json.loads(process.communicate(timeout=600)[0].splitlines()[-1]) for process in started]
    finally:
        shutil.rmtree(folder)
    return rows[0]


def main() -> None:
    """Measure, print and save."""
    if len(sys.argv) > 1:
        print(json.dumps(child(json.loads(sys.argv[1]))))
        return
    rows = {name: measured(asked) for name, asked in ROWS.items()}
    lines = ["| what | us a solve | memory, MB | error of T_tip |", "| --- | ---: | ---: | ---: |"]
    for name, row in rows.items():
        memory = f"{row['memory, MB']:.0f}" if "memory, MB" in row else ""
        lines.append(
            f"| {name} | {row['us a solve']:.3g} | {memory} | " + (f"{row['error']:.1e} |" if "error" in row else "|")
        )
    text = "\n".join(lines) + "\n"
    report("sweeps", text, rows)


if __name__ == "__main__":
    main()
