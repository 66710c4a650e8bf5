"""Load cases of a design: how its body is pulled and loaded, and cases with uncertain numbers."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from ..errors import InputError
from ..estimation.determination import IDENTIFIED, PRIOR_ONLY
from ..mechanics.directions import as_directions
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.profiles import Scalar, as_number
from ..statics.equilibrium import Equilibrium
from ..statics.named_numbers import Case
from ..statics.solve import solve

if TYPE_CHECKING:
    from ..identification.fit import Fit

Answer = TypeVar("Answer", bound=PyTree)
# parameters of a fit that are numbers of the body
BODY_PARAMETERS = (
    *("friction_coefficient", "youngs_modulus", "length", "drag"),
    *("stiffness_factor", "axial_factor", "shear_factor", "poissons_ratio"),
)


class LoadCase(eqx.Module):
    """One way in which the body is used.

    Args:
        base_tension: as in `solve`: T_base, N, or a target such as `TipAngle(1.57)`; one for all tendons, or one each.
        loads: dead loads, or None.
        direction: as in `solve`: +1 slides in, -1 slides out; None if it is to be found.
        numbers: numbers of the body that have other values in this case, by name, e.g. {"youngs_modulus": 1.5e6}.
        weight: of this case in means over the cases, above 0.
        name: in tables and messages.
    """

    base_tension: PyTree = eqx.field(converter=lambda given: jax.tree.map(as_number, given))
    loads: Loads | None = None
    direction: PyTree = eqx.field(default=None, converter=as_directions)
    numbers: Mapping[str, Scalar] = eqx.field(
        default_factory=dict, converter=lambda given: {name: as_number(x) for name, x in given.items()}
    )
    weight: Scalar = eqx.field(default=1.0, converter=as_number)
    name: str = eqx.field(default="", static=True)

    def __check_init__(self):
        if isinstance(self.weight, np.ndarray) and not (np.isfinite(self.weight) and self.weight > 0):
            raise InputError(f"LoadCase: the weight must be above 0, got {self.weight:g}")

    def body(self, manipulator: Manipulator) -> Manipulator:
        """The body with the numbers of this case.

        Raises:
            InputError: names a number that the body does not have.
        """
        return case_numbers(manipulator).with_numbers(self.numbers).manipulator

    def of(self, manipulator: Manipulator) -> Case:
        """Body and load case together, as a case whose numbers have names."""
        return Case(manipulator, self.base_tension, self.loads, self.direction)

    def with_numbers(self, manipulator: Manipulator, numbers: Mapping[str, Scalar]) -> "tuple[Manipulator, LoadCase]":
        """Body and load case with other numbers, by name."""
        there = self.of(manipulator).with_numbers(numbers)
        return there.manipulator, replace(self, base_tension=there.base_tension, loads=there.loads)

    def solve(self, manipulator: Manipulator, nodes: int = 16) -> Equilibrium:
        """The equilibrium of the body in this case; look at its `status`."""
        body = self.body(manipulator)
        return solve(body, self.base_tension, self.loads, direction=self.direction, nodes=nodes, throw=False)


def uncertain_cases(case: LoadCase, fit: "Fit", num: int = 16) -> tuple[LoadCase, ...]:
    """The case with bodies drawn from the uncertainty of a fit: log-normal about its estimate.

    Quasi-random normal points for the logarithms, so that a modulus stays positive. Mean and covariance of the draws
    are those of the fit to a few percent.

    Args:
        case: how the body is used.
        fit: its parameters that are numbers of the body must each be identified, or have a prior.
        num: how many bodies, a power of 2.

    Raises:
        InputError: for a fit that does not determine each of these parameters.
    """
    own = [name for name in fit.names if name in BODY_PARAMETERS]
    open_ones = [name for name in own if fit.status[name] not in (IDENTIFIED, PRIOR_ONLY)]
    if open_ones or not own:
        raise InputError(
            f"uncertain_cases: the fit does not determine {', '.join(open_ones) or 'any number of the body'}; "
            "measure more, or give a prior, before designing for it"
        )
    if isinstance(num, bool) or not isinstance(num, int) or num < 1 or num & (num - 1):
        raise InputError(f"uncertain_cases: num must be a power of 2 such as 16, got {num!r}")
    places, centre = [fit.names.index(name) for name in own], np.array([fit.value[name] for name in own])
    logarithmic = np.log1p(fit.covariance[np.ix_(places, places)] / np.outer(centre, centre))
    from scipy.stats import qmc

    points = qmc.MultivariateNormalQMC(-np.diag(logarithmic) / 2, logarithmic, rng=0).random(num)
    values = centre * np.exp(points)
    label, weight = case.name or "case", float(case.weight) / num
    drawn = [{**case.numbers, **dict(zip(own, row, strict=True))} for row in values]
    return tuple(
        replace(case, numbers=numbers, weight=weight, name=f"{label} {i}") for i, numbers in enumerate(drawn, 1)
    )


def case_numbers(manipulator: Manipulator) -> Case:
    """The numbers of a body alone, by name."""
    return Case(manipulator, None, None, None)


def of_every_case(function: Callable[[LoadCase], Answer], cases: Sequence[LoadCase]) -> Answer:
    """A function of every case, with a leading axis on its values; similar neighbours are computed together."""

    def kind(case: LoadCase) -> Hashable:
        leaves, structure = jax.tree.flatten(case)
        return structure, tuple(map(np.shape, leaves))

    found = []
    for _, group in groupby((replace(case, name="") for case in cases), key=kind):
        first, *others = group
        if others:
            similar = jax.tree.map(lambda *x: jnp.stack(list(map(jnp.asarray, x))), first, *others)
            found.append(jax.vmap(function)(similar))
        else:
            found.append(jax.tree.map(lambda x: x[None], function(first)))
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *found)
