"""How searches go on: portions of steps, Ctrl-C, the misfit that progress shows, the time limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cddf_jax.estimation import restarts
from cddf_jax.estimation.least_squares import least_squares_fit
from cddf_jax.estimation.levenberg_marquardt import Watch
from cddf_jax.estimation.whole_search import INTERRUPTED

X = np.linspace(0.0, 3.0, 12)
TRUE = {"height": 2.0, "rate": 0.7}
DATA = TRUE["height"] * np.exp(-TRUE["rate"] * X) + 0.01 * np.sin(7 * X)
START = {"height": 20.0, "rate": 3.0}


def decay(p):
    return p["height"] * jnp.exp(-p["rate"] * X)


def test_a_model_that_is_not_good_to_all_digits_is_not_searched_to_the_last_one():
    """Noise of 1e-8 in the model, without a derivative: the estimates are those without it, to 1 % of their errors."""

    def rough(p):
        return decay(p) + 1e-8 * jax.lax.stop_gradient(jnp.sin(1e12 * p["rate"] * (1 + X)))

    smooth, wandering, found = (
        least_squares_fit(model, START, DATA, sigma=0.01, accuracy=accuracy)
        for model, accuracy in ((decay, 0.0), (rough, 0.0), (rough, 0.01))
    )
    assert found.success
    assert found.num_steps < wandering.num_steps
    for name, error in smooth.standard_error.items():
        assert abs(found.value[name] - smooth.value[name]) < 0.01 * error


@pytest.mark.parametrize("looks", [1, 3])
def test_ctrl_c_gives_the_best_so_far(monkeypatch, looks):
    """Interrupted after some looks at the search: better than the start, and nothing is called identified."""
    seen, saw = [], Watch.saw

    def look(watch, minimum, **how):
        saw(watch, minimum, **how)
        seen.append(float(minimum.outcome.cost))
        if len(seen) == looks:
            raise KeyboardInterrupt

    monkeypatch.setattr(Watch, "saw", look)
    fit = least_squares_fit(decay, START, DATA, sigma=0.01)
    assert (fit.success, fit.result) == (False, INTERRUPTED)
    assert set(fit.status.values()) == {"not identified"}
    assert set(fit.standard_error.values()) == {np.inf}
    assert np.sum((decay(fit.value) - DATA) ** 2) / 0.01**2 == pytest.approx(min(seen))


def test_an_interruption_before_the_first_step_is_raised():
    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        least_squares_fit(interrupted, START, DATA, sigma=0.01)


def test_progress_tells_the_misfit():
    """The misfit is the root mean square of the residuals over that of the data about their mean, by NumPy."""
    fit = least_squares_fit(decay, START, DATA, sigma=0.01)
    ratio = np.linalg.norm(fit.residuals) / np.linalg.norm(DATA - DATA.mean())
    found = f"misfit {100 * ratio:.3g} % (data), height {fit.value['height']:.4g}, rate {fit.value['rate']:.4g}"
    assert fit.minimum.in_words == f"step {fit.num_steps}, {found}"


def test_other_searches_end_in_time(monkeypatch):
    """No place explains a parabola by a line through 0; without time there is one more search, and the fit says so."""
    monkeypatch.setattr(restarts, "LONGEST", 0.0)
    fit = least_squares_fit(lambda p: p["a"] * X, {"a": 1.0}, 5 + (X - 1.5) ** 2, bounds={"a": (0.0, 1e-3 + 1.0)})
    assert not fit.success
    assert "other searches ended after 0 s; give starts to allow more" in fit.restarted
