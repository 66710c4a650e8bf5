"""The built documentation: it needs no network, its links lead somewhere, and it names everything that is public."""

import re
import runpy
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
import typer
from places import ROOT

import cddf_jax as cddf
from cddf_jax.cli.app import app

pytestmark = pytest.mark.docs
LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src"}


class Page(HTMLParser):
    """What a page loads, where it leads, and the places in it that can be led to."""

    def __init__(self, path):
        super().__init__()
        self.path, self.loaded, self.links, self.ids, self.formulas = path, [], [], set(), 0
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given["id"]} if given.get("id") else set()
        self.formulas += tag == "math"
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev", "edit"):
            self.loaded.append(given["href"])
        elif tag in LOADED and given.get(LOADED[tag]):
            self.loaded.append(given[LOADED[tag]])
        elif tag == "a" and given.get("href"):
            self.links.append(given["href"])


@pytest.fixture(scope="module")
def site():
    """The pages by their place in the site."""
    folder = ROOT / "out" / "site"
    if not (folder / "index.html").is_file():
        pytest.fail("out/site: the documentation is not built; `make docs` builds and checks it")
    return {path.relative_to(folder).as_posix(): Page(path) for path in folder.rglob("*.html")}


def test_nothing_is_loaded_from_elsewhere(site):
    elsewhere = {url for page in site.values() for url in page.loaded if urlsplit(url).netloc}
    assert elsewhere == set()
    folder = site["index.html"].path.parent
    styles = "".join(path.read_text(encoding="utf-8") for path in folder.rglob("*.css"))
    assert re.findall(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", styles) == []


def test_what_is_loaded_and_linked_is_there(site):
    lost, places = [], {page.path.resolve(): page.ids for page in site.values()}
    for name, page in site.items():
        if name == "404.html":  # its addresses count from the server's root
            continue
        for url in page.loaded + page.links:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            target = (page.path.parent / unquote(parts.path)).resolve() if parts.path else page.path
            known = not parts.fragment or unquote(parts.fragment) in places.get(target.resolve(), set()) | {"__top"}
            if not target.is_file() or not known:
                lost.append(f"{name}: {url}")
    assert lost == []


def test_every_public_name_is_in_the_reference_with_its_docstring(site):
    reference = [page for name, page in site.items() if name.startswith("reference/")]
    places = set().union(*(page.ids for page in reference))
    assert [name for name in cddf.__all__ if f"cddf_jax.{name}" not in places] == []
    # without one, dataclasses and tuples have a docstring of their own making, which begins with their call
    assert [name for name in cddf.__all__ if (getattr(cddf, name).__doc__ or f"{name}(").startswith(f"{name}(")] == []


def test_every_command_and_option_is_in_the_reference(site):
    text = site["reference/command_line.html"].text
    for name, command in typer.main.get_group(app).commands.items():
        assert f'id="cddf-{name}"' in text
        assert [option for parameter in command.params for option in parameter.opts if option not in text] == []


def test_examples_end_in_the_numbers_that_they_name(site):
    # the closed form of the tip tension at 75 N, and the tip of the exact kinematics: docs/theory.md (16)
    assert "45.1229" in site["index.html"].text
    assert "(117.344, 60.282) mm" in site["index.html"].text
    # what was simulated, data/README.md: tensions alone tell mu / E = 0.42 / 1.4e6 only
    assert "friction_coefficient / youngs_modulus = 3.0" in site["identifiability.html"].text
    # NIST, Misra1a.dat
    assert "b1 238.94212" in site["reference/fitting.html"].text


def test_the_gallery_is_drawn(site):
    pictures = runpy.run_path(str(ROOT / "docs" / "make_gallery.py"))["PICTURES"]
    drawn = {path.stem: path for path in (site["gallery.html"].path.parent / "gallery").iterdir()}
    assert set(drawn) == {picture.name for picture in pictures}
    assert all(path.stat().st_size > 1000 for path in drawn.values())


def test_formulas_are_mathml_and_numbered(site):
    theory = site["theory.html"]
    assert theory.formulas > 60
    assert {f"eq-{n}" for n in range(1, 20)} <= theory.ids
    assert "arithmatex" not in theory.text
