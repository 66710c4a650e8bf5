"""Wheel and source distribution: what they hold, and that the wheel works where nothing else of the project is."""

import subprocess
import sys
import tarfile
import venv
import zipfile
from email.parser import Parser
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from places import ROOT

import cddf_jax

pytestmark = pytest.mark.packaging
SOLVE = """
import sys
from pathlib import Path
import cddf_jax, jax
assert Path(cddf_jax.__file__).is_relative_to(sys.prefix), cddf_jax.__file__
jax.config.update("jax_enable_x64", True)
robot = cddf_jax.conical(length=0.14, outer_radius=0.015, inner_radius=0.0, tendon_offset=0.01,
                         youngs_modulus=1.4e6, friction_coefficient=0.42)
print(float(cddf_jax.solve(robot, 20.0).tip_tension[0]), float(cddf_jax.closed_form_tension(robot, 20.0, 0.14)))
"""
# solve, fit and design without what the command line needs
CORE = """
import importlib.util, sys
import cddf_jax as cddf, jax
from cddf_jax.application import configure_jax
assert not [name for name in ("typer", "rich", "tomli_w") if importlib.util.find_spec(name)]
configure_jax()
robot = cddf.read_manipulator(f"{sys.argv[1]}/smooth_sil_940.toml")
tables = cddf.read_tables([f"{sys.argv[1]}/{name}_simulated.csv" for name in ("pulley", "load_cells")])
with cddf.show_progress():
    fit = cddf.fit(robot, tables)
    design = cddf.design(robot, cddf.Least("volume"), free=("outer_radius",), bounds={"outer_radius": (8e-3, 25e-3)},
                         constraints=[cddf.Limit("clearance", least=0.75e-3)], cases=cddf.LoadCase(20.0))
try:
    cddf.write_manipulator(robot, "robot.toml")
except cddf.InputError as error:
    print(error)
print(fit.manipulator.friction_coefficient, design.objective < design.objectives[0].start)
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


def test_what_was_tested_can_be_installed_with_every_python_that_is_allowed():
    """Fresh machines have the Python of their system, which may be the first of its series."""
    pinned = [line.partition("==")[0] for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line]
    known = {name: metadata.metadata(name) for name in pinned if any(metadata.distributions(name=name))}
    allowed = {name: SpecifierSet(",".join(own.get_all("Requires-Python", []))) for name, own in known.items()}
    assert len(allowed) > 100
    assert [name for name, pythons in allowed.items() if "3.11.0" not in pythons] == []


def test_the_wheel_holds_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built[0]) as wheel:
        names = wheel.namelist()
    files = [path for path in (ROOT / "src/cddf_jax").rglob("*.*") if path.suffix != ".pyc"]
    assert {path.relative_to(ROOT / "src").as_posix() for path in files} <= set(names)
    assert {name.split("/")[0] for name in names} == {"cddf_jax", f"cddf_jax-{cddf_jax.__version__}.dist-info"}


def test_the_source_distribution_holds_what_the_tests_need(built):
    with tarfile.open(built[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE", "Makefile", "constraints.txt"} <= names
    assert {"tests/test_packaging.py", "data/smooth_sil_940.toml", "mkdocs.yml"} <= names
    assert not any(name.startswith(("out/", ".venv/", "dist/")) for name in names)


def told(declared, extra):
    """The requirements among some declared ones that hold here, for an extra or "" for none."""
    return [r for r in map(Requirement, declared) if r.marker is None or r.marker.evaluate({"extra": extra})]


def needed_by(wheel, extra):
    """The distributions that a wheel needs: those that its metadata declare, for an extra or "" for none."""
    with zipfile.ZipFile(wheel) as opened:
        (name,) = (name for name in opened.namelist() if name.endswith(".dist-info/METADATA"))
        declared = Parser().parsestr(opened.read(name).decode()).get_all("Requires-Dist")
    found, left = {}, told(declared, extra)
    while left:
        wanted = left.pop()
        distribution = found[wanted.name] = metadata.distribution(wanted.name)
        for own in wanted.extras or {""}:
            left += [r for r in told(distribution.requires or (), own) if r.name not in found]
    return list(found.values())


def declared_alone(wheel, extra, home):
    """The Python of an environment of links to the distributions that a wheel declares, and to nothing else."""
    venv.create(home, symlinks=True)
    python, (site,) = home / "bin" / "python", home.glob("lib/*/site-packages")
    for distribution in needed_by(wheel, extra):
        for part in {file.parts[0] for file in distribution.files or () if ".." not in file.parts}:
            place = Path(str(distribution.locate_file(part)))
            if place.exists() and not (site / part).exists():
                (site / part).symlink_to(place)
    run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-compile", wheel)
    return python


def test_the_wheel_works_with_what_it_declares_alone(built, tmp_path):
    """The solve meets the closed form, and the command answers."""
    python = declared_alone(built[0], "cli", tmp_path / "declared")
    solved, expected = map(float, run(python, "-c", SOLVE, cwd=tmp_path).split())
    assert solved == pytest.approx(expected, rel=1e-9)
    command = python.with_name("cddf"), "solve", ROOT / "data/smooth_sil_940.toml", "-t", "10 N", "--json"
    assert '"tip_tension"' in run(*command, cwd=tmp_path)


def test_the_library_works_without_what_the_command_line_needs(built, tmp_path):
    python = declared_alone(built[0], "", tmp_path / "core")
    missing = "this needs {}; install it with: pip install 'cddf-jax[cli]'\n"
    written, answer = run(python, "-c", CORE, ROOT / "data", cwd=tmp_path).splitlines(keepends=True)
    friction, smaller = answer.split()
    assert written == missing.format("tomli_w")
    assert float(friction) == pytest.approx(0.42, abs=0.005)  # what was simulated, data/README.md
    assert smaller == "True"
    done = subprocess.run([python.with_name("cddf"), "--help"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "error: " + missing.format("typer"))
