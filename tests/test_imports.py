"""Who imports whom: the flow of the physics, a light start, and no backend touched on import."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import cddf_jax as cddf

SOURCE = Path(cddf.__file__).parent
# a file imports only from files to its left, or beside it in the same set
FLOW = [
    {"profiles", "errors", "reductions", "varying"},
    {"manipulator", "loads", "implicit"},
    {"friction"},
    {"mechanics"},
    {"quadrature", "fixed_point", "trigonometry"},
    {"problem"},
    {"solver", "tendon_travel", "sign_changes"},
    {"load_path", "directions"},
    {"balance"},
    {"targets"},
    {"tension_search"},
    {"equilibrium"},
    {"validation"},
    {"statics", "contact"},
    {"literal_iteration", "marching", "closed_form", "stiffness", "energy"},
]
CORE = [name for stage in FLOW for name in sorted(stage)]
STAGE = {name: i for i, stage in enumerate(FLOW) for name in stage}
# `Manipulator.validate` and `print` ask for the host's checks and words when they are called, not on import
ON_DEMAND = {
    *(("manipulator", "validation"), ("manipulator", "printing"), ("equilibrium", "printing")),
    *(("design_results", "design_command"), ("pareto", "design_command")),
}
HEAVY = {"matplotlib", "typer", "rich", "pint", "pandas", "xarray", "zarr", "scipy", "optimistix"}


def is_ours(node):
    return isinstance(node, ast.ImportFrom) and (node.level > 0 or (node.module or "").startswith("cddf_jax"))


def our_imports(name):
    """The files of the package that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse((SOURCE / f"{name}.py").read_text())):
        if is_ours(node):
            module = (node.module or "").removeprefix("cddf_jax").strip(".")
            found |= {module.split(".")[0]} if module else {alias.name for alias in node.names}
    return found


def packages(name):
    """The packages that a file imports when it is itself imported."""
    found = set()
    for node in ast.parse((SOURCE / f"{name}.py").read_text()).body:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
    return found


def run(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("name", CORE)
def test_the_core_imports_only_from_earlier_in_the_flow(name):
    for imported in our_imports(name):
        if (name, imported) in ON_DEMAND:
            continue
        assert imported in STAGE, f"{name}.py imports {imported}, which is no part of the core"
        assert STAGE[imported] < STAGE[name], f"{name}.py imports {imported}, which comes later in the flow"


@pytest.mark.parametrize(("name", "imported"), sorted(ON_DEMAND))
def test_what_is_imported_on_demand_is_not_imported_at_once(name, imported):
    tree = ast.parse((SOURCE / f"{name}.py").read_text())
    assert imported not in {(node.module or "").split(".")[0] for node in tree.body if is_ours(node)}


@pytest.mark.parametrize("name", CORE)
def test_the_core_imports_nothing_heavy(name):
    assert not packages(name) & HEAVY


def test_the_statistics_know_nothing_of_manipulators():
    assert not our_imports("least_squares") & (set(CORE) - {"profiles", "errors"})


def test_nothing_imports_in_a_circle():
    names = {path.stem for path in SOURCE.glob("*.py")} - {"__init__"}
    wanted = {name: (our_imports(name) & names) - {b for a, b in ON_DEMAND if a == name} for name in names}
    while wanted:
        ready = {name for name, needs in wanted.items() if not needs}
        assert ready, f"a circle among {sorted(wanted)}"
        wanted = {name: needs - ready for name, needs in wanted.items() if name not in ready}


def test_only_the_solvers_know_the_fixed_point():
    """style.md section 2: only the solver's file knows that a fixed point exists; and the paper's literal map."""
    users = {path.stem for path in SOURCE.glob("*.py") if "fixed_point" in our_imports(path.stem)}
    assert users <= {"solver", "literal_iteration"}


def test_only_the_friction_law_knows_friction():
    """The paper's own algorithms beside the solver have it in their closed forms."""
    written = {path.stem for path in SOURCE.glob("*.py") if "section.friction_coefficient" in path.read_text()}
    assert written == {"friction", "literal_iteration"}


def test_importing_the_package_imports_neither_jax_nor_matplotlib():
    loaded = run("import sys, cddf_jax; dir(cddf_jax); print(*{name.split('.')[0] for name in sys.modules})")
    assert "cddf_jax" in loaded
    assert not set(loaded) & ({"jax", "jaxlib", "equinox", "numpy"} | HEAVY)


def test_importing_the_core_starts_no_backend_and_nothing_heavy():
    program = """
import sys, cddf_jax.marching, cddf_jax.literal_iteration, cddf_jax.closed_form, cddf_jax.stiffness, cddf_jax.energy
import jax._src.xla_bridge
assert not jax._src.xla_bridge._backends, jax._src.xla_bridge._backends
print(*{name.split('.')[0] for name in sys.modules})
"""
    loaded = set(run(program))
    assert "jax" in loaded
    # jax itself loads parts of scipy
    assert not loaded & (HEAVY - {"scipy"})


def test_building_a_manipulator_starts_no_backend():
    program = """
import cddf_jax as cddf
body = cddf.conical(length=0.14, outer_radius=(0.02, 0.013), inner_radius=0.007, tendon_offset=0.01,
                    youngs_modulus=1.4e6, friction_coefficient=0.42)
import jax._src.xla_bridge
print(len(jax._src.xla_bridge._backends))
"""
    assert run(program) == ["0"]


def test_importing_does_not_change_the_precision():
    program = "import cddf_jax.statics, jax; print(jax.config.jax_enable_x64)"
    assert run(program) == ["False"]


def test_every_public_name_is_there_and_no_module_bears_it():
    """A lazily exported function named like its module turns into the module on second access, design.md section 6."""
    modules = {path.stem for path in SOURCE.glob("*.py")}
    assert not set(cddf.__all__) & modules
    for name in cddf.__all__:
        assert getattr(cddf, name) is getattr(cddf, name)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = cddf.nothing


def test_no_module_starts_threads_when_it_is_imported():
    """Nor keeps a pool of them, which would be shut down with the first that uses it."""
    program = """
import importlib, pkgutil, threading
from concurrent.futures import Executor
before = threading.enumerate()
import cddf_jax
for module in pkgutil.iter_modules(cddf_jax.__path__):
    names = vars(importlib.import_module(f"cddf_jax.{module.name}"))
    kept = [item for value in names.values() for item in (value if isinstance(value, (list, tuple)) else [value])]
    assert not any(isinstance(item, (Executor, threading.Thread)) for item in kept), module.name
    assert set(threading.enumerate()) <= set(before), module.name
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=600)
