"""A fit as people read it: in words first, no number for what was not determined, JSON without infinities."""

import dataclasses
import json
import re

import numpy as np
import pytest
from bodies import paper_body
from matplotlib.image import imread
from places import DATA
from read_back import x_of, xy_of
from repeat import repeated
from scipy import stats

import cddf_jax as cddf
from cddf_jax.estimation.observations import Noise
from cddf_jax.figures import fit as fit_figures
from cddf_jax.files import writing
from cddf_jax.identification.bench import Bench
from cddf_jax.measurements.table import Measurements
from cddf_jax.reports import fit_report as report

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


def words_of(fit):
    return report.fit_as_markdown(fit, {})


def row_of(markdown, name):
    """The cells of a parameter's row."""
    line = next(line for line in markdown.splitlines() if line.startswith(f"| {name} |"))
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


# --- the report in words -------------------------------------------------------------------------


def test_words_come_first(tensions_only):
    lines = words_of(tensions_only).splitlines()
    assert lines[0].startswith("# ")
    bullets = [line for line in lines[2:] if line][: len(tensions_only.verdict)]
    assert bullets == [f"- {line}" for line in tensions_only.verdict]
    first_table = next(i for i, line in enumerate(lines) if line.startswith("|"))
    assert first_table > lines.index(bullets[-1])


def test_what_is_not_identified_has_no_number(tensions_only):
    markdown = words_of(tensions_only)
    for name in BOTH:
        assert row_of(markdown, name) == ["-", "-", "-", "not identified"]
        alone = [part for line in markdown.splitlines() for part in re.split(r"[;|]", line) if RATIO not in part]
        assert not any(re.search(rf"{name} *= *[\d.]", part) for part in alone)
    for value in tensions_only.value.values():  # wherever the optimiser ended along the valley
        assert not re.search(rf"(?<![\d.]){re.escape(f'{value:.4g}')}(?!\d)", markdown)
        assert f"{value / 1e6:.4g} MPa" not in markdown


def test_the_combination_has_its_row(tensions_only):
    value, error, interval, status = row_of(words_of(tensions_only), RATIO)
    estimate = tensions_only.combinations[RATIO]
    assert value == f"{estimate.value:.5g} 1/Pa"
    number, unit = error.split()
    assert float(number) == pytest.approx(estimate.standard_error, rel=0.05)  # two digits
    assert unit == "1/Pa"
    low, high = (float(end) for end in interval.removesuffix(" 1/Pa").split(" to "))
    quantile = stats.t.ppf(0.975, len(tensions_only.residuals[next(iter(tensions_only.residuals))]) - 1)
    assert (high - low) / 2 == pytest.approx(
        quantile * estimate.standard_error, rel=0.05
    )  # of one number from one column
    assert status == "identified"


def test_identified_parameters_carry_units(paper_route):
    markdown = words_of(paper_route)
    value, _, interval, status = row_of(markdown, "youngs_modulus")
    number, unit = value.split()
    assert float(number) == pytest.approx(paper_route.value["youngs_modulus"] / 1e6, rel=1e-4)
    assert (unit, status) == ("MPa", "identified")
    assert interval.endswith(" MPa")
    low, high = (float(limit) for limit in interval.removesuffix(" MPa").split(" to "))
    assert low < 1.4 < high  # data/README.md: the truth
    assert row_of(markdown, "friction_coefficient")[3] == "identified"


def test_each_table_alone_is_reported(paper_route):
    markdown = words_of(paper_route)
    section = markdown[markdown.index("## Each table alone determines") :]
    assert "- pulley_simulated.csv: friction_coefficient identified; youngs_modulus not identified" in section
    assert f"{RATIO} = 3." in section


def test_simulated_data_are_called_so(tensions_only, paper_route):
    assert "The data are simulated: load_cells_simulated.csv." in words_of(tensions_only)
    both = "The data are simulated: pulley_simulated.csv, load_cells_simulated.csv."
    assert both in words_of(paper_route)


def test_where_the_noise_comes_from(tensions_only, with_prior):
    assert "Noise estimated from the residuals; 101 degrees of freedom; rank 1" in words_of(tensions_only)
    assert "Noise as given" in words_of(with_prior)
    assert "| pulley_simulated.csv: pulling_tension | 0.3 N | the same for all |" in words_of(with_prior)
    assert row_of(words_of(with_prior), "youngs_modulus")[3] == "prior only"


def test_warnings_have_their_section(paper):
    two = Measurements.from_columns("drum", weight=[5.0, 0.0], wrap_angle=[1.0, 1.0], pulling_tension=[8.0, -0.1])
    fit = cddf.fit(paper, two, noise={"pulling_tension": 0.1})
    assert "## Warnings\n\n- drum: rows with pulling_tension below 0: 1 of 2 (row 2: -0.1 N)" in words_of(fit)
    assert "simulated" not in words_of(fit)


