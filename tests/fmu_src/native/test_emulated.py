"""The binaries for Windows and for Linux on ARM, under wine and qemu: the whole FMI call sequence, and the numbers of linux64."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import pytest

from build_fmus import SYSTEMS
from cosim.results import Result
from fmu_src.compliance.files.binaries import functions
from fmu_src.native import compiler as native
from once import once
from slave import Slave
from tools import ARM_ROOT, QEMU, WINE, need

pytestmark = pytest.mark.long  # zig compiles its C library for each platform once: a minute

DRIVER = Path(__file__).parent / "drive" / "drive.c"
# A system for every kind of observer, with its plant.
KINDS = (
    "gong_example_2",
    "gong_example_1_spline",
    "gong_example_4_tube",
    "gong_example_5_ukf",
    "gong_example_6",
    "james_baras_5_1",
    "chen_yen_short",
    "nikoukhah_motor",
    "nikoukhah_motor_regional",
    "nikoukhah_example_2_1",
    "calvillo_alamir_full",
)
# Two windows or four, of twelve: under qemu a sample takes more than 50 ms.
STOPS = {"gong_example_1_spline": 10.0, "gong_example_4_tube": 10.0}  # [s]
TOLERANCE = 1e-12  # of the variable's largest value
# The tube's interior point stops at a tolerance: a last bit of a cosine can cost or save it a step, and the refined bounds pass that on.
TOLERANCES = {"gong_example_4_tube": 1e-9}
# Roots of the normal matrix' inverse, which magnifies the last bit, 1e-16, that the platforms' sines differ by: where a window straddles a
# jump (gong_example_2 at 10.8 s) by the 1e5 of its conditioning, and nowhere by more than the 1e7 of the tuning's start value.
MAGNIFYING, MAGNIFIED = ("diagnostics.deviation", "diagnostics.std."), 1e-9
CONDITIONED = "tuning.conditioning_limit"  # of the observers that have such a matrix
ROUNDING = 1e-16  # a variable that is never larger, such as a violation of constraints that all hold, consists of rounding errors
# One line of arithmetic after the other, as the other kinds' C, but so many that a compiler takes minutes to optimise it for a platform.
LONG_IN_C = ("motor_canonical_dae_regional",)
NOT_OPTIMISED = ("-O0",)  # after the -O2: the last counts
Answers = list[list[str]]
Example = Callable[..., Result]


@dataclass(frozen=True)
class Machine:
    """What runs the program that makes FMI calls as on another platform, with variables of its environment."""

    platform: str
    suffix: str
    command: tuple[str, ...]
    environment: Mapping[str, str]

    def calls(self, library: Path, lines: Sequence[str], folder: Path, status: int = 0) -> Answers:
        """The program's answers, cut into words; it must end with `status`."""
        done = subprocess.run(
            [*self.command, str(library)],
            input="\n".join(lines) + "\n",
            capture_output=True,
            text=True,
            cwd=folder,
            env=os.environ | dict(self.environment),
        )
        assert done.returncode == status, done.stdout[-500:] + done.stderr[-500:]
        return [line.split() for line in done.stdout.splitlines()]


def _windows(folder: Path) -> Machine:
    need(WINE is not None, "wine64 is not installed here: make ci-tools")
    program = compiled_driver(folder, "x86_64-windows-gnu", "drive.exe")
    environment = {"WINEPREFIX": str(folder / "prefix"), "WINEDEBUG": "-all"}
    return Machine("win64", ".dll", (str(WINE), program), environment)


def _arm(folder: Path) -> Machine:
    need(
        QEMU is not None and ARM_ROOT.is_dir(), "qemu-user and libc6-arm64-cross are not installed here: make ci-tools"
    )
    program = compiled_driver(folder, "aarch64-linux-gnu.2.17", "drive", "-ldl")
    return Machine("aarch64-linux", ".so", (str(QEMU), "-L", str(ARM_ROOT), program), {})


Unpacked = Callable[[Machine, str], Path]
MACHINES = {"win64": _windows, "aarch64-linux": _arm}


def compiled_driver(folder: Path, target: str, name: str, *libraries: str) -> str:
    """The path of the test tool for another platform."""
    headers = Path(fmpy.__file__).parent / "c-code"
    cache = str(native.cache_folder())
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-std=c99", "-O1"]
    command += ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", str(headers), str(DRIVER), "-o", name, *libraries]
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    subprocess.run(command, cwd=folder, env=environment, check=True)
    return str(folder / name)


