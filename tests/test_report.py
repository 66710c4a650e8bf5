"""A fit as people read it: in words first, no number for what was not determined, JSON without infinities."""

import json
import re
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from bodies import paper_body
from matplotlib.image import imread

import cddf_jax as cddf
from cddf_jax import artifacts, plotting, report
from cddf_jax.measurements import Measurements

DATA = Path(__file__).resolve().parents[1] / "data"
RATIO = "friction_coefficient / youngs_modulus"
BOTH = ("friction_coefficient", "youngs_modulus")


@pytest.fixture(scope="module")
def paper():
    return cddf.read_manipulator(DATA / "smooth_sil_940.toml")


@pytest.fixture(scope="module")
def load_cells():
    return cddf.read_measurements(DATA / "load_cells_simulated.csv")


@pytest.fixture(scope="module")
def pulley():
    return cddf.read_measurements(DATA / "pulley_simulated.csv")


@pytest.fixture(scope="module")
def tensions_only(paper, load_cells):
    return cddf.fit(paper, load_cells)


@pytest.fixture(scope="module")
def paper_route(paper, pulley, load_cells):
    return cddf.fit(paper, (pulley, load_cells))


@pytest.fixture(scope="module")
def with_prior(paper, pulley):
    """The pulley with a prior on the modulus, of which it says nothing, and declared noise."""
    return cddf.fit(paper, pulley, priors={"youngs_modulus": (1.4e6, 1e5)}, noise={"pulling_tension": 0.3})


def row_of(markdown, name):
    """The cells of a parameter's row."""
    (line,) = [line for line in markdown.splitlines() if line.startswith(f"| {name} |")]
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


# --- the report in words -------------------------------------------------------------------------


def test_words_come_first(tensions_only):
    lines = report.as_markdown(tensions_only).splitlines()
    assert lines[0].startswith("# ")
    bullets = [line for line in lines[2:] if line][: len(tensions_only.verdict)]
    assert bullets == [f"- {line}" for line in tensions_only.verdict]
    first_table = next(i for i, line in enumerate(lines) if line.startswith("|"))
    assert first_table > lines.index(bullets[-1])


def test_what_is_not_identified_has_no_number(tensions_only):
    markdown = report.as_markdown(tensions_only)
    for name in BOTH:
        assert row_of(markdown, name) == ["-", "-", "-", "not identified"]
        alone = [part for line in markdown.splitlines() for part in re.split(r"[;|]", line) if RATIO not in part]
        assert not any(re.search(rf"{name} *= *[\d.]", part) for part in alone)
    for value in tensions_only.value.values():  # wherever the optimiser ended along the valley
        assert not re.search(rf"(?<![\d.]){re.escape(f'{value:.4g}')}(?!\d)", markdown)
        assert f"{value / 1e6:.4g} MPa" not in markdown


def test_the_combination_has_its_row(tensions_only):
    value, error, interval, status = row_of(report.as_markdown(tensions_only), RATIO)
    estimate = tensions_only.combinations[RATIO]
    assert value == f"{estimate.value:.5g} (SI)"
    assert float(error) == pytest.approx(estimate.standard_error, rel=0.05)  # two digits
    assert (interval, status) == ("-", "identified")


def test_identified_parameters_carry_units(paper_route):
    markdown = report.as_markdown(paper_route)
    value, _, interval, status = row_of(markdown, "youngs_modulus")
    number, unit = value.split()
    assert float(number) == pytest.approx(paper_route.value["youngs_modulus"] / 1e6, rel=1e-4)
    assert (unit, status) == ("MPa", "identified")
    low, high = (float(limit) for limit in interval.split(" to "))
    assert low < 1.4 < high  # data/README.md: the truth
    assert row_of(markdown, "friction_coefficient")[3] == "identified"


def test_each_table_alone_is_reported(paper_route):
    markdown = report.as_markdown(paper_route)
    section = markdown[markdown.index("alone would have told") :]
    assert "- pulley_simulated.csv: friction_coefficient identified; youngs_modulus not identified" in section
    assert f"{RATIO} = 3." in section


def test_simulated_data_are_called_so(tensions_only, paper_route):
    assert "The data are simulated: load_cells_simulated.csv." in report.as_markdown(tensions_only)
    both = "The data are simulated: pulley_simulated.csv, load_cells_simulated.csv."
    assert both in report.as_markdown(paper_route)


def test_where_the_noise_comes_from(tensions_only, with_prior):
    assert "Noise estimated from the residuals; 101 degrees of freedom; rank 1" in report.as_markdown(tensions_only)
    assert "Noise as given" in report.as_markdown(with_prior)
    assert "| pulley_simulated.csv: pulling_tension | 0.3 |" in report.as_markdown(with_prior)


def test_prior_only_is_said(with_prior):
    assert row_of(report.as_markdown(with_prior), "youngs_modulus")[3] == "prior only"


def test_warnings_have_their_section(paper):
    one = Measurements.from_columns("drum", weight=[5.0], wrap_angle=[1.0], pulling_tension=[8.0])
    fit = cddf.fit(paper, one, noise={"pulling_tension": 0.1})
    assert "## Warnings\n\n- drum: there is one row only" in report.as_markdown(fit)
    assert "simulated" not in report.as_markdown(fit)


