"""What the tests of built FMUs share: each is built once per session, and driven through fmpy, messages recorded."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

import linear_models
import moving_window
from build_fmus import build_all, choose
from cosim.master import run
from cosim.results import Result
from cosim.system import Element, System, write_ssp
from fmu_src import export
from observers.component import Component
from observers.pseudospectral import pseudospectral
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.gong_2007 import rlc
from reference_models.plant import plant
from tools import imports, need
from toys import draining_toy, feedthrough_toy, growing_toy, sampled_toy

COMPONENTS: dict[str, Callable[[], Component]] = {
    "sampled_toy": sampled_toy,
    "feedthrough_toy": feedthrough_toy,
    "growing_toy": growing_toy,
    "draining_toy": draining_toy,
    "rlc": rlc,
    "duffing": lambda: plant(DUFFING, jumps={"theta": 2}),
    "duffing_segments": lambda: pseudospectral(DUFFING, sample_time=0.1, N=7, L=8, segments=4, name="duffing_segments"),
    "linear_arrival": lambda: pseudospectral(
        moving_window.linear(),
        sample_time=0.1,
        N=10,
        L=4,
        segments=2,
        arrival_cost=True,
        measurement_noise={"y1": 0.3, "y2": 0.5},
        name="linear_arrival",
    ),
    "rotation_bounded": lambda: pseudospectral(
        moving_window.rotation(), sample_time=0.2, N=12, L=10, name="rotation_bounded"
    ),
    "duffing_missing_ukf": lambda: ukf(DUFFING, sample_time=0.1, measurement_noise={"y": 1e-3}, name="duffing_ukf"),
    "linear_3_least_squares": lambda: linear_models.least_squares(3),
    **{f"linear_{n}_riccati": partial(linear_models.riccati, n) for n in range(1, linear_models.LARGEST + 1)},
}


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The path of the FMU called `name`, one of COMPONENTS, built for this machine at the first call."""
    folder = tmp_path_factory.mktemp("fmus")
    made: dict[str, Path] = {}

    def build(name: str) -> Path:
        if name not in made:
            made[name] = export(COMPONENTS[name](), folder)
        return made[name]

    return build


