"""Settings of every test: double precision, quick compilation, and four devices of the CPU for `shard_map`."""

import gc
import os
import sys
from pathlib import Path

# compiling is most of the run time of the suite, and the compiled programs are small; every core has a worker of its
# own, so that one thread for each of them does; the flags are those of the jaxlib in constraints.txt
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1",
)
os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"  # no test depends on what earlier runs left on the disk

import jax
import pytest
from hypothesis import Phase, settings

from cddf_jax import progress

# tracing makes many small objects that live: looking for garbage among them took a quarter of its time
gc.set_threshold(200_000, 50, 50)
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 4)
jax.config.update("jax_traceback_in_locations_limit", 0)  # compiled programs need not know the lines they come from

# the same examples on every run; compiling takes longer than any deadline; shrinking a body tells little and takes long
settings.register_profile(
    "cddf", deadline=None, derandomize=True, database=None, phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("cddf")

# every compiled program keeps a dozen maps of memory; Linux grants a process 65,530 of them, and the compiler crashes
# without a word where there are no more
MAPS = Path("/proc/self/maps")
MANY_MAPS = 25_000


# The files that take longest, of slow and other tests: one that starts last would leave the other workers without work.
FIRST = ("test_fit_in_space", "test_trace_in_space", "test_space", "test_stepped_in_space", "test_commands_in_space")
FIRST += (
    "test_displacement",
    "test_fit_of_loops",
    "test_stepped",
    "test_shapes",
    "test_rivals",
    "test_fit",
    "test_loads",
)
FIRST += ("test_soft_tentacle", "test_driven", "test_trace", "test_real_robot_loops", "test_work", "test_targets")


def pytest_collection_modifyitems(items):
    place = {name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(FIRST)))


@pytest.fixture(scope="module", autouse=True)
def _let_compiled_programs_go():
    """Between the files of a long run, before there are too many."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MANY_MAPS:
        jax.clear_caches()
        gc.collect()


def pytest_unconfigure():
    """Garbage is looked for once; pytest and Python would go through all that was traced three times more."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def said(monkeypatch):
    """Every stage that work says to those who asked, in order; nothing is shown."""
    every = []

    class Recording(list):
        def append(self, stage):
            every.append(stage)
            super().append(stage)

    class Recorded(progress.Stages):
        def __init__(self, write):
            super().__init__(write)
            self.now = Recording()

    monkeypatch.setattr(progress, "PATIENCE", float("inf"))
    monkeypatch.setattr(progress, "Stages", Recorded)
    return every


@pytest.fixture
def cddf_command(monkeypatch, capsys):
    """Run `cddf` with some arguments in this process, set up by the tests; exit code, standard output and error."""

    def run(*arguments):
        from cddf_jax import application
        from cddf_jax.cli import app as cli

        monkeypatch.setattr(application, "configure_jax", lambda **_: None)
        monkeypatch.setattr(progress, "PATIENCE", float("inf"))  # however long it takes
        monkeypatch.setattr(sys, "argv", ["cddf", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return run
