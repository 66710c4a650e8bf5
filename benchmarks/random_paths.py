"""How many random paths of several tendons settle, in the plane and in space, with loads and without.

Each path has 12 steps. Of the tensions, up to 50 N, four of ten stay from step to step and one of seven is 0 N.
Friction is 0.1 to 0.6. Without an argument all kinds of bodies are followed; `python random_paths.py space 3 loaded 64`
is one kind with its number of paths, and further numbers are those of paths that are followed alone, from 0.

Where a step does not settle, it is followed again in 16 parts, each with as many increments as the step had; and with
tendons that stretch by 1e-4 under 10 N, of which no tension is open. Some of their states within the step are judged by
`tangent.py`, which shares nothing with the library: how many directions of tensions or of the shape would be open if
the tendons did not stretch, and how far a small moment changes the shape, against the body without tendons. If these
tendons do not settle either, the last state that settled is judged. States of the first paths that settled are judged
for comparison.
"""

import sys
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
import tangent

import cddf_jax as cddf

jax.config.update("jax_enable_x64", True)
LENGTH, STEPS, PATHS, LARGEST, PARTS, JUDGED = 0.14, 12, 64, 50.0, 16, 3
STRETCH = 1e5  # N
AS_FOLLOWED = {"nodes": 8, "short_steps": 8, "throw": False}
ELEMENTS = 4 * 8  # of `trace` with these nodes


def robot(in_space: bool, count: int) -> cddf.Manipulator:
    """A tapered body; every second tendon is slanted, and in space every third winds by one radian."""
    tendons = []
    for i in range(count):
        offset = cddf.Linear(0.010, 0.008, LENGTH) if i % 2 else 0.009 + (0.0 if in_space else 0.0005 * i)
        start = 2 * np.pi * i / count
        angle = cddf.Linear(start, start + (1.0 if i % 3 == 0 else 0.0), LENGTH) if in_space else None
        tendons.append(cddf.Tendon(offset, side=-1 if i % 2 and not in_space else 1, angle=angle))
    return cddf.Manipulator(
        length=LENGTH,
        outer_radius=cddf.Linear(0.012, 0.010, LENGTH),
        inner_radius=0.004,
        youngs_modulus=1.4e6,
        friction_coefficient=0.3,
        tendons=tuple(tendons),
    )


