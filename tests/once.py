"""What several processes need, made once; what several runs need, compiled once."""

from __future__ import annotations

import hashlib
import importlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import pytest
from filelock import FileLock

from fmu_src.native import compiler
from tools import ROOT

LIBRARIES = ROOT / ".cache" / "tests"
PLOTTED = 20  # steps


def once(folder: Path, fill: Callable[[Path], object]) -> Path:
    """`folder`, complete: where it is missing, one of the processes that ask for it lets `fill` make it, the others wait."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            scratch = Path(tempfile.mkdtemp(dir=folder.parent))
            fill(scratch)
            scratch.rename(folder)
    return folder


@contextmanager
def compiled_once(optimised: bool = True) -> Iterator[None]:
    """Exports within it take the library that an earlier run compiled of the same C with the same flags.

    zig's own cache does not serve here: it compiles anew what lies in another folder. Not `optimised`: no optimisation, which takes most
    of the time, up to two minutes for one FMU.
    """

    def compile_library(name: str, folder: Path, platform: str, libraries: Sequence[str] = ("-lm",)) -> bytes:
        made_by = (version("ziglang"), compiler.FLAGS, compiler.LINK, name, platform, libraries)
        digest = hashlib.sha256(repr(made_by).encode())
        for path in sorted(folder.iterdir()):
            digest.update(f"{path.name} {path.stat().st_size} ".encode() + path.read_bytes())
        made = once(
            LIBRARIES / digest.hexdigest(),
            lambda to: (to / "library").write_bytes(compiler.compile_library(name, folder, platform, libraries)),
        )
        return (made / "library").read_bytes()

    flags = compiler.FLAGS
    if not optimised:
        flags = tuple("-O0" if flag == "-O2" else flag for flag in flags)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "FLAGS", flags)
        for module in ("fmu_src.component_fmu", "fmu_src.plant.guest"):
            patch.setattr(importlib.import_module(module), "compile_library", compile_library)
        yield


@contextmanager
def plotted_briefly() -> Iterator[None]:
    """Exports within it plot the first steps only of the default experiment, 600 of which take the Python face up to 20 s.

    The reference results keep their steps. Of a plot in full: test_native.py and test_experiment.py.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fmu_src.documentation.figures.MOST_STEPS", PLOTTED)
        yield
