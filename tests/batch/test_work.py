"""Nothing of a sweep is lost and nothing depends on who computes it: chunks, devices, processes, kills, a full disk.

The expected values are those of the same sweep in one piece; its numbers are checked in test_sweep.py.
"""

import errno
import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import paper_body
from places import ROOT
from refusals import refused
from sweep_child import axes

import cddf_jax as cddf

xarray = pytest.importorskip("xarray")
zarr = pytest.importorskip("zarr")

SOLVES = 500
SAME = 1e-12  # other lanes side by side: the compiler may order the same operations otherwise
OPTIONS: dict[str, Any] = {"outputs": ("tip_tension", "tip_position")}
STORED = (*OPTIONS["outputs"], "successful", "result")
CHILD = ROOT / "tests" / "sweep_child.py"


@pytest.fixture(scope="module")
def plain():
    return cddf.sweep(paper_body(), axes(SOLVES), **OPTIONS)


def same(found, expected, rtol=SAME):
    assert list(found.data_vars) == list(expected.data_vars)
    for name in expected.variables:
        assert found[name].dims == expected[name].dims
        if expected[name].dtype.kind == "f":
            np.testing.assert_allclose(found[name], expected[name], rtol=rtol, atol=0)
        else:
            np.testing.assert_array_equal(found[name].values, expected[name].values)
        assert found[name].attrs == expected[name].attrs


def start(compiler=None, **asked):
    environment = dict(os.environ) if compiler is None else {**os.environ, "XLA_FLAGS": compiler}
    command = [sys.executable, str(CHILD), json.dumps({"solves": SOLVES, **asked})]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(child):
    out, err = child.communicate(timeout=300)
    assert child.returncode == 0, err[-2000:]
    return out


def whole_chunks(path):
    """The files that say of a chunk that it is whole."""
    return list((path / "result").glob("c/*/*"))


# --- chunks -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A store of ten chunks."""
    path = tmp_path_factory.mktemp("stored") / "s.zarr"
    cddf.sweep(paper_body(), axes(SOLVES), out=path, chunk=50, **OPTIONS)
    return path


@pytest.fixture
def copied(stored, tmp_path):
    return Path(shutil.copytree(stored, tmp_path / "s.zarr"))


def test_chunks_change_nothing_and_a_store_opens_anywhere(plain, stored):
    same(cddf.sweep(paper_body(), axes(SOLVES), chunk=170, **OPTIONS), plain)
    found = xarray.open_zarr(stored, chunks=None, consolidated=False)
    same(found[list(OPTIONS["outputs"])], plain[list(OPTIONS["outputs"])])


def test_coordinates_of_samples_are_coordinates_in_the_store(tmp_path):
    samples = cddf.latin_hypercube({"base_tension": (5.0, 85.0), "youngs_modulus": (1e6, 2e6)}, 20)
    kept = cddf.sweep(paper_body(), {"sample": samples}, **OPTIONS)
    stored = cddf.sweep(paper_body(), {"sample": samples}, out=tmp_path / "s.zarr", **OPTIONS)
    assert set(stored.coords) == set(kept.coords)
    same(stored, kept)


# --- devices and processes --------------------------------------------------------------------------


@pytest.mark.slow
def test_devices_change_nothing(plain, tmp_path):
    """Four devices here (conftest), two in a process of its own; the compiler's options differ as well."""
    path = tmp_path / "s.zarr"
    ended(start(compiler="", out=str(path), devices=2))
    same(cddf.sweep(paper_body(), axes(SOLVES), out=path, **OPTIONS), plain)


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.mark.slow
def test_processes_share_the_work(plain, tmp_path):
    path = tmp_path / "s.zarr"
    common = {"out": str(path), "chunk": 50, "processes": 2, "port": free_port()}
    children = [start(rank=rank, **common) for rank in range(2)]
    told = {ended(child).splitlines()[-1] for child in children}  # gloo chats before
    assert len(told) == 1  # every process comes back with all of it
    same(cddf.sweep(paper_body(), axes(SOLVES), out=path, **OPTIONS), plain)


