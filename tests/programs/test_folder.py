"""The folder of kept programs: the user's own, limited in size, shown and emptied."""

import os
import stat
import sys

import pytest

from cddf_jax.programs import folder

ENTRY = folder.Entry({"a": [1, None]}, b"content \n of bytes")


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.setenv(folder.VARIABLE, str(tmp_path / "programs"))
    return tmp_path / "programs"


def test_what_was_written_is_read(place):
    folder.write("key", ENTRY)
    assert folder.read("key") == ENTRY
    assert folder.read("another") is None
    assert [path.name for path in place.iterdir()] == ["key.program"]


@pytest.mark.skipif(sys.platform == "win32", reason="modes of folders are those of Unix")
def test_only_its_owner_may_look_into_it(place):
    folder.write("key", ENTRY)
    assert stat.S_IMODE(place.stat().st_mode) == 0o700


@pytest.mark.skipif(sys.platform != "linux", reason="XDG_CACHE_HOME names the user's cache folder on Linux")
def test_it_is_in_the_cache_of_the_user(tmp_path, monkeypatch):
    monkeypatch.delenv(folder.VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder.folder() == tmp_path / "cddf_jax" / "programs"


def test_switched_off(monkeypatch):
    monkeypatch.setenv(folder.VARIABLE, "off")
    folder.write("key", ENTRY)
    assert folder.folder() is None
    assert folder.read("key") is None
    assert folder.entries() == []


def test_those_used_least_recently_go_first(place, monkeypatch):
    for i, key in enumerate("abc"):
        folder.write(key, ENTRY)
        os.utime(place / f"{key}.program", (i, i))
    assert folder.read("a") == ENTRY  # used just now
    monkeypatch.setattr(folder, "LARGEST", 3 * (place / "a.program").stat().st_size)
    folder.write("d", ENTRY)
    assert {path.stem for path in folder.entries()} == {"a", "c", "d"}


def test_it_is_emptied(place):
    folder.write("key", ENTRY)
    (place / "key.1234.tmp").write_bytes(b"half")  # of a process that was killed
    assert folder.size_of(folder.entries()) > 4
    assert folder.empty() == 2
    assert folder.entries() == []
