"""Programs that are kept: the next process neither traces nor compiles, and never gets a wrong answer."""

import json
import os
import subprocess
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cddf_jax as cddf
from cddf_jax.programs import environment, folder, json_form
from cddf_jax.programs.kept import PROGRAMS, kept_program, shapes_of
from cddf_jax.progress import SHOWN

PAPER = {"length": 0.14, "outer_radius": (0.02, 0.013), "inner_radius": 0.007, "tendon_offset": 0.01}
BODY = cddf.conical(**PAPER, youngs_modulus=1.4e6, friction_coefficient=0.42)
TRACED = []  # what a function was traced for


@kept_program
@eqx.filter_jit
def raised(numbers, power=2, extra=None):
    TRACED.append(numbers)
    found = {"power": numbers["x"] ** power, "left": None, "name": "power"}
    return found if extra is None else found | {"extra": extra(numbers["x"])}


@kept_program
@partial(jax.jit, static_argnames="n")
def inverse(x, n):
    TRACED.append(x)
    return jnp.linalg.inv(x) * n


@kept_program
@eqx.filter_jit
def same(numbers):
    TRACED.append(numbers)
    return numbers


@kept_program
@eqx.filter_jit
def watched(numbers):
    TRACED.append([stage.what for stage in SHOWN.get().now])
    return numbers


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty folder, and an empty memory."""
    monkeypatch.setenv(folder.VARIABLE, str(tmp_path / "programs"))
    next_process()
    return tmp_path / "programs"


def next_process():
    """Forget all programs in memory, and all that JAX has traced, as another process has none."""
    PROGRAMS.clear()
    jax.clear_caches()
    TRACED.clear()


def x(*values, dtype=None):
    return {"x": np.array(values, dtype)}


def test_the_next_process_does_not_trace():
    first = raised(x(1.0, 2.0))
    assert len(TRACED) == 1
    next_process()
    again = raised(x(1.0, 3.0))
    assert TRACED == []
    np.testing.assert_array_equal(first["power"], [1.0, 4.0])  # squares
    np.testing.assert_array_equal(again["power"], [1.0, 9.0])
    assert (again["left"], again["name"]) == (None, "power")


def test_neither_does_the_second_call():
    raised(x(1.0))
    raised(x(2.0))
    assert len(TRACED) == 1


def test_it_is_said_that_one_is_made():
    with cddf.show_progress():
        watched(x(1.0))
    assert TRACED == [["compiling"]]


@pytest.mark.parametrize(
    "other",
    [
        lambda: raised(x(1.0, 2.0, 3.0)),  # a shape
        lambda: raised(x(1.0, 2.0, dtype=np.float32)),  # a type
        lambda: raised(x(1.0, 2.0), power=3),  # an option
        lambda: raised(x(1.0, 2.0), power=2.0),  # a number of another kind
        lambda: raised(x(1.0, 2.0) | {"y": np.ones(2)}),  # a structure
        lambda: raised({"x": jnp.ones_like(1.0, shape=2)}),  # a weak type
    ],
)
def test_any_difference_makes_a_new_program(other):
    raised(x(1.0, 2.0))
    next_process()
    other()
    assert len(TRACED) == 1
    assert len(folder.entries()) == 2


def test_a_setting_of_jax_makes_a_new_program():
    raised(x(1.0))
    next_process()
    with jax.enable_x64(False):
        assert raised(x(1.0))["power"].dtype == np.float32
    assert len(TRACED) == 1
    with jax.default_matmul_precision("float32"):
        raised(x(1.0))
    assert len(TRACED) == 2


@pytest.mark.parametrize("first", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_small_and_large_arrays_of_all_types_come_out_as_they_went_in(first):
    """Small ones go in as one row; the property is that nothing is seen of it."""
    numbers = {
        "x": first(np.arange(6.0).reshape(2, 3)),
        "number": np.float64(0.1),
        "none": np.zeros((0, 3)),
        "single": jnp.asarray([1 / 3], jnp.float32),
        "whole": np.array([2**53 + 1]),
        "flag": np.array([True, False]),
        "weak": jnp.asarray(2.0),
        "complex": np.array([1.0 + 2.0j]),
        "large": jnp.linspace(0.0, 1.0, 1000),
    }
    wanted = jax.tree.map(lambda x: (np.asarray(x).dtype, np.asarray(x).tolist()), numbers)
    for traces in 1, 0:
        next_process()
        found = same(numbers)
        assert jax.tree.map(lambda x: (np.asarray(x).dtype, np.asarray(x).tolist()), found) == wanted
        assert len(TRACED) == traces


def test_the_key_knows_versions_source_machine_and_flags(monkeypatch):
    parts = environment.machine_and_versions()
    packages = ("cddf_jax", "jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
    assert {text.split()[0] for text in parts if text} >= set(packages)
    assert {os.environ["XLA_FLAGS"], sys.version} <= set(parts)
    for i, text in enumerate(parts):
        changed = (*parts[:i], f"{text} another", *parts[i + 1 :])
        monkeypatch.setattr("cddf_jax.programs.kept.machine_and_versions", lambda changed=changed: changed)
        next_process()
        raised(x(1.0))
        assert len(TRACED) == 1


def test_an_edited_source_is_another_one(tmp_path, monkeypatch):
    (tmp_path / "module.py").write_text("LAW = 1\n")
    monkeypatch.setattr(environment, "SOURCE", tmp_path)
    before, stamp = environment.source.__wrapped__(), environment.stamp()
    (tmp_path / "module.py").write_text("LAW = 22\n")
    assert environment.source.__wrapped__() != before
    assert environment.stamp() != stamp


def test_nothing_is_kept_once_the_source_is_edited(place, monkeypatch):
    monkeypatch.setattr(environment, "STAMP", (("module.py", 0, 0),))
    raised(x(1.0))
    assert not place.exists()


def test_traced_values_are_left_to_jax(place):
    np.testing.assert_array_equal(jax.grad(lambda y: raised({"x": y})["power"])(3.0), 6.0)  # of the square
    np.testing.assert_array_equal(jax.vmap(lambda y: raised({"x": y})["power"])(jnp.arange(3.0)), [0.0, 1.0, 4.0])
    np.testing.assert_array_equal(jax.jit(lambda y: raised({"x": y})["power"])(3.0), 9.0)
    assert not place.exists()


class Mine(eqx.Module):
    """A class of a user's."""

    x: np.ndarray