# --- the dictionary ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["tensions_only", "paper_route", "with_prior"])
def test_json_has_no_infinities(name, request):
    text = artifacts.as_json(report.as_dict(request.getfixturevalue(name)))

    def refuse(constant):
        raise AssertionError(constant)

    json.loads(text, parse_constant=refuse)


def test_what_is_infinite_is_null(tensions_only):
    answer = json.loads(artifacts.as_json(report.as_dict(tensions_only)))
    assert answer["standard_error"] == dict.fromkeys(BOTH)
    assert answer["confidence_interval"] == {name: [0.0, None] for name in BOTH}
    assert answer["condition_number"] is None
    assert answer["status"] == dict.fromkeys(BOTH, "not identified")
    assert answer["combinations"][RATIO]["value"] == tensions_only.combinations[RATIO].value
    assert answer["combinations"][RATIO]["standard_error"] == tensions_only.combinations[RATIO].standard_error


def test_the_dictionary_holds_the_fit(paper_route):
    answer = json.loads(artifacts.as_json(report.as_dict(paper_route)))
    assert answer["value"] == paper_route.value
    assert answer["standard_error"] == paper_route.standard_error
    assert answer["verdict"] == list(paper_route.verdict)
    assert answer["alone"]["pulley_simulated.csv"]["status"]["youngs_modulus"] == "not identified"
    assert (answer["rank"], answer["success"], answer["result"]) == (2, True, "successful")
    assert answer["data"] == [
        {"name": "pulley_simulated.csv", "rows": 30, "simulated": True},
        {"name": "load_cells_simulated.csv", "rows": 102, "simulated": True},
    ]
    assert (answer["kinematics"], answer["version"]) == ("published", cddf.__version__)
    np.testing.assert_allclose(np.diag(answer["correlation"]), 1.0)


# --- figures -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def figures(paper_route):
    before = plt.get_fignums()
    made = report.fit_figures(paper_route)
    assert plt.get_fignums() == before  # nothing left open
    return made


def test_one_figure_per_table(figures):
    assert list(figures) == ["fit_pulley_simulated", "fit_load_cells_simulated"]
    for figure in figures.values():
        assert len(figure.axes) == 2  # data and model above, residuals below
    above, below = figures["fit_load_cells_simulated"].axes
    labels = [above.get_ylabel().lower(), below.get_ylabel().lower(), below.get_xlabel().lower()]
    for label, quantity in zip(labels, ("tip tension", "residual", "base tension"), strict=True):
        assert label.startswith(quantity)
        assert re.search(r"\bn\b", label)  # the unit


def test_figures_are_drawn(figures, tmp_path):
    for name, figure in figures.items():
        files = plotting.render(figure, name)
        assert set(files) == {f"{name}.pdf", f"{name}.png"}
        artifacts.write_all(tmp_path, files)
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF-")
        assert np.ptp(imread(tmp_path / f"{name}.png")) > 0.5  # something is on it


def test_the_curve_is_the_model(figures, paper_route):
    """The line of the load cells' panel against the closed form at the estimate, design.md section 3."""
    above = figures["fit_load_cells_simulated"].axes[0]
    mu, modulus = (paper_route.value[name] for name in BOTH)
    drawn = [line.get_xydata() for line in above.get_lines() if len(line.get_xydata()) == 100]
    assert drawn
    base, tip = np.asarray(drawn[0]).T
    np.testing.assert_allclose(tip, base / (1 + mu / modulus * base * 2.942783188998e4), rtol=1e-8)


def test_the_figure_of_a_single_level(paper):
    """Three readings of one weight and one wrap: a column of points, no warning from the axes."""
    table = Measurements.from_columns("drum", weight=[5.0] * 3, wrap_angle=[1.0] * 3, pulling_tension=[7.9, 8.0, 8.1])
    fit = cddf.fit(paper, table)
    (figure,) = report.fit_figures(fit).values()
    assert imread(BytesIO(plotting.render(figure, "drum")["drum.png"])).size > 0


def test_the_figure_of_one_base_tension(paper):
    table = Measurements.from_columns("bench", base_tension=[50.0] * 17, tip_tension=34.7 + 0.1 * np.sin(np.arange(17)))
    (figure,) = report.fit_figures(cddf.fit(paper, table)).values()
    assert imread(BytesIO(plotting.render(figure, "bench")["bench.png"])).size > 0


def test_a_failed_fit_still_has_a_report():
    """A tendon that slides out at 200 N locks (mu T G / E = 1.8 > 1): the model gives no number at the start."""
    table = Measurements.from_columns(
        "bench", base_tension=np.full(17, 200.0), tip_tension=np.linspace(300, 310, 17), direction=-np.ones(17)
    )
    fit = cddf.fit(paper_body(), table)
    assert not fit.success
    assert report.as_markdown(fit).splitlines()[2].startswith("- The fit failed: ")
    json.dumps(artifacts.plain(report.as_dict(fit)), allow_nan=False)
    for name, figure in report.fit_figures(fit).items():
        assert plotting.render(figure, name)
