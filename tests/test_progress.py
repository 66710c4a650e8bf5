"""What long work says of itself: in order, after 2 s, on standard error, and only to those who ask.

The clock is the tests' own.
"""

import subprocess
import sys

import pytest

from cddf_jax.progress import SHOWN, Stages, each, stage


@pytest.fixture
def lines():
    return []


@pytest.fixture
def at(lines):
    """Stages shown as lines of a log; `at(seconds)` shows what is seen so many seconds after the beginning."""
    now = [100.0]
    stages = Stages(lines.append, lambda: now[0])
    before = SHOWN.set(stages)

    def look(seconds):
        now[0] = 100.0 + seconds
        stages.look()

    yield look
    SHOWN.reset(before)


def test_quick_work_is_silent(at, lines):
    with stage("searching"):
        at(1.9)
    at(30.0)  # nothing goes on
    assert lines == []


def test_stages_in_order(at, lines):
    with stage("loading"):
        at(2.0)
        at(3.0)  # said already
    with stage("searching"):
        at(3.9)  # too soon after the last line
        at(4.0)
        with stage("compiling"):
            at(7.0)
        at(11.0)
    assert lines == ["2 s: loading\n", "4 s: searching\n", "7 s: searching: compiling\n", "11 s: searching\n"]


def test_what_is_counted_has_an_end(at, lines):
    """A store holds 400 of 1,000 solves; 200 more take 4 s: 50 a second, and 8 s for the other 400."""
    with stage("solving", 1000, 400) as now:
        at(2.0)
        now.done = 600
        at(4.0)
    assert lines == ["2 s: solving 401 of 1,000\n", "4 s: solving 601 of 1,000, 0:00:08 left\n"]


def test_one_after_the_other(at, lines):
    """Two of five take 10 s, so that the others take 15 s."""
    seen = []
    for name in each("profile", list("abcde")):
        seen.append(name)
        at(5.0 * len(seen) - 5.0)
    assert seen == list("abcde")
    assert lines[1] == "10 s: profile 3 of 5, 0:00:15 left\n"


def test_progress_goes_to_standard_error():
    """In a process of its own, which has no patience; without asking there is no word."""
    program = (
        "import time, cddf_jax as cddf\n"
        "from cddf_jax import progress\n"
        "progress.PATIENCE, progress.TICK = 0.0, 0.001\n"
        "def work():\n"
        "    for what in ('loading', 'searching'):\n"
        "        shown = progress.SHOWN.get()\n"
        "        with progress.stage(what):\n"
        "            while shown and shown.last != what:\n"
        "                time.sleep(0.001)\n"
        "work()\n"
        "with cddf.show_progress(): work()\n"
        "print('the answer')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "the answer\n"
    assert done.stderr == "0 s: loading\n0 s: searching\n"
