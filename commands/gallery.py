"""observer-fmus gallery: worked models from the literature, each a file to start from."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

import gallery as models
from commands.console import fail, out
from cosim.errors import suggest
from cosim.whole import whole


def gallery(
    name: Annotated[
        str | None, typer.Argument(help="Of the model that becomes NAME.py.", show_default="list all")
    ] = None,
) -> None:
    """List the worked models of the gallery, or copy one into NAME.py: model, plant, observer and the source of its inputs.

    \b
    Example:
      observer-fmus gallery quadruple_tank
    """
    files = {path.stem: path for path in sorted(Path(models.__file__).parent.glob("[a-z]*.py"))}
    if name is None:
        table = Table(box=None, show_header=False, pad_edge=False)
        for known, path in files.items():
            table.add_row(Text(known, style="bold"), _summary(path))
        out.print(table)
        return
    if name not in files:
        fail(f"the gallery has no '{name}'; {suggest(name, files)}", 2)
    path = Path(f"{name}.py")
    if path.exists():
        fail(f"{path}: is there already, and stays as it is", 2)
    with whole(path) as partial:
        partial.write_bytes(files[name].read_bytes())
    out.print(f"{path}: now observer-fmus build --file {path}", markup=False, soft_wrap=True)


def _summary(path: Path) -> str:
    """The first sentence of a file's docstring."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").splitlines()[0]
