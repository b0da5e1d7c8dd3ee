"""The page of a comparison: one HTML file, with plots drawn as SVG and pictures of the worst frame inside it."""

from __future__ import annotations

import base64
import html
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from plait.pipeline.compare import Comparison, PrimComparison
from plait.pipeline.errors import PlaitError, UsageError
from plait.pipeline.files import replacing
from plait.pipeline.plot import line_plot

PAGE = "index.html"
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; color: #222; background: #fff; }
table { border-collapse: collapse; }
td, th { padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }
td:first-child, th:first-child { text-align: left; }
.different { color: #b3261e; } .same { color: #1b6e3c; }
figure { display: inline-block; margin: .5rem .5rem .5rem 0; } figure img { max-width: 29rem; }
svg text { font-size: 12px; }
"""


def write_report(comparison: Comparison, folder: Path) -> Path:
    """Writes `folder`/index.html, which needs no other file, and returns its path.

    Pictures are of the frame with the largest distance; where drawing is impossible the page says why.
    Raises UsageError for a folder that cannot be written.
    """
    page = folder / PAGE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(page) as aside:
            aside.write_text(_page(comparison), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--report {folder}: cannot be written: {error.strerror}") from error
    return page


def _page(comparison: Comparison) -> str:
    verdict = "same" if comparison.ok else "different"
    ordered = sorted(comparison.prims, key=lambda prim: prim.same)
    return "\n".join(
        [
            "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
            f"<title>plait compare: {verdict}</title><style>{_STYLE}</style></head><body>",
            f"<h1 class='{verdict}'>{verdict.capitalize()}</h1>",
            f"<p>Reference <code>{_text(comparison.reference)}</code><br>"
            f"New <code>{_text(comparison.new)}</code><br>Tolerance {comparison.tolerance:g} m</p>",
            *(f"<p class='different'>{_text(problem)}</p>" for problem in comparison.problems),
            _table(ordered),
            _pictures(comparison),
            *(_plots(prim, comparison.tolerance) for prim in ordered if len(prim.codes) > 1),
            "</body></html>",
        ]
    )


def _table(prims: Sequence[PrimComparison]) -> str:
    names = ("prim", "points", "frames", "largest [m]", "at frame", "mean [m]", "length", "beyond from", "")
    rows = ["<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"]
    for prim in prims:
        cells = [f"<code>{_text(prim.path)}</code>", str(prim.points), str(len(prim.codes))]
        if len(prim.codes):
            worst = prim.worst
            cells += [f"{prim.largest[worst]:.3g}", f"{prim.codes[worst]:g}", f"{prim.mean.mean():.3g}"]
        else:
            cells += ["", "", ""]
        changed = prim.length_change is not None and len(prim.length_change)
        cells.append(
            f"{100 * prim.length_change[np.argmax(np.abs(prim.length_change))]:+.3g} %" if changed else ""
        )
        cells.append("" if prim.first_beyond is None else f"{prim.first_beyond:g}")
        cells.append("<br>".join(map(_text, prim.problems)))
        kind = "same" if prim.same else "different"
        rows.append(f"<tr class='{kind}'>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return "<table>" + "".join(rows) + "</table>"


def _pictures(comparison: Comparison) -> str:
    compared = [prim for prim in comparison.prims if len(prim.codes)]
    if not compared:
        return ""
    worst = max(compared, key=lambda prim: prim.largest[prim.worst])
    code = float(worst.codes[worst.worst])
    try:
        from plait.pipeline.preview import render_still

        with tempfile.TemporaryDirectory() as folder:
            shown = []
            for name, path in (("reference", comparison.reference), ("new", comparison.new)):
                picture = Path(folder) / f"{name}.png"
                render_still(path, picture, frame=code)
                shown.append((name, base64.b64encode(picture.read_bytes()).decode()))
    except (PlaitError, ImportError) as error:
        return f"<p>No pictures: {_text(error)}</p>"
    return "".join(
        f"<figure><img alt='{name}' src='data:image/png;base64,{data}'>"
        f"<figcaption>{name}, frame {code:g}</figcaption></figure>"
        for name, data in shown
    )


def _plots(prim: PrimComparison, tolerance: float) -> str:
    distance = line_plot(
        prim.codes,
        {"largest": prim.largest, "mean": prim.mean},
        "distance [m]",
        logarithmic=True,
        mark=("tolerance", tolerance),
    )
    shown = f"<h2><code>{_text(prim.path)}</code></h2><figure>{distance}</figure>"
    if prim.length_change is not None:
        change = line_plot(prim.codes, {"length change": 100.0 * prim.length_change}, "length change [%]")
        shown += f"<figure>{change}</figure>"
    return shown


def _text(value: object) -> str:
    return html.escape(str(value))
