"""How the command line, scripts and notebooks set JAX up; the library itself never does."""

import os
from importlib.metadata import version

# Small programs spend their time in the compiler: these flags make it several times faster and its
# code slower, which fits and single solves do not feel. XLA refuses flags that it does not know.
QUICK_COMPILATION = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
TESTED_JAXLIB = "0.10."


def configure_jax(*, quick_compilation: bool = True) -> None:
    """Double precision, and compiled code kept in the user's cache folder. Call it before JAX computes anything.

    Args:
        quick_compilation: trade the speed of compiled code for that of compiling it; not for large batches.
            Without effect where XLA_FLAGS are set already.
    """
    if quick_compilation and version("jaxlib").startswith(TESTED_JAXLIB):
        os.environ.setdefault("XLA_FLAGS", QUICK_COMPILATION)
    import jax
    from platformdirs import user_cache_dir

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", os.path.join(user_cache_dir("cddf_jax"), "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
