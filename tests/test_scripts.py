"""The README's example and the studies of fitting/ run and say what they should."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cddf_jax as cddf

ROOT = Path(__file__).parents[1]
G = 2.942783188998e4  # int_0^L d/J ds of the paper's body, m^-2, design.md section 3
BOTH = ("friction_coefficient", "youngs_modulus")
STATUS = {
    "pulley": ("identified", "fixed"),
    "tensions_only": ("not identified", "not identified"),
    "pulley_then_tensions": ("identified", "identified"),
    "tensions_with_tip_angle": ("identified", "identified"),
}


def readme_example() -> str:
    return re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S).group(1)


def test_readme_example(capsys):
    names: dict = {}
    exec(compile(readme_example(), "README.md", "exec"), names)
    ratio = 0.42 / 1.4e6 * 75.0 * G
    # the closed form: T_tip = T / (1 + mu / E T G), and its derivative by mu
    np.testing.assert_allclose(names["eq"].tip_tension, 75.0 / (1 + ratio), rtol=1e-10)
    np.testing.assert_allclose(names["slope"].friction_coefficient, -75.0 * ratio / 0.42 / (1 + ratio) ** 2, rtol=1e-9)
    pulls = np.linspace(5.0, 85.0, 17)
    np.testing.assert_allclose(names["loss"], 1 - 1 / (1 + 0.42 / 1.4e6 * pulls * G), rtol=1e-9)
    assert "0.117343" in capsys.readouterr().out  # tip X of the exact kinematics, design.md section 3


@pytest.mark.slow
def test_readme_example_of_loads():
    """The first two blocks run; both loads pull down, so that their moment at the base is negative."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    names: dict = {}
    for block in blocks[:2]:
        exec(compile(block, "README.md", "exec"), names)
    assert float(names["cddf"].solve(names["robot"], 75.0, names["loads"]).base_moment) < 0


def test_readme_example_of_sweeps(tmp_path, monkeypatch):
    """The second sweep with 2**6 samples instead of 2**20."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    sweeps = next(block for block in blocks if "cddf.sweep(" in block)
    assert sweeps.count("2**20") == 1
    robot = cddf.read_manipulator(ROOT / "data" / "smooth_sil_940.toml")
    names: dict = {"cddf": cddf, "robot": robot}
    exec(compile(sweeps.replace("2**20", "2**6"), "README.md", "exec"), names)
    grid = names["grid"]
    assert grid.successful.all()
    # the closed form at the paper's own tip radius, 13 mm: T / (1 + mu / E T G)
    at = grid.tip_tension.sel(tendon=0).interp({"outer_radius.tip": 0.013})
    pulls = np.linspace(5.0, 85.0, 17)
    np.testing.assert_allclose(at, pulls / (1 + 0.42 / 1.4e6 * pulls * G), rtol=1e-4)  # interpolated
    assert (tmp_path / "sweep.zarr").is_dir()


def test_readme_example_of_a_design():
    """The lightest wall all along, the tendon as far out in it as it may be; 90 degrees at the tension that is told."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    text = next(block for block in blocks if "cddf.design(" in block)
    names: dict = {}
    exec(compile(readme_example(), "README.md", "exec"), names)
    exec(compile(text, "README.md", "exec"), names)
    found = names["found"]
    told = re.search(r"# ([\d.]+) N before, ([\d.]+) N after", text)
    assert [found.objectives[0].start, found.objective] == pytest.approx([float(x) for x in told.groups()], rel=1e-3)
    assert found.success
    assert found.value == pytest.approx(
        {"outer_radius.base": 9e-3, "outer_radius.tip": 9e-3, "tendons.0.offset": 8.25e-3}, rel=1e-6
    )
    assert float(cddf.solve(found.manipulator, found.objective).tip_angle) == pytest.approx(np.pi / 2, rel=1e-8)


def test_readme_example_is_short():
    lines = [line for line in readme_example().splitlines() if line.strip()]
    assert len(lines) <= 12


def test_readme_names_commands_that_exist():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    used = re.findall(r"`?make ([a-z]+)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert {"fit", "test"} <= set(used) <= set(targets)


def test_every_study_is_expected():
    own_test = {"soft_tentacle"}  # test_soft_tentacle.py
    assert {path.stem for path in (ROOT / "fitting").glob("*.py")} == set(STATUS) | own_test


@pytest.mark.slow
@pytest.mark.parametrize("name", STATUS)
def test_study(name):
    fit = runpy.run_path(str(ROOT / "fitting" / f"{name}.py"))["study"]()
    assert fit.success
    assert tuple(fit.status[p] for p in BOTH) == STATUS[name]
    # the truth of the simulated data, data/README.md; 4 standard errors, for one draw with friction that
    # differs from trial to trial, which the standard error does not know
    for parameter, truth in zip(BOTH, (0.42, 1.4e6), strict=True):
        if fit.status[parameter] == "identified":
            assert abs(fit.value[parameter] - truth) < 4 * fit.standard_error[parameter]


@pytest.mark.slow
def test_study_as_a_script(tmp_path):
    script = ROOT / "fitting" / "pulley.py"
    environment = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PATH": "", "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "friction_coefficient = 0.4" in done.stdout
    written = json.loads((tmp_path / "out/fitting/pulley/results.json").read_text())
    assert written["status"]["friction_coefficient"] == "identified"
    assert (tmp_path / "out/fitting/pulley/fit_pulley_simulated.png").stat().st_size > 10_000
