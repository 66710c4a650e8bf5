"""How scripts set JAX up: double precision, programs kept for the next process, and the user's settings untouched."""

import json
import os
import subprocess
import sys

import jax
import pytest
from refusals import refused

from cddf_jax import application

REPORT = """
import json, jax
from cddf_jax.application import configure_jax, keep_programs
{set_up}
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name) if name.endswith("/cache_hits") else None)
number = jax.jit(lambda x: x + 1.0)(1.0)  # a function of the user
print(json.dumps([float(number), str(number.dtype), jax.config.jax_compilation_cache_dir, len(hits)]))
"""
OURS = ("XLA_FLAGS", "JAX_ENABLE_X64", "JAX_COMPILATION_CACHE_DIR", "JAX_ENABLE_COMPILATION_CACHE")


@pytest.fixture
def fresh(tmp_path):
    """What a fresh process finds, and what it says on standard error."""

    def run(set_up="configure_jax()", **environment):
        kept = {name: value for name, value in os.environ.items() if name not in OURS}
        done = subprocess.run(
            [sys.executable, "-c", REPORT.format(set_up=set_up)],
            env=kept | {"XDG_CACHE_HOME": str(tmp_path)} | environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return *json.loads(done.stdout), done.stderr

    return run


def test_the_next_process_finds_the_program_in_the_users_cache(fresh, tmp_path):
    """A damaged program is made again with a warning."""
    folder = tmp_path / "cddf_jax" / "programs"
    assert [fresh(), fresh()] == [(2.0, "float64", str(folder), hits, "") for hits in (0, 1)]
    for path in folder.glob("*-cache"):
        path.write_bytes(path.read_bytes()[:20])
    number, *_, hits, said = fresh()
    assert (number, hits) == (2.0, 0)
    assert "UserWarning: Error reading persistent compilation cache entry" in said


def test_scripts_keep_programs_where_they_like(fresh, tmp_path):
    own = tmp_path / "own"
    assert fresh(f"keep_programs({str(own)!r})") == (2.0, "float32", str(own), 0, "")
    assert list(own.glob("*-cache"))


def test_settings_of_the_user_are_respected(fresh, tmp_path):
    own = str(tmp_path / "own")
    assert fresh(JAX_COMPILATION_CACHE_DIR=own)[2] == own


@pytest.mark.parametrize("error", [AssertionError, RuntimeError])  # of JAX without a plug-in, and without a device
def test_a_platform_that_is_not_there(error, monkeypatch):
    def missing():
        raise error

    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    monkeypatch.setattr(jax, "devices", missing)
    said = refused(application._check_platform)
    assert said == "JAX_PLATFORMS=cuda: JAX finds no such device; unset it, or set JAX_PLATFORMS=cpu"
