"""Every notebook runs from its first cell to its last, which checks what it shows; and is stored without outputs."""

import base64
import importlib
import json
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
# a warning ends the cell that it comes from; ipykernel is not ours, and has one about itself as it shuts down
WARNINGS = "error,ignore::PendingDeprecationWarning:ipykernel.kernelbase"
MACHINE = re.compile(r"/(home|root|Users|work|tmp|usr)/|[A-Z]:\\\\|site-packages")


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    """The environment of the kernels: warnings are errors, and what is kept of compiled code serves all notebooks."""
    caches = tmp_path_factory.mktemp("caches")
    return {
        "PYTHONWARNINGS": WARNINGS,
        "PYTHONDONTWRITEBYTECODE": "1",
        "XDG_CACHE_HOME": str(caches),
        "IPYTHONDIR": str(caches / "ipython"),
        "JUPYTER_RUNTIME_DIR": str(caches / "runtime"),
    }


AT_ONCE = ("03",)  # data of one's own; the others are slow
RUN = [path if path.stem.startswith(AT_ONCE) else pytest.param(path, marks=pytest.mark.slow) for path in NOTEBOOKS]


@pytest.mark.parametrize("path", RUN, ids=lambda path: path.stem)
def test_a_notebook_runs(path, surroundings, monkeypatch):
    """In a fresh kernel in its own folder, where it leaves nothing behind."""
    for name, value in surroundings.items():
        monkeypatch.setenv(name, value)
    before = set(FOLDER.rglob("*"))
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}})
    client.execute()
    assert set(FOLDER.rglob("*")) == before
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stderr") == ""
    assert any("image/png" in output.get("data", {}) for output in outputs)


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
    """01 to 07, none left out and none twice."""
    assert [path.stem[:3] for path in NOTEBOOKS] == [f"{number:02}_" for number in range(1, 8)]


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


def test_pictures_are_drawn_anew_where_something_changed(runs, tmp_path, monkeypatch):
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
