"""`trace`: pull and release."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..errors import SolveError
from ..robot.manipulator import Manipulator
from ..statics.arguments import check_nodes
from ..statics.equilibrium import RESULTS, code_of
from .congruent import CongruentStates, congruent_history
from .history import History


def trace(
    manipulator: Manipulator,
    base_tension: ArrayLike | Sequence[float],
    *,
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
            to the next.
        start: the history of the same body that goes on. None for a body that is straight, with a tendon that never
            had a tension.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static.
        max_turns: how many turns may be felt at once, 1 or more; static. Where there are more, the step is
            `too_many_turns`. A loop closes when a tension passes the turn before: then two turns are forgotten.
        throw: raise where the values are known and a step failed.

    Raises:
        SolveError: with `throw`, when a step failed; it names the step.
        ValueError: for a body with several tendons, tensions that are not a list of numbers, nodes below 4 or
            max_turns below 1.
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
    if np.ndim(base_tension) != 1 or np.size(base_tension) == 0:
        shape = np.shape(base_tension)
        raise ValueError(f"trace: base_tension must be a list of tensions, N, one for each step, got the shape {shape}")
    tensions = jnp.asarray(base_tension, jnp.result_type(float, jnp.asarray(base_tension)))
    if start is not None and not isinstance(start, History):
        raise TypeError(f"trace: start must be a History, got {type(start).__name__}")
    history = congruent_history(manipulator, tensions, _open_tension(start), nodes, max_turns)
    if throw:
        _raise_if_failed(history)
    return history


def _open_tension(start: History | None) -> Float[Array, " turns"] | None:
    if start is None:
        return None
    assert isinstance(start._states, CongruentStates)
    return start._states.open_tension


def _raise_if_failed(history: History) -> None:
    codes = code_of(history.result)
    if isinstance(codes, Tracer) or np.ndim(codes) != 1 or not np.any(codes):
        return
    step = int(np.argmax(np.asarray(codes) != 0))
    words = RESULTS[jax.tree.map(lambda code: code[step], history.result)]
    raise SolveError(f"step {step} of the trace, {float(history.base_tension[step]):g} N: {words}")
