"""vmap, scan and shard_map change nothing, and a lane that fails harms no other."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import codes, paper_body, paper_plain, replaced, stack
from jax.sharding import AxisType, PartitionSpec

import cddf_jax as cddf

# --- lanes that fail -----------------------------------------------------------------------------

# one tendon that slides out, 40 N; the lanes differ in their body, mu is shared
GOOD = paper_body("exact", friction_coefficient=0.3)
LOCKING = replaced(GOOD, youngs_modulus=0.15e6)
FAILURES = {
    "NaN modulus": (replaced(GOOD, youngs_modulus=jnp.nan), 30.0, cddf.Status.unphysical),
    "negative modulus": (replaced(GOOD, youngs_modulus=-1.4e6), 30.0, cddf.Status.unphysical),
    "infinite length": (replaced(GOOD, length=jnp.inf), 30.0, cddf.Status.unphysical),
    "no wall": (paper_body("exact", friction_coefficient=0.3, inner_radius=0.014), 30.0, cddf.Status.unphysical),
    "negative tension": (GOOD, -30.0, cddf.Status.unphysical),
    "NaN tension": (GOOD, jnp.nan, cddf.Status.unphysical),
    "locks": (LOCKING, 60.0, cddf.Status.locked),
}
NUMBERS = (
    *("arc_length", "curvature", "heading", "position", "tension", "wrap_angle", "normal_force", "friction_force"),
    *("tip_tension", "tip_position", "tension_loss", "tendon_displacement", "error_estimate"),
)
NEIGHBOURS = [(GOOD, 30.0), (paper_body("exact", outer_radius=(0.020, 0.018)), 50.0)]


def tip_of(body, tension, mu):
    """Shared mu and a tendon that slides out."""
    solution = cddf.solve(replaced(body, friction_coefficient=mu), tension, direction=-1, throw=False)
    return jnp.concatenate([solution.tip_tension, 10 * solution.tip_position]), solution


def masked_sum(bodies, tensions, mu):
    values, _ = jax.vmap(tip_of, (0, 0, None))(bodies, tensions, mu)
    return jnp.nansum(values)


batch_of_three = jax.jit(jax.vmap(tip_of, (0, 0, None)))
slopes_of_three = jax.jit(lambda *a: (jax.jacfwd(masked_sum, 2)(*a), jax.grad(masked_sum, 2)(*a)))
curvature_of_three = jax.jit(jax.hessian(masked_sum, 2))


def batch_with(failure):
    lanes = [NEIGHBOURS[0], FAILURES[failure][:2], NEIGHBOURS[1]]
    return stack([body for body, _ in lanes]), jnp.array([tension for _, tension in lanes])


def of_neighbours(function):
    """What a function of three lanes has for each neighbour alone, three times."""
    return [function(stack([body] * 3), jnp.full(3, tension), 0.3) for body, tension in NEIGHBOURS]


def test_a_failing_lane_reports_itself_and_leaves_its_neighbours_and_all_derivatives_alone():
    """Of the sum without NaN by the friction that all lanes share: forward, reverse and second derivative."""
    alone = jnp.stack([values[0] for values, _ in of_neighbours(batch_of_three)])
    slopes = sum(np.array(both) / 3 for both in of_neighbours(slopes_of_three))
    bend = sum(x / 3 for x in of_neighbours(curvature_of_three))
    contradicted = cddf.Status.direction_contradicted  # the tendons shorten, and are said to slide out
    for failure, (*_, expected) in FAILURES.items():
        bodies, tensions = batch_with(failure)
        values, solutions = batch_of_three(bodies, tensions, 0.3)
        assert codes(solutions.status) == [contradicted, expected, contradicted], failure
        for name in NUMBERS:
            assert np.all(np.isnan(getattr(solutions, name)[1])), (failure, name)
        np.testing.assert_allclose(values[::2], alone, rtol=1e-10, err_msg=failure)
        np.testing.assert_allclose(slopes_of_three(bodies, tensions, 0.3), slopes, rtol=1e-9, err_msg=failure)
        np.testing.assert_allclose(curvature_of_three(bodies, tensions, 0.3), bend, rtol=1e-8, err_msg=failure)


# --- loops and devices ---------------------------------------------------------------------------

BODY = paper_body("exact")
LADDER = jnp.linspace(10.0, 80.0, 8)


def tip_tension(tension):
    return cddf.solve(BODY, tension, throw=False).tip_tension[0]


tip_tensions = jax.jit(jax.vmap(lambda t: (tip_tension(t), jax.grad(tip_tension)(t))))


LANES, EVERYWHERE = PartitionSpec("lanes"), PartitionSpec()


def on_four_devices(function, in_specs: Any = LANES, out_specs=LANES):
    mesh = jax.make_mesh((4,), ("lanes",), axis_types=(AxisType.Auto,))
    return jax.jit(jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=out_specs))


def test_shard_map_gives_values_slopes_and_curvatures():
    def values(tension):
        slope, bend = jax.jvp(jax.grad(tip_tension), (tension,), (jnp.ones_like(tension),))
        return tip_tension(tension), slope, bend

    sharded = on_four_devices(jax.vmap(values))(LADDER)
    np.testing.assert_allclose(sharded[:2], tip_tensions(LADDER), rtol=1e-10)
    a = 0.42 / 1.4e6 * paper_plain("exact").compliance(0.14)  # T / (1 + a T), docs/theory.md (16)
    np.testing.assert_allclose(sharded[2], -2 * a / (1 + a * LADDER) ** 3, rtol=1e-7)
    assert len(sharded[0].sharding.device_set) == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "target",
    [
        lambda x: (cddf.Displacement(1e-3 * x), 5.0),
        lambda x: cddf.TipPosition(jnp.stack([0.125, 0.04 + 0.002 * x])),
    ],
    ids=["displacement and tension", "place"],
)
def test_targets_that_differ_from_device_to_device(target):
    """Only the target differs; body and tensions are those of all devices. Beside the same batch on one device."""
    pair, wanted = paper_body("exact", num_tendons=2), jnp.linspace(1.0, 4.0, 4)
    reached = jax.vmap(lambda x: cddf.solve(pair, target(x), throw=False).base_tension)
    alone = jax.jit(reached)(wanted)
    assert np.all(np.isfinite(alone))
    np.testing.assert_allclose(on_four_devices(reached)(wanted), alone, rtol=1e-6)


def through_scan(scale, tensions):
    return jax.lax.scan(lambda c, t: (c + tip_tension(scale * t), None), 0.0 * scale, tensions)[0]


def across_devices(scale, tensions):
    def local(scale, tensions):
        return jax.lax.psum(jnp.sum(jax.vmap(lambda t: tip_tension(scale * t))(tensions)), "lanes")

    return on_four_devices(local, (EVERYWHERE, LANES), EVERYWHERE)(scale, tensions)


@pytest.mark.parametrize("total", [through_scan, across_devices])
def test_the_derivative_of_a_sum_is_the_sum_of_derivatives(total):
    """By a number that all lanes share."""
    _, slopes = tip_tensions(LADDER)
    np.testing.assert_allclose(jax.jit(jax.grad(total))(1.0, LADDER), jnp.sum(LADDER * slopes), rtol=1e-10)
