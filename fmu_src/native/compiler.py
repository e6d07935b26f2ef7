"""C sources become a shared library, for any platform, with the one compiler that comes from PyPI: ziglang."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from fmu_src.errors import ExportError
from fmu_src.platforms import PLATFORMS

FLAGS = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Werror",
    "-O2",
    "-ffp-contract=off",  # no fused multiply-add: platforms agree to the last bit where their libm does
    "-mcpu=baseline",  # zig's default is the machine that builds
    "-fvisibility=hidden",  # only the fmi2 functions are seen from outside
    "-fno-sanitize=undefined",  # zig's default in some modes; its runtime has no place in an FMU
    "-fPIC",
)
LINK = ("-shared", "-g0", "-s")


def cache_folder() -> Path:
    """Where zig keeps what it compiled: the project's `.cache/zig`, or the user's cache where there is no project."""
    project = Path(__file__).resolve().parents[2]
    if (project / "pyproject.toml").is_file():
        return project / ".cache" / "zig"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "observer-fmus" / "zig"


def compile_library(name: str, folder: Path, platform: str, libraries: Sequence[str] = ("-lm",)) -> bytes:
    """The shared library made of all `*.c` in `folder`, linked with `libraries`, for a platform of PLATFORMS.

    Raises:
        ExportError: the compiler refused; the message holds what it said.
    """
    target = PLATFORMS[platform]
    library = f"{name}{target.suffix}"
    sources = sorted(path.name for path in folder.glob("*.c"))
    install_name = [f"-Wl,-install_name,@rpath/{library}"] if target.suffix == ".dylib" else []
    # Relative names only, so that no path of this machine gets into the library.
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        target.target,
        *FLAGS,
        *LINK,
        *install_name,
        "-o",
        library,
        *sources,
        *libraries,
    ]
    cache = str(cache_folder())
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if result.returncode != 0:
        raise ExportError(
            f"component '{name}': the C compiler refused its sources for {platform}:\n{result.stderr.strip()}"
        )
    made = folder / library
    content = made.read_bytes()
    made.unlink()
    return content
