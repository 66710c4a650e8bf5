"""`sweep`: a solve for every combination of what varies, as a labelled dataset, in chunks that survive a stop."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
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
from ..batch.lanes import in_lanes
from ..batch.work import COPIES, carry_out
from ..errors import InputError, needed, within
from ..mechanics.directions import as_directions, stated_directions
from ..mechanics.march import FixedPoint
from ..mechanics.problem import Method
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..statics.named_numbers import Case, holds, of_tendon
from ..statics.targets import Actuation
from . import one_solve
from .axes import PATH, Dimension, dimensions_of
from .checks import check_sweep
from .one_solve import RESULT, SUCCESSFUL, OneSolve, slope_name

if TYPE_CHECKING:
    import xarray

CHUNK = 131072  # solves
CHUNK_IN_INCREMENTS = 512  # solves, each of which takes some 10,000 times as long
SHARE = 0.25  # of the free memory
DEFAULT_OUTPUTS = ("tip_tension", "tip_position", "tip_angle")
Values = Sequence[object] | np.ndarray | jax.Array  # along one axis
Observable = Callable[[Equilibrium], ArrayLike]
_OF_SPACE = re.compile(r"loads\.((tip_force|gravity)\.2|tip_moment\.[0-2])")  # components that only space has


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
    out: str | os.PathLike[str] | None = None,
    memory: float | None = None,
    chunk: int | None = None,
) -> "xarray.Dataset":
    """Solve for every combination of the values along the axes, on all devices and processes.

    Args:
        manipulator: the body, with all numbers that no axis names.
        axes: by dimension of the dataset. Either the name of a number and its values, {"base_tension": values}, or any
            other name and several numbers that vary together along it, {"sample": latin_hypercube(...)}. The dimensions
            are combined with each other. A name is the path to a number: "base_tension", "youngs_modulus",
            "outer_radius.tip", "tendons.0.offset", "loads.tip_force.1", "base_tension_2", and the options "nodes",
            "method", "kinematics". SI units.
        base_tension, loads, direction, nodes, method: as `solve` takes them, if no axis names them.
        history: take the base tensions along their axis as a path in time, N, from rest: tendons are pulled and
            released in their order, by `trace`, for each combination of the other axes. Several tendons, and loads that
            change with them, vary together along it: {"path": {"base_tension_1": values, "base_tension_2": values}}.
            If base tensions vary along other axes too, give the name of the axis that is the path. `loads` act before
            the first step. Several tendons and loads are followed in increments: ask for `error_estimate`, and look at
            `result`, which is `inaccurate` if the error is large.
        short_steps: as `trace` takes it, with several tendons or loads.
        outputs: attributes of `Equilibrium`, or of `History` and its fields, each an array of the dataset.
        observables: more outputs, by name, each a function of an `Equilibrium`.
        sensitivities: names of numbers; for each real output X and each number P the dataset then has X_by_P, the
            derivative.
        out: path of a Zarr store. A sweep that was stopped, even by a kill, goes on where it was when it is started
            again. A store of another sweep is refused. Several processes (`jax.distributed`) share the work.
        memory: bytes that may be used; a quarter of the free memory unless given.
        chunk: solves between two writes; chosen for speed and memory unless given.

    Returns:
        The outputs with the dimensions of the axes first, then "tendon", "point" (along the body), "component" (X, Y,
        and in space Z), and in space "axis" (x, y, z of the cross-section).
        `result` is the code of each solve (its attributes list the codes), and `successful` is true where it has no
        doubt. A failed solve is NaN, and a doubtful one (crossing, inaccurate, unstable, ...) keeps its numbers. As in
        `solve`, walls and clearances are not checked: call `manipulator.validate()`. Chunks, devices and processes
        change numbers by 1e-13 relative at most.

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
    """A sweep before it runs; for its fields see `sweep`."""

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
        if loads is not None:
            loads = loads.with_components(3 if any(map(_OF_SPACE.fullmatch, names)) else self.manipulator.components)
        tension, count = self.base_tension, self.manipulator.num_tendons
        own = [of_tendon("base_tension", i) for i in range(count)]
        if tension is None and not set(own).isdisjoint(names):
            if missing := [name for name in own if name not in names]:
                remedy = f"give base_tension= with a number for each tendon, or the axis {missing[0]!r} as well"
                raise InputError(f"sweep: the tension of {missing[0]!r} is neither given nor an axis; {remedy}")
            tension = np.zeros(count)
        tension = tuple(tension) if isinstance(tension, list) else tension
        if any(holds("base_tension", name) for name in names) and isinstance(tension, int | float):
            tension = np.full(count, float(tension))
        with within("sweep", ValueError):
            direction = as_directions(stated_directions(self.direction, count))
        if any(holds("direction", name) for name in names) and isinstance(direction, np.ndarray) and not direction.ndim:
            direction = np.full(count, direction)
        return Case(self.manipulator, tension, loads, direction)

    @property
    def known_outputs(self) -> Mapping[str, tuple[str, ...]]:
        """All possible outputs, and their dimensions besides those of the sweep."""
        of_history, of_one_tendon = one_solve.OF_HISTORY, "num_turns"
        if self.in_increments:
            return {name: dims for name, dims in of_history[2].items() if name != of_one_tendon}
        return (of_history if self.history else one_solve.OUTPUTS_OF)[self.case.components]

    @property
    def dtype(self) -> np.dtype:
        """The precision, that of JAX."""
        return jax.dtypes.canonicalize_dtype(np.float64)

    @cached_property
    def allowed(self) -> float:
        """The memory that may be used, bytes."""
        return SHARE * needed("psutil").virtual_memory().available if self.memory is None else float(self.memory)

    # --- the answer before it is computed -------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """The shape of the dataset, and its chunks."""
        check_sweep(self)
        variables = self._variables()
        units = {name: self.case.unit(name) for dimension in self.dimensions for name in dimension.numbers}
        layout = Layout(
            {dimension.name: dimension.size for dimension in self.dimensions},
            tuple(1 for _ in self.dimensions),
            one_solve.coordinates(self.dimensions, units, variables),
            variables,
            {"title": "cddf_jax sweep", "cddf_jax": version("cddf_jax"), "precision": self.dtype.name}
            | ({PATH: self.path.name} if self.path else {}),
        )
        each = COPIES * layout.bytes_each * self.steps
        if each > self.allowed:
            raise InputError(f"sweep: one solve needs {each} bytes, {self.allowed:.3g} are allowed; raise memory=")
        usual = CHUNK_IN_INCREMENTS if self.in_increments else CHUNK
        most = max((self.chunk_size or min(usual, int(self.allowed // each) * self.steps)) // self.steps, 1)
        sizes = [1 if d is self.path else d.size for d in self.dimensions]
        chunks = even_chunks(sizes, most, [bool(d.options) for d in self.dimensions])
        whole = [d.size if d is self.path else c for d, c in zip(self.dimensions, chunks, strict=True)]
        return replace(layout, chunks=tuple(whole))

    @property
    def pulled(self) -> list[Dimension]:
        """The dimensions along which base tensions vary."""
        return [d for d in self.dimensions if any(name.startswith("base_tension") for name in d.numbers)]

    @cached_property
    def path(self) -> Dimension | None:
        """The dimension whose base tensions are traced in their order; None without one, or if there are several."""
        if isinstance(self.history, str):
            return next((dimension for dimension in self.pulled if dimension.name == self.history), None)
        return self.pulled[0] if self.history and len(self.pulled) == 1 else None

    @property
    def in_increments(self) -> bool:
        """Whether a history has no exact answer."""
        return bool(self.history) and (self.case.manipulator.num_tendons > 1 or self.case.loads is not None)

    @property
    def steps(self) -> int:
        """The number of solves that are made together: the steps of a path."""
        return 1 if self.path is None else self.path.size

    def _variables(self) -> dict[str, Variable]:
        inputs = {n: np.zeros((), self.dtype) for d in self.dimensions if d is not self.path for n in d.numbers}
        outputs, found = (*self.outputs, *self.observables), dict[str, Variable]()
        shape = {dimension.name: dimension.size for dimension in self.dimensions}
        # name, output and the number that it is differentiated by, in the order of the answer
        wanted = [(slope_name(n, by) if by else n, n, by) for n in outputs for by in ("", *self.sensitivities)]
        wanted += [(SUCCESSFUL, SUCCESSFUL, ""), (RESULT, RESULT, "")]
        for index in np.ndindex(*(d.size if d.options else 1 for d in self.dimensions)):
            try:
                with within("sweep", ValueError):
                    shapes = jax.eval_shape(self.solver(index), inputs)
            except TypeError as error:
                raise InputError(str(error), where="sweep") from None
            if self.path:  # the steps are a dimension of the sweep
                shapes = {name: jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for name, x in shapes.items()}
            for name, base, by in wanted:
                if name not in shapes:  # a derivative of what is not real
                    continue
                unit_by = self.case.unit(by) if by else ""
                new = one_solve.variable(base, shapes[name], shape, self.known_outputs, unit_by, by)
                if found.setdefault(name, new).shape != new.shape:
                    raise InputError(f"sweep: the length of {name} changes with the nodes; sweep 'nodes' without it")
        return found

    @cached_property
    def identity(self) -> dict[str, object]:
        """All that the results depend on, JSON."""
        body = self.case.manipulator
        along = np.linspace(0.0, float(np.asarray(body.length)), 101)  # for profiles that are functions, without leaves
        profiles = body.profiles.values()
        axes = {f"axis {d.name}": {k: recorded(v) for k, v in (d.numbers | d.options).items()} for d in self.dimensions}
        return {
            **numbers_of(self.case),
            **axes,
            "order of axes": [dimension.name for dimension in self.dimensions],
            # not compiled: the last digits would depend on the options of the compiler
            "radii and offsets": recorded(np.stack([np.asarray(profile(along), float) for profile in profiles])),
            "kinematics": self.manipulator.kinematics,
            "history": self.history,
            **({"short_steps": self.short_steps} if self.in_increments else {}),
            "nodes": self.nodes,
            "method": recorded(self.method),
            "outputs": list(self.outputs),
            "observables": {name: code_digest(function) for name, function in self.observables.items()},
            "sensitivities": list(self.sensitivities),
            "precision": self.dtype.name,
            "version of cddf_jax": version("cddf_jax"),
        }

    def solver(self, index: Index) -> OneSolve:
        """One solve as a function of the numbers that vary, with the options at `index` along the dimensions."""
        chosen = {
            name: values[i]
            for dimension, i in zip(self.dimensions, index, strict=True)
            for name, values in dimension.options.items()
        }
        kinematics = str(chosen.pop("kinematics", self.manipulator.kinematics))
        case, observed = one_solve.prepared(self.case, kinematics), tuple(self.observables.items())
        path = None
        if self.path is not None:
            path = {name: jnp.asarray(values) for name, values in self.path.numbers.items()}
        asked = self.outputs, observed, self.sensitivities
        one = OneSolve(case, path, *asked, self.nodes, self.short_steps, self.method)
        return replace(one, **chosen)

    # --- running ------------------------------------------------------------------------------------

    def run(self, out: str | os.PathLike[str] | None = None) -> "xarray.Dataset":
        """Compute the chunks that the store does not have yet, and return the whole dataset."""
        done = carry_out("solving", self.layout, lambda: self.identity, self.chunk, out, self.allowed)
        return done.dataset()

    def chunk(self, layout: Layout, index: Index) -> dict[str, np.ndarray]:
        """The outputs of one chunk, in the shape of its region."""
        region = layout.region(index)
        options = tuple(r.start if d.options else 0 for d, r in zip(self.dimensions, region, strict=True))
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
        most = layout.chunk_size // self.steps
        outputs = in_lanes(self.solver(options), numbers, places[0].size, most, self.steps)
        return {name: self._in_place(np.reshape(x, (*places[0].shape, *x.shape[1:]))) for name, x in outputs.items()}

    def _in_place(self, output: np.ndarray) -> np.ndarray:
        """An output of a chunk with the steps of a path moved to their dimension, which has the length 1 so far."""
        if self.path is None:
            return output
        steps, own = len(self.dimensions), self.dimensions.index(self.path)
        return np.squeeze(np.swapaxes(output, own, steps), steps)
