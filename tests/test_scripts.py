"""The README's example and the studies of fitting/ run and say what they should."""

import contextlib
import io
import json
import re
import runpy
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from places import ROOT

import cddf_jax as cddf

G = 2.942783188998e4  # int_0^L d/J ds of the paper's body, m^-2, docs/theory.md (16)
BOTH = ("friction_coefficient", "youngs_modulus")
STATUS = {
    "pulley": ("identified", "fixed"),
    "tensions_only": ("not identified", "not identified"),
    "pulley_then_tensions": ("identified", "identified"),
    "tensions_with_tip_angle": ("identified", "identified"),
    "loop_simulated": ("identified", "identified"),
}


README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.S)


@pytest.fixture(scope="module")
def readme():
    """What the blocks of the README define when they run one after the other, and what each prints."""
    names, printed = {}, []
    for block in BLOCKS:
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(block, "README.md", "exec"), names)
        printed.append(out.getvalue())
    return SimpleNamespace(**names), printed


def without_error_estimate(text):
    """It differs from machine to machine in its rounding errors."""
    return [line for line in text.splitlines() if "error estimate" not in line]


@pytest.mark.slow
def test_the_readme_shows_what_its_first_block_prints(readme):
    shown = re.findall(r"```text\n(.*?)```", README, re.S)[0]
    assert without_error_estimate(readme[1][0]) == without_error_estimate(shown)
    # the closed form: T_tip = T / (1 + mu / E T G), and its derivative by mu
    ratio = 0.42 / 1.4e6 * 75.0 * G
    assert f"tip tension {75.0 / (1 + ratio):.4f} N" in shown
    assert f"dT_tip/dmu = {-75.0 * ratio / 0.42 / (1 + ratio) ** 2:.3f} N" in shown
    assert "(117.344, 60.282) mm" in shown  # the tip in the exact kinematics, docs/theory.md (16)


@pytest.mark.slow
def test_the_sweep_of_the_readme(readme):
    grid = readme[0].grid
    assert grid.successful.all()
    # the closed form at the paper's own tip radius, 13 mm: T / (1 + mu / E T G)
    at = grid.tip_tension.sel(tendon=0).interp({"outer_radius.tip": 0.013}, method="cubic")
    pulls = np.linspace(5.0, 85.0, 17)
    np.testing.assert_allclose(at, pulls / (1 + 0.42 / 1.4e6 * pulls * G), rtol=1e-4)  # interpolated


@pytest.mark.slow
def test_the_design_of_the_readme(readme):
    """The thinnest wall all along and the tendon as far out as allowed; it reaches 90 degrees at the tension found."""
    found = readme[0].found
    assert found.success
    assert found.value == pytest.approx(
        {"outer_radius.base": 9e-3, "outer_radius.tip": 9e-3, "tendons.0.offset": 8.25e-3}, rel=1e-6
    )
    assert float(cddf.solve(found.manipulator, found.objective).tip_angle) == pytest.approx(np.pi / 2, rel=1e-8)


@pytest.mark.slow
def test_the_fit_of_the_readme(cddf_command, monkeypatch):
    monkeypatch.chdir(ROOT)
    command, shown = re.findall(r"```console\n\$ cddf (.*?)\n(.*?)```", README, re.S)[0]
    code, out, err = cddf_command(*command.split())
    assert (code, err) == (0, "")
    assert out == shown


@pytest.mark.slow
def test_optimistix_and_the_command_find_the_same(readme):
    """Pulley test and load cells each determine one number, so the weights of an optimiser change neither."""
    shown = re.findall(r"```console\n.*?```", README, re.S)[0]
    mu, modulus = (float(re.findall(rf"{name} = ([\d.]+)", shown)[0]) for name in ("coefficient", "modulus"))
    assert readme[1][1] == f"mu = {mu:.4f}, E = {modulus:.3f} MPa\n"
    assert readme[1][1].strip() in README


def test_the_readme_is_short():
    assert len(README.split()) <= 900


def test_readme_names_commands_that_exist():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    used = re.findall(r"`?make ([a-z]+)", README)
    assert {"fit", "test"} <= set(used) <= set(targets)


def test_every_study_is_expected():
    own_test = {"soft_tentacle", "sorosim_shapes", "real_robot_loops", "real_robot_recordings"}  # tests of their names
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
