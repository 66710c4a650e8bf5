"""The command `cddf`: options in, words out; the work is done by the other rooms."""

import sys

from ..errors import InputError, needed


def command() -> None:
    """Run the command line, if the extra `cli` is installed."""
    try:
        needed("typer", "cli")
    except InputError as error:
        sys.exit(f"error: {error}")
    from .app import main

    main()
