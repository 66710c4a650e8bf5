"""Every notebook is stored without outputs and ends in checks; `make docs` runs them all."""

import base64
import importlib
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


# --- their pictures on the site --------------------------------------------------------------------


@pytest.fixture
def runs(monkeypatch):
    """docs/run_notebooks.py, with a run that costs nothing: one picture of 3 by 2 pixels below the second heading."""
    monkeypatch.syspath_prepend(str(FOLDER.parent / "docs"))
    module, runs = importlib.import_module("run_notebooks"), []
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (3).to_bytes(4) + (2).to_bytes(4)
    outputs = [
        nbformat.v4.new_output("display_data", {"image/png": base64.b64encode(png).decode()}),
        nbformat.v4.new_output("display_data", {"text/plain": "no picture"}),
    ]
    cells = [
        nbformat.v4.new_markdown_cell("# Title\n\ntext"),
        nbformat.v4.new_markdown_cell("## Below it"),
        nbformat.v4.new_code_cell("draw()", outputs=outputs),
    ]

    def run(path):
        runs.append(path.stem)
        return nbformat.v4.new_notebook(cells=cells)

    monkeypatch.setattr(module, "_run", run)
    return module, runs, png


def test_pictures_are_redrawn_where_something_changed(runs, tmp_path, monkeypatch):
    module, ran, png = runs
    module.run_notebooks(tmp_path)
    assert ran == [path.stem for path in NOTEBOOKS]
    assert (tmp_path / ran[0] / "1.png").read_bytes() == png
    assert module.kept(tmp_path / ran[0])["pictures"] == [{"file": "1.png", "heading": "Below it", "width": 3}]
    ran.clear()
    module.run_notebooks(tmp_path)
    assert ran == []
    before = module.made_from
    monkeypatch.setattr(module, "made_from", lambda path: before(path) + "changed" * (path == NOTEBOOKS[1]))
    module.run_notebooks(tmp_path)
    assert ran == [NOTEBOOKS[1].stem]
    assert len({before(path) for path in NOTEBOOKS}) == len(NOTEBOOKS)
