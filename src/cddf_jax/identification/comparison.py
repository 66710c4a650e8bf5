"""Which model explains the data best, by information criteria.

It compares several fits of the same tables, for instance with and without drag, or with and without errors of cells.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import InputError
from .fit import Fit


@dataclass(frozen=True)
class Comparison:
    """One model among others. Lower criteria are better."""

    name: str  # as it was given
    num_parameters: int  # including the estimated noise
    AIC: float  # Akaike's criterion
    BIC: float  # Schwarz's criterion
    success: bool  # whether the fit succeeded


def compare(fits: Mapping[str, Fit]) -> list[Comparison]:
    """Compare fits of the same tables; the one with the least AIC comes first.

    Raises:
        InputError: for fewer than two fits, or fits of different data.
    """
    if len(fits) < 2:
        raise InputError("compare: needs two fits or more, by name")
    checksums = {name: [table.checksum for table in fit.tables] for name, fit in fits.items()}
    first, *others = checksums.items()
    for name, found in others:
        if found != first[1]:
            raise InputError(f"compare: {name!r} was fitted to other data than {first[0]!r}; fit the same tables")
    found = [
        Comparison(name, fit.num_estimated, **fit.information_criteria, success=fit.success)
        for name, fit in fits.items()
    ]
    return sorted(found, key=lambda comparison: comparison.AIC)
