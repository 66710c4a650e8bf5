"""The texts beside the figures of the explorer, as HTML; every number has its name in `data-name`."""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from ..statics.status import Status, in_words, words_of
from .model import Picture
from .past import Loop
from .plots import tendon_look

INACCURATE = "The path is rough: see its error estimate. Tensions of tendons that hold each other are open."


def _number(name: str, number: str, unit: str) -> str:
    return f'<b data-name="{name}">{number}</b> {unit}'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    heads = "".join(f"<th>{words}</th>" for words in head)
    lines = ("".join(f"<td>{cell}</td>" for cell in row) for row in rows)
    return f"<table><tr>{heads}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def numbers_html(picture: Picture) -> str:
    """The answer in numbers: a strip of them, and one row for each tendon."""
    found = picture.equilibrium
    place = zip("xyz", 1e3 * np.asarray(found.tip_position), strict=False)
    tiles = [
        ("tip angle", _number("tip_angle", f"{np.degrees(float(found.tip_angle)):.3f}", "deg")),
        *((f"tip {axis.upper()}", _number(f"tip_{axis}", f"{at:z.3f}", "mm")) for axis, at in place),
        ("peak bending", _number("peak_curvature", f"{picture.peak_curvature:.4g}", "1/m")),
        ("error estimate", _number("error_estimate", f"{float(found.error_estimate):.1e}", "")),
    ]
    if np.isfinite(picture.peak_strain):
        tiles.insert(-1, ("peak strain", _number("peak_strain", f"{100 * picture.peak_strain:.3f}", "%")))
    several, rows = len(found.direction) > 1, []
    numbers = zip(found.base_tension, found.tip_tension, found.tension_loss, found.tendon_displacement, strict=True)
    for i, (base, tip, loss, travel) in enumerate(numbers, 1):
        way = _number(f"direction_{i}", "in" if found.direction[i - 1] > 0 else "out", "")
        lost = _number(f"tension_loss_{i}", f"{100 * loss:.3f}", "%") if base > 0 else "no tension"
        row = [f"{_line(i - 1)} {i}", *[way] * several, _number(f"base_tension_{i}", f"{base:.4g}", "N")]
        row += [_number(f"tip_tension_{i}", f"{tip:.4f}", "N"), lost]
        rows.append([*row, _number(f"tendon_displacement_{i}", f"{1e3 * travel:.3f}", "mm")])
    head = ("tendon", *["slides"] * several, "base tension", "tip tension", "loss", "pulled in")
    result = escape(in_words(found.status), quote=True)
    strip = "".join(f'<div class="tile"><span>{words}</span>{number}</div>' for words, number in tiles)
    head_of_strip = f'<div class="tiles" role="status" data-name="result" data-result="{result}">'
    return f"{head_of_strip}{strip}</div>{_table(head, rows)}"


def paragraph(text: str) -> str:
    return f"<p>{escape(' '.join(text.split()))}</p>"


def loop_html(loop: Loop, tendon: int = 0) -> str:
    """The present state with its past, of the tendon that moved last, counted from 0."""
    words = words_of(loop.status) if loop.status != Status.inaccurate else INACCURATE
    if not loop.shown:
        return paragraph(f"There is no answer with this past: {words}")
    tip = _number(f"past_tip_tension_{tendon + 1}", f"{loop.tip_tension[-1]:.4f}", "N")
    angle = _number("past_tip_angle", f"{np.degrees(loop.tip_angle[-1]):.3f}", "deg")
    front = _number("front", f"{1e3 * loop.front:.2f}", "mm")
    text = f"With its past (purple): {tip} at the tip, {angle}. The tendon slid last up to {front} from the base. "
    text += f"{_number('past_error', f'{loop.error_estimate:.1e}', 'is the error estimate')}. "
    return f"{paragraph(words) if words else ''}<p>{text}All other numbers are those of a pull from rest.</p>"


def _line(tendon: int) -> str:
    """The look of a tendon in the figures."""
    look = tendon_look(tendon)
    dashes = " ".join(map(str, look["line_dash"]))
    line = f'<line x2="26" y1="4" y2="4" stroke="{look["line_color"]}" stroke-width="2" stroke-dasharray="{dashes}"/>'
    return f'<svg width="26" height="8" aria-hidden="true">{line}</svg>'


def lines_html(text: str) -> str:
    """Lines of text, such as the output of `cddf fit`, one paragraph each."""
    return f'<div role="status" data-name="verdict">{"".join(map(paragraph, text.splitlines()))}</div>'
