"""`cddf cache`: the compiled programs that are kept for the next run."""

from typing import Annotated

import typer

from .options import AsJson, print_answer

EXAMPLE = "Example: cddf cache --empty"
MB = 1e6  # bytes


def cache(
    empty: Annotated[bool, typer.Option("--empty", help="Remove all kept programs.")] = False,
    as_json: AsJson = False,
) -> None:
    """The compiled programs that are kept on this machine, so that the next run starts sooner.

    The folder is limited in size; the programs that were used least recently are removed first. CDDF_PROGRAMS=off in
    the environment keeps none; CDDF_PROGRAMS=FOLDER keeps them elsewhere.
    """
    from ..programs import folder

    place = folder.folder()
    if place is None:
        print_answer("nothing is kept: CDDF_PROGRAMS is off", {"folder": None}, as_json=as_json)
        return
    removed = folder.empty() if empty else 0
    found = folder.entries()
    count, size = len(found), folder.size_of(found)
    text = f"{place}: {count} programs, {size / MB:.1f} MB of at most {folder.LARGEST / MB:.0f} MB"
    answer = {"folder": str(place), "programs": count, "bytes": size, "most_bytes": folder.LARGEST, "removed": removed}
    print_answer(f"{removed} removed; {text}" if empty else text, answer, as_json=as_json)
