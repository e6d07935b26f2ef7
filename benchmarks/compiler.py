"""Compiles C for this machine as the FMUs are compiled: same compiler, same flags."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path

from benchmarks.errors import BenchmarkError
from fmu_src.native.compiler import FLAGS, cache_folder
from fmu_src.platforms import PLATFORMS, resolve

FMI_HEADERS = str(files("fmpy") / "c-code")


def compile_c(sources: Iterable[Path], out: Path, *more: str, cache: Path | None = None) -> None:
    """The program `out` (a library with "-shared" in `more`) made of `sources`; symbols stay in it.

    `cache` is where zig keeps what it compiled, the project's own cache if absent.

    Raises:
        BenchmarkError: the compiler refused; the message holds what it said.
    """
    target = PLATFORMS[resolve(["host"])[0]].target
    folder = str(cache or cache_folder())
    result = subprocess.run(
        [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            "-target",
            target,
            *FLAGS,
            "-g0",
            "-o",
            str(out),
            *map(str, sources),
            *more,
        ],
        env=os.environ | {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder},
        capture_output=True,
        text=True,
    )
    if result.returncode != 0:
        raise BenchmarkError(f"the C compiler refused {out.name}:\n{result.stderr.strip()}")