@pytest.fixture(scope="session", params=MACHINES)
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return MACHINES[request.param](tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="session")
def unpacked_for(catalogue_fmu: Callable[[str], Path], shared: Path) -> Unpacked:
    """The folder of the catalogue's FMU called `name`, with the library for that machine, of the same sources, beside this one's."""

    def unpacked(machine: Machine, name: str) -> Path:
        def fill(folder: Path) -> None:
            fmpy.extract(str(catalogue_fmu(name)), str(folder))
            identifier = fmpy.read_model_description(str(folder)).coSimulation.modelIdentifier
            library = folder / "binaries" / machine.platform / f"{identifier}{machine.suffix}"
            library.parent.mkdir()
            flags = NOT_OPTIMISED if name in LONG_IN_C else ()
            library.write_bytes(native.compile_library(identifier, folder / "sources", machine.platform, flags=flags))

        return once(shared / "emulated" / machine.platform / name, fill)

    return unpacked


def kind(fmu: Path) -> frozenset[str]:
    """What makes an FMU one of its kind: the tuning that it offers, and whether it has algebraic variables."""
    names = [v.name.split("[")[0].split(".") for v in fmpy.read_model_description(str(fmu)).modelVariables]
    return frozenset(
        ".".join(name[:2]) if name[0] == "tuning" else name[0] for name in names if name[0] in ("tuning", "z")
    )


def test_no_kind_of_plant_or_observer_is_forgotten(catalogue_fmu: Callable[[str], Path]) -> None:
    found: dict[frozenset[str], str] = {}
    for system in (*KINDS, *SYSTEMS):
        for fmu in SYSTEMS[system].fmus.values():
            found.setdefault(kind(catalogue_fmu(fmu)), system)
    assert set(found.values()) <= set(KINDS), found


def bits(value: float) -> str:
    return struct.pack(">d", value).hex()


class Element:
    """An element of a recorded system: the calls that repeat what the master did with it, and the numbers of then."""

    def __init__(self, machine: Machine, unpacked: Unpacked, system: str, name: str, result: Result):
        recipe = SYSTEMS[system]
        folder = unpacked(machine, recipe.fmus[name])
        description = fmpy.read_model_description(str(folder))
        identifier = description.coSimulation.modelIdentifier
        self.library = folder / "binaries" / machine.platform / f"{identifier}{machine.suffix}"
        self.variables = {v.name: v for v in description.modelVariables}
        self.step = recipe.step
        self.steps = len(result.time) - 1
        self._name, self._guid, self._result = name, description.guid, result
        self._parameters = recipe.parameters.get(name, {})
        ends = [(start, end.partition(".")) for start, end in recipe.connections]
        self._sources = {variable: start for start, (element, _, variable) in ends if element == name}
        outputs = [v for v in description.modelVariables if v.causality == "output"]
        self._reals = [v for v in outputs if v.type == "Real"]
        self._integers = [v for v in outputs if v.type in ("Integer", "Enumeration")]  # a Boolean follows from them

    def set(self, name: str, value: float) -> str:
        variable = self.variables[name]
        if variable.type == "Real":
            return f"setReal {variable.valueReference} {bits(value)}"
        return f"setInteger {variable.valueReference} {int(value)}"

    def instantiate(self) -> list[str]:
        return [f"instantiate {self._name} {self._guid}", "logging"]

    def initialise(self) -> list[str]:
        """From instantiated (or reset) to initialised, with the outputs read."""
        parameters = [self.set(name, value) for name, value in self._parameters.items()]
        setup = f"setup {bits(self._result.time[0])} {bits(self._result.time[-1])}"
        return [*parameters, setup, "enter", *self._inputs(0), "exit", *self._outputs()]

    def steps_from(self, first: int, last: int) -> list[str]:
        """Steps `first` to `last` - 1, each with its inputs before and its outputs after it."""
        calls = []
        for k in range(first, last):
            calls += [*self._inputs(k), f"step {bits(self._result.time[k])} {bits(self.step)}", *self._outputs()]
        return calls

    def _inputs(self, k: int) -> list[str]:
        return [self.set(variable, self._result[source][k]) for variable, source in self._sources.items()]

    def _outputs(self) -> list[str]:
        kinds = (("getReal", self._reals), ("getInteger", self._integers))
        return [" ".join([call, *(str(v.valueReference) for v in found)]) for call, found in kinds if found]

    def recorded(self) -> dict[str, np.ndarray]:
        """The master's numbers, (steps + 1,) by variable."""
        return {v.name: self._result[f"{self._name}.{v.name}"] for v in [*self._reals, *self._integers]}

    def read(self, answers: Answers) -> dict[str, np.ndarray]:
        """The numbers in the answers, likewise."""
        columns: dict[str, np.ndarray] = {}
        for kind, variables in (("real", self._reals), ("integer", self._integers)):
            rows = [[number(kind, text) for text in line[1:]] for line in answers if line[0] == kind]
            columns |= dict(zip((v.name for v in variables), np.array(rows).T, strict=True))
        return columns


def number(kind: str, text: str) -> float:
    return float(struct.unpack(">d", bytes.fromhex(text))[0]) if kind == "real" else float(text)


