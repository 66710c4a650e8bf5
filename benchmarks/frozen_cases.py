"""42 solves whose answers a redesign of the solver must keep: `python benchmarks/frozen_cases.py`, ten minutes.

For each case: how the solve ended, the numbers at the tip, and the first and second derivatives of one number. It is
phi(L) + (1, 2, 3) . u(L) / L + the sum of T_tip / 10 N, as a function of the logarithms of mu, E, the actuation and
the loads. First derivatives are computed in both modes; second ones of the cases that say so.

The answers are compared with those in `frozen_cases.json`, which a first run with `--freeze` writes. `--nodes 48`
solves with other nodes: what then differs from the file is the error of its answers. Times and sizes of programs are
those of `batch.py` and `program_size.py`, which are run before and after in turn.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from paper import paper_body
from table import report

import cddf_jax as cddf
from cddf_jax.files.writing import as_json

FROZEN = Path(__file__).with_suffix(".json")


class Case(NamedTuple):
    """One solve."""

    body: cddf.Manipulator
    actuation: Any
    loads: cddf.Loads | None = None
    options: tuple[tuple[str, Any], ...] = ()  # of `solve`
    hessian: bool = False


def force(*components: float) -> cddf.Loads:
    return cddf.Loads(tip_force=components)


def with_tendons(*tendons: cddf.Tendon, **changes: Any) -> cddf.Manipulator:
    """The paper's body with other tendons, and other fields."""
    body = paper_body()
    names = "length", "outer_radius", "inner_radius", "youngs_modulus", "friction_coefficient", "density"
    return cddf.Manipulator(**{**{name: getattr(body, name) for name in names}, "tendons": tendons, **changes})


def around(*degrees: float, **changes: Any) -> cddf.Manipulator:
    """The paper's body with parallel tendons at angles around the axis."""
    return with_tendons(*(cddf.Tendon(0.010, angle=np.radians(angle)) for angle in degrees), **changes)


