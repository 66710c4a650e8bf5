"""`sweep`: a solve for every combination of what varies, as a labelled dataset, in chunks that survive a stop."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from ..batch.fingerprint import numbers_of, recorded
from ..batch.lanes import in_lanes
from ..batch.work import COPIES, Layout, Region, carry_out, even_chunks, not_computed
from ..errors import InputError, needed, within
from ..mechanics.directions import as_directions, stated_directions
from ..numerics.given_numbers import check_numbers, check_whole
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.validation import check_loads
from ..statics.arguments import refuse_batch
from ..statics.named_numbers import Case, holds, of_tendon, stem_and_tendon
from ..statics.targets import Actuation, Target, TipPosition
from . import one_solve
from .axes import ALONG_A_PATH, PATH, Dimension, dimensions_of
from .one_solve import RESULT, SUCCESSFUL, OneSolve, slope_name

if TYPE_CHECKING:
    import xarray

CHUNK = 131072  # solves
CHUNK_IN_INCREMENTS = 512  # solves, each of which takes some 10,000 times as long
SHARE = 0.25  # of the free memory, for the chunks at work
DEFAULT_OUTPUTS = ("tip_tension", "tip_position", "tip_angle")
Values = Sequence[object] | np.ndarray | jax.Array  # along one axis


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
    sensitivities: Sequence[str] = (),
    nodes: int = 16,
    out: str | os.PathLike[str] | None = None,
    chunk: int | None = None,
) -> "xarray.Dataset":
    """Solve for every combination of the values along the axes, on all devices and processes.

    Args:
        manipulator: the body, with all numbers that no axis names.
        axes: by dimension of the dataset. Either the name of a number and its values, {"base_tension": values}, or any
            other name and several numbers that vary together along it, {"sample": latin_hypercube(...)}. The dimensions
            are combined with each other. A name is the path to a number: "base_tension", "youngs_modulus",
            "outer_radius.tip", "tendons.0.offset", "loads.tip_force.1", "base_tension_2". SI units.
        base_tension, loads, direction, nodes: as `solve` takes them, if no axis names them.
        history: take the base tensions along their axis as a path in time, N, from rest: tendons are pulled and
            released in their order, by `trace`, for each combination of the other axes. Several tendons, and loads that
            change with them, vary together along it: {"path": {"base_tension_1": values, "base_tension_2": values}}.
            If base tensions vary along other axes too, give the name of the axis that is the path. `loads` act before
            the first step. Several tendons and loads are followed in increments: ask for `error_estimate`, and look at
            `result`, which is `inaccurate` if the error is large.
        short_steps: as `trace` takes it, with several tendons or loads.
        outputs: attributes of `Equilibrium`, or of `History` and its fields, each an array of the dataset.
        sensitivities: names of numbers; for each real output X and each number P the dataset then has X_by_P, the
            derivative.
        out: path of a Zarr store. A sweep that was stopped, even by a kill, goes on where it was when it is started
            again. A store of another sweep is refused. Several processes (`jax.distributed`) share the work.
        chunk: solves between two writes; chosen for speed and memory unless given.

    Returns:
        The outputs with the dimensions of the axes first, then "tendon", "point" (along the body), "component" (X, Y,
        and in space Z), and in space "axis" (x, y, z of the cross-section).
        `result` is the code of each solve (its attributes list the codes), and `successful` is true where it has no
        doubt. A failed solve is NaN, such as one with a point load beside the body. A doubtful one (crossing,
        inaccurate, unstable, ...) keeps its numbers. As in `solve`, walls and clearances are not checked: call
        `manipulator.validate()`. Chunks, devices and processes change numbers by 1e-13 relative at most.

    With "length" everything along the body varies in proportion: tapers, knots, joints and anchors. All other numbers
    of a profile stay, and so do the places of point loads.

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
        sensitivities=_names("sensitivities", sensitivities),
        nodes=nodes,
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
    sensitivities: tuple[str, ...] = ()
    nodes: int = 16
    chunk_size: int | None = None

    # --- what is asked for ------------------------------------------------------------------------

    @cached_property
    def case(self) -> Case:
        """The case to solve; axes replace some of its numbers."""
        names = [*self.sensitivities, *(name for dimension in self.dimensions for name in dimension.numbers)]
        loads = Loads() if self.loads is None and any(name.startswith("loads.") for name in names) else self.loads
        loads = None if loads is None else loads.with_components(max(loads.components, self.manipulator.components))
        tension, count = self.base_tension, self.manipulator.num_tendons
        own = [of_tendon("base_tension", i) for i in range(count)]
        if tension is None and not set(own).isdisjoint(names):
            if lost := [name for name in own if name not in names]:
                raise InputError(f"sweep: {lost[0]!r} is neither given nor an axis; give base_tension= or this axis")
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
        known = (one_solve.OF_HISTORY if self.history else one_solve.OUTPUTS_OF)[self.case.components]
        return {name: dims for name, dims in known.items() if name != "num_turns" or not self.in_increments}

    @property
    def dtype(self) -> np.dtype:
        """The precision, that of JAX."""
        return jax.dtypes.canonicalize_dtype(np.float64)

    @cached_property
    def free(self) -> float:
        """The free memory, bytes."""
        return float(needed("psutil").virtual_memory().available)

    # --- the answer before it is computed -------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """The dataset before it is computed, and its chunks."""
        _check(self)
        layout = Layout(self._empty(), {dimension.name: 1 for dimension in self.dimensions})
        at_once = SHARE * self.free // (COPIES * layout.bytes_each * self.steps)
        usual = min(CHUNK_IN_INCREMENTS if self.in_increments else CHUNK, int(at_once) * self.steps)
        most = max((self.chunk_size or usual) // self.steps, 1)
        sizes = [1 if d is self.path else d.size for d in self.dimensions]
        chunks = even_chunks(sizes, most)
        whole = {d.name: d.size if d is self.path else c for d, c in zip(self.dimensions, chunks, strict=True)}
        return replace(layout, chunks=whole)

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
        body = self.case.manipulator
        return bool(self.history) and (body.num_tendons > 1 or self.case.loads is not None or body.has_memory)

    @property
    def steps(self) -> int:
        """The number of solves that are made together: the steps of a path."""
        return 1 if self.path is None else self.path.size

    def _empty(self) -> "xarray.Dataset":
        """The dataset without results."""
        sizes = {dimension.name: dimension.size for dimension in self.dimensions}
        arrays: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, object]]] = {}
        known = self.known_outputs
        # name, output and the number that it is differentiated by, in the order of the answer
        wanted = [(slope_name(n, by) if by else n, n, by) for n in self.outputs for by in ("", *self.sensitivities)]
        wanted += [(SUCCESSFUL, SUCCESSFUL, ""), (RESULT, RESULT, "")]
        shapes = self._shapes()
        for name, output, by in (entry for entry in wanted if entry[0] in shapes):  # only what is real has slopes
            own, dtype = shapes[name]
            attrs = one_solve.attributes(output, by, self.case.unit(by) if by else "")
            arrays[name] = (*sizes, *known.get(output, ())), not_computed((*sizes.values(), *own), dtype), attrs
        units = {name: self.case.unit(name) for dimension in self.dimensions for name in dimension.numbers}
        attrs = {"title": "cddf_jax sweep", "cddf_jax": version("cddf_jax"), "precision": self.dtype.name}
        empty = needed("xarray").Dataset(arrays, attrs=attrs | ({PATH: self.path.name} if self.path else {}))
        return empty.assign_coords(one_solve.coordinates(self.dimensions, units, empty.sizes))

    def _shapes(self) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """Shape and type of each output of one solve, or of one step of a path."""
        inputs = {n: np.zeros((), self.dtype) for d in self.dimensions if d is not self.path for n in d.numbers}
        with within("sweep", (ValueError, TypeError)):
            found = jax.eval_shape(self.solver(), inputs)
        first = 0 if self.path is None else 1  # the steps are a dimension of the sweep
        return {name: (x.shape[first:], np.dtype(x.dtype)) for name, x in found.items()}

    @cached_property
    def identity(self) -> dict[str, object]:
        """All that the results depend on, JSON."""
        body = self.case.manipulator
        # for profiles that are functions, without leaves; so closely that also a step elsewhere is another profile
        along = np.linspace(0.0, float(np.asarray(body.length)), 10_001)
        axes = {f"axis {d.name}": {k: recorded(v) for k, v in d.numbers.items()} for d in self.dimensions}
        return {
            **numbers_of(self.case),
            **axes,
            "order of axes": [dimension.name for dimension in self.dimensions],
            # not compiled: the last digits would depend on the options of the compiler
            "profiles": {n: recorded(np.asarray(profile(along), float)) for n, profile in body.profiles.items()},
            "kinematics": self.manipulator.kinematics,
            "history": self.history,
            **({"short_steps": self.short_steps} if self.in_increments else {}),
            "nodes": self.nodes,
            "outputs": list(self.outputs),
            "sensitivities": list(self.sensitivities),
            "precision": self.dtype.name,
            "version of cddf_jax": version("cddf_jax"),
        }

    def solver(self) -> OneSolve:
        """One solve as a function of the numbers that vary."""
        numbers = float, np.ndarray
        case = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, numbers) else leaf, self.case)
        path = None if self.path is None else jax.tree.map(jnp.asarray, self.path.numbers)
        return OneSolve(case, path, self.outputs, self.sensitivities, self.nodes, self.short_steps)

    # --- running ------------------------------------------------------------------------------------

    def run(self, out: str | os.PathLike[str] | None = None) -> "xarray.Dataset":
        """Compute the chunks that the store does not have yet, and return the whole dataset."""
        return carry_out(self.layout, lambda: self.identity, self.chunk, out, self.free)

    def chunk(self, layout: Layout, region: Region) -> dict[str, np.ndarray]:
        """The outputs of one chunk, in the shape of its region."""
        axes = [dimension for dimension in self.dimensions if dimension is not self.path]
        sizes = [region[axis.name].stop - region[axis.name].start for axis in axes]
        places = np.indices(sizes).reshape(len(axes), math.prod(sizes))
        numbers = {
            name: values[region[axis.name]][place].astype(self.dtype)
            for axis, place in zip(axes, places, strict=True)
            for name, values in axis.numbers.items()
        }
        found = in_lanes(self.solver(), numbers, math.prod(sizes), layout.chunk_size // self.steps, self.steps)
        shaped = {name: np.reshape(x, (*sizes, *x.shape[1:])) for name, x in found.items()}
        if self.path is None:
            return shaped
        along = self.dimensions.index(self.path)  # the steps come behind the axes so far
        return {name: np.moveaxis(x, len(axes), along) for name, x in shaped.items()}


# --- what is refused before anything is solved --------------------------------------------------------


def _check_history(work: Sweep) -> None:
    """Refuse what cannot be traced."""
    among = [dimension.name for dimension in work.pulled]
    if not among:
        raise InputError('sweep: history needs the axis "base_tension", whose values are the path')
    if work.path is None:
        which = ", ".join(map(repr, among))
        raise InputError(
            f"sweep: base tensions vary along {which}; give as history the name of the axis that is the path "
            "(--history)"
        )
    beside = [name for name in work.path.numbers if not name.startswith(ALONG_A_PATH) or name.endswith(".arc_length")]
    if beside:
        raise InputError(f"sweep: only base tensions and loads vary along a path, not {beside[0]}; give it an axis")
    numbers = {name for dimension in work.dimensions for name in dimension.numbers}
    others = [] if work.direction is None else ["direction"]
    others += [name for name in numbers if name.startswith("direction")]
    others += [name for name in work.sensitivities if name.startswith(ALONG_A_PATH)]
    if others:
        raise InputError(f"sweep: with history there is no {others[0]}; leave it out")
    entries = jax.tree.leaves(work.case.base_tension, is_leaf=lambda entry: isinstance(entry, Target))
    if work.in_increments and any(isinstance(entry, Target | TipPosition) for entry in entries):
        raise InputError("sweep: with history base_tension must hold tensions, N, in place of targets")


def _check(work: Sweep) -> None:
    """Refuse what cannot be solved or is not known; what `solve` and `trace` refuse themselves is not looked at."""
    if not isinstance(work.manipulator, Manipulator):
        raise InputError(
            f"sweep: manipulator must be a Manipulator, such as that of read_manipulator, got {work.manipulator!r}"
        )
    if work.loads is not None and not isinstance(work.loads, Loads):
        raise InputError(f"sweep: loads must be Loads, as in Loads(tip_force=(0.0, -1.0)), got {work.loads!r}")
    check_numbers("sweep: base_tension", jax.tree.leaves(work.base_tension))
    if work.chunk_size is not None:
        check_whole("sweep: chunk", work.chunk_size, 1)
    refuse_batch("sweep", work.manipulator)
    if work.history:
        _check_history(work)
    known = {name for dimension in work.dimensions for name in (dimension.name, *dimension.numbers)}
    if work.base_tension is not None and "base_tension" in known:
        raise InputError("sweep: base_tension is given and an axis; leave one out")
    for name in work.outputs:
        if name not in work.known_outputs:
            of = " of a history" if work.history else " in space" if work.case.in_space else ""
            raise InputError(f"sweep: {name!r} is not an output{of}; there are {', '.join(work.known_outputs)}")
        if name in known:
            raise InputError(f"sweep: {name!r} is an axis and an output; take it out of the outputs")
    case, swept = work.case, {name for dimension in work.dimensions for name in dimension.numbers}
    _check_effects(swept, case)
    if case.base_tension is None and "base_tension" not in swept:
        raise InputError("sweep: base_tension is neither given nor an axis; give one of the two")
    for name in work.sensitivities:
        if stem_and_tendon(name)[0] == "direction":
            raise InputError(f"sweep: nothing can be differentiated by {name!r}; take it out of the sensitivities")
        if case.number(name) is None and name not in swept:
            raise InputError(f"sweep: the case has no {name!r} to differentiate by; give it a value")
        if wider := [other for other in swept if holds(other, name) or holds(name, other)]:
            raise InputError(f"sweep: {name!r} and the axis {wider[0]!r} overlap; differentiate by {wider[0]!r} itself")


def _check_effects(swept: set[str], case: Case) -> None:
    """Refuse numbers that have no effect, only because another one is given or missing."""
    body, loads = case.manipulator, case.loads
    for name in ("friction_coefficient", "drag"):
        if name in swept and all(getattr(tendon, name) is not None for tendon in body.tendons):
            raise InputError(f"sweep: {name!r} has no effect here; let 'tendons.0.{name}' vary, as each has its own")
    gravity = any(name.startswith("loads.gravity.") for name in swept)
    masses = [name for name in swept if name.split(".")[0] in ("density", "mass_per_length", "point_masses")]
    if masses and not gravity and (loads is None or not np.any(np.asarray(loads.gravity))):
        raise InputError(f"sweep: {min(masses)!r} has no effect here; give loads=Loads(gravity=(0.0, -9.81))")
    if not masses:
        check_loads(body, Loads(gravity=(0.0, 1.0)) if gravity else loads)
