"""Cells of time: the seconds, counted by hand from the text, and what is refused with its row."""

import numpy as np
import pytest

from cddf_jax.errors import InputError
from cddf_jax.files.times import seconds_in, seconds_of

DAY = 86400.0


@pytest.mark.parametrize(
    ("texts", "unit", "seconds"),
    [
        (["0", "1.5"], "min", [0, 90]),
        (["17", "18 s", "0.4 min", "2e4 ms"], "s", [17, 18, 24, 20]),
        (["9:59:59.5", "10:00:00"], "s", [35999.5, 36000]),
        (["11:59:59 AM", "12:00 pm", "1:00:00 p.m."], "s", [43199, 43200, 46800]),
        (["12:00:05 am"], "s", [5]),
        (["10:05", "25:00"], "hh:mm", [36300, 90000]),
        (["10:05"], "mm:ss", [605]),
        (["00:01.5", "61:02.25"], "s", [1.5, 3662.25]),
        (["0:00:05", "1 day, 0:00:05.5", "2 days 00:00:00"], "s", [5, DAY + 5.5, 2 * DAY]),
        (["2026-05-04 23:59:59.5", "2026-05-05T00:00:01"], "UTC", [0, 1.5]),
        (["2026-05-04 23:00:00+00:00", "2026-05-05T00:00:30+01:00", "2026-05-04T23:01:00Z"], "s", [0, 30, 60]),
        (["2024/02/28 9:05", "2024/03/01 09:05"], "s", [0, 2 * DAY]),  # of a leap year
        (["31.12.2025 23:59:00", "01.01.2026 00:00:00"], "s", [0, 60]),
        (["2026-05-04", "2026-05-05"], "s", [0, DAY]),
    ],
)
def test_seconds(texts, unit, seconds):
    values, said = seconds_in("time", range(2, 2 + len(texts)), texts, unit)
    np.testing.assert_allclose(values, seconds, rtol=1e-15, atol=1e-6)
    assert bool(said) == any(mark in texts[0] for mark in ":-")  # what is no number is told


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["0", ""], "row 3, column time: the cell is empty; give a time such as 18 s, 10:00:18 or 2026-05-04 10:00:18"),
        (["0", "1", "x"], "row 4, column time: 'x' is not a time; give a time such as 18 s"),
        (["0", "nan"], "row 3, column time: 'nan' is not a time"),
        (["inf"], "row 2, column time: 'inf' is not a time"),
        (["0", "1:8"], "row 3, column time: '1:8' is not a time"),
        (["13:00 pm"], "row 2, column time: '13:00 pm' is not a time"),
        (["2026-02-30 10:00"], "row 2, column time: '2026-02-30 10:00' is not a time"),
        (["05/04/2026 10:00"], "row 2, column time: '05/04/2026 10:00' is not a time"),  # of April or of May
        (["18 mm"], "row 2, column time: '18 mm' is not a time"),
        (["17", "0:18"], "row 3, column time: '0:18' is a clock time, but '17' in row 2 is a number; write one form"),
        (["23:59:59", "1900-01-01 00:00:01"], "'1900-01-01 00:00:01' is a date, but '23:59:59' in row 2 is a clock"),
    ],
)
def test_what_is_not_a_time_is_refused_by_row(texts, said):
    with pytest.raises(InputError) as error:
        seconds_in("time", range(2, 2 + len(texts)), texts, "s")
    assert said in str(error.value)


def test_dates_and_durations_of_python():
    """NumPy's dates are compared with the text that they were made of."""
    texts = ["2026-05-04T10:00:00", "2026-05-04T10:00:01", "2026-05-05T10:00:00"]
    for unit in ("s", "ms", "ns"):
        dates = np.array(texts, f"M8[{unit}]")
        for times in (texts, dates, dates.tolist() if unit != "ns" else texts, dates - dates[0]):
            np.testing.assert_array_equal(seconds_of(times), [0, 1, DAY])
    np.testing.assert_array_equal(seconds_of(np.array([0, "NaT"], "m8[s]")), [0, np.nan])
    np.testing.assert_array_equal(seconds_of([3, 4.5]), [3, 4.5])
