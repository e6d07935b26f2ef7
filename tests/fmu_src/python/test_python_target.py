"""PythonFMUs: every promise of the native shell, the native FMU's numbers, and models that no C can be written for."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree
from scipy.integrate import solve_ivp

from build_fmus import SYSTEMS, build_all, choose
from components import COMPONENTS
from cosim.master import run as run_system
from fmu_src import ExportError, export
from fmu_src.native.compiler import compile_library
from fmu_src.python import target
from fmu_src.python.target import CAPABILITIES
from observers.instance import Instance
from observers.model import Model, Variable
from once import plotted_briefly
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from slave import Slave
from test_emulated import KINDS
from test_lifecycle import (  # noqa: F401  and these, where both targets say the same
    test_a_count_that_an_earlier_state_takes_back_warns_when_it_rises_again,
    test_a_state_saved_anywhere_is_taken_up_anywhere,
    test_after_a_reset_nothing_of_before_acts,
    test_counters_warn_with_their_name_value_and_time,
    test_derivatives_belong_to_the_inputs_they_were_set_for,
    test_logging_tells_what_was_chosen_last_and_after_a_reset_what_was_chosen_first,
    test_the_end_of_the_run_is_reached_but_not_passed,
)
from test_shell import *  # noqa: F403  its tests run here once more, on the FMUs of the fixture below
from test_shell import CASES, grid
from tools import ROOT, few, need

counted = test_what_a_step_takes_is_counted_from_where_the_run_is  # noqa: F405
del test_what_a_step_takes_is_counted_from_where_the_run_is  # noqa: F821
# A PythonFMU's memory is Python's, as its model description says: the importer's callbacks serve nothing.
del test_memory_that_is_refused_is_an_answer  # noqa: F821

Path_of = Callable[[str], Path]


@pytest.mark.parametrize("name", few(COMPONENTS, 5))
def test_fmpy_finds_nothing_wrong(python_fmus: Path_of, name: str) -> None:
    assert validate_fmu(str(python_fmus(name))) == []


@pytest.mark.parametrize("name", few(COMPONENTS, 5))
def test_the_description_is_the_native_one_but_for_what_must_differ(
    python_fmus: Path_of, built: Path_of, name: str
) -> None:
    def described(path: Path) -> tuple[etree._Element, dict[str, str]]:
        with zipfile.ZipFile(path) as archive:
            root = etree.fromstring(archive.read("modelDescription.xml"), etree.XMLParser(remove_blank_text=True))
        simulation = root.find("CoSimulation")
        capabilities = dict(simulation.attrib)
        del root.attrib["guid"]
        root.remove(simulation)
        return root, capabilities

    python, native = described(python_fmus(name)), described(built(name))
    assert etree.tostring(python[0]) == etree.tostring(native[0])
    assert python[1] == native[1] | CAPABILITIES
    assert native[1] != python[1]


def test_same_component_same_bytes_in_another_process(python_fmus: Path_of, tmp_path: Path) -> None:
    script = "import sys; sys.path[:0] = {!r}; from toys import sampled_toy; from fmu_src import export; "
    script += "export(sampled_toy(), {!r}, target='python')"
    subprocess.run(
        [sys.executable, "-c", script.format([str(ROOT / "tests"), str(ROOT)], str(tmp_path))],
        env=os.environ | {"PYTHONHASHSEED": "7"},
        check=True,
    )
    assert (tmp_path / "sampled_toy.fmu").read_bytes() == python_fmus("sampled_toy").read_bytes()


def test_two_of_them_and_a_native_one_run_in_one_process(
    slave: Callable[..., Slave], built: Path_of, tmp_path: Path
) -> None:
    plants, toy = [slave("duffing"), slave("duffing")], slave("sampled_toy")
    native = Slave(Path(fmpy.extract(str(built("duffing")), str(tmp_path))))
    start, drive = CASES["duffing"]
    for instance in (*plants, native):
        instance.initialize(start)
    toy.initialize()
    points = list(zip(grid("multiplied")[0], *grid("multiplied"), strict=True))[:50]
    for k, (now, t, h) in enumerate(points):
        for instance in (*plants, native):
            for name, value in drive(now).items():
                instance.set(name, value)
            instance.step(t, h)
        toy.step(k * 0.1, 0.1)
    values = [instance.outputs() for instance in (*plants, native)]
    assert values[0] == values[1]
    assert values[0] == pytest.approx(values[2], rel=1e-14, abs=1e-14)
    assert toy.get("diagnostics.rejected_samples") == 0
    native.fmu.freeInstance()


def test_the_fmu_needs_no_project_on_the_target(python_fmus: Path_of, tmp_path: Path) -> None:
    """The modules come from the FMU: `observers` is not imported, even where it could be."""
    script = (
        "import sys, fmpy\n"
        f"result = fmpy.simulate_fmu({str(python_fmus('sampled_toy'))!r}, stop_time=1.0, output_interval=0.1)\n"
        "assert 'observers' not in sys.modules and 'fmu_src' not in sys.modules\n"
        "print(result['estimate.level'][-1].hex())\n"
    )
    printed = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    face = Instance(COMPONENTS["sampled_toy"]())
    for k in range(10):
        face.step(k * 0.1, 0.1)
    assert float.fromhex(printed.stdout.strip()) == face.get("estimate.level")


NO_PYTHON = """
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include "fmi2Functions.h"

