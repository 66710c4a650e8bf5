"""`trace`: pull and release, and `tip_compliance` of what it returns."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, PyTree

from ..errors import SolveError
from ..numerics.given_numbers import check_numbers, check_whole
from ..numerics.rotations import rotation_vector
from ..quantities import check_range_in_space
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator, in_space
from ..robot.validation import check_loads
from ..statics.arguments import refuse_batch
from ..statics.equilibrium import nan_unless
from ..statics.response import tip_compliance
from ..statics.status import Status, words_of
from .grid import Goal
from .history import GOOD, History, listed
from .path import Driven, Path, as_numbers, check_moments, given_path
from .play_operator import CongruentStates, congruent_history
from .stepped import ACCURACY, ELEMENTS, Following, SteppedStates, after_first, after_step, squeezed, stepped_history

LEAST_MOVE = 1e-6  # of the tip by a push, over the length and in rad; steps settle to some 1e-8 of them


def trace(
    manipulator: Manipulator,
    base_tension: Driven,
    loads: Loads | Sequence[Loads] | None = None,
    *,
    before: ArrayLike | Sequence[ArrayLike] | Literal["rest"] = "rest",
    start: History | None = None,
    nodes: int = 16,
    max_turns: int = 16,
    short_steps: int = 16,
    estimate_error: bool = True,
    throw: bool = True,
) -> History:
    """Pull and release a manipulator, from rest.

    One tendon without loads has an exact answer, in the plane and in space. Several tendons, loads, and friction
    besides that of tendons on the body are followed in increments with elements of finite length; `error_estimate`
    compares with results for half as many increments and for half as many elements. An increment that does not settle
    is cut; where that does not help, the step says so. Works under jit, vmap, grad and scan. Derivatives are continuous
    where fronts move; at a turn they are those of the direction in which the step went. With several tendons or loads
    only first derivatives are valid, and 64-bit numbers are needed.

    Args:
        manipulator: the body.
        base_tension: T_base >= 0, N, after each step, in the order of time: (steps,) for one tendon, or (steps,
            tendons). Between two steps the tensions change linearly. `Displacement([...])`, m, or `TipAngle([...])`,
            rad, after each step is also possible; then the tensions are found. Several tendons may have an entry
            (steps,) each, some of them a `Displacement`, `TipAngle`, `TipTension` or `TotalTension`. A tendon of given
            displacement that would have to push is slack until it is pulled in again. The status of such a step is
            `slack`, which is not an error; its displacement is that at which the tendon became slack. Where another
            target asks a tendon to push, the status is `unreachable`; so it is for one tendon in space whose tip angle
            does not grow while it is pulled.
        loads: `Loads`. Each of tip_force, tip_moment, gravity and those of points either acts already before the first
            step and stays, or has a leading axis of steps, one load after each step; then it starts from zero. So
            gravity can rest on the body while a force changes. A list of `Loads`, one for each step, starts from no
            loads. None for no loads. After `start` they continue from the loads of that history; None then keeps those
            loads.
        before: the largest base tension, N, that the tendon had before it was released to the first step; "rest" for
            tendons that never had a tension. For several tendons, (tendons,), and under loads, it is a step before the
            first, to which all tensions rise linearly from rest; loads that change along the path come after it.
            Displacements before the path are its first steps.
        start: the history of the same body that continues, in place of `before`. Its elements are kept, not `nodes`.
            The carry of `jax.lax.scan` must keep its structure: begin with a history of as many steps as each call has,
            such as `trace(body, [0.0])` for one step.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static. With several tendons or loads the piece
            has three times as many elements.
        max_turns: how many turns can be remembered at once, 1 or more; static. Where there are more, the status of the
            step is `too_many_turns`. A loop closes when a tension passes the turn before: then two turns are forgotten.
            With several tendons or loads there is no such limit.
        short_steps: into how many increments a step is divided with several tendons or loads, 2 or more; static. It
            counts for steps that would turn the body by 0.5 rad or more without friction. Smaller ones have fewer in
            proportion, but at least 2.
        estimate_error: static. Without it several tendons or loads take a third of the time, `error_estimate` is NaN,
            and no step is called `inaccurate`. A `start` without an estimate is continued without one.
        throw: raise an error if a step failed, where the values are known.

    Raises:
        SolveError: with `throw`, when a step failed; it names the step.
        ValueError: for tensions or loads of a wrong shape, both `before` and `start`, nodes below 4, max_turns
            below 1, short_steps below 2, a `start` of another kind of path, or 32-bit numbers where 64 bits are needed.
        TypeError: if an argument has the wrong type.
    """
    if not isinstance(manipulator, Manipulator):
        raise TypeError(f"trace: the first argument must be a Manipulator, got {type(manipulator).__name__}")
    if start is not None and not isinstance(start, History):
        raise TypeError(f"trace: start must be a History, got {type(start).__name__}")
    each = loads if isinstance(loads, tuple | list) else [loads]
    planar = not (manipulator.in_space or (start is not None and start._states.manipulator.in_space))
    if not planar or any(isinstance(one, Loads) and one.in_space for one in each):
        manipulator = in_space(manipulator)
    check_whole("nodes", nodes, 4)
    check_whole("trace: max_turns", max_turns, 1)
    check_whole("trace: short_steps", short_steps, 2)
    if start is not None:
        here, there = (eqx.tree_at(lambda b: b.point_masses, b, ()) for b in (manipulator, start._states.manipulator))
        _check_same(here, there, "trace: start is the history of another body; trace this body from rest")
    try:
        path, driven = given_path(manipulator, base_tension, loads)
        if planar and isinstance(loads, Loads):
            check_moments(loads, path.given.shape[0])
        earlier = _earlier(manipulator, before, start)
        followed = start is not None and isinstance(start._states, SteppedStates)
        alone = manipulator.num_tendons == 1 and not manipulator.has_memory and loads is None
        if alone and not followed and all(goal.quantity in ("displacement", "tip_angle") for goal in driven):
            history = _exactly(manipulator, path, driven, earlier, start, nodes, max_turns)
        else:
            kind = Following(driven, ELEMENTS * nodes + nodes % 2, short_steps, estimate_error)
            history = _in_increments(manipulator, path, loads is None, earlier, start, kind)
    except (TypeError, ValueError):
        refuse_batch("trace", manipulator)
        raise
    if throw:
        _raise_if_failed(history)
    return history


def _exactly(
    manipulator: Manipulator,
    path: Path,
    driven: tuple[Goal, ...],
    earlier: Float[Array, "1"] | None,
    start: History | None,
    nodes: int,
    max_turns: int,
) -> History:
    quantity = driven[0].quantity if driven else "base_tension"
    values = path.given[:, 0]
    if manipulator.in_space and not isinstance(values, Tracer):
        check_range_in_space("trace", quantity, values)
    past, spent = jnp.zeros(0, values.dtype) if earlier is None else earlier.astype(values.dtype), None
    if start is not None:
        assert isinstance(start._states, CongruentStates)
        energies = start.energies
        past, spent = start._states.open_tension, jnp.stack([energies.work[-1], energies.friction_loss[-1]])
    known = not isinstance(earlier, Tracer) and not isinstance(values, Tracer)
    if earlier is not None and known and not driven and earlier[0] < values[0]:
        raise ValueError(
            f"trace: before must be the largest base tension up to the first step, {float(values[0]):g} N or more, "
            f"got {float(earlier[0]):g} N"
        )
    return congruent_history(manipulator, values, past, spent, nodes, max_turns, quantity)


def _check_same(one: PyTree, other: PyTree, words: str) -> None:
    """Refuse a history with other numbers, where they are known.

    Raises:
        ValueError: with these words.
    """
    (leaves, structure), (others, other_structure) = map(jax.tree.flatten, (one, other))
    pairs = [pair for pair in zip(leaves, others, strict=False) if not any(isinstance(x, Tracer) for x in pair)]
    if structure != other_structure or not all(np.array_equal(*pair) for pair in pairs):
        raise ValueError(words)


def _in_increments(
    manipulator: Manipulator,
    path: Path,
    goes_on: bool,
    earlier: Float[Array, " tendons"] | None,
    start: History | None,
    kind: Following,
) -> History:
    """Follow a path; `goes_on`: whether the loads of `start` stay."""
    path = path if earlier is None else path.behind(earlier)
    states = None if start is None else start._states
    if goes_on and isinstance(states, SteppedStates):
        path = path.under(states.loads)
    check_loads(manipulator, path.loads)
    if path.given.dtype != jnp.float64:
        raise ValueError(
            "trace: several tendons or loads need 64-bit numbers; jax.config.update('jax_enable_x64', True) first"
        )
    if isinstance(states, SteppedStates):
        both = jax.tree.map(lambda x: x[-1], path.loads), states.loads
        here, there = ([point.arc_length for point in each.points] for each in both)
        words = "trace: start has point loads at other places; give those that do not act 0 N from rest on"
        _check_same(here, there, words)
        estimated = kind.estimated and states.passes.work.shape[0] > 1
        kind = kind._replace(num_elements=states.num_elements, estimated=estimated)
    elif states is not None:
        raise ValueError("trace: start is a history of one tendon without loads; trace it with loads from rest on")
    history = stepped_history(manipulator, path, states, kind)
    history = history if earlier is None else after_first(history)
    history = history if start is None else after_step(start.tip_angle[-1], start.status[-1], history)
    return squeezed(history) if manipulator.num_tendons == 1 else history


def _earlier(
    manipulator: Manipulator, before: ArrayLike | Sequence[ArrayLike] | Literal["rest"], start: History | None
) -> Float[Array, " tendons"] | None:
    """The tensions before the first step, N; None where there is no such step."""
    if isinstance(before, str) and before == "rest":
        return None
    if start is not None:
        raise ValueError("trace: before and start both give the history before the first step; leave one of them out")
    count = manipulator.num_tendons
    words = f'trace: before must be "rest" or base tensions, N, of the shape (tendons,), ({count},) for this body, got '
    if isinstance(before, str):
        raise ValueError(f"{words}{before!r}")
    tension = jnp.atleast_1d(as_numbers(before, "trace: before"))
    if tension.shape != (count,):
        raise ValueError(f"{words}{np.asarray(before).shape}")
    if not isinstance(tension, Tracer) and not np.all((np.asarray(tension) >= 0) & np.isfinite(tension)):
        raise ValueError(f"trace: before must hold tensions of 0 N or more, got {np.asarray(tension).tolist()}")
    return tension


def _raise_if_failed(history: History) -> None:
    codes = history.status
    if isinstance(codes, Tracer) or np.ndim(codes) != 1:
        return
    failed = ~np.isin(np.asarray(codes), GOOD)
    if not np.any(failed):
        return
    step = int(np.argmax(failed))
    words = words_of(codes[step])
    if isinstance(history._states, SteppedStates) and codes[step] == Status.inaccurate:
        words = f"The error estimate exceeds {ACCURACY:g}: raise short_steps= and nodes=, or give throw=False."
    raise SolveError(f"step {step} of the trace, {listed(np.asarray(history.base_tension[step]), 'force')}: {words}")


# --- a push after it ------------------------------------------------------------------------------


@tip_compliance.register
def _(
    history: History, *, push: ArrayLike | Sequence[float] | None = None, short_steps: int = 16
) -> Float[Array, " pose"]:
    """The change of the tip pose (X, Y, phi) by a push on the tip after the last step, per newton: m/N, m/N and rad/N.

    In space it has six numbers: position, and the rotation vector of the tip, about X, Y, Z.

    It is one-sided, and the mean over the push. Friction holds the tendons; they begin to slide at the base, and slide
    further out under a harder push. The base tensions stay. Where friction holds tendons that do not stretch, the
    compliance of the angle goes to zero with the push. That of the position need not: one part of a tendon may slide
    in and another out, so that the body bends to and fro.

    Args:
        history: of `trace`.
        push: the force (X, Y), in space (X, Y, Z), N, in addition to the loads.
        short_steps: into how many increments the push is divided, 2 or more; static.

    Raises:
        ValueError: for a push of another number of components or of 0 N, or short_steps below 2.
        SolveError: where the numbers are known, and no equilibrium under the push was found, or the push moves the tip
            by less than 1e-6 of the length and 1e-6 rad, which rounding may do. Under a transformation NaN.
    """
    states, follow = history._states, partial(trace, short_steps=short_steps, estimate_error=False, throw=False)
    axes = "XYZ"[: states.manipulator.components]
    check_numbers("tip_compliance: push", 0.0 if push is None else push)
    if push is None or np.shape(push) != (len(axes),):
        needed = f"{len(axes)} components ({', '.join(axes)}), N"
        raise ValueError(f"tip_compliance: after a history, push= must have {needed}, got {push!r}")
    if not isinstance(push, Tracer) and not 0 < float(np.linalg.norm(np.asarray(push))) < np.inf:
        raise ValueError(f"tip_compliance: push must be a force above 0 N, got {push!r}")
    push = jnp.asarray(push, float)
    if isinstance(states, CongruentStates):
        history = follow(states.manipulator, states.path, Loads(), nodes=states.nodes)
        states = history._states
    assert isinstance(states, SteppedStates)
    pushed = eqx.tree_at(lambda loads: loads.tip_force, states.loads, states.loads.tip_force + push)
    after = follow(states.manipulator, history.base_tension[-1:], pushed, start=history)

    if not isinstance(after.status, Tracer) and np.ndim(after.status) == 1 and np.any(np.isnan(after.tip_angle)):
        raise SolveError("tip_compliance: no equilibrium was found under the push; push less, or raise short_steps=")

    shift, turned = after.tip_position[-1] - history.tip_position[-1], after.tip_angle[-1] - history.tip_angle[-1]
    if history.tip_frame is not None and after.tip_frame is not None:
        turned = rotation_vector(after.tip_frame[-1] @ history.tip_frame[-1].T)
    seen = jnp.linalg.norm(jnp.append(shift / states.manipulator.length, turned)) > LEAST_MOVE
    if not isinstance(seen, Tracer) and not np.any(seen):
        raise SolveError(
            f"tip_compliance: a push of {float(np.linalg.norm(np.asarray(push))):g} N moves the tip by less than "
            f"{LEAST_MOVE:g} of the length, as rounding may do; push harder"
        )
    return nan_unless(seen, jnp.append(shift, turned) / jnp.linalg.norm(push))
