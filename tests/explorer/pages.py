"""What the tests of the explorer's page share: a server of their own, and waiting for numbers."""

import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from urllib.parse import urlsplit

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
COMPUTING, STALE = (f"[style*='--{mark}: on']" for mark in ("computing", "stale"))  # parts of the page
PATIENCE = 120_000  # ms, for compilers on a busy machine


@contextmanager
def served(*arguments, times=1):
    """`cddf explore` so many times in one process, each ended by Ctrl-C: the process, its first address."""
    program = f"from cddf_jax.cli.app import app; [app(standalone_mode=False) for _ in range({times})]"
    command = [sys.executable, "-u", "-c", program, "explore", *map(str, arguments), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        line = process.stdout.readline()
        if line:
            yield process, line.split()[0]
            process.send_signal(signal.SIGINT)
        try:
            _, error = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert line.startswith("http://localhost:"), error
    assert process.returncode == 0, error
    assert "Traceback" not in error, error


def opened_page(browser, address):
    """A wide page, what it asks for, and what goes wrong in it."""
    page, asked, wrong = browser.new_page(viewport={"width": 1440, "height": 900}), [], []
    page.set_default_timeout(PATIENCE)
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(address)
    return page, asked, wrong


def wait_for(page, name, text=None):
    """Until a number, or this one, stands on the page."""
    words = {} if text is None else {"has_text": re.compile(f"^{re.escape(text)}$")}
    page.locator(f'[data-name="{name}"]', **words).wait_for()


def hosts_of(asked):
    """Of what a page asked for, but for what it made itself."""
    return {urlsplit(url).hostname for url in asked if not url.startswith(("data:", "blob:"))}


def type_at(page, place, text):
    """Into the field beside a slider."""
    field = page.locator(".slider-edit input").nth(place)
    field.fill(text)
    field.press("Enter")


def is_to_scale(page, figure):
    """Whether a millimetre has as many pixels along both axes, up to 1 %."""
    x, y = page.evaluate(
        """name => {
        const {x_range, y_range, inner_width, inner_height} = Bokeh.documents[0].get_model_by_name(name)
        return [(x_range.end - x_range.start) / inner_width, (y_range.end - y_range.start) / inner_height]
    }""",
        figure,
    )
    return abs(x - y) < 0.01 * y
