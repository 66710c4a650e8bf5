"""The error for bad input."""


class InputError(ValueError):
    """What a person typed or a file holds cannot be used; the message is one line with the remedy."""