@pytest.mark.slow
def test_a_process_that_cannot_open_the_store_stops_the_others_too(tmp_path):
    """It is told another path, which is a folder: both end at once, each says why, and neither waits for the other."""
    (tmp_path / "folder").mkdir()
    common = {"processes": 2, "port": free_port()}
    children = [start(out=str(tmp_path / out), rank=rank, **common) for rank, out in enumerate(("s.zarr", "folder"))]
    said = [child.communicate(timeout=300)[1].splitlines()[-1] for child in children]
    assert [child.returncode for child in children] == [1, 1]
    assert said[0].endswith("s.zarr: another process could not use the store, and says why")
    assert said[1].endswith("folder exists and was not written by cddf_jax; give another path, or delete it")


# --- stopped and started again ----------------------------------------------------------------------


def stopped_at(patched, last, error):
    """Every write of an array of the store from the `last` one on fails."""
    count, write = itertools.count(1), zarr.Array.__setitem__

    def stopped(array, region, values):
        if array.name.strip("/") in STORED and next(count) >= last:
            raise error
        write(array, region, values)

    patched.setattr(zarr.Array, "__setitem__", stopped)


def test_stopped_at_any_write_it_goes_on_where_it_was(plain, tmp_path, monkeypatch):
    """Stopped at the 1st, 4th and 11th write of an array, at last by a full disk; test_killed_at_a_random_time kills
    a real process."""
    path, kept = tmp_path / "s.zarr", {}
    full = pytest.raises(OSError, match="No space left on device")
    for last, error, said in (
        (1, KeyboardInterrupt(), pytest.raises(KeyboardInterrupt)),
        (4, KeyboardInterrupt(), pytest.raises(KeyboardInterrupt)),
        (11, OSError(errno.ENOSPC, "No space left on device"), full),
    ):
        with monkeypatch.context() as patched, said:
            stopped_at(patched, last, error)
            cddf.sweep(paper_body(), axes(SOLVES), out=path, chunk=50, **OPTIONS)
        assert all(file.stat().st_mtime_ns == written for file, written in kept.items())  # not computed again
        kept = {file: file.stat().st_mtime_ns for file in whole_chunks(path)}
    assert len(kept) == 2  # four arrays a chunk: three writes make none, ten more two
    same(cddf.sweep(paper_body(), axes(SOLVES), out=path, **OPTIONS), plain)
    assert all(file.stat().st_mtime_ns == written for file, written in kept.items())


@pytest.mark.slow
def test_killed_at_a_random_time_it_goes_on_where_it_was(plain, tmp_path):
    path, rng = tmp_path / "s.zarr", np.random.default_rng(int.from_bytes(os.urandom(4)))
    child, wanted = start(out=str(path), chunk=1), rng.integers(1, 400)  # of 500 chunks of one solve
    while child.poll() is None and len(whole_chunks(path)) < wanted:
        time.sleep(0.001)
    child.send_signal(signal.SIGKILL)
    child.communicate()
    kept = {file: file.stat().st_mtime_ns for file in whole_chunks(path)}
    assert kept
    same(cddf.sweep(paper_body(), axes(SOLVES), out=path, **OPTIONS), plain)
    assert all(file.stat().st_mtime_ns == written for file, written in kept.items())  # what was whole stays
    assert len(whole_chunks(path)) == SOLVES


