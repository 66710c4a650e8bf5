"""`sweep`: one solve for every combination of what varies, with labels, in chunks that survive a stop."""

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from ..batch.chunks import Index, Layout, Variable, even_chunks
from ..batch.fingerprint import code_digest, numbers_of, recorded
from ..batch.lanes import Lanes
from ..batch.work import COPIES, Work, carry_out
from ..errors import InputError, needed, within
from ..mechanics.directions import as_directions, stated_directions
from ..mechanics.fixed_point import FixedPoint
from ..mechanics.problem import Method
from ..programs.kept import shapes_of
from ..robot.loads import Loads, loads_in_space
from ..robot.manipulator import Manipulator
from ..robot.named_numbers import Case, holds, of_tendon
from ..statics.arguments import check_nodes
from ..statics.equilibrium import Equilibrium
from ..statics.targets import Actuation, Target, TipPosition
from .axes import PATH, RESERVED, Dimension, check_names, dimensions_of
from .one_solve import (
    IN_SPACE,
    OF_HISTORY,
    OF_HISTORY_IN_SPACE,
    OUTPUTS,
    RESULT,
    SUCCESSFUL,
    OneSolve,
    coordinates,
    prepared,
    slope_name,
    variable,
)

if TYPE_CHECKING:
    import xarray

CHUNK = 131072  # solves
CHUNK_IN_SHORT_STEPS = 512  # each of which takes some 10,000 times as long
SHARE = 0.25  # of the memory that is free
DEFAULT_OUTPUTS = ("tip_tension", "tip_position", "tip_angle")
Values = Sequence[object] | np.ndarray | jax.Array  # along one axis
Observable = Callable[[Equilibrium], ArrayLike]
ALONG_A_PATH = ("base_tension", "loads.")  # beginnings of the names of what may vary along it
_OF_SPACE = re.compile(r"loads\.((tip_force|gravity)\.2|tip_moment\.[0-2])")  # components that the plane has not


def sweep(
    manipulator: Manipulator,
    axes: Mapping[str, Values | Mapping[str, Values]],
    base_tension: Actuation | None = None,
    loads: Loads | None = None,
    *,
    history: bool | str = False,
    short_steps: int = 16,
    direction: ArrayLike | Sequence[int | None] | None = None,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    observables: Mapping[str, Observable] | None = None,
    sensitivities: Sequence[str] = (),
    nodes: int = 16,
    method: Method = FixedPoint(),
    precision: str | None = None,
    out: str | os.PathLike[str] | None = None,
    memory: float | None = None,
    chunk: int | None = None,
) -> "xarray.Dataset":
    """Solve for every combination of the values along the axes, on all devices and processes there are.

    Args:
        manipulator: the body; what no axis names is taken from here.
        axes: by dimension of the answer. Either the name of a number and its values, {"base_tension": values}, or any
            other name and several numbers that vary together along it, {"sample": latin_hypercube(...)}. The dimensions
            are combined with each other. A name is the path to a number: "base_tension", "youngs_modulus",
            "outer_radius.tip", "tendons.0.offset", "loads.tip_force.1", "base_tension_2", and the options "nodes",
            "method", "kinematics". SI units.
        base_tension, loads, direction, nodes, method: as `solve` takes them, where no axis names them.
        history: take the base tensions along their axis for a path in time, N, from rest: they are pulled and
            released in their order, by `trace`, for each combination of the other axes. Several tendons, and loads that
            change with them, vary together along it: {"path": {"base_tension_1": values, "base_tension_2": values}}.
            Where base tensions vary along other axes too, the name of the axis that is the path. `loads` rest on the
            body before the first step. Several tendons and loads are followed in short steps: ask for `error_estimate`,
            and look at `result`, which says `inaccurate` where it is large.
        short_steps: as `trace` takes it, with several tendons or loads.
        outputs: attributes of `Equilibrium`, or of `History` and its fields, each an array of the answer.
        observables: more outputs, by name, each a function of an `Equilibrium`.
        sensitivities: names of numbers; for each output X that is real and each number P there is then
            X_by_P, the derivative.
        precision: "float32" or "float64"; that of JAX unless given.
        out: path of a Zarr store. A sweep that was stopped, even by a kill, goes on where it was when it is started
            again. A store of another sweep is refused. Several processes (`jax.distributed`) share the work.
        memory: that may be used, bytes; a quarter of what is free unless given.
        chunk: solves between two writes; sized for speed and memory unless given.

    Returns:
        The outputs with the dimensions of the axes first, then "tendon", "point" (along the body), "component" (X, Y,
        and in space Z), and in space "axis" (x, y, z of the cross-section).
        `result` says how each solve went (its codes are among its attributes) and `successful` where all is well: a
        failed solve is NaN, a doubtful one (crossing, inaccurate, unstable, ...) keeps its numbers. As in `solve`,
        walls and clearances are not checked: call `manipulator.validate()`. Chunks, devices and processes change
        numbers in the last bits at most (1e-13 relative).

    With "length" everything along the body varies in proportion: tapers, knots, joints and anchors. All other numbers
    of a profile stay.

    Raises:
        InputError: for an unknown axis, output or option, a store of another sweep, or too little memory.
    """
    work = Sweep(
        manipulator=manipulator,
        dimensions=dimensions_of(axes),
        base_tension=base_tension,
        loads=loads,
        history=history,
        short_steps=short_steps,
        direction=direction,
        outputs=_names("outputs", outputs),
        observables=dict(observables or {}),
        sensitivities=_names("sensitivities", sensitivities),
        nodes=nodes,
        method=method,
        precision=precision,
        memory=memory,
        chunk_size=chunk,
    )
    return work.run(out)