@pytest.fixture(scope="session")
def duffing_system(built: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A system file: the Duffing plant and its pseudospectral observer, 5 s in steps of 0.1 s."""
    folder = tmp_path_factory.mktemp("duffing_system")
    observer = export(pseudospectral(DUFFING, sample_time=0.1), folder)
    elements = {"plant": Element(built("duffing")), "observer": Element(observer, {"guess.x1": 0.5})}
    system = System("duffing_system", elements, [("plant.y", "observer.y")], stop=5.0, step=0.1)
    write_ssp(system, folder / "duffing_system.ssp")
    return folder / "duffing_system.ssp"


class Slave:
    """An instance of an FMU: variables by name, calls by fmpy, messages (status, category, text), memory counted."""

    def __init__(self, folder: Path, name: str = "instance", guid: str | None = None, logging: bool = True):
        description = fmpy.read_model_description(str(folder))
        self.variables = {v.name: v for v in description.modelVariables}
        self.messages: list[tuple[int, str, str]] = []
        self.blocks: set[int] = set()
        self.fmu = FMU2Slave(
            guid=guid or description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        libc = ctypes.CDLL(None)
        libc.calloc.restype = ctypes.c_void_p
        libc.calloc.argtypes = [ctypes.c_size_t, ctypes.c_size_t]
        libc.free.argtypes = [ctypes.c_void_p]

        def log(_: Any, __: bytes, status: int, category: bytes, message: bytes) -> None:
            self.messages.append((status, category.decode(), message.decode()))

        def allocate(count: int, size: int) -> int:
            block: int = libc.calloc(count, size)
            self.blocks.add(block)
            return block

        def free(block: int) -> None:
            self.blocks.remove(block)
            libc.free(block)

        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(log)
        self.callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(allocate)
        self.callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        self.fmu.instantiate(callbacks=self.callbacks, loggingOn=logging)

    def initialize(self, start: Mapping[str, float] | None = None, t0: float = 0.0, stop: float | None = None) -> Slave:
        for name, value in (start or {}).items():
            self.set(name, value)
        self.fmu.setupExperiment(startTime=t0, stopTime=stop)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, name: str, value: float) -> None:
        variable = self.variables[name]
        if variable.type == "Real":
            self.fmu.setReal([variable.valueReference], [value])
        elif variable.type == "Boolean":
            self.fmu.setBoolean([variable.valueReference], [bool(value)])
        else:
            self.fmu.setInteger([variable.valueReference], [int(value)])

    def get(self, name: str) -> float:
        variable = self.variables[name]
        read = {"Real": self.fmu.getReal, "Boolean": self.fmu.getBoolean}.get(variable.type, self.fmu.getInteger)
        return float(read([variable.valueReference])[0])

    def outputs(self) -> dict[str, float]:
        """All outputs and shown variables."""
        return {name: self.get(name) for name, v in self.variables.items() if v.initial == "calculated"}

    def step(self, t: float, h: float) -> None:
        self.fmu.doStep(t, h)

    def refuses(self, call: Callable[[], object]) -> str:
        """The one message with which `call` is refused with fmi2Error."""
        self.messages.clear()
        with pytest.raises(FMICallException) as caught:
            call()
        assert caught.value.status == 3, caught.value
        assert [(status, category) for status, category, _ in self.messages] == [(3, "logStatusError")]
        return self.messages[0][2]

    def state(self) -> bytes:
        """The serialised state."""
        handle = self.fmu.getFMUState()
        content = bytes(self.fmu.serializeFMUState(handle))
        self.fmu.freeFMUState(handle)
        return content


@pytest.fixture(scope="session")
def unpacked(built: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder with the contents of the FMU called `name`."""
    made: dict[str, Path] = {}

    def unpack(name: str) -> Path:
        if name not in made:
            made[name] = Path(fmpy.extract(str(built(name)), str(tmp_path_factory.mktemp(name))))
        return made[name]

    return unpack


@pytest.fixture
def slave(unpacked: Callable[[str], Path]) -> Iterator[Callable[..., Slave]]:
    """Makes instances of the FMU called `name`; afterwards each is freed and must have given all its memory back."""
    made: list[Slave] = []

    def make(name: str, **options: Any) -> Slave:
        made.append(Slave(unpacked(name), **options))
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.freeInstance()
        assert not instance.blocks


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the whole catalogue: `fmus/` and `systems/`."""
    folder = tmp_path_factory.mktemp("catalogue")
    build_all(choose([]), folder / "fmus", ["host"])
    return folder


@pytest.fixture(scope="session")
def example(catalogue: Path) -> Callable[..., Result]:
    """Runs a system of the catalogue, each variant once."""
    made: dict[str, Result] = {}

    def result(name: str, **options: object) -> Result:
        key = f"{name} {options}"
        if key not in made:
            made[key] = run(catalogue / "systems" / f"{name}.ssp", **options)  # type: ignore[arg-type]
        return made[key]

    return result


@pytest.fixture
def catalogue_slave(catalogue: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Slave]]:
    """Makes instances of the catalogue's FMU called `name`; afterwards each is freed and must have given all its memory back."""
    folders: dict[str, Path] = {}
    made: list[Slave] = []

    def make(name: str) -> Slave:
        if name not in folders:
            folder = tmp_path_factory.mktemp(name)
            folders[name] = Path(fmpy.extract(str(catalogue / "fmus" / f"{name}.fmu"), str(folder)))
        made.append(Slave(folders[name]))
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.freeInstance()
        assert not instance.blocks


@pytest.fixture(scope="session")
def other_masters() -> None:
    """Ecos and libcosim are installed."""
    for name, package in (("ecos", "ecospy"), ("libcosim", "libcosimpy")):
        need(imports(package), f"{name} is not installed here: see docs/masters.md")
