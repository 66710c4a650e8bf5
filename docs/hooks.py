"""What the pages need beyond their packages: examples that run, formulas in MathML, files of the project as pages.

Every ```python block of a page is run, in one session for the page, and every `$ cddf` line of a ```console block,
both in a folder that holds copies of `data` and `fitting`; an error is fatal under `mkdocs build --strict`.
"""

import base64
import contextlib
import html
import io
import json
import logging
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args, get_origin
from unittest import mock

import ziamath
from latex2mathml.converter import convert
from mkdocs.structure.files import File
from run_notebooks import NOTEBOOKS, kept  # MkDocs finds what lies beside this file while it loads it

from cddf_jax.application import configure_jax

ROOT = Path(__file__).resolve().parents[1]
WORK = Path(tempfile.mkdtemp(prefix="cddf_docs_"))
RUNS = ROOT / "out" / "notebooks"  # pictures of the notebooks, kept from build to build
FONT = Path(ziamath.__file__).parent / "fonts" / "STIXTwoMath-Regular.ttf"  # for formulas, where none is installed
PAGES = {"index.md": "README.md", "changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
log = logging.getLogger("mkdocs.hooks")
drawing: dict[str, subprocess.Popen] = {}  # by script
sys.modules["hooks"] = sys.modules[__name__]  # pages import from here


def on_pre_build(config: Any, **_: Any) -> None:
    """One process runs all examples: what is compiled for one page serves the next. Two others draw meanwhile."""
    sys.path.insert(0, str(ROOT / "docs"))  # where the scripts that draw are
    configure_jax()
    for folder in ("data", "fitting"):
        shutil.copytree(ROOT / folder, WORK / folder, ignore=shutil.ignore_patterns("__pycache__"))
    if config.extra["gallery"]:
        for script, folder in (("make_gallery", WORK / "gallery"), ("run_notebooks", RUNS)):
            command = [sys.executable, ROOT / "docs" / f"{script}.py", folder]
            output: dict[str, Any] = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
            drawing[script] = subprocess.Popen(command, cwd=ROOT, **output)


def on_build_error(**_: Any) -> None:
    """Stop the processes that draw."""
    for process in drawing.values():
        process.kill()


def _wait_for(script: str) -> bool:
    """Until a script has drawn; whether it has, and well."""
    drawn = drawing.pop(script, None)
    if drawn is None:
        return False
    output, _ = drawn.communicate()
    if drawn.returncode:
        log.warning("docs/%s.py failed: %s", script, output)
    return drawn.returncode == 0


def on_env(env: Any, files: Any, **_: Any) -> Any:
    """When all pages are read: what the notebooks have drawn goes into theirs."""
    page = files.get_file_from_path("notebooks.md").page
    if _wait_for("run_notebooks"):
        page.content = re.sub(r'<div data-notebook="(\w+)"></div>', lambda m: _notebook_pictures(m[1]), page.content)
    return env


def _notebook_pictures(name: str) -> str:
    place, shown = RUNS / name, []
    for picture in kept(place)["pictures"]:
        copied = shutil.copy(place / picture["file"], _folder(WORK / "notebooks" / name))
        source, words = f"notebooks/{name}/{Path(copied).name}", html.escape(picture["heading"], quote=True)
        image = f'<img class="figure" src="{source}" alt="{words}" width="{picture["width"]}">'
        shown.append(f"<p>{image}<br><em>{words}</em></p>")
    return "\n".join(shown)


def _folder(path: Path) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    return path


def on_post_build(config: Any, **_: Any) -> None:
    """Add the pictures of gallery and notebooks, and leave nothing behind."""
    _wait_for("make_gallery")
    for folder in ("gallery", "notebooks"):
        for picture in (WORK / folder).rglob("*.png"):
            shutil.copy(picture, _folder(Path(config.site_dir, picture.relative_to(WORK).parent)))
    shutil.rmtree(WORK, ignore_errors=True)


# --- pages that are made ----------------------------------------------------------------------------


def on_files(files: Any, config: Any) -> Any:
    """README, changelog, how to contribute, the gallery, the notebooks themselves, and a font for formulas."""
    for page, source in PAGES.items():
        files.append(File.generated(config, page, content=_as_page((ROOT / source).read_text(encoding="utf-8"))))
    files.append(File.generated(config, "gallery.md", content=_gallery(config.extra["gallery"])))
    for path in (*NOTEBOOKS, FONT):
        folder = "fonts" if path == FONT else "notebooks"
        files.append(File.generated(config, f"{folder}/{path.name}", abs_src_path=str(path)))
    return files


def _as_page(text: str) -> str:
    """A file of the project as a page of the site, whose Python blocks are run and show what they print themselves."""
    text = re.sub(r"^```text\n.*?^```\n", "", text, flags=re.M | re.S)
    pages = {f"]({source})": f"]({page})" for page, source in PAGES.items()}
    for there, here in (*pages.items(), ("](docs/", "](")):
        text = text.replace(there, here)
    return re.sub(r"\[([^]]+)\]\((data/README\.md|CITATION\.cff|LICENSE)\)", r"\1", text)  # on no page of the site


def _gallery(drawn: bool) -> str:
    """The page; `on_pre_build` has set the drawing of its pictures going."""
    made = import_module("make_gallery")
    parts = ["# Gallery", "Drawn when the site is built, by the code below each picture."]
    parts += ["All of them draw into axes of yours as well (`axes=`). What they are made from:", _shown(made.SETUP)]
    for name, title, caption, code in made.PICTURES:
        picture = f'<img class="figure" src="gallery/{name}.png" alt="{title}" width="525">'
        parts += [f"## {title}", picture if drawn else "", f"*{caption}*", _shown(code)]
    return "\n\n".join(parts)


def _shown(code: str) -> str:
    return f"```py\n{code.strip()}\n```"


def notebook_sections() -> str:
    """Each notebook with its title, the first sentence below it, and a place for its pictures."""
    parts = []
    for path in NOTEBOOKS:
        text = "".join(json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"])
        title, _, rest = text.partition("\n")
        sentence = re.split(r"(?<=[.?])\s", " ".join(rest.split()), maxsplit=1)[0]
        link = f'<a href="notebooks/{path.name}" download><code>{path.name}</code></a>'
        parts += [f"## {title.lstrip('# 0123456789')}", f"{sentence} {link}"]
        parts.append(f'<div data-notebook="{path.stem}"></div>')
    return "\n\n".join(parts)


def benchmark_tables() -> str:
    """What the last run of each benchmark left, with its date."""
    text = (ROOT / "benchmarks" / "measured.md").read_text(encoding="utf-8")
    return re.sub("^#", "##", text.partition("\n")[2], flags=re.M).strip()


def command_tables() -> str:
    """Every command of `cddf` with an example, its arguments and its options."""
    import typer

    from cddf_jax.cli.app import app

    parts = []
    for name, command in typer.main.get_command(app).commands.items():
        rows = [_parameter_row(parameter) for parameter in command.params]
        example = ["", "```sh", command.epilog.removeprefix("Example: "), "```"] if command.epilog else []
        head = [f"## cddf {name}\n", command.help, *example, "", "| name | meaning |", "| --- | --- |"]
        parts.append("\n".join([*head, *rows]))
    return "\n\n".join(parts)


def _parameter_row(parameter: Any) -> str:
    names = ", ".join(f"`{name}`" for name in parameter.opts)
    kind = parameter.type_descriptor.annotation
    choices = " or ".join(f"`{choice}`" for choice in get_args(kind)) if get_origin(kind) is Literal else ""
    words = [parameter.help or "", choices and f"One of {choices}.", "Required." if parameter.required else ""]
    words.append(_default_in_words(parameter))
    return f"| {names} | {' '.join(filter(None, words))} |".replace("\n", " ")


def _default_in_words(parameter: Any) -> str:
    """As `--help` shows it; nothing for switches, and for what has no default."""
    if parameter.required or getattr(parameter, "is_flag", False) or parameter.show_default is False:
        return ""
    told = parameter.show_default if isinstance(parameter.show_default, str) else parameter.default
    return "" if told is None else f"Default: {told}."


# --- examples ---------------------------------------------------------------------------------------


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Hand Python to markdown-exec, run commands, and leave out pictures that are not there."""
    run = f'exec="on" session="{page.file.src_uri}" workdir="{WORK}"'
    blocks = re.compile(r"^```python *(\w*)\n(.*?)^```$", flags=re.M | re.S)
    markdown = blocks.sub(lambda m: _example(m[1], m[2], run), markdown)
    markdown = re.sub(r"^```console\n(.*?)^```$", lambda m: _console(m[1]), markdown, flags=re.M | re.S)
    if page.file.abs_src_path is None:
        return markdown
    folder = Path(page.file.abs_src_path).parent
    pictures = re.compile(r"^!\[.*?\]\((.*?)\).*$", flags=re.M)
    return pictures.sub(lambda m: m[0] if (folder / m[1]).exists() else "", markdown)


def _example(kind: str, code: str, run: str) -> str:
    """A block that is run: ```python is shown with what it prints, the others as their word says."""
    if kind == "hidden":  # only what it prints
        return f'```python {run} result="text"\n{code}```'
    if kind == "table":  # what it prints is Markdown
        return f'```python {run} idprefix=""\n{code}```'
    if kind == "figure":  # with the picture that its `axes` lie in
        shown = "from hooks import picture\nprint(picture(axes))"
        return f'```python {run} source="above"\n{code}```\n\n```python {run} html="on"\n{shown}\n```'
    result = 'result="text"' if "print(" in code else ""
    return f'```python {run} source="above" {result}\n{code}```'


def _console(block: str) -> str:
    """The commands of a block with what they print; one that ends in a backslash goes on in the next line."""
    shown = []
    for command in re.findall(r"^\$ (.*?[^\\])$", block, flags=re.M | re.S):
        shown += [f"$ {command}", _run(command)]
    return "```console\n" + "\n".join(shown) + "\n```"


def _run(command: str) -> str:
    """What `cddf` prints, in this process."""
    from cddf_jax import application
    from cddf_jax.cli import app as cli

    said, code = io.StringIO(), None
    with (
        contextlib.chdir(WORK),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        mock.patch.object(sys, "argv", shlex.split(command.replace("\\\n", " "))),
        mock.patch.object(application, "configure_jax"),
    ):
        try:
            cli.main()
        except SystemExit as ended:
            code = ended.code
    if code:
        log.warning("%s ended with %s: %s", command, code, said.getvalue())
    return said.getvalue().rstrip()


def picture(axes: Any) -> str:
    """The figure that some axes lie in, within the page."""
    axes.figure.savefig(WORK / "picture.svg", metadata={"Date": None})
    file = base64.b64encode((WORK / "picture.svg").read_bytes()).decode()
    width = round(150 * axes.figure.get_figwidth())
    words = "What the code above draws"
    return f'<p><img class="figure" alt="{words}" width="{width}" src="data:image/svg+xml;base64,{file}"></p>'


# --- formulas ---------------------------------------------------------------------------------------


def on_page_content(content: str, **_: Any) -> str:
    """LaTeX, as arithmatex marks it, into MathML; \\tag{n} becomes the number and the anchor eq-n."""
    content = re.sub(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', lambda m: _display(m[1]), content, flags=re.S)
    inline = r'<span class="arithmatex">\\\((.*?)\\\)</span>'
    return re.sub(inline, lambda m: _mathml(m[1], "inline"), content, flags=re.S)


def _mathml(latex: str, display: str) -> str:
    return convert(html.unescape(latex).strip(), display=display).replace(
        "<mi>&#x02032;", '<mi class="prime">&#x02032;'
    )


def _display(latex: str) -> str:
    number = re.search(r"\\tag\{(.*?)\}", latex)
    formula = _mathml(re.sub(r"\\tag\{.*?\}", "", latex), "block")
    if number is None:
        return f'<div class="equation">{formula}</div>'
    return f'<div class="equation" id="eq-{number[1]}">{formula}<span>({number[1]})</span></div>'
