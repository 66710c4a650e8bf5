"""The residuals of a fit: what a model predicts less what was observed, and the parameters less what was known.

Inputs of the model that were read with errors, such as tensions, move several data at once. To first order the data
have the covariance S (1 + A A^T) S. S is diagonal, the noise of the data. A is what one standard deviation of each
input does to the data, over S. Residuals and derivatives are multiplied by the symmetric inverse square root of
1 + A A^T. Then they are independent, and each still belongs to its datum.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..errors import InputError
from .parameter_space import Numbers, ParameterSpace, Prior


class InputErrors(NamedTuple):
    """Inputs that were read with errors, by groups with one standard deviation each."""

    slopes: Callable[[PyTree], Mapping[str, Mapping[str, np.ndarray]]]
    # from parameters: by input group and group of data, (data, inputs), the derivative of the data by each input, times
    # its standard deviation over that of the group
    sigma: Mapping[str, float | None]  # by input group; None: it is estimated
    largest: Mapping[str, float]  # by input group, of an estimate


NO_ERRORS = InputErrors(lambda _: {}, {}, {})


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


class Data(NamedTuple):
    """The data of a fit."""

    values: tuple[Numbers, ...]  # by group
    noise: tuple[Numbers, ...]  # standard deviations, of the shapes of the values
    prior: dict[int, Prior]  # by parameter


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    """A model, its data, and what is known of its parameters."""

    predict: Callable[[PyTree], PyTree]
    unravel: Callable[[Any], PyTree] = field(metadata={"static": True})  # of `ravel_pytree`: equal ones share programs
    groups: tuple[str, ...] = field(metadata={"static": True})  # of the data
    data: Data
    shared: Shared  # errors of inputs in the data
    space: ParameterSpace
    max_steps: int = field(metadata={"static": True})  # of a search
    # in standard errors: a search need not come closer to the minimum
    accuracy: float = field(default=0.0, metadata={"static": True})

    def residual(self, z: Float[Numbers, " n"], held: Float[Numbers, " n"]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors.

        Where inputs have errors, the data are whitened, see `Shared`.
        """
        parameters = self.parameters(z, held)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        values, noise, prior = self.data
        sizes, wanted = [jnp.size(p) for p in predicted], [np.size(v) for v in values]
        if sizes != wanted:
            raise InputError(f"predict gives arrays of {sizes} numbers where the data have {wanted}")
        groups = zip(predicted, values, noise, strict=True)
        rows = jnp.concatenate([jnp.ravel((jnp.reshape(p, jnp.shape(v)) - v) / s) for p, v, s in groups])
        rows = self.shared.whitened(rows)
        pulls = [(parameters[i] - one.mean) / one.standard_deviation for i, one in prior.items()]
        return jnp.concatenate([rows, jnp.stack(pulls)]) if pulls else rows

    def parameters(self, z: Float[Numbers, " n"], held: Float[Numbers, " n"]) -> Float[Array, " n"]:
        """The parameters at z; `held` is NaN where they are free."""
        return jnp.where(jnp.isnan(held), self.space.parameters(z), held)

    @property
    def noteworthy(self) -> float:
        """The fall of the cost, relative to it, that moves the estimates by `accuracy`."""
        return self.accuracy**2 / self.num_data

    @property
    def num_data(self) -> int:
        """The number of data, without the rows of the priors."""
        return sum(np.size(v) for v in self.data.values)

    def unwhitened(self, rows: np.ndarray) -> np.ndarray:
        """The rows of the data as they are without errors of inputs, and then those of the priors."""
        return np.concatenate([self.shared.unwhitened(rows[: self.num_data]), rows[self.num_data :]])

    def by_group(self, rows: np.ndarray) -> list[np.ndarray]:
        """An array with a row for each residual, split by group of data, without the rows of the priors."""
        return np.split(rows, np.cumsum([np.size(v) for v in self.data.values]))[:-1]
