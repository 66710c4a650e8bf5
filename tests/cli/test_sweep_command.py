"""`cddf sweep`: axes with units, the store and what goes beside it, going on where it was, one-line errors."""

import csv
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import xarray
from bodies import paper_body
from places import DATA

import cddf_jax as cddf
from cddf_jax.cli import sweep_options
from cddf_jax.reports import sweep_report
from cddf_jax.sweeping import export as sweep_exports
from cddf_jax.sweeping.sweep import Sweep

PAPER = DATA / "smooth_sil_940.toml"
LENGTH, G = 0.14, 2.942783188998e4  # m, m^-2, docs/theory.md (16)
TENSIONS = ("--over", "base_tension=5N:85N:5")
FRICTIONS = ("--over", "friction_coefficient=0.1:0.6:4")
PAIR = ("--together", "base_tension,friction_coefficient")


@pytest.fixture
def run(cddf_command, tmp_path, monkeypatch):
    """`cddf sweep` with some arguments, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: cddf_command("sweep", *arguments)


@pytest.fixture
def fails(fails):
    """The same of `cddf sweep`."""
    return partial(fails, "sweep")


def opened(path):
    with xarray.open_zarr(path, chunks=None, consolidated=False) as answer:
        return answer.load()


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def tip_tension(tension, friction):
    return float(cddf.closed_form_tension(replace(paper_body(), friction_coefficient=friction), tension, LENGTH))


def read(*over, base_tension=None, body=None, **asked):
    body = body or paper_body(density=1070.0)
    return sweep_options.read_sweep(body, over, base_tension=base_tension or [], **asked)


# --- running -------------------------------------------------------------------------------------


def test_a_sweep_with_all_its_files_and_once_more_after_a_stop(run, tmp_path, monkeypatch):
    exports = ("--csv", "tables/sweep.csv")
    outputs = ("--output", "tip_tension,tip_position")
    monkeypatch.setattr("cddf_jax.sweeping.sweep.CHUNK", 8)
    arguments = (PAPER, *TENSIONS, *FRICTIONS, *outputs, "--out", "sweep.zarr", *exports)
    code, text, error = run(*arguments, "--json")
    assert (code, error) == (0, "")
    told = json.loads(text)
    assert json.loads((tmp_path / "sweep.json").read_text()) == told
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"sweep.zarr", "sweep.json", "sweep.pdf", "sweep.png", "tables"}
    assert {path.name for path in (tmp_path / "tables").iterdir()} == {"sweep.csv"}

    tensions, frictions = np.linspace(5.0, 85.0, 5), np.linspace(0.1, 0.6, 4)
    expected = np.array([[tip_tension(t, mu) for mu in frictions] for t in tensions])
    answer = opened("sweep.zarr")
    assert list(answer["tip_position"].dims) == ["base_tension", "friction_coefficient", "component"]
    np.testing.assert_allclose(answer["base_tension"], tensions, rtol=1e-15)
    np.testing.assert_allclose(answer["tip_tension"].isel(tendon=0), expected, rtol=1e-9)
    assert (told["solves"], told["results"]) == (20, {"successful": 20})
    assert told["options"]["over"] == ["base_tension=5N:85N:5", "friction_coefficient=0.1:0.6:4"]

    rows = rows_of("tables/sweep.csv")
    heads = ["base_tension [N]", "friction_coefficient", "tip_tension [N]", "tip_position.X [m]", "tip_position.Y [m]"]
    assert list(rows[0]) == [*heads, "result"]
    assert [float(row["tip_tension [N]"]) for row in rows] == answer["tip_tension"].values.ravel().tolist()
    assert {row["result"] for row in rows} == {"successful"}

    chunks = sorted((tmp_path / "sweep.zarr" / "result" / "c").rglob("*"))
    chunks = [path for path in chunks if path.is_file()]
    assert len(chunks) == 3  # of 2 x 4, the last of 1 x 4
    chunks[1].unlink()
    monkeypatch.setattr("cddf_jax.figures.render", lambda figure, name: {})
    code, text, error = run(*arguments)
    assert (code, error) == (0, "")
    assert text.startswith("20 solves in ")
    assert chunks[1].exists()
    xarray.testing.assert_identical(opened("sweep.zarr"), answer)


def test_failed_solves_are_counted_and_reported(run):
    """In the exact kinematics fibres cross at the base from E J / d^2 = 1733 N on; a tendon cannot push."""
    axes = ("--over", "base_tension=-5 N,10 N,3 kN", "--kinematics", "exact", "--output", "tip_tension,curvature")
    code, text, error = run(PAPER, *axes, "--out", "folder", "--csv", "folder/table.csv")
    assert (code, error) == (0, "")
    first, *others = text.splitlines()
    assert first.endswith(": 1 successful, 1 crossing, 1 unphysical")
    assert others[0].startswith("crossing: offset * curvature reaches 1: fibres of the body would cross")
    assert others[1].startswith("unphysical: The body or its load is not physical")
    rows = rows_of("folder/table.csv")
    assert list(rows[0]) == ["base_tension [N]", "tip_tension [N]", "result"]  # no line along the body in a table
    assert [row["result"] for row in rows] == ["unphysical", "successful", "crossing"]
    assert [bool(row["tip_tension [N]"]) for row in rows] == [False, True, True]


def test_two_tendons_in_a_table(tmp_path):
    """The columns; the numbers are made up."""
    body = paper_body("exact", num_tendons=2)
    work = replace(
        read("base_tension_1=20N,40N", "friction_coefficient=0.2,0.4", base_tension=["0 N", "5 N"], body=body),
        outputs=("tip_tension",),
    )
    answer = work.layout.empty.copy(deep=True)
    answer["tip_tension"][...] = np.arange(8.0).reshape(2, 2, 2)
    answer["result"][...] = [[0, 0], [3, 0]]
    sweep_exports.write_csv(answer, tmp_path / "two.csv")
    rows = rows_of(tmp_path / "two.csv")
    assert list(rows[0]) == [
        "base_tension_1 [N]",
        "friction_coefficient",
        "tip_tension_1 [N]",
        "tip_tension_2 [N]",
        "result",
    ]
    assert [tuple(row.values()) for row in rows] == [
        ("20.0", "0.2", "0.0", "1.0", "successful"),
        ("20.0", "0.4", "2.0", "3.0", "successful"),
        ("40.0", "0.2", "4.0", "5.0", "crossing"),
        ("40.0", "0.4", "6.0", "7.0", "successful"),
    ]


def test_no_success_at_all_and_the_loads(run, tmp_path, monkeypatch):
    """Nothing is solved: the results are made up."""

    def made_up(work, _):
        answer = work.layout.empty.copy(deep=True)
        answer["result"][...] = cddf.Status.crossing
        return answer

    monkeypatch.setattr(Sweep, "run", made_up)
    cddf.write_manipulator(paper_body(density=1070.0), tmp_path / "heavy.toml")
    arguments = ("heavy.toml", "--over", "base_tension=5N,10N", "--gravity", "0, -9.81 m/s^2", "--out", "x.zarr")
    code, text, error = run(*arguments, "--json")
    assert (code, error) == (1, "error: no solve was successful; see the results\n")
    told = json.loads((tmp_path / "x.json").read_text())
    assert json.loads(text) == told
    assert (told["results"], told["loads"]["gravity"]) == ({"crossing": 2}, [0.0, -9.81])


# --- task files ----------------------------------------------------------------------------------


TASK = """
robot = "{robot}"
output = "tip_tension"
samples = 5
dry_run = true