@pytest.mark.parametrize("damage", ["missing", "empty", "scrambled", "short"])
def test_a_chunk_that_is_not_whole_is_computed_again(plain, copied, damage):
    """A file that is empty, or holds rubbish, is what a power cut leaves."""
    chunk = copied / "tip_tension" / "c" / "3" / "0" / "0"
    whole = chunk.read_bytes()
    if damage == "missing":
        chunk.unlink()
    else:
        chunk.write_bytes({"empty": b"", "scrambled": b"\0" * len(whole), "short": whole[: len(whole) // 2]}[damage])
    same(cddf.sweep(paper_body(), axes(SOLVES), out=copied, **OPTIONS), plain)
    assert len(chunk.read_bytes()) == len(whole)


def test_a_chunk_in_which_all_solves_failed_is_not_computed_again(tmp_path):
    """All its numbers are those of a chunk that is missing."""
    over = {"base_tension": [10.0, -1.0]}
    cddf.sweep(paper_body(), over, out=tmp_path / "s.zarr", chunk=1, **OPTIONS)
    (tmp_path / "s.zarr" / "tip_tension" / "c" / "1" / "0").unlink()  # begun again in a store that is there
    for _ in range(2):
        cddf.sweep(paper_body(), over, out=tmp_path / "s.zarr", chunk=1, **OPTIONS)
        assert {len(list((tmp_path / "s.zarr" / name / "c").iterdir())) for name in STORED} == {2}


def test_a_store_without_one_of_its_arrays_is_said_to_be_damaged(copied):
    (copied / "tip_position" / "zarr.json").unlink()
    with pytest.raises(cddf.InputError, match=r"s\.zarr is damaged: its array 'tip_position' cannot be read"):
        cddf.sweep(paper_body(), axes(SOLVES), out=copied, **OPTIONS)


def test_how_far_it_is(tmp_path, capfd, said):
    """The second time all solves are there before it begins."""
    for _ in range(2):
        with cddf.show_progress():
            cddf.sweep(paper_body(), axes(SOLVES), out=tmp_path / "s.zarr", chunk=50, **OPTIONS)
    told = [(stage.what, stage.before, stage.done, stage.total) for stage in said]
    assert told == [("solving", 0, SOLVES, SOLVES), ("solving", SOLVES, SOLVES, SOLVES)]
    assert capfd.readouterr() == ("", "")


# --- refusals ---------------------------------------------------------------------------------------

OTHERS = {
    "body": ({"body": {"youngs_modulus": 1.5e6}}, "its youngs_modulus is 1400000.0, not 1500000.0"),
    "axis": ({"solves": 250}, "its axis base_tension is"),
    "outputs": ({"outputs": ["tip_angle"]}, "its outputs is"),
    "nodes": ({"nodes": 12}, "its nodes is 16, not 12"),
    "a number more": ({"body": {"drag": 1.0}}, 'its drag is "missing", not 1.0'),
}


@pytest.mark.parametrize("other", OTHERS)
def test_a_store_of_another_sweep_is_refused(stored, other):
    changes, message = OTHERS[other]
    options = OPTIONS | {name: value for name, value in changes.items() if name not in ("body", "solves")}
    before = sorted(file.stat().st_mtime_ns for file in stored.rglob("*"))
    asked = paper_body(**changes.get("body", {})), axes(changes.get("solves", SOLVES))
    said = refused(cddf.sweep, *asked, out=stored, **options)
    assert "holds other work" in said
    assert message in said
    assert before == sorted(file.stat().st_mtime_ns for file in stored.rglob("*"))


@pytest.mark.parametrize("kind", ["file", "folder", "json"])
def test_what_is_no_store_is_left_alone(tmp_path, kind):
    path = tmp_path / "s.zarr"
    if kind == "file":
        path.write_text("mine")
    elif kind == "folder":
        path.mkdir()
        (path / "mine.txt").write_text("mine")
    else:
        zarr.create_group(path, attributes={"identity": "no json"})
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(cddf.InputError, match=r"s\.zarr exists and was not written by cddf_jax; give another path"):
        cddf.sweep(paper_body(), axes(SOLVES), out=path, **OPTIONS)
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


def test_a_package_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(cddf.InputError, match=r"needs zarr; install it with: pip install 'cddf-jax\[sweep\]'"):
        cddf.sweep(paper_body(), axes(SOLVES), out="anywhere", **OPTIONS)


# --- memory -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_is_bounded_for_any_size(tmp_path):
    """28 chunks of 50,000 solves, 216 MB, in a process that may take 120 MB more than two of them have taken."""
    asked = {"solves": 1_400_000, "outputs": ["tip_tension", "curvature"], "limit": 120_000_000}
    told = ended(start(compiler="", out=str(tmp_path / "s.zarr"), **asked)).split()
    assert told[1] == "1400000"
