"""What the tests of built FMUs share: each FMU is built once a session, when it is first asked for, by whichever process asks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import fmpy
import pytest

import strict_fmu
from build_fmus import FMUS, SYSTEMS, Build, build_all
from components import COMPONENTS, STRAIGHT
from cosim.master import run
from cosim.results import Result
from cosim.system import Element, System, write_ssp
from fmu_src import export
from observers.pseudospectral import pseudospectral
from once import compiled_once, once, plotted_briefly
from reference_models.duffing import DUFFING
from slave import Slave
from tools import TESTS, imports, need

Paths = Callable[[str], Path]
# What takes minutes, most first: begun last it would keep one processor busy and leave the others idle. One process runs it in this
# order, while the others take the rest from the end, so that what these files make for all their tests is made once.
LONGEST = (
    "fuzz/test_fuzz.py",
    "fmu_src/native/test_emulated.py",
    "fmu_src/native/test_other_targets.py",
    "fmu_src/native/test_time.py",
    "fmu_src/native/test_catalogue_sources.py",
    "fmu_src/python/test_python_target.py",
    "test_catalogue.py",
)
# Of the catalogue, what the tests that run in CI only run for so long that optimising it saves time.
LONG_RUNS = ("duffing_known_pseudospectral_tube", "van_der_pol_signed_elementary")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first."""
    place = {TESTS / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(LONGEST)))


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of this session that all its processes see: a worker of pytest-xdist has its own base folder in the session's."""
    base = tmp_path_factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"


@pytest.fixture(scope="session")
def built(shared: Path) -> Paths:
    """The path of the FMU called `name`, one of COMPONENTS, built for this machine at the first call."""

    def fill(name: str, folder: Path) -> None:
        with compiled_once(optimised=name not in STRAIGHT):
            export(COMPONENTS[name](), folder)

    def build(name: str) -> Path:
        return next(once(shared / "components" / name, partial(fill, name)).glob("*.fmu"))

    return build


@pytest.fixture(scope="session")
def duffing_system(built: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A system file: the Duffing plant and its pseudospectral observer, 5 s in steps of 0.1 s."""
    folder = tmp_path_factory.mktemp("duffing_system")
    with compiled_once(optimised=False):
        observer = export(pseudospectral(DUFFING, sample_time=0.1, N=15), folder)
    elements = {"plant": Element(built("duffing")), "observer": Element(observer, {"guess.x1": 0.5})}
    system = System("duffing_system", elements, [("plant.y", "observer.y")], stop=5.0, step=0.1)
    write_ssp(system, folder / "duffing_system.ssp")
    return folder / "duffing_system.ssp"


@pytest.fixture(scope="session")
def unpacked(built: Paths, shared: Path) -> Paths:
    """The folder with the contents of the FMU called `name`."""
    return lambda name: once(shared / "unpacked" / name, lambda folder: fmpy.extract(str(built(name)), str(folder)))


@pytest.fixture
def slave(unpacked: Paths) -> Iterator[Callable[..., Slave]]:
    """Makes instances of the FMU called `name`; afterwards each is freed and must have given all its memory back."""
    yield from _instances(unpacked)


def _instances(unpacked: Paths) -> Iterator[Callable[..., Slave]]:
    made: list[Slave] = []

    def make(name: str, **options: Any) -> Slave:
        made.append(Slave(unpacked(name), **options))
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.freeInstance()
        assert not instance.blocks


@pytest.fixture(scope="session")
def catalogue_fmu(shared: Path) -> Paths:
    """The path of the catalogue's FMU called `name`, built at the first call, not optimised but for LONG_RUNS in CI.

    What optimisation could change is asked of the FMUs that `built` gives, whose shell is the same, and, of each kind of model, by
    test_emulated.py, whose optimised libraries must give the numbers of these, and by test_catalogue_sources.py.
    """

    def fill(name: str, folder: Path) -> None:
        optimised = name in LONG_RUNS and "CI" in os.environ
        with compiled_once(optimised), plotted_briefly():
            build_all(Build(fmus={name: FMUS[name]}), folder, ["host"])

    def fmu(name: str) -> Path:
        return once(shared / "fmus" / name, partial(fill, name)) / f"{name}.fmu"

    return fmu


@pytest.fixture(scope="session")
def catalogue_system(catalogue_fmu: Paths, shared: Path) -> Paths:
    """The path of the catalogue's system called `name`, in a folder `systems`; its FMUs are in the folder `fmus` beside that."""

    def system(name: str) -> Path:
        def fill(folder: Path) -> None:
            fmus = folder / "fmus"
            fmus.mkdir()
            for fmu in set(SYSTEMS[name].fmus.values()):
                (fmus / f"{fmu}.fmu").symlink_to(catalogue_fmu(fmu))
            build_all(Build(systems={name: SYSTEMS[name]}), fmus, ["host"])

        return once(shared / "systems" / name, fill) / "systems" / f"{name}.ssp"

    return system


@pytest.fixture(scope="session")
def example(catalogue_system: Paths) -> Callable[..., Result]:
    """Runs a system of the catalogue, each variant once in a process."""
    made: dict[str, Result] = {}

    def result(name: str, **options: object) -> Result:
        key = f"{name} {options}"
        if key not in made:
            made[key] = run(catalogue_system(name), **options)  # type: ignore[arg-type]
        return made[key]

    return result


@pytest.fixture
def catalogue_slave(catalogue_fmu: Paths, shared: Path) -> Iterator[Callable[..., Slave]]:
    """Makes instances of the catalogue's FMU called `name`; afterwards each is freed and must have given all its memory back."""

    def unpacked(name: str) -> Path:
        fmu = catalogue_fmu(name)
        return once(shared / "fmus_unpacked" / name, lambda folder: fmpy.extract(str(fmu), str(folder)))

    yield from _instances(unpacked)


@pytest.fixture(scope="session")
def other_masters() -> None:
    """Ecos and libcosim are installed."""
    for name, package in (("ecos", "ecospy"), ("libcosim", "libcosimpy")):
        need(imports(package), f"{name} is not installed here: see docs/masters.md")


@pytest.fixture(scope="session")
def strict_library(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return strict_fmu.compiled(tmp_path_factory.mktemp("strict"))


@pytest.fixture
def strict(strict_library: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Writes an FMU called `name` of strict/strict.c; the other arguments as of `strict_fmu.description`.

    It writes into the working directory, which is a folder of the test's own.
    """
    monkeypatch.chdir(tmp_path)
    return lambda name="strict", **choices: strict_fmu.write(tmp_path / f"{name}.fmu", strict_library, **choices)
