"""`sweep`: one solve for every combination of what varies, labelled, in chunks of which none is lost."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from .axes import RESERVED, Dimension, check_names, dimensions_of
from .case import Case
from .equilibrium import Equilibrium
from .errors import InputError
from .lanes import Lanes
from .loads import Loads
from .manipulator import Manipulator
from .problem import Method
from .solver import FixedPoint
from .statics import check_nodes, solve
from .sweep_identity import identity
from .sweep_layout import (
    CHUNK,
    OUTPUTS,
    RESULT,
    RESULT_NAMES,
    Index,
    Layout,
    Variable,
    bytes_each,
    chunks_of,
    coordinates,
    slope_name,
    variable,
)
from .sweep_store import Memory, Store, ZarrStore, needed

if TYPE_CHECKING:
    import xarray

SHARE = 0.25  # of the memory that is free
COPIES = 3  # of a chunk in memory: as it is computed, gathered, written
DEFAULT_OUTPUTS = ("tip_tension", "tip_position", "tip_angle")
Numbers = Mapping[str, Any]


def sweep(
    manipulator: Manipulator,
    axes: Mapping[str, Any],
    base_tension: Any = None,
    loads: Loads | None = None,
    *,
    direction: Any = +1,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    observables: Mapping[str, Callable[[Equilibrium], Any]] | None = None,
    sensitivities: Sequence[str] = (),
    nodes: int = 16,
    method: Method = FixedPoint(),
    precision: str | None = None,
    out: Any = None,
    memory: float | None = None,
    chunk: int | None = None,
    progress: bool = False,
) -> "xarray.Dataset":
    """Solve for every combination of the values along the axes, on all devices and processes there are.

    Args:
        manipulator: the body; what no axis names is taken from here.
        axes: by dimension of the answer. Either the name of a number and its values, {"base_tension": values}, or any
            other name and several numbers that vary together along it, {"sample": latin_hypercube(...)}. The dimensions
            are combined with each other. For the names see `case`: "base_tension", "youngs_modulus",
            "outer_radius.tip", "tendons.0.offset", "loads.tip_force.1", "base_tension.1", and the options "nodes",
            "method", "kinematics". SI units.
        base_tension, loads, direction, nodes, method: as `solve` takes them, where no axis names them.
        outputs: attributes of `Equilibrium`, each an array of the answer.
        observables: more of them, by name, each a function of an `Equilibrium`.
        sensitivities: names of numbers; for each output X that is real and each number P there is then
            X_by_P, the derivative.
        precision: "float32" or "float64"; that of JAX unless given.
        out: path of a Zarr store. A sweep that was stopped, whatever stopped it, goes on where it was when it is
            started again; a store of another sweep is refused. Several processes (`jax.distributed`) share the work.
        memory: that may be used, bytes; a quarter of what is free unless given.
        chunk: solves between two writes; sized for speed and memory unless given.
        progress: show a bar with the rate and the time that is left.

    Returns:
        The outputs with the dimensions of the axes first, then "tendon", "point" (along the body), "component" (X, Y).
        `result` says how each solve went (its codes are among its attributes) and `successful` where all is well: a
        failed solve is NaN, a doubtful one (crossing, inaccurate, unstable, ...) keeps its numbers.

    A number that a profile holds stays what it is when another varies: with "length" alone the taper of a `Linear`
    radius goes on at its slope; let "outer_radius.length" vary together with it.

    Raises:
        InputError: for an axis, output or option that is none, a store of another sweep, too little memory.
    """
    work = Sweep(
        manipulator=manipulator,
        dimensions=dimensions_of(axes),
        base_tension=base_tension,
        loads=loads,
        direction=direction,
        outputs=tuple(outputs),
        observables=dict(observables or {}),
        sensitivities=tuple(sensitivities),
        nodes=nodes,
        method=method,
        precision=precision,
        memory=memory,
        chunk=chunk,
    )
    return work.run(out, progress)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep that is to run; for its fields see `sweep`."""

    manipulator: Manipulator
    dimensions: tuple[Dimension, ...]
    base_tension: Any = None
    loads: Loads | None = None
    direction: Any = +1
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS
    observables: dict[str, Callable[[Equilibrium], Any]] = field(default_factory=dict)
    sensitivities: tuple[str, ...] = ()
    nodes: int = 16
    method: Method = field(default_factory=FixedPoint)
    precision: str | None = None
    memory: float | None = None
    chunk: int | None = None

    # --- what is asked for ------------------------------------------------------------------------

    @cached_property
    def case(self) -> Case:
        """What no axis names."""
        names = [*self.sensitivities, *(name for dimension in self.dimensions for name in dimension.numbers)]
        loads = self.loads
        if loads is None and any(name.startswith("loads.") for name in names):
            loads = Loads()
        tension, count = self.base_tension, self.manipulator.num_tendons
        if tension is None and {f"base_tension.{i}" for i in range(count)} <= set(names):
            tension = np.zeros(count)
        tension = tuple(tension) if isinstance(tension, list) else tension
        if any(name.startswith("base_tension.") for name in names) and isinstance(tension, int | float):
            tension = np.full(count, float(tension))
        return Case(self.manipulator, tension, loads, np.asarray(self.direction, float))

    @cached_property
    def dtype(self) -> np.dtype:
        """The precision."""
        widest = jax.dtypes.canonicalize_dtype(np.float64)
        if self.precision not in (None, "float32", "float64"):
            raise InputError(f"sweep: precision must be 'float32' or 'float64', got {self.precision!r}")
        if self.precision == "float64" and widest != np.float64:
            raise InputError("sweep: float64 is switched off in JAX; set jax.config.update('jax_enable_x64', True)")
        return np.dtype(self.precision or widest)

    @cached_property
    def allowed(self) -> float:
        """The memory that may be used, bytes."""
        return SHARE * needed("psutil").virtual_memory().available if self.memory is None else float(self.memory)

    @property
    def options(self) -> dict[str, Any]:
        return {"nodes": self.nodes, "method": self.method, "kinematics": self.manipulator.kinematics}

    def _check(self) -> None:
        known = {name for dimension in self.dimensions for name in (dimension.name, *dimension.numbers)}
        for name in self.outputs:
            if name not in OUTPUTS:
                raise InputError(f"sweep: {name!r} is no output; there are {', '.join(OUTPUTS)}")
        for name in (*self.outputs, *self.observables):
            if name in known:
                raise InputError(f"sweep: {name!r} is an axis and an output; take it out of the outputs")
        for name in self.observables:
            if name in OUTPUTS or name in (RESULT, "successful", *RESERVED):
                raise InputError(f"sweep: the answer has a {name!r} already; give the observable another name")
        if not self.outputs and not self.observables:
            raise InputError("sweep: nothing is asked for; name an output such as 'tip_tension'")
        if self.chunk is not None and (not isinstance(self.chunk, int) or self.chunk < 1):
            raise InputError(f"sweep: chunk must be a whole number of 1 or more, got {self.chunk!r}")
        try:
            check_nodes(self.nodes)
        except ValueError as error:
            raise InputError(f"sweep: {error}") from None
        check_names(self.dimensions, self.sensitivities, self.case)

    # --- the answer before it is computed -------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """Its shape.

        Raises:
            InputError: where something that is asked for is wrong.
        """
        self._check()
        variables = self._variables()
        each = COPIES * bytes_each(variables, len(self.dimensions))
        if each > self.allowed:
            raise InputError(f"sweep: one solve needs {each} bytes, {self.allowed:.3g} are allowed; raise memory=")
        most = self.chunk or min(CHUNK, int(self.allowed // each))
        units = {name: self.case.unit(name) for dimension in self.dimensions for name in dimension.numbers}
        return Layout(
            self._shape,
            chunks_of(self.dimensions, most),
            coordinates(self.dimensions, units, variables),
            variables,
            {"title": "cddf_jax sweep", "cddf_jax": version("cddf_jax"), "precision": self.dtype.name},
        )

    @property
    def _shape(self) -> dict[str, int]:
        return {dimension.name: dimension.size for dimension in self.dimensions}

    def _variables(self) -> dict[str, Variable]:
        inputs = {name: jax.ShapeDtypeStruct((), self.dtype) for d in self.dimensions for name in d.numbers}
        found: dict[str, Variable] = {}
        for index in np.ndindex(*(d.size if d.options else 1 for d in self.dimensions)):
            told = jax.eval_shape(self.solver(index), inputs)
            for name, base, by in self._names(told):
                new = variable(base, told[name], self._shape, self.case.unit(by) if by else "", by)
                if found.setdefault(name, new).shape != new.shape:
                    raise InputError(f"sweep: the length of {name} changes with the nodes; sweep 'nodes' without it")
        return found

    def _names(self, told: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
        """What was told, in the order in which it was asked for: name, output and by what it is differentiated."""
        for name in (*self.outputs, *self.observables):
            yield name, name, ""
            for by in self.sensitivities:
                if (slope := slope_name(name, by)) in told:
                    yield slope, name, by
        yield RESULT, RESULT, ""

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What makes this sweep, JSON."""
        others = {
            "outputs": list(self.outputs),
            "sensitivities": list(self.sensitivities),
            "precision": self.dtype.name,
        }
        return identity(self.case, self.dimensions, self.options, self.observables, others)

    # --- one solve --------------------------------------------------------------------------------------

    def solver(self, index: Index) -> Callable[[Numbers], dict[str, Any]]:
        """One solve as a function of the numbers that vary; `index` is that of the options along the dimensions."""
        options = self.options
        for dimension, i in zip(self.dimensions, index, strict=True):
            options |= {name: values[i] for name, values in dimension.options.items()}
        body = replace(self.case.manipulator, kinematics=options["kinematics"])
        case = jax.tree.map(self._cast, replace(self.case, manipulator=body))

        def answer(numbers: Numbers) -> dict[str, Any]:
            there = case.with_numbers(numbers)
            found = solve(
                there.manipulator,
                there.base_tension,
                there.loads,
                direction=there.direction,
                method=options["method"],
                nodes=options["nodes"],
                throw=False,
            )
            told = {name: getattr(found, name) for name in self.outputs}
            told |= {name: jnp.asarray(function(found)) for name, function in self.observables.items()}
            return told | {RESULT: found.result._value.astype(jnp.int8)}

        return answer if not self.sensitivities else lambda numbers: self._with_slopes(answer, case, numbers)

    def _with_slopes(self, answer: Callable[[Numbers], dict[str, Any]], case: Case, numbers: Numbers) -> dict[str, Any]:
        """The outputs and the derivatives of those that are real."""
        by = {name: jnp.asarray(numbers.get(name, case.number(name)), self.dtype) for name in self.sensitivities}

        def real(by: Numbers) -> tuple[dict[str, Any], dict[str, Any]]:
            told = answer({**numbers, **by})
            return {name: x for name, x in told.items() if jnp.issubdtype(x.dtype, jnp.floating)}, told

        slopes, told = jax.jacfwd(real, has_aux=True)(by)
        return told | {slope_name(name, by): slope for name, of in slopes.items() for by, slope in of.items()}

    def _cast(self, leaf: Any) -> Any:
        return np.asarray(leaf, self.dtype) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    # --- running ------------------------------------------------------------------------------------

    def run(self, out: Any = None, progress: bool = False) -> "xarray.Dataset":
        """Compute what is not there yet, and return everything."""
        store = self._store(out)
        layout, rank, ranks = store.layout, jax.process_index(), jax.process_count()
        mine = [index for i, index in enumerate(layout.indices()) if i % ranks == rank]
        missing = [index for index in mine if not store.has(index)]
        sizes = {index: int(np.prod([r.stop - r.start for r in layout.region(index)])) for index in mine}
        lanes: dict[Index, Lanes] = {}
        with _bar(sum(sizes.values()), sum(sizes[i] for i in missing), progress and rank == 0) as advance:
            for index in missing:
                store.write(index, self._chunk(layout, index, lanes))
                advance(sizes[index])
        _wait_for_all("cddf_jax sweep: done")
        return _with_mask(store.dataset())

    def _store(self, out: Any) -> Store:
        ranks, layout = jax.process_count(), self.layout
        if out is None:
            if ranks > 1:
                raise InputError(f"sweep: {ranks} processes need out=, a store that all of them reach")
            self._check_memory(layout.bytes_each * (layout.size + COPIES * layout.chunk_size), "give out= or memory=")
            return Memory(layout)
        first = jax.process_index() == 0
        store = ZarrStore(out, layout, self.identity) if first else None
        _wait_for_all("cddf_jax sweep: store")
        store = store or ZarrStore(out, layout, self.identity, create=False)
        self._check_memory(
            COPIES * layout.bytes_each * store.layout.chunk_size, "raise memory= or choose another store"
        )
        return store

    def _check_memory(self, wanted: float, remedy: str) -> None:
        if wanted > self.allowed:
            raise InputError(
                f"sweep: takes {wanted / 1e6:.4g} MB of memory, {self.allowed / 1e6:.4g} MB are allowed; {remedy}"
            )

    def _chunk(self, layout: Layout, index: Index, lanes: dict[Index, Lanes]) -> dict[str, np.ndarray]:
        """The outputs of one chunk, in the shape of its region."""
        region = layout.region(index)
        options = tuple(r.start if d.options else 0 for d, r in zip(self.dimensions, region, strict=True))
        if options not in lanes:
            solver = self.solver(options)
            lanes[options] = Lanes(lambda lane: solver(lane["numbers"]), layout.chunk_size)
        places = np.meshgrid(*(np.arange(r.start, r.stop) for r in region), indexing="ij")
        numbers = {
            name: values[place.ravel()].astype(self.dtype)
            for dimension, place in zip(self.dimensions, places, strict=True)
            for name, values in dimension.numbers.items()
        }
        told = lanes[options]({"numbers": numbers, "place": places[0].ravel()})
        return {name: x.reshape(*places[0].shape, *x.shape[1:]) for name, x in told.items()}


def _with_mask(answer: "xarray.Dataset") -> "xarray.Dataset":
    good = answer[RESULT] == RESULT_NAMES.index("successful")
    return answer.assign(successful=good.assign_attrs(long_name="solved without any doubt"))


def _wait_for_all(what: str) -> None:
    """Until every process has come here."""
    if jax.process_count() > 1:
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(what)


@contextmanager
def _bar(total: int, missing: int, shown: bool) -> Iterator[Callable[[int], None]]:
    """A bar of progress with the rate and the time that is left."""
    if not shown:
        yield lambda count: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    rate = TextColumn("{task.fields[rate]}")
    with Progress(TextColumn("sweep"), BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn()) as bar:
        task = bar.add_task("sweep", total=total, completed=total - missing, rate="")

        def advance(count: int) -> None:
            bar.advance(task, count)
            speed = bar.tasks[0].speed
            bar.update(task, rate="" if speed is None else f"{speed:,.0f} a second")

        yield advance
