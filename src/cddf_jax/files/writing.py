"""Results written to files: all of a set or none, and never half of one."""

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..batch.drafts import in_one_step
from ..errors import in_utf8

# a value of JSON; a recursive type cannot be checked at run time
JsonValue: TypeAlias = dict[str, Any] | list[Any] | str | bool | int | float | None


def write_all(folder: str | Path, contents: Mapping[str, str | bytes]) -> None:
    """Write several files into a folder, which is made if it is missing.

    The files take their places only when all are complete, each in one step. If something fails before, the old files
    stay. Text is written as UTF-8.
    """
    with ExitStack() as files:
        for name, content in contents.items():
            draft = files.enter_context(in_one_step(Path(folder, name)))
            draft.write_bytes(in_utf8(content).encode() if isinstance(content, str) else content)


def as_json(value: object) -> str:
    """JSON text of a result that may hold arrays; infinity and NaN become null."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n"


def plain(value: object) -> JsonValue:
    """The same result in the types of JSON; named tuples and dataclasses become dictionaries of their fields."""
    match value:
        case str():
            return in_utf8(value)
        case bool() | int() | None:
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case Mapping():
            return {in_utf8(key): plain(item) for key, item in value.items()}
        case tuple() if (as_dict := getattr(value, "_asdict", None)) is not None:
            return plain(as_dict())
        case list() | tuple():
            return [plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return plain(np.asarray(value).tolist())


def picked(what: object, names: Iterable[str]) -> dict[str, object]:
    """Some attributes of an object, by name."""
    return {name: getattr(what, name) for name in names}


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]], right: Collection[str] = ()) -> list[str]:
    """The lines of a table in Markdown; the columns named in `right` are aligned to the right."""
    rules = ["---:" if name in right else "---" for name in head]
    escaped = ([cell.replace("|", "\\|") for cell in cells] for cells in (head, rules, *rows))
    return [f"| {' | '.join(cells)} |" for cells in escaped]
