"""How an equilibrium responds to changes: compliance and Jacobian of the tip, and the energy balance of a pull.

The Jacobian is with respect to every number of the body, the tensions and the loads. The energy balance divides the
work of pulling into elastic energy, friction loss and work on the loads.
"""

from functools import singledispatch
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..errors import InputError
from ..mechanics.bending import slip_rate, stretch_rate
from ..mechanics.directions import Directions
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint
from ..mechanics.problem import (
    Method,
    Number,
    Problem,
    Solution,
    at_nodes,
    load_rate,
    strain_along,
    tension_of,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.elements import gauss_rule
from ..robot.cross_section import planar
from ..robot.loads import Loads, loads_in_space
from ..robot.manipulator import Manipulator
from ..robot.profiles import as_number
from ..robot.validation import check_loads
from .arguments import one_precision
from .balance import equilibrate
from .equilibrium import Equilibrium, nan_unless
from .settle import Setup
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
    if manipulator.in_space or loads.in_space:
        loads = loads_in_space(loads)
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
    turned = frame @ jax.lax.stop_gradient(frame).T
    pairs = [(2, 1), (0, 2), (1, 0)]
    return jnp.append(equilibrium.tip_position, jnp.stack([turned[i, j] - turned[j, i] for i, j in pairs]) / 2)


class EnergyBalance(eqx.Module):
    """Work and energy along a pull, J: actuation_work = elastic_energy + friction_loss + load_work + residual."""

    actuation_work: Float[Array, " tendons"]  # of the base tensions over their travel
    elastic_energy: Float[Array, ""]  # gained by the body in bending and by the tendons in stretching
    friction_loss: Float[Array, " tendons"]  # of friction over the sliding; not negative where `direction` is right
    load_work: Float[Array, ""]  # done against the dead loads: weights lifted
    status: Int[Array, ""]  # of the solve at the full tensions

    @property
    def residual(self) -> Number:
        """The actuation work less the other terms, J: zero in the exact kinematics, not in the published one."""
        gains = jnp.sum(self.friction_loss, axis=-1) + self.elastic_energy + self.load_work
        return jnp.sum(self.actuation_work, axis=-1) - gains


def energy_balance(
    manipulator: Manipulator,
    base_tension: Actuation,
    loads: Loads | None = None,
    *,
    direction: Directions = None,
    method: Method = FixedPoint(),
    nodes: int = 16,
    num_steps: int = 16,
    throw: bool = True,
) -> EnergyBalance:
    """Work and energy while all base tensions rise together from 0 to their end, under constant dead loads.

    Without loads the pull starts from the straight body, with loads from the body that the loads bend. In the exact
    kinematics the work of the base tensions is the sum of elastic energy, friction loss and work on the loads. The
    published kinematics are not consistent with virtual work (arm d q, travel the integral of d kappa), so
    `residual` is not zero: 5 % of the work at 75 N on the paper's body.

    Args:
        manipulator, base_tension, loads, direction, method, nodes, throw: as in `solve`.
        num_steps: Gauss points along the pull. Where the curvature changes sign during the pull, or drag leaves a
            tendon slack at first, the residual falls more slowly with their number.
    """
    if manipulator.in_space or (loads is not None and loads.in_space):
        raise InputError("energy_balance: the body is in space; this works for bodies in the plane only")
    end = solve(manipulator, base_tension, loads, direction=direction, method=method, nodes=nodes, throw=throw)
    manipulator, tension, direction, loads = one_precision(manipulator, end.base_tension, end._dense.direction, loads)
    return _energy_balance(Setup(manipulator, direction, loads, method, nodes), tension, end.status, num_steps)


@eqx.filter_jit
def _energy_balance(setup: Setup, base_tension: PerTendon, status: Int[Array, ""], num_steps: int) -> EnergyBalance:
    rule = gauss_rule(num_steps)
    fraction = jnp.concatenate([jnp.zeros(1), jnp.asarray(rule.nodes), jnp.ones(1)]).astype(base_tension.dtype)

    def along(fraction):
        stage, rate = jax.jvp(lambda x: _stage(setup, x * base_tension), (fraction,), (jnp.ones_like(fraction),))
        pulled = fraction * base_tension
        return stage, pulled * rate.displacement, _dissipation(pulled, stage, rate)

    stages, power, dissipation = jax.vmap(along)(fraction)
    weights = jnp.asarray(rule.weights, base_tension.dtype)
    gained = jax.tree.map(lambda x: x[-1] - x[0], (stages.elastic_energy, stages.load_energy))
    answer = EnergyBalance(weights @ power[1:-1], gained[0], weights @ dissipation[1:-1], gained[1], status)
    numbers, code = eqx.partition(answer, eqx.is_inexact_array)
    return eqx.combine(nan_unless(jnp.all(stages.converged), numbers), code)


slip_along = at_nodes(slip_rate, (0, 0, 0, None))


class _Stage(NamedTuple):
    """One equilibrium during the pull."""

    displacement: PerTendon
    elastic_energy: Number
    load_energy: Number  # potential of the dead loads
    tension: Float[Array, "P p tendons"]
    slip: Float[Array, "P p tendons"]  # length of tendon by which the part of each node shortens, m
    converged: Bool[Array, ""]


def _stage(setup: Setup, base_tension: PerTendon) -> _Stage:
    there = equilibrate(setup, base_tension)
    problem, solution, cut = there.problem, there.solution, there.problem.elements
    section = planar(problem.nodes)
    tension = tension_of(section, base_tension, solution.nodes.pull)
    kappa = strain_along(section, base_tension, solution.nodes)
    body = problem.manipulator
    stretching = jnp.sum(tension * stretch_rate(body.tendon_compliance, tension, section), axis=-1)
    outside = jnp.sum(base_tension * base_tension * body.tendon_outside_compliance)
    return _Stage(
        displacement=tendon_displacement(problem, solution.nodes),
        elastic_energy=jnp.sum(cut.gain(section.stiffness * kappa**2 + stretching)) / 2 + outside / 2,
        load_energy=_load_energy(problem, solution),
        tension=tension,
        slip=(cut.shares * cut.edges[-1])[..., None] * slip_along(section, kappa, tension, body.tendon_compliance),
        converged=there.load_path.converged,
    )


def _load_energy(problem: Problem, solution: Solution) -> Number:
    loads = problem.loads
    if loads is None:
        return jnp.zeros_like(solution.tip.heading)
    rate = load_rate(problem.manipulator, problem.elements.nodes, loads)
    at_starts, at_nodes, at_tip = (state.position for state in (solution.starts, solution.nodes, solution.tip))
    lifted = jnp.sum(problem.elements.gain(jnp.sum(rate * at_nodes, axis=-1)))
    if problem.outboard.drops is not None:
        drops = problem.outboard.drops
        lifted = lifted + jnp.sum(drops.force * at_starts) + jnp.sum(drops.moment * solution.starts.heading)
    return -(jnp.asarray(loads.tip_force) @ at_tip + loads.tip_moment * solution.tip.heading + lifted)


def _dissipation(base_tension: PerTendon, stage: _Stage, rate: _Stage) -> PerTendon:
    """Friction force times sliding, per unit of the pull, J.

    The integral of -T' times the sliding, by parts: the tendon slides at s by the sum of the slip from s to the tip.
    """
    return jnp.sum((base_tension - stage.tension) * rate.slip, axis=(0, 1))
