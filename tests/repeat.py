"""A fit repeated from nothing but its results.json and the shipped tables."""

from places import DATA

import cddf_jax as cddf
from cddf_jax.estimation.observations import Noise
from cddf_jax.estimation.parameter_space import Prior


def repeated(results, folder):
    """The fit that the results describe; `folder` takes the manipulator's file."""
    robot = folder / "again.toml"
    robot.write_text(results["manipulator"], encoding="utf-8")
    tables = [cddf.read_measurements(DATA / table["name"]) for table in results["data"]]
    assert [table.checksum for table in tables] == [table["sha256"] for table in results["data"]]
    options = dict(results["options"])
    options["noise"] = {k: Noise(**v) if isinstance(v, dict) else v for k, v in options["noise"].items()}
    options["priors"] = {k: Prior(**v) for k, v in options["priors"].items()}
    setting = options["setting"]
    loads = None if setting["loads"] is None else cddf.Loads(**setting["loads"])
    markers = {name: cddf.Marker(**marker) for name, marker in setting["markers"].items()}
    options["setting"] = cddf.BenchSetting(loads, markers, setting["given"])
    return cddf.fit(cddf.read_manipulator(robot), tables, **options)
