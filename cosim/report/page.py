"""A report, whatever it is on: a single HTML file that needs nothing else, not even a network."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from bokeh.core.json_encoder import serialize_json
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.plotting import figure as new_figure
from bokeh.resources import Resources

from cosim.report.axes import GRID, INK, PAPER
from cosim.report.figures import figures
from cosim.results import Result
from cosim.whole import whole

_STYLE = """
:root { --ink: #1a1a1a; --paper: #fefefe; --line: #dddddd; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --paper: #161616; --line: #444444; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2rem auto; max-width: 64rem;
       padding: 0 1rem; overflow-wrap: break-word; }
h1, h2 { line-height: 1.25; } h2 { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: 1.5rem; }
a { color: inherit; } code { font-size: 0.92em; }
table { border-collapse: collapse; margin: 1.5rem 0; font-size: 0.92rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 0.3rem 0.9rem 0.3rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td { white-space: nowrap; } pre { font-size: 0.92em; }
caption { text-align: left; font-weight: 600; }
th { border-bottom: 2px solid var(--ink); }
.scroll { overflow-x: auto; } svg { max-width: 100%; height: auto; }
"""
_NO_SCRIPT = "<noscript><p>The figures need JavaScript; the numbers are in the files beside this one.</p></noscript>"
# The figures are drawn in the colours of the reader's choice, and once more where that changes.
_DRAW = """
const unpacked = async id => {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), c => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
};
const dark = matchMedia("(prefers-color-scheme: dark)");
const draw = async () => {
  let text = await unpacked("drawn");
  if (dark.matches) for (const [light, other] of LIGHT_TO_DARK) text = text.replaceAll(light, other);
  for (const item of JSON.parse(text)) {
    document.getElementById(item.target_id).replaceChildren();
    await Bokeh.embed.embed_item(item);
  }
  document.body.dataset.drawn = "yes";
};
(async () => {
  const script = document.createElement("script");
  script.textContent = await unpacked("library");
  document.head.append(script);
  await draw();
  dark.addEventListener("change", draw);
})();
""".replace("LIGHT_TO_DARK", json.dumps([[INK, "#e6e6e6"], [PAPER, "#161616"], [GRID, "#333333"]]))


@dataclass(frozen=True)
class Table:
    """A table of text: the heads of its columns, rows of as many cells, and what stands above it, if anything."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a report: heading, sentences (plain text, a paragraph each), tables, and figures below each other."""

    heading: str
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[new_figure] = ()


def on_run(heading: str, comment: str, result: Result) -> Section:
    """The section on a run: how often each status occurred, and all its figures."""
    return Section(heading, (comment,) if comment else (), statuses(result), figures(result))


def write_report(path: Path, title: str, intro_html: str, tables: Sequence[Table], sections: Sequence[Section]) -> None:
    """Write one self-contained HTML file: introduction, summary, and the sections.

    Args:
        path: the file to write; its folder is made where there is none.
        title: the page's title, plain text.
        intro_html: what comes first, HTML.
        tables: the summary; their cells are plain text.
        sections: what follows, with a table of contents where there are several.

    Raises:
        OSError: the file cannot be written.
    """
    parts = [f"<h1>{escape(title).replace('_', '_<wbr>')}</h1>", intro_html, *map(_html_table, tables)]
    if len(sections) > 1:
        links = (f'<li><a href="#part-{i}">{escape(one.heading)}</a></li>' for i, one in enumerate(sections))
        parts.append(f"<ul>{''.join(links)}</ul>")
    drawn = []
    for i, one in enumerate(sections):
        parts.append(f'<h2 id="part-{i}">{escape(one.heading)}</h2>')
        parts += [f"<p>{escape(sentence)}</p>" for sentence in one.sentences]
        parts += map(_html_table, one.tables)
        if one.figures:
            parts.append(f'<div id="part-{i}-figures" class="figures"></div>')
            drawn.append(json_item(column(*one.figures, sizing_mode="stretch_width"), f"part-{i}-figures"))
    if drawn:
        parts += [_NO_SCRIPT, _drawing(drawn)]
    body = "\n".join(parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as partial:
        partial.write_text(
            f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n'
            f"<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n",
            encoding="utf-8",
        )


def statuses(result: Result) -> list[Table]:
    """How often each status occurred, in words, for every status of `result`."""
    made = []
    for name in result.names:
        if name.endswith(".status") and name in result.items:
            rows = [(word, str(code), f"{part:.1%}") for word, code, part in shares(result, name)]
            made.append(Table((name, "code", "of the rows"), rows))
    return made


def shares(result: Result, name: str, where: np.ndarray | None = None) -> list[tuple[str, int, float]]:
    """Word and code of each value of an enumeration, and in which part of all rows it occurred; only of those `where` (n,) it counts."""
    values = result[name] if where is None else result[name][where]
    codes, counts = np.unique(values.astype(int), return_counts=True)
    words = result.items.get(name, {})
    return [
        (words.get(int(code), ""), int(code), float(count / len(result.time)))
        for code, count in zip(codes, counts, strict=True)
    ]


def _drawing(items: Sequence[object]) -> str:
    """The scripts that draw `items`: Bokeh's own library and what it draws, packed to a quarter of their size."""
    library = "\n".join(Resources(mode="inline", components=["bokeh"]).js_raw)
    packed = {"library": library, "drawn": serialize_json(items)}
    data = (f'<script type="text/plain" id="{name}">{_packed(text)}</script>\n' for name, text in packed.items())
    return "".join(data) + f"<script>{_DRAW}</script>\n"


def _packed(text: str) -> str:
    return b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _html_table(table: Table) -> str:
    def row(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    lines = [row("th", table.columns), *(row("td", cells) for cells in table.rows)]
    if table.caption:
        lines.insert(0, f"<caption>{escape(table.caption)}</caption>")
    return '<div class="scroll"><table>\n' + "\n".join(lines) + "\n</table></div>"
