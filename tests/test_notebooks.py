"""Every notebook runs from its first cell to its last, which checks what it shows."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))


def cells(path):
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    """Its code cells in one process of their own."""
    program = "\n".join("".join(cell["source"]) for cell in cells(path) if cell["cell_type"] == "code")
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=path.parent,
        env=os.environ | {"MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_a_notebook_shows_is_there_and_names_no_machine(path):
    code = [cell for cell in cells(path) if cell["cell_type"] == "code"]
    assert any(cell["outputs"] for cell in code)
    shown = json.dumps([output.get("text", "") for cell in code for output in cell["outputs"]])
    assert str(Path.home()) not in shown
    assert "site-packages" not in shown
    assert not any(output["output_type"] == "error" for cell in code for output in cell["outputs"])
