"""How often 95 % intervals from displacements contain the true value: `python benchmarks/driven_coverage.py`.

Tendons on a tube of 140 mm are driven by motors with encoders; what they pull on gives way by 0.02 mm/N. A tracker
sees the tip. Encoders have 0.05 mm of noise, the tracker 0.5 mm; both are given to the fit. There are three benches:

- one tendon, a loop to 10 mm with a smaller one inside, 27 readings;
- a pair, each tendon pulled and released in turn while the other one is held, 24 readings;
- three tendons in space, each pulled and released in turn while the others are held, 24 readings.

Friction coefficient, modulus, compliance and the slack offset of each tendon are fitted. Displacements hold the product
of modulus and compliance only, so that neither may be called identified. Numbers that are too large are called
identified more often. So both shares are counted: of identified quantities, and of all stated intervals. Where a
parameter is not identified, the stated interval has open sides; a product that is not identified counts as held. The
benches are simulated with three times the elements and twice the increments of the fit. The seed is fixed beforehand,
23; bench k is drawn from (23, k).
"""

import argparse
from typing import Any

import numpy as np
from table import report

import cddf_jax as cddf
from cddf_jax.application import configure_jax

SEED = 23
ENCODER, TRACKER = 5e-5, 5e-4  # m
MU, MODULUS, COMPLIANCE, OFFSET = 0.3, 1.4e6, 2e-5, 5e-4  # 1, Pa, m/N, m
PRODUCT = "outside_compliance * youngs_modulus"
UNKNOWN = ("youngs_modulus", "outside_compliance")
ONE = [0, 2, 4, 6, 8, 10, 8, 6, 4, 2, 4, 6, 8, 6, 4, 2, 4, 6, 8, 10, 12, 10, 8, 6, 4, 2, 0.5]  # mm
PULL = [3, 5, 7, 9, 7, 5, 3, 2]  # mm, of one of several tendons
HELD = 2.0  # mm, of the others


def path_of(tendons: int) -> np.ndarray:
    """(rows, tendons), how far each tendon is pulled in, m."""
    if tendons == 1:
        return 1e-3 * np.array(ONE)[:, None]
    rows = np.full((24, tendons), HELD)
    for part in range(24 // len(PULL)):
        rows[part * len(PULL) :][: len(PULL), part % tendons] = PULL
    return 1e-3 * rows


def body_of(tendons: int, mu: float, modulus: float, compliance: float) -> cddf.Manipulator:
    """A tube with tendons spread evenly about its axis."""
    if tendons == 3:
        own = [cddf.Tendon(0.009, angle=2 * np.pi * k / 3, outside_compliance=compliance) for k in range(3)]
    else:
        own = [cddf.Tendon(0.009, side, outside_compliance=compliance) for side in (1, -1)[:tendons]]
    return cddf.Manipulator(
        length=0.14,
        outer_radius=0.012,
        inner_radius=0.007,
        youngs_modulus=modulus,
        friction_coefficient=mu,
        tendons=own,
    )


def bench(tendons: int, rng: np.random.Generator) -> cddf.Measurements:
    """One simulated table."""
    path, ends = path_of(tendons), ("", "_2", "_3")[:tendons]
    pulls = [cddf.Displacement(own) for own in path.T]
    history = cddf.trace(
        body_of(tendons, MU, MODULUS, COMPLIANCE), pulls, nodes=32, short_steps=8, estimate_error=False, throw=False
    )
    tip = np.asarray(history.tip_position) + TRACKER * rng.normal(size=history.tip_position.shape)
    read = path + OFFSET + ENCODER * rng.normal(size=path.shape)
    columns = {f"displacement{end}": read[:, i] for i, end in enumerate(ends)}
    columns |= {f"tip_{axis}": own for axis, own in zip("xyz", tip.T, strict=False)} | {"step": np.arange(len(path))}
    return cddf.Measurements.from_columns("driven", ("simulated",), **columns)


def coverage(tendons: int, numbers: range) -> dict[str, Any]:
    """How many intervals hold the truth."""
    offsets = [f"slack_offset_{k}" for k in range(1, tendons + 1)]
    truth = {"friction_coefficient": MU, **dict.fromkeys(offsets, OFFSET), PRODUCT: MODULUS * COMPLIANCE}
    held: dict[str, list[bool]] = {name: [] for name in truth}  # of identified quantities
    stated = dict.fromkeys(truth, 0)  # how many intervals of all fits hold
    failed, wrong = 0, 0
    for k in numbers:
        table = bench(tendons, np.random.default_rng((SEED, k)))
        noise = {"displacement": ENCODER} | {c: TRACKER for c in table.columns if c.startswith("tip")}
        free = ("friction_coefficient", *UNKNOWN, *offsets)
        fit = cddf.fit(body_of(tendons, 0.2, 1e6, 1e-5), table, free, noise=noise)
        if not fit.success:
            failed += 1
            print(f"bench {k}: {fit.result}", flush=True)
            continue
        wrong += any(fit.status[name] == "identified" for name in UNKNOWN)
        ends = fit.confidence_interval | {name: one.confidence_interval for name, one in fit.combinations.items()}
        ends = {name: ends.get(name, (-np.inf, np.inf)) for name in truth}
        inside = {name: low <= truth[name] <= high for name, (low, high) in ends.items()}
        known = [name for name in truth if fit.status.get(name) == "identified" or name in fit.combinations]
        for name in truth:
            stated[name] += inside[name]
            held[name] += [inside[name]] * (name in known)
        lost, known_ones = (", ".join(own) or "none" for own in ([n for n in truth if not inside[n]], known))
        mu, (low, high) = fit.value["friction_coefficient"], ends["friction_coefficient"]
        print(f"bench {k}: mu {mu:.3f} ({low:.3f} to {high:.3f}), identified: {known_ones}; missed: {lost}", flush=True)
    rows = {"fits": len(numbers) - failed}
    shares = {
        name: {"identified": len(own), "hold": sum(own), "stated hold": stated[name]} | rows
        for name, own in held.items()
    }
    return {"tendons": tendons, "benches": len(numbers), "failed": failed, "wrongly identified": wrong} | shares


def share_of(held: int, count: int) -> str:
    """A share and its standard error, per cent."""
    share = held / max(count, 1)
    return f"{100 * share:.1f} ± {100 * np.sqrt(share * (1 - share) / max(count, 1)):.1f} % of {count}"


def markdown(rows: list[dict[str, Any]]) -> str:
    """A line for each bench; a cell has the shares that hold the truth, of the identified ones and of all fits."""
    lines = [
        "| tendons | benches | failed | modulus or compliance identified | friction | slack offsets | E C |",
        "| ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        groups = [["friction_coefficient"], [name for name in row if name.startswith("slack")], [PRODUCT]]
        cells = []
        for group in groups:
            pairs = (("hold", "identified"), ("stated hold", "fits"))
            shares = (share_of(*(sum(row[name][what] for name in group) for what in pair)) for pair in pairs)
            cells.append("; ".join(shares))
        first = (row["tendons"], row["benches"], row["failed"], row["wrongly identified"])
        lines.append(f"| {' | '.join(map(str, first))} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate, print and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tendons", type=int, nargs="*", default=[1, 2, 3])
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the number of the first one")
    asked = parser.parse_args()
    configure_jax()
    rows = [coverage(tendons, range(asked.first, asked.first + asked.benches)) for tendons in asked.tendons]
    report("driven_coverage", markdown(rows), {"seed": SEED, "results": rows})


if __name__ == "__main__":
    main()
