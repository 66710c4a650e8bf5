"""How the command line, scripts and notebooks set JAX up; the library itself never does."""

import gc
import os
from functools import cache
from importlib.metadata import version

from .errors import InputError

# XLA repeats these passes, with others, until none of them changes anything, which is a large part of compiling.
LEFT_OUT = ",".join(
    [
        "while-loop-invariant-code-motion",
        "while-loop-constant-sinking",
        "simplify-while-loops",
        "reshape-mover",
        "constant_folding",
    ]
)
# For small programs most of the time goes into compiling. With these flags it is several times faster, and the code is
# slower, which does not matter for fits and single solves.
QUICK_COMPILATION = (
    f"--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_disable_hlo_passes={LEFT_OUT}"
)
TESTED_JAXLIB = "0.10."


def configure_jax(*, quick_compilation: bool = True) -> None:
    """Set double precision, and make small programs start quickly. Call it before JAX computes anything.

    Args:
        quick_compilation: compile faster, to slower code; not for large batches. Without effect if XLA_FLAGS is set
            already.

    Raises:
        InputError: if JAX_PLATFORMS names a platform that JAX cannot use.
    """
    _configure(quick_compilation=quick_compilation)
    _check_platform()


def _configure(*, quick_compilation: bool) -> None:
    if quick_compilation and is_tested_jaxlib():
        os.environ.setdefault("XLA_FLAGS", QUICK_COMPILATION)
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # else every small program wakes another thread
    jax.config.update("jax_traceback_in_locations_limit", 0)  # compiled code does not need its source lines
    gc.set_threshold(200_000, 50, 50)  # tracing makes many small objects that stay; collecting takes long


@cache
def is_tested_jaxlib() -> bool:
    """Whether the options of XLA that the library knows are those of this jaxlib; XLA refuses unknown ones."""
    return version("jaxlib").startswith(TESTED_JAXLIB)


def configure_jax_for_batches(*, distributed: bool = False) -> None:
    """As `configure_jax`, for large batches: fully optimised code, and every core is a device.

    The user's settings for the devices, JAX_NUM_CPU_DEVICES or XLA_FLAGS, are kept.

    Args:
        distributed: several processes share the work; JAX asks Slurm or MPI which one this is.

    Raises:
        InputError: as `configure_jax`.
    """
    _configure(quick_compilation=False)
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", True)  # one chunk is written while the next is computed
    given = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if jax.config.jax_num_cpu_devices < 0 and not given:  # type: ignore[attr-defined]  # JAX types no options
        jax.config.update("jax_num_cpu_devices", _cores())
    if distributed:
        jax.distributed.initialize()
    _check_platform()


def _check_platform() -> None:
    """Refuse a platform of the user that JAX cannot use; without one JAX chooses itself."""
    wanted = os.environ.get("JAX_PLATFORMS")
    if not wanted:
        return
    import jax

    try:
        jax.devices()
    except (AssertionError, RuntimeError):  # the former without a plug-in for the platform
        raise InputError(
            f"JAX_PLATFORMS={wanted}: JAX finds no such device", remedy="unset it, or set JAX_PLATFORMS=cpu"
        ) from None


def _cores() -> int:
    """The number of cores that this process may use, or of all cores if the system does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
