"""Results written to files: all of a set or none, and never half of one."""

import json
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def write_all(folder: str | Path, contents: Mapping[str, str | bytes]) -> list[Path]:
    """Write several files into a folder, which is made if it is missing.

    Every file is first written under a temporary name beside its place; only when all are complete
    do they take their places, each in one step. A failure before that leaves what was there.

    Args:
        folder: where the files go.
        contents: text (written as UTF-8) or bytes by file name.

    Returns:
        The paths in the order of `contents`.

    Raises:
        OSError: when the folder cannot be made or written to.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    suffix = f".{secrets.token_hex(4)}.tmp"
    places = {folder / name: folder / f".{name}{suffix}" for name in contents}
    try:
        for temporary, content in zip(places.values(), contents.values(), strict=True):
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        for place, temporary in places.items():
            os.replace(temporary, place)
    finally:
        for temporary in places.values():
            temporary.unlink(missing_ok=True)
    return list(places)


def as_json(value: Any) -> str:
    """JSON text of a result that may hold arrays; what is infinite or NaN becomes null."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n"


def plain(value: Any) -> Any:
    """The same result in what JSON knows: dictionaries, lists, text, numbers and None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (str, bool, int)) or value is None:
        return value
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return plain(np.asarray(value).tolist())
