"""How often a 95 % interval holds the truth, on 200 experiments; the benchmark has a thousand of each kind."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

EXPERIMENTS = 200


@pytest.fixture(scope="module")
def benchmark():
    path = Path(__file__).parents[1] / "benchmarks" / "interval_coverage.py"
    spec = importlib.util.spec_from_file_location("coverage_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.mark.parametrize("noise", ["one sd for each table, estimated", "floor and fraction, estimated"])
@pytest.mark.slow
def test_intervals_hold_the_truth(benchmark, noise):
    """The number that do is binomial, 95 % of 200; outside these limits one time in a thousand."""
    held = benchmark.simulate(benchmark.SCENARIOS[noise], EXPERIMENTS // 2)
    assert len(held) == EXPERIMENTS // 2  # every fit succeeds
    low, high = stats.binom.interval(0.999, EXPERIMENTS // 2, 0.95)
    for how in ("t", "profile"):
        for name in (benchmark.MU, benchmark.E):
            assert low <= np.sum([row[how][name] for row in held]) <= high
