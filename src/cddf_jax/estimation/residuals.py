"""The residuals of a fit: prediction minus data, divided by the noise, and how a robust loss changes them."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from ..errors import InputError
from .parameter_space import Numbers, ParameterSpace, Prior
from .robust_loss import LOSSES

Deviations = Sequence[Numbers]  # standard deviations, one array for each group of data


class LeastSquaresProblem(eqx.Module):
    """A model, its data, and what is known of its parameters."""

    predict: Callable[[PyTree], PyTree]
    unravel: Callable[[Array], PyTree] = eqx.field(static=True)
    values: tuple[Numbers, ...]
    space: ParameterSpace
    prior: dict[int, Prior]
    loss: str = eqx.field(static=True, default="linear")
    times: tuple[Numbers, ...] | None = None  # how often each datum counts, under a robust loss

    def residual(self, z: Float[Numbers, " n"], noise: Deviations, held: Float[Numbers, " n"]) -> Float[Array, " m"]:
        """(predicted - observed) / sigma of all groups, then (value - mean) / deviation of the priors."""
        parameters = self.parameters(z, held)
        predicted = jax.tree.leaves(self.predict(self.unravel(parameters)))
        sizes, wanted = [jnp.size(p) for p in predicted], [np.size(v) for v in self.values]
        if sizes != wanted:
            raise InputError(f"predict gives arrays of {sizes} numbers where the data have {wanted}")
        groups = zip(predicted, self.values, noise, strict=True)
        rows = [jnp.ravel((jnp.reshape(p, jnp.shape(v)) - v) / s) for p, v, s in groups]
        pulls = [(parameters[i] - prior.mean) / prior.standard_deviation for i, prior in self.prior.items()]
        return jnp.concatenate([*rows, jnp.stack(pulls)] if pulls else rows)

    def parameters(self, z: Float[Numbers, " n"], held: Float[Numbers, " n"]) -> Float[Array, " n"]:
        """The parameters at z; `held` is NaN where they are free."""
        return jnp.where(jnp.isnan(held), self.space.parameters(z), held)

    @property
    def num_data(self) -> int:
        """Without the rows of the priors, which no loss softens."""
        return sum(int(np.prod(np.shape(v))) for v in self.values)

    def softened(self, residual: Float[Array, " m"]) -> Float[Array, " m"]:
        """What to square and sum."""
        if self.loss == "linear":
            return residual
        data, prior = jnp.split(residual, [self.num_data])
        data = LOSSES[self.loss].transformed(data)
        if self.times is not None:
            data = data * jnp.sqrt(jnp.concatenate([jnp.ravel(t) for t in self.times]))
        return jnp.concatenate([data, prior])

    def influence(self, residual: np.ndarray) -> np.ndarray:
        """Half the derivative of the cost by each residual."""
        data, prior = np.split(residual, [self.num_data])
        return np.append(LOSSES[self.loss].influence(data), prior)

    def by_group(self, residual: np.ndarray) -> list[np.ndarray]:
        """The residuals (rows) of each group of data; those of the priors are left out."""
        return np.split(residual, np.cumsum([np.size(v) for v in self.values]))[:-1]
