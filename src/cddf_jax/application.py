"""How the command line, scripts and notebooks set JAX up; the library itself never does."""

import gc
import os
from pathlib import Path

from .errors import InputError, needed


def configure_jax(*, all_cores: bool = False, distributed: bool = False) -> None:
    """Set double precision, and keep compiled programs for the next process. Call it before JAX computes anything.

    Args:
        all_cores: make every core a device, for large batches. The user's settings for the devices, JAX_NUM_CPU_DEVICES
            or XLA_FLAGS, are kept.
        distributed: several processes share the work; JAX asks Slurm or MPI which one this is.

    Raises:
        InputError: if JAX_PLATFORMS names a platform that JAX cannot use, or a package is missing.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_traceback_in_locations_limit", 0)  # compiled code does not need its source lines
    gc.set_threshold(200_000, 50, 50)  # tracing makes many small objects that stay; collecting takes long
    keep_programs()
    given = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if all_cores and jax.config.jax_num_cpu_devices < 0 and not given:  # type: ignore[attr-defined]  # JAX types none
        own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None  # cores of this process
        jax.config.update("jax_num_cpu_devices", own or os.cpu_count() or 1)
    if distributed:
        jax.distributed.initialize()
    _check_platform()


def keep_programs(folder: str | os.PathLike[str] | None = None) -> Path:
    """Keep what JAX compiles, your own functions too, so that the next process does not compile it again.

    Call it before JAX computes anything. It sets JAX's persistent compilation cache; `configure_jax` calls it as well.

    Args:
        folder: where. Programs are machine code: choose a folder in which nobody else can write. None for the folder
            that JAX has already, as from JAX_COMPILATION_CACHE_DIR, or else that of cddf_jax in your cache.

    Returns:
        The folder.

    Raises:
        InputError: without a folder, if the package platformdirs is missing.
    """
    import jax

    place = folder or jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]  # JAX types none
    place = Path(place or needed("platformdirs", "cli").user_cache_path("cddf_jax") / "programs")
    jax.config.update("jax_compilation_cache_dir", str(place))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return place


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
