"""Systems that tests write to files, and change in ways in which the writer would not."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

from cosim.fmu import Value
from cosim.system import Element, System, write_ssp
from cosim.system.ssp_files import STRUCTURE


def coupled(
    built: Callable[[str], Path], plant: Mapping[str, Value] | None = None, toy: Mapping[str, Value] | None = None
) -> System:
    """A noisy plant that drives a sampled component."""
    noise = {"sensor.noise_bound": 0.1, "sensor.sample_time": 0.1}
    elements = {
        "plant": Element(built("duffing"), noise | dict(plant or {})),
        "toy": Element(built("sampled_toy"), dict(toy or {})),
    }
    return System("coupled", elements, [("plant.y", "toy.y")], stop=5.0, step=0.1)


def written(system: System, folder: Path) -> Path:
    path = folder / f"{system.name}.ssp"
    write_ssp(system, path)
    return path


def edited(path: Path, edit: Callable[[str], str], name: str) -> Path:
    """A copy of the .ssp file whose SystemStructure.ssd went through `edit`."""
    target = path.with_name(f"{name}.ssp")
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as archive:
        for member in source.namelist():
            content = source.read(member)
            archive.writestr(member, edit(content.decode()) if member == STRUCTURE else content)
    return target
