"""Who imports whom: the flow of the physics, a light start, and no backend touched on import."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

import cddf_jax as cddf

SOURCE = Path(cddf.__file__).parent
TESTS = Path(__file__).parent
# a room imports only from rooms above it in this list, and from the modules at the top of the package
ROOMS = (
    "numerics",
    "robot",
    "mechanics",
    "statics",
    "history",
    "batch",
    "sweeping",
    "estimation",
    "files",
    "measurements",
    "identification",
    "designing",
    "figures",
    "reports",
    "explorer",
    "cli",
)
CORE = ROOMS[: ROOMS.index("statics") + 1]
# asked for when it is called, not on import: `Manipulator.validate` and what `print` shows of results
ON_DEMAND = {
    ("robot/manipulator", "robot/validation"),
    ("statics/equilibrium", "statics/equilibrium_text"),
}
HEAVY = {"matplotlib", "typer", "rich", "pint", "pandas", "xarray", "zarr", "scipy", "optimistix"}


FILES = sorted(path.relative_to(SOURCE).with_suffix("").as_posix() for path in SOURCE.rglob("*.py"))


@functools.cache
def tree_of(name):
    return ast.parse((SOURCE / f"{name}.py").read_text())


def room_of(name):
    return name.rpartition("/")[0]


def is_ours(node):
    return isinstance(node, ast.ImportFrom) and (node.level > 0 or (node.module or "").startswith("cddf_jax"))


def imported_by(name, node):
    """The files that one import statement in the file `name` takes something from."""
    here = ["cddf_jax", *name.split("/")]
    package = here[: -node.level] if node.level else []
    module = "/".join([*package, *(node.module or "").split(".")]).strip("/").removeprefix("cddf_jax").strip("/")
    candidates = {module} | {f"{module}/{alias.name}".strip("/") for alias in node.names}
    return {each for each in candidates if each in FILES}


def typing_only(tree):
    """The nodes under `if TYPE_CHECKING`, which are not imported when the program runs."""
    blocks = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    return {inner for block in blocks for inner in ast.walk(block)}


@functools.cache
def our_imports(name):
    """The files of the package that a file imports when it runs, wherever in it."""
    tree = tree_of(name)
    left_out = typing_only(tree)
    return {
        found for node in ast.walk(tree) if is_ours(node) and node not in left_out for found in imported_by(name, node)
    }


@functools.cache
def reached(name):
    """The files of the package that a file needs: itself, what it imports, what these import, and so on."""
    found, left = set(), {name}
    while left:
        now = left.pop()
        found.add(now)
        left |= our_imports(now) - found
    return found


def packages(name):
    """The packages that a file imports when it is itself imported."""
    found = set()
    for node in tree_of(name).body:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
    return found


def run(program):
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_room_imports_only_from_rooms_before_it():
    """And the modules at the top of the package import no room."""
    place = {"": -1} | {room: number for number, room in enumerate(ROOMS)}
    pairs = [(name, needed) for name in FILES for needed in reached(name)]
    assert [(a, b) for a, b in pairs if place[room_of(b)] > place[room_of(a)]] == []


def test_nothing_imports_in_a_circle():
    wanted = {name: our_imports(name) - {b for a, b in ON_DEMAND if a == name} - {name} for name in FILES}
    while wanted:
        ready = {name for name, needs in wanted.items() if not needs & set(wanted)}
        assert ready, f"a circle among {sorted(wanted)}"
        wanted = {name: needs for name, needs in wanted.items() if name not in ready}


def test_annotations_hide_no_circle():
    named = {(a, b) for a in FILES for node in typing_only(tree_of(a)) if is_ours(node) for b in imported_by(a, node)}
    assert [(a, b) for a, b in named if a in reached(b)] == []


def test_the_package_has_these_rooms_and_few_modules_beside_them():
    assert {room_of(name) for name in FILES} - {""} == set(ROOMS)
    assert len([name for name in FILES if not room_of(name)]) <= 6


def test_the_tests_mirror_the_rooms():
    folders = {path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")} - {"."}
    assert folders == set(ROOMS)


def test_the_core_imports_nothing_heavy():
    core = [name for name in FILES if room_of(name) in CORE]
    assert {name: heavy for name in core if (heavy := set().union(*map(packages, reached(name))) & HEAVY)} == {}


def test_importing_the_package_imports_neither_jax_nor_matplotlib():
    loaded = run("import sys, cddf_jax; dir(cddf_jax); print(*{name.split('.')[0] for name in sys.modules})")
    assert "cddf_jax" in loaded
    assert not set(loaded) & ({"jax", "jaxlib", "equinox", "numpy"} | HEAVY)


def test_a_manipulator_starts_no_backend_changes_no_precision_and_loads_nothing_heavy():
    program = """
