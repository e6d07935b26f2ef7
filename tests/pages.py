"""What stands in the blocks of a page of the documentation, and a folder in which it runs.

    sh       commands: each is run, in the order of the page; with a title (`title="..."`) they are for elsewhere
    python   code: run in one namespace with the page's other code; with a title it is a file of that name
    csv      a file of the name in its title
    yaml     for a CI system
    text     output

Indented blocks are equations.
"""

from __future__ import annotations

import re
import runpy
import shlex
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import plant_fmu
from build_fmus import FMUS, SYSTEMS
from tools import ROOT
from verbs import observer_fmus

BLOCK = re.compile(r"^```(\w*)(?: title=\"([^\"]*)\")?\n(.*?)^```$", flags=re.S | re.M)
LANGUAGES = {"sh", "python", "csv", "yaml", "text"}


@dataclass(frozen=True)
class Block:
    language: str
    title: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    return [Block(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


def commands_of(block: Block) -> list[list[str]]:
    return [shlex.split(line, comments=True) for line in block.text.replace("\\\n", " ").splitlines() if line.strip()]


def prepare(blocks: list[Block], folder: Path, fmu: Callable[[str], Path], system: Callable[[str], Path]) -> None:
    """Puts into `folder` what the blocks take from a clone in which the catalogue was built."""
    text = "\n".join(block.text for block in blocks)
    (folder / "reference_models").symlink_to(ROOT / "reference_models")
    for kind, known, path_of in (("fmus", FMUS, fmu), ("systems", SYSTEMS, system)):
        (folder / kind).mkdir()
        for name in sorted(set(re.findall(rf"(?:\b{kind}/|--only )(\w+)", text)) & set(known)):
            (folder / kind / f"{name}.{'fmu' if kind == 'fmus' else 'ssp'}").symlink_to(path_of(name))
    if "describe pendulum.fmu" in text:  # a plant that somebody exported
        plant_fmu.write(folder / "pendulum.fmu", plant_fmu.library(), "pendulum", slopes=True)


def run_blocks(blocks: list[Block], folder: Path) -> None:
    """Runs commands and code in `folder`, the working directory; what fails, or prints otherwise than its comment says, fails the test."""
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block in blocks:
        if block.language in ("python", "csv") and block.title:
            (folder / block.title).write_text(block.text, encoding="utf-8")
            if block.language == "python":
                namespace.update(runpy.run_path(str(folder / block.title)))
        elif block.language == "python":
            run_code(block.text, namespace)
        elif block.language == "sh" and not block.title:
            for command in commands_of(block):
                run_command(command)


def run_command(words: list[str]) -> None:
    program, *arguments = words
    if program == "make":
        assert f"\n{arguments[0]}:" in (ROOT / "Makefile").read_text(encoding="utf-8"), words
        return
    if program == "python":  # a script of docs/, whose imports are tested: it draws what the page shows
        assert (ROOT / arguments[0]).is_file(), words
        return
    assert program == "observer-fmus", words
    if arguments[:2] == ["build", "--only"]:  # of the catalogue, which is built for all tests
        assert all(Path("fmus", f"{name}.fmu").exists() for name in arguments[2::2]), words
        return
    if "--runs" in arguments:  # two show what a hundred do
        arguments[arguments.index("--runs") + 1] = "2"
    done = observer_fmus(*arguments)
    assert done.exit_code == 0, f"{' '.join(words)}\n{done.output}"


def run_code(text: str, namespace: dict[str, object]) -> None:
    """A number behind a print is what it prints, to the digits that it shows; "within" says how far off it may be."""
    said = re.findall(r"^print\(.*\)  # (.+)$", text, flags=re.M)
    shown = StringIO()
    with redirect_stdout(shown):
        exec(text.replace("runs=100", "runs=2"), namespace)
    for expected, found in zip(said, shown.getvalue().splitlines() if said else [], strict=True):
        value, _, within = expected.partition(", within ")
        digits = len(value.partition(".")[2])
        assert abs(float(found) - float(value)) <= (float(within) if within else 0.5 * 10.0**-digits), (
            expected,
            found,
        )
