"""The report on one or several runs: a single HTML file that needs nothing else, not even a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from plotly.offline import get_plotlyjs

from cosim.report.figures import figures
from cosim.results import Result
from cosim.whole import whole

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 2rem auto; max-width: 64rem;
       padding: 0 1rem; }
h1, h2 { line-height: 1.25; } h2 { margin-top: 3rem; border-top: 1px solid #ccc; padding-top: 1.5rem; }
table { border-collapse: collapse; margin: 1.5rem 0; font-size: 0.92rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 0.3rem 0.9rem; border-bottom: 1px solid #ddd; vertical-align: top; }
th { border-bottom: 2px solid #1a1a1a; }
.scroll { overflow-x: auto; } svg { max-width: 100%; height: auto; }
"""


@dataclass(frozen=True)
class Table:
    """A table of text: the heads of its columns, and rows of as many cells."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def write_report(
    path: Path, title: str, intro_html: str, table: Table | None, results: Sequence[tuple[str, str, Result]]
) -> None:
    """Write one self-contained HTML file: introduction, summary table, and a section of figures for each result.

    Args:
        path: the file to write.
        title: the page's title, plain text.
        intro_html: what comes first, HTML.
        table: the summary; its cells are plain text.
        results: heading and comment (both plain text) and the run that they are about.
    """
    parts = [f"<h1>{escape(title)}</h1>", intro_html]
    if table is not None:
        parts.append(html_table(table))
    if len(results) > 1:
        links = (f'<li><a href="#run-{i}">{escape(heading)}</a></li>' for i, (heading, _, _) in enumerate(results))
        parts.append(f"<ul>{''.join(links)}</ul>")
    for i, (heading, comment, result) in enumerate(results):
        parts.append(f'<h2 id="run-{i}">{escape(heading)}</h2>')
        if comment:
            parts.append(f"<p>{escape(comment)}</p>")
        for j, figure in enumerate(figures(result)):
            config = {"displaylogo": False, "responsive": True}
            div = figure.to_html(full_html=False, include_plotlyjs=False, div_id=f"run-{i}-figure-{j}", config=config)
            parts.append(div)
    write_page(path, title, parts, get_plotlyjs())


def write_page(path: Path, title: str, parts: Sequence[str], script: str = "") -> None:
    """Write one self-contained HTML file of the given `parts` (HTML); the title is plain text."""
    body = "\n".join(parts)
    with whole(path) as partial:
        partial.write_text(
            f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<style>{_STYLE}</style>\n<script>{script}</script>\n</head>\n<body>\n{body}\n</body>\n</html>\n",
            encoding="utf-8",
        )


def html_table(table: Table) -> str:
    """`table` as HTML."""

    def row(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    lines = [row("th", table.columns), *(row("td", cells) for cells in table.rows)]
    return '<div class="scroll"><table>\n' + "\n".join(lines) + "\n</table></div>"