def plain(in_space: bool, count: int, friction: float) -> tangent.Body:
    """The same body in plain functions."""

    def tendon(i: int):
        def route(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            offset = 0.010 - 0.002 * s / LENGTH if i % 2 else 0.009 + (0.0 if in_space else 0.0005 * i) + 0 * s
            if not in_space:
                return offset, np.pi * (i % 2) + 0 * s
            return offset, 2 * np.pi * i / count + (1.0 if i % 3 == 0 else 0.0) * s / LENGTH

        return route

    def stiffness(s: np.ndarray) -> np.ndarray:
        return 1.4e6 * np.pi / 4 * ((0.012 - 0.002 * s / LENGTH) ** 4 - 0.004**4)

    return tangent.Body(LENGTH, stiffness, 2 / 3, tuple(map(tendon, range(count))), friction, in_space)


class Way(NamedTuple):
    """A random path."""

    friction: float
    pulls: np.ndarray  # (steps, tendons), N
    force: np.ndarray  # (steps, components), on the tip, N


def ways(in_space: bool, count: int, loaded: bool, paths: int) -> Iterator[Way]:
    """The random paths of one kind; with or without loads the tensions are the same."""
    rng = np.random.default_rng(count)
    for _ in range(paths):
        pulls = rng.uniform(0.0, LARGEST, (STEPS, count)) * (rng.random((STEPS, count)) > 1 / 7)
        for step in range(1, STEPS):
            pulls[step] = np.where(rng.random(count) < 0.4, pulls[step - 1], pulls[step])
        force = 0.4 * rng.normal(size=(STEPS, 3 if in_space else 2))
        yield Way(rng.uniform(0.1, 0.6), pulls, force * loaded)


class Kind:
    """Bodies of one kind, and the program that follows their paths."""

    def __init__(self, in_space: bool, count: int, loaded: bool):
        self.in_space, self.count, self.loaded = in_space, count, loaded
        body, stretch = robot(in_space, count), [np.asarray(STRETCH)] * count
        stretching = eqx.tree_at(
            lambda b: [t.axial_stiffness for t in b.tendons], body, stretch, is_leaf=lambda x: x is None
        )

        def followed(body: cddf.Manipulator, way: Way) -> cddf.History:
            here = eqx.tree_at(lambda b: b.friction_coefficient, body, way.friction)
            loads = cddf.Loads(tip_force=way.force) if loaded else None
            return cddf.trace(here, way.pulls, loads, **AS_FOLLOWED)

        self.followed = jax.jit(partial(followed, body))
        self.stretching = jax.jit(partial(followed, stretching))

    @property
    def words(self) -> str:
        where, loads = "space" if self.in_space else "plane", "a force" if self.loaded else "no loads"
        return f"{where}, {self.count} tendons, {loads}"

    def judged(self, way: Way, history: cddf.History, step: int) -> tangent.Determined:
        """The state after a step."""
        s = np.linspace(0.0, LENGTH, ELEMENTS + 1)
        fields, none = history.at(s), np.zeros(ELEMENTS + 1)
        bent, slides = np.asarray(fields.curvature)[step], np.asarray(history.sliding((s[1:] + s[:-1]) / 2))[step]
        strain = bent if self.in_space else np.stack([none, none, bent], axis=1)
        tension = np.asarray(fields.tension)[step].reshape(self.count, -1).T
        force = np.pad(way.force[step], (0, 3 - way.force.shape[1]))
        return plain(self.in_space, self.count, way.friction).determined(
            tension, strain, slides.reshape(self.count, -1).T, force
        )

    def explained(self, way: Way, step: int) -> str:
        """In words: how a step that did not settle goes in parts, and whether states within it are determined."""
        parts = np.arange(1, PARTS + 1)[:, None] / PARTS

        def divided(values: np.ndarray) -> np.ndarray:
            before = np.concatenate([np.zeros((1, values.shape[1])), values])[: step + 1]
            path = np.concatenate([before[1:], before[-1] + parts * (values[step] - before[-1])])
            return np.pad(path, ((0, STEPS + PARTS - len(path)), (0, 0)), mode="edge")

        fine = Way(way.friction, divided(way.pulls), divided(way.force))
        both = self.followed(fine), self.stretching(fine)
        settled = [int(np.sum(np.isfinite(np.asarray(each.tip_angle)[: step + PARTS]))) for each in both]
        states = [(both[0], settled[0] - 1)]
        if settled[1] == step + PARTS:
            states = [(both[1], step + part) for part in range(0, PARTS, 3)]
        done = " and ".join(str(max(each - step, 0)) for each in settled)
        words = f"{done} of {PARTS} parts settle, the second with tendons that stretch"
        if min(at for _, at in states) < 0:
            return words
        worst = tangent.Determined(*map(max, zip(*(self.judged(fine, *state) for state in states), strict=True)))
        return f"{words}; {in_words(worst)}"


def in_words(told: tangent.Determined) -> str:
    return (
        f"up to {told.open_tensions} directions of tensions and {told.open_shapes} of the shape are open, a moment "
        f"bends up to {told.compliance:.2f} times as far (moments missing: {told.missing:.0e})"
    )


def study(kind: Kind, paths: int, alone: list[int]) -> None:
    """Follow the paths of a kind, and explain those that do not settle."""
    good = inaccurate = judged = 0
    opened, bent = [], []
    for number, way in enumerate(ways(kind.in_space, kind.count, kind.loaded, paths)):
        if alone and number not in alone:
            continue
        history = kind.followed(way)
        status = np.asarray(history.status)
        failed = status == cddf.Status.not_converged
        inaccurate += int(np.sum(status == cddf.Status.inaccurate))
        if np.any(failed):
            step = int(np.argmax(failed))
            print(f"path {number}, step {step}: {kind.explained(way, step)}", flush=True)
            continue
        good += 1
        if judged < JUDGED:
            judged += 1
            told = [kind.judged(way, history, step) for step in range(STEPS)]
            opened += [one.open_tensions > 0 for one in told]
            bent += [one.compliance for one in told]
    count = len(alone) or paths
    print(f"| {kind.words} | {good} of {count} | {inaccurate} of {count * STEPS} |", flush=True)
    if bent:
        print(
            f"of {len(bent)} states of paths that settled {sum(opened)} leave tensions open; a moment bends "
            f"{min(bent):.2f} to {max(bent):.2f} times as far",
            flush=True,
        )


if __name__ == "__main__":
    kinds = [(space, count, load) for space in (False, True) for count in (1, 2, 3, 4) for load in (False, True)]
    paths = PATHS
    if sys.argv[1:]:
        kinds, paths = [(sys.argv[1] == "space", int(sys.argv[2]), sys.argv[3] == "loaded")], int(sys.argv[4])
    for kind in kinds:
        study(Kind(*kind), paths, [int(number) for number in sys.argv[5:]])
