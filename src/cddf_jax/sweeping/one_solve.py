"""The outputs of a sweep with their dimensions and units, and the function that computes them for one solve."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..history.history import ENERGIES, History
from ..history.trace import trace
from ..quantities import QUANTITIES
from ..robot.loads import Loads
from ..statics.named_numbers import Case, holds
from ..statics.solve import solve
from ..statics.status import Status
from .axes import Dimension

COMPONENTS = ("X", "Y", "Z")  # in the fixed frame; a body in the plane has the first two
AXES = ("x", "y", "z")  # of a cross-section of a body in space
SUCCESSFUL, RESULT = VERDICTS = "successful", "result"

# outputs of an `Equilibrium`, and their dimensions besides those of the sweep
OUTPUTS: dict[str, tuple[str, ...]] = {
    "tip_position": ("component",),
    "tip_angle": (),
    "tip_tension": ("tendon",),
    "tension_loss": ("tendon",),
    "tendon_displacement": ("tendon",),
    "base_tension": ("tendon",),
    "target_miss": ("target",),
    "base_moment": (),
    "load_fraction": (),
    "num_load_steps": (),
    "stable": (),
    "direction": ("tendon",),
    "direction_contradicted": ("tendon",),
    "error_estimate": (),
    "num_iterations": (),
    "peak_strain": (),
    "peak_strain_at": (),
    "arc_length": ("point",),
    "curvature": ("point",),
    "heading": ("point",),
    "position": ("point", "component"),
    "tension": ("tendon", "point"),
    "wrap_angle": ("tendon", "point"),
    "normal_force": ("tendon", "point", "component"),
    "friction_force": ("tendon", "point", "component"),
}
# the same of a body in space: curvature is twist and bending about y and z; columns of frames are axes of the body
IN_SPACE: dict[str, tuple[str, ...]] = {
    **{name: dims for name, dims in OUTPUTS.items() if name != "heading"},
    "base_moment": ("component",),
    "tip_frame": ("component", "axis"),
    "curvature": ("point", "axis"),
    "twist": ("point",),
    "frame": ("point", "component", "axis"),
    "path": ("tendon", "point", "component"),
}
OUTPUTS_OF = {2: OUTPUTS, 3: IN_SPACE}  # by the number of components of a position
# outputs of a `History` by that number, and their dimensions besides those of the sweep
OF_HISTORY: dict[int, dict[str, tuple[str, ...]]] = {
    components: {
        **{name: known[name] for name in ("tip_position", "tip_angle", "tip_tension", "tendon_displacement")},
        **{name: known[name] for name in ("direction", "error_estimate")},
        **{"front": ("tendon",), "num_turns": ()},
        **dict.fromkeys(ENERGIES, ()),
        **{name: dims for name, dims in known.items() if name == "tip_frame"},
        **{name: dims for name, dims in known.items() if "point" in dims},
    }
    for components, known in OUTPUTS_OF.items()
}


def attributes(name: str, by: str = "", unit_by: str = "") -> dict[str, object]:
    """What the dataset says of an output, or of its derivative by the number `by`, which has the unit `unit_by`."""
    if name == SUCCESSFUL:
        return {"long_name": "solved without any doubt"}
    if name == RESULT:
        codes = {"flag_values": [*range(len(Status))], "flag_meanings": " ".join(Status.__members__)}
        return {"long_name": name, **codes}
    unit, meaning = QUANTITIES[name].unit, QUANTITIES[name].words
    if by:
        meaning = f"{meaning}, by {by}"
    if unit and by and unit_by != "1":
        unit += f"/({unit_by})" if " " in unit_by or "/" in unit_by else f"/{unit_by}"
    return {"long_name": meaning, "units": unit} if unit else {"long_name": meaning}


def slope_name(output: str, by: str) -> str:
    """The name of the derivative of an output."""
    return f"{output}_by_{by}"


def coordinates(
    dimensions: tuple[Dimension, ...], units: Mapping[str, str], sizes: Mapping[Any, int]
) -> dict[str, Any]:
    """The coordinates of the dataset, as xarray takes them; `sizes` are those of its dimensions."""
    coords: dict[str, Any] = {}
    for dimension in dimensions:
        for name, values in dimension.numbers.items():
            coords[name] = (dimension.name, values, {"units": units[name]})
    own = {
        "tendon": (np.arange(sizes.get("tendon", 0)), {"long_name": "place among the tendons"}),
        "component": ([*COMPONENTS[: sizes.get("component")]], {}),
        "axis": ([*AXES], {"long_name": "axis of the cross-section"}),
    }
    return coords | {name: (name, *told) for name, told in own.items() if name in sizes}


Numbers = Mapping[str, ArrayLike]


class OneSolve(eqx.Module):
    """The outputs of one solve, and their derivatives, as a function of the numbers that vary.

    With a path the outputs are those of `trace` after each step, step first.
    """

    case: Case
    path: dict[str, Float[Array, " steps"]] | None  # base tensions, N, and loads along it, by name
    outputs: tuple[str, ...] = eqx.field(static=True)
    sensitivities: tuple[str, ...] = eqx.field(static=True)
    nodes: int = eqx.field(static=True)
    short_steps: int = eqx.field(static=True)

    def __call__(self, numbers: Numbers) -> dict[str, Array]:
        if not self.sensitivities:
            return self._answer(numbers)
        by = {name: jnp.asarray(numbers.get(name, self.case.number(name)), float) for name in self.sensitivities}

        def real(by: Numbers) -> tuple[dict[str, Array], dict[str, Array]]:
            outputs = self._answer({**numbers, **by})
            smooth = (name for name, x in outputs.items() if jnp.issubdtype(x.dtype, jnp.floating))
            return {name: outputs[name] for name in smooth if name != "front"}, outputs  # `trace` holds fronts fixed

        slopes, outputs = jax.jacfwd(real, has_aux=True)(by)
        return outputs | {slope_name(name, by): slope for name, of in slopes.items() for by, slope in of.items()}

    def _answer(self, numbers: Numbers) -> dict[str, Array]:
        there = self.case.with_numbers(numbers)
        if self.path is None:
            given = there.manipulator, there.base_tension, there.loads
            found = solve(*given, direction=there.direction, nodes=self.nodes, throw=False)
            outputs = {name: getattr(found, name) for name in self.outputs}
        else:
            given = there.manipulator, *_along(there, self.path)
            found = trace(*given, nodes=self.nodes, short_steps=self.short_steps, throw=False)
            outputs = {name: _after_each_step(found, name) for name in self.outputs}
        return outputs | {SUCCESSFUL: found.status == Status.successful, RESULT: found.status.astype(jnp.int8)}


def _along(case: Case, path: dict[str, Float[Array, " steps"]]) -> tuple[Array, Loads | None]:
    """Base tensions of all tendons, step first, and the loads; those that change are step first as well."""
    count = case.manipulator.num_tendons

    def after_step(numbers: Numbers) -> tuple[Array, Loads | None]:
        there = case.with_numbers(numbers)
        return jnp.broadcast_to(jnp.asarray(there.base_tension), count), there.loads

    def changing(place: tuple, stays: ArrayLike, after_steps: Array) -> ArrayLike:
        load = f"loads.{jax.tree_util.keystr(place, simple=True, separator='.')}"
        return after_steps if any(name == load or holds(load, name) for name in path) else stays

    tension, loads = jax.vmap(after_step)(path)
    return tension, jax.tree_util.tree_map_with_path(changing, case.loads, loads)


def _after_each_step(history: History, name: str) -> Array:
    """An output, step first, then its own dimensions."""
    dims = OF_HISTORY[history.tip_position.shape[-1]][name]
    if "point" in dims:
        return getattr(history.equilibria, name)
    values = getattr(history.energies if name in ENERGIES else history, name)
    return values.reshape(len(values), -1) if dims == ("tendon",) else values
