"""A sweep in a process of its own, for the tests of what processes do: `python sweep_child.py JSON`.

The argument holds what differs: `out`, `devices`, `chunk`, `processes`, `rank`, `port`, `solves`, `outputs`, `limit`
(bytes of data beyond what a sweep of two chunks took). It prints the sum of the tip tensions.
"""

import json
import resource
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from bodies import paper_body

import cddf_jax as cddf


def axes(solves: int, frictions: int = 50) -> dict[str, Any]:
    tensions = np.linspace(5.0, 85.0, solves // frictions)
    return {"base_tension": tensions, "friction_coefficient": np.linspace(0.1, 0.6, frictions)}


def main(asked: dict[str, Any]) -> None:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", asked.get("devices", 1))
    if "port" in asked:
        where = f"127.0.0.1:{asked['port']}"
        jax.distributed.initialize(where, asked["processes"], asked["rank"], heartbeat_timeout_seconds=10)
    options = {"outputs": asked.get("outputs", ["tip_tension", "tip_position"]), "chunk": asked.get("chunk")}
    over = axes(asked["solves"])
    if "limit" in asked:
        # threads and compiled code come with a sweep of the first two chunks, of one row each as those of the whole
        over = axes(asked["solves"], 50_000)
        options["chunk"] = 50_000
        first = {"base_tension": over["base_tension"][:2]}
        cddf.sweep(paper_body(), over | first, out=asked["out"] + ".first", **options)
        status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
        most = 1024 * int(status["VmData"].split()[0]) + asked["limit"]  # written memory, not mere address space
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    found = cddf.sweep(paper_body(), over, out=asked["out"], **options)
    print(repr(float(found.tip_tension.sum())), int(found.successful.sum()), flush=True)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
