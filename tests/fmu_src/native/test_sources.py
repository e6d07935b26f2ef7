"""The sources in an FMU, as those compile them who take no binary: several FMUs in one program, one translation unit, other compilers."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import fmpy
import pytest

from fmu_src.compliance.files.binaries import functions
from fmu_src.native import compiler as native
from fmu_src.native.sources import text
from slave import Slave
from tools import few, need

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads ELF files")

Path_of = Callable[[str], Path]
RUN = Path(__file__).parent / "static_link" / "run.c"
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
DOCUMENTED = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
ZIG = (sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-linux-gnu.2.17", "-mcpu=baseline")
COMPILERS = {"gcc": ("gcc",), "zig": ZIG}
# A plant with a jumping parameter, a filter, a moving window.
THREE = ("duffing", "duffing_missing_ukf", "duffing_segments")
STEPS, STEP = 40, 0.1


def call(command: Sequence[str | Path], folder: Path) -> str:
    """What the command prints; the test fails with its words where it does."""
    cache = str(native.cache_folder())
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    done = subprocess.run(list(map(str, command)), cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def compiler(name: str) -> tuple[str, ...]:
    command = COMPILERS.get(name, (name,))
    need(shutil.which(command[0]) is not None, f"{command[0]} is not installed here: make ci-tools")
    return command


def sources(folder: Path) -> list[Path]:
    return sorted((folder / "sources").glob("*.c"))


def symbols(file: Path, *options: str) -> set[str]:
    """The names that a file defines for others."""
    lines = call(["nm", "--defined-only", *options, file], file.parent).splitlines()
    return {line.split()[2] for line in lines if len(line.split()) == 3}


def of_shared_library(folder: Path) -> list[str]:
    """What run.c prints, of the binary in the FMU."""
    slave = Slave(folder)
    slave.initialize()
    inputs, outputs = real(folder, "input"), real(folder, "output")
    printed = []
    for k in range(STEPS):
        for i, reference in enumerate(inputs):
            slave.fmu.setReal([reference], [(k + i) % 7 * 0.125])
        slave.step(k * STEP, STEP)
        printed += [struct.pack(">d", value).hex() for value in slave.fmu.getReal(outputs)]
    slave.fmu.freeInstance()
    return printed


def real(folder: Path, causality: str) -> list[int]:
    variables = fmpy.read_model_description(str(folder)).modelVariables
    return [v.valueReference for v in variables if v.causality == causality and v.type == "Real"]


def runner(folder: Path, name: str) -> list[str]:
    """The definitions that run.c wants for this FMU."""
    guid = fmpy.read_model_description(str(folder)).guid
    lists = {kind.upper() + "S": ",".join(map(str, real(folder, kind))) for kind in ("input", "output")}
    defined = {"RUN": f"run_{name}", "GUID": f'"{guid}"', "STEP": STEP, "STEPS": STEPS, **lists}
    return [f"-D{key}={value}" for key, value in defined.items()]


def identifier(folder: Path) -> str:
    return str(fmpy.read_model_description(str(folder)).coSimulation.modelIdentifier)


# zig makes the binaries of every other test.
@pytest.mark.long
@pytest.mark.parametrize("name", ["gcc", pytest.param("zig", marks=pytest.mark.long)])
def test_three_fmus_linked_into_one_program_give_what_their_shared_libraries_give(
    name: str, unpacked: Path_of, tmp_path: Path
) -> None:
    """gcc does not optimise: it is names that meet here; the numbers of optimised sources are the next test's."""
    cc = (*compiler(name), *STRICT, *(["-O0"] if name == "gcc" else []))
    folders = {identifier(folder): folder for folder in map(unpacked, THREE)}
    assert len(folders) == len(THREE)
    objects: list[Path] = []
    for model, folder in folders.items():
        for source in [*sources(folder), RUN]:
            objects.append(tmp_path / f"{model}_{source.stem}.o")
            defined = [f"-DFMI2_FUNCTION_PREFIX={model}_", *(runner(folder, model) if source == RUN else [])]
            call([*cc, *defined, "-I", folder / "sources", "-c", source, "-o", objects[-1]], tmp_path)
            foreign = {s for s in symbols(objects[-1], "--extern-only") if not s.startswith(f"{model}_")}
            assert foreign == ({f"run_{model}"} if source == RUN else set()), source
    declared = "".join(f"int run_{model}(void);\n" for model in folders)
    body = " || ".join(f"run_{model}()" for model in folders)
    (tmp_path / "main.c").write_text(f"{declared}int main(void) {{ return {body}; }}\n")
    call([*cc, "main.c", *objects, "-lm", "-o", "program"], tmp_path)
    printed = call([tmp_path / "program"], tmp_path).splitlines()
    for model, line in zip(folders, printed, strict=True):
        assert line.split() == of_shared_library(folders[model]), model
        assert len(set(line.split())) > STEPS  # it moves


