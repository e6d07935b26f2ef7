"""Drives an FMU natively: the FMU unpacked, the C driver compiled and run."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from benchmarks.compiler import FMI_HEADERS, compile_c
from benchmarks.errors import BenchmarkError
from cosim.fmu import read_description
from fmu_src.platforms import PLATFORMS, resolve

SOURCE = Path(__file__).with_name("driver.c")


@dataclass(frozen=True)
class Unpacked:
    """The FMU unpacked in `directory`; `library` is its binary for this machine."""

    directory: Path
    description: ModelDescription
    library: Path

    def variable(self, name: str) -> ModelVariable:
        """The variable called `name`. Raises BenchmarkError when there is none."""
        for variable in self.description.modelVariables:
            if variable.name == name:
                return variable
        raise BenchmarkError(f"the FMU {self.description.modelName} has no variable '{name}'")

    def references(self, names: Iterable[str]) -> list[int]:
        """The value references of the variables called `names`."""
        return [self.variable(name).valueReference for name in names]


@dataclass(frozen=True)
class Experiment:
    """What is done with an FMU: `samples` go to its `input` in steps of `step` [s], `outputs` are read after each.

    `samples` is (n,) for one input, (n, m) for a tuple of m. `start`: parameters set before initialisation.
    """

    samples: np.ndarray
    step: float
    input: str | tuple[str, ...]
    outputs: Sequence[str]
    start: Mapping[str, float]

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs' names."""
        return (self.input,) if isinstance(self.input, str) else self.input


@dataclass(frozen=True)
class Run:
    """`ns` per sample of each run, (runs,); `record`: the outputs after each step of the last run, (n, outputs)."""

    ns: np.ndarray
    record: np.ndarray


def unpack(fmu: Path, directory: Path) -> Unpacked:
    """Unpack `fmu` into `directory`. Raises BenchmarkError when it has no binary for this machine."""
    description = read_description(fmu)
    fmpy.extract(str(fmu), str(directory))
    platform = resolve(["host"])[0]
    library = (
        directory / "binaries" / platform / f"{description.coSimulation.modelIdentifier}{PLATFORMS[platform].suffix}"
    )
    if not library.is_file():
        raise BenchmarkError(f"{fmu} has no binary for {platform}")
    return Unpacked(directory, description, library)


def build_driver(directory: Path) -> Path:
    """The driver, compiled into `directory`. Raises BenchmarkError where there is no dlopen."""
    platform = resolve(["host"])[0]
    if platform == "win64":
        raise BenchmarkError(
            "the native driver loads the FMU with dlopen, which Windows lacks: run the benchmarks on Linux or macOS"
        )
    driver = directory / "driver"
    compile_c([SOURCE], driver, "-I", FMI_HEADERS, "-ldl")
    return driver


def command(
    driver: Path, fmu: Unpacked, library: Path, experiment: Experiment, runs: int, directory: Path
) -> list[str]:
    """Drives `library` through `experiment` `runs` times; its samples and its record are files in `directory`."""
    samples = directory / "samples.bin"
    np.ascontiguousarray(experiment.samples, dtype=float).tofile(samples)
    return [
        str(driver),
        str(library.resolve()),
        fmu.description.guid,
        repr(float(experiment.step)),
        str(runs),
        str(samples),
        str(directory / "record.bin"),
        ",".join(map(str, fmu.references(experiment.inputs))),
        ",".join(map(str, fmu.references(experiment.outputs))),
        (fmu.directory / "resources").resolve().as_uri(),
        *(
            f"{reference}={float(experiment.start[name])!r}"
            for name, reference in zip(experiment.start, fmu.references(experiment.start), strict=True)
        ),
    ]


def drive(driver: Path, fmu: Unpacked, experiment: Experiment, runs: int) -> Run:
    """Drive the FMU's own binary through `experiment` `runs` times.

    Raises:
        BenchmarkError: the FMU failed; the message is the driver's.
    """
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch)
        printed = execute(command(driver, fmu, fmu.library, experiment, runs, directory))
        record = np.fromfile(directory / "record.bin").reshape(len(experiment.samples), len(experiment.outputs))
    return Run(np.array([float(line) for line in printed.split()]), record)


def execute(arguments: Sequence[str]) -> str:
    """What the command prints. Raises BenchmarkError with its messages when it fails."""
    result = subprocess.run(arguments, capture_output=True, text=True)
    if result.returncode != 0:
        raise BenchmarkError(f"{Path(arguments[0]).name} failed: {(result.stderr or result.stdout).strip()}")
    return result.stdout
