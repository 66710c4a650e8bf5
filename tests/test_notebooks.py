"""Every notebook is stored without outputs and ends in checks; `make docs` runs them all."""

import json
import re

import nbformat
import pytest
from places import ROOT

FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
MACHINE = re.compile(r"/(home|root|Users|work|tmp|usr)/|[A-Z]:\\\\|site-packages")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_bare(path):
    """Valid, each cell with an id of its own, no outputs, and nothing of the machine that it was written on."""
    text = path.read_text(encoding="utf-8")
    nbformat.validate(json.loads(text))
    notebook = nbformat.reads(text, as_version=4)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    assert len({cell.id for cell in notebook.cells}) == len(notebook.cells)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    assert not MACHINE.search(text)
    assert notebook.cells[0].source.startswith("# ")
    assert "assert" in code[-1].source  # it ends in checks


def test_the_notebooks_are_those_of_the_series():
    """01 to 09, none left out and none twice."""
    assert [path.stem[:3] for path in NOTEBOOKS] == [f"{number:02}_" for number in range(1, 10)]
