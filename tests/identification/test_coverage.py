"""How often a 95 % interval holds the truth, on 100 experiments; the benchmark has a thousand of each kind."""

import importlib

import numpy as np
import pytest
from places import ROOT
from scipy import stats

EXPERIMENTS = 100


@pytest.fixture(scope="module")
def benchmark():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield importlib.import_module("interval_coverage")


@pytest.mark.slow
def test_intervals_hold_the_truth(benchmark):
    """The number that do is binomial, 95 % of 100; outside these limits one time in a thousand."""
    held = benchmark.simulate(benchmark.SCENARIOS["floor and fraction, estimated"], EXPERIMENTS)
    assert len(held) == EXPERIMENTS  # every fit succeeds
    low, high = stats.binom.interval(0.999, EXPERIMENTS, 0.95)
    for how in ("t", "profile"):
        for name in (benchmark.MU, benchmark.E):
            assert low <= np.sum([row[how][name] for row in held]) <= high