def values(answers: Answers) -> Answers:
    return [line for line in answers if line[0] in ("real", "integer")]


@pytest.mark.parametrize("name", ["plant", "observer"])
@pytest.mark.parametrize("system", KINDS)
def test_every_kind_of_observer_and_its_plant_give_linux64s_numbers_and_resume_from_a_file_bit_by_bit(
    system: str, name: str, unpacked_for: Unpacked, example: Example, machine: Machine, tmp_path: Path
) -> None:
    element = Element(machine, unpacked_for, system, name, example(system, stop=STOPS.get(system)))
    half = element.steps // 2
    first = machine.calls(
        element.library,
        [
            *("version", *element.instantiate(), *element.initialise(), *element.steps_from(0, half), "save state.bin"),
            *(*element.steps_from(half, element.steps), "terminate", "free"),
        ],
        tmp_path,
    )
    assert first[0] == ["version", "2.0", "default"]
    found, wanted = element.read(first), element.recorded()
    for variable, column in wanted.items():
        tolerance = TOLERANCES.get(system, TOLERANCE)
        if CONDITIONED in element.variables and variable.startswith(MAGNIFYING):
            tolerance = max(tolerance, MAGNIFIED)
        limit = max(tolerance * np.abs(column).max(), ROUNDING)
        np.testing.assert_allclose(found[variable], column, rtol=0, atol=limit, err_msg=variable)

    resumed = machine.calls(
        element.library,
        [
            *(*element.instantiate(), *element.initialise(), "load state.bin"),
            *(*element.steps_from(half, element.steps), "terminate", "reset", *element.initialise()),
            *(*element.steps_from(0, 3), "terminate", "free"),
        ],
        tmp_path,
    )
    per_point = len(values(first)) // (element.steps + 1)
    whole, again = values(first), values(resumed)[per_point:]
    second_half = (element.steps - half) * per_point
    assert again[:second_half] == whole[(half + 1) * per_point :]
    assert again[second_half:] == whole[: 4 * per_point]


def test_all_functions_of_the_standard_are_exported(unpacked_for: Unpacked, machine: Machine, tmp_path: Path) -> None:
    library = unpacked_for(machine, "duffing") / "binaries" / machine.platform / f"duffing{machine.suffix}"
    names = sorted(functions("CoSimulation"))
    answers = machine.calls(
        library, [f"exported {name}" for name in [*names, "duffing_component", "duffing_flow"]], tmp_path
    )
    assert answers == [["exported", "1"]] * len(names) + [["exported", "0"]] * 2


def test_input_derivatives_act_as_on_linux64(
    unpacked_for: Unpacked, example: Example, machine: Machine, catalogue_slave: Callable[..., Slave], tmp_path: Path
) -> None:
    linux, recorded = catalogue_slave("duffing"), example(KINDS[0])
    element = Element(machine, unpacked_for, KINDS[0], "plant", recorded)
    reference = {name: element.variables[name].valueReference for name in ("u", "x.x1", "x.x2")}
    linux.initialize(SYSTEMS[KINDS[0]].parameters["plant"], stop=30.0)
    calls, expected = [*element.instantiate(), *element.initialise()], []
    for k in range(20):
        linux.fmu.setRealInputDerivatives([reference["u"]], [1], [1.0 + k])
        linux.step(0.1 * k, 0.1)
        expected.append([linux.get("x.x1"), linux.get("x.x2")])
        calls += [f"setDerivative {reference['u']} {bits(1.0 + k)}", f"step {bits(0.1 * k)} {bits(0.1)}"]
        calls += [f"getReal {reference['x.x1']} {reference['x.x2']}"]
    answers = [line for line in machine.calls(element.library, [*calls, "free"], tmp_path) if len(line) == 3]
    found = [[number("real", text) for text in line[1:]] for line in answers if line[0] == "real"]
    np.testing.assert_allclose(found, expected, rtol=TOLERANCE)
    assert abs(expected[-1][0] - recorded["plant.x.x1"][20]) > 0.01  # the derivatives do act


def test_a_refused_call_is_an_error_with_a_message_and_not_a_crash(
    unpacked_for: Unpacked, example: Example, machine: Machine, tmp_path: Path
) -> None:
    element = Element(machine, unpacked_for, KINDS[0], "observer", example(KINDS[0]))
    wrong = machine.calls(element.library, ["instantiate observer {wrong}"], tmp_path, status=1)
    assert wrong[0][:4] == ["log", "observer", "3", "logStatusError"] and wrong[-1] == ["failed", "instantiate", "3"]
    ready = [*element.instantiate(), *element.initialise(), *element.steps_from(0, 3)]
    backward = machine.calls(element.library, [*ready, f"step {bits(0.0)} {bits(0.1)}"], tmp_path, status=1)
    assert backward[-2][:4] == ["log", "observer", "3", "logStatusError"] and backward[-1] == ["failed", "step", "3"]
