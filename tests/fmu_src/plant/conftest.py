"""Plants for model exchange, compiled once, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import plant_fmu
from fmu_src import PlantFMU
from once import compiled_once

Plants = Callable[..., Path]


@pytest.fixture
def plants(tmp_path: Path) -> Plants:
    """plants(kind, **choices) -> the FMU of that kind."""

    def write(kind: str, library: bytes | None = None, **choices: object) -> Path:
        return plant_fmu.write(tmp_path / f"{kind}.fmu", library or plant_fmu.library(), kind, **choices)  # type: ignore[arg-type]

    return write


@pytest.fixture
def modelled(plants: Plants) -> Callable[..., PlantFMU]:
    """modelled(kind, **choices) -> its Model: y is measured, the force known, the tunable parameter estimated."""

    def model(kind: str, **choices: object) -> PlantFMU:
        tunable, fixed = plant_fmu.PARAMETERS.get(kind, ("mu", "m"))
        given = {"outputs": ["y"], "inputs": ["force"], "unknown_parameters": [tunable]}
        if kind == "pendulum":
            given["parameters"] = [fixed]
        for name in ("outputs", "inputs", "parameters", "unknown_parameters", "attributes", "name", "redistribute"):
            if name in choices:
                given[name] = choices.pop(name)
        with compiled_once():
            return PlantFMU(plants(kind, **choices), **given)  # type: ignore[arg-type]

    return model
