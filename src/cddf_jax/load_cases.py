"""Load cases of a design: how its body is pulled and loaded, and of what it may turn out to be made."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import norm, qmc

from .case import Case
from .determination import IDENTIFIED, PRIOR_ONLY
from .directions import as_directions
from .equilibrium import Equilibrium
from .errors import InputError
from .loads import Loads
from .manipulator import Manipulator
from .profiles import Scalar, as_number
from .statics import solve

if TYPE_CHECKING:
    from .identification import Fit

BODY_PARAMETERS = (
    "friction_coefficient",
    "youngs_modulus",
    "length",
    "drag",
    "stiffness_factor",
)  # of what a fit may have estimated


class LoadCase(eqx.Module):
    """One way in which the body is used.

    Args:
        base_tension: as in `solve`: T_base, N, or what is to be reached, such as `TipAngle(1.57)`.
        loads: dead loads, or None.
        direction: as in `solve`: +1 slides in, -1 slides out; None where it is to be found.
        numbers: of the body that are other ones in this case, by name, e.g. {"youngs_modulus": 1.5e6}.
        weight: in sums over the cases.
        name: in tables and messages.
    """

    base_tension: Any = eqx.field(converter=lambda given: jax.tree.map(as_number, given))
    loads: Loads | None = None
    direction: Any = eqx.field(default=None, converter=as_directions)
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
            InputError: names a number that is none of the body.
        """
        return Case(manipulator, None, None, None).with_numbers(self.numbers).manipulator

    def solve(self, manipulator: Manipulator, nodes: int = 16) -> Equilibrium:
        """The equilibrium of the body in this case; look at its `result`."""
        body = self.body(manipulator)
        return solve(body, self.base_tension, self.loads, direction=self.direction, nodes=nodes, throw=False)


def uncertain_cases(case: LoadCase, fit: "Fit", num: int = 16, seed: int = 0) -> tuple[LoadCase, ...]:
    """The case with what a fit leaves uncertain: bodies drawn from the log-normal distribution about its estimate.

    Sobol points through the normal quantile of the logarithms, which keeps a modulus positive; means and covariance of
    the draws are those of the fit to a few percent.

    Args:
        case: how the body is used.
        fit: its parameters that are numbers of the body must each be identified.
        num: how many bodies, a power of 2.
        seed: of the points.

    Raises:
        InputError: for a fit that does not tell the parameters one by one: a design for wrong numbers is worthless.
    """
    own = [name for name in fit.names if name in BODY_PARAMETERS]
    open_ones = [name for name in own if fit.status[name] not in (IDENTIFIED, PRIOR_ONLY)]
    if open_ones or not own:
        raise InputError(
            f"uncertain_cases: the fit does not tell {', '.join(open_ones) or 'any number of the body'}; "
            "measure more, or give a prior, before designing for it"
        )
    if isinstance(num, bool) or not isinstance(num, int) or num < 1 or num & (num - 1):
        raise InputError(f"uncertain_cases: num must be a power of 2 such as 16, got {num!r}")
    places, centre = [fit.names.index(name) for name in own], np.array([fit.value[name] for name in own])
    logarithmic = np.log1p(fit.covariance[np.ix_(places, places)] / np.outer(centre, centre))
    points = norm.ppf(qmc.Sobol(len(own), rng=seed).random(num))
    values = centre * np.exp(points @ np.linalg.cholesky(logarithmic).T - np.diag(logarithmic) / 2)
    label = case.name or "case"
    return tuple(
        LoadCase(
            case.base_tension,
            case.loads,
            case.direction,
            {**case.numbers, **dict(zip(own, row, strict=True))},
            float(case.weight) / num,
            f"{label} {i}",
        )
        for i, row in enumerate(values, 1)
    )


def alike(cases: Sequence[LoadCase]) -> list[list[int]]:
    """The places of cases that are solved by one program, group by group."""
    groups: dict[Any, list[int]] = {}
    for i, case in enumerate(cases):
        nameless = eqx.tree_at(lambda c: c.weight, case, jnp.zeros(()))
        leaves, structure = jax.tree.flatten(_unnamed(nameless))
        key = (structure, tuple(np.shape(leaf) for leaf in leaves))
        groups.setdefault(key, []).append(i)
    return list(groups.values())


def stacked(cases: Sequence[LoadCase]) -> LoadCase:
    """Cases that are alike as one with a leading axis on every number."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *map(_unnamed, cases))


def _unnamed(case: LoadCase) -> LoadCase:
    return LoadCase(case.base_tension, case.loads, case.direction, case.numbers, case.weight)