[over]
base_tension = "5N:85N:5"
friction_coefficient = [0.2, 0.4]

[sample]
youngs_modulus = "1.2MPa:1.6MPa"
"""


def test_a_task_file_gives_the_options_and_the_command_line_overrides_it(run, tmp_path):
    (tmp_path / "task.toml").write_text(TASK.format(robot=PAPER))
    code, text, error = run("--task", "task.toml", "--samples", 3, "--json")
    assert (code, error) == (0, "")
    told = json.loads(text)
    assert told["axes"] == {"base_tension": 5, "friction_coefficient": 2, "sample": 3}
    assert told["outputs"] == ["tip_tension"]


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("outputs = 3", "task.toml: there is no option 'outputs'; there are robot, over, together, sample, "),
        ("over = ", "task.toml: is not TOML: "),
        (None, "task.toml: cannot be read (No such file or directory); check the path"),
    ],
)
def test_task_files_that_are_refused(fails, tmp_path, task, message):
    if task is not None:
        (tmp_path / "task.toml").write_text(task)
    assert fails(PAPER, "--task", "task.toml").startswith(message)


# --- dry runs ------------------------------------------------------------------------------------


def test_a_dry_run_writes_nothing(run, tmp_path, monkeypatch):
    monkeypatch.setattr("cddf_jax.sweeping.sweep.CHUNK", 10)
    arguments = (PAPER, *TENSIONS, *FRICTIONS, "--over", "youngs_modulus=1 MPa,2 MPa", "--dry-run")
    code, text, error = run(*arguments, "--out", "new/sweep.zarr", "--csv", "new/table.csv")
    assert (code, error) == (0, "")
    assert not list(tmp_path.iterdir())
    lines = text.splitlines()
    assert lines[0] == "40 solves: base_tension 5, friction_coefficient 4, youngs_modulus 2"
    # tip tension, two components and the angle in float64, the mask and the result: 34 bytes
    assert lines[1] == "answer: tip_tension, tip_position, tip_angle; 1.4 kB on disk at most"
    assert lines[2].startswith(f"memory: {3 * 8 * 34} bytes needed, ")
    assert len(lines) == 3


# --- reading -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "tensions", "name", "values"),
    [
        ("base_tension=0N, 10N:30N:3,20N", [], "base_tension", [0.0, 10.0, 20.0, 30.0, 20.0]),
        (" base_tension = 0.085 kN : 5 N : 17 ", [], "base_tension", np.arange(85.0, 4.0, -5.0)),
        ("youngs_modulus=1.2 MPa,1400 kPa", ["75 N"], "youngs_modulus", [1.2e6, 1.4e6]),
        ("loads.tip_force.1=-5N:5N:3", ["75 N"], "loads.tip_force.1", [-5.0, 0.0, 5.0]),
        ("density=1 g/cm^3:1.2 g/cm^3:2", ["75 N"], "density", [1000.0, 1200.0]),
        ("direction=1,-1", ["75 N"], "direction", [1.0, -1.0]),
        ("base_tension.value=10deg:60deg:2", ["tip_angle=45 deg"], "base_tension.value", np.radians([10.0, 60.0])),
        ("base_tension.value=1 1/m,2 1/m", ["curvature=8 1/m at 70 mm"], "base_tension.value", [1.0, 2.0]),
        ("base_tension_2.value=10deg", ["20 N", "tip_angle=45 deg"], "base_tension_2.value", np.radians([10.0])),
    ],
)
def test_axes_with_units(text, tensions, name, values):
    body = paper_body("exact", num_tendons=2) if len(tensions) > 1 else None
    (axis,) = read(text, base_tension=tensions, body=body).dimensions
    assert axis.name == name
    np.testing.assert_allclose(axis.numbers[name], values, rtol=1e-14)


def test_a_sweep_over_axes_that_are_one(run):
    pair = ("--over", "youngs_modulus=1MPa,2MPa", "--together", "friction_coefficient,youngs_modulus")
    arguments = ("-t", "50 N", "--over", "friction_coefficient=0.1,0.5", *pair, "--output", "tip_tension")
    code, _, error = run(PAPER, *arguments, "--out", "x.zarr", "--csv", "x.csv")
    assert (code, error) == (0, "")
    assert opened("x.zarr")["tip_tension"].dims[0] == "friction_coefficient_and_youngs_modulus"
    found = [float(row["tip_tension [N]"]) for row in rows_of("x.csv")]
    np.testing.assert_allclose(found, [tip_tension(50.0, 0.1 * 1.4), tip_tension(50.0, 0.5 * 0.7)], rtol=1e-9)  # mu / E


# --- errors --------------------------------------------------------------------------------------


WRONG = [
    ((), "nothing varies; give --over "),
    (("--over", "base_tension"), "--over 'base_tension': write for example "),
    (("--over", "base_tension=5:85:17 N"), "--over base_tension: write first, last and how many, 2 or more, as in "),
    (("--over", "base_tension=5N:85N:1"), "--over base_tension: write first, last and how many"),
    (("--over", "base_tension=5N:85"), "--over base_tension: write first, last and how many"),
    ((*TENSIONS, *TENSIONS), "--over base_tension is given twice; leave one out"),
    ((*TENSIONS, "--together", "base_tension"), "--together 'base_tension': name two axes or more, each once, as in "),
    ((*TENSIONS, "--together", "base_tension,x"), "--together 'base_tension,x': there is no --over x; give it its"),
    ((*TENSIONS, *FRICTIONS, *2 * PAIR), f"--together '{PAIR[1]}': base_tension varies together with others already"),
    ((*TENSIONS, "-t", "5 N"), "sweep: base_tension is given and an axis; leave one out"),
    ((*TENSIONS, "--samples", "5"), "--samples 5: nothing is sampled"),
    ((*TENSIONS, "--over", "nodes=8,16"), "'nodes' is not a number of the body"),
    ((*TENSIONS, "--sample", "youngs_modulus=1MPa:2MPa"), "--sample needs the number of samples"),
    ((*TENSIONS, "--samples", "4", "--sample", "youngs_modulus=1MPa"), "--sample youngs_modulus: write least and "),
    ((*TENSIONS, "--samples", "4", "--sample", "nodes=8:16"), "'nodes' is not a number of the body"),
    ((*TENSIONS, "--output", "tip_tention"), "sweep: 'tip_tention' is not an output"),
    ((*TENSIONS, "--csv", "."), "--csv .: is a folder; give the name of a file"),
    ((*TENSIONS, "--csv", "x.csv", "--output", "tension"), "--csv x.csv: a table takes no outputs along the body"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_options_that_are_refused(fails, arguments, message):
    assert fails(PAPER, *arguments, "--out", "x.zarr").startswith(message)


def test_a_place_is_needed(fails):
    assert fails(PAPER, *TENSIONS).startswith("--out is missing; give a store such as --out sweep.zarr, or --dry-run")


def test_places_that_cannot_be(fails, tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other.zarr").mkdir()
    for options in (("--out", "file/sweep.zarr"), ("--out", "x.zarr", "--csv", "file/table.csv"), ("--out", "file")):
        said = "file: Not a directory; choose another place"
        assert fails(PAPER, *TENSIONS, *options) == f"{options[-2]}: {said}"
    message = "other.zarr exists and was not written by cddf_jax; give another path, or delete it"
    assert fails(PAPER, *TENSIONS, "--out", "other.zarr") == message


def test_an_interruption(run, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep_report, "run_sweep", interrupted)
    code, _, error = run(PAPER, *TENSIONS, "--out", "x.zarr")
    assert code == 130
    assert error.startswith("error: interrupted; what is in the store stays there, start the same command again")


# --- loops ---------------------------------------------------------------------------------------


PAIR_LOOP = ("--over", "base_tension_1=0N:75N:4,40N", "--over", "base_tension_2=5N,20N")


def test_the_axis_that_is_the_path(run, two_tendons, monkeypatch, tmp_path):
    """By an option, or in a task file; where it is no axis of base tensions the remedy names the option."""
    works = []
    monkeypatch.setattr(sweep_report, "run_sweep", lambda work, places, options: works.append(work))
    task = tmp_path / "sweep.toml"
    task.write_text('history = "base_tension_1"\nshort_steps = 4\n', encoding="utf-8")
    path = ("--history", "base_tension", "--over", "base_tension=0N:75N:4,40N,75N", *FRICTIONS, "--out", "loops")
    assert run(PAPER, *path)[0] == 0
    assert (works[-1].path.name, works[-1].path.size) == ("base_tension", 6)
    for options in (("--history", "base_tension_1", "--short-steps", "4"), ("--task", task)):
        assert run(two_tendons, *PAIR_LOOP, *options, "--out", "loops")[0] == 0
        assert (works[-1].path.name, works[-1].short_steps) == ("base_tension_1", 4)
    code, _, error = run(two_tendons, *PAIR_LOOP, "--history", "base_tension", "--dry-run")
    assert code == 2
    assert error.startswith("error: sweep: base tensions vary along 'base_tension_1', 'base_tension_2'; give ")
    assert error.endswith("the path (--history)\n")


# --- processes -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_all_cores():
    """As a process of its own has them; what the user sets for the devices holds."""
    script = (
        "from cddf_jax.application import configure_jax; configure_jax(all_cores=True); import jax, os\n"
        "print(len(jax.devices()), len(os.sched_getaffinity(0)))"
    )
    kept = {name: value for name, value in os.environ.items() if name not in ("XLA_FLAGS", "JAX_NUM_CPU_DEVICES")}
    for own, count in (({}, None), ({"JAX_NUM_CPU_DEVICES": "3"}, 3)):
        done = subprocess.run([sys.executable, "-c", script], env=kept | own, capture_output=True, text=True)
        devices, cores = map(int, done.stdout.split())
        assert devices == (count or cores)


@pytest.mark.slow
def test_tips_in_space_are_a_cloud(run, tmp_path):
    three = [cddf.Tendon(0.010, angle=i * 2 * np.pi / 3) for i in range(3)]
    body = cddf.Manipulator(LENGTH, 0.015, 0.007, three, youngs_modulus=1.4e6, friction_coefficient=0.42)
    cddf.write_manipulator(body, tmp_path / "three.toml")
    pulls = [word for i in (1, 2, 3) for word in ("--over", f"base_tension_{i}=0N,20N")]
    code, _, _ = run("three.toml", *pulls, "--nodes", "6", "--out", "out", "--csv", "tips.csv")
    assert code == 0
    assert {"sweep_workspace.png", "sweep_workspace.pdf"} <= {path.name for path in (tmp_path / "out").iterdir()}
    with open(tmp_path / "tips.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    lengths = [sum(float(row[f"tip_position.{x} [m]"]) ** 2 for x in "XYZ") ** 0.5 for row in rows]
    assert max(lengths) == pytest.approx(LENGTH)  # straight without tension, and where all are equal
    assert sum(length == pytest.approx(LENGTH, abs=1e-12) for length in lengths) == 2
