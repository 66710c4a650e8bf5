"""The residuals of a fit: what a model predicts less what was observed, and the parameters less what was known."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..errors import InputError
from .parameter_space import Numbers, ParameterSpace, Prior, Structure
from .robust_loss import LOSSES
from .shared_errors import Shared


class Data(NamedTuple):
    """The data of a fit; for many fits at once, arrays may have a leading axis of fits."""

    values: tuple[Numbers, ...]  # by group
    noise: tuple[Numbers, ...]  # standard deviations, of the shapes of the values
    times: tuple[Numbers, ...]  # how often each datum counts
    prior: dict[int, Prior]  # by parameter


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    """A model, its data, and what is known of its parameters."""

    predict: Callable[[PyTree], PyTree]
    unravel: Structure = field(metadata={"static": True})
    groups: tuple[str, ...] = field(metadata={"static": True})  # of the data
    data: Data
    shared: Shared  # errors of inputs in the data
    space: ParameterSpace
    loss: str = field(metadata={"static": True})
    max_steps: int = field(metadata={"static": True})  # of a search

    def residual(self, z: Float[Numbers, " n"], held: Float[Numbers, " n"]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors.

        Where inputs have errors, the data are whitened, see `Shared`.
        """
        parameters = self.parameters(z, held)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        values, noise, _, prior = self.data
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
    def num_data(self) -> int:
        """The number of data, without the rows of the priors."""
        return sum(np.size(v) for v in self.data.values)

    def softened(self, residual: Float[Numbers, " m"]) -> Float[Numbers, " m"]:
        """The residuals whose squares are summed: as the loss transforms them, data that count twice taken twice."""
        xp = residual.__array_namespace__()
        data, prior = residual[: self.num_data], residual[self.num_data :]
        times = xp.concat([t.reshape(-1) for t in self.data.times])
        return xp.concat([LOSSES[self.loss].transformed(data) * xp.sqrt(times), prior])

    def influence(self, residual: np.ndarray) -> np.ndarray:
        """Half the derivative of the cost by each residual."""
        data, prior = np.split(residual, [self.num_data])
        return np.append(LOSSES[self.loss].influence(data), prior)

    def unwhitened(self, rows: np.ndarray) -> np.ndarray:
        """The rows of the data as they are without errors of inputs, and then those of the priors."""
        return np.concatenate([self.shared.unwhitened(rows[: self.num_data]), rows[self.num_data :]])

    def by_group(self, rows: np.ndarray) -> list[np.ndarray]:
        """An array with a row for each residual, split by group of data, without the rows of the priors."""
        return np.split(rows, np.cumsum([np.size(v) for v in self.data.values]))[:-1]
