"""All that a compiled program depends on besides its function and arguments: versions, source, machine, settings."""

import hashlib
import logging
import os
import platform
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter
from pathlib import Path

import jax
from jaxlib import xla_client

PACKAGES = ("cddf_jax", "jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy", "jaxtyping")
SOURCE = Path(__file__).parents[1]
# settings of JAX that change neither what is traced nor what is compiled
WITHOUT_EFFECT = ("jax_compilation_cache", "jax_persistent_cache", "jax_log", "jax_debug_log", "jax_pprint", "jax_pgle")
WITHOUT_EFFECT += ("jax_traceback", "jax_include_full_tracebacks", "jax_raise_persistent", "jax_explain")
# with these settings a program is run or checked operation by operation, which only JAX can do
SPECIAL = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_no_execution", "jax_no_tracing")
SPECIAL += ("jax_check_tracer_leaks", "jax_default_device")
LOG = logging.getLogger("cddf_jax.programs")


@cache
def machine_and_versions() -> tuple[str, ...]:
    """The part that stays the same while this process runs."""
    devices = jax.local_devices()
    kinds = [f"{device.platform} {device.device_kind} {device.client.platform_version}" for device in devices]
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "LIBTPU_INIT_ARGS")]
    return (*map(_version, PACKAGES), sys.version, _processor(), *kinds, *flags, source())


def settings() -> tuple[object, ...]:
    """JAX's settings, as they hold in this thread now."""
    return _getter()(jax.config)


def are_special() -> bool:
    """Whether JAX itself must run the program: with several processes, in a mesh, or with `SPECIAL` settings."""
    if jax.process_count() > 1 or not jax.sharding.get_abstract_mesh().empty:
        return True
    return any(getattr(jax.config, name, None) for name in SPECIAL)


def named_settings() -> dict[str, str]:
    """The settings by their names, in words."""
    return dict(zip(_names(), map(str, settings()), strict=True))


@cache
def _names() -> tuple[str, ...]:
    return tuple(n for n in sorted(jax.config.values) if hasattr(jax.config, n) and not n.startswith(WITHOUT_EFFECT))


@cache
def _getter() -> Callable[[object], tuple[object, ...]]:
    return attrgetter(*_names())


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return package


def _processor() -> str:
    """The processor with its instruction set: code compiled for another one would crash."""
    parts = [platform.machine(), platform.processor(), platform.system()]
    try:
        parts.append(str(xla_client.get_topology_for_devices(jax.local_devices()).fingerprint()))
    except Exception as error:  # a backend without one; its name and version are part of the key
        LOG.debug("no fingerprint of the devices: %s", error)
    instructions = Path("/proc/cpuinfo")
    if instructions.exists():
        lines = instructions.read_text().splitlines()
        parts += sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})
    return " ".join(parts)


def stamp() -> tuple[tuple[str, int, int], ...]:
    """When each file of the library's source was written, and its size."""
    found = ((str(path), path.stat()) for path in sorted(SOURCE.rglob("*.py")))
    return tuple((path, status.st_mtime_ns, status.st_size) for path, status in found)


STAMP = stamp()


def is_source_unchanged() -> bool:
    """Whether the source is there, and unchanged since this process began."""
    return bool(STAMP) and stamp() == STAMP


@cache
def source() -> str:
    """A digest of the library's source."""
    found = hashlib.sha256()
    for path in sorted(SOURCE.rglob("*.py")):
        found.update(path.relative_to(SOURCE).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()
