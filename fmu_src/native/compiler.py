"""C sources become a shared library, for any platform, with the one compiler that comes from PyPI: ziglang."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Sequence
from importlib.util import find_spec
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
MOST_ERRORS = 3  # of the compiler that a message holds
LINK = ("-shared", "-g0", "-s")
_shares = False  # its group with the compilers


def cache_folder() -> Path:
    """Where zig keeps what it compiled: the project's `.cache/zig`, or the user's cache where there is no project."""
    project = Path(__file__).resolve().parents[2]
    if (project / "pyproject.toml").is_file():
        return project / ".cache" / "zig"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "observer-fmus" / "zig"


def compile_library(
    name: str, folder: Path, platform: str, libraries: Sequence[str] = ("-lm",), flags: Sequence[str] = ()
) -> bytes:
    """The shared library made of all `*.c` in `folder`, linked with `libraries`, for a platform of PLATFORMS; `flags` add to FLAGS.

    Raises:
        ExportError: the compiler is missing, does not start, was ended or refused; the message holds what it said first.
    """
    target = PLATFORMS[platform]
    library = f"{name}{target.suffix}"
    sources = sorted(path.name for path in folder.glob("*.c"))
    install_name = [f"-Wl,-install_name,@rpath/{library}"] if target.suffix == ".dylib" else []
    # Relative names only, so that no path of this machine gets into the library.
    command = [
        str(_compiler()),
        "cc",
        "-target",
        target.target,
        *FLAGS,
        *LINK,
        *flags,
        *install_name,
        "-o",
        library,
        *sources,
        *libraries,
    ]
    cache = str(cache_folder())
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    code, said = _run(command, folder, environment)
    if code < 0:
        raise ExportError(
            f"component '{name}': the C compiler was ended by {signal.Signals(-code).name} for {platform}: memory may have run out"
        )
    if code != 0:
        raise ExportError(f"component '{name}': the C compiler refused its sources for {platform}: {_first(said)}")
    made = folder / library
    content = made.read_bytes()
    made.unlink()
    return content


def check_compiler() -> None:
    """Raise an ExportError where there is no compiler: before anything is worked out for it."""
    _compiler()


def _compiler() -> Path:
    """The compiler's program, run without Python between, so that it can be ended."""
    found = find_spec("ziglang")
    folder = Path(found.origin).parent if found is not None and found.origin is not None else None
    program = folder / ("zig.exe" if os.name == "nt" else "zig") if folder is not None else None
    if program is None or not program.is_file():
        raise ExportError(
            "the C compiler is missing: install it by 'pip install ziglang' into this Python's environment"
        )
    return program


def share_group() -> None:
    """From now on compilers are in this process's group, for whoever ends that as one; else each is in a group of its own."""
    global _shares
    _shares = True


def _run(command: Sequence[str], folder: Path, environment: dict[str, str]) -> tuple[int, str]:
    """Exit code and error text of the compiler. Whatever ends this process's wait ends the compiler and what it started."""
    try:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=not _shares,  # a group of its own, which can be ended as one
        )
    except OSError as error:
        raise ExportError(f"the C compiler {command[0]} does not start: {error.strerror or error}") from None
    try:
        said = process.communicate()[1]
    except BaseException:
        _end(process)
        raise
    return process.returncode, said


def _end(process: subprocess.Popen[str]) -> None:
    if os.name == "posix" and not _shares:
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def _first(said: str) -> str:
    """The first errors of what the compiler said: one usually makes the others."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()] or lines
    return "; ".join(errors[:MOST_ERRORS]) or "it says nothing"