# --- the dictionary ------------------------------------------------------------------------------


def test_what_is_infinite_is_null(tensions_only):
    text = writing.as_json(report.fit_as_dict(tensions_only, {}))
    answer = json.loads(text, parse_constant=lambda constant: pytest.fail(constant))
    assert answer["standard_error"] == dict.fromkeys(BOTH)
    assert answer["confidence_interval"] == {name: [0.0, None] for name in BOTH}
    assert answer["condition_number"] is None
    assert answer["status"] == dict.fromkeys(BOTH, "not identified")
    assert answer["unit"] == {"friction_coefficient": "1", "youngs_modulus": "Pa", RATIO: "1/Pa"}
    assert answer["combinations"][RATIO]["value"] == tensions_only.combinations[RATIO].value
    assert answer["combinations"][RATIO]["standard_error"] == tensions_only.combinations[RATIO].standard_error


# --- figures -------------------------------------------------------------------------------------


def test_the_figure_of_a_single_level(paper):
    """Three readings of one weight and one wrap: a column of points, no warning from the axes."""
    table = Measurements.from_columns("drum", weight=[5.0] * 3, wrap_angle=[1.0] * 3, pulling_tension=[7.9, 8.0, 8.1])
    fit = cddf.fit(paper, table)
    (figure,) = fit_figures.table_figures(fit).values()
    figure.draw_without_rendering()


@pytest.mark.slow
def test_two_tendons_are_drawn_over_their_predictions():
    """Rows of the model itself, with noise; the interval is that of `Fit.band`."""
    pair, pulls = paper_body(num_tendons=2), np.array([[20.0, 5.0], [40.0, 5.0], [60.0, 10.0], [30.0, 8.0]] * 2)
    read = Bench(pulls, (np.ones(8), -np.ones(8))).evaluate(pair, {"friction_coefficient": 0.42}, 16)[0]
    noise = np.random.default_rng(0).normal(0, 0.01, (8, 2))
    columns = {"base_tension": pulls[:, 0], "base_tension_2": pulls[:, 1], "direction_2": -np.ones(8)}
    columns |= {name: read[name] + noise[:, i] for i, name in enumerate(("tip_tension", "tip_tension_2"))}
    fit = cddf.fit(pair, Measurements.from_columns("pair", **columns), "friction_coefficient")
    (figure,) = fit_figures.table_figures(fit).values()
    labels = [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()]
    assert labels == ["Predicted tip tension (N)", "Predicted tip tension 2 (N)"]
    axes = fit_figures.draw_fit(fit, column="tip_tension_2")
    drawn = next(line for line in axes.lines if line.get_marker() == "o")
    predicted = Bench(pulls, (np.ones(8), -np.ones(8))).evaluate(pair, fit.parameters, 16)
    np.testing.assert_allclose(x_of(drawn), predicted.readings["tip_tension_2"], rtol=1e-9)
    (bars,) = (item for item in axes.containers if item.get_label() == "95 % interval of the model")
    reach = [np.ptp(segment[:, 0]) / 2 for segment in bars[2][0].get_segments()]
    np.testing.assert_allclose(reach, fit.band(predicted.derivatives["tip_tension_2"]), rtol=1e-9)


# --- residuals, profiles, correlation --------------------------------------------------


@pytest.fixture(scope="module")
def drum(paper, pulley):
    """The friction alone, from the pulley test: no solve, and a model that stands in one line of NumPy."""
    return cddf.fit(paper, pulley, free=("friction_coefficient",), noise={"pulling_tension": Noise(0.1, 0.01)})


@pytest.fixture(scope="module")
def profiles(drum):
    return report.profiles_of(drum)


def texts(axes):
    return [text.get_text() for text in axes.texts]


def line_of(axes, label):
    return xy_of(next(line for line in axes.get_lines() if line.get_label() == label))


def pulled(table, mu):
    """Liu et al. (2020), eq. (5): pulled up over the drum, T = W exp(mu * wrap)."""
    return table["weight"] * np.exp(mu * table["wrap_angle"])


def test_the_residuals_against_normal_quantiles(drum, pulley):
    residual = pulley["pulling_tension"] - pulled(pulley, drum.value["friction_coefficient"])
    predicted = pulled(pulley, drum.value["friction_coefficient"])
    standardised = residual / np.hypot(0.1, 0.01 * predicted)
    (axes,) = fit_figures.residuals_figure(drum).axes
    quantile, shown = line_of(axes, "data")
    np.testing.assert_allclose(shown, np.sort(standardised), rtol=1e-5, atol=1e-6)
    assert np.corrcoef(quantile, shown)[0, 1] > 0.95
    assert texts(axes) == ["30 residuals"]