@pytest.mark.parametrize("model", few(THREE))
def test_all_sources_in_one_translation_unit_compile_and_give_the_same(
    model: str, unpacked: Path_of, tmp_path: Path
) -> None:
    folder = unpacked(model)
    (tmp_path / "all.c").write_text("".join(f'#include "{source.name}"\n' for source in sources(folder)))
    (tmp_path / "main.c").write_text("int run_it(void);\nint main(void) { return run_it(); }\n")
    include = ["-I", folder / "sources"]
    call([*compiler("gcc"), *STRICT, *include, "-c", "all.c"], tmp_path)
    call(["gcc", *STRICT, *include, *runner(folder, "it"), "-c", RUN, "-o", "run.o"], tmp_path)
    call(["gcc", "main.c", "run.o", "all.o", "-lm", "-o", "program"], tmp_path)
    assert call([tmp_path / "program"], tmp_path).split() == of_shared_library(folder)


@pytest.mark.parametrize("name", COMPILERS)
@pytest.mark.parametrize("option", [(), ("-DFMI2_OVERRIDE_FUNCTION_PREFIX", "-DFMI2_FUNCTION_PREFIX=duffing_")])
def test_built_as_the_page_says_the_library_exports_the_functions_of_fmi_and_nothing_else(
    name: str, option: tuple[str, ...], unpacked: Path_of, tmp_path: Path
) -> None:
    folder = unpacked("duffing")
    page = (folder / "documentation" / "index.html").read_text()
    assert f"cc {' '.join(DOCUMENTED)} *.c -lm" in page
    call([*compiler(name), *DOCUMENTED, *option, *sources(folder), "-lm", "-o", tmp_path / "built.so"], tmp_path)
    assert symbols(tmp_path / "built.so", "--dynamic") == functions("CoSimulation")


@pytest.mark.parametrize("model", THREE)
def test_a_compiler_that_knows_c99_and_no_more_takes_the_sources(model: str, unpacked: Path_of, tmp_path: Path) -> None:
    """tcc: INFINITY, for one, is no constant to it."""
    folder = unpacked(model)
    call([*compiler("tcc"), "-shared", *sources(folder), "-lm", "-o", tmp_path / "built.so"], tmp_path)
    assert symbols(tmp_path / "built.so", "--dynamic") >= functions("CoSimulation")


@pytest.mark.parametrize("name", ["gcc", "tcc"])
def test_a_text_is_a_string_of_c_whatever_it_holds(name: str, tmp_path: Path) -> None:
    """Quotes, escapes, trigraphs, figures behind an escape, letters of other alphabets and what lies beyond 16 bits."""
    value = 'a "b" \\n ??) ??/ é7 \u03b8 \U0001f600 \x07'
    (tmp_path / "it.c").write_text(
        f"#include <stdio.h>\nint main(void)\n{{\n    puts({text(value)});\n    return 0;\n}}\n"
    )
    call([*compiler(name), *(STRICT if name == "gcc" else ()), "it.c", "-o", "it"], tmp_path)
    assert call([tmp_path / "it"], tmp_path) == value + "\n"


@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
@pytest.mark.parametrize("name", COMPILERS)
def test_arithmetic_without_nan_is_refused_where_it_is_compiled(
    name: str, option: str, unpacked: Path_of, tmp_path: Path
) -> None:
    for source in sources(unpacked("duffing")):
        command = [*compiler(name), "-std=c99", option, "-c", str(source), "-o", str(tmp_path / "it.o")]
        cache = str(native.cache_folder())
        environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert done.returncode != 0 and "needs NaN and infinity" in done.stderr, source
