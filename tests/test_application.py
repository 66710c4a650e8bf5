"""How programs set JAX up: double precision, quick compilation, and the user's own flags untouched."""

import json
import os
import subprocess
import sys

import jax
import pytest
from refusals import refused

from cddf_jax import application

REPORT = """
import json, os
from cddf_jax.application import configure_jax
configure_jax({arguments})
import jax, jax.numpy as jnp
number = jax.jit(lambda x: x + 1.0)(1.0)
print(json.dumps({{
    "dtype": str(number.dtype),
    "cache": jax.config.jax_compilation_cache_dir,
    "flags": os.environ.get("XLA_FLAGS"),
}}))
"""


def configured(tmp_path, arguments="", **environment):
    """What a fresh process finds after `configure_jax`."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in ("XLA_FLAGS", "JAX_ENABLE_X64", "CDDF_PROGRAMS")
    }
    done = subprocess.run(
        [sys.executable, "-c", REPORT.format(arguments=arguments)],
        env=kept | {"XDG_CACHE_HOME": str(tmp_path)} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache")
    return configured(folder), folder


def test_double_precision(fresh):
    assert fresh[0]["dtype"] == "float64"


def test_the_compilation_cache_of_jax_is_left_alone(fresh):
    assert fresh[0]["cache"] is None
    assert not (fresh[1] / "cddf_jax").exists()  # JAX compiled a function of the user, which the library does not keep


def test_quick_compilation(fresh):
    assert "--xla_backend_optimization_level=0" in fresh[0]["flags"]


def test_flags_of_the_user_are_respected(tmp_path):
    own = "--xla_force_host_platform_device_count=2"
    assert configured(tmp_path, XLA_FLAGS=own)["flags"] == own


def test_quick_compilation_can_be_declined(tmp_path):
    assert configured(tmp_path, "quick_compilation=False")["flags"] is None


@pytest.mark.parametrize("error", [AssertionError, RuntimeError])  # of JAX without a plug-in, and without a device
def test_a_platform_that_is_not_there(error, monkeypatch):
    def missing():
        raise error

    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    monkeypatch.setattr(jax, "devices", missing)
    said = refused(application._check_platform)
    assert said == "JAX_PLATFORMS=cuda: JAX finds no such device; unset it, or set JAX_PLATFORMS=cpu"
