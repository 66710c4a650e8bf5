"""How the command line, scripts and notebooks set JAX up; the library itself never does."""

import gc
import os
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

# Small programs spend their time in the compiler: these flags make it several times faster and its
# code slower, which fits and single solves do not feel. XLA refuses flags that it does not know.
QUICK_COMPILATION = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
TESTED_JAXLIB = "0.10."


def configure_jax(*, quick_compilation: bool = True) -> None:
    """Double precision, and what makes small programs start quickly. Call it before JAX computes anything.

    Args:
        quick_compilation: trade the speed of compiled code for that of compiling it; not for large batches.
            Without effect where XLA_FLAGS are set already.
    """
    if quick_compilation and version("jaxlib").startswith(TESTED_JAXLIB):
        os.environ.setdefault("XLA_FLAGS", QUICK_COMPILATION)
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # another thread would be woken for every small program
    jax.config.update("jax_traceback_in_locations_limit", 0)  # compiled code need not know the lines it comes from
    gc.set_threshold(200_000, 50, 50)  # tracing makes many small objects that live; looking through them takes long


def configure_jax_for_batches(processes: Mapping[str, Any] | None = None) -> None:
    """As `configure_jax`, for large batches: code compiled with all care, and every core a device.

    Settings of the user's for the devices, JAX_NUM_CPU_DEVICES or XLA_FLAGS, are respected.

    Args:
        processes: arguments of `jax.distributed.initialize` where several processes share the work; with none of
            them in it JAX asks Slurm or MPI.
    """
    configure_jax(quick_compilation=False)
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", True)  # one chunk is written while the next is computed
    told = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if jax.config.jax_num_cpu_devices < 0 and not told:  # type: ignore[attr-defined]  # JAX types no options
        jax.config.update("jax_num_cpu_devices", _cores())
    if processes is not None:
        jax.distributed.initialize(**processes)


def _cores() -> int:
    """Those that this process may use, where the system tells."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
