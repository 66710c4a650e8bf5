"""`cddf cache`: what is kept is shown and emptied."""

import json

import pytest

from cddf_jax.programs import folder


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.setenv(folder.VARIABLE, str(tmp_path / "programs"))
    return tmp_path / "programs"


def test_it_is_shown_and_emptied(cddf_command, place):
    folder.write("key", folder.Entry({}, b"content"))
    size = (place / "key.program").stat().st_size
    code, out, err = cddf_command("cache", "--json")
    most = folder.LARGEST
    shown = {"folder": str(place), "programs": 1, "bytes": size, "most_bytes": most, "removed": 0}
    assert (code, json.loads(out), err) == (0, shown, "")
    code, out, _ = cddf_command("cache", "--empty")
    assert (code, out) == (0, f"1 removed; {place}: 0 programs, 0.0 MB of at most {most / 1e6:.0f} MB\n")
    assert not list(place.iterdir())


def test_an_empty_folder_and_none(cddf_command, place, monkeypatch):
    assert cddf_command("cache")[1].startswith(f"{place}: 0 programs, 0.0 MB")
    monkeypatch.setenv(folder.VARIABLE, "off")
    assert cddf_command("cache")[1] == "nothing is kept: CDDF_PROGRAMS is off\n"