static void say(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)e, (void)name, (void)category;
    printf("%d %s", (int)status, text);
}

int main(int argc, char **argv)
{
    fmi2CallbackFunctions callbacks = {say, calloc, free, NULL, NULL};
    void *library = argc > 2 ? dlopen(argv[1], RTLD_NOW) : NULL;
    if (!library)
        return 2;
    fmi2InstantiateTYPE *instantiate;
    *(void **)&instantiate = dlsym(library, "fmi2Instantiate");
    return instantiate("x", fmi2CoSimulation, argv[2], "", &callbacks, 0, 0) != NULL;
}
"""


@pytest.mark.long  # needs a C compiler of the machine's
@pytest.mark.skipif(sys.platform != "linux", reason="an ELF host")
def test_a_host_without_python_is_told_so(unpacked: Path_of, tmp_path: Path) -> None:
    (tmp_path / "host.c").write_text(NO_PYTHON)
    headers = Path(fmpy.__file__).parent / "c-code"
    gcc = shutil.which("gcc")  # zig would compile the C library's start-up code first
    need(gcc is not None, "gcc is not installed here: make ci-tools")
    subprocess.run([str(gcc), "-I", str(headers), "host.c", "-ldl", "-o", "host"], cwd=tmp_path, check=True)
    folder = unpacked("sampled_toy")
    guid = fmpy.read_model_description(str(folder)).guid
    library = folder / "binaries" / "linux64" / "sampled_toy.so"
    result = subprocess.run([tmp_path / "host", library, guid], capture_output=True, text=True, check=True)
    assert result.stdout.startswith("3 fmi2Instantiate: there is no Python in this process")


@pytest.fixture(scope="session")
def friction(tmp_path_factory: pytest.TempPathFactory) -> ca.Function:
    """A function that CasADi knows from a shared library only: sin(x) + tanh(3 x)."""
    folder = tmp_path_factory.mktemp("friction")
    (folder / "friction.c").write_text(
        "#include <math.h>\nint friction(const double **arg, double **res, long long *iw, double *w, int mem);\n"
        '__attribute__((visibility("default")))\n'
        "int friction(const double **arg, double **res, long long *iw, double *w, int mem)\n"
        "{ (void)iw, (void)w, (void)mem; if (res[0]) res[0][0] = sin(arg[0][0]) + tanh(3 * arg[0][0]); return 0; }\n"
    )
    (folder / "built.so").write_bytes(compile_library("friction", folder, "linux64"))
    return ca.external("friction", str(folder / "built.so"), {"enable_fd": True})


def swing(friction: ca.Function) -> Model:
    return Model(
        name="swing",
        states=[Variable("angle", start=1.0), Variable("rate")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.rate, -x.angle - 0.1 * friction(x.rate)],
        output=lambda x, u, p, t: [x.angle],
    )


class Python(ca.Callback):
    """A function that CasADi knows as Python code only."""

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.construct("python_friction", {"enable_fd": True})

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return [ca.tanh(arguments[0])]


def test_a_model_with_an_external_function_runs_by_this_target_only(friction: ca.Function, tmp_path: Path) -> None:
    component = plant(swing(friction))
    with pytest.raises(ExportError, match=r"'swing': CasADi cannot write C .* 'flow': .* an external function"):
        export(component, tmp_path)
    path = export(component, tmp_path, target="python")
    result = fmpy.simulate_fmu(str(path), stop_time=5.0, output_interval=0.1, output=["y"])

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1], -x[0] - 0.1 * (np.sin(x[1]) + np.tanh(3 * x[1]))]

    reference = solve_ivp(rates, (0, 5), [1.0, 0.0], rtol=1e-11, atol=1e-12, t_eval=result["time"])
    assert np.abs(result["y"] - reference.y[0]).max() < 4e-11


def test_a_function_that_is_python_code_is_refused_by_both_targets_with_the_reason(tmp_path: Path) -> None:
    component = plant(swing(Python()))
    with pytest.raises(ExportError, match=r"CasADi cannot write C .* Callback"):
        export(component, tmp_path)
    with pytest.raises(ExportError, match=r"cannot serialise the function 'flow': .*Callback"):
        export(component, tmp_path, target="python")


def test_unknown_targets_and_platforms_are_named(tmp_path: Path) -> None:
    component = plant(DUFFING)
    with pytest.raises(ExportError, match="target 'java' is unknown; known: native, python"):
        export(component, tmp_path, target="java")
    with pytest.raises(ExportError, match="PythonFMU has no library for darwin64; it has linux64, win64"):
        export(component, tmp_path, ["darwin64"], target="python")


@pytest.mark.long  # a million samples
def test_what_a_step_takes_is_counted_from_where_the_run_is_in_python_too(slave: Callable[..., Slave]) -> None:
    counted(slave)


@pytest.mark.parametrize(
    "compiled",
    [
        pytest.param(False, id="choice"),
        pytest.param(True, id="compiled", marks=pytest.mark.long),  # zig compiles its C library for Windows once
    ],
)
def test_all_platforms_are_those_that_pythonfmu_has_a_library_for(
    compiled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not compiled:
        monkeypatch.setattr(target, "compile_library", lambda *_: b"")
    export(plant(DUFFING), tmp_path, ["all"], target="python")
    with zipfile.ZipFile(tmp_path / "duffing.fmu") as archive:
        binaries = {name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/")}
    assert binaries == {"linux64", "win64"}


def test_the_command_line_builds_them_and_names_what_it_does_not_know(tmp_path: Path) -> None:
    def build_fmus(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(ROOT / "build_fmus.py"), "--only", "sine", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)

    assert build_fmus("--target", "python").returncode == 0
    with zipfile.ZipFile(tmp_path / "fmus" / "sine.fmu") as archive:
        assert "resources/component.json" in archive.namelist()
    refused = build_fmus("--target", "java")
    assert refused.returncode == 2
    assert refused.stderr.strip().splitlines()[-1] == "error: target 'java' is unknown; known: native, python"


def is_noisy(name: str) -> bool:
    """Does a sensor of this system make noise?"""
    return any(values.get("sensor.noise_bound", 0.0) > 0 for values in SYSTEMS[name].parameters.values())


def largest_difference(native: Path, python: Path, stop: float | None = None) -> float:
    """Of any variable at any time, to the system's stop time or `stop`, relative to the variable's largest value or 1."""
    results = [run_system(path, stop=stop) for path in (native, python)]
    assert results[0].names == results[1].names
    scale = np.maximum(1, np.nanmax(np.abs(results[0].values), axis=0))
    return float(np.nanmax(np.abs(results[0].values - results[1].values) / scale))


@pytest.mark.parametrize(("name", "stop"), [("gong_example_2", 30.0), ("closed_loop_motor", 1.0)])
def test_a_system_of_python_fmus_gives_the_native_numbers(
    name: str, stop: float, catalogue_system: Path_of, tmp_path: Path
) -> None:
    with plotted_briefly():
        build_all(choose([name]), tmp_path / "fmus", ["host"], target="python")
    python = tmp_path / "systems" / f"{name}.ssp"
    assert largest_difference(catalogue_system(name), python, stop) < (1e-9 if is_noisy(name) else 1e-12)


@pytest.mark.long
def test_a_system_of_every_kind_of_python_fmu_gives_the_native_numbers(
    catalogue_system: Path_of, tmp_path: Path
) -> None:
    with plotted_briefly():
        build_all(choose(KINDS), tmp_path / "fmus", ["host"], target="python")
    differences = {
        name: largest_difference(catalogue_system(name), tmp_path / "systems" / f"{name}.ssp") for name in KINDS
    }
    limits = {name: 1e-9 if is_noisy(name) else 1e-12 for name in KINDS}
    assert {name: value for name, value in differences.items() if not value <= limits[name]} == {}


# Of a state of the slave, by byte offset behind the relay's header: lifecycle, whole, steps, label, phase, carry, step, t0, stop, numbers.
UNSOUND = {
    "lifecycle": (0, "q", 64),
    "negative ticks": (8, "q", -5),
    "not started": (8, "q", -1),
    "steps": (16, "q", -1),
    "time": (24, "d", np.nan),
    "phase": (32, "d", 1.0),
    "start time": (56, "d", np.inf),
    "stop time": (64, "d", np.nan),
    "parameter out of range": (72 + 5 * 8, "d", 7.0),
    "integer that is not whole": (72 + 6 * 8, "d", 1.5),
    "state": (-8, "d", np.nan),
}


@pytest.mark.parametrize("what", UNSOUND)
def test_a_state_that_no_slave_can_have_is_refused(slave: Callable[..., Slave], what: str) -> None:
    """Its checksum is right (FNV-1a, 64 bits)."""
    offset, kind, value = UNSOUND[what]
    fmu = slave("sampled_toy").initialize()
    for k in range(5):
        fmu.step(k * 0.1, 0.1)
    before = fmu.state()
    bad = bytearray(before)
    struct.pack_into(f"<{kind}", bad, offset + 32 if offset >= 0 else offset + len(bad), value)
    total = 14695981039346656037
    for byte in bad[32:]:
        total = ((total ^ byte) * 1099511628211) % 2**64
    struct.pack_into("<Q", bad, 24, total)
    handle = fmu.fmu.deSerializeFMUstate(bytes(bad))
    message = fmu.refuses(lambda: fmu.fmu.setFMUstate(handle))
    assert message == "fmi2SetFMUstate: the state holds what no instance of sampled_toy can hold."
    fmu.fmu.freeFMUState(handle)
    assert fmu.state() == before
    fmu.step(0.5, 0.1)
