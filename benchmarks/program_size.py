"""How large the compiled programs are: operations of the lowered modules, and the time to trace and compile them.

Compiling is what a user waits for, and it grows with the size of the program. Operations are those of the StableHLO
module with every call expanded, so that moving code into functions is no gain. XLA fuses them into kernels, and
compiles each kernel by itself: their number says more about the time than that of the operations. Beside them stands a
plain RK4 `lax.scan` of one tendon, which is what a user would otherwise write. Times are the least of three first
calls.

    python benchmarks/program_size.py
"""

import re
import time
from collections import Counter
from collections.abc import Callable
from operator import attrgetter

import jax
import jax.numpy as jnp
from paper import paper_body
from table import report

import cddf_jax as cddf

REPEATS = 3
OUTPUTS = "tip_tension", "tip_position", "status", "error_estimate"
OF_TRACES = "tip_tension", "tip_position", "front", "error_estimate"
TIP_FORCE = cddf.Loads(tip_force=(0.0, -1.0))
IN_SPACE = cddf.Loads(tip_force=(0.0, -1.0, 0.5))


def num_operations(function: Callable, *arguments: object) -> int:
    """The operations of the lowered module, every call counted with all that it calls."""
    module = jax.jit(function).lower(*arguments).compiler_ir("stablehlo")
    own, calls = {}, {}
    assert module is not None
    for part in module.body.operations:
        name = part.attributes["sym_name"].value
        own[name], calls[name] = _own(part)

    def total(name: str) -> int:
        return own[name] + sum(count * total(callee) for callee, count in calls[name].items())

    return total("main")


def _own(operation) -> tuple[int, Counter]:
    count, calls = 0, Counter()
    for region in operation.regions:
        for block in region.blocks:
            for inner in block.operations:
                kind = inner.operation.name
                if kind in ("func.return", "stablehlo.return"):
                    continue
                if kind == "func.call":
                    calls[inner.attributes["callee"].value] += 1
                else:
                    below, called = _own(inner.operation)
                    count += 1 + below
                    calls += called
    return count, calls


def outputs(equilibrium: cddf.Equilibrium) -> list:
    return [getattr(equilibrium, name) for name in OUTPUTS]


def solved(actuation: Callable, num_tendons: int = 1, loads: cddf.Loads | None = None, **options) -> Callable:
    """What is lowered: a function of the body and a number that makes the actuation."""

    def program(body, number):
        return outputs(cddf.solve(body, actuation(number), loads, throw=False, **options))

    return program


def traced(path: Callable, *outputs: str) -> Callable:
    """What is lowered: a function of the body and a number that makes the path."""

    def program(body, number):
        history = cddf.trace(body, path(number * jnp.array([1.0, 0.5, 0.8, 1.0])), throw=False)
        return [attrgetter(name)(history) for name in outputs]

    return program


def gradient(loads: cddf.Loads) -> Callable:
    def tip(body, number):
        return cddf.solve(body, number, loads, throw=False).tip_position[1]

    return jax.value_and_grad(tip, allow_int=True)


def plain_scan(body: cddf.Manipulator, base_tension: jax.Array) -> tuple:
    """One tendon by 64 RK4 steps, as one would write it by hand: exact kinematics, offset constant."""
    length, friction = jnp.asarray(body.length), jnp.asarray(body.friction_coefficient)

    def rates(s, state):
        tension, heading = state[0], state[1]
        offset = body.tendons[0].offset(s)
        curvature = tension * offset / body.stiffness(s)
        return jnp.stack([-friction * jnp.abs(curvature) * tension, curvature, jnp.cos(heading), jnp.sin(heading)])

    step = length / 64

    def advance(state, s):
        a = rates(s, state)
        b = rates(s + step / 2, state + step / 2 * a)
        c = rates(s + step / 2, state + step / 2 * b)
        d = rates(s + step, state + step * c)
        return state + step / 6 * (a + 2 * b + 2 * c + d), None

    start = jnp.zeros(4).at[0].set(base_tension)
    end, _ = jax.lax.scan(advance, start, step * jnp.arange(64.0))
    return end[0], end[2:]


PROGRAMS = {
    "plain RK4 scan, one tendon": (plain_scan, 1),
    "one tendon": (solved(lambda x: x), 1),
    "two tendons, directions stated": (solved(lambda x: jnp.stack([x, 0.3 * x]), direction=(1.0, -1.0)), 2),
    "two tendons, directions found": (solved(lambda x: jnp.stack([x, 0.3 * x])), 2),
    "a displacement": (solved(lambda x: cddf.Displacement(1e-4 * x)), 1),
    "a tip force": (solved(lambda x: x, loads=TIP_FORCE), 1),
    "a tip force, gradient by the whole body": (gradient(TIP_FORCE), 1),
    "a displacement under a tip force": (solved(lambda x: cddf.Displacement(1e-4 * x), loads=TIP_FORCE), 1),
    "a tip force in space": (solved(lambda x: x, loads=IN_SPACE), 1),
    "a trace": (traced(lambda path: path, *OF_TRACES), 1),
    "a trace of displacements": (traced(lambda path: cddf.Displacement(1e-4 * path), *OF_TRACES), 1),
    "a trace of two tendons": (traced(lambda path: jnp.stack([path, 0.3 * path], axis=1), *OF_TRACES), 2),
    "the work of a trace": (traced(lambda path: path, "energies.work"), 1),
}


def measure(name: str) -> dict[str, float]:
    """The size of a program, and the seconds that it takes."""
    program, num_tendons = PROGRAMS[name]
    arguments, found = jax.tree.map(jnp.asarray, (paper_body(num_tendons=num_tendons), 40.0)), []
    for _ in range(REPEATS):
        jax.clear_caches()
        started = time.perf_counter()
        lowered = jax.jit(program).lower(*arguments)
        traced = time.perf_counter()
        program_text, compiled = lowered.compile().as_text, time.perf_counter()
        times = {"trace and lower, s": traced - started, "compile, s": compiled - traced}
        kernels = len(re.findall(r" (?:fusion|dot)\(", program_text() or ""))
        found.append({"kernels": kernels, **times, "together, s": compiled - started})
    return {"operations": num_operations(program, *arguments)} | min(found, key=lambda one: one["together, s"])


def main() -> None:
    """Measure, print and save."""
    rows = {name: measure(name) for name in PROGRAMS}
    plain = next(iter(rows.values()))["together, s"]
    lines = [
        "| program | operations | kernels | trace and lower, s | compile, s | times the plain scan |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines += [
        f"| {name} | {size:,.0f} | {kernels} | {trace:.2f} | {compiling:.2f} | {both / plain:.1f} |"
        for name, (size, kernels, trace, compiling, both) in ((name, row.values()) for name, row in rows.items())
    ]
    text = "\n".join(lines) + "\n"
    report("program_size", text, rows)


if __name__ == "__main__":
    with jax.enable_x64(True):
        main()
