"""Which measurement next: expected errors against fits of simulated data, and the cases of docs/identifiability.md."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import paper_body, three_tendon_tube
from test_displacement import robot
from test_fit import COMPLIANCE, MU, RATIO, E, closed_form, wrap

import cddf_jax as cddf
from cddf_jax.errors import InputError
from cddf_jax.identification.experiment_design import BEFOREHAND, Candidate
from cddf_jax.measurements.table import Measurements

LEVELS = 85.0 * np.arange(1, 7) / 6
TENSIONS = Candidate("tensions", {"base_tension": LEVELS}, {"tip_tension": 1.0})
PULLEY = Candidate("pulley", {"wrap_angle": [1.0, 2.0, 3.0], "weight": 10.0}, {"pulling_tension": 0.5})
ANGLES = Candidate("angles", {"base_tension": LEVELS}, {"tip_angle": np.radians(1.0)})
POSITIONS = Candidate("positions", {"base_tension": LEVELS}, {"tip_tension": 1.0, "tip_x": 1e-3, "tip_y": 1e-3})
WEIGHT = Candidate("weight", {"base_tension": LEVELS, "tip_force_y": 1.0}, {"tip_tension": 1.0})


def tensions_by_hand():
    """d(T_tip)/d(ln mu, ln E) of T / (1 + mu T G / E), over 1 N."""
    tip = closed_form(LEVELS)
    along = tip**2 * MU * COMPLIANCE / E
    return np.stack([-along, along], axis=1)


@pytest.fixture(scope="module")
def planned():
    return cddf.plan(paper_body("exact"), [TENSIONS, PULLEY, ANGLES, POSITIONS], num=2)


def ranked(plan, name):
    return next(r for r in plan.ranking if r.candidate.name == name)


def test_the_best_is_first(planned):
    """Tensions leave both parameters open."""
    gains = [ranked.gain for ranked in planned.ranking]
    assert gains == sorted(gains, reverse=True)
    assert np.isinf([*ranked(planned, "tensions").expected.standard_error.values()]).all()
    assert str(planned).splitlines()[1].startswith(planned.ranking[0].candidate.name)


def test_tensions_determine_only_the_ratio(planned):
    told = ranked(planned, "tensions").expected
    assert set(told.status.values()) == {"not identified"}
    information = tensions_by_hand().T @ tensions_by_hand()
    expected = MU / E / np.sqrt(information[0, 0])  # of ln(mu/E), with the other direction unknown
    assert told.combinations[RATIO].standard_error == pytest.approx(expected, rel=1e-4)
    # ln det with the guess beforehand: one direction grows by twice the information, the other not at all
    gain = np.log1p(2 * information[0, 0] * BEFOREHAND**2)
    assert ranked(planned, "tensions").gain == pytest.approx(gain, rel=1e-6)


def test_a_pulley_test_determines_only_the_friction(planned):
    told = ranked(planned, "pulley").expected
    wraps = np.array([1.0, 2.0, 3.0])
    expected = 0.5 / np.sqrt(np.sum((10.0 * wraps * np.exp(MU * wraps)) ** 2))
    assert told.standard_error["friction_coefficient"] == pytest.approx(expected, rel=1e-9)
    assert told.status == {"friction_coefficient": "identified", "youngs_modulus": "not identified"}


def test_positions_determine_both(planned):
    """docs/identifiability.md: with 1 mm and 1 N over 6 levels mu to about 3 %, E to about 1 %."""
    told = ranked(planned, "positions").expected
    assert told.standard_error["friction_coefficient"] / MU == pytest.approx(0.03, abs=0.005)
    assert told.standard_error["youngs_modulus"] / E == pytest.approx(0.01, abs=0.002)


@pytest.mark.slow
def test_a_tip_weight_hardly_helps():
    """docs/identifiability.md: singular values 320 to 470 apart, standard errors of 5 to 7 in the logarithm at 1 N."""
    told = cddf.plan(paper_body("exact"), [WEIGHT]).ranking[0].expected
    assert set(told.status.values()) == {"not identified"}
    assert 320 < told.condition_number < 470
    assert 5 < np.sqrt(told.covariance[0, 0]) / MU < 7


@pytest.mark.slow
def test_a_weight_on_the_body():
    """The errors of ln mu and ln E from differences of `solve` with the weight as a point load."""
    body, loads = paper_body("exact"), cddf.Loads(points=[cddf.PointLoad(0.06, (0.0, -1.0))])
    hung = Candidate("hung", {"base_tension": LEVELS, "force_y@60mm": -1.0}, {"tip_angle": 0.01})
    told = cddf.plan(body, [hung], num=1).ranking[0].expected

    def angles(mu, modulus):
        here = replace(body, friction_coefficient=mu, youngs_modulus=modulus)
        return np.array([float(cddf.solve(here, pull, loads).tip_angle) for pull in LEVELS])

    h = 1e-4
    pairs = ((angles(MU * (1 + h), E), angles(MU * (1 - h), E)), (angles(MU, E * (1 + h)), angles(MU, E * (1 - h))))
    slopes = np.stack([(more - less) / (2 * h) for more, less in pairs], axis=1)
    errors = 0.01 * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    found = [told.standard_error["friction_coefficient"] / MU, told.standard_error["youngs_modulus"] / E]
    np.testing.assert_allclose(found, errors, rtol=1e-3)
    with pytest.raises(InputError, match="candidate 'hung': force @160mm: it must act above 0 and up to the tip at"):
        cddf.plan(body, [replace(hung, conditions={"base_tension": LEVELS, "force_y@160mm": -1.0})])


def test_the_ranking_and_the_choice(planned):
    assert planned.ranking[0].candidate is POSITIONS
    assert planned.chosen[0].candidate is POSITIONS
    # two candidates determine more than the first alone
    first, second = (r.expected.standard_error for r in planned.chosen)
    assert all(second[name] <= first[name] for name in first)


@pytest.mark.slow
def test_added_to_a_fit_the_errors_are_those_of_the_fit_of_both():
    """After tensions, angles: what was expected is what a fit to tensions and angles then finds."""
    body, base = paper_body("exact"), np.tile(LEVELS, 4)
    rng = np.random.default_rng(2)
    tip = closed_form(base) + rng.normal(size=base.size)
    noise = {"tip_tension": 1.0, "tip_angle": np.radians(1.0)}
    tensions = Measurements.from_columns("tensions", base_tension=base, tip_tension=tip)
    known = cddf.fit(body, tensions, noise={"tip_tension": 1.0})
    plan = cddf.plan(known, [TENSIONS, ANGLES, PULLEY], criterion="youngs_modulus", num=1)
    assert plan.now.status["youngs_modulus"] == "not identified"
    assert plan.ranking[-1].candidate is TENSIONS  # more of the same does not separate the two
    angle = wrap(LEVELS) + np.radians(1.0) * rng.normal(size=LEVELS.size)
    angles = Measurements.from_columns("angles", base_tension=LEVELS, tip_angle=angle)
    both = cddf.fit(body, (tensions, angles), noise=noise)
    expected = ranked(plan, "angles").expected
    for name in ("friction_coefficient", "youngs_modulus"):  # at another estimate: the errors differ as much as it
        ratio = both.standard_error[name] / both.value[name] / (expected.standard_error[name] / expected.value[name])
        assert ratio == pytest.approx(1.0, abs=0.1)


def test_a_prior_counts():
    prior = {"friction_coefficient": (MU, 0.02)}
    plan = cddf.plan(paper_body("exact"), [TENSIONS], priors=prior, num=1)
    told = plan.chosen[0].expected
    # E = mu / m: its relative variance is that of mu and of m
    of_ratio = 1 / np.sum(tensions_by_hand()[:, 0] ** 2)
    expected = np.hypot(0.02 / MU, np.sqrt(of_ratio))
    assert told.standard_error["youngs_modulus"] / E == pytest.approx(expected, rel=1e-6)


def test_a_candidate_beyond_the_model_has_a_warning_and_adds_nothing():
    """At 4000 N the exact body is bent beyond d kappa = 1 at its base, where T d^2 > E J."""
    beyond = Candidate("far", {"base_tension": [40.0, 4000.0]}, {"tip_angle": 0.01})
    plan = cddf.plan(paper_body("exact"), [beyond], num=1)
    assert plan.ranking[0].warnings[0].startswith("1 of 2 rows")
    alone = cddf.plan(paper_body("exact"), [Candidate("near", {"base_tension": 40.0}, {"tip_angle": 0.01})], num=1)
    assert plan.ranking[0].gain == pytest.approx(alone.ranking[0].gain, rel=1e-12)  # the row without a solution adds 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"candidates": []}, "no candidate"),
        ({"criterion": "E"}, "criterion 'E' is neither"),
        ({"free": ("friction",)}, "'friction' is not a parameter"),
        ({"candidates": [Candidate("x", {"base_tension": 1.0}, {"tip": 1.0})]}, "candidate 'x': unknown column 'tip'"),
        ({"candidates": [Candidate("x", {"base_tension_2": 1.0}, {"tip_angle": 1.0})]}, "candidate 'x'"),
    ],
)
def test_refusals(change, message):
    options = {"candidates": [TENSIONS], "free": ("friction_coefficient", "youngs_modulus")} | change
    with pytest.raises(InputError, match=message):
        cddf.plan(paper_body("exact"), **options)


def test_a_candidate_that_reads_nothing():
    with pytest.raises(InputError, match="noise must name what is read"):
        Candidate("x", {"base_tension": 1.0}, {})
    with pytest.raises(InputError, match="with standard deviations > 0"):
        Candidate("x", {"base_tension": 1.0}, {"tip_angle": cddf.Noise(0.1, 0.01)})  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_what_separates_modulus_and_compliance_of_a_driven_bench():
    """E C alone decides the shape, docs/how_to/displacement.md; newtons come by a cell at the tip or a weight there."""
    body = robot()
    free = ["friction_coefficient", "youngs_modulus", "outside_compliance"]
    found = cddf.plan(body, cddf.standard_candidates(body, 20.0, displacement=10e-3), free, num=1)
    expected = {ranked.candidate.name: ranked.expected for ranked in found.ranking}
    product = ["outside_compliance * youngs_modulus"]
    for name in ("loop", "loop of half the displacement", "loop with a marker in the middle"):
        assert expected[name].status["youngs_modulus"] == "not identified"
        lone = expected[name].status["friction_coefficient"] == "identified"  # else it is a part of the combination
        assert not lone or [*expected[name].combinations] == product
    for name in ("loop with a load cell at the tip", "loop under a tip weight of 1 N"):
        assert {*expected[name].status.values()} == {"identified"}
    assert found.chosen[0].candidate.name == "loop with a load cell at the tip"
    plain, marked = (expected[name].standard_error for name in ("loop", "loop with a marker in the middle"))
    assert marked["friction_coefficient"] < plain["friction_coefficient"]


@pytest.mark.slow
def test_poses_one_after_another_are_planned_as_they_are_fitted():
    """Three tendons in space; the expected errors are those of a fit to the same rows, simulated and without noise."""
    body = three_tendon_tube()
    candidate = cddf.standard_candidates(body, 12.0)[-1]
    assert candidate.name == "tip positions, tendons pulled in turn"
    first = cddf.plan(body, [candidate], num=1, nodes=12).ranking[0].expected
    pulls = np.transpose([np.asarray(candidate.conditions[f"base_tension{end}"]) for end in ("", "_2", "_3")])
    np.testing.assert_allclose(pulls[[0, 4]], [[12.0, 1.2, 1.2], [1.2, 6.0, 1.2]])
    few = {"nodes": 8, "short_steps": 4, "throw": False}  # the elements and increments of a fit with 12 nodes
    tips = cddf.trace(body, pulls, **few).tip_position
    columns = {name: np.asarray(own) for name, own in candidate.conditions.items()}
    columns |= {f"tip_{axis}": tips[:, i] for i, axis in enumerate("xyz")}
    table = cddf.Measurements.from_columns("poses", ("simulated",), **columns)
    fit = cddf.fit(body, table, noise=dict(candidate.noise) | {"base_tension": 0.0}, nodes=12)
    for name, error in fit.standard_error.items():
        assert first.standard_error[name] == pytest.approx(error, rel=1e-3)
