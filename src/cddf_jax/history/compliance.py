"""How the tip gives way to a push, when its tendons have a past: friction holds them until they slide back."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..robot.loads import Loads
from ..statics.response import tip_compliance
from .congruent import CongruentStates
from .history import History
from .path import Path
from .stepped import Following, SteppedStates, stepped_history


@tip_compliance.register
def _(history: History, *, push: ArrayLike, short_steps: int = 16) -> Float[Array, "3"]:
    """How the pose of the tip (X, Y, phi) follows a push on it after the last step, by its size: m/N, m/N and rad/N.

    One-sided, and the mean over the push: friction holds the tendons, which begin to slide at the base, and further
    out the harder the push is. The base tensions stay. With tendons that do not stretch it goes to zero with the push.

    Args:
        history: of `trace`.
        push: the force (X, Y), N, which comes on top of the loads.
        short_steps: into how many the push is divided; static.
    """
    push = jnp.asarray(push, float)
    if push.shape != (2,):
        raise ValueError(f"tip_compliance: push must have two components (X, Y), N, got the shape {push.shape}")
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

    def pose(history: History) -> Float[Array, "3"]:
        return jnp.append(history.tip_position[-1], history.tip_angle[-1])

    return (pose(after) - pose(history)) / jnp.linalg.norm(push)
