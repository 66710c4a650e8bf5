"""The size of the programs that JAX compiles, in operations: it does not depend on the machine, and costs waiting."""

import importlib

import jax
import jax.numpy as jnp
import pytest
from places import ROOT

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(ROOT / "benchmarks")
    SIZES = importlib.import_module("program_size")

# what benchmarks/program_size.py counts, and up to 3 % more
LARGEST = {
    "one tendon": 1_710,
    "two tendons, directions stated": 2_030,
    "two tendons, directions found": 3_490,
    "a displacement": 4_200,
    "a tip force": 7_090,
    "a tip force, gradient by the whole body": 13_360,
    "a displacement under a tip force": 12_030,
    "a tip force in space": 10_160,
    "a trace": 3_850,
    "a trace of displacements": 12_160,
    "a trace of two tendons": 4_780,
    "the work of a trace": 6_600,
}


@pytest.mark.parametrize("name", LARGEST)
def test_programs_stay_small(name):
    program, num_tendons = SIZES.PROGRAMS[name]
    arguments = jax.tree.map(jnp.asarray, (SIZES.paper_body(num_tendons=num_tendons), 40.0))
    assert SIZES.num_operations(program, *arguments) <= LARGEST[name]


def test_a_function_called_twice_counts_twice():
    """By hand: a sine, a product and a sum are three operations; two calls, x + x and the difference make eight."""
    inner = jax.jit(lambda x: jnp.sin(x) + x * x)
    assert SIZES.num_operations(inner, 1.0) == 3
    assert SIZES.num_operations(lambda x: inner(x) - inner(x + x), 1.0) == 3 + 3 + 2
