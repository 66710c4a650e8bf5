"""How the tip gives way to a push, when its tendons have a past: friction holds them until they slide back."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..errors import SolveError
from ..robot.loads import Loads
from ..statics.equilibrium import code_of
from ..statics.response import tip_compliance
from .congruent import CongruentStates
from .history import History
from .path import Path
from .stepped import Following, SteppedStates, stepped_history


@tip_compliance.register
def _(history: History, *, push: ArrayLike | Sequence[float] | None = None, short_steps: int = 16) -> Float[Array, "3"]:
    """How the pose of the tip (X, Y, phi) follows a push on it after the last step, by its size: m/N, m/N and rad/N.

    One-sided, and the mean over the push: friction holds the tendons, which begin to slide at the base, and further
    out the harder the push is. The base tensions stay. With tendons that do not stretch it goes to zero with the push.

    Args:
        history: of `trace`.
        push: the force (X, Y), N, which comes on top of the loads.
        short_steps: into how many the push is divided, 2 or more; static.

    Raises:
        ValueError: for a body in space, a push without two components, or of no size, or short_steps below 2.
        SolveError: where the numbers are known, and the body under the push was not found.
    """
    if history.tip_frame is not None:
        raise ValueError(
            "tip_compliance: the history is of a body in space; take tip_compliance(robot, ...), which slides"
        )
    if push is None or np.shape(push) != (2,):
        raise ValueError(f"tip_compliance: after a history, push= must have two components (X, Y), N, got {push!r}")
    if not isinstance(push, Tracer) and not 0 < float(np.linalg.norm(np.asarray(push))) < np.inf:
        raise ValueError(f"tip_compliance: push must be a force above 0 N, got {push!r}")
    if isinstance(short_steps, bool) or not isinstance(short_steps, int) or short_steps < 2:
        raise ValueError(f"tip_compliance: short_steps must be a whole number of 2 or more, got {short_steps!r}")
    push = jnp.asarray(push, float)
    states = history._states
    if isinstance(states, CongruentStates):
        path = Path(states.path[:, None], jnp.zeros_like(states.path)[:, None], None)
        kind = Following((), False, 4 * states.nodes, short_steps)
        history = stepped_history(states.manipulator, path, None, kind)
        states = history._states
    assert isinstance(states, SteppedStates)
    force = states.loads.tip_force + push
    pushed = Loads(tip_force=force, tip_moment=states.loads.tip_moment, gravity=states.loads.gravity)
    tension = history.base_tension[-1:].reshape(1, -1)
    path = Path(tension, jnp.zeros_like(tension), jax.tree.map(lambda x: x[None], pushed))
    after = stepped_history(states.manipulator, path, states, Following((), False, states.num_cells, short_steps))

    codes = code_of(after.result)
    if not isinstance(codes, Tracer) and np.ndim(codes) == 1 and np.any(np.isnan(after.tip_angle)):
        raise SolveError("tip_compliance: no body was found under the push; push less, or raise short_steps=")

    def pose(history: History) -> Float[Array, "3"]:
        return jnp.append(history.tip_position[-1], history.tip_angle[-1])

    return (pose(after) - pose(history)) / jnp.linalg.norm(push)
