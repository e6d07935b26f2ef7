"""The gallery on the command line: what there is, and a copy to start from."""

from __future__ import annotations

from pathlib import Path

import pytest

import gallery
from build_fmus import build_of
from verbs import observer_fmus, refused

FILES = sorted(Path(gallery.__file__).parent.glob("[a-z]*.py"))


def test_without_a_name_the_gallery_is_listed() -> None:
    listed = observer_fmus("gallery")
    assert listed.exit_code == 0
    assert [line.split()[0] for line in listed.output.splitlines() if line[:1].isalpha()] == [
        path.stem for path in FILES
    ]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_copy_is_the_model_with_its_plant_its_observer_and_its_source_connected(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert observer_fmus("gallery", file.stem).output.startswith(f"{file.name}: now observer-fmus build")
    assert (tmp_path / file.name).read_bytes() == file.read_bytes()
    (system,) = build_of(Path(file.name)).systems.values()
    assert set(system.fmus) == {"plant", "observer", "source"}
    assert system.fmus["plant"] == file.stem


def test_nothing_is_overwritten_and_a_wrong_name_finds_the_right_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lithium_cell.py").write_text("mine")
    assert "lithium_cell.py: is there already" in refused(observer_fmus("gallery", "lithium_cell"))
    assert "'quadruple_tank'" in refused(observer_fmus("gallery", "quadruple_tanks"))
    assert [path.name for path in tmp_path.iterdir()] == ["lithium_cell.py"]
    assert (tmp_path / "lithium_cell.py").read_text() == "mine"