def cases() -> dict[str, Case]:
    """The solves by name."""
    paper, published, pair = paper_body(), paper_body(kinematics="published"), paper_body(num_tendons=2)
    slanted = paper_body(tendon_offset=(0.012, 0.006))
    slanted_pair = paper_body(tendon_offset=(0.012, 0.006), num_tendons=2)
    heavy, drag = paper_body(density=1080.0), paper_body(drag=20.0)
    stretching = with_tendons(cddf.Tendon(0.010, axial_stiffness=2e3, free_length=0.3), cddf.Tendon(0.010, -1))
    short = with_tendons(cddf.Tendon(0.010), cddf.Tendon(0.008, -1, end=0.08))
    stepped = with_tendons(
        cddf.Tendon(0.010), outer_radius=cddf.Piecewise([0.06], [0.020, cddf.Linear(0.018, 0.013, 0.140)])
    )
    bowed = with_tendons(cddf.Tendon(cddf.Spline([0.0, 0.05, 0.1, 0.14], [0.008, 0.012, 0.011, 0.006])))
    helix = with_tendons(cddf.Tendon(0.010, angle=cddf.Linear(0.0, 2 * np.pi, 0.140)))
    soft = around(0.0, 120.0, 240.0, extensible=True, poissons_ratio=0.45)
    down = cddf.Loads(gravity=(0.0, -9.81))
    steel = paper_body(
        **{"length": 0.2, "outer_radius": 0.004, "inner_radius": 0.001, "tendon_offset": 0.003},
        **{"youngs_modulus": 60e6, "friction_coefficient": 0.2},
    )
    return {
        "one tendon, 75 N": Case(paper, 75.0, hessian=True),
        "one tendon, 5 N": Case(paper, 5.0),
        "published, 75 N": Case(published, 75.0, hessian=True),
        "published, slides out": Case(published, 30.0, options=(("direction", -1.0),)),
        "slanted, 75 N": Case(slanted, 75.0, hessian=True),
        "bowed, 60 N": Case(bowed, 60.0),
        "stepped, 60 N": Case(stepped, 60.0),
        "antagonists, 75 and 20 N": Case(pair, [75.0, 20.0]),
        "antagonists, directions stated": Case(pair, [40.0, 60.0], options=(("direction", (-1.0, 1.0)),)),
        "slanted antagonists, 60 and 30 N": Case(slanted_pair, [60.0, 30.0]),
        "anchored at 80 mm, 30 and 50 N": Case(short, [30.0, 50.0]),
        "stretching, 60 and 20 N": Case(stretching, [60.0, 20.0]),
        "drag, 40 N": Case(drag, 40.0),
        "drag, slack at 2 N": Case(drag, 2.0),
        "no tension": Case(paper, 0.0),
        "locks": Case(paper_body(friction_coefficient=1.5), 60.0, options=(("direction", -1.0),)),
        "fibres cross": Case(paper_body(youngs_modulus=5e4), 85.0),
        "tip force, no sign change": Case(paper, 75.0, force(0.0, 2.0), hessian=True),
        "tip force, one sign change": Case(paper, 75.0, force(0.0, -10.0), hessian=True),
        "small tip force": Case(paper, 75.0, force(0.0, -1.0)),
        "oblique tip force": Case(paper, 30.0, force(-5.0, -6.0)),
        "tip moment": Case(paper, 40.0, cddf.Loads(tip_moment=-0.15)),
        "force and moment, two sign changes": Case(paper, 60.0, cddf.Loads(tip_force=(0.0, -12.0), tip_moment=0.55)),
        "gravity": Case(heavy, 30.0, down),
        "gravity, no tension": Case(heavy, 0.0, down),
        "published, tip force": Case(published, 75.0, force(0.0, -6.0)),
        "slanted, tip force": Case(slanted, 60.0, force(0.0, -8.0), hessian=True),
        "antagonists, tip force": Case(pair, [60.0, 30.0], force(0.0, -4.0)),
        "drag, tip force": Case(drag, 40.0, force(0.0, -3.0)),
        "near the load limit": Case(steel, 5.0, force(-1.2, 0.2)),
        "beyond the load limit": Case(steel, 5.0, force(-60.0, 0.2)),
        "a displacement": Case(paper, cddf.Displacement(0.008)),
        "a tip angle under a force": Case(paper, cddf.TipAngle(0.6), force(0.0, -3.0)),
        "tip angle and total tension": Case(pair, [cddf.TipAngle(0.5), cddf.TotalTension(80.0)]),
        "a place of the tip": Case(pair, cddf.TipPosition((0.125, 0.05))),
        "unreachable": Case(paper, cddf.TipAngle(-0.5)),
        "space, three tendons": Case(around(0.0, 120.0, 240.0), [40.0, 20.0, 5.0], options=(("direction", 1.0),)),
        "space, a helix": Case(helix, 40.0, hessian=True),
        "space, helix under a force": Case(helix, 40.0, force(0.0, -1.0, 0.5)),
        "space, three tendons under a force": Case(around(0.0, 120.0, 240.0), [40.0, 20.0, 5.0], force(0.0, -2.0, 1.0)),
        "space, stretch and gravity": Case(
            soft, [10.0, 4.0, 1.0], cddf.Loads(gravity=(0.0, -9.81, 0.0)), (("direction", 1.0),)
        ),
        "space, the plane in space": Case(paper, 75.0, force(0.0, -10.0), (("space", True),)),
    }


def program(options: tuple[tuple[str, Any], ...], nodes: int) -> Callable[..., Any]:
    """From the logarithms of the factors on mu, E, actuation and loads to the number that is derived, and the solve."""

    def of(factors, body, actuation, loads):
        mu, modulus, pull, load = jnp.exp(factors)
        fields = body.friction_coefficient * mu, body.youngs_modulus * modulus
        body = eqx.tree_at(lambda body: (body.friction_coefficient, body.youngs_modulus), body, fields)
        actuation, loads = jax.tree.map(lambda x: pull * x, actuation), jax.tree.map(lambda x: load * x, loads)
        found = cddf.solve(body, actuation, loads, nodes=nodes, throw=False, **dict(options))
        ahead = jnp.arange(1.0, 1.0 + found.tip_position.size) @ found.tip_position / jnp.asarray(body.length)
        return found.tip_angle + ahead + jnp.sum(found.tip_tension) / 10.0, found

    return of


