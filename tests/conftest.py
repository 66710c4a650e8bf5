"""Settings of every test: double precision, quick compilation, and four devices of the CPU for `shard_map`."""

import os

from cddf_jax.application import QUICK_COMPILATION

# compiling is most of the run time of the suite, and the compiled programs are small
os.environ.setdefault("XLA_FLAGS", QUICK_COMPILATION)

import jax
from hypothesis import Phase, settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 4)

# the same examples on every run; compiling takes longer than any deadline; shrinking a body tells little and takes long
settings.register_profile(
    "cddf", deadline=None, derandomize=True, database=None, phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("cddf")