def _names(what: str, given: Sequence[str]) -> tuple[str, ...]:
    if isinstance(given, str) or not all(isinstance(name, str) for name in given):
        raise InputError(f"sweep: {what} must be a tuple of names, as in {what}=('tip_tension',), got {given!r}")
    return tuple(given)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep that is to run; for its fields see `sweep`."""

    manipulator: Manipulator
    dimensions: tuple[Dimension, ...]
    base_tension: Actuation | None = None
    loads: Loads | None = None
    history: bool | str = False
    short_steps: int = 16
    direction: ArrayLike | Sequence[int | None] | None = None
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS
    observables: dict[str, Observable] = field(default_factory=dict)
    sensitivities: tuple[str, ...] = ()
    nodes: int = 16
    method: Method = field(default_factory=FixedPoint)
    precision: str | None = None
    memory: float | None = None
    chunk_size: int | None = None

    # --- what is asked for ------------------------------------------------------------------------

    @cached_property
    def case(self) -> Case:
        """The case to solve; axes replace some of its numbers."""
        names = [*self.sensitivities, *(name for dimension in self.dimensions for name in dimension.numbers)]
        loads = self.loads
        if loads is None and any(name.startswith("loads.") for name in names):
            loads = Loads()
        if loads is not None and (self.manipulator.in_space or any(map(_OF_SPACE.fullmatch, names))):
            loads = loads_in_space(loads)
        tension, count = self.base_tension, self.manipulator.num_tendons
        if tension is None and {of_tendon("base_tension", i) for i in range(count)} <= set(names):
            tension = np.zeros(count)
        tension = tuple(tension) if isinstance(tension, list) else tension
        if any(holds("base_tension", name) for name in names) and isinstance(tension, int | float):
            tension = np.full(count, float(tension))
        with within("sweep", ValueError):
            direction = as_directions(stated_directions(self.direction, count))
        return Case(self.manipulator, tension, loads, direction)

    @property
    def known_outputs(self) -> Mapping[str, tuple[str, ...]]:
        """What can be asked for, and its dimensions beside those of the sweep."""
        if self._in_short_steps:
            return {name: dims for name, dims in OF_HISTORY.items() if name != "num_turns"}  # which one tendon has
        if self.history:
            return OF_HISTORY_IN_SPACE if self.case.in_space else OF_HISTORY
        return IN_SPACE if self.case.in_space else OUTPUTS

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

    def _check_kinds(self) -> None:
        if not isinstance(self.manipulator, Manipulator):
            raise InputError(
                f"sweep: manipulator must be a Manipulator, as of read_manipulator, got {self.manipulator!r}"
            )
        if self.loads is not None and not isinstance(self.loads, Loads):
            raise InputError(f"sweep: loads must be Loads, as in Loads(tip_force=(0.0, -1.0)), got {self.loads!r}")
        if not isinstance(self.method, Method) or isinstance(self.method, type):
            raise InputError(f"sweep: method must be one such as FixedPoint(), got {self.method!r}")
        if self.memory is not None and not (isinstance(self.memory, int | float) and self.memory > 0):
            raise InputError(f"sweep: memory must be a number of bytes above 0, as in memory=2e9, got {self.memory!r}")
        if self.chunk_size is not None and (not isinstance(self.chunk_size, int) or self.chunk_size < 1):
            raise InputError(f"sweep: chunk must be a whole number of 1 or more, got {self.chunk_size!r}")
        with within("sweep", ValueError):
            check_nodes(self.nodes)

    def _check_history(self) -> None:
        """What cannot be traced."""
        among = [dimension.name for dimension in self._pulled]
        if not among:
            raise InputError('sweep: history needs the axis "base_tension", whose values are the path')
        if self.path is None:
            which = ", ".join(map(repr, among))
            raise InputError(
                f"sweep: base tensions vary along {which}; history must be the name of the one that is the path"
            )
        beside = [name for name in (*self.path.numbers, *self.path.options) if not name.startswith(ALONG_A_PATH)]
        if beside:
            raise InputError(f"sweep: only base tensions and loads vary along a path, not {beside[0]}; give it an axis")
        numbers = {name for d in self.dimensions for name in (*d.numbers, *d.options)}
        given = {"direction": self.direction, "observables": self.observables or None}
        others = [name for name, value in given.items() if value is not None]
        others += [name for name in numbers if name.startswith(("direction", "method"))]
        others += [name for name in self.sensitivities if name.startswith(ALONG_A_PATH)]
        if others or not isinstance(self.method, FixedPoint):
            what = others[0] if others else "method"
            raise InputError(f"sweep: with history there is no {what}; leave it out")
        if self._in_short_steps:
            self._check_short_steps()

    def _check_short_steps(self) -> None:
        """What cannot be followed in short steps."""
        what = "of several tendons or under loads"
        if self.case.in_space:
            raise InputError(f"sweep: a history {what} is known in the plane only; take one tendon without loads")
        entries = jax.tree.leaves(self.case.base_tension, is_leaf=lambda entry: isinstance(entry, Target))
        if any(isinstance(entry, Target | TipPosition) for entry in entries):
            raise InputError("sweep: with history base_tension must hold tensions, N, in place of targets")
        if self.dtype != np.float64:
            raise InputError(f"sweep: a history {what} needs float64; set jax.config.update('jax_enable_x64', True)")
        if self.sensitivities:
            raise InputError(
                f"sweep: derivatives of a history {what} are right to about 1 % only; leave sensitivities out"
            )
        if isinstance(self.short_steps, bool) or not isinstance(self.short_steps, int) or self.short_steps < 2:
            raise InputError(f"sweep: short_steps must be a whole number of 2 or more, got {self.short_steps!r}")

    def _check(self) -> None:
        if self.history:
            self._check_history()
        for name in ("outputs", "sensitivities"):
            if len(set(getattr(self, name))) < len(getattr(self, name)):
                raise InputError(f"sweep: {name} names something twice; leave one out")
        known = {name for dimension in self.dimensions for name in (dimension.name, *dimension.numbers)}
        if self.base_tension is not None and "base_tension" in known:
            raise InputError("sweep: base_tension is given and an axis; leave one out")
        for name in self.outputs:
            if name not in self.known_outputs:
                of = " of a history" if self.history else " in space" if self.case.in_space else ""
                raise InputError(f"sweep: {name!r} is no output{of}; there are {', '.join(self.known_outputs)}")
        for name in (*self.outputs, *self.observables):
            if name in known:
                raise InputError(f"sweep: {name!r} is an axis and an output; take it out of the outputs")
        for name in self.observables:
            if name in OUTPUTS | IN_SPACE or name in RESERVED or "/" in name:
                raise InputError(f"sweep: no observable can be called {name!r}; give it another name")
            if not callable(self.observables[name]):
                raise InputError(f"sweep: the observable {name!r} must be a function of an Equilibrium")
        if not self.outputs and not self.observables:
            raise InputError("sweep: nothing is asked for; name an output such as 'tip_tension'")
        if not all(np.all(np.abs(stated) == 1) for stated in jax.tree.leaves(self.case.direction)):
            raise InputError(f"sweep: direction is 1 for sliding in and -1 for sliding out, got {self.direction!r}")
        wall_is_seen = bool(self.observables) or not {"peak_strain", "peak_strain_at"}.isdisjoint(self.outputs)
        check_names(self.dimensions, self.sensitivities, self.case, wall_is_seen)

    # --- the answer before it is computed -------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """Its shape.

        Raises:
            InputError: where an argument of the sweep is wrong.
        """
        self._check_kinds()
        self._check()
        variables = self._variables()
        units = {name: self.case.unit(name) for dimension in self.dimensions for name in dimension.numbers}
        layout = Layout(
            self._shape,
            tuple(1 for _ in self.dimensions),
            coordinates(self.dimensions, units, variables),
            variables,
            {"title": "cddf_jax sweep", "cddf_jax": version("cddf_jax"), "precision": self.dtype.name}
            | ({PATH: self.path.name} if self.path else {}),
        )
        each = COPIES * layout.bytes_each * self.steps
        if each > self.allowed:
            raise InputError(f"sweep: one solve needs {each} bytes, {self.allowed:.3g} are allowed; raise memory=")
        usual = CHUNK_IN_SHORT_STEPS if self._in_short_steps else CHUNK
        most = max((self.chunk_size or min(usual, int(self.allowed // each) * self.steps)) // self.steps, 1)
        sizes = [1 if d is self.path else d.size for d in self.dimensions]
        chunks = even_chunks(sizes, most, [bool(d.options) for d in self.dimensions])
        whole = [d.size if d is self.path else c for d, c in zip(self.dimensions, chunks, strict=True)]
        return replace(layout, chunks=tuple(whole))

    @property
    def _pulled(self) -> list[Dimension]:
        """The dimensions along which base tensions vary."""
        return [d for d in self.dimensions if any(name.startswith("base_tension") for name in d.numbers)]

    @cached_property
    def path(self) -> Dimension | None:
        """The dimension whose base tensions are traced in their order; None without one, or if there are several."""
        if isinstance(self.history, str):
            return next((dimension for dimension in self._pulled if dimension.name == self.history), None)
        return self._pulled[0] if self.history and len(self._pulled) == 1 else None

    @property
    def _in_short_steps(self) -> bool:
        """Whether a history has no exact answer."""
        return bool(self.history) and (self.case.manipulator.num_tendons > 1 or self.case.loads is not None)

    @property
    def steps(self) -> int:
        """How many solves are made together, as one goes on where another ended."""
        return 1 if self.path is None else self.path.size

    @property
    def _varied(self) -> list[Dimension]:
        """What varies from one solve or one trace to another."""
        return [dimension for dimension in self.dimensions if dimension is not self.path]

    @property
    def _shape(self) -> dict[str, int]:
        return {dimension.name: dimension.size for dimension in self.dimensions}

    def _variables(self) -> dict[str, Variable]:
        inputs = {name: np.zeros((), self.dtype) for d in self._varied for name in d.numbers}
        found: dict[str, Variable] = {}
        for index in np.ndindex(*(d.size if d.options else 1 for d in self.dimensions)):
            shapes = shapes_of(self.solver(index), inputs)
            if self.path:  # the steps are a dimension of the sweep
                shapes = {name: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for name, x in shapes.items()}
            for name, base, by in self._names(shapes):
                unit_by = self.case.unit(by) if by else ""
                new = variable(base, shapes[name], self._shape, self.known_outputs, unit_by, by)
                if found.setdefault(name, new).shape != new.shape:
                    raise InputError(f"sweep: the length of {name} changes with the nodes; sweep 'nodes' without it")
        return found

    def _names(self, known: Collection[str]) -> Iterator[tuple[str, str, str]]:
        """Of all variables, in the order of the answer: name, output and the number that it is differentiated by."""
        for name in (*self.outputs, *self.observables):
            yield name, name, ""
            for by in self.sensitivities:
                if (slope := slope_name(name, by)) in known:
                    yield slope, name, by
        for name in (SUCCESSFUL, RESULT):
            yield name, name, ""

    @cached_property
    def identity(self) -> dict[str, object]:
        """All that the answer depends on, JSON."""
        body = self.case.manipulator
        along = np.linspace(0.0, float(np.asarray(body.length)), 101)  # a function as a profile has no leaves
        profiles = body.profiles.values()
        axes = {f"axis {d.name}": {k: recorded(v) for k, v in (d.numbers | d.options).items()} for d in self.dimensions}
        return {
            **numbers_of(self.case),
            **axes,
            "order of axes": [dimension.name for dimension in self.dimensions],
            # operation by operation: compiled together, the last digits would depend on the compiler's options
            "radii and offsets": recorded(np.stack([np.asarray(profile(along), float) for profile in profiles])),
            "kinematics": self.manipulator.kinematics,
            "history": self.history,
            **({"short_steps": self.short_steps} if self._in_short_steps else {}),
            "nodes": self.nodes,
            "method": recorded(self.method),
            "outputs": list(self.outputs),
            "observables": {name: code_digest(function) for name, function in self.observables.items()},
            "sensitivities": list(self.sensitivities),
            "precision": self.dtype.name,
            "version of cddf_jax": version("cddf_jax"),
        }

    def solver(self, index: Index) -> OneSolve:
        """One solve as a function of the numbers that vary; `index` is that of the options along the dimensions."""
        chosen = {
            name: values[i]
            for dimension, i in zip(self.dimensions, index, strict=True)
            for name, values in dimension.options.items()
        }
        kinematics = str(chosen.pop("kinematics", self.manipulator.kinematics))
        case, observed = prepared(self.case, kinematics, self.dtype), tuple(self.observables.items())
        path = None
        if self.path is not None:
            path = {name: jnp.asarray(values, self.dtype) for name, values in self.path.numbers.items()}
        asked = self.outputs, observed, self.sensitivities
        one = OneSolve(case, path, *asked, self.nodes, self.short_steps, self.method, self.dtype)
        return replace(one, **chosen)

    # --- running ------------------------------------------------------------------------------------

    def run(self, out: str | os.PathLike[str] | None = None) -> "xarray.Dataset":
        """Compute the chunks that the store does not have yet, and return the whole answer."""
        work = Work("solving", self.layout, lambda: self.identity, self.chunk)
        return carry_out(work, out, self.allowed).dataset()

    def chunk(self, layout: Layout, index: Index) -> dict[str, np.ndarray]:
        """The outputs of one chunk, in the shape of its region."""
        region = layout.region(index)
        options = tuple(r.start if d.options else 0 for d, r in zip(self.dimensions, region, strict=True))
        lanes = Lanes(self.solver(options), layout.chunk_size // self.steps, self.steps)
        along = [
            np.zeros(1, int) if dimension is self.path else np.arange(r.start, r.stop)
            for dimension, r in zip(self.dimensions, region, strict=True)
        ]
        places = np.meshgrid(*along, indexing="ij")
        numbers = {
            name: values[place.ravel()].astype(self.dtype)
            for dimension, place in zip(self.dimensions, places, strict=True)
            for name, values in dimension.numbers.items()
            if dimension is not self.path
        }
        outputs = lanes(numbers, places[0].size)
        return {name: self._in_place(np.reshape(x, (*places[0].shape, *x.shape[1:]))) for name, x in outputs.items()}

    def _in_place(self, output: np.ndarray) -> np.ndarray:
        """An output of a chunk with the steps of a path along their dimension, which has one place so far."""
        if self.path is None:
            return output
        steps, own = len(self.dimensions), self.dimensions.index(self.path)
        return np.squeeze(np.swapaxes(output, own, steps), steps)
