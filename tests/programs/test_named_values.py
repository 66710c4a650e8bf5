"""What is described of arguments and results, and what is not."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body

import cddf_jax as cddf
from cddf_jax.programs.json_form import NotDescribedError, Place, describe, rebuild
from cddf_jax.robot.profiles import Linear

BODY = paper_body("exact")


def without_arrays(tree):
    leaves, structure = jax.tree.flatten(tree)
    return structure.unflatten(map(Place, range(len(leaves))))


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        -3,
        0.1,
        float("-inf"),
        "text",
        (1, [2, {"a": (), "b": None}, {3: 4}]),
        np.dtype("float32"),
        Linear,
        cddf.Status,
        jnp.linalg.inv,
        jax.tree.structure((1, {"a": 2, "b": None})),
        jax.sharding.Mesh(np.array(jax.devices()), ("lanes",)),
        without_arrays(BODY),
        without_arrays(cddf.FixedPoint()),
        without_arrays((cddf.TipAngle(0.5), cddf.Loads())),
    ],
)
def test_what_is_rebuilt_is_the_same(value):
    described = json.loads(json.dumps(describe(value)))
    again = rebuild(described)
    assert type(again) is type(value)
    assert jax.tree.structure(again) == jax.tree.structure(value)
    assert jax.tree.leaves(again) == jax.tree.leaves(value)
    assert describe(again) == described


class Own(eqx.Module):
    """Of a user."""

    value: float = 1.0


@pytest.mark.parametrize(
    "value", [lambda s: s, Own(), Own, (1, Own()), np.ones(2), np.float64(1.0), BODY, {1.5, 2.5}, object()]
)
def test_what_only_this_process_knows_is_not_described(value):
    with pytest.raises(NotDescribedError):
        describe(value)


@pytest.mark.parametrize(
    "described", [{"name": "os:system"}, {"nothing": 1}, {"object": "subprocess:Popen", "fields": {}}]
)
def test_no_other_package_is_named(described):
    with pytest.raises(NotDescribedError):
        rebuild(described)
