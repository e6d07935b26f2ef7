"""PythonFMUs, built once, where the tests of the folder above have native ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from components import COMPONENTS
from fmu_src import export
from once import once

Path_of = Callable[[str], Path]


@pytest.fixture(scope="session")
def python_fmus(shared: Path) -> Path_of:
    """The path of the PythonFMU called `name`, one of COMPONENTS, built at the first call."""

    def make(name: str) -> Path:
        folder = once(shared / "python" / name, lambda folder: export(COMPONENTS[name](), folder, target="python"))
        return next(folder.glob("*.fmu"))

    return make


@pytest.fixture(scope="session")
def unpacked(python_fmus: Path_of, shared: Path) -> Path_of:
    """The folder with the contents of the PythonFMU called `name`."""

    def unpack(name: str) -> Path:
        fmu = python_fmus(name)
        return once(shared / "python_unpacked" / name, lambda folder: fmpy.extract(str(fmu), str(folder)))

    return unpack
