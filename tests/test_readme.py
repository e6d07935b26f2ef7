"""The README's example runs as printed; what the documentation lists is all there is."""

import re
from pathlib import Path

import pytest

from build_fmus import SYSTEMS

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_observer_of_the_readme_finds_the_friction(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.S)
    exec("\n".join(blocks), {})
    assert float(capsys.readouterr().out.splitlines()[-1]) == pytest.approx(0.2, abs=1e-4)


def test_every_file_that_the_readme_links_to_exists() -> None:
    links = [target for target in re.findall(r"\]\(([^)]+)\)", README) if "://" not in target]
    assert links
    for target in links:
        assert (Path(__file__).parents[1] / target).exists(), target


def test_the_documentation_lists_every_system() -> None:
    page = (Path(__file__).parents[1] / "docs" / "systems.md").read_text(encoding="utf-8")
    rows = "\n".join(line for line in page.splitlines() if line.startswith("|"))
    assert set(re.findall(r"`(\w+)\.ssp`", rows)) == set(SYSTEMS)