import sys, cddf_jax as cddf, cddf_jax.statics.literal_iteration, cddf_jax.mechanics.capstan, cddf_jax.statics.response
body = cddf.conical(length=0.14, outer_radius=(0.02, 0.013), inner_radius=0.007, tendon_offset=0.01,
                    youngs_modulus=1.4e6, friction_coefficient=0.42)
import jax
import jax._src.xla_bridge
assert not jax._src.xla_bridge._backends, jax._src.xla_bridge._backends
assert not jax.config.jax_enable_x64
print(*{name.split('.')[0] for name in sys.modules})
"""
    loaded = set(run(program))
    assert "jax" in loaded
    # jax itself loads parts of scipy
    assert not loaded & (HEAVY - {"scipy"})


def test_what_takes_long_to_load_is_loaded_when_it_is_used():
    """Drawing, tables, units, statistics, and the optimisers of SciPy, which designs alone begin with."""
    program = """
import sys, cddf_jax as cddf
cddf.solve, cddf.fit, cddf.sweep, cddf.plan, cddf.read_manipulator, cddf.read_measurements
import cddf_jax.explorer.server, cddf_jax.reports.fit_report
print(*sys.modules)
"""
    loaded = set(run(program))
    assert {"jax", "optimistix"} <= loaded
    assert not loaded & {"matplotlib", "pandas", "xarray", "zarr", "pint", "rich"}
    assert not loaded & {"scipy.stats", "scipy.interpolate", "scipy.optimize"}


def test_every_public_name_is_there_and_no_module_bears_it():
    """A lazily exported function named like its module turns into the module on second access."""
    modules = {path.stem for path in SOURCE.iterdir()}
    assert not set(cddf.__all__) & modules
    for name in cddf.__all__:
        assert getattr(cddf, name) is getattr(cddf, name)
    with pytest.raises(AttributeError, match="No cddf_jax attribute nothing"):
        _ = cddf.nothing  # pyright: ignore[reportAttributeAccessIssue]


def test_one_name_is_one_thing():
    """No public function or class has the name of another, but for a command and the function that it calls."""
    places = {}
    for name in FILES:
        for node in tree_of(name).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(name)
    twice = {name for name, files in places.items() if len(files) > 1}
    assert twice == {"design", "fit", "plan", "reproduce", "solve", "sweep", "trace"}
    assert all(sum(room_of(file) == "cli" for file in places[name]) == 1 and len(places[name]) == 2 for name in twice)


def test_functions_of_the_solver_are_read_at_a_glance():
    """At most 40 lines after the docstring, and 12 names beside the arguments."""
    scopes = ast.FunctionDef, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp

    def named_in(nodes):
        own = [node for node in nodes if not isinstance(node, scopes)]
        names = {node.id for node in own if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        names |= {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
        return names.union(*(named_in([*ast.iter_child_nodes(node)]) for node in own))

    for name in (name for name in FILES if room_of(name) in ("numerics", "mechanics", "statics")):
        for function in (node for node in ast.walk(tree_of(name)) if isinstance(node, ast.FunctionDef)):
            if body := function.body[ast.get_docstring(function) is not None :]:
                assert (body[-1].end_lineno or 0) - body[0].lineno < 40, (name, function.name)
                arguments = {each.arg for each in ast.walk(function.args) if isinstance(each, ast.arg)}
                assert len(named_in(body) - arguments) <= 12, (name, function.name)
