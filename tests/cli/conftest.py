"""Fixtures of the tests of the command line."""

import json

import pytest
from bodies import paper_body

from cddf_jax.files.manipulator_file import write_manipulator


@pytest.fixture
def answer_of(cddf_command):
    """The one JSON object on standard output of a command that succeeds."""

    def run(*arguments):
        code, out, err = cddf_command(*arguments, "--json")
        assert (code, err) == (0, "")
        assert out.startswith("{")
        return json.loads(out, parse_constant=lambda constant: pytest.fail(constant))

    return run


@pytest.fixture
def fails(cddf_command, tmp_path, monkeypatch):
    """Run in an empty folder; the command must end in one line on standard error, and write nothing."""
    monkeypatch.chdir(tmp_path)

    def content():
        return {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}

    def run(*arguments, code=2, files=None):
        for name, text in (files or {}).items():
            (tmp_path / name).write_text(text)
        before = content()
        ended, out, err = cddf_command(*arguments)
        assert (ended, out) == (code, "")
        assert err.startswith("error: ")
        assert err.endswith("\n")
        assert err.count("\n") == 1
        assert "Traceback" not in err
        assert content() == before
        return err.removeprefix("error: ").rstrip("\n")

    return run


@pytest.fixture(scope="module")
def two_tendons(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.toml"
    write_manipulator(paper_body("exact", num_tendons=2), path)
    return path
