"""`trace`: pull and release."""

from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..errors import SolveError
from ..robot.manipulator import Manipulator
from ..statics.arguments import check_nodes
from ..statics.equilibrium import RESULTS, code_of
from ..statics.targets import Displacement, TipAngle
from .congruent import Before, CongruentStates, congruent_history
from .history import History


def trace(
    manipulator: Manipulator,
    base_tension: ArrayLike | Sequence[float] | Displacement | TipAngle,
    *,
    before: ArrayLike | Literal["rest"] = "rest",
    start: History | None = None,
    nodes: int = 16,
    max_turns: int = 16,
    throw: bool = True,
) -> History:
    """Pull and release a manipulator with one tendon, without loads, from rest.

    Works under jit, vmap, grad and scan. Derivatives are continuous where fronts move; at a turn they are those of the
    direction in which the step went.

    Args:
        manipulator: a body with one tendon.
        base_tension: T_base >= 0, N, after each step, in the order in time; between steps it goes straight from one
            to the next. Or `Displacement([...])`, m, or `TipAngle([...])`, rad, after each step: then the tensions are
            found. A tendon that would have to push hangs without tension until it is taken up; the result of such a
            step is `slack`, which is no error, and its displacement is that at which the tendon went slack.
        before: the largest base tension, N, that the tendon had before it was released to the first step; "rest" for
            a body that is straight, with a tendon that never had a tension.
        start: the history of the same body that goes on, in the place of `before`.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static.
        max_turns: how many turns may be felt at once, 1 or more; static. Where there are more, the step is
            `too_many_turns`. A loop closes when a tension passes the turn before: then two turns are forgotten.
        throw: raise where the values are known and a step failed.

    Raises:
        SolveError: with `throw`, when a step failed; it names the step.
        ValueError: for a body with several tendons, a path that is not a list of numbers, both `before` and `start`,
            nodes below 4 or max_turns below 1.
        TypeError: if an argument has the wrong type.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"trace: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    if manipulator.num_tendons != 1:
        raise ValueError(
            f"trace: the body has {manipulator.num_tendons} tendons, and the history of several is not known here; "
            "solve() has each of them slide one way"
        )
    check_nodes(nodes)
    if isinstance(max_turns, bool) or not isinstance(max_turns, int) or max_turns < 1:
        raise ValueError(f"trace: max_turns must be a whole number of 1 or more, got {max_turns!r}")
    quantity, values = _path(base_tension)
    history = congruent_history(manipulator, values, _before(before, start, values.dtype), nodes, max_turns, quantity)
    if throw:
        _raise_if_failed(history)
    return history


def _path(given: ArrayLike | Sequence[float] | Displacement | TipAngle) -> tuple[str, Float[Array, " steps"]]:
    """What is driven, and its values."""
    target = isinstance(given, Displacement | TipAngle)
    quantity, values = (given.quantity, given.value) if target else ("base_tension", given)
    if isinstance(values, str) or np.ndim(values) != 1 or np.size(values) == 0:
        unit = {"base_tension": "tensions, N", "displacement": "lengths, m", "tip_angle": "angles, rad"}[quantity]
        raise ValueError(
            f"trace: {quantity} must be a list of {unit}, one for each step, got the shape {np.shape(values)}"
        )
    return quantity, jnp.asarray(values, jnp.result_type(float, jnp.asarray(values)))


def _before(before: ArrayLike | Literal["rest"], start: History | None, dtype: jnp.dtype) -> Before:
    at_rest = isinstance(before, str) and before == "rest"
    if not at_rest and (isinstance(before, str) or np.ndim(before) != 0):
        raise ValueError(f'trace: before must be "rest" or the largest base tension, N, got {before!r}')
    if start is None:
        return Before(jnp.zeros(0, dtype) if at_rest else jnp.asarray(before, dtype)[None])
    if not isinstance(start, History):
        raise TypeError(f"trace: start must be a History, got {type(start).__name__}")
    if not at_rest:
        raise ValueError("trace: before and start both tell what was before; leave one of them out")
    states = start._states
    assert isinstance(states, CongruentStates)
    return Before(states.open_tension, jnp.stack([start.work[-1], start.friction_loss[-1]]))


def _raise_if_failed(history: History) -> None:
    codes = code_of(history.result)
    if isinstance(codes, Tracer) or np.ndim(codes) != 1:
        return
    failed = ~np.isin(np.asarray(codes), [code_of(result) for result in (RESULTS.successful, RESULTS.slack)])
    if not np.any(failed):
        return
    step = int(np.argmax(failed))
    words = RESULTS[jax.tree.map(lambda code: code[step], history.result)]
    raise SolveError(f"step {step} of the trace, {float(history.base_tension[step]):g} N: {words}")
