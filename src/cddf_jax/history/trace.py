"""`trace`: pull and release, and `tip_compliance` of what it returns."""

from collections.abc import Sequence
from functools import partial
from typing import Literal, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..errors import SolveError
from ..numerics.given_numbers import check_numbers
from ..quantities import check_range_in_space
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator, in_space
from ..robot.validation import check_loads
from ..statics.arguments import check_nodes, refuse_batch
from ..statics.equilibrium import nan_unless
from ..statics.response import tip_compliance
from ..statics.status import Status, words_of
from ..statics.targets import Displacement, TipAngle
from .grid import Goal
from .history import GOOD, History
from .path import ALONG_A_PATH, Driven, Path, as_numbers, entries_of, given_path
from .play_operator import Before, CongruentStates, congruent_history
from .stepped import ACCURACY, ELEMENTS, Following, SteppedStates, after_first, squeezed, stepped_history

LEAST_MOVE = 1e-6  # of the tip by a push, over the length and in rad; steps settle to some 1e-8 of them
BOTH_GIVEN = "trace: before and start both give the history before the first step; leave one of them out"


def trace(
    manipulator: Manipulator,
    base_tension: Driven,
    loads: Loads | Sequence[Loads] | None = None,
    *,
    before: ArrayLike | Literal["rest"] = "rest",
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
        loads: `Loads`. Each of tip_force, tip_moment and gravity either acts already before the first step and stays,
            or has a leading axis of steps, one load after each step; then it starts from zero. So gravity can rest on
            the body while a force changes. A list of `Loads`, one for each step, starts from no loads. None for no
            loads. After `start` they continue from the loads of that history; None then keeps those loads.
        before: the largest base tension, N, that the tendon had before it was released to the first step; "rest" for
            tendons that never had a tension. For several tendons, (tendons,), and under loads, it is a step before the
            first, to which all tensions rise linearly from rest; loads that change along the path come after it.
        start: the history of the same body that continues, in place of `before`. Its elements are kept, not `nodes`.
            The carry of `jax.lax.scan` must keep its structure: begin with a history of as many steps as each call has,
            such as `trace(body, [0.0])` for one step.
        nodes: Gauss nodes in each smooth piece of the body, 4 or more; static. With several tendons or loads the piece
            has four times as many elements.
        max_turns: how many turns can be remembered at once, 1 or more; static. Where there are more, the status of the
            step is `too_many_turns`. A loop closes when a tension passes the turn before: then two turns are forgotten.
            With several tendons or loads there is no such limit.
        short_steps: into how many increments each step is divided with several tendons or loads, 2 or more; static. A
            path of many steps needs fewer.
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
    _check_driven(base_tension)
    manipulator = _as_known(manipulator, base_tension, loads)
    check_nodes(nodes)
    for name, value, least in (("max_turns", max_turns, 1), ("short_steps", short_steps, 2)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"trace: {name} must be a whole number of {least} or more, got {value!r}")
    if start is not None and not isinstance(start, History):
        raise TypeError(f"trace: start must be a History, got {type(start).__name__}")
    if start is not None:
        _check_same_body(manipulator, start)
    if _is_exact(manipulator, base_tension, loads, start):
        quantity, values = _path(base_tension)
        if manipulator.in_space and not isinstance(values, Tracer):
            check_range_in_space("trace", quantity, values)
        past = _before(before, start, values.dtype)
        _check_largest(past, quantity, values)
        program = partial(congruent_history, manipulator, values, past, nodes, max_turns, quantity)
    else:
        program = partial(_in_increments, manipulator, base_tension, loads, before, start, nodes, short_steps)
        program = partial(program, estimate_error)
    try:
        history = program()
    except (TypeError, ValueError):
        refuse_batch("trace", manipulator)
        raise
    if throw:
        _raise_if_failed(history)
    return history


def _is_exact(manipulator: Manipulator, base_tension: Driven, loads: object, start: History | None) -> bool:
    """Whether the path has an exact answer."""
    driven = [entry for entry in entries_of(base_tension) if isinstance(entry, ALONG_A_PATH)]
    followed = start is not None and isinstance(start._states, SteppedStates)
    known = all(isinstance(entry, Displacement | TipAngle) for entry in driven)
    return manipulator.num_tendons == 1 and loads is None and known and not followed and not manipulator.has_memory


def _check_driven(base_tension: Driven) -> None:
    """Refuse targets of `solve` that drive no tendon along a path."""
    for entry in entries_of(base_tension):
        if isinstance(entry, eqx.Module) and not isinstance(entry, ALONG_A_PATH):
            kinds = ", ".join(kind.__name__ for kind in ALONG_A_PATH)
            raise TypeError(
                f"trace: a path may hold base tensions, {kinds}, got {type(entry).__name__}; give the tension or the "
                "length pulled in after each step (solve finds tensions without a history: they are right up to the "
                "first turn only)"
            )


def _as_known(manipulator: Manipulator, base_tension: Driven, loads: Loads | Sequence[Loads] | None) -> Manipulator:
    """The body, with an angle of its tendon where it is in space; refuse what `trace` cannot follow in space."""
    given = loads if isinstance(loads, tuple | list) else [loads]
    turned = manipulator.in_space or any(isinstance(entry, Loads) and entry.in_space for entry in given)
    return in_space(manipulator) if turned else manipulator


def _check_largest(past: Before, quantity: str, values: Array) -> None:
    """Refuse a `before` that is smaller than the tension of the first step, where the numbers are known."""
    if past.work_and_loss is not None or past.open_tension.size == 0 or isinstance(past.open_tension, Tracer):
        return
    largest = float(past.open_tension[0])
    first = 0.0 if quantity != "base_tension" or isinstance(values, Tracer) else float(values[0])
    if largest < max(first, 0.0):
        raise ValueError(
            f"trace: before must be the largest base tension up to the first step, {max(first, 0.0):g} N or more, "
            f"got {largest:g} N"
        )


def _check_same_body(manipulator: Manipulator, start: History) -> None:
    """Refuse a history of another body, where the numbers are known."""
    without = [eqx.tree_at(lambda b: b.point_masses, b, ()) for b in (manipulator, start._states.manipulator)]
    (leaves, one), (others, other) = map(jax.tree.flatten, without)
    known = not any(isinstance(x, Tracer) for x in [*leaves, *others])
    if one != other or (known and not all(np.array_equal(a, b) for a, b in zip(leaves, others, strict=True))):
        raise ValueError("trace: start is the history of another body; trace this body from rest")


def _in_increments(
    manipulator: Manipulator,
    base_tension: Driven,
    loads: Loads | Sequence[Loads] | None,
    before: ArrayLike | Literal["rest"],
    start: History | None,
    nodes: int,
    short_steps: int,
    estimated: bool,
) -> History:
    path, driven = given_path(manipulator, base_tension, loads)
    earlier = _earlier(manipulator, before, start, driven)
    if earlier is not None:
        path = path.behind(earlier)
    if loads is None and start is not None and isinstance(start._states, SteppedStates):
        path = path.under(start._states.loads)  # the last loads stay
    check_loads(manipulator, path.loads)
    if path.tension.dtype != jnp.float64:
        raise ValueError(
            "trace: several tendons or loads need 64-bit numbers; jax.config.update('jax_enable_x64', True) first"
        )
    states = None if start is None else start._states
    kind = Following(driven, ELEMENTS * nodes, short_steps, estimated)
    if isinstance(states, SteppedStates):
        _check_same_points(path.loads, states.loads)
        kind = kind._replace(num_elements=states.num_elements, estimated=estimated and states.passes.work.shape[0] > 1)
    elif states is not None:
        raise ValueError("trace: start is a history of one tendon without loads; trace it with loads from rest on")
    history = stepped_history(manipulator, path, states, kind)
    history = history if earlier is None else after_first(history)
    return squeezed(history) if manipulator.num_tendons == 1 else history


def _check_same_points(loads: Loads | None, before: Loads) -> None:
    """Refuse other places of point loads than those of the history before, where elements end."""
    places = [[] if each is None else [point.arc_length for point in each.points] for each in (loads, before)]
    if len(places[0]) != len(places[1]) or not all(
        isinstance(one, Tracer) or isinstance(other, Tracer) or np.all(np.asarray(one) == np.asarray(other))
        for one, other in zip(*places, strict=True)
    ):
        raise ValueError("trace: start has point loads at other places; give those that do not act 0 N from rest on")


def _earlier(
    manipulator: Manipulator, before: ArrayLike | Literal["rest"], start: History | None, driven: tuple[Goal, ...]
) -> Float[Array, " tendons"] | None:
    """The tensions of the step before the first; None where there is no such step."""
    if isinstance(before, str) and before == "rest":
        return None
    if start is not None:
        raise ValueError(BOTH_GIVEN)
    if driven:
        raise ValueError("trace: before= needs tensions along the path; give earlier displacements as the first steps")
    count = manipulator.num_tendons
    tension = jnp.atleast_1d(as_numbers(before, "trace: before"))
    if tension.shape != (count,):
        raise ValueError(
            f'trace: before must be "rest" or base tensions, N, of the shape (tendons,), ({count},) for this body, got '
            f"{np.shape(tension)}"
        )
    if not isinstance(tension, Tracer) and not np.all((np.asarray(tension) >= 0) & np.isfinite(tension)):
        raise ValueError(f"trace: before must hold tensions of 0 N or more, got {np.asarray(tension).tolist()}")
    return tension


def _path(given: Driven) -> tuple[str, Float[Array, " steps"]]:
    """The name of the given quantity, and its values."""
    if isinstance(given, tuple | list) and len(given) == 1 and isinstance(given[0], Displacement | TipAngle):
        given = given[0]
    target = isinstance(given, Displacement | TipAngle)
    quantity, values = (given.quantity, given.value) if target else ("base_tension", cast("ArrayLike", given))
    numbers = as_numbers(values, f"trace: {quantity}")
    numbers = numbers[:, 0] if numbers.ndim == 2 and numbers.shape[1] == 1 else numbers
    if numbers.ndim != 1 or numbers.size == 0:
        unit = {"base_tension": "tensions, N", "displacement": "lengths, m", "tip_angle": "angles, rad"}[quantity]
        raise ValueError(
            f"trace: {quantity} must be a list of {unit}, one for each step, got the shape {numbers.shape}"
        )
    return quantity, numbers


def _before(before: ArrayLike | Literal["rest"], start: History | None, dtype: jnp.dtype) -> Before:
    at_rest = isinstance(before, str) and before == "rest"
    if not at_rest and (isinstance(before, str) or np.ndim(before) != 0):
        raise ValueError(f'trace: before must be "rest" or the largest base tension, N, got {before!r}')
    if not at_rest:
        check_numbers("trace: before", before)
    if start is None:
        return Before(jnp.zeros(0, dtype) if at_rest else jnp.asarray(before, dtype)[None])
    if not at_rest:
        raise ValueError(BOTH_GIVEN)
    states = start._states
    assert isinstance(states, CongruentStates)
    return Before(states.open_tension, jnp.stack([start.work[-1], start.friction_loss[-1]]))


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
    raise SolveError(f"step {step} of the trace, {_in_newton(history.base_tension[step])}: {words}")


def _in_newton(base_tension: Float[Array, "*tendons"]) -> str:
    return ", ".join(f"{float(tension):g}" for tension in np.ravel(base_tension)) + " N"


# --- a push after it ------------------------------------------------------------------------------


@tip_compliance.register
def _(history: History, *, push: ArrayLike | Sequence[float] | None = None, short_steps: int = 16) -> Float[Array, "3"]:
    """The change of the tip pose (X, Y, phi) by a push on the tip after the last step, per newton: m/N, m/N and rad/N.

    It is one-sided, and the mean over the push. Friction holds the tendons; they begin to slide at the base, and slide
    further out under a harder push. The base tensions stay. Where friction holds tendons that do not stretch, the
    compliance of the angle goes to zero with the push. That of the position need not: one part of a tendon may slide
    in and another out, so that the body bends to and fro.

    Args:
        history: of `trace`.
        push: the force (X, Y), N, in addition to the loads.
        short_steps: into how many increments the push is divided, 2 or more; static.

    Raises:
        ValueError: for a body in space, a push without two components or of 0 N, or short_steps below 2.
        SolveError: where the numbers are known, and no equilibrium under the push was found, or the push moves the tip
            by less than 1e-6 of the length and 1e-6 rad, which rounding may do. Under a transformation NaN.
    """
    if history.tip_frame is not None:
        raise ValueError(
            "tip_compliance: the history is of a body in space; use tip_compliance(robot, ...), where tendons slide"
        )
    check_numbers("tip_compliance: push", 0.0 if push is None else push)
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
        kind = Following((), ELEMENTS * states.nodes, short_steps)
        history = stepped_history(states.manipulator, path, None, kind)
        states = history._states
    assert isinstance(states, SteppedStates)
    pushed = eqx.tree_at(lambda loads: loads.tip_force, states.loads, states.loads.tip_force + push)
    tension = history.base_tension[-1:].reshape(1, -1)
    path = Path(tension, jnp.zeros_like(tension), jax.tree.map(lambda x: x[None], pushed))
    after = stepped_history(states.manipulator, path, states, Following((), states.num_elements, short_steps))

    if not isinstance(after.status, Tracer) and np.ndim(after.status) == 1 and np.any(np.isnan(after.tip_angle)):
        raise SolveError("tip_compliance: no equilibrium was found under the push; push less, or raise short_steps=")

    def pose(history: History) -> Float[Array, "3"]:
        return jnp.append(history.tip_position[-1], history.tip_angle[-1])

    moved = pose(after) - pose(history)
    seen = jnp.linalg.norm(moved / jnp.append(jnp.full(2, states.manipulator.length), 1.0)) > LEAST_MOVE
    if not isinstance(seen, Tracer) and not np.any(seen):
        raise SolveError(
            f"tip_compliance: a push of {float(np.linalg.norm(np.asarray(push))):g} N moves the tip by less than "
            f"{LEAST_MOVE:g} of the length, as rounding may do; push harder"
        )
    return nan_unless(seen, moved / jnp.linalg.norm(push))
