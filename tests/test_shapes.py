"""The annotations of the package are true: every public function runs with its shapes and types checked."""

import re
import subprocess
import sys

import pytest
from places import ROOT

import cddf_jax as cddf

CALLS = ROOT / "tests" / "typed_calls.py"


def test_every_public_name_is_called():
    """Classes that only come back as results are made by the functions that are called."""
    results = "Candidate Contact Design Determination Plan Equilibrium Fields Fit "
    results += "InputError IterationHistory LeastSquaresFit Measurements ModelFreeFriction ParetoFront "
    results += "Profile SolveError TipJacobian History RobotFile"
    called = set(re.findall(r"cddf\.(\w+)", CALLS.read_text(encoding="utf-8")))
    assert set(cddf.__all__) - called <= set(results.split())


@pytest.mark.slow
def test_public_functions_with_their_annotations_checked(tmp_path):
    done = subprocess.run([sys.executable, CALLS, tmp_path], capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout.split()[-1] == "done"
