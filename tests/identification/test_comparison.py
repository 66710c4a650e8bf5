"""Which data a fold of cross-validation leaves out."""

from types import SimpleNamespace

import numpy as np

from cddf_jax.identification.comparison import _folds


def test_folds_go_in_the_order_of_the_groups_of_the_fit():
    """Tables may come in any order, the groups of a fit (and their noise) are sorted; by hand, two trials of two rows.

    The pulley test without trials is left out by sixths of its rows, of which three are filled.
    """
    clusters = {"pulley: pulling_tension": ("pulley", np.arange(3)), "bench: tip": ("bench", np.array([0, 0, 1, 1]))}
    fit = SimpleNamespace(
        clusters=clusters, evidence=SimpleNamespace(rows={"bench: tip": 0, "pulley: pulling_tension": 0})
    )
    bench, pulley = _folds(fit)
    assert bench.astype(int).tolist() == [[1, 1, 0, 0], [0, 0, 1, 1], [0] * 4, [0] * 4, [0] * 4]
    assert pulley.astype(int).tolist() == [[0] * 3, [0] * 3, [1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_a_column_with_one_reading_a_trial_goes_with_its_trials():
    """Two trials of two tensions each, and of one angle each: a fold is a trial in both columns."""
    clusters = {"bench: tip": ("bench", np.array([0, 0, 7, 7])), "bench: angle": ("bench", np.array([0, 7]))}
    tip, angle = _folds(SimpleNamespace(clusters=clusters, evidence=SimpleNamespace(rows=clusters)))
    assert tip.astype(int).tolist() == [[1, 1, 0, 0], [0, 0, 1, 1]]
    assert angle.astype(int).tolist() == [[1, 0], [0, 1]]