@eqx.filter_jit
def _everything(case: Case, nodes: int) -> tuple[Any, ...]:
    function, start = program(case.options, nodes), jnp.zeros(4)
    inputs = case.body, case.actuation, case.loads
    found = function(start, *inputs)[1]
    forward = jax.jacfwd(lambda x: function(x, *inputs)[0])
    second = jax.jacfwd(forward)(start) if case.hessian else jnp.zeros((4, 4))
    return found, forward(start), jax.jacrev(lambda x: function(x, *inputs)[0])(start), second


def answer(case: Case, nodes: int) -> dict[str, Any]:
    """The numbers of one case."""
    arrays = case._replace(
        body=jax.tree.map(jnp.asarray, case.body),
        actuation=jax.tree.map(lambda x: jnp.asarray(x, float), case.actuation),
        loads=jax.tree.map(jnp.asarray, case.loads),
    )
    found, forward, reverse, second = jax.device_get(_everything(arrays, nodes))
    return {
        "result": cddf.Status(int(found.status)).name,
        "stable": bool(found.stable),
        "error_estimate": float(found.error_estimate),
        "tip_tension": found.tip_tension.tolist(),
        "tip_position": (found.tip_position / np.asarray(case.body.length)).tolist(),
        "tip_angle": float(found.tip_angle),
        "displacement": (found.tendon_displacement / np.asarray(case.body.length)).tolist(),
        "gradient": forward.tolist(),
        "modes_differ_by": float(np.max(np.abs(forward - reverse)) / max(1.0, np.max(np.abs(forward)))),
        "hessian": second.tolist() if case.hessian else None,
    }


def difference(one: Any, other: Any) -> float:
    """The largest relative difference of numbers of order one; 0 where both are NaN, infinite where one is."""
    one, other = np.asarray(one, float), np.asarray(other, float)  # None, of JSON, is NaN
    if one.shape != other.shape or np.any(np.isnan(one) != np.isnan(other)):
        return float("inf")
    apart = np.nan_to_num(np.abs(one - other))
    return float(np.max(apart, initial=0.0) / max(1.0, float(np.nanmax(np.abs(other), initial=0.0))))


FIELDS = "tip_tension", "tip_position", "tip_angle", "displacement", "gradient", "hessian"


def row(name: str, now: dict[str, Any], frozen: dict[str, Any] | None) -> str:
    """A line of the table."""
    parts = [name, now["result"] + ("" if now["stable"] else ", not stable")]
    if frozen is not None:
        changed = [key for key in ("result", "stable") if now[key] != frozen[key]]
        parts.append(", ".join(f"{key} was {frozen[key]}" for key in changed) or "the same")
        parts += [f"{difference(now[field], frozen[field]):.1e}" for field in FIELDS]
    parts += [f"{now['modes_differ_by']:.1e}", f"{now['error_estimate']:.1e}"]
    return f"| {' | '.join(parts)} |"


def main() -> None:
    """Solve, compare, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--freeze", action="store_true", help="write the answers, with which later runs are compared")
    parser.add_argument("--nodes", type=int, default=16)
    parser.add_argument("--only", default="", help="cases whose names contain this text")
    wanted = parser.parse_args()
    chosen = {name: case for name, case in cases().items() if wanted.only in name}
    frozen = json.loads(FROZEN.read_text()) if FROZEN.exists() else {}
    now = {}
    for name, case in chosen.items():
        now[name] = answer(case, wanted.nodes)
        print(row(name, now[name], frozen.get(name)), flush=True)
    if wanted.freeze:
        frozen |= now
        FROZEN.write_text(as_json(frozen))
    compared = ["compared", *FIELDS] if frozen else []  # relative changes of the numbers
    head = ["case", "ended", *compared, "modes differ by", "error estimate"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    lines += [row(name, numbers, frozen.get(name) if frozen else None) for name, numbers in now.items()]
    report("frozen_cases", "\n".join(lines) + "\n", now)


if __name__ == "__main__":
    with jax.enable_x64(True):
        main()