def test_what_involves_a_user_is_not_kept(place):
    raised(x(1.0), extra=lambda y: y + 1)
    raised(x(1.0) | {"mine": Mine(np.ones(2))})
    raised(x(1.0) | {"number": 2.5})  # each value of it would make a program
    assert not place.exists()


def test_what_calls_back_into_python_is_not_kept(place):
    @kept_program
    @jax.jit
    def sine(y):
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(np.shape(y), np.float64), y, vmap_method="sequential")

    np.testing.assert_array_equal(sine(np.ones(2)), np.sin(np.ones(2)))
    assert not place.exists()


def test_arrays_of_other_devices_are_left_to_jax(place):
    other = jax.device_put(np.ones(2), jax.devices()[1])
    assert raised({"x": other})["power"].devices() == {jax.devices()[1]}
    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("i",))
    shared = jax.device_put(np.ones(4), jax.sharding.NamedSharding(mesh, jax.P("i")))
    np.testing.assert_array_equal(raised({"x": shared})["power"], np.ones(4))
    assert not place.exists()


def test_results_can_go_to_another_device():
    for _ in range(2):
        found = raised(x(2.0))["power"]
        np.testing.assert_array_equal(found + jax.device_put(np.ones(1), jax.devices()[1]), [5.0])
        next_process()


