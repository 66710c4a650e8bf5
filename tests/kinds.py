"""What may be of several kinds, as the one kind that a test expects."""

from collections.abc import Callable
from typing import Any, TypeVar

from scipy.optimize import brentq

from cddf_jax.identification.bench import Bench, experiment_of

Kind = TypeVar("Kind")


def of_kind(kind: type[Kind], value: object) -> Kind:
    assert isinstance(value, kind)
    return value


def bench_of(*arguments: Any, **options: Any) -> Bench:
    """A table of the manipulator as the model takes it."""
    return of_kind(Bench, experiment_of(*arguments, **options))


def root_of(function: Callable[[float], Any], low: float, high: float, **tolerances: Any) -> float:
    """As `brentq` has it, which can return more than the root."""
    found: Any = brentq(function, low, high, **tolerances)
    return found
