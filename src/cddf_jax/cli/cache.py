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

    JAX_COMPILATION_CACHE_DIR=FOLDER in the environment keeps them elsewhere; JAX_ENABLE_COMPILATION_CACHE=false keeps
    none.
    """
    from ..application import keep_programs

    folder = keep_programs()
    kept = [path for path in folder.glob("*-cache") if path.is_file()]  # the names that JAX gives
    size = sum(path.stat().st_size for path in kept)
    if empty:
        for path in kept:
            path.unlink(missing_ok=True)
    text = f"{folder}: {len(kept)} programs, {size / MB:.1f} MB" + (" removed" if empty else "")
    answer = {"folder": str(folder), "programs": len(kept), "bytes": size, "removed": empty}
    print_answer(text, answer, as_json=as_json)