def test_the_profile_is_the_sum_of_squares(drum, profiles, pulley):
    """One parameter and noise that is held: the profile is the sum of squares itself."""
    (axes,) = fit_figures.profiles_figure(drum, profiles).axes
    estimate = drum.value["friction_coefficient"]
    noise = np.hypot(0.1, 0.01 * pulled(pulley, estimate))

    def squares(mu):
        return np.sum(((pulley["pulling_tension"] - pulled(pulley, mu)) / noise) ** 2)

    mu, root = line_of(axes, "profile")
    rise = np.array([squares(value) - squares(estimate) for value in mu])
    near = np.abs(mu - estimate) < 0.05
    assert near.sum() > 10
    np.testing.assert_allclose(root[near] ** 2, rise[near], rtol=1e-4, atol=1e-6)
    low, high = profiles["friction_coefficient"].confidence_interval
    assert [squares(end) - squares(estimate) for end in (low, high)] == pytest.approx([1.959964**2] * 2, rel=1e-3)
    assert axes.get_xlim()[0] < low < estimate < high < axes.get_xlim()[1]
    assert "open" not in "".join(texts(axes))
    assert f"| friction_coefficient | {low:.5g} | {high:.5g} |" in report.fit_as_markdown(drum, profiles)


@pytest.mark.slow
def test_an_open_profile_is_seen_to_be_open(tensions_only):
    """Tensions know mu / E only: mu alone costs nothing, two decades up and down."""
    profile = tensions_only.profile("friction_coefficient")
    (axes,) = fit_figures.profiles_figure(tensions_only, {"friction_coefficient": profile}).axes
    assert texts(axes) == ["open", "open"]
    assert axes.get_xscale() == "log"
    mu, root = line_of(axes, "profile")
    low, high = axes.get_xlim()
    assert high / low > 1e3
    assert np.max(root[(mu >= low) & (mu <= high)]) < 0.05
    assert "estimate" not in axes.get_legend_handles_labels()[1]  # there is none


def test_what_cannot_be_drawn_is_said(drum):
    """A failed search at a place where the model gives no numbers, made up."""
    lost = {label: np.full(values.shape, np.nan) for label, values in drum.residuals.items()}
    failed = dataclasses.replace(drum, success=False, result="made up", residuals=lost)
    drawn, said = report.report_figures(failed, {})
    assert drawn == {}
    assert said["pulley_simulated.csv"] == "the model gave no numbers for pulling_tension in 30 of 30 rows"
    assert said["profiles"] == "the fit failed: made up"


# --- what a fit hangs on, and how to repeat it ------------------------------------------------------


def test_the_first_lines_name_a_bound(paper, pulley):
    """The pulley says 0.42: held below 0.3, the parameter ends there, and the report begins with it."""
    start = dataclasses.replace(paper, friction_coefficient=0.2)
    fit = cddf.fit(start, pulley, free=("friction_coefficient",), bounds={"friction_coefficient": (0.0, 0.3)})
    head = words_of(fit).partition("| parameter")[0]
    assert "- friction_coefficient = 0.3: at bound" in head


def test_the_first_lines_name_the_one_point(paper):
    """Wraps of 10 degrees hardly speak of friction beside one of 180."""
    wrap = np.radians([10.0] * 5 + [180.0])
    table = Measurements.from_columns(
        "drum", weight=[5.0] * 6, wrap_angle=wrap, pulling_tension=5.0 * np.exp(0.42 * wrap)
    )
    fit = cddf.fit(paper, table, free=("friction_coefficient",), noise={"pulling_tension": 0.1})
    head = words_of(fit).partition("| parameter")[0]
    assert "- friction_coefficient depends on one datum, row 6 of drum: pulling_tension" in head


def test_the_files_of_a_report(drum, profiles, tmp_path):
    cddf.write_fit(drum, tmp_path)
    written = {path.name for path in tmp_path.iterdir()}
    figures = {f"{name}.{suffix}" for name in report.report_figures(drum, profiles)[0] for suffix in ("pdf", "png")}
    assert written == {"report.md", "results.json", *figures}
    named = re.findall(r"!\[.*\]\((.*)\)", (tmp_path / "report.md").read_text())
    assert set(named) == {name for name in figures if name.endswith("png")}
    assert all(np.ptp(imread(tmp_path / name)) > 0.5 for name in named)  # something is drawn


def test_a_fit_is_repeated_from_its_results(drum, profiles, tmp_path):
    results = json.loads(writing.as_json(report.fit_as_dict(drum, profiles)))
    packages = {"cddf-jax", "jax", "jaxlib", "numpy", "scipy", "optimistix", "equinox"}
    assert set(results["versions"]) == {"python", *packages}
    again = repeated(results, tmp_path)
    assert again.value == pytest.approx(drum.value, rel=1e-12)
    assert again.standard_error == pytest.approx(drum.standard_error, rel=1e-9)
    rise = results["profiles"]["friction_coefficient"]["rise"]
    assert again.profile("friction_coefficient").rise == pytest.approx(rise, rel=1e-6, abs=1e-9)
