"""The pictures of every notebook, from a run of all its cells: `python docs/run_notebooks.py FOLDER`.

The runs take minutes. Their pictures are kept in the folder, beside a digest of what they were made from: a notebook
is run again only where it, the library or the data have changed.
"""

import base64
import hashlib
import json
import os
import shutil
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LONGEST_CELL = 1200  # s
# a warning ends the cell that it comes from; ipykernel has one about itself as it shuts down
WARNINGS = "error,ignore::PendingDeprecationWarning:ipykernel.kernelbase"


def run_notebooks(folder: str | Path) -> None:
    """Bring the pictures of all notebooks up to date.

    Args:
        folder: made if it is missing; one folder in it for each notebook, with its pictures and `pictures.json`.
    """
    for path in NOTEBOOKS:
        place, digest = Path(folder, path.stem), made_from(path)
        if kept(place).get("made_from") != digest:
            _write(place, digest, list(_pictures(_run(path))))


def kept(place: Path) -> dict[str, Any]:
    """What lies in the folder of a notebook: `pictures`, in their order, and what they were `made_from`."""
    record = place / "pictures.json"
    return json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}


def made_from(path: Path) -> str:
    """A digest of a notebook and all that its pictures depend on: library, data, versions of packages."""
    others = [path for folder in ("src", "data") for path in sorted((ROOT / folder).rglob("*.*")) if path.is_file()]
    digest = hashlib.sha256()
    for source in (path, ROOT / "constraints.txt", *others):
        if source.suffix != ".pyc":
            digest.update(f"{source.relative_to(ROOT)}\0".encode() + source.read_bytes())
    return digest.hexdigest()


def _run(path: Path) -> Any:
    """The notebook with its outputs, run in a fresh kernel in its own folder.

    Raises:
        CellExecutionError: for an error in a cell; a warning is an error there.
        ValueError: where it draws nothing, prints to standard error, or leaves files behind.
    """
    import nbformat
    from nbclient import NotebookClient

    os.environ["PYTHONWARNINGS"] = WARNINGS
    before = set(path.parent.rglob("*"))
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=LONGEST_CELL, kernel_name="python3", resources=place).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    printed = "".join(output.text for output in outputs if output.get("name") == "stderr")
    left = sorted(file.name for file in set(path.parent.rglob("*")) - before)
    drawn = any("image/png" in output.get("data", {}) for output in outputs)
    if printed or left or not drawn:
        raise ValueError(f"{path.name}: picture drawn: {drawn}; files left behind: {left}; standard error: {printed!r}")
    return notebook


def _pictures(notebook: Any) -> Iterator[tuple[str, int, bytes]]:
    """The heading above each picture, the width at which a notebook shows it, pixels, and its PNG."""
    heading = ""
    for cell in notebook.cells:
        headings = [line.lstrip("# ") for line in cell.source.splitlines() if line.startswith("#")]
        if cell.cell_type == "markdown" and headings:
            heading = headings[-1]
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                content = base64.b64decode(output["data"]["image/png"])
                stated = output.get("metadata", {}).get("image/png", {}).get("width")
                yield heading, stated or struct.unpack(">I", content[16:20])[0], content


def _write(place: Path, digest: str, pictures: list[tuple[str, int, bytes]]) -> None:
    """Replace what was there; `pictures.json` comes last, so that a run cut short counts for nothing."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    pictures_made = []
    for number, (heading, width, content) in enumerate(pictures, 1):
        (place / f"{number}.png").write_bytes(content)
        pictures_made.append({"file": f"{number}.png", "heading": heading, "width": width})
    text = json.dumps({"made_from": digest, "pictures": pictures_made}, indent=1)
    (place / "pictures.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run_notebooks(sys.argv[1])
