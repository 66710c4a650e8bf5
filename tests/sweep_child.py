"""A sweep in a process of its own, for the tests of what processes do: `python sweep_child.py JSON`.

The argument holds what differs: `out`, `devices`, `chunk`, `processes`, `rank`, `port`, `solves`, `outputs`, `limit`
(bytes of data beyond what a small sweep took). It prints the sum of the tip tensions.
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


def axes(solves: int) -> dict[str, Any]:
    return {"base_tension": np.linspace(5.0, 85.0, solves // 50), "friction_coefficient": np.linspace(0.1, 0.6, 50)}


def main(asked: dict[str, Any]) -> None:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", asked.get("devices", 1))
    if "port" in asked:
        where = f"127.0.0.1:{asked['port']}"
        jax.distributed.initialize(where, asked["processes"], asked["rank"], heartbeat_timeout_seconds=10)
    options = {"outputs": asked.get("outputs", ["tip_tension", "tip_position"]), "chunk": asked.get("chunk")}
    if "limit" in asked:
        # threads and compiled code come with the first sweep; what is limited is written memory, not mere address space
        cddf.sweep(paper_body(), axes(20_000), out=asked["out"] + ".small", memory=asked["limit"] / 4, **options)
        status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
        most = 1024 * int(status["VmData"].split()[0]) + asked["limit"]
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        options["memory"] = asked["limit"] / 4
    found = cddf.sweep(paper_body(), axes(asked["solves"]), out=asked["out"], **options)
    print(repr(float(found.tip_tension.sum())), int(found.successful.sum()), flush=True)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
