"""The documentation runs as it stands: commands, code, and the numbers on the gallery's pages."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from commands.app import VERBS
from cosim.master import run
from once import compiled_once
from pages import LANGUAGES, blocks_of, commands_of, prepare, run_blocks
from tools import ROOT, imports, need

PAGES = {str(page.relative_to(ROOT)): page for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]}
GALLERY = {f"docs/gallery/{path.stem}.md" for path in (ROOT / "gallery").glob("[a-z]*.py")}
ELSEWHERE = {"docs/masters.md"}  # its code and its comparison run in tests/cosim/masters/, which need the other tools
RUN = {name for name, page in PAGES.items() if any(b.language in ("sh", "python") for b in blocks_of(page))} - ELSEWHERE
QUICK = {"docs/closed_loop.md", "docs/least_squares.md", "docs/signals.md", "docs/ukf.md"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.long) for n in sorted(RUN)])
def test_what_a_page_says_runs_as_it_says(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    catalogue_fmu: Callable[[str], Path],
    catalogue_system: Callable[[str], Path],
) -> None:
    blocks = blocks_of(PAGES[name])
    prepare(blocks, tmp_path, catalogue_fmu, catalogue_system)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(
        "CI", raising=False
    )  # the page's own FMUs are asked for numbers only: not optimised in CI either
    with compiled_once(optimised=False):
        run_blocks(blocks, tmp_path)
    if name in GALLERY:
        check_table(PAGES[name])


def check_table(page: Path) -> None:
    """Each row is a run of the page's command with one more option: trusted part, then largest errors, over the second half."""
    commands = [words for block in blocks_of(page) if block.language == "sh" for words in commands_of(block)]
    (command,) = [words for words in commands if words[1] == "run"]
    noise = settings(" ".join(command))
    rows = re.findall(r"^\| (as above|`--set [^`]*`) \| (.*) \|$", page.read_text(encoding="utf-8"), flags=re.M)
    assert len(rows) == 4
    for label, cells in rows:
        trusted, *largest = cells.split(" | ")
        result = run(command[2], overrides=noise | settings(label))
        late = len(result.time) // 2
        assert round(100 * result["observer.diagnostics.trusted"][late:].mean()) == pytest.approx(
            float(trusted.split()[0]), abs=2
        )
        estimates = [n for n in result.names if n.startswith("observer.estimate.")]
        for estimate, said in zip(estimates, largest, strict=True):
            truth = result[estimate.replace("observer.estimate.", "plant.x.")]
            assert np.abs(result[estimate] - truth)[late:].max() == pytest.approx(float(said), rel=0.1), (
                label,
                estimate,
            )


def settings(text: str) -> dict[str, str]:
    return dict(re.findall(r"--set (\S+)=([^\s`]+)", text))


def test_every_model_of_the_gallery_has_a_page_with_its_picture_and_its_file() -> None:
    assert GALLERY | {"docs/gallery/index.md"} == {name for name in PAGES if name.startswith("docs/gallery/")}
    for name in GALLERY:
        text, model = PAGES[name].read_text(encoding="utf-8"), Path(name).stem
        assert f"](../images/gallery_{model}.svg)" in text and f"](../../gallery/{model}.py)" in text
        assert f"]({model}.md)" in PAGES["docs/gallery/index.md"].read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PAGES)
def test_every_block_says_what_it_is(name: str) -> None:
    text = PAGES[name].read_text(encoding="utf-8")
    blocks = blocks_of(PAGES[name])
    assert len(re.findall(r"^ *```", text, flags=re.M)) == 2 * len(blocks)
    assert {block.language for block in blocks} <= LANGUAGES
    for block in blocks:
        if block.language == "yaml":
            said = re.findall(r"observer-fmus (\w+) ", str(yaml.safe_load(block.text)))
            assert said and set(said) <= set(VERBS)


@pytest.mark.long
def test_the_site_is_built_and_every_link_in_it_leads_somewhere(tmp_path: Path) -> None:
    need(imports("material"), "the extra `docs` is not installed here")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    build(load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(tmp_path)))
    pages = list(tmp_path.rglob("*.html"))
    assert {f"{name.removeprefix('docs/').removesuffix('.md')}.html" for name in PAGES if name != "README.md"} <= {
        str(page.relative_to(tmp_path)) for page in pages
    }
    loaded = r"<(?:script|img|link)[^>]*?(?:src|href)=\"?(https?:[^\"> ]*)"
    assert not [found for page in pages for found in re.findall(loaded, page.read_text(encoding="utf-8"))]


def test_the_figures_of_the_plant_that_is_an_fmu_are_those_of_its_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from figures_plant import SHOWN, figures_of, simulated

    rows = re.findall(
        r"^\| \w+ `[\w.]+` \| ([\d.]+) \S+ \| (\d+) % \|$", PAGES["docs/plant_fmu.md"].read_text(), flags=re.M
    )
    found = figures_of(simulated())
    for (largest, within), name in zip(rows, SHOWN, strict=True):
        assert found[name][0] == pytest.approx(float(largest), rel=0.05)
        assert round(100 * found[name][1]) == int(within)
