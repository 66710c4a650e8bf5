"""How the tip gives way: its compliance under loads, and its Jacobian by tensions, body and loads."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .equilibrium import RESULTS, Equilibrium, nan_unless
from .loads import Loads
from .manipulator import Manipulator
from .problem import Method
from .profiles import as_number
from .solver import FixedPoint
from .statics import solve
from .validation import check_weight


def tip_compliance(
    manipulator: Manipulator,
    base_tension: Any,
    loads: Loads | None = None,
    *,
    direction: Any = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
) -> Float[Array, "3 3"]:
    """The compliance C of the tip: how its pose (X, Y, phi) follows a force and a moment on it (F_X, F_Y, m).

    In m/N, and where one of the two is an angle or a moment 1/N, where both are rad/(N m). The tendons are held as
    they are given: by constant base tensions, or by a constant `Displacement`.

    It is the compliance of the sliding branch that `direction` states. A real tendon sticks before it slides: under
    a small disturbance friction holds it, and the tip is stiffer than this. At constant tensions C is symmetric
    without friction, and with friction it is not.

    Args:
        manipulator, base_tension, loads, direction, method, nodes: as in `solve`.

    Returns:
        Row by row the derivatives of X, Y and phi; NaN where `solve` would raise.
    """
    loads = Loads() if loads is None else loads
    by = tip_jacobian(manipulator, base_tension, loads, direction=direction, method=method, nodes=nodes).loads
    assert by is not None
    return jnp.concatenate([by.tip_force, by.tip_moment[:, None]], axis=1)


class TipJacobian(eqx.Module):
    """Derivatives of the tip's pose (X, Y, phi), SI.

    Trees like the arguments of `solve`, with a leading axis of 3 on every number; NaN where `solve` would raise.
    """

    manipulator: Manipulator  # e.g. `.manipulator.youngs_modulus`, (3,): m/Pa, m/Pa, rad/Pa
    base_tension: Any  # (3, tendons) or (3,), as they were given: m/N, m/N, rad/N; of a target by its value
    loads: Loads | None  # e.g. `.loads.gravity`, (3, 2)


def tip_jacobian(
    manipulator: Manipulator,
    base_tension: Any,
    loads: Loads | None = None,
    *,
    direction: Any = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
) -> TipJacobian:
    """The Jacobian of the tip's pose (X, Y, phi) by every number of the body, the tensions and the loads.

    Args:
        manipulator, base_tension, loads, direction, method, nodes: as in `solve`.

    Raises:
        InputError: for gravity on a body without mass.
    """
    check_weight(manipulator, loads)
    base_tension, direction = (jax.tree.map(as_number, x) for x in (base_tension, direction))
    return _tip_jacobian((manipulator, base_tension, loads), direction, method, nodes)


@eqx.filter_jit
def _tip_jacobian(arguments: tuple, direction: Any, method: Method, nodes: int) -> TipJacobian:
    numbers, rest = eqx.partition(arguments, eqx.is_inexact_array)

    def pose(numbers):
        equilibrium = solve(*eqx.combine(numbers, rest), direction=direction, method=method, nodes=nodes)
        return tip_pose(equilibrium), equilibrium.result

    jacobian, result = jax.jacrev(pose, has_aux=True)(numbers)
    solved = (result == RESULTS.successful) | (result == RESULTS.direction_contradicted)
    return TipJacobian(*eqx.combine(nan_unless(solved, jacobian), rest))


def tip_pose(equilibrium: Equilibrium) -> Float[Array, "3"]:
    """The pose of the tip: X and Y, m, and its heading phi, rad."""
    return jnp.append(equilibrium.tip_position, equilibrium.tip_angle)
