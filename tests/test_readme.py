"""The README's model finds its friction; what the documentation names, links to or imports is there."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from build_fmus import FMUS, SYSTEMS
from commands.app import VERBS
from fmu_src.compliance.rules import DYNAMIC, STATIC
from observers.instance import Instance

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md")]
PAGES += [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "reference_models/data/README.md"]
TEXTS = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in PAGES}
README = TEXTS["README.md"]
GALLERY = [path.stem for path in (ROOT / "gallery").glob("[a-z]*.py")]
# What the changelog says is gone may be named there.
NOW = {name: text for name, text in TEXTS.items() if name != "CHANGELOG.md"}

FENCED = re.compile(r"^ *```(\w*)[^\n]*\n(.*?)```", flags=re.S | re.M)
GONE = re.compile(
    r"python -m (cosim(?!\.masters)|fmu_src\.compliance)"
    r"|\b(nikoukhah|james_baras|chen_yen|calvillo_alamir)\("
    r"|\bmodel\.<|cosim\.ssp\b|cosim\.campaign_report|_dae_observer|\bspec/"
)


def blocks(text: str, language: str) -> list[str]:
    return [content for named, content in FENCED.findall(text) if named == language]


def anchors(text: str) -> set[str]:
    """The headings of a page as links name them."""
    heads = re.findall(r"^#+ (.*)$", FENCED.sub("", text), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def test_the_observer_of_the_readme_finds_the_friction() -> None:
    made: dict[str, Any] = {}
    exec("\n".join(blocks(README, "python")), made)
    run, truth = Instance(made["observer"]), Instance(made["true_system"])
    for k in range(60):
        run.set("y", truth.get("y"))
        truth.step(0.05 * k, 0.05)
        run.step(0.05 * k, 0.05)
    assert run.get("estimate.friction") == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("page", TEXTS)
def test_every_link_leads_to_something(page: str) -> None:
    folder = (ROOT / page).parent
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCED.sub("", TEXTS[page])):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = folder / path if path else ROOT / page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file.read_text(encoding="utf-8")), target


@pytest.mark.parametrize("page", NOW)
def test_every_file_of_the_project_that_is_named_is_there(page: str) -> None:
    named = re.findall(
        r"\b((?:tests|docs|benchmarks)/[\w/]*\.py|(?:tests|reference_models|fmu_src|cosim|observers)/[\w/]+/)",
        NOW[page],
    )
    for name in named:
        assert (ROOT / name).exists(), name
    for name in re.findall(r"python ([\w/.]+\.py)", NOW[page]):
        assert (ROOT / name).is_file(), name
    for name in re.findall(r"python -m ([\w.]+)", NOW[page]):
        assert importlib.util.find_spec(name), name


@pytest.mark.parametrize("page", TEXTS)
def test_every_import_of_a_python_block_is_there(page: str) -> None:
    for block in blocks(TEXTS[page], "python"):
        compile(block, page, "exec")
        for module, names in re.findall(r"^\s*from ([\w.]+) import ([\w, ]+)", block, flags=re.M):
            if module.partition(".")[0] in (
                "ecospy",
                "libcosimpy",
            ):  # of the extra `masters`; tests/cosim/masters/ runs these
                continue
            for name in names.split(","):
                assert hasattr(importlib.import_module(module), name.strip()), f"from {module} import {name}"


@pytest.mark.parametrize("page", NOW)
def test_every_command_is_one(page: str) -> None:
    for word in re.findall(
        r"observer-fmus ([a-z]\w*)", "\n".join(re.findall(r"`[^`]+`|```.*?```", NOW[page], flags=re.S))
    ):
        assert word in VERBS, word
    for name in re.findall(r"(?:build_fmus\.py|observer-fmus build)(?: --only (\w+))+", NOW[page]):
        assert name in FMUS or name in SYSTEMS, name
    for name in re.findall(r"\bsystems/(\w+)\.ssp", NOW[page]):
        assert name in SYSTEMS or name.startswith(("pendulum", *GALLERY)), name  # of the reader, of the gallery


@pytest.mark.parametrize("page", NOW)
def test_nothing_is_called_as_it_was(page: str) -> None:
    assert not [found.group() for found in GONE.finditer(NOW[page])]


def test_the_scripts_that_draw_the_pictures_find_what_they_import(tmp_path: Path) -> None:
    scripts = sorted(path.stem for path in (ROOT / "docs").glob("figures*.py"))
    program = f"import sys; sys.path[0] = {str(ROOT / 'docs')!r}; import {', '.join(scripts)}"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True)


def test_the_page_says_how_many_rules_there_are() -> None:
    assert f"against {len(STATIC) + len(DYNAMIC)} rules" in TEXTS["docs/compliance.md"]


def test_every_folder_is_where_the_guide_says() -> None:
    tree = TEXTS["CONTRIBUTING.md"].split("## What is where")[1].split("```")[1]
    top = "."
    for line in tree.strip().splitlines():
        names = re.findall(r"(?:^|[ ;])([\w.]+/|[\w]+\.py)(?=[ ,:;(]|$)", line)
        if not line.startswith(" "):
            top = names[0]
            assert (ROOT / top).exists(), top
        for name in names:
            assert (ROOT / name).exists() or any((ROOT / top).rglob(name.rstrip("/"))), name
    rooms = {path.parent.name for path in (ROOT / "observers").glob("*/__init__.py")}
    rooms |= {path.parent.name for package in ("cosim", "fmu_src") for path in (ROOT / package).glob("*/__init__.py")}
    assert not [room for room in rooms if f"{room}/" not in tree]


def test_the_documentation_lists_every_system() -> None:
    rows = "\n".join(line for line in TEXTS["docs/systems.md"].splitlines() if line.startswith("|"))
    assert set(re.findall(r"`(\w+)\.ssp`", rows)) == set(SYSTEMS)
