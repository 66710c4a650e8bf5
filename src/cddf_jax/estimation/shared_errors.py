"""Errors of the inputs of a model, such as tensions that a cell reads: each of them moves several data at once.

To first order the data have the covariance S (1 + A A^T) S. S is diagonal, the noise of the data. A is what one
standard deviation of each input does to the data, over S. Residuals and derivatives are multiplied by the symmetric
inverse square root of 1 + A A^T. Then they are independent, and each still belongs to its datum.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, PyTree

from .parameter_space import Numbers


class Inputs(NamedTuple):
    """Inputs that were read with errors, by groups with one standard deviation each."""

    slopes: Callable[[PyTree], Mapping[str, Mapping[str, np.ndarray]]]
    # from parameters: by input group and group of data, (data, inputs), the derivative of the data by each input, times
    # its standard deviation over that of the group
    sigma: Mapping[str, float | None]  # by input group; None: it is estimated
    largest: Mapping[str, float]  # by input group, of an estimate


class Shared(NamedTuple):
    """The errors of inputs in the data, of all groups one after the other."""

    basis: Float[Numbers, "data inputs"]  # B, with orthogonal columns: (1 + A A^T)^(-1/2) = 1 - B B^T
    columns: dict[str, Float[Numbers, "data inputs"]]  # A, by input group
    deviation: dict[str, Float[Numbers, ""]]  # of an input, by input group

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray], deviation: Mapping[str, float], data: int) -> "Shared":
        """From A by input group."""
        basis = np.concatenate([np.zeros((data, 0)), *columns.values()], axis=1)
        if np.any(basis):
            square, directions = np.linalg.eigh(basis.T @ basis)
            left = 1 / np.sqrt(1 + np.maximum(square, 0.0))
            basis = basis @ directions * (left / np.sqrt(1 + left))
        return cls(basis, dict(columns), {name: np.asarray(value, float) for name, value in deviation.items()})

    def whitened(self, rows: Any) -> Any:
        """The rows, (data, ...), over the noise of the data, without what the data have in common."""
        return rows - self.basis @ (self.basis.T @ rows) if self.basis.shape[1] else rows

    def unwhitened(self, rows: np.ndarray) -> np.ndarray:
        """The rows from whitened ones."""
        if not self.basis.shape[1]:
            return rows
        return rows + np.asarray(self.basis / (1 - np.sum(self.basis**2, axis=0))) @ (self.basis.T @ rows)

    def at(self, kept: np.ndarray) -> "Shared":
        """Of some of the data."""
        columns = {name: np.asarray(own)[kept] for name, own in self.columns.items()}
        return Shared.of(columns, {name: float(own) for name, own in self.deviation.items()}, int(np.sum(kept)))

    @property
    def inverse(self) -> np.ndarray:
        """(data, data), the inverse of 1 + A A^T."""
        return self.whitened(self.whitened(np.eye(len(self.basis))))

    @property
    def kept(self) -> np.ndarray:
        """(data,), the diagonal of the inverse of 1 + A A^T."""
        square = np.asarray(self.basis) ** 2
        return 1 - square @ (2 - np.sum(square, axis=0))

    @property
    def log_determinant(self) -> float:
        """Of 1 + A A^T."""
        return -2 * float(np.sum(np.log1p(-np.sum(np.asarray(self.basis) ** 2, axis=0))))


def no_inputs(data: int) -> Shared:
    """Without errors of inputs."""
    return Shared(np.zeros((data, 0)), {}, {})
