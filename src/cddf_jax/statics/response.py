"""How the tip responds to changes: its compliance, and its Jacobian by every number of body, tensions and loads."""

from functools import singledispatch

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from ..mechanics.directions import Directions
from ..mechanics.march import FixedPoint
from ..mechanics.problem import Method
from ..numerics.rotations import rotation_vector
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.profiles import as_number
from ..robot.validation import check_loads
from .equilibrium import Equilibrium, nan_unless
from .solve import solve
from .status import Status
from .targets import Actuation


@singledispatch  # after `trace`: history/trace.py
def tip_compliance(
    manipulator: Manipulator,
    base_tension: Actuation,
    loads: Loads | None = None,
    *,
    direction: Directions = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
) -> Float[Array, "pose wrench"]:
    """The compliance C of the tip: the derivative of its pose (X, Y, phi) by a force and a moment on it (F_X, F_Y, m).

    In space it is 6 x 6: position and rotation about X, Y, Z by force and moment, (X, Y, Z) each.

    Units: m/N; 1/N for an angle by a force and for a position by a moment; rad/(N m) for an angle by a moment. The
    tendons are held as they are given: by constant base tensions, or by a constant `Displacement`.

    It is the compliance of the sliding branch that `direction` states. A real tendon sticks before it slides: under
    a small disturbance friction holds it, and the tip is stiffer than this. For that use
    `tip_compliance(history, push=...)` after `trace`: the change of the pose (X, Y, phi) per newton of a push.
    At constant tensions C is symmetric without friction, and not symmetric with friction.

    Args:
        manipulator, base_tension, loads, direction, method, nodes: as in `solve`.

    Returns:
        Row by row the derivatives of X, Y and phi; NaN where `solve` would raise.
    """
    loads = Loads() if loads is None else loads
    loads = loads.with_components(max(manipulator.components, loads.components))
    by = tip_jacobian(manipulator, base_tension, loads, direction=direction, method=method, nodes=nodes).loads
    assert by is not None
    by_moment = jnp.asarray(by.tip_moment)
    return jnp.concatenate([by.tip_force, by_moment if by_moment.ndim > 1 else by_moment[:, None]], axis=1)


class TipJacobian(eqx.Module):
    """Derivatives of the tip's pose (X, Y, phi), SI; in space of position and rotation about X, Y, Z.

    They have the structure of the arguments of `solve`, where every number has a leading axis of 3, in space of 6. They
    are NaN where `solve` would raise an error.
    """

    manipulator: Manipulator  # e.g. `.manipulator.youngs_modulus`, (3,): m/Pa, m/Pa, rad/Pa
    base_tension: PyTree  # (3, tendons) or (3,), as they were given: m/N, m/N, rad/N; for a target, by its value
    loads: Loads | None  # e.g. `.loads.gravity`, (3, 2)


def tip_jacobian(
    manipulator: Manipulator,
    base_tension: Actuation,
    loads: Loads | None = None,
    *,
    direction: Directions = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
) -> TipJacobian:
    """The Jacobian of the tip's pose (X, Y, phi) by every number of the body, the tensions and the loads.

    Args:
        manipulator, base_tension, loads, direction, method, nodes: as in `solve`.

    Raises:
        InputError: for gravity on a body without mass.
    """
    check_loads(manipulator, loads)
    base_tension, direction = (jax.tree.map(as_number, x) for x in (base_tension, direction))
    return _tip_jacobian((manipulator, base_tension, loads), direction, method, nodes)


@eqx.filter_jit
def _tip_jacobian(arguments: tuple, direction: PyTree, method: Method, nodes: int) -> TipJacobian:
    numbers, rest = eqx.partition(arguments, eqx.is_inexact_array)

    def pose(numbers):
        equilibrium = solve(*eqx.combine(numbers, rest), direction=direction, method=method, nodes=nodes)
        return tip_pose(equilibrium), equilibrium.status

    jacobian, status = jax.jacrev(pose, has_aux=True)(numbers)
    solved = (status == Status.successful) | (status == Status.direction_contradicted)
    return TipJacobian(*eqx.combine(nan_unless(solved, jacobian), rest))


def tip_pose(equilibrium: Equilibrium) -> Float[Array, "3"]:
    """The pose of the tip: X and Y, m, and its heading phi, rad.

    In space X, Y, Z, and three angles about these axes by which the tip is turned from where it is: zero, with the
    derivatives of a rotation.
    """
    frame = equilibrium.tip_frame
    if frame is None:
        return jnp.append(equilibrium.tip_position, equilibrium.tip_angle)
    return jnp.append(equilibrium.tip_position, rotation_vector(frame @ jax.lax.stop_gradient(frame).T))