@pytest.mark.parametrize("spoil", ["bit", "half", "empty", "other", "text"])
def test_a_spoilt_entry_is_made_again(spoil, recwarn):
    raised(x(1.0))
    (entry,) = folder.entries()
    whole = entry.read_bytes()
    raised(x(1.0, 2.0))
    (other,) = set(folder.entries()) - {entry}
    changed = whole[:-20] + bytes([whole[-20] ^ 1]) + whole[-19:]
    spoilt = {"bit": changed, "half": whole[: len(whole) // 2], "empty": b"", "text": b"not a program\n\n"}
    entry.write_bytes(other.read_bytes() if spoil == "other" else spoilt[spoil])
    next_process()
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert len(TRACED) == 1
    assert not recwarn.list
    next_process()
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert TRACED == []


@pytest.mark.parametrize("case", ["executable", "about", "answer", "outputs"])
def test_an_entry_that_cannot_be_used_is_made_again(case):
    raised(x(1.0))
    (path,) = folder.entries()
    whole = folder.read(path.stem)
    foreign = {
        "executable": folder.Entry(whole.about, b"no executable"),
        "about": folder.Entry({}, whole.content),
        "answer": folder.Entry(whole.about | {"answer": {"name": "os:system"}}, whole.content),
        "outputs": folder.Entry(whole.about | {"outputs": []}, whole.content),
    }
    folder.write(path.stem, foreign[case])
    next_process()
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert len(TRACED) == 1


def test_switched_off(place, monkeypatch):
    monkeypatch.setenv(folder.VARIABLE, "off")
    raised(x(1.0))
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert len(TRACED) == 1
    assert not place.exists()
    next_process()
    raised(x(1.0))
    assert len(TRACED) == 1


def test_a_folder_that_cannot_be_made_keeps_nothing(place, recwarn):
    place.write_text("a file")
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert place.read_text() == "a file"
    assert not recwarn.list


@pytest.mark.skipif(sys.platform == "win32", reason="modes of folders are those of Unix")
def test_a_folder_that_others_can_write_to_is_not_trusted(place):
    place.mkdir()
    place.chmod(0o777)
    np.testing.assert_array_equal(raised(x(3.0))["power"], [9.0])
    assert folder.entries() == []


@pytest.mark.slow
def test_an_equilibrium_is_that_of_a_fresh_trace_to_the_last_bit(place, monkeypatch):
    loads = cddf.Loads(tip_force=(0.0, -1.0))
    monkeypatch.setenv(folder.VARIABLE, "off")
    fresh = [cddf.solve(BODY, 75.0), cddf.solve(BODY, 40.0, loads)]
    monkeypatch.setenv(folder.VARIABLE, str(place))
    for _ in range(2):
        next_process()
        for one, there in zip((cddf.solve(BODY, 75.0), cddf.solve(BODY, 40.0, loads)), fresh, strict=True):
            assert jax.tree.structure(one) == jax.tree.structure(there)
            for ours, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(there), strict=True):
                assert (ours.dtype, ours.committed) == (theirs.dtype, theirs.committed)
                np.testing.assert_array_equal(ours, theirs)
            assert one.status == cddf.Status.successful
        assert len(folder.entries()) == 2


FRESH = """
import json
from cddf_jax.application import configure_jax
configure_jax()
import jax
compiled = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **_: compiled.append(name) if "backend_compile" in name or "jaxpr_trace" in name else None
)
import cddf_jax as cddf
cddf.solve
before = dict(jax.config.values)
body = cddf.conical(length=0.14, outer_radius=(0.02, 0.013), inner_radius=0.007, tendon_offset=0.01,
                    youngs_modulus=1.4e6, friction_coefficient=0.42)
found = cddf.solve(body, 40.0, cddf.Loads(tip_force=(0.0, -1.0)))
assert dict(jax.config.values) == before
print(json.dumps([float(found.tip_angle).hex(), len(compiled)]))
"""


def fresh_processes(count):
    """What so many processes that start at once print: the angle of the tip, and how much was traced and compiled."""
    run = partial(subprocess.Popen, [sys.executable, "-c", FRESH], stdout=subprocess.PIPE, text=True)
    started = [run() for _ in range(count)]
    printed = [one.communicate(timeout=300)[0] for one in started]
    assert all(one.returncode == 0 for one in started)
    return [json.loads(text) for text in printed]


class Scaled(eqx.Module):
    by: jax.Array
    extra: object = eqx.field(static=True, default=None)

    def __call__(self, x):
        TRACED.append(x)
        return {"square": self.by * x["x"] ** 2, "above": x["x"] > 0}


def test_shapes_are_kept_and_those_of_a_user_are_not(place, monkeypatch):
    numbers, users = {"x": np.ones(3)}, Scaled(jnp.ones(()), lambda: None)
    traced = jax.eval_shape(users, numbers)
    assert shapes_of(users, numbers) == traced
    assert not place.exists()
    monkeypatch.setattr(json_form, "PACKAGES", (*json_form.PACKAGES, Scaled.__module__.partition(".")[0]))
    next_process()
    assert [shapes_of(Scaled(jnp.ones(())), numbers) for _ in range(2)] == [traced, traced]
    assert len(TRACED) == len(list(place.iterdir())) == 1


@pytest.mark.slow
def test_several_processes_at_once_and_one_that_follows():
    together = fresh_processes(3)
    ((angle, compiled),) = fresh_processes(1)
    assert {one for one, _ in together} == {angle}
    assert max(count for _, count in together) > 0
    assert compiled == 0
    assert len(folder.entries()) == 1


def test_a_fresh_process_finds_lapack():
    program = f"""
import sys, numpy as np, jax
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, {os.path.dirname(__file__)!r})
import test_kept
print(test_kept.inverse(np.array([[2.0]]), n=3).item(), len(test_kept.TRACED))
"""
    for traced in (1, 0):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300)
        assert done.stdout.split() == ["1.5", str(traced)]  # 3 / 2
