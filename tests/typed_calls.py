"""Every public function once, while the annotations of the whole package are checked: shapes, kinds of numbers, types.

`python typed_calls.py FOLDER` prints the public names that it called; a wrong annotation or shape ends it.
"""

import dataclasses
import gc
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import install_import_hook
from places import DATA

gc.set_threshold(200_000, 50, 50)  # as in conftest.py
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_traceback_in_locations_limit", 0)
CHECKER = "beartype.beartype(conf=beartype.BeartypeConf(strategy=beartype.BeartypeStrategy.On))"
with install_import_hook("cddf_jax", CHECKER):
    import cddf_jax as cddf

    assert all(getattr(cddf, name) for name in cddf.__all__)  # loaded now, under the hook

OUT = Path(sys.argv[1])
cddf.keep_programs(OUT / "programs")
TAPER: dict[str, Any] = {"length": 0.14, "outer_radius": (0.020, 0.013), "inner_radius": 0.007, "tendon_offset": 0.010}
MATERIAL: dict[str, Any] = {"youngs_modulus": 1.4e6, "friction_coefficient": 0.42, "density": 1070.0}
robot = cddf.conical(**TAPER, **MATERIAL)
pair = cddf.conical(**TAPER, **MATERIAL, num_tendons=2)
stepped = cddf.Manipulator(
    length=0.14,
    outer_radius=cddf.Piecewise((0.07,), (cddf.Constant(0.02), cddf.Linear(0.015, 0.013, 0.14))),
    inner_radius=cddf.Spline.through(cddf.Constant(0.007), np.linspace(0.0, 0.14, 4)),
    tendons=(cddf.Tendon(0.010),),
    point_masses=(cddf.PointMass(0.1, 0.01),),
    **MATERIAL,
).validate()
pulley, tensions = (cddf.read_measurements(DATA / f"{name}_simulated.csv") for name in ("pulley", "load_cells"))
eq = cddf.solve(robot, 20.0, nodes=8)


def statics():
    loads = cddf.Loads(tip_force=(0.0, -1.0), gravity=(0.0, -9.81), points=[cddf.PointLoad(0.05, (0.0, -0.1))])
    cddf.solve(stepped, 20.0, loads, nodes=8)
    wanted = cddf.Displacement(0.005), cddf.TipTension(15.0), cddf.CurvatureAt(4.0, 0.07), cddf.TipStiffness(200.0)
    assert all(np.isfinite(target.value) for target in wanted)
    cddf.solve(pair, (cddf.TipAngle(0.3), cddf.TotalTension(30.0)), nodes=8)
    cddf.solve(
        pair, cddf.TipPosition((0.13, 0.03), minimum_tension=1.0, maximum_tension=(60.0, 50.0)), nodes=8, throw=False
    )
    cddf.FixedPoint(tolerance=1e-8)
    cddf.solve(robot, 20.0, method=cddf.LiteralIteration(1e-6), nodes=8)
    print(eq, eq.remarks, eq.at(0.07).tension, eq.peak_strain, cddf.in_words(eq.status), sep="\n", file=sys.stderr)
    assert eq.status == cddf.Status.successful
    cddf.iteration_history(robot, 20.0, nodes=8)
    cddf.closed_form_tension(robot, 20.0, 0.14)
    cddf.pulling_tension(10.0, 1.0, 0.42)
    cddf.tip_jacobian(robot, 20.0, nodes=8)
    cddf.self_contact(eq)
    winding = dataclasses.replace(robot, tendons=(cddf.Tendon(0.010, angle=cddf.Linear(0.0, 3.0, 0.14)),))
    there = cddf.solve(winding, 20.0, nodes=4, throw=False).at(np.array([0.0, 0.07]))
    assert isinstance(there, cddf.SpatialFields)
    assert there.twist.shape == (2,)
    history = cddf.trace(robot, [20.0, 10.0], nodes=8)
    with cddf.show_progress():
        cddf.trace(robot, np.array([15.0]), start=history, nodes=8, max_turns=4)
    cddf.trace(pair, [[20.0, 5.0], [10.0, 5.0]], cddf.Loads(tip_force=(0.0, -0.1)), nodes=4, short_steps=2)
    cddf.tip_compliance(history, push=(0.0, -0.1), short_steps=2)
    energies = history.energies
    print(energies.work, energies.friction_loss, energies.stored_energy, history.equilibria.tension, file=sys.stderr)
    cddf.as_frame(history)
    print(history.at(np.array([0.0, 0.07])).tension, history.sliding(0.07), file=sys.stderr)


