"""The folder in which programs are kept. It belongs to the user alone, and is limited in size.

The programs that were used least recently are removed first. Every file has a checksum. If the folder cannot be used,
nothing is kept.
"""

import hashlib
import json
import logging
import os
import secrets
import stat
from pathlib import Path
from typing import Any, NamedTuple

VARIABLE = "CDDF_PROGRAMS"  # of the environment: "off", or another folder
OFF = "off"
LARGEST = 512 * 2**20  # bytes of all files together
SUFFIX = ".program"
MAGIC = b"cddf_jax program 1\n"
LOG = logging.getLogger("cddf_jax.programs")


class Entry(NamedTuple):
    """A kept program."""

    about: dict[str, Any]  # JSON
    content: bytes


def is_off() -> bool:
    """Whether keeping is switched off."""
    return os.environ.get(VARIABLE, "").lower() == OFF


def folder() -> Path | None:
    """Where programs are kept; None if that is switched off."""
    if is_off():
        return None
    if place := os.environ.get(VARIABLE):
        return Path(place)
    from platformdirs import user_cache_dir

    return Path(user_cache_dir("cddf_jax")) / "programs"


def read(key: str) -> Entry | None:
    """The entry of a key; None if there is none that is complete and the user's own."""
    try:
        place = _usable_folder(make=False)
        if place is None or not (path := place / f"{key}{SUFFIX}").exists():
            return None
        entry = _decoded(key, path.read_bytes())
        os.utime(path)  # used just now
        return entry
    except (OSError, ValueError, KeyError) as error:
        LOG.debug("%s cannot be read: %s", key, error)
        return None


def write(key: str, entry: Entry) -> None:
    """Keep an entry, in one step, so that no process reads a part of it."""
    try:
        place = _usable_folder(make=True)
        if place is None:
            return
        draft = place / f"{key}.{secrets.token_hex(4)}.tmp"
        try:
            draft.write_bytes(_encoded(key, entry))
            draft.replace(place / f"{key}{SUFFIX}")
        finally:
            draft.unlink(missing_ok=True)
        _make_room()
    except OSError as error:
        LOG.debug("%s cannot be kept: %s", key, error)


def entries() -> list[Path]:
    """All files that are kept, the least recently used first."""
    place = folder()
    try:
        found = [path for path in place.iterdir() if path.suffix in (SUFFIX, ".tmp")] if place else []
        return sorted(found, key=lambda path: path.stat().st_mtime)
    except OSError:  # no such folder, or another process removes files just now
        return []


def size_of(paths: list[Path]) -> int:
    """The size of some files, bytes; files that are gone count as 0."""
    total = 0
    for path in paths:
        try:
            total += path.stat().st_size
        except OSError:
            continue
    return total


def empty() -> int:
    """Remove all files; return their number."""
    found = entries()
    for path in found:
        path.unlink(missing_ok=True)
    return len(found)


def _usable_folder(*, make: bool) -> Path | None:
    """The folder, if it is this user's and no other can write there: programs are machine code."""
    place = folder()
    if place is None:
        return None
    if make:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
    if not place.is_dir():
        return None
    status = place.stat()
    if hasattr(os, "getuid"):  # not on Windows, whose cache folder is the user's own
        if status.st_uid != os.getuid():
            raise PermissionError(f"{place} belongs to another user")
        if stat.S_IMODE(status.st_mode) & 0o077:
            raise PermissionError(f"{place} is open to others; allow it to its owner alone (chmod 700)")
    return place


def _encoded(key: str, entry: Entry) -> bytes:
    about = json.dumps({"key": key, "size": len(entry.content), **entry.about}).encode()
    rest = about + b"\n" + entry.content
    return MAGIC + hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest


def _decoded(key: str, data: bytes) -> Entry:
    """The entry that `_encoded` wrote.

    Raises:
        ValueError: for damaged bytes, or those of another key.
    """
    digest, _, rest = data.removeprefix(MAGIC).partition(b"\n")
    if not data.startswith(MAGIC) or hashlib.sha256(rest).hexdigest().encode() != digest:
        raise ValueError("damaged, or not a program of cddf_jax")
    line, _, content = rest.partition(b"\n")
    about = json.loads(line)
    if about.pop("key") != key or about.pop("size") != len(content):
        raise ValueError("the program of another key")
    return Entry(about, content)


def _make_room() -> None:
    paths = entries()
    surplus = size_of(paths) - LARGEST
    for path in paths:
        if surplus <= 0:
            return
        surplus -= size_of([path])
        path.unlink(missing_ok=True)
