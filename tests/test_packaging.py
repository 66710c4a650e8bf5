"""Wheel and source distribution: what they hold, and that the wheel works where nothing else of the project is."""

import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import cddf_jax

ROOT = Path(__file__).resolve().parents[1]
SOLVE = """
import json, sys
from pathlib import Path
import cddf_jax, jax
assert Path(cddf_jax.__file__).is_relative_to(sys.prefix), cddf_jax.__file__
jax.config.update("jax_enable_x64", True)
robot = cddf_jax.conical(length=0.14, outer_radius=0.015, inner_radius=0.0, tendon_offset=0.01,
                         youngs_modulus=1.4e6, friction_coefficient=0.42)
print(float(cddf_jax.solve(robot, 20.0).tip_tension[0]), float(cddf_jax.closed_form_tension(robot, 20.0, 0.14)))
"""


def run(*command, **options):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=600, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The two distributions, built by the project's own build back end, which is installed already."""
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT)
    (wheel,), (source,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, source


def test_the_wheel_holds_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built[0]) as wheel:
        names = wheel.namelist()
    modules = {path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src/cddf_jax").rglob("*.py")}
    assert modules <= set(names)
    assert {name.split("/")[0] for name in names} == {"cddf_jax", f"cddf_jax-{cddf_jax.__version__}.dist-info"}


def test_the_source_distribution_holds_what_the_tests_need(built):
    with tarfile.open(built[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "Makefile", "constraints.txt"} <= names
    assert {"tests/test_packaging.py", "data/smooth_sil_940.toml", "mkdocs.yml"} <= names
    assert not any(name.startswith(("out/", ".venv/", "dist/")) for name in names)


def test_the_wheel_works_in_a_clean_environment(built, tmp_path):
    """Only the wheel and its declared dependencies are there; the solve meets the closed form."""
    home = tmp_path / "clean"
    venv.create(home, with_pip=True)
    python = home / "bin" / "python"
    constraints = ROOT / "constraints.txt"
    run(
        python,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-compile",
        "--disable-pip-version-check",
        "-c",
        constraints,
        built[0],
    )
    solved, expected = map(float, run(python, "-c", SOLVE, cwd=tmp_path).split())
    assert solved == pytest.approx(expected, rel=1e-9)
    told = run(home / "bin" / "cddf", "solve", ROOT / "data/smooth_sil_940.toml", "-t", "10 N", "--json", cwd=tmp_path)
    assert '"tip_tension"' in told
    assert "No broken requirements" in run(python, "-m", "pip", "check")
