"""What a person waits for in fresh processes: `python benchmarks/cold_start.py`.

Each line is a process of its own, once with the programs of an earlier run and once with none kept. The times are in
seconds and in multiples of a process that only loads the packages, measured in the same run. The line of the explorer
needs Chromium and playwright; it ends when the page has followed a slider.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cddf_jax.files.writing import as_json, write_all

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[1]
CDDF = [sys.executable, "-c", "import sys; sys.argv[0] = 'cddf'; from cddf_jax.cli.app import main; main()"]
ROBOT, PULLEY, TRIALS = (
    f"data/{n}" for n in ("smooth_sil_940.toml", "pulley_simulated.csv", "load_cells_simulated.csv")
)
COMPUTING = "[style*='--computing: on']"  # parts of the page
DESIGN = "fitting/design_uniform_curvature.toml"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
RUNS = 5
PATIENCE = 120_000  # ms
OUT = "OUT"  # stands for an empty folder
PACKAGES = "import jax, optimistix, scipy.optimize"
OVER = ["--over", "friction_coefficient=0.2:0.6:20", "--over", "base_tension=10N:80N:50"]

Wait = Callable[[dict[str, str], str], None]  # until something is done, with an environment and an empty folder


def process(*arguments: str) -> Wait:
    """A process that ends by itself."""

    def wait(environment: dict[str, str], out: str) -> None:
        command = [out if argument == OUT else argument for argument in arguments]
        subprocess.run(command, check=True, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)

    return wait


def python(program: str) -> Wait:
    """A Python program."""
    return process(sys.executable, "-c", program)


def cddf(*arguments: str) -> Wait:
    """A command."""
    return process(*CDDF, *arguments)


def moving_page(browser: "Browser") -> Wait:
    """`cddf explore`, until its page has followed a slider."""

    def wait(environment: dict[str, str], _: str) -> None:
        command = [*CDDF, "explore", ROBOT, "--no-browser"]
        with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            page = browser.new_page()
            page.set_default_timeout(PATIENCE)
            page.goto(server.stdout.readline().split()[0])
            page.locator('[data-name="tip_tension_1"]').wait_for()
            tension = page.locator(".slider-edit input").first
            tension.fill("64")
            tension.press("Enter")
            page.locator('[data-name="base_tension_1"]', has_text=re.compile("^64$")).wait_for()
            page.locator(COMPUTING).first.wait_for(state="detached")
            page.close()
            server.kill()

    return wait


@contextmanager
def a_browser() -> "Iterator[Browser | None]":
    """Chromium, where it is there."""
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        yield None
        return
    with sync_playwright() as running:
        yield running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]) if CHROMIUM else None


def seconds(wait: Wait, programs: str) -> float:
    """How long it takes with the programs of a folder."""
    with tempfile.TemporaryDirectory() as out:
        begin = time.perf_counter()
        wait(os.environ | {"JAX_COMPILATION_CACHE_DIR": programs}, out)
        return time.perf_counter() - begin


def kept_and_not(wait: Wait) -> tuple[float, float]:
    """Median seconds with the programs of an earlier run, and with none."""
    kept, fresh = [], []
    with tempfile.TemporaryDirectory() as earlier:
        seconds(wait, earlier)
        for _ in range(RUNS):
            kept.append(seconds(wait, earlier))
            with tempfile.TemporaryDirectory() as empty:
                fresh.append(seconds(wait, empty))
    return float(np.median(kept)), float(np.median(fresh))


LINES = {
    PACKAGES: python(PACKAGES),
    "import jax, optimistix": python("import jax, optimistix"),
    "import cddf_jax": python("import cddf_jax"),
    "import cddf_jax, its fit loaded": python("import cddf_jax; cddf_jax.fit"),
    "cddf fit --help": cddf("fit", "--help"),
    "cddf solve": cddf("solve", ROBOT, "-t", "75 N"),
    "cddf solve under a tip force": cddf("solve", ROBOT, "-t", "75 N", "--tip-force", "0 N, -5 N"),
    "cddf fit": cddf("fit", ROBOT, PULLEY, TRIALS),
    "cddf fit with figures": cddf("fit", ROBOT, PULLEY, TRIALS, "--out", OUT),
    "cddf sweep of 1,000 solves": cddf("sweep", ROBOT, *OVER, "--output", "tip_tension", "--out", OUT),
    "cddf design of the uniform curvature": cddf("design", DESIGN),
    "cddf reproduce": cddf("reproduce", ROBOT, TRIALS, "--out", OUT),
}


def main() -> None:
    """Measure, print and save."""
    with a_browser() as browser:
        page = {} if browser is None else {"cddf explore, to a page that moves": moving_page(browser)}
        rows = {name: kept_and_not(wait) for name, wait in (LINES | page).items()}
    unit = float(np.mean(rows[PACKAGES]))  # it keeps nothing: both are the same
    lines = ["| what | kept, s | times the packages | none kept, s | times the packages |"]
    lines += ["| --- | ---: | ---: | ---: | ---: |"]
    for name, (kept, fresh) in rows.items():
        lines.append(f"| {name} | {kept:.2f} | {kept / unit:.2f} | {fresh:.2f} | {fresh / unit:.2f} |")
    text = "\n".join(lines) + "\n"
    print(text)
    write_all(ROOT / "out" / "benchmark", {"cold_start.md": text, "cold_start.json": as_json(rows)})


if __name__ == "__main__":
    main()
