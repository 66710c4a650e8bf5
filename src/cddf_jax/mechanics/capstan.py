"""The capstan law, T = T_base exp(-mu theta), in closed form where it has one.

Along a body with one tendon the closed form is the reference for every method. Over a fixed pulley it is eq. (5) of
the paper: there the friction between tendon and body material is measured without a manipulator.
"""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..numerics.elements import Elements, elements_between, gauss_rule, smooth_pieces
from ..numerics.given_numbers import check_numbers
from ..robot.manipulator import Manipulator
from ..robot.profiles import Constant, Linear, Profile
from ..robot.validation import refuse_memory


def closed_form_tension(
    manipulator: Manipulator, base_tension: ArrayLike, arc_length: ArrayLike, *, nodes: int = 32
) -> Float[Array, "*points"]:
    """T(s) = T_base / (1 + mu T_base G(s)) with G(s) = integral of d / (E J) from 0 to s.

    Holds for one tendon that slides in, without external load and drag: in the published kinematics with any
    offset, in the exact kinematics with a constant one while d kappa < 1 (not checked). Then
    kappa_c = T d / (E J) exactly, so that T' = -mu kappa_c T can be integrated. This goes beyond
    Liu et al. (2020), whose eq. (8) and (14) it solves.

    Args:
        base_tension: T_base, N, a number.
        arc_length: s, m, a number or an array; the tension is NaN outside 0 to L. Beyond the anchor of
            the tendon it is the tension at the anchor.
        nodes: Gauss nodes for G in each smooth piece of the body. Whether they are enough is not checked.

    Raises:
        ValueError: for a negative tension, more tendons than one, drag, friction along a history, a curvature at rest,
            a varying angle, or in the exact kinematics a varying offset.
    """
    if manipulator.num_tendons != 1:
        raise ValueError(f"closed_form_tension holds for one tendon, not for {manipulator.num_tendons}; use solve")
    refuse_memory("closed_form_tension", manipulator)
    if manipulator.tendon_drag is not None:
        raise ValueError("closed_form_tension holds without drag only; use solve, or drag=None")
    tendon = manipulator.tendons[0]
    if manipulator.kinematics == "exact" and not _surely_constant(tendon.offset):
        raise ValueError(
            "closed_form_tension holds in the exact kinematics for a Constant tendon offset only, "
            f"not for {type(tendon.offset).__name__}; use solve, or kinematics='published'"
        )
    if manipulator.rest_curvature is not None or (tendon.angle is not None and not _surely_constant(tendon.angle)):
        raise ValueError(
            "closed_form_tension holds for a tendon parallel to the axis of a body that is straight at rest; use solve"
        )
    for name, given in {"base_tension": base_tension, "arc_length": arc_length}.items():
        check_numbers(f"closed_form_tension: {name}", given)
    if not isinstance(base_tension, Tracer) and np.any(np.asarray(base_tension) < 0):
        raise ValueError(f"closed_form_tension: a tendon cannot push, got base_tension {base_tension}")
    s = jnp.asarray(arc_length, float)
    length = jnp.asarray(manipulator.length, s.dtype)
    whole = elements_between(smooth_pieces(length, manipulator.breakpoints), nodes)
    reach = s if tendon.end is None else jnp.minimum(s, tendon.end)
    compliance = _integral_up_to(whole, lambda x: manipulator.offset(x)[0] / manipulator.stiffness(x), reach)
    ratio = 1.0 + manipulator.tendon_friction[0] * base_tension * compliance
    return jnp.where((s >= 0) & (s <= length), base_tension / ratio, jnp.nan)


def _surely_constant(offset: Profile) -> bool:
    if isinstance(offset, Linear):
        ends = offset.base, offset.tip
        return all(isinstance(end, np.ndarray) for end in ends) and bool(ends[0] == ends[1])
    return isinstance(offset, Constant)


def _integral_up_to(whole: Elements, function: Profile, arc_length: Float[Array, "*points"]) -> Float[Array, "*points"]:
    """The integral of `function` from 0 to each arc length, by the Gauss rule on the covered part of each element."""
    starts = whole.edges[:-1]
    covered = jnp.clip(arc_length[..., None] - starts, 0.0, whole.width)
    rule = gauss_rule(whole.order)
    at = starts[:, None] + covered[..., None] * jnp.asarray(rule.nodes, starts.dtype)
    return jnp.sum(covered * (function(at) @ jnp.asarray(rule.weights, starts.dtype)), axis=-1)


def pulling_tension(weight: ArrayLike, friction_coefficient: ArrayLike, wrap_angle: ArrayLike) -> Float[Array, "*rows"]:
    """T_pull = W exp(mu theta), N: the tension that raises a weight W over a fixed pulley. Liu et al. (2020), eq. (5).

    Args:
        weight: W, N.
        friction_coefficient: mu.
        wrap_angle: theta, rad.
    """
    return jnp.asarray(weight) * jnp.exp(friction_coefficient * jnp.asarray(wrap_angle))
