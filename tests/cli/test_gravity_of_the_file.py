"""Gravity in the robot file: every command takes it as it takes `--gravity`, which wins, and zeros switch it off."""

import numpy as np
import pytest
from bodies import paper_body
from places import DATA

import cddf_jax as cddf
from cddf_jax.designing.task_file import read_task
from cddf_jax.errors import InputError
from cddf_jax.files.manipulator_file import write_manipulator

DOWN = (0.0, -9.81)
NOTE = "note: gravity (0, -9.81) m/s^2, of the robot file\n"
TASK = """
robot = "robot.toml"
[free]
outer_radius = { taper = true, bounds = ["8 mm", "25 mm"] }
[[case]]
base_tension = "50 N"
[[case]]
base_tension = "50 N"
gravity = "1, 2 m/s^2"
[[case]]
base_tension = "50 N"
gravity = "0, 0 m/s^2"
[[case]]
base_tension = "50 N"
tip_force = "0, -1 N"
point_loads = ["60 mm: 0, -2 N and 0.1 N m"]
[[objective]]
least = "volume"
"""
# the arguments of each command, and the function that does its work
COMMANDS = {
    "solve": (("-t", "30 N"), "cddf_jax.statics.solve.solve"),
    "trace": (("--path", "0 N, 30 N"), "cddf_jax.reports.trace_report.traced"),
    "fit": ((DATA / "load_cells_simulated.csv",), "cddf_jax.identification.fit.fit"),
    "plan": ((), "cddf_jax.identification.experiment_design.plan"),
    "sweep": (("--over", "base_tension=10 N, 30 N", "--dry-run"), "cddf_jax.cli.sweep_options.read_sweep"),
}


@pytest.fixture(scope="module")
def mounted(tmp_path_factory):
    """The paper's body with a density, and gravity across its base."""
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    write_manipulator(paper_body("exact", density=1070.0), path, gravity=DOWN)
    return path


@pytest.fixture
def loads_of(cddf_command, monkeypatch, mounted):
    """The loads with which a command calls the function that does its work, and what it says before."""

    def run(command, *more):
        arguments, worker = COMMANDS[command]
        found = []

        def stop(*given, **named):
            found.extend((*given, *named.values()))
            raise InputError("far enough")

        monkeypatch.setattr(worker, stop)
        code, out, err = cddf_command(command, mounted, *arguments, *more)
        assert (code, out) == (2, "")
        assert err.endswith("far enough\n")
        loads = [x.loads for x in found if isinstance(x, cddf.BenchSetting)]
        return [*loads, *(x for x in found if isinstance(x, cddf.Loads))], err.rpartition("error: ")[0]

    return run


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_the_gravity_of_the_file(loads_of, command):
    (loads,), said = loads_of(command)
    assert np.asarray(loads.gravity).tolist() == list(DOWN)
    assert said == NOTE
    (loads,), said = loads_of(command, "--gravity", "1, 2, 3 m/s^2")
    assert np.asarray(loads.gravity).tolist() == [1.0, 2.0, 3.0]
    assert said == ""
    off, said = loads_of(command, "--gravity", "0, 0 m/s^2")
    assert (set(off) <= {None}, said) == (True, "")


def test_gravity_without_a_mass_is_refused_as_the_option_is(cddf_command, tmp_path):
    write_manipulator(paper_body("exact"), tmp_path / "light.toml", gravity=DOWN)
    code, out, err = cddf_command("solve", tmp_path / "light.toml", "-t", "30 N")
    assert (code, out) == (2, "")
    assert err.startswith(f"{NOTE}error: {tmp_path / 'light.toml'}: loads.gravity: the body has no weight, since")


def test_reproduce_refuses_gravity(fails, mounted):
    said = fails("reproduce", mounted, DATA / "load_cells_simulated.csv")
    assert said == f"{mounted}: the paper's manipulator bears no loads, this one has gravity; leave it out"


# --- designs and the explorer ---------------------------------------------------------------------


@pytest.fixture
def task(mounted):
    path = mounted.with_name("task.toml")
    path.write_text(TASK)
    return read_task(path)


def test_every_case_of_a_design_takes_it_unless_it_has_its_own(task):
    first, own, off, pushed = (case.loads for case in task.arguments["cases"])
    assert np.asarray(first.gravity).tolist() == list(DOWN)
    assert np.asarray(own.gravity).tolist() == [1.0, 2.0]
    assert off is None
    assert np.asarray(pushed.gravity).tolist() == list(DOWN)
    assert np.asarray(pushed.tip_force).tolist() == [0.0, -1.0]
    (point,) = pushed.points
    assert [np.asarray(load).tolist() for load in (point.arc_length, point.force, point.moment)] == [0.06, [0, -2], 0.1]
    assert task.read_as == ("gravity (0, -9.81) m/s^2, of the robot file, in every case without a gravity of its own",)


def test_the_data_of_uncertain_numbers_were_measured_under_it(mounted, monkeypatch):
    told = []

    def stop(body, tables, *, setting):
        told.append(np.asarray(setting.loads.gravity).tolist())
        raise InputError("far enough")

    monkeypatch.setattr("cddf_jax.identification.fit.fit", stop)
    path = mounted.with_name("uncertain.toml")
    path.write_text(f'{TASK}[uncertain]\ndata = ["{DATA / "load_cells_simulated.csv"}"]\n')
    with pytest.raises(InputError, match="far enough"):
        read_task(path)
    assert told == [list(DOWN)]


def test_the_explorer_is_given_the_whole_file(cddf_command, monkeypatch, mounted):
    pytest.importorskip("panel")
    served = []
    monkeypatch.setattr("cddf_jax.explorer.server.serve", lambda robot, *_, **__: served.append(robot))
    cddf_command("explore", mounted, "--no-browser")
    assert [robot.gravity for robot in served] == [DOWN]
