"""Files that take their places complete or not at all, and places that are tried before the work begins."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError

REMEDY = "choose another place"
TRIAL = 2**20  # bytes, about the size of a report


@contextmanager
def in_one_step(path: Path) -> Iterator[Path]:
    """A draft of a file or folder, which takes the place of the path when it is complete.

    The folder around it is made if it is missing, and removed again if nothing came into it.
    """
    with _draft(path) as draft:
        yield draft
        os.replace(draft, path)


def check_writable(path: Path) -> None:
    """Refuse a path at which no file can be written, before long work whose result goes there.

    A file is written beside it and removed, with the folders that were made for it.
    """
    if path.is_dir():
        raise InputError("is a folder; give the name of a file", where=str(path))
    with _draft(path) as draft:
        draft.write_bytes(bytes(TRIAL))


@contextmanager
def _draft(path: Path) -> Iterator[Path]:
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        os.fsencode(draft)
    except UnicodeEncodeError:
        raise InputError("no file can have this name here", where=str(path), remedy="set a locale of UTF-8") from None
    missing = [folder for folder in path.parents if not os.path.lexists(folder)]
    for folder in path.parents[len(missing) :]:
        if not os.path.isdir(folder):
            raise InputError("is a file, and a folder is needed there", where=str(folder), remedy=REMEDY)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
    except OSError as error:
        raise InputError(error.strerror or str(error), where=str(path), remedy=REMEDY) from None
    finally:
        with suppress(OSError):
            shutil.rmtree(draft) if draft.is_dir() else draft.unlink(missing_ok=True)
        for folder in missing:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
