"""`cddf cache`: what is kept is shown and emptied."""

import json

import pytest

from cddf_jax import application


def test_it_is_shown_and_emptied(cddf_command, tmp_path, monkeypatch):
    monkeypatch.setattr(application, "keep_programs", lambda: tmp_path)
    for name in ("jit_f-1-cache", "jit_g-2-cache", "of_somebody_else"):
        (tmp_path / name).write_bytes(bytes(60_000))
    code, out, err = cddf_command("cache", "--json")
    shown = {"folder": str(tmp_path), "programs": 2, "bytes": 120_000, "removed": False}
    assert (code, json.loads(out), err) == (0, shown, "")
    assert cddf_command("cache", "--empty")[:2] == (0, f"{tmp_path}: 2 programs, 0.1 MB removed\n")
    assert [path.name for path in tmp_path.iterdir()] == ["of_somebody_else"]


@pytest.mark.parametrize("arguments", [(), ("--empty",)])
def test_a_folder_that_is_not_there_is_empty(cddf_command, tmp_path, monkeypatch, arguments):
    monkeypatch.setattr(application, "keep_programs", lambda: tmp_path / "none")
    assert cddf_command("cache", *arguments)[1].startswith(f"{tmp_path / 'none'}: 0 programs, 0.0 MB")
