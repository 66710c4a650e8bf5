"""Files that take their places complete or not at all, and folders that are tried before the work begins."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from ..errors import InputError

REMEDY = "choose another place"
TRIAL = 2**20  # bytes, about the size of a report


@contextmanager
def in_one_step(path: Path) -> Iterator[Path]:
    """A draft of a file or folder, which takes the place of the path when it is complete.

    The folder around it is made if it is missing.
    """
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        os.replace(draft, path)
    except OSError as error:
        raise InputError(error.strerror or str(error), where=str(path), remedy=REMEDY) from None
    finally:
        with suppress(OSError):
            shutil.rmtree(draft) if draft.is_dir() else draft.unlink(missing_ok=True)


def check_folder(folder: Path) -> None:
    """Refuse a folder into which nothing can be written, before long work whose result goes there.

    A file without a name is written in it, or where it would be made; nothing is left of it.
    """
    there = next(path for path in (folder, *folder.parents) if path.exists())
    try:
        with TemporaryFile(dir=there) as trial:
            trial.write(bytes(TRIAL))
    except OSError as error:
        raise InputError(error.strerror or str(error), where=str(there), remedy=REMEDY) from None
