"""The sources on processors for which no FMU holds a binary: 32 bits, big-endian, another C library; under qemu."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from slave import Slave
from test_sources import RUN, STRICT, THREE, call, compiler, identifier, of_shared_library, runner, sources
from tools import need

Path_of = Callable[[str], Path]
# The compiler by qemu's name of its processor: 32 bits; 32 bits and big-endian. Debian's gcc has its C library with it, where zig has to
# compile one first, a minute or two.
COMPILERS = {"arm": "arm-linux-gnueabihf-gcc", "mips": "mips-linux-gnu-gcc"}
TOLERANCE = 1e-12  # of each output's largest value


def numbers(words: list[str], outputs: int) -> np.ndarray:
    return np.array([struct.unpack(">d", bytes.fromhex(word))[0] for word in words]).reshape(-1, outputs)


@pytest.mark.long
@pytest.mark.parametrize("name", THREE)
@pytest.mark.parametrize("processor", COMPILERS)
def test_the_sources_give_linux64s_numbers_on_another_processor(
    processor: str, name: str, unpacked: Path_of, tmp_path: Path
) -> None:
    emulator = shutil.which(f"qemu-{processor}")
    need(emulator is not None, "qemu-user is not installed here: make ci-tools")
    assert emulator is not None
    folder = unpacked(name)
    (tmp_path / "main.c").write_text("int run_it(void);\nint main(void) { return run_it(); }\n")
    cc = (*compiler(COMPILERS[processor]), "-static", *STRICT)
    defined = runner(folder, "it")
    call([*cc, *defined, "-I", folder / "sources", "main.c", RUN, *sources(folder), "-lm", "-o", "it"], tmp_path)
    printed, expected = call([emulator, tmp_path / "it"], tmp_path).split(), of_shared_library(folder)
    outputs = len(expected) // 40
    found, wanted = numbers(printed, outputs), numbers(expected, outputs)
    error = np.abs(found - wanted).max(axis=0) / np.maximum(np.abs(wanted).max(axis=0), 1e-16)
    print(processor, identifier(folder), error.max())
    assert (error <= TOLERANCE).all()


def test_a_state_of_a_machine_of_the_other_endianness_is_refused(unpacked: Path_of) -> None:
    slave = Slave(unpacked("duffing"))
    slave.initialize()
    state = slave.state()
    count = len(state) // 8
    swapped = struct.pack(f"<{count}Q", *struct.unpack(f">{count}Q", state))
    assert len(swapped) == len(state)
    words = slave.refuses(lambda: slave.fmu.deSerializeFMUstate(swapped))
    assert "does not belong to duffing" in words
    assert slave.state() == state
    slave.fmu.freeInstance()
