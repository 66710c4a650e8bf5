"""One solve of a sweep: a function of what varies, the same program for every body of one kind."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .case import Case
from .equilibrium import RESULTS, Equilibrium
from .errors import InputError
from .problem import Method
from .statics import solve
from .sweep_outputs import RESULT, SUCCESSFUL, slope_name

Numbers = Mapping[str, Any]
Observables = tuple[tuple[str, Callable[[Equilibrium], Any]], ...]


class OneSolve(eqx.Module):
    """The outputs of one solve, and their derivatives, as a function of the numbers that vary."""

    case: Case
    outputs: tuple[str, ...] = eqx.field(static=True)
    observables: Observables = eqx.field(static=True)
    sensitivities: tuple[str, ...] = eqx.field(static=True)
    nodes: int = eqx.field(static=True)
    method: Method = eqx.field(static=True)
    dtype: np.dtype = eqx.field(static=True)

    def __call__(self, numbers: Numbers) -> dict[str, Any]:
        if not self.sensitivities:
            return self._answer(numbers)
        by = {name: jnp.asarray(numbers.get(name, self.case.number(name)), self.dtype) for name in self.sensitivities}

        def real(by: Numbers) -> tuple[dict[str, Any], dict[str, Any]]:
            outputs = self._answer({**numbers, **by})
            return {name: x for name, x in outputs.items() if jnp.issubdtype(x.dtype, jnp.floating)}, outputs

        slopes, outputs = jax.jacfwd(real, has_aux=True)(by)
        return outputs | {slope_name(name, by): slope for name, of in slopes.items() for by, slope in of.items()}

    def _answer(self, numbers: Numbers) -> dict[str, Any]:
        there = self.case.with_numbers(numbers)
        options = {"direction": there.direction, "method": self.method, "nodes": self.nodes}
        found = solve(there.manipulator, there.base_tension, there.loads, throw=False, **options)
        outputs = {name: getattr(found, name) for name in self.outputs}
        outputs |= {name: _observed(name, function, found) for name, function in self.observables}
        code = found.result._value
        return outputs | {SUCCESSFUL: code == RESULTS.successful._value, RESULT: code.astype(jnp.int8)}


def _observed(name: str, function: Callable[[Equilibrium], Any], found: Equilibrium) -> jax.Array:
    try:
        return jnp.asarray(function(found))
    except (TypeError, ValueError, AttributeError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"sweep: the observable {name!r} makes no array of an Equilibrium ({why})") from None


def prepared(case: Case, kinematics: Any, dtype: np.dtype) -> Case:
    """The case in one precision and kinematics, its numbers ready to be arguments of a program."""

    def cast(leaf: Any) -> Any:
        number = isinstance(leaf, float | np.ndarray | jax.Array)
        return jnp.asarray(leaf, dtype) if number and jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    return jax.tree.map(cast, replace(case, manipulator=replace(case.manipulator, kinematics=kinematics)))