def sweeping():
    samples = {"sample": cddf.sobol({"friction_coefficient": (0.1, 0.6)}, 4)}
    cddf.sweep(robot, {"base_tension": [5.0, 10.0], **samples}, nodes=8, sensitivities=("youngs_modulus",))
    cddf.latin_hypercube({"density": (1000.0, 1100.0)}, 3)


def files():
    cddf.write_manipulator(stepped, OUT / "robot.toml")
    cddf.read_manipulator(OUT / "robot.toml")
    cddf.write_manipulator(stepped, OUT / "hanging.toml", gravity=(9.81, 0.0))
    assert cddf.read_robot_file(OUT / "hanging.toml").gravity == (9.81, 0.0)
    body = OUT / "body.csv"
    body.write_text("arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm]\n0,20,7,10\n140,13,7,10\n")
    cddf.read_cross_sections(body)
    cddf.read_tables([DATA / "pulley_simulated.csv"])
    cddf.as_dataset(eq)
    cddf.as_frame(eq)


def identification():
    fit = cddf.fit(robot, [pulley, tensions], nodes=8)
    head = cddf.BenchSetting(markers={"head": cddf.Marker(0.08, (0.0, 0.011))}, given={"camera_x": 0.01})
    seen = cddf.Measurements.from_columns("head", base_tension=[20.0], **{"y@head": [0.005]})
    cddf.fit(robot, [pulley, seen], setting=head, nodes=8, noise={"y@head": 1e-3})
    fit.profile("friction_coefficient")
    fit.predict("tip_tension", [20.0, 40.0])
    cddf.write_fit(fit, OUT / "fit")
    cddf.fit(robot, [pulley, tensions], nodes=8, noise={"tip_tension": cddf.Noise()}).information_criteria["AIC"]
    cddf.plan(fit, cddf.standard_candidates(robot, 85.0)[:2], num=1)
    cddf.model_free_friction(cddf.read_measurements(DATA / "tip_angle_simulated.csv"))
    up_and_down = [10.0, 40.0, 80.0, 20.0, 10.0]
    loop = cddf.Measurements.from_columns(
        base_tension=up_and_down, tip_tension=cddf.trace(robot, up_and_down).tip_tension
    )
    loops = cddf.fit(robot, loop, history=True, before=["rest"], nodes=8)
    loops.predict("tip_tension", up_and_down, history=True)
    cddf.average_holds(tensions)
    x = np.arange(4.0)
    bounds = {"a": (-10.0, 10.0)}
    cddf.least_squares_fit(lambda p: p["a"] + p["b"] * x, {"a": 0.0, "b": 1.0}, 1.0 + 2.0 * x, bounds=bounds, sigma=0.1)
    cddf.uncertain_cases(cddf.LoadCase(20.0), fit, num=2)


def designing():
    free, bounds = ("outer_radius.tip",), {"outer_radius.tip": (0.012, 0.016)}
    at = {"cases": cddf.LoadCase(20.0), "constraints": (cddf.Limit("wall_thickness", least=2e-3),), "nodes": 8}
    aims = [cddf.Least("mass"), cddf.Most("tip_angle"), cddf.Even("curvature"), cddf.Near("tip_angle", 0.4)]
    cddf.design(robot, [(1.0, aim) for aim in aims], free, bounds, **at)
    cddf.LoadCase(20.0, weight=2.0)
    cddf.pareto_front(robot, (cddf.Least("mass"), cddf.Most("tip_angle")), free, bounds, **at, num=3)


if __name__ == "__main__":
    for group in (statics, sweeping, files, identification, designing):
        group()
    print("done")
