"""When the rows of a table cannot determine parameters, from the statuses of their solves."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body

import cddf_jax as cddf
from cddf_jax.identification.bench import Bench, BenchModel, Evaluation
from cddf_jax.identification.verdict import SolveResults, doubt, solve_results
from cddf_jax.measurements.table import Measurements


def solves(**counts):
    """Ten rows of which so many end in each status, the first ones; lines 3 to 12 of a file."""
    named = [cddf.Status[name] for name, count in counts.items() for _ in range(count)]
    status = jnp.array([*named, *[cddf.Status.successful] * (10 - len(named))])
    table = Measurements("bench", {"base_tension": np.arange(10.0)}, np.arange(3, 13))
    read = np.arange(10) != 9  # the last row has no reading, and does not count
    against = np.asarray(status == cddf.Status.direction_contradicted)
    return SolveResults("bench", table, status, against & read, read)


@pytest.mark.parametrize(
    ("counts", "kinds"),
    [({"crossing": 6}, "crossing"), ({"crossing": 3, "not_converged": 3}, "not converged, crossing")],
)
def test_most_rows_without_a_body(counts, kinds):
    assert f"(6 of 9, rows 3-8 of bench: {kinds})" in doubt([solves(**counts)])


def test_fewer_than_half_of_the_rows_are_not_most():
    assert doubt([solves(crossing=4)]) == ""
    assert doubt([solves(inaccurate=10)]) == ""  # a matter of nodes


@pytest.mark.parametrize(
    ("stated", "expected"), [((), [0, 1, 2]), ((1,), [1, 2]), ((2,), [0, 2]), ((1, 2), [])], ids=str
)
def test_stated_directions_are_believed_tendon_by_tendon(stated, expected, monkeypatch):
    """Row 1 contradicts tendon 1, row 2 tendon 2, row 3 both, row 4 none; the rule is that of the tutorial."""
    against = np.array([[True, False], [False, True], [True, True], [False, False]])
    status = jnp.array([cddf.Status.direction_contradicted] * 3 + [cddf.Status.successful])
    monkeypatch.setattr(Bench, "evaluate", lambda *_: Evaluation({}, {}, status, against, {}))
    rows = Bench(np.ones((4, 2)), tuple(-np.ones(4) if tendon in stated else None for tendon in (1, 2)), name="bench")
    table = Measurements("bench", {"base_tension": np.ones(4), "tip_tension": np.ones(4)}, np.arange(1, 5))
    (found,) = solve_results({}, [table], BenchModel(paper_body(), (rows,), 16))
    assert np.flatnonzero(found.contradicted).tolist() == expected
    assert (doubt([found]) == "") == (not expected)


def test_all_contradicted_rows_are_named():
    """Lines 3, 4 and 5 of one file and 3 of another, as the tables were made; the row without a reading is not one."""
    one, other = solves(direction_contradicted=3), solves(direction_contradicted=1)
    assert "in 3 of 9 rows: rows 3-5 of bench; " in doubt([one])
    assert "in 4 of 18 rows: rows 3-5 of bench (1) and row 3 of bench (2); " in doubt([one, other])
