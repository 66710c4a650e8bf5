"""The status of a solve: its codes, its words, and what is said of a batch."""

import jax
import jax.numpy as jnp
import numpy as np
from bodies import codes

import cddf_jax as cddf
from cddf_jax.statics.status import first_of

# as they stand in stores on disk
NAMES = (
    *("successful", "direction_contradicted", "inaccurate", "crossing", "not_converged", "unstable", "load_limit"),
    *("slack", "unreachable", "undetermined", "locked", "too_many_turns", "unphysical"),
)


def test_codes_and_words():
    assert {status.name: int(status) for status in cddf.Status} == {name: i for i, name in enumerate(NAMES)}
    assert [status.name for status in cddf.Status if not status.words] == ["successful"]


def test_the_first_case_counts():
    x = jnp.arange(4, dtype=jnp.int32)
    status = jax.jit(lambda x: first_of((x > 2, cddf.Status.locked), (x > 1, x), (x > 0, cddf.Status.slack)))(x)
    assert codes(status) == [0, cddf.Status.slack, 2, cddf.Status.locked]
    assert status.dtype == np.int32
    assert cddf.in_words(status) == "1 successful, 1 inaccurate, 1 slack, 1 locked"
