"""What the explorer writes beside its figures, as HTML; every number has its name in `data-name`."""

from collections.abc import Sequence
from html import escape

import numpy as np

from ..statics.equilibrium import RESULTS
from .model import Picture, Taper
from .plots import tendon_look

Row = tuple[str, str, str, str]  # name, words, number, unit


def _cell(name: str, number: str, unit: str) -> str:
    return f'<td><b data-name="{name}">{number}</b> {unit}</td>'


def numbers_html(picture: Picture) -> str:
    """The answer in numbers: a strip of them, and one row for each tendon."""
    found = picture.equilibrium
    x, y = 1e3 * np.asarray(found.tip_position)
    tiles: list[Row] = [
        ("tip_angle", "tip angle", f"{np.degrees(float(found.tip_angle)):.3f}", "deg"),
        ("tip_x", "tip X", f"{x:.3f}", "mm"),
        ("tip_y", "tip Y", f"{y:.3f}", "mm"),
        ("peak_curvature", "peak curvature", f"{picture.peak_curvature:.4g}", "1/m"),
        *_strain_tile(picture),
        ("error_estimate", "error estimate", f"{float(found.error_estimate):.1e}", ""),
    ]
    several = len(found.direction) > 1
    titles = ("tendon", *["slides"] * several, "base tension", "tip tension", "loss", "pulled in")
    head = "".join(f"<th>{words}</th>" for words in titles)
    rows = []
    for i, travel in enumerate(np.asarray(found.tendon_displacement), 1):
        base, tip, loss = (
            float(number[i - 1]) for number in (found.base_tension, found.tip_tension, found.tension_loss)
        )
        cells = [_cell(f"direction_{i}", "in" if found.direction[i - 1] > 0 else "out", "")] * several
        cells += [
            _cell(f"base_tension_{i}", f"{base:.4g}", "N"),
            _cell(f"tip_tension_{i}", f"{tip:.4f}", "N"),
            _cell(f"tension_loss_{i}", f"{100 * loss:.3f}", "%") if base > 0 else "<td>no tension</td>",
            _cell(f"tendon_displacement_{i}", f"{1e3 * travel:.3f}", "mm"),
        ]
        rows.append(f"<tr><td>{_line(i - 1)} {i}</td>{''.join(cells)}</tr>")
    result = RESULTS[found.result] or "successful"
    return (
        f'<div class="tiles" role="status" data-name="result" data-result="{escape(result, quote=True)}">'
        f"{_tiles(tiles)}</div><table><tr>{head}</tr>{''.join(rows)}</table>"
    )


def _strain_tile(picture: Picture) -> list[Row]:
    """Nothing for a body without radii."""
    known = np.isfinite(picture.peak_strain)
    return [("peak_strain", "peak strain", f"{100 * picture.peak_strain:.3f}", "%")] if known else []


def _line(tendon: int) -> str:
    """The look of a tendon in the figures."""
    look = tendon_look(tendon)
    dashes = {"solid": "none", "dashed": "6 3", "dotted": "2 2", "dashdot": "6 2 2 2"}
    dash = look["line_dash"]
    pattern = dashes[dash] if isinstance(dash, str) else " ".join(map(str, dash))
    line = f'<line x2="26" y1="4" y2="4" stroke="{look["line_color"]}" stroke-width="2" stroke-dasharray="{pattern}"/>'
    return f'<svg width="26" height="8" aria-hidden="true">{line}</svg>'


def _tiles(tiles: Sequence[Row]) -> str:
    return "".join(
        f'<div class="tile"><span>{words}</span><b data-name="{name}">{number}</b> {unit}</div>'
        for name, words, number, unit in tiles
    )


def tapers_html(tapers: tuple[Taper, Taper], angle: float, several: bool) -> str:
    """The taper that is set against the manipulator's own."""
    which = " of tendon 1" if several else ""
    rows = [
        ("tension_loss", f"tension loss{which}, at the tensions set", 100.0, "%"),
        ("tip_angle", "tip angle, at the tensions set", float(np.degrees(1.0)), "deg"),
        ("peak_strain", "peak strain, at the tensions set", 100.0, "%"),
        ("base_tension", f"base tension{which} for a tip angle of {angle:g} deg", 1.0, "N"),
        ("strain_there", f"peak strain at {angle:g} deg", 100.0, "%"),
    ]
    lines = []
    for name, words, scale, unit in rows:
        own, new = (scale * getattr(taper, name) for taper in tapers)
        change = 100 * (new / own - 1) if own else np.nan
        change_text = f"{change:+.1f} %" if np.isfinite(change) else "-"
        lines.append(
            f"<tr><td>{words}</td>{_cell(f'own_{name}', _number(own), unit)}"
            f"{_cell(f'new_{name}', _number(new), unit)}<td>{change_text}</td></tr>"
        )
    head = "".join(f"<th>{words}</th>" for words in ("what if", "file's taper", "this taper", "change"))
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "not reached"


def lines_html(text: str) -> str:
    """Lines of text, the first ones of `cddf fit`, one paragraph each; what is identified is marked."""
    marked = []
    for line in text.splitlines():
        kind = "lost" if "not identified" in line else "known" if line.endswith("identified") else ""
        marked.append(f'<p class="{kind}">{escape(line)}</p>' if line.strip() else "")
    return f'<div role="status" data-name="verdict">{"".join(marked)}</div>'
